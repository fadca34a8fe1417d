"""Results as one page: what is on it, that it needs nothing else, and what it refuses."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from command_line import run, scene_file, short_example
from pages import Page

from crosscheck.cli import main
from crosscheck.compare.check import CONSTRAINT_VIOLATION, POSES
from crosscheck.library import SCENES
from crosscheck.report.entry import key_times
from crosscheck.report.page import MAX_FOLDERS_IN_FULL, PAGE, write_report
from crosscheck.report.plots import pictures
from crosscheck.report.table import Column, Table, checked_cell
from crosscheck.support.checksum import with_checksum
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.results import digest
from newton_euler.model.trajectory import load_arrays

ENGINES = ["newton_euler", "pinocchio"]
PNG = b"\x89PNG\r\n\x1a\n"
EVIL = "</table><script>alert('1')</script>\"&"


DRIVER_MESSAGE = "Vulkan EGL_NOT_INITIALIZED libGL wgpu panicked Traceback"

DIFFERENCE = "difference from newton_euler, largest over the bodies; thin lines are tolerances"
DIFFERENCES = [f"{quantity}: {DIFFERENCE}" for quantity in POSES]
DRIFT = f"{CONSTRAINT_VIOLATION}: drift, largest over the joints; thin lines are tolerances"
ENERGIES = [f"{name}, J: energy" for name in ("kinetic", "potential", "work done by what has no potential")]


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    """The folder of a short run of two engines."""
    folder = tmp_path_factory.mktemp("finished")
    path = scene_file(folder, short_example(), "four_bar.yaml")
    with pytest.raises(SystemExit) as ended:
        main(["run", str(path), "--engines", ",".join(ENGINES), "--output", str(folder / "four_bar")])
    assert not ended.value.code
    return folder / "four_bar"


@pytest.fixture
def folder(finished, tmp_path, monkeypatch) -> Path:
    """A copy of it, where no viewer runs."""

    def no_driver(*_):
        raise CrosscheckError(DRIVER_MESSAGE)

    monkeypatch.setattr("crosscheck.recording.screenshot.screenshots", no_driver)
    return Path(shutil.copytree(finished, tmp_path / "four_bar"))


@pytest.fixture
def bare(folder) -> Path:
    """A summary of nothing beside it: nothing is drawn."""
    for path in (*folder.glob("*.npz"), *folder.glob("*.rrd")):
        path.unlink()
    change(folder, files={})
    return folder


def change(folder: Path, **changes: object) -> dict:
    """Rewrite entries of a folder's summary."""
    path = folder / "summary.json"
    summary = json.loads(path.read_text()) | changes
    path.write_text(json.dumps(with_checksum(summary)))
    return summary


def vouch(folder: Path, name: str) -> None:
    """Have the summary say that a file is its own."""
    files = json.loads((folder / "summary.json").read_text())["files"]
    change(folder, files=files | {name: digest(folder / name)})


def write(path: Path, **changes: object) -> None:
    """Write a file of results whose report has these entries."""
    whole = {"title": "a study", "verdict": "", "judged": {"text": ""}, "parts": []} | changes
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(with_checksum({"report": whole, "files": {}})))


def report(folder: Path) -> Page:
    return Page(write_report(folder, lambda _: None).path)


def test_a_page_holds_what_a_run_found(folder, capsys):
    status, out, err = run(capsys, "report", folder)
    assert (status, out) == (0, f"wrote {folder / PAGE}\n")
    assert err == f"note: the page has no 3-D pictures of four_bar.rrd: {DRIVER_MESSAGE}\n"
    found, summary = Page(folder / PAGE), json.loads((folder / "summary.json").read_text())
    word, _, rest = summary["verdict"].partition(": ")
    assert {word, *found.text} == {*found.text}
    assert rest in found.words
    for figure in summary["checks"]:
        assert figure["level"] in found.words
        assert figure["quantity"] in found.words
        assert f"{figure['value']:.1e}" in found.words
    for package, version in summary["versions"].items():
        assert package in found.words
        assert version in found.words
    assert "DOP853" in found.words
    assert list(found.images) == [*DIFFERENCES, DRIFT, *ENERGIES]
    assert all(content.startswith(PNG) and len(content) > 5000 for content in found.images.values())
    assert {path.name for path in folder.iterdir()} == {
        *(f"{engine}.npz" for engine in ENGINES),
        "summary.json",
        "junit.xml",
        "four_bar.rrd",
        PAGE,
    }


def test_pictures_by_the_viewer_where_it_runs(folder, monkeypatch):
    words = report(folder).words
    assert not [word for word in DRIVER_MESSAGE.split() if word in words]
    assert "crosscheck view four_bar.rrd" in words
    taken = lambda rrd, moments, view: [PNG + str(moment).encode() for moment in moments]  # noqa: E731
    monkeypatch.setattr("crosscheck.recording.screenshot.screenshots", taken)
    first, middle, last, *_ = report(folder).images
    assert (first, last) == ("four_bar at 0 s", "four_bar at 0.05 s")
    assert middle not in (first, last)


def test_a_motion_is_told_by_its_start_its_end_and_what_is_farthest_from_both():
    time, along = np.arange(5.0), np.array([0.0, 3.0, 2.0, 1.0, 1.0])
    position = along[:, None, None] * [[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]]
    assert key_times({"time": time, "position": position}) == [0.0, 1.0, 4.0]
    assert key_times({"time": time, "position": 0.0 * position}) == [0.0, 2.0, 4.0]


def test_what_is_zero_throughout_is_not_drawn():
    time, poses = np.arange(2.0), {"position": np.zeros((2, 1, 3)), "quaternion": np.ones((2, 1, 4))}
    energies = {"kinetic_energy": time, "potential_energy": 0.0 * time}
    drawn = pictures({"one": {"time": time, **poses, **energies}}, {})
    assert [caption for _, caption in drawn] == ["kinetic, J: energy"]


def test_texts_are_texts(tmp_path):
    column = {"name": EVIL, "unit": EVIL, "numeric": True}
    rows = [EVIL, [EVIL, {"text": EVIL, "verdict": "fails", "about": EVIL}]]
    table = {"title": EVIL, "columns": [column, column], "rows": rows}
    parts = [table, table | {"folded": True}, {"title": EVIL, "lines": [EVIL]}]
    write(tmp_path / "summary.json", title=EVIL, verdict=EVIL, judged={"text": EVIL}, parts=parts)
    found = report(tmp_path)
    assert "script" not in found.seen
    assert found.words.count(EVIL) == 20


@pytest.mark.parametrize("verdict", ['holds" onload="alert(1)', "other", 1])
def test_a_cell_is_judged_in_one_of_four_ways(tmp_path, verdict):
    write(tmp_path / "summary.json", judged={"text": "", "verdict": verdict})
    with pytest.raises(CrosscheckError, match=r"summary.json: report.judged.verdict: Input should be ''"):
        report(tmp_path)


def test_a_disagreement_is_found_at_a_glance(tmp_path):
    failing = checked_cell(0.125, 1e-12, False, "worst at the crank")
    table = Table("", [Column("engine"), Column("mass", "kg", True)], [["mujoco", failing]])
    word = {"text": "FAILS", "verdict": "fails"}
    write(tmp_path / "summary.json", verdict="DISAGREE: somewhere", judged=word, parts=[asdict(table)])
    text = (tmp_path / PAGE).read_text() if report(tmp_path) else ""
    assert '<div class="answer fails"><b>DISAGREE</b><span>somewhere</span></div>' in text
    assert '<th scope="col" class="number">mass, kg</th>' in text
    assert '<td class="number fails" title="worst at the crank">1.2e-01 &gt; 1e-12</td>' in text


@pytest.mark.parametrize("name", ["pinocchio.npz", "four_bar.rrd"])
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda path: None, "missing, summary.json beside it was written with it; run it again"),
        (os.mkfifo, "not a regular file"),
        (lambda path: path.symlink_to("/dev/zero"), "not a regular file"),
        (lambda path: path.symlink_to("nowhere"), "cannot be read: No such file or directory"),
        (Path.mkdir, "not a regular file"),
    ],
)
def test_what_a_run_wrote_is_there(folder, capsys, name, make, message):
    (folder / name).unlink()
    make(folder / name)
    status, out, err = run(capsys, "report", folder)
    assert (status, out, err) == (2, "", f"crosscheck: error: {folder / name}: {message}\n")
    assert not (folder / PAGE).exists()


def test_a_recording_elsewhere_is_no_part_of_the_page(tmp_path, capsys):
    path = scene_file(tmp_path, short_example())
    options = ("--engines", "newton_euler", "--output", tmp_path / "out", "--save", tmp_path / "there.rrd")
    assert run(capsys, "run", path, *options)[0] == 0
    assert set(json.loads((tmp_path / "out" / "summary.json").read_text())["files"]) == {"newton_euler.npz"}
    assert DRIFT in report(tmp_path / "out").images


def test_a_recording_that_is_none(folder):
    (folder / "four_bar.rrd").write_bytes(b"RRF2 and no more")
    vouch(folder, "four_bar.rrd")
    files = json.loads((folder / "summary.json").read_text())["files"]
    change(folder, files={name: known for name, known in files.items() if name != "pinocchio.npz"})
    (missing,) = write_report(folder, lambda _: None).missing
    assert missing.startswith("the page has no 3-D pictures of four_bar.rrd: ")
    found = Page(folder / PAGE)
    assert not {"four_bar at 0 s"} & found.images.keys()
    assert DRIFT in found.images
    assert not {*DIFFERENCES} & found.images.keys()


def test_the_library_on_one_page(bare, tmp_path):
    library = tmp_path / "library"
    for name in ("one", "two"):
        shutil.copytree(bare, library / name)
    word = {"text": "FAILS", "verdict": "fails"}
    write(library / "two" / "summary.json", verdict="DISAGREE: as it were", judged=word)
    (library / "notes").mkdir()
    found = report(library)
    assert found.links == {"folder-one", "folder-two"} <= found.anchors
    assert {"AGREE", "FAILS"} <= set(found.text)
    assert found.words.count("as it were") == 2  # in the index and below
    assert [path.name for path in library.rglob(PAGE)] == [PAGE]


def test_all_below_the_usual_folder_on_one_page(bare, tmp_path):
    """Folders of scenes, and folders of folders of them, as `output` holds them."""
    output = tmp_path / "output"
    shutil.copytree(bare, output / "four_bar")
    for name in ("bench/one", "bench/two"):
        write(output / name / "rhs.json", parts=[{"title": "", "lines": [f"{name} is quick"]}])
    found = report(output)
    assert found.links == {"folder-four_bar", "folder-bench/one", "folder-bench/two"} <= found.anchors
    assert "bench/two is quick" in found.words


def test_of_many_folders_an_index(bare, tmp_path, capsys):
    """Verdicts, and what writes the pages; nothing is drawn, even of what has runs."""
    output = tmp_path / "many runs"
    for number in range(MAX_FOLDERS_IN_FULL + 1):
        shutil.copytree(bare, output / f"run_{number}")
    write(output / "run_3" / "summary.json", verdict="DISAGREE: as it were")
    found = report(output)
    assert found.links == set()
    assert found.words.count("as it were") == 1
    assert found.text.count("AGREE") == MAX_FOLDERS_IN_FULL
    for number in range(MAX_FOLDERS_IN_FULL + 1):
        assert f"crosscheck report '{output / f'run_{number}'}'" in found.text
    shutil.rmtree(output / "run_3")
    assert len(report(output).links) == MAX_FOLDERS_IN_FULL
    assert len(SCENES) <= MAX_FOLDERS_IN_FULL  # so that `run --all` has one page


def test_progress_counts_the_folders(folder, tmp_path, monkeypatch):
    for name in ("one", "two"):
        shutil.copytree(folder, tmp_path / "library" / name)
    said: list[str] = []
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", lambda _, stream, **__: stream.write(PNG))
    write_report(tmp_path / "library", said.append)
    assert said == [
        f"{number} of 2 folders, {what}"
        for number in (1, 2)
        for what in ("four_bar: pictures of the recording", "plots")
    ]


def timed(seconds: str) -> bytes:
    """Results that took this long."""
    return (
        b'{"report": {"title": "", "verdict": "", "judged": {"text": ""}, "parts": [], "wall_time": %s}, '
        % (seconds.encode())
        + b'"files": {}, "sha256": ""}'
    )


def listed(name: str) -> bytes:
    """Results with a file of this name beside them."""
    return json.dumps(with_checksum(json.loads(timed("1")) | {"files": {name: "00"}})).encode()


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("summary.json", b"{", "file: Invalid JSON: "),
        ("summary.json", b"\xff", "file: Invalid JSON: "),
        ("summary.json", b"[" * 100_000, "file: Invalid JSON: "),
        ("summary.json", b"{}", "summary.json: report: Field required"),
        ("summary.json", b"[]", "summary.json: file: "),
        ("bench.json", b"3", "bench.json: file: "),
        ("faults.json", b"{}", "faults.json: report: Field required"),
        ("regress.json", b'{"report": 1, "files": {}}', "regress.json: report: Input should be"),
        ("stress.json", b'{"report": {"title": "x"}}', "stress.json: report.verdict: Field required"),
        ("rhs.json", timed("NaN"), "rhs.json: report: wall_time is no time in seconds"),
        ("rhs.json", timed("-1"), "rhs.json: report: wall_time is no time in seconds"),
        ("rhs.json", timed("1e999"), "rhs.json: report: wall_time is no time in seconds"),
        ("rhs.json", listed("../x.npz"), "rhs.json: files: '../x.npz' is no name of a file"),
        ("rhs.json", listed("x.npz"), "x.npz: missing, rhs.json beside it"),
        ("rhs.json", timed("1"), "rhs.json: sha256: does not fit the other fields"),
        ("rhs.json", timed("1").replace(b', "sha256": ""', b""), "rhs.json: sha256: Field required"),
    ],
)
def test_what_cannot_be_read_is_one_line(bare, capsys, name, content, message):
    (bare / name).write_bytes(content)
    status, out, err = run(capsys, "report", bare)
    assert (status, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert message in err
    assert not (bare / PAGE).exists()


def test_folders_without_results(tmp_path, capsys):
    (tmp_path / "deep" / "deeper" / "deepest").mkdir(parents=True)
    (tmp_path / "deep" / "deeper" / "deepest" / "rhs.json").write_text("{}")
    for target, message in (("absent", "is no folder"), (".", "nothing of crosscheck's in ")):
        status, out, err = run(capsys, "report", tmp_path / target)
        assert (status, out) == (2, "")
        assert message in err
        assert len(err.splitlines()) == 1


def test_a_run_of_other_arrays(folder, capsys):
    """Even if the summary says that they are its own."""
    path = folder / "pinocchio.npz"
    whole = load_arrays(path)
    for changes, message in (
        ({"quaternion": None}, "no array 'quaternion'"),
        ({"position": whole["position"][:, :-1]}, "position has shape (6, 3, 3); needed: (6, 4, 3)"),
        ({name: whole[name][:, :2] for name in ("position", "quaternion")}, "(6, 2, 3); needed: (6, 4, 3)"),
    ):
        np.savez(path, **{name: array for name, array in (whole | changes).items() if array is not None})
        vouch(folder, path.name)
        status, _, err = run(capsys, "report", folder)
        assert status == 2
        assert err.startswith(f"crosscheck: error: {path}: holds no trajectory: ")
        assert err.endswith(f"{message}\n")
