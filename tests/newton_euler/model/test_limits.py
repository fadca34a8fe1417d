"""Limits that can be seen and changed, and surroundings that take something away."""

from __future__ import annotations

import math
import os
import re
import resource
import sys
from contextlib import suppress
from pathlib import Path

import mujoco
import pytest
from command_line import command, run, scene_file, short_example
from hostile_files import MJCF, WEDGE

import mjcf
import newton_euler
from crosscheck.library import SCENES, load
from crosscheck.library.model_files import MJCF_OPTIONS, URDF_OPTIONS
from crosscheck.library.options import options_of
from crosscheck.recording.log import log_run
from crosscheck.recording.mesh_budget import engines_with_meshes
from crosscheck.recording.stream import recorded
from mjcf.errors import ModelError
from newton_euler.errors import OptionError, UnknownNameError, listed
from newton_euler.limits import ENVIRONMENT_VARIABLE, LIMITS, changed, exceeded, limit, too_small


def test_limits_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "list", "-v")
    assert status == 0
    for name, each in LIMITS.items():
        assert f"--set {name}=" in out
        assert f"[default: {each}]" in out


def test_no_limit_has_the_name_of_an_option() -> None:
    options = {
        *MJCF_OPTIONS,
        *URDF_OPTIONS,
        *(name for scene in SCENES.values() for name in options_of(scene)),
    }
    assert LIMITS.keys().isdisjoint(options)


def test_limits_are_changed_for_a_while_and_in_processes_that_are_started() -> None:
    before = os.environ.get(ENVIRONMENT_VARIABLE)
    with changed({"velocities": "12.5"}), changed({"time": 3}):
        assert (limit("velocities"), limit("time"), limit("bodies")) == (12.5, 3.0, LIMITS["bodies"].default)
        assert os.environ[ENVIRONMENT_VARIABLE] == "velocities=12.5 time=3"
        assert exceeded("velocities", 12.5) == ""
        assert (
            exceeded("velocities", 12.6) == "12.6 velocities, at most 12.5; to allow it: --set velocities=13"
        )
    assert os.environ.get(ENVIRONMENT_VARIABLE) == before


@pytest.mark.parametrize("value", ["", "much", "nan", "inf", "-1", "0", None])
def test_a_limit_is_a_positive_number(value: object) -> None:
    with pytest.raises(OptionError), changed({"velocities": value}):  # type: ignore[dict-item]
        pass


def test_limits_as_large_as_numbers_can_be_are_none(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "wedge.obj").write_text(WEDGE)
    (tmp_path / "model.xml").write_text(MJCF)
    with changed(dict.fromkeys(LIMITS, "1e308")):
        scene = mjcf.read(tmp_path / "model.xml").scene
        assert engines_with_meshes(scene.mechanism, ["mujoco"]) == ["mujoco"]
        assert load(str(scene_file(tmp_path, short_example()))).name == "four_bar"


def test_an_unknown_limit() -> None:
    with pytest.raises(UnknownNameError), changed({"patience": 1}):
        pass


def test_what_a_limit_refuses_runs_with_the_setting_that_the_message_names(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = scene_file(tmp_path, short_example())
    status, _, err = run(capsys, "convert", path, tmp_path / "x.json", "--set", "velocities=2")
    assert status == 2
    (setting,) = re.findall(r"to allow it: --set (\S+)$", err)
    status, _, err = run(capsys, "convert", path, tmp_path / "x.json", "--set", setting)
    assert (status, err) == (0, "")
    assert limit("velocities") == LIMITS["velocities"].default


def test_memory_that_mujoco_needs(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path, out = tmp_path / "m.xml", tmp_path / "x.yaml"
    texture = '<texture name="t" type="2d" builtin="flat" width="5000" height="5000"/>'  # 75 MB
    text = MJCF.replace('<mesh name="wedge" file="wedge.obj"/>', texture)
    path.write_text(text.replace('<geom type="mesh" mesh="wedge"/>', '<geom size="0.1"/>'))
    status, _, err = run(capsys, "convert", path, out, "--set", "memory=160")
    assert status == 2
    assert err.endswith(
        "MuJoCo needs more than 160 MB of memory to compile it; to allow more: --set memory=640\n"
    )
    assert run(capsys, "convert", path, out, "--set", "memory=640")[0] == 0


def test_assets_elsewhere_are_a_question_of_trust(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "robot" / "models" / "m.xml"
    path.parent.mkdir(parents=True)
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "wedge.obj").write_text(WEDGE)
    path.write_text(MJCF.replace('"parts"', '"../../meshes"'))
    status, _, err = run(capsys, "convert", path, tmp_path / "x.yaml")
    assert status == 2
    assert err.endswith(f"if you trust the file: --set root={tmp_path}\n")
    assert run(capsys, "convert", path, tmp_path / "x.yaml", "--set", f"root={tmp_path}")[0] == 0
    path.write_text(MJCF.replace('"parts"', f'"{tmp_path / "meshes"}"'))  # in there, however it is named
    assert run(capsys, "convert", path, tmp_path / "y.yaml", "--set", f"root={tmp_path}")[0] == 0


def test_a_chain_that_is_too_long_for_mujocos_parser() -> None:
    mujoco.MjModel.from_xml_string(mjcf.to_xml(load("chain", N=490)))
    with pytest.raises(ModelError, match=r"491 bodies in one branch; .* at most 490"):
        mjcf.to_xml(load("chain", N=491))


def test_no_cursor_moves_in_a_pipe(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    status, out, err = run(capsys, "report", tmp_path)
    assert (status, out) == (2, "")
    assert "\x1b" not in err


def test_standard_error_that_is_full(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    full = Path("/dev/full").open("w")  # noqa: SIM115
    monkeypatch.setattr(sys, "stderr", full)
    status, out, _ = run(capsys, "run", "nonsense")
    monkeypatch.undo()
    with suppress(OSError):
        full.close()
    assert status == 2
    assert out.startswith("crosscheck: error: unknown scene 'nonsense'")


@pytest.mark.parametrize("switch", ["off", "on", "false", "?"])
def test_a_recording_is_made_whatever_logging_is_set_to(monkeypatch: pytest.MonkeyPatch, switch: str) -> None:
    monkeypatch.setenv("RERUN", switch)
    scene = load("pendulum")
    content = recorded(log_run, scene, {"newton_euler": newton_euler.simulate(scene)}, "verdict", "title")
    assert content.startswith(b"RRF2")
    assert os.environ["RERUN"] == switch


def test_few_open_files_are_told(tmp_path: Path) -> None:
    """Native code of Rerun would end the process."""
    limits = lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (40, 40))  # noqa: E731
    done = command(tmp_path, "run", "pendulum", preexec_fn=limits)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("crosscheck: error: the limit of open files is 40 (ulimit -n); needed: ")
    assert not list(tmp_path.iterdir())


def test_little_memory_is_told(tmp_path: Path) -> None:
    limits = lambda: resource.setrlimit(resource.RLIMIT_AS, (500_000_000, 500_000_000))  # noqa: E731
    done = command(tmp_path, "run", "pendulum", preexec_fn=limits)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("crosscheck: error: the limit of memory is 500 MB (ulimit -v); needed: ")
    assert not list(tmp_path.iterdir())


def test_numbers_that_no_double_holds_exceed_limits() -> None:
    assert exceeded("cycles", math.inf) == "more cycles than a number can hold, at most 1000"
    assert exceeded("cycles", math.nan) == "more cycles than a number can hold, at most 1000"


def test_the_setting_of_a_tiny_limit_has_its_digits():
    with changed({"time": "1e-320"}):
        assert too_small("time") == "to allow more: --set time=4e-320"


def test_long_lists_of_names_are_cut():
    names = [f"link_{k}" for k in range(500)]
    assert listed(names[:3]) == "link_0, link_1, link_2"
    assert listed([]) == ""
    text = str(UnknownNameError("body", "x", tuple(names)))
    shown = sum(name in text.replace(" ", ",").split(",") for name in names)
    assert text.endswith(f" and {500 - shown} others")
    assert len(text) < 350
    assert listed(["x" * 400, "y"]) == f"{'x' * 400} and 1 other"
