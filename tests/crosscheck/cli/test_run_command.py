"""`crosscheck run`: what it writes, its exit statuses, and a dozen kinds of bad input."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from command_line import check_refused, run, scene_file, verdict_of

from crosscheck.cli.shared import scene_options
from crosscheck.compare.check import LEVELS, READING, Check
from crosscheck.library import load
from newton_euler.model.trajectory import load_arrays


def test_run_writes_everything_and_agrees(capsys, tmp_path, good):
    path = scene_file(tmp_path, good)
    status, out, err = run(capsys, "run", path, "--output", tmp_path / "out")
    assert (status, err) == (0, "")
    assert verdict_of(out).startswith("AGREE: newton_euler, mujoco, pinocchio ")
    names = {p.name for p in (tmp_path / "out").iterdir()}
    assert names == {
        "newton_euler.npz",
        "mujoco.npz",
        "pinocchio.npz",
        "summary.json",
        "junit.xml",
        "scene.rrd",
    }
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["agrees"] is True
    assert {figure["level"] for figure in summary["checks"]} == {*LEVELS} - {READING}
    assert set(summary["engines"]) == {"newton_euler", "mujoco", "pinocchio"}
    assert summary["versions"]["mujoco"].split(".")[0].isdigit()
    arrays = load_arrays(tmp_path / "out" / "mujoco.npz")
    assert arrays["position"].shape == (6, 4, 3)
    assert list(arrays["body_names"]) == ["frame", "crank", "coupler", "rocker"]


def test_engines_can_be_chosen_and_the_recording_put_elsewhere(capsys, tmp_path, good):
    path, recording = scene_file(tmp_path, good), tmp_path / "deep" / "run.rrd"
    arguments = ("--engines", "newton_euler,pinocchio", "--output", tmp_path / "out", "--save", recording)
    status, _, _ = run(capsys, "run", path, *arguments)
    assert status == 0
    assert recording.exists()
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        "newton_euler.npz",
        "pinocchio.npz",
        "summary.json",
        "junit.xml",
    }


def test_elements_to_ignore_may_be_given_one_by_one():
    assert scene_options(("ignore=a", "base=free", "ignore=b")) == {"ignore": "a,b", "base": "free"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["trakcer"], "unknown scene 'trakcer'; did you mean 'tracker'? choose from: tracker, "),
        (["tracker", "--engines", "bullet"], "unknown engine 'bullet'; choose from: newton_euler, mujoco"),
        (["tracker", "--engines", "mujoco,mujoco"], "engine 'mujoco' is named 2 times"),
        (["tracker", "--engines", ","], "no engine named"),
        (["tracker", "--set", "panel_inertia"], "--set 'panel_inertia' is not of the form OPTION=VALUE"),
        (["tracker", "--set", "panel_inertia=round"], "choose from: realisable, literal"),
        (["tracker", "--set", "color=red"], "unknown option 'color'"),
        (["tracker", "--set", "name=red"], "unknown option 'name'"),
        (["tracker", "--set", "panel_inertia=literal", "--set", "panel_inertia=realisable"], "given twice"),
        (["tracker", "--fast"], "No such option"),
        (["tracker", "four_bar"], "unexpected extra argument"),
        (["tracker", "--log", "a.csv", "--log-map", "x"], "--log-map 'x' is not of the form COLUMN=QUANTITY"),
    ],
)
def test_bad_usage(capsys, tmp_path, arguments, message):
    check_refused(capsys, tmp_path, *arguments, message=message)


def test_a_file_with_another_suffix_is_no_scene(capsys, tmp_path):
    path = tmp_path / "robot.txt"
    path.touch()
    message = f"{path}: cannot be read; needed: a name that ends in .yaml, .json, .xml or .urdf"
    check_refused(capsys, tmp_path, path, message=message)


def test_paths_that_cannot_be_written(capsys, tmp_path, good):
    path = scene_file(tmp_path, good)
    (tmp_path / "file").write_text("")
    (tmp_path / "folder.rrd").mkdir()
    for option, target in (("--output", "file/out"), ("--save", "file/run.rrd"), ("--save", "folder.rrd")):
        status, out, err = run(capsys, "run", path, "--output", tmp_path / "o", option, tmp_path / target)
        assert (status, out) == (2, "")
        assert err.startswith("crosscheck: error: cannot write ")
        assert len(err.splitlines()) == 1


def test_an_interrupt_is_one_line(tmp_path, capsys, good, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("crosscheck.compare.crosscheck.stages", interrupted)
    out = tmp_path / "out"
    status, printed, err = run(capsys, "run", scene_file(tmp_path, good), "--output", out)
    assert (status, printed, err) == (130, "", "crosscheck: error: interrupted\n")
    assert not list(out.iterdir())


def test_what_nobody_foresaw_is_one_line_and_what_there_is_is_kept(tmp_path, capsys, good, monkeypatch):
    def broken(_):
        raise ZeroDivisionError("division\nby zero")

    monkeypatch.setattr("crosscheck.compare.crosscheck.stages", lambda *_: {"comparing": broken})
    path, out = scene_file(tmp_path, good), tmp_path / "out"
    status, said, err = run(capsys, "run", path, "--engines", "newton_euler,mujoco", "--output", out)
    assert (status, err) == (3, "")
    reason = "comparing: internal error: ZeroDivisionError: division by zero"
    assert verdict_of(said).startswith(f"UNFINISHED: {reason}; ")
    files = {"newton_euler.npz", "mujoco.npz", "summary.json", "junit.xml", "scene.rrd"}
    assert {path.name for path in out.iterdir()} == files


def test_a_figure_that_is_not_a_number_is_none(tmp_path, capsys, good, monkeypatch):
    row = Check("drift", "open joints", ("mujoco",), float("nan"), 1.0, "elbow")
    monkeypatch.setattr(
        "crosscheck.compare.crosscheck.stages",
        lambda *_: {"comparing": lambda _: [row, replace(row, value=0.5)]},
    )
    path, out = scene_file(tmp_path, good), tmp_path / "out"
    status, said, err = run(capsys, "run", path, "--engines", "newton_euler,mujoco", "--output", out)
    assert (status, err) == (3, "")
    assert "no check of open joints at level 'drift' between mujoco: nan at elbow; as far" in said
    figures = json.loads((out / "summary.json").read_text())["checks"]
    assert [figure["value"] for figure in figures] == [0.5]


def test_markup_in_texts_is_text(tmp_path, capsys, good):
    path = scene_file(tmp_path, good | {"description": "[/red] [bold]b :smile:"})
    folder = tmp_path / "[b]"
    status, out, err = run(capsys, "run", path, "--engines", "pinocchio,newton_euler", "--output", folder)
    assert (status, err) == (0, "")
    assert out.startswith("four_bar: [/red] [bold]b :smile:")
    assert f"crosscheck report '{folder}'" in out


def test_one_engine_alone_agrees_with_nobody(tmp_path, capsys, good):
    path = scene_file(tmp_path, good)
    status, out, _ = run(capsys, "run", path, "--engines", "mujoco", "--output", tmp_path / "out")
    assert status == 0
    assert verdict_of(out).startswith(
        "ONE ENGINE ALONE: ran mujoco on four_bar: nothing to compare it with; "
    )
    assert "AGREE" not in out
    assert "agree" not in verdict_of(out)


def test_one_engine_alone_can_fail(tmp_path, capsys, good, monkeypatch):
    row = Check("drift", "constraint violation, m or rad", ("mujoco",), 2.0, 1.0, "elbow at 0 s")
    monkeypatch.setattr("crosscheck.compare.crosscheck.stages", lambda *_: {"comparing": lambda _: [row]})
    path = scene_file(tmp_path, good)
    status, out, _ = run(capsys, "run", path, "--engines", "mujoco", "--output", tmp_path / "out")
    assert status == 1
    verdict = (
        "its own checks fail at level 'drift': constraint violation, m or rad: 2 > 1, worst at elbow at 0 s"
    )
    assert verdict in verdict_of(out)


def test_a_second_run_leaves_nothing_of_the_first(tmp_path, capsys, good):
    path, folder = scene_file(tmp_path, good), tmp_path / "out"
    run(capsys, "run", path, "--engines", "mujoco,pinocchio", "--output", folder)
    (folder / "notes.npz").write_text("somebody's own")
    run(capsys, "run", path, "--engines", "pinocchio", "--output", folder)
    assert {p.name for p in folder.iterdir()} == {
        "pinocchio.npz",
        "summary.json",
        "junit.xml",
        "scene.rrd",
        "notes.npz",
    }


def test_a_recording_is_named_as_one(tmp_path, capsys, good):
    path = scene_file(tmp_path, good)
    check_refused(capsys, tmp_path, path, "--save", tmp_path / "x.npz", message="name ends in .rrd")


def test_summary_tells_what_was_run(tmp_path, capsys, monkeypatch, good):
    short = replace(load("tracker", panel_inertia="literal"), duration=0.02)
    monkeypatch.setattr("crosscheck.loading.load.load", lambda *_, **__: short)
    arguments = ("--set", "panel_inertia=literal", "--engines", "pinocchio", "--output", tmp_path)
    _, out, _ = run(capsys, "run", "tracker", *arguments)
    summary = json.loads((tmp_path / "summary.json").read_text())
    told = {name: summary[name] for name in ("scene", "source", "options")}
    assert told == {"scene": "tracker", "source": "tracker", "options": {"panel_inertia": "literal"}}
    assert set(summary["versions"]) == {"python", "numpy", "scipy", "rerun-sdk", "pin", "crosscheck"}
    assert summary["verdict"] == verdict_of(out)
    assert "ran pinocchio on tracker (panel_inertia=literal)" in summary["verdict"]
