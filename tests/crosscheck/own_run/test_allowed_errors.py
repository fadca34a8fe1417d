"""Largest errors that a user allows for the run with the settings of a file: command line and Python."""

from __future__ import annotations

import json
import math
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from command_line import check_refused, run, verdict_of

import crosscheck
from crosscheck.compare.outcome import ExitStatus, Outcome
from crosscheck.own_run.allowed import (
    OWN_RUN,
    AllowedError,
    ErrorKind,
    exceeded_text,
    length,
    without_loops,
)
from crosscheck.own_run.errors import Band, LoopError
from crosscheck.support.errors import CrosscheckError
from mjcf.errors import collected_warnings
from newton_euler.reading.file_run import LoopErrors

ENGINES = ["newton_euler", "mujoco"]

PENDULUM = """<mujoco model="swing"><option timestep="{step}" integrator="RK4"/><worldbody>
  <body name="bar" euler="0 40 0"><joint name="hinge" axis="0 1 0" {limit}/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.01" mass="0.4" contype="0"/></body>
  </worldbody></mujoco>"""

COARSE, FINE = 0.1, 0.002
"""Steps, s, at which the error is about 0.5 %, and below 0.001 %."""


BOUNCE = """<mujoco model="bounce"><option timestep="0.001" integrator="RK4"/><worldbody>
  <geom type="plane" size="1 1 .1" solref="-1e15 -1e3"/><body name="ball" pos="0 0 .0999">
  <joint name="z" type="slide" axis="0 0 1"/><geom type="sphere" size=".1" solref="-1e15 -1e3" mass="1"/>
  </body></worldbody></mujoco>"""
"""A ball on a floor that is far too stiff for the time step: MuJoCo resets the run."""


@pytest.fixture
def swing(tmp_path):
    def write(step, limit=""):
        path = tmp_path / "swing.xml"
        path.write_text(PENDULUM.format(step=step, limit=limit))
        return path

    return write


@pytest.mark.parametrize(
    ("text", "kind", "largest"),
    [
        ("1e-3", "relative", 1e-3),
        ("0.1%", "relative", 1e-3),
        ("relative=0.1 %", "relative", 1e-3),
        ("position=0.002", "position", 2e-3),
        ("position=2mm", "position", 2e-3),
        ("position=50um", "position", 5e-5),
        ("rotation=180deg", "rotation", math.pi),
        ("rotation=1mrad", "rotation", 1e-3),
        ("opening=0.1mm", "opening", 1e-4),
        ("loop_angle=0.1deg", "loop_angle", math.radians(0.1)),
        ("energy=1%", "energy", 1e-2),
    ],
)
def test_allowed_errors_have_units(text, kind, largest):
    found = AllowedError.parse(text)
    assert (found.kind, found.largest) == (kind, pytest.approx(largest))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1mm", "no unit 'mm' of relative; choose from %"),
        ("position=3deg", "no unit 'deg' of position; choose from m, cm, mm, um"),
        (
            "positon=1",
            "unknown error 'positon'; choose from relative, position, rotation, opening, loop_angle, energy",
        ),
        ("0", "needed: a number above 0"),
        ("-1", "needed: a number above 0"),
        ("position=", "'' is no number with a unit"),
        ("1e", "'1e' is no number with a unit"),
        ("nan", "'nan' is no number with a unit"),
    ],
)
def test_other_texts_are_refused(capsys, tmp_path, swing, text, message):
    check_refused(
        capsys, tmp_path, swing(FINE), f"--max-error={text}", message=f"--max-error {text}: {message}"
    )


def test_scenes_without_settings_are_refused(capsys, tmp_path):
    check_refused(capsys, tmp_path, "pendulum", "--max-error=1", message="pendulum has no run of its own")


def test_the_exit_status_is_of_the_error_only_with_the_option(capsys, tmp_path, swing):
    out = tmp_path / "out"
    arguments = [swing(COARSE), "--engines", ",".join(ENGINES), "--output", out]
    status, text, _ = run(capsys, "run", *arguments)
    assert (status, verdict_of(text).split(":")[0]) == (0, "AGREE")
    position = json.loads((out / "summary.json").read_text())["own_run"]["error"]["position"]
    # above the error, and below
    assert run(capsys, "run", *arguments, f"--max-error=position={1.01 * position}")[0] == ExitStatus.AGREE
    status, text, _ = run(
        capsys, "run", *arguments, f"--max-error=position={0.99 * position}m", "--max-error=50%"
    )
    assert status == ExitStatus.INACCURATE == 5
    assert verdict_of(text).startswith("INACCURATE: errors of the run with your settings: position ")
    assert "relative" not in verdict_of(text).split("AGREE")[0]
    found = json.loads((out / "summary.json").read_text())
    assert (found["outcome"], found["agrees"]) == ("INACCURATE", False)
    assert [each["exceeded"] for each in found["allowed_errors"]] == [True, False]
    assert found["report"]["judged"]["verdict"] == "fails"


def test_python(swing):
    coarse = crosscheck.check(swing(COARSE), ENGINES)
    assert coarse.own_run is coarse.crosscheck.own_run
    assert coarse.outcome is Outcome.AGREE
    with pytest.raises(AssertionError) as raised:
        coarse.assert_accurate(1e-3)
    message = str(raised.value)
    for part in ("INACCURATE", "OFF BY", "cause", "time step", "fix", 'timestep="'):
        assert part in message
    error = coarse.own_run.error
    coarse.assert_accurate(
        1.01 * error.relative, position=1.01 * error.position, rotation=1.01 * error.rotation
    )
    with pytest.raises(AssertionError):
        coarse.assert_accurate(None, rotation=0.99 * error.rotation)
    with pytest.raises(CrosscheckError, match="not positive"):
        coarse.assert_accurate(0.0)
    crosscheck.check(swing(FINE), ENGINES).assert_accurate(1e-4)


def test_what_acts_and_is_not_in_the_reference_is_no_plain_pass(swing):
    limited = crosscheck.check(swing(FINE, 'range="-1 1" limited="true"'), ENGINES)
    assert limited.own_run.events
    with pytest.raises(AssertionError, match="limits of joint 'hinge'"):
        limited.assert_accurate(1e-3)
    limited.assert_accurate(1e-3, allow_reduced=True)


def test_a_scene_without_settings_is_never_accurate():
    with pytest.raises(AssertionError, match="UNFINISHED: your settings: not judged"):
        crosscheck.check("pendulum", ENGINES).assert_accurate()


def test_a_run_that_is_not_judged_is_unfinished(capsys, tmp_path, swing, monkeypatch):
    def stops(*_):
        raise CrosscheckError("out of time")

    monkeypatch.setattr("crosscheck.compare.crosscheck.judge", stops)
    arguments = [swing(FINE), "--engines", ",".join(ENGINES), "--output", tmp_path / "out"]
    assert run(capsys, "run", *arguments)[0] == ExitStatus.AGREE
    status, text, _ = run(capsys, "run", *arguments, "--max-error=1")
    assert status == ExitStatus.UNFINISHED
    assert verdict_of(text).startswith("UNFINISHED: your settings: out of time")


def test_every_error_can_be_limited(swing):
    found = crosscheck.check(swing(COARSE), ENGINES).own_run
    assert {kind: kind.of(found) for kind in ErrorKind} == {
        "relative": found.error.relative,
        "position": found.error.position,
        "rotation": found.error.rotation,
        "opening": found.loop_error.opening,
        "loop_angle": found.loop_error.angle,
        "energy": found.error.energy,
    }


def test_an_error_just_above_the_allowed_one_has_more_digits(swing):
    found = crosscheck.check(swing(COARSE), ENGINES).own_run
    allowed = AllowedError(ErrorKind.ENERGY, found.error.energy * (1.0 - 1e-6))
    text = exceeded_text(OWN_RUN, found, [allowed])
    judged, limit = text.removeprefix("errors of the run with your settings: energy ").split(", allowed ")
    # both numbers differ, and are those of the run and of the limit to round-off of at most 9 digits
    assert judged != limit
    assert float(judged.removesuffix(" %")) == pytest.approx(100.0 * found.error.energy, rel=1e-6)
    assert float(limit.removesuffix(" %")) == pytest.approx(100.0 * allowed.largest, rel=1e-6)


@pytest.mark.parametrize(
    ("meters", "text"), [(0.0, "0 m"), (1e-16, "below 1 pm"), (2e-12, "2 pm"), (0.0123, "12.3 mm")]
)
def test_lengths(meters, text):
    assert length(meters) == text


def test_models_in_memory(swing):
    model = mujoco.MjModel.from_xml_path(str(swing(COARSE)))
    found = crosscheck.check(model, ENGINES)
    found.assert_accurate(0.5)
    with pytest.raises(AssertionError, match="INACCURATE"):
        found.assert_accurate()


def test_a_run_that_diverges_by_what_the_reference_lacks_exceeds_every_error(tmp_path):
    path = tmp_path / "bounce.xml"
    path.write_text(BOUNCE)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    with collected_warnings(data):  # MuJoCo writes them to a file of the current folder otherwise
        mujoco.mj_step(model, data, 100)
    assert data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number  # by MuJoCo alone
    verdict = crosscheck.check(str(path), ENGINES, excitation="off", duration=0.2)
    assert verdict.own_run.stopped
    assert not verdict.own_run.without.stopped
    assert verdict.own_run.band is Band.WRONG
    with pytest.raises(AssertionError):
        verdict.assert_accurate(0.5, allow_reduced=True)


def test_the_end_of_a_long_run_that_is_not_judged_is_an_unfinished_judgement(swing, monkeypatch):
    monkeypatch.setattr("crosscheck.own_run.comparison.MAX_STEPS", 200)
    path = swing(FINE)
    verdict = crosscheck.check(str(path), ENGINES, excitation="off", duration=1.0)
    assert verdict.own_run.unjudged_from == pytest.approx(200 * FINE)
    with pytest.raises(AssertionError, match=r"not judged from 0\.4 s on"):
        verdict.assert_accurate(1e-3)


SWITCHED_OFF = """<option><flag equality="disable"/></option>
  <equality><joint joint1="hinge"/></equality>"""


@pytest.mark.parametrize("angles", [[True], [False]])
def test_a_limit_needs_a_loop_constraint_of_its_kind(angles):
    errors = np.array([[0.0], [0.5]])
    have_angles = np.array(angles)
    found = LoopErrors(("loop",), errors * ~have_angles, errors * have_angles, ~have_angles, have_angles)
    loops = LoopError.of(found, np.array([0.0, 0.1]))
    limited, lacking = (loops.angle, loops.opening) if angles == [True] else (loops.opening, loops.angle)
    assert (limited, lacking) == (0.5, 0.0)
    kinds = [ErrorKind.OPENING if angles == [True] else ErrorKind.LOOP_ANGLE]
    assert list(without_loops(loops)) == kinds


@pytest.mark.slow
@pytest.mark.parametrize(
    "equality", ["", '<equality><joint joint1="hinge" active="false"/></equality>', SWITCHED_OFF]
)
@pytest.mark.parametrize("kind", ["opening", "loop_angle"])
def test_the_loop_error_of_a_file_without_loops_cannot_be_limited(capsys, tmp_path, swing, kind, equality):
    path = swing(FINE)
    path.write_text(path.read_text().replace("</mujoco>", f"{equality}</mujoco>"))
    arguments = [path, "--engines", ",".join(ENGINES), "--output", tmp_path / "out"]
    status, text, _ = run(capsys, "run", *arguments, f"--max-error={kind}=1", "--max-error=1%")
    assert status == ExitStatus.UNFINISHED
    assert verdict_of(text).startswith("UNFINISHED: your settings: no loops")
    assert f"{kind} 1" not in text
    assert "  allowed relative 1 %: met" in text
    # a skipped test case, beside the one of the other limit
    page = ElementTree.parse(tmp_path / "out" / "junit.xml")
    cases = {each.get("name"): each.find("skipped") for each in page.iter("testcase")}
    (limited,) = (each for each in cases if each.startswith(f"{kind} error at most"))
    assert cases[limited] is not None
    assert cases["relative error at most 1 %"] is None
    with pytest.raises(AssertionError, match="no loops"):
        crosscheck.check(path, ENGINES).assert_accurate(**{kind: 1.0})


def test_a_run_of_which_nothing_is_compared_passes_no_limit(capsys, tmp_path, swing, monkeypatch):
    monkeypatch.setattr("crosscheck.own_run.comparison.comparable_until", lambda *_: (0.001,))
    verdict = crosscheck.check(str(swing(FINE)), ENGINES, excitation="off", duration=0.5)
    assert verdict.own_run.band is Band.NOT_JUDGED
    with pytest.raises(AssertionError, match="UNFINISHED: your settings: not judged: the motion is chaotic"):
        verdict.assert_accurate(1e-3)
    output = tmp_path / "out"
    options = ["--set", "excitation=off", "--set", "duration=0.5", "--engines", ",".join(ENGINES)]
    status, text, _ = run(capsys, "run", swing(FINE), *options, "--max-error", "0.5", "--output", output)
    assert status == ExitStatus.UNFINISHED
    assert verdict_of(text).startswith("UNFINISHED: your settings: not judged: the motion is chaotic")
    assert "allowed" not in text
    cases = (output / "junit.xml").read_text()
    assert '<skipped message="your settings: relative error at most 50 %: not judged' in cases
