"""Pictures of the documentation: each is of what is printed, laid out and drawn today."""

from __future__ import annotations

import io
import json
import re
from contextlib import redirect_stdout
from pathlib import Path

import moving_picture
import pytest
from command_plots import PLOTS, plot_command
from guide_plots import GUIDE_PLOTS, guide_content
from pictures import (
    IMAGES,
    MADE_FROM,
    NOTEBOOK,
    PAGES,
    PAPER,
    ROOT,
    SCENES,
    STALE,
    WIDGET,
    WIDTHS,
    WRONG,
    digest,
    figure_content,
    made_from,
    notebook_content,
    page_words,
    shown,
    verdict_words,
    words,
    wrong_engine,
)
from result_plots import RESULT_PLOTS, result_content
from theory_plots import THEORY_PLOTS, theory_content

from crosscheck.cli import main
from crosscheck.engines.registry import ENGINES
from crosscheck.report.page import write_report

LARGEST, LARGEST_OF_ALL = 150_000, 2_000_000
"""Bytes of a picture and of all, which every clone of the repository has."""


def printed(folder: Path, scene: str, patch: pytest.MonkeyPatch, status: int = 0) -> str:
    """What a run of a scene prints on 80 columns, its results in a folder."""
    patch.setenv("COLUMNS", "80")
    patch.chdir(folder)
    said = io.StringIO()
    with redirect_stdout(said), pytest.raises(SystemExit) as ended:
        main(["run", scene])
    assert (ended.value.code or 0) == status
    return said.getvalue()


@pytest.fixture(scope="module")
def tracker(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    """What a run of the tracker prints, and its folder."""
    folder = tmp_path_factory.mktemp("pictures")
    with pytest.MonkeyPatch.context() as patch:
        return printed(folder, "tracker", patch), folder / "output" / "tracker"


def test_a_run_is_told_in_25_lines_of_80_columns(tracker):
    lines = tracker[0].splitlines()
    assert (len(lines) <= 25, max(map(len, lines)) <= 80) == (True, True), tracker[0]


@pytest.mark.parametrize("picture", WIDTHS)
def test_the_terminal(tracker, picture):
    assert made_from(f"{picture}.svg") == digest(words(tracker[0])), f"{picture}.svg {STALE}"


@pytest.mark.parametrize("scene", SCENES)
def test_recordings(tracker, scene):
    pane = verdict_words(tracker[1] / "tracker.rrd")
    assert made_from(f"{scene}.png") == digest(shown(scene) + pane), f"{scene}.png {STALE}"


def test_the_page(tracker, monkeypatch):
    taken = lambda rrd, moments, view: [b""] * len(moments)  # noqa: E731
    monkeypatch.setattr("crosscheck.recording.screenshot.screenshots", taken)
    page = write_report(tracker[1], lambda _: None).path
    for picture in PAGES:
        assert made_from(f"{picture}.png") == digest(page_words(page.read_text())), f"{picture}.png {STALE}"


def test_the_notebook():
    content = digest(notebook_content())
    assert json.loads(NOTEBOOK.read_text())["metadata"].get(MADE_FROM) == content, f"{NOTEBOOK.name} {STALE}"
    assert made_from("notebook.png") == content, f"notebook.png {STALE}"


@pytest.mark.slow  # a kernel of its own, three engines
def test_the_notebook_runs(tmp_path):
    formats, clients = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    book = formats.read(NOTEBOOK, as_version=4)
    clients.NotebookClient(book, resources={"metadata": {"path": tmp_path}}).execute()
    outputs = [output for cell in book.cells for output in cell.get("outputs", ())]
    shown = [data for output in outputs for data in output.get("data", ())]  # printed text has none
    assert shown.count("text/html") == 2
    assert "image/png" in shown
    assert WIDGET in shown


@pytest.mark.slow  # three engines, and a diagnosis; tests/test_snapshots.py has the words
def test_the_disagreement(tmp_path, monkeypatch):
    monkeypatch.setitem(ENGINES, "mujoco", wrong_engine())
    content = digest(words(printed(tmp_path, WRONG[0], monkeypatch, status=1)))
    for picture in ("disagree.svg", "disagree.png"):
        assert made_from(picture) == content, f"{picture} {STALE}"


@pytest.mark.parametrize(("name", "plot"), PLOTS.items())
def test_plots_of_commands(name, plot):
    assert made_from(f"{name}.png") == digest(plot_command(plot)), f"{name}.png {STALE}"


def test_the_moving_picture():
    picture = moving_picture.FILE
    assert made_from(picture) == digest(moving_picture.content()), f"{picture} {STALE}"


def test_figures_of_the_paper():
    run = shown("tracker")
    for number, name in PAPER.items():
        assert made_from(f"{name}.png") == digest(figure_content(number, run)), f"{name}.png {STALE}"


@pytest.mark.parametrize("name", THEORY_PLOTS)
def test_plots_of_theory(name):
    assert made_from(f"{name}.png") == digest(theory_content(name)), f"{name}.png {STALE}"


@pytest.mark.parametrize("name", RESULT_PLOTS)
def test_plots_of_results(name):
    assert made_from(f"{name}.png") == digest(result_content(name)), f"{name}.png {STALE}"


@pytest.mark.parametrize("name", GUIDE_PLOTS)
def test_plots_of_guides(name):
    assert made_from(f"{name}.png") == digest(guide_content(name)), f"{name}.png {STALE}"


def test_all_pictures_are_shown_and_small():
    files = {path.name: path.stat().st_size for path in IMAGES.iterdir()}
    pages = [ROOT / "README.md", *ROOT.glob("docs/**/*.md")]
    link = re.compile(r"\]\([^)]*images/([^)]*)\)")
    named = {name for page in pages for name in link.findall(page.read_text())}
    assert named == files.keys()
    assert all(made_from(name) for name in files)
    assert max(files.values()) < LARGEST
    assert sum(files.values()) < LARGEST_OF_ALL


def test_words_are_those_of_any_processor():
    said = (
        "5 s, 501 outputs\nmodel  28 ok  1e-14  2 %  panel_7\nmujoco 164 ms  RK4 1 ms\nAMD, 2 cores\n 1 2\n"
    )
    assert words(said) == "#, # outputs model # ok mujoco # RK# #"
    said = "error of 1e-3  1e-5\nmujoco  1  2  3,000  -\nmujoco for 1e-6: RK4,\n  step 0.1\nand more"
    assert words(said) == "error of # # mujoco mujoco for #: and more"
