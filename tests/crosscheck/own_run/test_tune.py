"""`crosscheck tune`: the found settings reach the error in plain MuJoCo, and no others are much cheaper."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from command_line import run, verdict_of
from mjcf_models import FOUR_BAR_BODIES
from own_runs import acting_in

import crosscheck
import newton_euler
from crosscheck.compare.outcome import ExitStatus
from crosscheck.loading.load import load_scene
from crosscheck.own_run import tune as tuning
from crosscheck.own_run.allowed import AllowedError, ErrorKind, in_unit
from crosscheck.own_run.judge import judge
from crosscheck.own_run.tune import search_settings
from crosscheck.report.own_run import own_run_lines, percent
from crosscheck.report.table import Lines
from crosscheck.report.tuning import report as search_report
from crosscheck.support.errors import CrosscheckError
from mjcf.reading.softness import equalities_with_own_softness
from newton_euler.errors import NewtonEulerError
from newton_euler.model.euler_parameters import angle_between

TARGET = 1e-3

OPTIONS = {"duration": "0.5", "output_period": "0.01"}

FOUR_BAR = f"""<mujoco model="loop"><option timestep="0.0025"/>
  <worldbody>
{FOUR_BAR_BODIES}</worldbody>
  <equality><connect name="tip" body1="coupler" body2="rocker" anchor="0.25 0 0.1"/></equality></mujoco>"""

OWN_SOFTNESS = FOUR_BAR.replace("<connect ", '<connect solref="0.05 1" ')

CLASS_SOFTNESS = FOUR_BAR.replace(
    "<worldbody>", '<default><default class="soft"><equality solref="0.05 1"/></default></default><worldbody>'
).replace("<connect ", '<connect class="soft" ')

WEAK_SOLVER = FOUR_BAR.replace("<option ", '<option solver="PGS" iterations="1" ')

GYROSCOPE = """<mujoco model="top"><option timestep="0.0025" gravity="0 0 0"/><worldbody>
  <body name="hull"><freejoint/><inertial pos="0 0 0" mass="0.12" diaginertia="18e-5 1.65e-5 18e-5"/></body>
  </worldbody><keyframe><key name="go" qvel="0 0 0 3 60 2"/></keyframe></mujoco>"""

SERVO = """<mujoco model="arm"><option timestep="0.0025"/><worldbody>
  <body name="arm" euler="0 40 0"><joint name="a" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.01" mass="0.4" contype="0"/></body></worldbody>
  <actuator><position name="servo" joint="a" kp="20" kv="5"/></actuator></mujoco>"""

PENDULUM = """<mujoco model="swing"><option timestep="0.0025"/><worldbody>
  <body name="bar" euler="0 40 0"><joint name="hinge" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.01" mass="0.4" contype="0"/></body>
  </worldbody></mujoco>"""
"""A slow motion, for which RK4 can take longer steps than the time between two outputs."""

STIFF = """<mujoco model="stiff"><option timestep="0.002"/><worldbody>
  <body name="arm"><joint name="a" axis="0 1 0" damping="2"/>
    <geom type="capsule" fromto="0 0 0 .5 0 0" size=".03" mass="2" contype="0"/>
    <body name="tip" pos=".5 0 0"><joint name="b" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 .2 0 0" size=".02" mass=".2" contype="0"/></body></body></worldbody>
  <actuator><position name="elbow" joint="b" kp="20000"/></actuator></mujoco>"""
"""A servo that is far too stiff for the time step: the run diverges after 12 ms."""

MODELS = {
    "pendulum": PENDULUM,
    "softness of the defaults": FOUR_BAR,
    "softness of an element": OWN_SOFTNESS,
    "softness of a class": CLASS_SOFTNESS,
    "one iteration": WEAK_SOLVER,
    "gyroscope": GYROSCOPE,
    "servo": SERVO,
}


@pytest.fixture(params=MODELS)
def path(request, tmp_path):
    found = tmp_path / "model.xml"
    found.write_text(MODELS[request.param])
    return found


def relative(largest):
    """A largest error relative to the motion."""
    return AllowedError(ErrorKind.RELATIVE, largest)


def loaded(path, **options):
    scene, report = load_scene(str(path), OPTIONS | options)
    assert report is not None
    assert report.simulation is not None
    return scene, report.simulation


def pasted(text, fragment):
    """The file with the fragment at its end, and with the attributes of the comment in its equality."""
    lines, _, comment = fragment.partition("<!--")
    if comment:
        attributes = re.match(r' (solref="[^"]*")?( solimp="[^"]*")?', comment)
        text = re.sub(r' (?:solref="[^"]*"|class="soft")(?=[^>]*body1)', "", text)
        text = text.replace("<connect ", f"<connect {attributes[0]} ")
    return text.replace("</mujoco>", f"{lines}</mujoco>")


def plain_error(text, scene):
    """Run a file by plain MuJoCo, and compare it with newton_euler: the relative error at the outputs, or
    after each step if that is longer."""
    model = mujoco.MjModel.from_xml_string(text)
    scene = with_outputs_after(scene, model.opt.timestep)
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    every = round(scene.output_period / model.opt.timestep)
    exact = newton_euler.simulate(scene, rtol=1e-11, atol=1e-12)
    bodies = [model.body(name).id for name in exact.body_names[1:]]
    lengths, angles = [0.0], [0.0]
    for position, quaternion in zip(exact.position[1:, 1:], exact.quaternion[1:, 1:], strict=True):
        mujoco.mj_step(model, data, every)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        lengths.append(np.max(np.linalg.norm(data.xipos[bodies] - position, axis=1)))
        angles.append(np.max(angle_between(data.xquat[bodies], quaternion)))
    moved = np.max(np.linalg.norm(exact.position - exact.position[0], axis=2))
    start = np.broadcast_to(exact.quaternion[0], exact.quaternion.shape)
    turned = min(np.max(angle_between(exact.quaternion, start)), 1.0)
    return max(np.max(lengths) / max(moved, 1e-3 * scene.mechanism.size), np.max(angles) / turned)


def with_outputs_after(scene, step):
    """The scene with longer times between outputs if a time step is longer."""
    period = max(scene.output_period, step)
    return replace(scene, output_period=period, duration=int(scene.duration / period * (1.0 + 1e-9)) * period)


def test_found_settings_reach_the_error_when_pasted(path):
    scene, simulation = loaded(path)
    found = search_settings(simulation, relative(TARGET))
    assert found.own.error.relative > TARGET
    assert found.found is not None
    text = path.read_text()
    assert plain_error(text, scene) == pytest.approx(found.own.error.relative, rel=0.01)
    error = plain_error(pasted(text, found.found.fragment), scene)
    assert error <= TARGET
    assert error == pytest.approx(found.found.error.relative, rel=0.01)
    # errors fall and costs rise down the table
    errors = [one.error.relative for one in found.tradeoff]
    costs = [one.evaluations for one in found.tradeoff]
    assert errors == sorted(errors, reverse=True)
    assert costs == sorted(costs)


@pytest.mark.slow
@pytest.mark.parametrize("target", [1e-2, 1e-3, 1e-4])
def test_no_settings_of_a_grid_cost_less_than_half(path, target):
    scene, simulation = loaded(path)
    found = search_settings(simulation, relative(target))
    assert found.found is not None
    # steps of up to a tenth of the run
    for steps in (0.2, 0.25, 0.5, *range(1, 400)):
        step = scene.output_period / steps
        sampled = with_outputs_after(scene, step)
        every = round(sampled.output_period / step)
        for settings in grid(simulation.settings, step):
            if 2.0 * simulation.evaluations(settings) >= found.found.evaluations:
                continue
            tried = simulation.run(settings, round(sampled.duration / step), every, reduced=True)
            assert tried.stopped or relative_error(tried.trajectory, sampled) > target, settings


def test_steps_may_be_longer_than_the_time_between_outputs(tmp_path):
    path = tmp_path / "model.xml"
    path.write_text(PENDULUM)
    scene, simulation = loaded(path)
    found = search_settings(simulation, relative(TARGET)).found
    assert found.changes["integrator"] == "RK4"
    assert scene.output_period < float(found.changes["timestep"]) <= scene.duration / tuning.MIN_OUTPUTS


def test_a_chaotic_motion_has_ten_compared_outputs_too(tmp_path, monkeypatch):
    """At long steps the comparison would end before the first one."""
    path = tmp_path / "model.xml"
    path.write_text(PENDULUM)
    scene, simulation = loaded(path)
    monkeypatch.setattr("crosscheck.own_run.comparison.comparable_until", lambda *_: (0.055,))
    search = search_settings(simulation, relative(TARGET))
    assert search.scale.mechanisms[0].until == 0.055
    assert float(search.found.changes["timestep"]) <= scene.output_period


def grid(own, step):
    """Yield integrators, softness and solvers at a time step."""
    default = {"solver": "Newton", "iterations": 100, "tolerance": 1e-8}
    for integrator in ("Euler", "implicit", "implicitfast", "RK4"):
        for solver in ({}, default):
            for constant in (None, 2.0 * step, 3.0 * step, 6.0 * step):
                for solimp in (None, (0.99, 0.99, 0.001), (0.9999, 0.9999, 0.001)):
                    solref = None if constant is None else (constant, 1.0)
                    changes = {"solref": solref, "solimp": solimp, **solver}
                    yield replace(own, timestep=step, integrator=integrator, **changes)


def relative_error(run, scene):
    """Compare a run with newton_euler at its outputs."""
    from crosscheck.own_run.errors import MotionScale, run_error

    exact = newton_euler.simulate(scene, rtol=1e-11, atol=1e-12)
    return run_error(run, exact, MotionScale.of(exact, scene.mechanism)).relative


def test_the_settings_of_a_urdf_are_found_and_can_be_given(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(
        '<robot name="arm"><link name="ground"/><link name="body"><inertial><origin xyz="0.3 0 0"/>'
        '<mass value="2"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="joint" type="continuous"><parent link="ground"/><child link="body"/><axis xyz="0 1 0"/>'
        '<dynamics damping="0.1"/></joint></robot>'
    )
    _, simulation = loaded(path)
    search = search_settings(simulation, relative(1e-6))
    assert [need.elements for need in search.needs] == [("damping of joint 'joint'",)]
    assert any("damping of joint 'joint'" in str(part) for part in search_report("arm", search).parts)
    found = search.found
    assert found is not None
    (tmp_path / "own.yaml").write_text(found.fragment)
    _, again = loaded(path, own_run=str(tmp_path / "own.yaml"))
    assert again.evaluations(again.settings) == found.evaluations
    assert judge(again).error.relative == pytest.approx(found.error.relative, rel=0.5)  # at other times


def test_run_times_are_multiples_of_evaluations_if_the_own_run_diverges(tmp_path, monkeypatch):
    """A run that stops after some steps has a short run time, which says nothing about others."""
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warnings into a file there
    path = tmp_path / "model.xml"
    path.write_text(STIFF)
    _, simulation = loaded(path)
    search = search_settings(simulation, relative(TARGET))
    assert "QACC" in search.own.stopped
    assert search.tradeoff
    for tried in search.tradeoff:
        assert tried.run_time == pytest.approx(tried.evaluations / search.own.evaluations, rel=1e-12)


def test_command(capsys, tmp_path):
    path, out = tmp_path / "model.xml", tmp_path / "out"
    path.write_text(GYROSCOPE)
    limits = [word for key, value in OPTIONS.items() for word in ("--set", f"{key}={value}")]
    status, text, _ = run(capsys, "tune", path, *limits, "--output", out)
    assert status == 0
    assert verdict_of(text).startswith('REACHED: timestep="')
    assert '<option timestep="' in text
    result = json.loads((out / "tune.json").read_text())
    assert result["found"] == result["tradeoff"][-1]
    assert result["own"]["run_time"] == 1.0
    assert result["report"]["verdict"].startswith("REACHED")


@pytest.mark.slow
def test_python_finds_what_the_command_finds(capsys, tmp_path):
    path, out = tmp_path / "model.xml", tmp_path / "out"
    path.write_text(FOUR_BAR)
    limits = [word for key, value in OPTIONS.items() for word in ("--set", f"{key}={value}")]
    run(capsys, "tune", path, *limits, "--error", "1e-2", "--output", out)
    command = json.loads((out / "tune.json").read_text())
    tuning = crosscheck.tune(path, 1e-2, duration=0.5, output_period=0.01)
    assert isinstance(tuning, crosscheck.Tuning)
    assert tuning.found.fragment == command["found"]["fragment"]
    assert dict(tuning.found.changes) == command["found"]["changes"]
    assert tuning.found.error.relative == command["found"]["error"]["relative_rotation"] <= 1e-2
    assert tuning.own.error.position == command["own"]["error"]["position"]
    assert [each.evaluations for each in tuning.tradeoff] == [e["evaluations"] for e in command["tradeoff"]]
    assert repr(tuning) == f"<{command['report']['verdict']}>"
    assert tuning.found.fragment in str(tuning)
    assert "REACHED" in tuning._repr_html_()


@pytest.mark.parametrize("read", [mujoco.MjModel.from_xml_string, mujoco.MjSpec.from_string])
def test_models_in_memory(read):
    tuning = crosscheck.tune(read(GYROSCOPE), TARGET, duration=0.5)
    assert tuning.found.changes["integrator"] == "RK4"  # the others are of order 1
    assert tuning.found.error.relative <= TARGET < tuning.own.error.relative


@pytest.mark.parametrize(
    ("model", "options", "message"),
    [
        ("pendulum", {}, "pendulum has no settings of an engine; needed: an MJCF or URDF model"),
        (
            GYROSCOPE,
            {"error": 0.0},
            "error 0.0: needed: a number above 0",
        ),
        (
            GYROSCOPE,
            {"error": 1.0},
            "error 1.0: needed: a fraction of the motion below 1, such as 1e-3 or 0.1%",
        ),
        (
            GYROSCOPE,
            {"error": "1mm"},
            "error 1mm: no unit 'mm' of relative; choose from %; for a length",
        ),
        (GYROSCOPE, {"nix": 1}, "no option 'nix'; choose from: duration, output_period"),
    ],
)
def test_wrong_arguments_are_one_line(model, options, message):
    given = model if model == "pendulum" else mujoco.MjModel.from_xml_string(model)
    with pytest.raises((CrosscheckError, NewtonEulerError)) as raised:
        crosscheck.tune(given, **options)
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)


def test_an_error_that_cannot_be_reached(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(tuning, "MAX_COST", 4.0)
    path = tmp_path / "model.xml"
    path.write_text(GYROSCOPE)
    status, text, _ = run(capsys, "tune", path, "--error", "1e-9", "--output", tmp_path / "out")
    assert status == ExitStatus.INACCURATE
    assert verdict_of(text).startswith("NOT REACHED: the smallest error is ")


def test_scenes_without_an_engine_of_their_own_are_refused(capsys, tmp_path):
    status, out, err = run(capsys, "tune", "pendulum", "--output", tmp_path / "out")
    assert (status, out) == (2, "")
    assert "pendulum has no settings of an engine; needed: an MJCF or URDF model" in err


def test_equalities_of_included_files(tmp_path):
    (tmp_path / "loops.xml").write_text(
        '<mujocoinclude><equality><joint joint1="a" joint2="b" solimp="0.9 0.9 0.001"/></equality>'
        "</mujocoinclude>"
    )
    path = tmp_path / "model.xml"
    path.write_text(CLASS_SOFTNESS.replace("<worldbody>", '<include file="loops.xml"/><worldbody>'))
    assert equalities_with_own_softness(str(path)) == ("connect 'tip'", "joint 2")


POLYNOMIAL = """<mujoco model="sprung"><option timestep="0.0005" integrator="RK4"/><worldbody>
  <body pos="0 0 1">
  <joint name="h" axis="0 1 0" stiffness="5 1 2" damping="0.1 0.05 0.1"/>
  <geom type="capsule" fromto="0 0 0 .5 0 0" size=".02" contype="0"/></body></worldbody></mujoco>"""
"""A spring whose stiffness depends on the angle, which the reference does not simulate."""


def test_what_acts_and_is_not_simulated_is_left_out_of_all_runs(tmp_path, capsys):
    (tmp_path / "sprung.xml").write_text(POLYNOMIAL)
    folder = tmp_path / "out"
    arguments = (str(tmp_path / "sprung.xml"), "--set", "excitation=off", "--error", "1e-3")
    status, _, _ = run(capsys, "tune", *arguments, "--output", str(folder))
    found = json.loads((folder / "tune.json").read_text())
    assert status == ExitStatus.AGREE
    assert found["events"]
    # RK4 at 0.5 ms is accurate, but for the spring; a few runs find a longer step
    assert found["own"]["error"]["relative_rotation"] < 1e-6
    assert found["runs"] < 30


def test_an_error_can_be_a_length(tmp_path, capsys):
    path = tmp_path / "model.xml"
    path.write_text(FOUR_BAR)
    limits = [word for key, value in OPTIONS.items() for word in ("--set", f"{key}={value}")]
    arguments = ["tune", path, *limits, "--error", "position=1mm", "--output", tmp_path / "out"]
    status, text, _ = run(capsys, *arguments)
    assert status == ExitStatus.AGREE
    found = json.loads((tmp_path / "out" / "tune.json").read_text())
    assert found["target"] == {"kind": "position", "largest": 1e-3}
    assert found["found"]["error"]["largest_position"] <= 1e-3
    # the cheaper settings in the table do not reach it
    assert all(each["error"]["largest_position"] > 1e-3 for each in found["tradeoff"][:-1])
    assert " for an error of 1 mm (position)" in text
    # the settings of the file are in the table twice, and have one run time
    assert {each["run_time"] for each in found["tradeoff"] if not each["changes"]} <= {1.0}


def test_an_error_needs_a_loop_of_its_kind(tmp_path):
    path = tmp_path / "model.xml"
    path.write_text(PENDULUM)
    _, simulation = loaded(path)
    with pytest.raises(CrosscheckError, match="no loops"):
        search_settings(simulation, AllowedError(ErrorKind.OPENING, 1e-3))


def test_the_search_is_of_the_file_as_it_stands_until_a_limit_acts(tmp_path):
    path = tmp_path / "model.xml"
    path.write_text(PENDULUM.replace('name="hinge" axis', 'name="hinge" range="-60 80" limited="true" axis'))
    scene, report = load_scene(str(path), OPTIONS)
    acting = acting_in(scene, report)
    search = search_settings(report.simulation, relative(TARGET), acting)
    assert [event.element for event in search.events] == ["limits of joint 'hinge'"]
    assert search.until == acting[0].time < scene.duration
    # the judgement of the file has the same error
    assert search.own.error == judge(report.simulation, acting).error
    assert search_report("model", search).verdict.startswith(f"REACHED until {search.until:.3g} s: ")


def test_errors_that_the_target_does_not_limit_are_reported(tmp_path):
    """A tolerance of 20 mm permits steps with 1 % of the motion and more, and a larger error of energy."""
    path = tmp_path / "model.xml"
    path.write_text(PENDULUM)
    _, report = load_scene(str(path), OPTIONS)
    search = search_settings(report.simulation, AllowedError(ErrorKind.POSITION, 0.02))
    assert search.own.error.relative < 0.01 < search.found.error.relative
    assert search.found.error.energy > 1.1 * search.own.error.energy
    lines = [part for part in search_report("model", search).parts if isinstance(part, Lines)]
    notes = [line for part in lines for line in part.lines if line.startswith("note")]
    assert len(notes) == 2
    assert f"{percent(search.found.error.relative)} of the motion" in notes[0]
    assert f"energy {in_unit(search.found.error.energy, ErrorKind.ENERGY)}, yours" in notes[1]


STOPPED = """<mujoco model="block"><option timestep="0.002" gravity="0 0 0"/><worldbody><body name="block">
  <joint name="rail" type="slide" axis="1 0 0" range="-0.1 0.1"/>
  <geom size="0.1" mass="3" contype="0"/></body></worldbody>
  <keyframe><key name="go" qvel="1"/></keyframe></mujoco>"""
"""A block that hits a limit, whose stop as a force differs from MuJoCo's constraint by millimeters."""


def test_settings_that_cannot_reach_the_error_are_given_up_with_the_reason(tmp_path):
    path = tmp_path / "model.xml"
    path.write_text(STOPPED)
    scene, report = load_scene(str(path), {"duration": "0.15", "limits": "compliant", "excitation": "off"})
    assert acting_in(scene, report) == []
    search = search_settings(report.simulation, relative(TARGET))
    assert (search.found, search.has_converged) == (None, True)
    assert search.runs < 100
    text = search_report("block", search).verdict
    reason = (
        "smaller steps do not reduce it, because limits of joint 'rail' as forces differ from constraints"
    )
    assert reason in text
    assert search.stiffer_limits == "solreflimit=\"0.004 1\" in joint 'rail'"  # two steps
    assert search.stiffer_limits in text
    # the judgement has no settings either, and the smallest error that it found
    judgement = judge(report.simulation)
    assert judgement.remedies == ()
    best = min(each.error.relative for each in search.tradeoff)  # of more settings
    smallest, own = judgement.smallest.relative, judgement.error.relative
    assert best <= smallest <= own < 2.0 * smallest
    (fix,) = (line for line in own_run_lines(judgement)[0].lines if line.split()[0] == "fix")
    assert judgement.stiffer_limits in fix
    assert not judgement.have_one_error  # most of the error is that of the limit
    # with this change of the file
    path.write_text(STOPPED.replace("range=", 'solreflimit="0.004 1" range='))
    _, report = load_scene(str(path), {"duration": "0.15", "limits": "compliant", "excitation": "off"})
    stiffer = judge(report.simulation)
    assert stiffer.stiffer_limits == ""
    assert stiffer.error.relative < own
    assert "none: no settings that were tried halve the error" in fix
