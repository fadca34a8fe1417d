"""Models in which one setting is made wrong on purpose: the judgement names that setting."""

from __future__ import annotations

import re

import pytest

from crosscheck.loading.load import load_scene, with_excitation
from crosscheck.own_run.errors import Band
from crosscheck.own_run.judge import judge

FOUR_BAR = """<mujoco><option timestep="0.0005" integrator="RK4" iterations="100"/>
  <default><equality solref="0.001 1" solimp="0.9999 0.9999 0.001"/></default><worldbody>
  <body name="crank"><joint name="a" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0.1 0 0" size="0.01" mass="0.3" contype="0"/>
    <body name="coupler" pos="0.1 0 0"><joint name="b" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0.25 0 0.1" size="0.01" mass="0.5" contype="0"/></body></body>
  <body name="rocker" pos="0.35 0 -0.1"><joint name="c" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0 0 0.2" size="0.01" mass="0.4" contype="0"/></body></worldbody>
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
    "step of a four-bar": (wrong(FOUR_BAR, timestep="0.005", integrator="implicitfast"), "time step"),
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


@pytest.mark.parametrize("name", CASES)
def test_cause(tmp_path, name):
    text, cause = CASES[name]
    path = tmp_path / "model.xml"
    path.write_text(text)
    _, report = load_scene(str(path), with_excitation(str(path), {}))
    assert report is not None
    assert report.simulation is not None
    found = judge(report.simulation)
    assert found.band is not Band.ACCURATE
    assert found.causes[0].name == cause, [(each.name, each.error.relative) for each in found.causes]
    assert found.remedies
    assert all(each.error.relative < found.error.relative for each in found.remedies)
