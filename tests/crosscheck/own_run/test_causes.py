"""Models in which one setting is made wrong on purpose: the judgement names that setting."""

from __future__ import annotations

import re

import mujoco
import numpy as np
import pytest
from mjcf_models import FOUR_BAR_BODIES
from own_runs import judged_run

from crosscheck.loading.load import load_scene, with_excitation
from crosscheck.own_run.errors import Band
from crosscheck.own_run.judge import judge
from crosscheck.report.own_run import own_run_lines
from mjcf.errors import collected_warnings

FOUR_BAR = f"""<mujoco><option timestep="0.0005" integrator="RK4" iterations="100"/>
  <default><equality solref="0.001 1" solimp="0.9999 0.9999 0.001"/></default><worldbody>
{FOUR_BAR_BODIES}</worldbody>
  <equality><connect body1="coupler" body2="rocker" anchor="0.25 0 0.1"/></equality></mujoco>"""

PENDULUMS = """<mujoco><option timestep="0.0005" integrator="RK4" iterations="100"/>
  <default><equality solref="0.001 1" solimp="0.9999 0.9999 0.001"/></default><worldbody>
  <body name="upper" euler="0 40 0"><joint name="a" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.01" mass="0.4" contype="0"/>
    <body name="lower" pos="0 0 -0.3"><joint name="b" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.01" mass="0.2" contype="0"/></body></body>
  </worldbody></mujoco>"""

HANGING = PENDULUMS.replace(
    "</worldbody>",
    '<body name="weight" pos="0 0.1 0"><joint name="z" type="slide" axis="0 0 1"/>'
    '<geom size="0.05" mass="5" contype="0"/></body></worldbody><equality><joint joint1="z" joint2="a" '
    'polycoef="0 0.1 0 0 0"/></equality>',
)

SERVO = """<mujoco><option timestep="0.0005" integrator="implicitfast" iterations="100"/><worldbody>
  <body name="arm" euler="0 40 0"><joint name="a" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.01" mass="0.4" contype="0"/></body></worldbody>
  <actuator><position name="servo" joint="a" kp="20" kv="5"/></actuator></mujoco>"""

GYROSCOPE = """<mujoco><option timestep="0.0005" integrator="RK4" gravity="0 0 0"/><worldbody>
  <body name="hull"><freejoint/><inertial pos="0 0 0" mass="0.12" diaginertia="18e-5 1.65e-5 18e-5"/></body>
  </worldbody><keyframe><key name="go" qvel="0 0 0 3 60 2"/></keyframe></mujoco>"""


def wrong(text, **values):
    """Change attributes of a model."""
    for name, value in values.items():
        text, count = re.subn(rf'{name}="[^"]*"', f'{name}="{value}"', text)
        assert count
    return text


CASES = {
    "step of a four-bar": (wrong(FOUR_BAR, timestep="0.02"), "time step"),
    "step of pendulums": (wrong(PENDULUMS, timestep="0.1"), "time step"),
    "step of a gyroscope": (wrong(GYROSCOPE, timestep="0.008"), "time step"),
    "softness of a four-bar": (wrong(FOUR_BAR, solref="0.2 1"), "soft constraints"),
    "impedance of a four-bar": (wrong(FOUR_BAR, solref="0.05 1", solimp="0.5 0.6 0.001"), "soft constraints"),
    "softness of a coupling": (wrong(HANGING, solref="0.05 1"), "soft constraints"),
    "one iteration": (wrong(FOUR_BAR, iterations='1" solver="PGS'), "solver iterations"),
    "one iteration of a coupling": (wrong(HANGING, iterations='1" solver="CG'), "solver iterations"),
    "Euler with a stiff damper": (wrong(SERVO, integrator="Euler", timestep="0.004"), "integrator"),
    "Euler of a gyroscope": (wrong(GYROSCOPE, integrator="Euler"), "integrator"),
}


def judged(tmp_path, text):
    path = tmp_path / "model.xml"
    path.write_text(text)
    return judged_run(*load_scene(str(path), with_excitation(str(path), {})))


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_cause(tmp_path, name):
    text, cause = CASES[name]
    found = judged(tmp_path, text)
    assert found.band is not Band.ACCURATE
    assert found.causes[0].name == cause, [(each.name, each.error.relative) for each in found.causes]
    assert found.remedies
    assert all(each.error.relative < found.error.relative for each in found.remedies)


@pytest.mark.parametrize("solver", ["Newton", "CG", "PGS"])
def test_a_file_runs_with_its_own_solver(tmp_path, solver):
    """Plain MuJoCo makes the same run of a file, and another one with any other solver."""
    path = tmp_path / "model.xml"
    path.write_text(wrong(FOUR_BAR, iterations=f'2" tolerance="0" solver="{solver}'))
    _, report = load_scene(str(path), {"excitation": "off"})
    simulation = report.simulation
    settings = simulation.settings
    assert (settings.solver, settings.iterations, settings.tolerance) == (solver, 2, 0.0)
    assert (f"solver {solver}" in simulation.words()) == (solver != "Newton")
    found = simulation.run(settings, 100, 100).trajectory
    for name in ("NEWTON", "CG", "PGS"):
        model = mujoco.MjModel.from_xml_path(str(path))
        model.opt.solver = getattr(mujoco.mjtSolver, f"mjSOL_{name}")
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, 100)
        mujoco.mj_kinematics(model, data)
        apart = np.max(
            np.abs(found.position[-1, 1:] - [data.body(body).xipos for body in found.body_names[1:]])
        )
        assert apart < 1e-12 if name == solver.upper() else apart > 1e-10, name


SLEEPING = """<mujoco><option timestep="0.002" gravity="0 0 0" integrator="RK4">
  <flag sleep="enable"/></option><worldbody><body pos="0 0 1">
  <joint axis="0 1 0" stiffness=".0001" springref="3"/>
  <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass="1"/></body></worldbody></mujoco>"""


@pytest.fixture
def sleeping(tmp_path):
    """A pendulum that a weak spring moves so slowly that MuJoCo lets it sleep."""
    path = tmp_path / "sleeping.xml"
    path.write_text(SLEEPING)
    _, report = load_scene(str(path), {"excitation": "off"})
    assert report is not None
    return report.simulation


def test_sleep_is_a_cause_and_its_end_a_fix(sleeping, tmp_path):
    found = judge(sleeping)
    assert (found.causes[0].name, found.is_explained) == ("sleep", True)
    assert "sleep" in found.settings.split(", ")
    remedy = found.remedies[0]
    assert remedy.changes == {"sleep": "disable"}
    assert remedy.error.relative < 1e-6 * found.error.relative
    fragment = '<option><flag sleep="disable"/></option>'
    assert remedy.fragment == fragment
    awake = SLEEPING.replace('<flag sleep="enable"/>', "").replace("<worldbody>", f"{fragment}<worldbody>")
    assert judged(tmp_path, awake).settings == "RK4, 2 ms"


def test_an_error_without_a_tested_cause_is_unexplained(sleeping, monkeypatch):
    causes = [cause for cause in sleeping.causes() if cause.name != "sleep"]
    monkeypatch.setattr(sleeping, "causes", lambda: iter(causes))
    found = judge(sleeping)
    assert not found.is_explained
    (line,) = (line for line in own_run_lines(found)[0].lines if line.split()[0] == "cause")
    assert "unexplained" in line


ARM = """<mujoco><option timestep="0.002" integrator="Euler"/><worldbody>
  <body name="arm" euler="0 40 0"><joint name="a" axis="0 1 0" damping="0.05"/>
    <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.01" mass="0.4" contype="0"/>
    <body name="tip" pos="0.3 0 0"><joint name="b" axis="0 1 0" stiffness="1" damping="0.02"/>
      <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.01" mass="0.2" contype="0"/></body></body>
  </worldbody><tendon><fixed name="belt" stiffness="2"><joint joint="b" coef="1"/></fixed></tendon>
  <actuator><position name="shoulder" joint="a" kp="20" kv="0.5"/>
    <position name="elbow" joint="b" kp="5" kv="0.1"/></actuator></mujoco>"""

PINNED = """<mujoco><option timestep="0.002" integrator="Euler"/>
  <default><equality solref="0.01 1"/></default><worldbody><body name="crank"><joint name="a" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0.1 0 0" size="0.01" mass="0.3" contype="0"/></body>
  <body name="coupler" pos="0.1 0 0"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
    <joint name="b" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0.25 0 0.1" size="0.01" mass="10" contype="0"/></body>
  <body name="rocker" pos="0.35 0 -0.1"><joint name="c" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0 0 0.2" size="0.01" mass="0.4" contype="0"/></body></worldbody>
  <equality><connect name="pin" body1="crank" body2="coupler" anchor="0.1 0 0"/>
    <connect name="loop" body1="coupler" body2="rocker" anchor="0.25 0 0.1"/></equality>
  <actuator><position name="drive" joint="a" kp="20" kv="1"/></actuator></mujoco>"""

FAULTS = {
    "gain by position": (ARM.replace('kp="5"', 'kp="20000"'), "kp of actuator 'elbow'", "tip"),
    "gain by velocity": (ARM.replace('kv="0.5"', 'kv="400"'), "kv of actuator 'shoulder'", None),
    "gain by velocity in RK4": (
        wrong(ARM.replace('kv="0.5"', 'kv="400"'), integrator="RK4"),
        "kv of actuator 'shoulder'",
        None,
    ),
    "joint spring": (
        wrong(ARM, integrator="implicitfast").replace('stiffness="1"', 'stiffness="8000"'),
        "stiffness of joint 'b'",
        "tip",
    ),
    "tendon spring": (ARM.replace('stiffness="2"', 'stiffness="8000"'), "stiffness of tendon 'belt'", "tip"),
    "light body": (ARM.replace('mass="0.2"', 'mass="1e-4"'), "actuator 'elbow'", "tip"),
    "light body in a loop": (PINNED.replace('mass="0.3"', 'mass="1e-4"'), "actuator 'drive'", "crank"),
    "stiff loop": (
        PINNED.replace('anchor="0.1 0 0"/>', 'anchor="0.1 0 0" solref="-4000000 -1000"/>'),
        "equality 'pin'",
        None,
    ),
    "damped loop": (
        PINNED.replace('anchor="0.25 0 0.1"/>', 'anchor="0.25 0 0.1" solref="-10000 -2000"/>'),
        "equality 'loop'",
        None,
    ),
    "loop shorter than two steps": (
        PINNED.replace('anchor="0.25 0 0.1"/>', 'anchor="0.25 0 0.1" solref="0.0005 1"/>').replace(
            "<option", '<option><flag refsafe="disable"/></option><option'
        ),
        "equality 'loop'",
        None,
    ),
}
"""Models that explode: the element that makes the mode, and the body that moves, if there is only one."""


@pytest.mark.parametrize("name", FAULTS)
def test_element_at_fault(tmp_path, name):
    text, element, body = FAULTS[name]
    found = judged(tmp_path, text)
    assert found.stopped
    assert found.stability is not None
    assert element in found.stability.elements[0].name, found.stability
    assert body in (None, found.stability.body.name)
    assert not found.stability.is_stable
    assert found.stability.limit_without > found.stability.timestep
    # steps below the limit bring the run back in plain MuJoCo, steps far above it do not
    assert completes(text, 0.9 * found.stability.limit)
    assert not completes(text, 3.0 * found.stability.limit)
    assert found.causes[0].brings_back
    assert found.remedies
    assert all(completes(pasted(text, each.fragment)) for each in found.remedies)
    assert found.changes or "equality" in element


def test_neighbor_of_a_light_body(tmp_path):
    found = judged(tmp_path, FAULTS["light body in a loop"][0])
    assert found.stability is not None
    assert found.stability.body.neighbor == "coupler"
    assert found.stability.body.neighbor_mass == pytest.approx(10.0)


def pasted(text, fragment):
    """Put the fragment of a remedy into a model."""
    for name, value in re.findall(r'(timestep|integrator)="([^"]*)"', fragment):
        text = wrong(text, **{name: value})
    for name, value in re.findall(r'(solref|solimp)="([^"]*)"', fragment):
        text = re.sub(rf'(<connect [^>]*?) {name}="[^"]*"', r"\1", text)
        text = text.replace("<connect", f'<connect {name}="{value}"')
    return text


def completes(text, timestep=None):
    """Return whether MuJoCo simulates a model for 1 s without a warning and without huge velocities."""
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep = timestep or model.opt.timestep
    data = mujoco.MjData(model)
    data.qvel[:] = 0.1
    with collected_warnings(data) as warnings:
        for _ in range(100):
            mujoco.mj_step(model, data, max(1, int(0.01 / model.opt.timestep)))
            if warnings or np.max(np.abs(data.qvel)) > 1e3:
                return False
    return True
