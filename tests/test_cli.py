"""The command line: what it writes, its exit statuses, and twenty-odd kinds of bad input."""

from __future__ import annotations

import copy
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from crosscheck.cli import main
from newton_euler.trajectory import load_arrays

EXAMPLE = Path(__file__).parents[1] / "examples" / "four_bar.yaml"


@pytest.fixture(scope="module")
def good():
    """The example's content, cut to a short run."""
    content = yaml.safe_load(EXAMPLE.read_text())
    content["duration"] = 0.05
    return content


def run(capsys, *arguments):
    """Exit status, standard output and standard error of a command line."""
    with pytest.raises(SystemExit) as caught:
        main([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    return caught.value.code or 0, captured.out, captured.err


def scene_file(folder, content, name="scene.yaml"):
    path = folder / name
    path.write_text(content if isinstance(content, str) else yaml.safe_dump(content))
    return path


def test_run_writes_everything_and_agrees(capsys, tmp_path, good):
    path = scene_file(tmp_path, good)
    status, out, err = run(capsys, "run", path, "--output", tmp_path / "out")
    assert (status, err) == (0, "")
    assert out.splitlines()[-1].startswith("AGREE: newton_euler, mujoco, pinocchio agree on four_bar")
    names = {p.name for p in (tmp_path / "out").iterdir()}
    assert names == {"newton_euler.npz", "mujoco.npz", "pinocchio.npz", "summary.json", "four_bar.rrd"}
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["agrees"] is True
    assert {"model", "kinematics", "accelerations and reactions", "trajectories", "drift", "energy"} == {
        figure["level"] for figure in summary["figures"]
    }
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
    }


def test_a_disagreement_is_status_1_and_names_the_place(capsys, tmp_path, good, monkeypatch):
    from dataclasses import replace

    import mjcf
    from crosscheck import engines
    from newton_euler.scene import Scene

    def heavier(scene: Scene):
        bodies = list(scene.mechanism.bodies)
        bodies[2] = replace(bodies[2], mass=1.001 * bodies[2].mass)
        return replace(
            scene, mechanism=type(scene.mechanism)(bodies, scene.mechanism.joints), initial_state=None
        )

    mujoco = engines.ENGINES["mujoco"]
    wrong = replace(
        mujoco,
        simulate=lambda scene: mjcf.simulate(heavier(scene)),
        systems=lambda scene: mujoco.systems(heavier(scene)),
        soft_start=None,
    )
    monkeypatch.setitem(engines.ENGINES, "mujoco", wrong)
    path = scene_file(tmp_path, good)
    status, out, _ = run(capsys, "run", path, "--output", tmp_path / "out")
    assert status == 1
    verdict = out.splitlines()[-1]
    assert "DISAGREE: newton_euler and mujoco part at level 'model': mass, rel: 0.001" in verdict
    assert "worst at coupler" in verdict
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["agrees"] is False


def test_list_names_scenes_options_and_engines(capsys):
    status, out, _ = run(capsys, "list")
    assert status == 0
    assert "tracker: dual-axis solar tracker" in out
    assert "--set panel_inertia=realisable|literal" in out
    assert "engines: newton_euler, mujoco, pinocchio" in out


def test_module_and_version():
    command = [sys.executable, "-m", "crosscheck", "--version"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("crosscheck, version ")


def changed(content, path, value):
    """A copy of nested content with one element replaced (or removed, for value ...)."""
    content = copy.deepcopy(content)
    at = content
    for key in path[:-1]:
        at = at[key]
    if value is ...:
        del at[path[-1]]
    else:
        at[path[-1]] = value
    return content


BAD_SCENES = {
    "negative mass": (("bodies", 1, "mass"), -1.0, "body 'coupler': mass is -1 kg; needed: a positive"),
    "zero mass": (("bodies", 1, "mass"), 0.0, "body 'coupler': mass is 0 kg"),
    "NaN": (("bodies", 0, "mass"), float("nan"), "bodies.0.mass: Input should be a finite number"),
    "infinite point": (("joints", 0, "point"), [0.0, float("inf"), 0.0], "joints.0.point.1"),
    "asymmetric inertia": (("bodies", 1, "inertia", 0, 1), 0.001, "body 'coupler': inertia differs from"),
    "indefinite inertia": (("bodies", 1, "inertia", 0, 0), -0.004, "a positive definite inertia"),
    "unrealisable inertia": (("bodies", 1, "inertia", 0, 0), 0.9, "body 'coupler': principal moments"),
    "quaternion not of unit norm": (("bodies", 1, "quaternion"), [1.0, 0.1, 0, 0], "quaternion has norm"),
    "quaternion of three": (("bodies", 1, "quaternion"), [1.0, 0.0, 0.0], "bodies.1.quaternion"),
    "zero axis": (("joints", 0, "axis"), [0.0, 0.0, 0.0], "joint 'motor': axis is [0.0, 0.0, 0.0]; needed"),
    "missing axis": (("joints", 0, "axis"), ..., "joint 'motor': a revolute joint needs axis, got none"),
    "slanted universal": (("joints", 2, "axis_on_second"), [1.0, 1.0, 0.0], "perpendicular axes"),
    "unknown body": (("joints", 1, "second"), "piston", "connects an unknown body 'piston'; needed: one of"),
    "joint to itself": (("joints", 1, "second"), "crank", "connects 'crank' to itself"),
    "unknown joint kind": (("joints", 1, "kind"), "rubber", "unknown kind 'rubber'; choose from: fixed,"),
    "open loop": (("joints", 1, "point_on_second"), [0, 0, 0.201], "joint 'elbow': is open by 0.001 m"),
    "duplicate body": (("bodies", 1, "name"), "crank", "body 'crank': 2 of that name; needed: unique"),
    "duplicate joint": (("joints", 1, "name"), "motor", "joint 'motor': 2 of that name"),
    "unusable name": (("bodies", 1, "name"), "a/b <c>", "has an unusable name"),
    "control of a passive joint": (("joints", 0, "actuated"), False, "the joint is not actuated"),
    "control of an unknown joint": (("control", 0, "joint"), "engine", "unknown joint 'engine'; choose"),
    "zero duration": (("duration",), 0.0, "duration is 0.0; needed: a positive number of seconds"),
    "a million outputs and more": (("output_period",), 1e-9, "outputs; needed: at most 1000000"),
    "misspelt key": (("gravitty",), [0, 0, 0], "gravitty: Extra inputs are not permitted"),
    "missing key": (("joints",), ..., "joints: Field required"),
    "text for a number": (("duration",), "long", "duration: Input should be a valid number"),
}


@pytest.mark.parametrize("kind", BAD_SCENES)
def test_bad_scene_files(capsys, tmp_path, good, kind):
    path, value, message = BAD_SCENES[kind]
    check_refused(capsys, tmp_path, scene_file(tmp_path, changed(good, path, value)), message=message)


def check_refused(capsys, tmp_path, *arguments, message):
    """One line on standard error, status 2, nothing written."""
    before = set(tmp_path.rglob("*"))
    status, out, err = run(capsys, "run", *arguments, "--output", tmp_path / "results" / "out")
    assert (status, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert err.startswith("crosscheck: error: ")
    assert message in err
    assert not [p for p in set(tmp_path.rglob("*")) - before if p.is_file()]


def test_a_body_that_nothing_holds(capsys, tmp_path, good):
    lonely = copy.deepcopy(good)
    lonely["bodies"].append(lonely["bodies"][0] | {"name": "moon"})
    check_refused(capsys, tmp_path, scene_file(tmp_path, lonely), message="body 'moon': no joint leads to it")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not YAML"),
        ("", "Input should be a valid dictionary"),
        ("- 1\n- 2\n", "Input should be a valid dictionary"),
        ("[" * 5000, "not YAML"),
        ("a: !!python/object/apply:os.system [true]", "not YAML"),
    ],
)
def test_files_that_are_no_scenes(capsys, tmp_path, text, message):
    check_refused(capsys, tmp_path, scene_file(tmp_path, text), message=message)


def test_binary_and_missing_files_and_folders(capsys, tmp_path):
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"\xff\xfe\x00\x80")
    check_refused(capsys, tmp_path, binary, message="binary.yaml: not")
    check_refused(capsys, tmp_path, tmp_path / "missing.yaml", message="No such file")
    (tmp_path / "folder.yaml").mkdir()
    check_refused(capsys, tmp_path, tmp_path / "folder.yaml", message="Is a directory")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["trakcer"], "unknown scene 'trakcer'; choose from: tracker"),
        (["tracker", "--engines", "bullet"], "unknown engine 'bullet'; choose from: newton_euler, mujoco"),
        (["tracker", "--engines", "mujoco,mujoco"], "engine 'mujoco' is named 2 times"),
        (["tracker", "--engines", ","], "no engine named"),
        (["tracker", "--set", "leg_inertia"], "--set 'leg_inertia' is not of the form OPTION=VALUE"),
        (["tracker", "--set", "leg_inertia=round"], "choose from: printed, aligned"),
        (["tracker", "--set", "colour=red"], "unknown option 'colour'"),
        (["tracker", "--fast"], "No such option"),
        (["tracker", "four_bar"], "unexpected extra argument"),
    ],
)
def test_bad_usage(capsys, tmp_path, arguments, message):
    check_refused(capsys, tmp_path, *arguments, message=message)


def test_unknown_command(capsys):
    status, _, err = run(capsys, "simulate")
    assert status == 2
    assert err == "crosscheck: error: No such command 'simulate'.\n"


def test_paths_that_cannot_be_written(capsys, tmp_path, good):
    path = scene_file(tmp_path, good)
    (tmp_path / "file").write_text("")
    for option, target in (("--output", "file/out"), ("--save", "file/run.rrd"), ("--save", ".")):
        status, out, err = run(capsys, "run", path, "--output", tmp_path / "o", option, tmp_path / target)
        assert (status, out) == (2, "")
        assert err.startswith("crosscheck: error: cannot write ")
        assert len(err.splitlines()) == 1


@pytest.mark.parametrize("content", [None, b"", b"RRF", b"a picture"])
def test_view_refuses_what_is_no_recording(capsys, tmp_path, content):
    path = tmp_path / "run.rrd"
    if content is not None:
        path.write_bytes(content)
    status, _, err = run(capsys, "view", path)
    assert status == 2
    assert "run.rrd" in err
    assert len(err.splitlines()) == 1


def test_view_without_a_display_says_what_to_do(capsys, tmp_path, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    path = tmp_path / "run.rrd"
    path.write_bytes(b"RRF2")
    status, _, err = run(capsys, "view", path)
    assert status == 2
    assert "rerun --bind 127.0.0.1 --serve-web" in err


def test_figures_draws_five_pictures(tmp_path, capsys):
    status, out, _ = run(capsys, "figures", "--output", tmp_path)
    assert status == 0
    for number in range(5, 10):
        path = tmp_path / f"figure_{number}.png"
        assert path.read_bytes().startswith(b"\x89PNG")
        assert str(path) in out


def test_a_user_sees_no_traceback_from_a_broken_file(tmp_path):
    path = scene_file(tmp_path, "bodies: 3")
    done = subprocess.run(
        [sys.executable, "-m", "crosscheck", "run", str(path)],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])},
    )
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_energy_balance_sees_missing_energy(tracker, tracker_run):
    from dataclasses import replace

    from crosscheck.compare import WORK_QUADRATURE, energy_balance

    run = tracker_run(rtol=1e-11, atol=1e-13)
    assert np.abs(energy_balance(tracker, run)).max() < WORK_QUADRATURE
    lossy = replace(run, kinetic_energy=run.kinetic_energy * (1.0 + 1e-3))
    assert np.abs(energy_balance(tracker, lossy)).max() > WORK_QUADRATURE
