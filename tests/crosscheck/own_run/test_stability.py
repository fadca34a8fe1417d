"""Stability limits of time steps, against those of textbooks."""

from __future__ import annotations

import math

import numpy as np
import pytest

from crosscheck.loading.load import load_scene
from crosscheck.own_run.stability import MAX_GROWTH, ModeAtFault

STEP, DURATION = 0.001, 1.0
MASS = 2.0  # kg
PERCENT = 0.02
"""Largest difference between the measured and the known limit, relative; bisection ends at 1 %."""

SLIDE = """<mujoco><option timestep="{step}" integrator="{integrator}" gravity="0 0 0"/><worldbody>
  <body name="mass"><joint name="slide" type="slide" axis="1 0 0" stiffness="{stiffness}"
  damping="{damping}"/>
    <inertial pos="0 0 0" mass="2" diaginertia="0.1 0.1 0.1"/></body></worldbody>{more}</mujoco>"""

SERVO = '<actuator><position joint="slide" kp="{kp}" kv="{kv}"/></actuator>'

HOLD = """<default><equality solimp="0.9 0.9 0.001" solref="{solref}"/></default>
  <equality><joint joint1="slide"/></equality>"""

FILTER = """<actuator><general name="valve" joint="slide" dyntype="{dynamics}" dynprm="{tau}"
  gainprm="1"/></actuator><keyframe><key name="go" ctrl="1" act="{act}"/></keyframe>"""

TOP = """<mujoco><option timestep="0.0005" integrator="{integrator}" gravity="0 0 0"/><worldbody>
  <body name="top"><joint name="ball" type="ball"/>
    <inertial pos="0 0 0" mass="1" diaginertia="0.03 0.03 0.05"/></body></worldbody>
  <keyframe><key name="go" qvel="1 0 60"/></keyframe></mujoco>"""


def small_motions(tmp_path, text):
    path = tmp_path / "model.xml"
    path.write_text(text)
    _, report = load_scene(str(path), {"duration": str(DURATION)})
    assert report is not None
    simulation = report.simulation
    assert simulation is not None
    motions = simulation.small_motions(simulation.run(simulation.settings, 1, 1, True), [0])
    assert motions is not None
    return motions, simulation.settings


def mode(tmp_path, text):
    motions, settings = small_motions(tmp_path, text)
    return ModeAtFault(motions, settings, settings.timestep, DURATION)


def slide(tmp_path, integrator="Euler", stiffness=0.0, damping=0.0, more=""):
    return mode(
        tmp_path,
        SLIDE.format(step=STEP, integrator=integrator, stiffness=stiffness, damping=damping, more=more),
    )


@pytest.mark.parametrize("frequency", [50.0, 5000.0])
@pytest.mark.parametrize(
    ("integrator", "limit"),
    [("Euler", 2.0), ("implicit", 2.0), ("implicitfast", 2.0), ("RK4", 2.0 * math.sqrt(2.0))],
)
def test_limit_of_an_oscillator(tmp_path, integrator, limit, frequency):
    found = slide(tmp_path, integrator, stiffness=MASS * frequency**2).found
    assert found.rate == pytest.approx(frequency, rel=1e-6)
    assert found.limit == pytest.approx(limit / frequency, rel=PERCENT)
    assert found.is_stable is (limit / frequency > STEP)
    assert found.elements[0].name == "stiffness of joint 'slide'"
    assert found.body.name == "mass"


@pytest.mark.parametrize(("integrator", "limit"), [("Euler", 2.0), ("RK4", 2.7853)])
def test_limit_of_an_explicit_damper(tmp_path, integrator, limit):
    damping = 8000.0
    found = slide(tmp_path, integrator, more=SERVO.format(kp=0.01, kv=damping)).found
    assert found.rate == pytest.approx(damping / MASS, rel=1e-3)
    assert found.limit == pytest.approx(limit * MASS / damping, rel=PERCENT)
    assert [each.name for each in found.elements] == ["kv of actuator 0"]


def test_implicit_dampers_have_no_limit(tmp_path):
    assert slide(tmp_path, "Euler", damping=8000.0).found.limit == math.inf
    assert slide(tmp_path, "implicitfast", more=SERVO.format(kp=0.01, kv=8000.0)).found.limit == math.inf


def test_limit_of_an_oscillator_with_an_explicit_damper(tmp_path):
    """Semi-implicit Euler with explicit forces: m^2 - (2 - h c - h^2 k) m + 1 - h c = 0 has m = -1."""
    stiffness, damping = 4e6, 1500.0  # of a mass of 1 kg
    more = SERVO.format(kp=MASS * stiffness, kv=MASS * damping)
    limit = (-damping + math.sqrt(damping**2 + 4.0 * stiffness)) / stiffness
    assert slide(tmp_path, more=more).found.limit == pytest.approx(limit, rel=PERCENT)


@pytest.mark.parametrize(("dynamics", "limit"), [("filter", 2.0), ("filterexact", math.inf)])
def test_limit_of_a_filter(tmp_path, dynamics, limit):
    time_constant = 0.0004  # s
    found = slide(
        tmp_path, damping=1.0, more=FILTER.format(dynamics=dynamics, tau=time_constant, act=1.0)
    ).found
    assert found.rate == pytest.approx(1.0 / time_constant, rel=1e-6)
    assert found.limit == pytest.approx(limit * time_constant, rel=PERCENT)
    assert [(each.name, each.value) for each in found.elements] == [
        ("time constant of actuator 'valve'", time_constant)
    ]
    assert found.body.name == "mass"


def test_a_filter_that_is_not_simulated_has_no_mode(tmp_path):
    # the control differs from the activation, so that the scene does not have the actuator
    found = slide(tmp_path, damping=1.0, more=FILTER.format(dynamics="filter", tau=0.0004, act=0.5)).found
    assert found.rate == pytest.approx(1.0 / MASS, rel=1e-6)
    assert found.limit == math.inf
    assert found.body.name == "mass"


def test_limit_of_a_constraint_in_direct_format(tmp_path):
    """A soft constraint is an explicit spring and damper of unit mass (MuJoCo's page Computation)."""
    stiffness, damping = 4e6, 1500.0
    found = slide(tmp_path, more=HOLD.format(solref=f"-{stiffness} -{damping}")).found
    limit = (-damping + math.sqrt(damping**2 + 4.0 * stiffness)) / stiffness
    assert found.limit == pytest.approx(limit, rel=PERCENT)
    assert found.elements[0].is_constraint


def test_constraints_in_standard_format_have_no_limit(tmp_path):
    assert slide(tmp_path, more=HOLD.format(solref="0.0001 1")).found.limit == math.inf


def test_limit_of_a_top(tmp_path):
    """Explicit gyroscopic forces multiply the precession w in the body by |1 + i h w| in each step."""
    found = mode(tmp_path, TOP.format(integrator="Euler")).found
    precession = 60.0 * (0.05 / 0.03 - 1.0)
    growth = 0.5 * math.log(1.0 + (found.limit * precession) ** 2) / found.limit * DURATION
    assert growth == pytest.approx(math.log(MAX_GROWTH), rel=PERCENT)
    # a name in the singular, as of all elements: the sentence is "... makes a mode"
    assert [each.name for each in found.elements] == ["gyroscopic effect of the motion"]
    assert mode(tmp_path, TOP.format(integrator="implicit")).found.limit == math.inf


def test_small_motions_after_one_step(tmp_path):
    """Semi-implicit Euler steps of an oscillator with frequency w: v + h (-w^2 x), then x + h v."""
    frequency = 50.0
    text = SLIDE.format(step=STEP, integrator="Euler", stiffness=MASS * frequency**2, damping=0.0, more="")
    motions, settings = small_motions(tmp_path, text)
    map_of_step = np.array([[1.0 - (STEP * frequency) ** 2, STEP], [-STEP * frequency**2, 1.0]])
    start = np.array([[1.0, 0.5], [2.0, -1.0]])
    # central differences of 1e-6 have a relative round-off of about 1e-10
    assert motions.step(0, settings) == pytest.approx(map_of_step, rel=1e-8, abs=1e-8)
    after = motions.step(0, settings, start=start)
    assert after == pytest.approx(map_of_step @ start, rel=1e-8)
    free = motions.step(0, settings, without=(0,), start=start)
    assert free == pytest.approx(np.array([[1.0, STEP], [0.0, 1.0]]) @ start, rel=1e-8)


def test_shape_of_a_mode(tmp_path):
    found = slide(tmp_path, stiffness=50.0)
    assert found.shape.shape == (1,)
    assert np.abs(found.shape[0]) > 0.0
