"""What holds for all pages: order, folded details, colors in light and dark, paper, and narrow screens."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
from html import escape
from pathlib import Path

import pytest
from pages import ORDER, Page

from crosscheck.report.chart import MAX_BARS, Measure, linear_chart, log_chart
from crosscheck.report.entry import PageEntry, Picture
from crosscheck.report.table import Cell, Column, Lines, Report, Table
from crosscheck.report.template import FOLDER, rendered

ROOT = Path(__file__).parents[3]
STYLE = (FOLDER / "style.css").read_text()
DARK = "@media screen and (prefers-color-scheme: dark)"
TEXT = ("ink", "quiet", "holds", "doubtful", "fails")
BARS = ("bar", "bar-holds", "bar-doubtful", "bar-fails")
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), "")


def page(folder: Path) -> Path:
    """Write the page of a result that has all kinds of parts, and a table that is wider than a phone."""
    wide = Table("all numbers", [Column(f"quantity {k}", "m", True) for k in range(20)], [["1.2e-05"] * 20])
    word = Table("", [Column("name"), Column("text")], [["x" * 200, "y" * 200]])
    report = Report(
        "a study of " + "z" * 100,
        "AGREE: " + "w" * 200,
        Cell("AGREE", "holds"),
        [wide, Lines("", ["a note"])],
        wall_time=1.0,
        summary=[word, Lines("", ["your settings  OFF BY 2 mm", "more"], verdict="doubtful")],
        charts=linear_chart("Times", "less is faster", [Measure("v" * 60, 1.0, "1 s", mark=1.0)]),
        next_steps=["Run `crosscheck " + "q" * 100 + "`."],
    )
    picture = Picture(b"\x89PNG", "a picture")
    entry = PageEntry(report, charts=report.charts, pictures=[picture], plots=[picture])
    path = folder / "report.html"
    path.write_text(rendered("page.html", title="study", overall=None, index=[], entries=[entry]))
    return path


def test_answer_picture_what_to_do_and_folded_details(tmp_path: Path) -> None:
    found = Page(page(tmp_path))
    assert found.parts == [list(ORDER)]
    assert found.words.index("OFF BY 2 mm") < found.words.index("What to do")
    text = (tmp_path / "report.html").read_text()
    titles = re.findall("<summary>(.*?)</summary>", text)
    assert titles == ["Results", "all numbers", "Plots over time"]
    assert f"<code>crosscheck {'q' * 100}</code>" in text


def test_every_report_of_a_command_has_a_next_step() -> None:
    calls = {
        f"{path.name}:{node.lineno}": {keyword.arg for keyword in node.keywords}
        for path in (ROOT / "crosscheck").rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Report"
    }
    assert len(calls) > 15
    assert [place for place, names in calls.items() if "next_steps" not in names] == []


def colors(block: str) -> dict[str, str]:
    """Return the variables of a block of the style by name."""
    return dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6});", block))


def luminance(color: str) -> float:
    """Relative luminance of a color, by WCAG 2.2."""
    parts = [int(color[k : k + 2], 16) / 255.0 for k in (1, 3, 5)]
    red, green, blue = (x / 12.92 if x <= 0.04045 else ((x + 0.055) / 1.055) ** 2.4 for x in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def contrast(first: str, second: str) -> float:
    """Contrast of two colors, from 1 to 21, by WCAG 2.2."""
    dark, light = sorted((luminance(first), luminance(second)))
    return (light + 0.05) / (dark + 0.05)


def test_texts_are_legible_in_light_and_dark() -> None:
    """4.5 is WCAG's limit for text, 3 that for graphics."""
    light, _, rest = STYLE.partition(DARK)
    sets = colors(light), colors(rest.partition("* {")[0])
    assert sets[0].keys() == sets[1].keys()
    for found in sets:
        for ground in ("ground", "panel"):
            assert all(contrast(found[name], found[ground]) >= 4.5 for name in TEXT)
            assert all(contrast(found[name], found[ground]) > 3.0 for name in BARS)


def test_colors_outside_of_the_sets_are_variables() -> None:
    """So that dark mode has none of the light colors; pictures keep their white ground."""
    _, _, rules = STYLE.partition(DARK)[2].partition("* {")
    assert re.findall("#[0-9a-f]{3,6}", rules) == ["#ffffff"]


def test_a_logarithmic_chart_covers_its_marks() -> None:
    measures = [Measure("one", 0.5, "0.5 %", mark=100.0), Measure("none", 0.0, "0 %")]
    (chart,) = log_chart("title", "caption", measures, "%")
    assert chart.caption == "caption; logarithmic from 0.1 % to 100 %"
    # log10(0.5) is -0.301, on an axis from -1 to 2
    assert chart.bars[0].length == pytest.approx(100.0 * 0.699 / 3.0, abs=0.05)
    assert (chart.bars[0].mark, chart.bars[1].length) == (100.0, 0.0)
    assert log_chart("title", "caption", measures[1:]) == []


def test_a_chart_has_a_limited_number_of_bars() -> None:
    (chart,) = linear_chart("title", "caption", [Measure(str(k), k, str(k)) for k in range(2 * MAX_BARS)])
    assert [bar.length for bar in chart.bars[::11]] == [0.0, 100.0]
    assert chart.caption.endswith(f"; the first {MAX_BARS} of {2 * MAX_BARS}")


@pytest.mark.slow  # a browser
@pytest.mark.skipif(not CHROMIUM, reason="needs Chromium")
def test_a_phone_shows_the_page_without_scrolling_it(tmp_path: Path) -> None:
    """The width of the content in a frame of 390 pixels, with all details open."""
    text = page(tmp_path).read_text().replace("<details>", "<details open>")
    measure = "document.title = f.contentDocument.documentElement.scrollWidth"
    frame = f'<iframe id="f" width="390" height="800" frameborder="0" srcdoc="{escape(text)}"></iframe>'
    (tmp_path / "frame.html").write_text(f"{frame}<script>f.onload = () => {{ {measure} }}</script>")
    command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path}/profile"]
    command += ["--virtual-time-budget=2000", "--dump-dom", (tmp_path / "frame.html").as_uri()]
    printed = subprocess.run(command, check=True, capture_output=True, text=True, timeout=120).stdout
    (width,) = re.findall("<title>(.*?)</title>", printed)
    assert int(width) <= 390
