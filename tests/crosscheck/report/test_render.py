"""One report in every format."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import matplotlib
import pytest

from crosscheck.report.entry import PageEntry
from crosscheck.report.plots import run_errors
from crosscheck.report.render import as_json, junit, markdown, markdown_table, shorten_words, terminal
from crosscheck.report.table import (
    Cell,
    Column,
    Lines,
    Report,
    Table,
    checked_cell,
    name_value_table,
    number_columns,
    text_columns,
)
from crosscheck.report.template import rendered

ODD = "a|b <c> & \x00 `d`_"

TABLE = Table(
    "figures",
    [Column("quantity"), Column("difference", "m", True)],
    [
        "model",
        ["mass", checked_cell(1e-3, 1e-6, False, "crank")],
        ["points", checked_cell(1e-9, 1e-6, True)],
        "energy",
    ],
)

REPORT = Report(
    "run four_bar",
    "DISAGREE: somewhere",
    Cell("FAILS", "fails"),
    [TABLE, Lines("notes", ["first", "second"]), Lines("versions", ["numpy 2"], folded=True)],
    1.5,
)


def test_an_empty_line_separates_sentences_from_a_table_without_title():
    table = Table("", text_columns("level", "checks"), [["model", "28 ok"]])
    lines = terminal([Lines("", ["your settings  ACCURATE"]), table, Lines("", ["untested"])]).splitlines()
    assert [line.split()[0] if line else "" for line in lines] == [
        *("your", "", "level", "model", "", "untested"),
    ]


def test_terminal():
    assert terminal(REPORT.parts).splitlines() == [
        "figures",
        "quantity    difference, m",
        "─────────────────────────",
        "model",
        "  mass    1.0e-03 > 1e-06",
        "  points  1.0e-09 < 1e-06",
        "",
        "energy",
        "",
        "notes",
        "first",
        "second",
    ]


LONG = " ".join(8 * ["words that go on and on;"])


@pytest.mark.parametrize("columns", [80, 60, 120])
def test_what_is_printed_fits_the_terminal(monkeypatch, columns):
    monkeypatch.setenv("COLUMNS", str(columns))
    names = [f"between the engines {k}, m" for k in range(9)]
    row = ["angular acceleration", "", *(checked_cell(k * 1e-9, 1e-6, True) for k in range(9))]
    wide = Table("wide", [Column(""), Column("why"), *number_columns(*names)], ["head", row, ["a", LONG]])
    text = terminal([wide, Lines("", [LONG, f"    {LONG}"])])
    assert max(map(len, text.splitlines())) <= columns
    assert all(f"{k}.0e-09 < 1e-06" in text for k in range(1, 9))
    *_, indented = text.split("\n    words")
    assert all(line.startswith(" " * 6) for line in indented.splitlines()[1:])


def test_a_heading_of_rows_is_wider_than_the_first_column(monkeypatch):
    monkeypatch.setenv("COLUMNS", "66")
    columns = [
        *text_columns("", "element"),
        Column("value"),
        *number_columns("difference, m", "motion, m/s^2"),
    ]
    heading = "rounding: within the digits of the files"
    rows = [heading, ["1", "left_shoulder_roll_joint", "0.00146452 0.0112843", "0.1", "0.2"]]
    lines = terminal([Table("rows", columns, rows)]).splitlines()
    assert lines.count(heading) == 2  # the columns do not fit side by side: two tables
    # both tables name the element, so that their rows can be told apart
    assert sum("left_shoulder_roll_joint" in line for line in lines) == 2


def test_an_empty_cell_is_not_bold_in_markdown():
    table = Table("", [Column("quantity"), *number_columns("size")], [["base", Cell("", "fails")]])
    assert list(markdown_table(table))[-1] == "| base |  |"


def test_sentences_in_files_are_a_line_each():
    assert LONG in terminal([Lines("", [LONG])])


def test_markdown():
    assert markdown(REPORT).splitlines() == [
        "# run four_bar",
        "",
        "**DISAGREE: somewhere**",
        "",
        "## figures",
        "",
        "| quantity | difference, m |",
        "|---|---:|",
        "| **model** | |",
        "| mass | **1.0e-03 > 1e-06** |",
        "| points | 1.0e-09 &lt; 1e-06 |",
        "| **energy** | |",
        "",
        "## notes",
        "",
        "- first",
        "- second",
    ]
    assert markdown(REPORT, folded=True).endswith("## versions\n\n- numpy 2\n")


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("1 < 2 <= 3", "1 < 2 <= 3"),
        ("without <plugin> 'lib.so' of gazebo", "without <plugin> 'lib.so' of gazebo"),
        ("<flag gravity='off'/> and </joint>", "<flag gravity='off'/> and </joint>"),
        ("run `crosscheck explain` | a_b [x] *y* _z_", "run crosscheck explain | a_b [x] *y* _z_"),
        ("a &lt; b \\ `c", "a &lt; b \\ `c"),
    ],
)
def test_markdown_shows_texts_unchanged_in_html(text, shown):
    markdown_package = pytest.importorskip("markdown")
    (*_, row) = markdown_table(Table("", [*text_columns("first", "second")], [["1", text]]))
    page = markdown_package.markdown(f"| a | b |\n|---|---|\n{row}\n", extensions=["tables"])
    cells = ElementTree.fromstring(page).iter("td")
    assert ["".join(cell.itertext()) for cell in cells] == ["1", shown]


def test_json_holds_data_report_and_files():
    files = {Path("folder") / "a.npz": b"abc"}
    content = json.loads(as_json({"worst": float("nan")}, REPORT, files), parse_constant=pytest.fail)
    digest = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"  # FIPS 180-2, appendix B.1
    assert (content["worst"], content["files"]) == ("nan", {"a.npz": digest})
    cell = {"text": "1.0e-03 > 1e-06", "verdict": "fails", "about": "crank"}
    assert content["report"]["parts"][0]["rows"][:2] == ["model", ["mass", cell]]


def test_junit_has_a_case_per_judged_row():
    root = ElementTree.fromstring(junit(REPORT))
    (suite,) = root
    assert (suite.get("name"), suite.get("tests"), suite.get("failures")) == ("figures", "2", "1")
    failed, passed = suite
    assert (failed.get("classname"), failed.get("name")) == ("figures.model", "mass")
    (failure,) = failed
    assert failure.get("message") == "model: mass: difference, m 1.0e-03 > 1e-06"
    assert failure.text == failure.get("message")  # GitLab shows the text, other servers the message
    assert list(passed) == []


def test_junit_skips_what_is_not_judged():
    rows = [
        ["a", Cell("1", "doubtful")],
        ["b", Cell("2", "doubtful"), Cell("3", "fails")],
        ["c", Cell("4", "holds")],
    ]
    table = Table("limits", text_columns("", "", ""), rows)
    (suite,) = ElementTree.fromstring(junit(Report("run", "", Cell(""), [table])))
    counts = {name: suite.get(name) for name in ("tests", "failures", "errors", "skipped")}
    assert counts == {"tests": "3", "failures": "1", "errors": "0", "skipped": "1"}
    assert [[element.tag for element in case] for case in suite] == [["skipped"], ["failure"], []]
    assert suite[0][0].get("message") == "a: 1"


def test_any_text_is_shown_as_it_is():
    odd = Report(ODD, ODD, Cell(ODD), [Table(ODD, text_columns(ODD, ODD), [ODD, [ODD, Cell(ODD, "fails")]])])
    root = ElementTree.fromstring(junit(odd))
    assert root[0][0].get("name") == ODD.replace("\x00", "\\x00")
    (line,) = [line for line in markdown(odd).splitlines() if line.startswith("| a") and "**" in line]
    assert line.replace("\\|", "").count("|") == 3
    assert ODD.replace("\x00", "\\x00") in terminal(odd.parts)


def test_units_follow_the_last_comma():
    assert [column.heading for column in number_columns("load, s", "ms")] == ["load, s", "ms"]
    assert [(column.name, column.unit) for column in number_columns("of mass, kg", "ms")] == [
        ("of mass", "kg"),
        ("ms", ""),
    ]


@pytest.mark.parametrize("width", [40, 60, 80])
def test_no_word_of_a_narrow_table_is_cut(width, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(width))
    names = ["relative: moving: angular acceleration, rad/s^2", "drift: joint acceleration of the loops"]
    rows = ["heading", *([name, "universal_47, x", "0.00300711086", "+2.31e+09"] for name in names)]
    text = terminal(
        [Table("moved", [*text_columns("figure", "where"), *number_columns("was", "tolerances")], rows)]
    )
    words = text.split()
    assert all(words.count(word) >= 1 for name in [*names, "0.00300711086"] for word in name.split())
    assert max(map(len, text.splitlines())) <= width


def test_entries_of_any_value():
    table = name_value_table("settings", {"a": [1, 2.5, None, "<"], "b": {"c": True, "d": 1.23456789}})
    assert table.rows == [["a", "1, 2.5, , <"], ["b", "c: True\nd: 1.23457"]]


ESCAPE = "a\x1b[31mb\u202ec\x07"
"""A name that would color what follows, turn it round, and ring."""


def terminal_of(report):
    return terminal([Table(report.title, [Column("")], []), *report.parts])


def page_of(report):
    return rendered("page.html", title=report.title, overall=None, index=[], entries=[PageEntry(report)])


@pytest.mark.parametrize("written", [terminal_of, markdown, junit, page_of], ids=lambda f: f.__name__)
def test_names_cannot_steer_a_terminal(written):
    table = Table(ESCAPE, [Column(ESCAPE), Column("x", numeric=True)], [ESCAPE, [ESCAPE, Cell("1", "fails")]])
    text = written(Report(ESCAPE, ESCAPE, Cell("DISAGREE", "fails"), [table, Lines(ESCAPE, [ESCAPE])]))
    assert not any(letter in text for letter in "\x1b\u202e\x07")
    shown = text.replace("\\\\", "\\").replace("\\[", "[").replace("&#39;", "'")
    assert "a\\x1b[31mb\\u202ec\\x07" in shown


def test_long_values_of_an_error_are_cut():
    line = shorten_words(f"--keep '{'x' * 5000}': no; {' '.join(['choice'] * 500)}; give another")
    assert len(line) < 620
    assert line.startswith("--keep 'xxx")
    assert line.endswith("give another")
    assert shorten_words(f"{'y' * 300}") == f"{'y' * 120}...{'y' * 30}"
    assert shorten_words("short: a b") == "short: a b"


def test_a_style_of_the_user_does_not_reach_pictures():
    errors = [0.0, 0.1], [0.0, 1e-9], [0.0, 1e-6], "log"
    plain = list(run_errors(*errors))
    changes = {"text.usetex": True, "font.size": 30, "axes.facecolor": "red", "savefig.dpi": 500}
    with matplotlib.rc_context(changes):
        styled = list(run_errors(*errors))
    assert styled == plain
