"""The figures of a crosscheck as tables for the terminal and as markdown."""

from __future__ import annotations

from collections.abc import Iterator

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from crosscheck.compare import Row
from crosscheck.run import Crosscheck


def terminal_tables(result: Crosscheck) -> Iterator[Table]:
    """Figures of pairs of engines, of each engine by itself, and of its own systems against each other."""
    titles = {
        "pairs": f"{result.title}: {result.scene.description}",
        "single": "each engine by itself",
        "within": "two equations of motion of one engine",
    }
    engines = {engine.name for engine in result.engines}
    for part, title in titles.items():
        rows = [row for row in result.rows if _part(row, engines) == part]
        if rows:
            yield _table(title, rows)


def _part(row: Row, engines: set[str]) -> str:
    if len(row.between) == 1:
        return "single"
    return "pairs" if set(row.between) <= engines else "within"


def _table(title: str, rows: list[Row]) -> Table:
    """A line for each quantity, a column for each pair or engine, a section for each level."""
    columns = list(dict.fromkeys(row.between for row in rows))
    heading = Text(title, style="bold")
    table = Table(title=heading, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("")
    for between in columns:
        table.add_column("\n".join(between), justify="right", no_wrap=True)
    for level in dict.fromkeys(row.level for row in rows):
        table.add_section()
        table.add_row(Text(level, style="bold"))
        at_level = [row for row in rows if row.level == level]
        for quantity in dict.fromkeys(row.quantity for row in at_level):
            cells = {row.between: _cell(row) for row in at_level if row.quantity == quantity}
            table.add_row(f"  {quantity}", *(cells.get(between, "") for between in columns))
    return table


def _cell(row: Row) -> Text:
    if row.informs:
        return Text(f"{row.value:.1e}")
    text = f"{row.value:.1e} {'<' if row.value <= row.tolerance else '>'} {row.tolerance:.0e}"
    if row.informs:
        return Text(text)
    return Text(text, style="green" if row.agrees else "bold red")


def settings_lines(result: Crosscheck) -> Iterator[str]:
    """One line an engine: what it ran with and how long."""
    for name, run in result.runs.items():
        settings = ", ".join(f"{key} {_short(value)}" for key, value in run.settings.items())
        yield f"{name}: {settings}; {run.wall_time:.2g} s"


def _short(value: object) -> object:
    """A setting with as many digits as people read."""
    return f"{value:.3g}" if isinstance(value, float) else value


def markdown(result: Crosscheck) -> str:
    """The verdict, the settings of the engines and all figures, a line each."""
    lines = [f"# {result.title}", "", f"**{result.verdict}**", ""]
    lines += [f"- {line}" for line in settings_lines(result)]
    level = ""
    for row in result.rows:
        if row.level != level:
            level = row.level
            lines += [
                "",
                f"## {level}",
                "",
                "| figure | between | value | at most | verdict | worst at |",
                "|---|---|---|---|---|---|",
            ]
        verdict = "for information" if row.informs else "holds" if row.agrees else "**FAILS**"
        lines.append(
            f"| {row.quantity} | {', '.join(row.between)} | {row.value:.1e} | {row.tolerance:.0e} "
            f"| {verdict} | {row.where} |"
        )
    return "\n".join(lines) + "\n"
