// Adds filters above each table with the class "filtered": by text, by the values of columns whose heading has
// the class "choice", and by the headings of rows. Without this script, the page shows all rows.
"use strict";
for (const table of document.querySelectorAll("table.filtered")) {
  const [head, ...all] = table.rows;
  const rows = [];
  const headings = [];
  for (const row of all) {
    if (row.cells[0].classList.contains("level")) headings.push({ row, rows: [] });
    else {
      rows.push(row);
      headings.at(-1)?.rows.push(row);
    }
  }
  const bar = document.createElement("p");
  bar.className = "filters";
  const tests = [];
  const add = (control, label, test) => {
    control.setAttribute("aria-label", label);
    control.addEventListener("input", update);
    bar.append(control);
    tests.push((row) => control.value === "" || test(row, control.value));
  };
  const addChoice = (label, values, test) => {
    const select = document.createElement("select");
    select.append(new Option(label, ""), ...values.map((value) => new Option(value, value)));
    add(select, label, test);
  };
  const search = document.createElement("input");
  search.type = "search";
  search.placeholder = "name of an element";
  const words = new Map(
    rows.map((row) => [row, [...row.cells].map((cell) => `${cell.textContent} ${cell.title}`).join(" ").toLowerCase()]),
  );
  add(search, "text", (row, text) => words.get(row).includes(text.toLowerCase()));
  [...head.cells].forEach((heading, column) => {
    if (!heading.classList.contains("choice")) return;
    const value = (row) => row.cells[column].dataset.value;
    const values = [...new Set(rows.map(value))].sort();
    if (values.length === 1) return;
    addChoice(`${heading.textContent}: all`, values, (row, chosen) => value(row) === chosen);
  });
  if (headings.length > 1) {
    const titles = headings.map(({ row }) => row.textContent.split(":")[0]);
    addChoice("verdict: all", titles, (row, chosen) => headings[titles.indexOf(chosen)].rows.includes(row));
  }
  const count = document.createElement("output");
  bar.append(count);
  function update() {
    for (const row of rows) row.hidden = !tests.every((test) => test(row));
    for (const heading of headings) heading.row.hidden = heading.rows.every((row) => row.hidden);
    count.textContent = `${rows.filter((row) => !row.hidden).length} of ${rows.length} rows`;
  }
  table.before(bar);
  update();
}
