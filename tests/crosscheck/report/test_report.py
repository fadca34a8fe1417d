"""Results as one page: what is on it, that it needs nothing else, and what it refuses."""

from __future__ import annotations

import base64
import json
import shutil
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from command_line import run, scene_file, short_example

from crosscheck.cli import main
from crosscheck.errors import CrosscheckError
from crosscheck.report.html import drawing, page
from crosscheck.report.html.report import MOST_IN_FULL, PAGE, write_report
from crosscheck.results import digest
from crosscheck.scenes import SCENES
from newton_euler.model.trajectory import load_arrays

ENGINES = ["newton_euler", "pinocchio"]
VOID = {"meta", "br", "img"}
PNG = b"\x89PNG\r\n\x1a\n"
MEASURED = {"source": "tracker", "options": {}, "machine": {}}
EVIL = "</table><script>alert('1')</script>\"&"


class Page(HTMLParser):
    """A page taken apart; fails where tags are not nested, or where something would be fetched."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.seen: set[str] = set()
        self.text: list[str] = []
        self.images: dict[str, bytes] = {}
        self.anchors: set[str] = set()
        self.links: set[str] = set()
        self.feed(path.read_text(encoding="utf-8"))
        self.close()
        assert self.tags == []

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        self.seen.add(tag)
        if tag not in VOID:
            self.tags.append(tag)
        if "id" in attributes:
            self.anchors.add(attributes["id"])
        assert not {"srcset", "background", "action", "data"} & attributes.keys()
        if "src" in attributes:
            kind, _, content = attributes["src"].partition("base64,")
            assert (tag, kind) == ("img", "data:image/png;")
            self.images[attributes["alt"]] = base64.b64decode(content, validate=True)
        if "href" in attributes:
            assert tag == "a"
            assert attributes["href"].startswith("#")
            self.links.add(attributes["href"][1:])

    def handle_endtag(self, tag):
        assert self.tags.pop() == tag

    def handle_data(self, data):
        if self.tags and self.tags[-1] != "style":
            self.text.append(data)

    @property
    def words(self) -> str:
        return "\n".join(self.text)


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    """The folder of a short run of two engines."""
    folder = tmp_path_factory.mktemp("finished")
    path = scene_file(folder, short_example())
    with pytest.raises(SystemExit) as ended:
        main(["run", str(path), "--engines", ",".join(ENGINES), "--output", str(folder / "four_bar")])
    assert not ended.value.code
    return folder / "four_bar"


@pytest.fixture
def folder(finished, tmp_path, monkeypatch) -> Path:
    """A copy of it, where no viewer runs."""

    def no_driver(*_):
        raise CrosscheckError("no Vulkan driver")

    monkeypatch.setattr("crosscheck.recording.screenshot.screenshots", no_driver)
    return Path(shutil.copytree(finished, tmp_path / "four_bar"))


@pytest.fixture
def bare(folder) -> Path:
    """Its summary alone: nothing is drawn."""
    for path in (*folder.glob("*.npz"), *folder.glob("*.rrd")):
        path.unlink()
    return folder


def change(folder: Path, **changes: object) -> dict:
    """Rewrite entries of a folder's summary."""
    path = folder / "summary.json"
    summary = json.loads(path.read_text()) | changes
    path.write_text(json.dumps(summary))
    return summary


def vouch(folder: Path, name: str) -> None:
    """Have the summary say that a file is its own."""
    files = json.loads((folder / "summary.json").read_text())["files"]
    change(folder, files=files | {name: digest(folder / name)})


def report(folder: Path) -> Page:
    return Page(write_report(folder, lambda _: None))


def test_a_page_holds_what_a_run_found(folder, capsys):
    status, out, err = run(capsys, "report", folder)
    assert (status, out, err) == (0, f"wrote {folder / PAGE}\n", "")
    found, summary = Page(folder / PAGE), json.loads((folder / "summary.json").read_text())
    assert summary["verdict"] in found.words
    for figure in summary["figures"]:
        assert figure["level"] in found.words
        assert figure["quantity"] in found.words
        assert f"{figure['value']:.1e}" in found.words
    for package, version in summary["versions"].items():
        assert package in found.words
        assert version in found.words
    assert "DOP853" in found.words
    assert list(found.images) == [
        "The mechanism at 0, 0.025, 0.05 s, by newton_euler",
        "Difference from newton_euler, largest over the bodies",
        "Drift: how far joints are open",
        "Energy",
        "Energy balance",
        "Centre of mass of crank",
        "Centre of mass of coupler",
        "Centre of mass of rocker",
        "Control",
    ]
    assert all(content.startswith(PNG) and len(content) > 5000 for content in found.images.values())
    assert {path.name for path in folder.iterdir()} == {
        *(f"{engine}.npz" for engine in ENGINES),
        "summary.json",
        "four_bar.rrd",
        PAGE,
    }


def test_pictures_by_the_viewer_where_it_runs(folder, monkeypatch):
    taken = lambda rrd, moments: [PNG + str(moment).encode() for moment in moments]  # noqa: E731
    monkeypatch.setattr("crosscheck.recording.screenshot.screenshots", taken)
    pictures = list(drawing.views(folder / "four_bar.rrd", "pinocchio", (0.0, 0.5, 1.0)))
    assert [caption for _, caption in pictures] == [f"The recording at {t} s" for t in ("0", "0.025", "0.05")]


def test_texts_are_texts(bare):
    figures = json.loads((bare / "summary.json").read_text())["figures"]
    texts = {"verdict": EVIL, "source": EVIL, "options": {EVIL: EVIL}, "left_out": {EVIL: EVIL}}
    texts |= {"mapping": [{"element": EVIL, "fate": EVIL, "how": EVIL}], "start": [EVIL], "scene": EVIL}
    texts |= {"advice": [{"topic": EVIL, "text": EVIL}], "versions": {EVIL: EVIL}}
    wrong = dict.fromkeys(("level", "quantity", "where"), EVIL)
    wrong |= {"between": [EVIL], "value": 1.0, "tolerance": 0.5, "informs": False, "agrees": False}
    engines = {EVIL: {"settings": {EVIL: EVIL}, "wall_time": 1.0}}
    change(bare, figures=[*figures, wrong], engines=engines, **texts)
    found = report(bare)
    assert "script" not in found.seen
    assert found.words.count(EVIL) >= 18


def test_a_disagreement_is_found_at_a_glance(bare):
    summary = json.loads((bare / "summary.json").read_text())
    summary["figures"][0] |= {"value": 0.125, "agrees": False, "where": "the crank"}
    change(bare, figures=summary["figures"], agrees=False, verdict="DISAGREE: somewhere")
    text = (bare / PAGE).read_text() if report(bare) else ""
    assert '<p class="verdict fails">DISAGREE: somewhere (' in text
    assert "Where they part" in text
    assert '<td class="figure fails" title="worst at the crank">1.2e-01 &gt; 1e-12</td>' in text


def test_reference_mapping_and_advice(bare):
    known = {"engine": "pinocchio", "quantity": "height", "unit": "m", "time": 1.0, "value": 0.25}
    known |= {"reference": 0.5, "difference": 0.25, "allowed": 0.1, "agrees": False}
    mapping = [{"element": "geom 'g'", "fate": "left out", "how": "no contacts"}]
    advice = [{"topic": "solref", "text": "a time constant of 2 ms"}]
    change(bare, known_figures=[known], mapping=mapping, start=["starts from home"], advice=advice)
    words = report(bare).words
    for text in (
        "height, m",
        "2.5e-01 > 1e-01",
        "geom 'g'",
        "no contacts",
        "left out: 1",
        "starts from home",
    ):
        assert text in words
    assert "a time constant of 2 ms" in words


def test_without_runs(bare):
    found = report(bare)
    assert found.images == {}
    assert "The runs are not in the folder" in found.words


def test_a_recording_that_is_none(folder):
    (folder / "four_bar.rrd").write_bytes(b"RRF2 and no more")
    vouch(folder, "four_bar.rrd")
    (folder / "pinocchio.npz").unlink()
    found = report(folder)
    assert "No picture of the mechanism: " in found.words
    assert "Drift: how far joints are open" in found.images
    assert "Difference from newton_euler, largest over the bodies" not in found.images


def test_the_library_on_one_page(bare, tmp_path):
    library = tmp_path / "library"
    for name in ("one", "two"):
        shutil.copytree(bare, library / name)
    change(library / "two", agrees=False, verdict="DISAGREE: as it were")
    (library / "notes").mkdir()
    found = report(library)
    assert found.links == {"folder-one", "folder-two"} <= found.anchors
    assert {"AGREE", "FAILS"} <= set(found.text)
    assert found.words.count("DISAGREE: as it were") == 2  # in the index and below
    assert [path.name for path in library.rglob(PAGE)] == [PAGE]


def test_all_below_the_usual_folder_on_one_page(bare, tmp_path):
    """Folders of scenes, and folders of folders of them, as `output` holds them."""
    output = tmp_path / "output"
    shutil.copytree(bare, output / "four_bar")
    for name in ("bench/one", "bench/two"):
        (output / name).mkdir(parents=True)
        (output / name / "rhs.json").write_text(
            json.dumps(MEASURED | {"right_hand_sides": [], "words": [f"{name} is quick"]})
        )
    found = report(output)
    assert found.links == {"folder-four_bar", "folder-bench/one", "folder-bench/two"} <= found.anchors
    assert "bench/two is quick" in found.words


def test_of_many_folders_an_index(bare, tmp_path, capsys):
    """Verdicts, and what writes the pages; nothing is drawn, even of what has runs."""
    output = tmp_path / "many runs"
    for number in range(MOST_IN_FULL + 1):
        shutil.copytree(bare, output / f"run_{number}")
    change(output / "run_3", agrees=False, verdict="DISAGREE: as it were")
    found = report(output)
    assert found.links == set()
    assert found.words.count("DISAGREE: as it were") == 1
    assert found.text.count("AGREE") == MOST_IN_FULL
    for number in range(MOST_IN_FULL + 1):
        assert f"crosscheck report '{output / f'run_{number}'}'" in found.text
    assert "The runs are not in the folder" not in found.words
    shutil.rmtree(output / "run_3")
    assert len(report(output).links) == MOST_IN_FULL
    assert len(SCENES) <= MOST_IN_FULL  # so that `run --all` has one page


def test_progress_counts_the_folders(folder, tmp_path):
    for name in ("one", "two"):
        shutil.copytree(folder, tmp_path / "library" / name)
    said: list[str] = []
    write_report(tmp_path / "library", said.append)
    assert said == [
        f"{number} of 2 folders, four_bar: {what}"
        for number in (1, 2)
        for what in ("pictures of the recording", "plots")
    ]


def two_models() -> list[dict]:
    """As `run --against` writes them."""
    mapping = [{"element": "geom 'shell'", "fate": "left out", "how": "no contacts"}]
    plain = {"name": "plain", "source": "tracker", "options": {}, "mapping": None, "start": None}
    file = {"name": "file", "source": "tracker.xml", "options": {"key": "go"}, "mapping": mapping}
    return [file | {"start": ["starts from go"]}, plain]


def test_two_models_and_the_notes_about_them(bare):
    models = two_models()
    first = {name: models[0][name] for name in ("mapping", "start")}
    change(bare, models=models, notes=["joint a is translational here"], **first)
    found = report(bare)
    for text in ("Model plain", "Model file", "tracker.xml", "key=go", "geom 'shell'", "starts from go"):
        assert text in found.words
    assert "joint a is translational here" in found.words
    assert "What became of the model file" not in found.words


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"models": two_models(), "notes": 3}, "notes: Input should be a valid array"),
        ({"models": two_models()[:1], "notes": []}, "models: List should have at least 2 items"),
        ({"models": [*two_models(), two_models()[0]], "notes": []}, "models: List should have at most 2"),
        ({"models": [{"name": "a"}, {}], "notes": []}, "models.0.source: Field required"),
    ],
)
def test_a_comparison_that_is_not_whole_is_one_line(bare, capsys, changes, message):
    change(bare, **changes)
    status, out, err = run(capsys, "report", bare)
    assert (status, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert f"{bare / 'summary.json'}: " in err
    assert message in err
    assert not (bare / PAGE).exists()


def moved_scene() -> dict:
    """A scene as `crosscheck regress` writes it, whose recording is in a folder of another machine."""
    figure = {"group": "relative", "name": EVIL, "unit": "m", "where": "crank, x", "was": 1.0, "now": 1.5}
    figure |= {"band": 0.1, "bands": 5.0, "moved": True, "problem": ""}
    gone = figure | {"name": "gone", "was": None, "now": None, "bands": None, "problem": "not measured"}
    baseline = {"date": "2026-01-01", "reason": "as delivered", "versions": {"numpy": "2.0"}}
    scene = {"scene": "four_bar", "quiet": False, "verdict": "four_bar: MOVED: 1", "baseline": baseline}
    scene |= {"versions": {"numpy": "3.0"}, "diverges": 0.1, "wall_time": 2.0, "figures": [figure, gone]}
    return scene | {"recording": str(Path("/elsewhere") / "four_bar.rrd")}


def test_scenes_against_their_baselines(folder):
    content = {"quiet": False, "verdict": "MOVED: 1 of 2 scenes", "scenes": [moved_scene()]}
    quiet = {"quiet": True, "verdict": "quiet as ever", "figures": [], "recording": None}
    content["scenes"].append(moved_scene() | quiet | {"scene": "still"})
    (folder / "summary.json").unlink()
    (folder / "regress.json").write_text(json.dumps(content))
    found = report(folder)
    for text in ("MOVED: 1 of 2 scenes (4 s)", "quiet as ever", "crank, x", "not measured", "as delivered"):
        assert text in found.words
    assert {"1", "1.5", "5", "2.0", "3.0"} <= set(found.text)
    assert list(found.images) == [f"four_bar: The mechanism at 0, 0.025, 0.05 s, by {ENGINES[0]}"]
    (folder / "four_bar.rrd").unlink()
    assert "No picture of four_bar: " in report(folder).words


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("summary.json", b"{", "file: Invalid JSON: "),
        ("summary.json", b"\xff", "file: Invalid JSON: "),
        ("summary.json", b"[" * 100_000, "file: Invalid JSON: "),
        ("summary.json", b"{}", "summary.json: scene: Field required"),
        ("summary.json", b"[]", "summary.json: file: "),
        ("bench.json", b"3", "bench.json: file: "),
        ("faults.json", b"{}", "faults.json: scene: Field required"),
        ("regress.json", b'{"quiet": true, "verdict": "", "scenes": [1]}', "regress.json: scenes.0: "),
        ("stress.json", b'{"form": "ci"}', "stress.json: wall_time: Field required"),
        ("pinocchio.npz", b"PK", "pinocchio.npz: is not the file that summary.json beside it was written"),
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


def test_a_drawing_holds_all_bodies(folder):
    poses, shapes = drawing._read(folder / "four_bar.rrd", "pinocchio")
    assert set(poses) == {f"/mechanism/pinocchio/{body}" for body in ("crank", "coupler", "rocker")}
    assert set(shapes) >= set(poses)
    with pytest.raises(CrosscheckError, match="no bodies of bullet"):
        list(drawing.views(folder / "four_bar.rrd", "bullet", [0.0]))


def test_values_of_any_shape():
    assert page.values({"a": [1, 2.5, None, "<"]}) == (
        "<table><tr><th></th><th></th></tr><tr><td>a</td><td>1, 2.5, , &lt;</td></tr></table>"
    )
    assert page.values([{"a": 1}, {"b": {"c": True}}]).count("<table>") == 2
    assert page.values([[1, 2], {"a": 1}]).startswith("1, 2<table>")
    assert page.values({}) == ""
