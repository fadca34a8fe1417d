"""Errors that the judgement of a file's run reports, against the known errors of each integrator."""

from __future__ import annotations

import re

import mujoco
import numpy as np
import pytest
from own_runs import judged_run

from crosscheck.loading.load import load_scene
from crosscheck.own_run.horizon import MAX_ERROR_GROWTH
from crosscheck.own_run.judge import horizons, judge

STEP, DURATION = 0.004, 1.0
FREQUENCY = 5.0  # rad/s, of the oscillator
DAMPING = 1.5  # N s/m
SPEED = 0.7  # m/s or rad/s, at the start
PERCENT = 0.01
"""Largest difference between the reported and the known error, relative."""

OSCILLATOR = """<mujoco><option timestep="{step}" integrator="{integrator}" gravity="0 0 0"/><worldbody>
  <body name="mass"><joint name="slide" type="slide" axis="1 0 0" stiffness="{stiffness}"
  damping="{damping}"/>
    <inertial pos="0 0 0" mass="2" diaginertia="0.1 0.1 0.1"/></body></worldbody>
  <keyframe><key name="go" qvel="{speed}"/></keyframe></mujoco>"""

FALLING = """<mujoco><option timestep="{step}" integrator="{integrator}"/><worldbody>
  <body name="stone"><freejoint/><inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/></body></worldbody>
  <keyframe><key name="go" qvel="0.1 0 0 0 0 0"/></keyframe></mujoco>"""

TOP = """<mujoco><option timestep="{step}" integrator="{integrator}" gravity="0 0 0"/><worldbody>
  <body name="top"><joint name="ball" type="ball"/>
    <inertial pos="0 0 0" mass="1" diaginertia="0.03 0.03 0.05"/></body></worldbody>
  <keyframe><key name="go" qvel="1 0 6"/></keyframe></mujoco>"""


def judged(tmp_path, text, **values):
    path = tmp_path / "model.xml"
    path.write_text(text.format(step=STEP, **values))
    return judged_run(*load_scene(str(path), {"duration": str(DURATION)}))


def semi_implicit(x, v, stiffness, damping, mass):
    """MuJoCo's Euler, implicit and implicitfast on one slide: implicit dampers, explicit springs."""
    while True:
        yield x
        v = (mass * v - STEP * stiffness * x) / (mass + STEP * damping)
        x += STEP * v


def runge_kutta(x, v, stiffness, damping, mass):
    matrix = np.array([[0.0, 1.0], [-stiffness / mass, -damping / mass]])
    powers = [np.linalg.matrix_power(STEP * matrix, k) for k in range(5)]
    step = sum(power / [1.0, 1.0, 2.0, 6.0, 24.0][k] for k, power in enumerate(powers))
    state = np.array([x, v])
    while True:
        yield state[0]
        state = step @ state


@pytest.mark.parametrize("damping", [0.0, DAMPING])
@pytest.mark.parametrize("integrator", ["Euler", "implicit", "implicitfast", "RK4"])
def test_error_of_an_oscillator(tmp_path, integrator, damping):
    method = runge_kutta if integrator == "RK4" else semi_implicit
    mass = 2.0
    stiffness = mass * FREQUENCY**2
    found = judged(
        tmp_path, OSCILLATOR, integrator=integrator, stiffness=stiffness, damping=damping, speed=SPEED
    )
    times = found.reference.time
    every = round(times[1] / STEP)
    decay = 0.5 * damping / mass
    frequency = np.sqrt(FREQUENCY**2 - decay**2)
    exact = SPEED / frequency * np.exp(-decay * times) * np.sin(frequency * times)
    numeric = method(0.0, SPEED, stiffness, damping, mass)
    states = np.array([next(numeric) for _ in range(every * (len(times) - 1) + 1)])[::every]
    expected = np.max(np.abs(states - exact))
    assert found.error.position == pytest.approx(expected, rel=PERCENT)
    assert found.error.relative == pytest.approx(expected / np.max(np.abs(exact)), rel=PERCENT)


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast"])
def test_error_of_a_fall(tmp_path, integrator):
    # after n steps the stone has fallen by g h^2 n (n + 1) / 2 instead of g (n h)^2 / 2
    found = judged(tmp_path, FALLING, integrator=integrator)
    assert found.error.position == pytest.approx(0.5 * 9.81 * STEP * found.reference.time[-1], rel=PERCENT)
    assert found.error.position_at[0] == "stone"


def test_error_of_a_free_top(tmp_path):
    """Euler's equations by explicit steps, and orientations by exact rotations of each step."""
    inertia = np.array([0.03, 0.03, 0.05])
    found = judged(tmp_path, TOP, integrator="Euler")
    times = found.reference.time
    spin, turn = np.array([1.0, 0.0, 6.0]), np.eye(3)
    # the exact motion: a turn about the axis of angular momentum, and one about the axis of symmetry
    momentum = inertia * spin
    about_momentum = momentum / inertia[0]
    about_axis = np.array([0.0, 0.0, spin[2] * (1.0 - inertia[2] / inertia[0])])
    every, worst = round(times[1] / STEP), 0.0
    for k in range(every * (len(times) - 1) + 1):
        if k % every == 0:
            now = k * STEP
            exact = rotation(about_momentum * now) @ rotation(about_axis * now)
            cosine = 0.5 * (np.trace(exact.T @ turn) - 1.0)
            worst = max(worst, float(np.arccos(np.clip(cosine, -1.0, 1.0))))
        spin = spin - STEP * np.cross(spin, inertia * spin) / inertia
        turn = turn @ rotation(STEP * spin)
    assert found.error.rotation == pytest.approx(worst, rel=PERCENT)
    assert not found.error.stated_by_position


def rotation(vector):
    angle = np.linalg.norm(vector)
    if not angle:
        return np.eye(3)
    x, y, z = vector / angle
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * skew + (1.0 - np.cos(angle)) * skew @ skew


BESIDE = """<mujoco><option timestep="{step}" gravity="0 0 -9.81"/><worldbody>
  <body name="mass"><joint name="slide" type="slide" axis="1 0 0" stiffness="{stiffness}"/>
    <inertial pos="0 0 0" mass="2" diaginertia="0.1 0.1 0.1"/></body>
  <body name="stone" pos="0 5 0"><freejoint/>
    <inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/></body></worldbody>
  <keyframe><key name="go" qvel="{speed} 0.1 0 0 0 0 0"/></keyframe></mujoco>"""


def test_a_mechanism_is_judged_by_its_own_motion(tmp_path):
    """An oscillator beside a stone, which falls almost 100 times as far as the oscillator moves."""
    mass, frequency, speed = 2.0, 20.0, 1.0
    found = judged(tmp_path, BESIDE, stiffness=mass * frequency**2, speed=speed)
    times = found.reference.time
    exact = speed / frequency * np.sin(frequency * times)
    numeric = semi_implicit(0.0, speed, mass * frequency**2, 0.0, mass)
    every = round(times[1] / STEP)
    states = np.array([next(numeric) for _ in range(every * (len(times) - 1) + 1)])[::every]
    error = np.max(np.abs(states - exact))
    assert found.error.position_at[0] == "mass"
    assert found.error.position == pytest.approx(error, rel=PERCENT)
    assert found.error.relative_position == pytest.approx(error / np.max(np.abs(exact)), rel=PERCENT)
    # of the stone, as in `test_error_of_a_fall`
    assert found.error.largest_position == pytest.approx(0.5 * 9.81 * STEP * times[-1], rel=PERCENT)


LANDING = """<mujoco><option timestep="{step}"/><worldbody><geom type="plane" size="9 9 1"/>
  <body name="stone" pos="0 0 0.5"><joint name="z" type="slide" axis="0 0 1"/>
    <geom name="stone" type="sphere" size="0.1" mass="1"/></body></worldbody>
  <keyframe><key name="go"/></keyframe></mujoco>"""


def test_a_contact_ends_the_comparison(tmp_path):
    """The error of a fall is h/t of the motion: larger until the landing than to the end of a fall without
    floor."""
    found = judged(tmp_path, LANDING)
    landing = np.sqrt(2.0 * 0.4 / 9.81)
    assert found.until == pytest.approx(landing, abs=2.0 * STEP)
    last = found.error.position_at[1]  # time of the last compared output
    assert last < found.until
    assert found.error.relative == pytest.approx(STEP / last, rel=PERCENT)
    assert found.without.error.relative == pytest.approx(STEP / found.without.reference.time[-1], rel=PERCENT)


def test_a_method_with_long_steps_is_compared_at_equal_times(tmp_path):
    """RK4 has four times the step of the file, which has two steps from one output to the next."""
    path = tmp_path / "model.xml"
    mass, stiffness = 2.0, 2.0 * 20.0**2
    values = {"integrator": "Euler", "stiffness": stiffness, "damping": 0.0, "speed": SPEED}
    path.write_text(OSCILLATOR.format(step=STEP, **values))
    options = {"duration": "0.96", "output_period": str(2.0 * STEP), "excitation": "off"}
    _, report = load_scene(str(path), options)
    found = judge(report.simulation)
    assert found.reference.time[1] == pytest.approx(2.0 * STEP)
    # by hand: RK4 with 4 STEP, whose step k is step 4 k of the file
    numeric = semi_implicit(0.0, SPEED, stiffness, 0.0, mass)
    states = np.array([next(numeric) for _ in range(241)])[::4]
    matrix = 4.0 * STEP * np.array([[0.0, 1.0], [-stiffness / mass, 0.0]])
    powers = [np.linalg.matrix_power(matrix, k) / [1.0, 1.0, 2.0, 6.0, 24.0][k] for k in range(5)]
    long_steps = [np.linalg.matrix_power(sum(powers), k) @ [0.0, SPEED] for k in range(61)]
    expected = np.max(np.abs(states - np.array(long_steps)[:, 0]))
    cause = next(each for each in found.causes if each.name == "integrator")
    assert cause.error.position == pytest.approx(expected, rel=PERCENT)


UPRIGHT = """<mujoco><option timestep="{step}" gravity="0 0 -9.81"/><worldbody>
  <body name="rod"><joint name="hinge" axis="0 1 0"/>
    <inertial pos="0 0 0.5" mass="1" diaginertia="0.05 0.05 0.01"/></body></worldbody>
  <keyframe><key name="go"/></keyframe></mujoco>"""


def test_horizon_of_an_unstable_equilibrium(tmp_path):
    """A change of the angle grows by cosh(r t), and one of the speed by sinh(r t)/(r t)."""
    path = tmp_path / "model.xml"
    path.write_text(UPRIGHT.format(step=STEP))
    _, report = load_scene(str(path), {"duration": "5", "excitation": "off"})
    rate = np.sqrt(9.81 * 0.5 / (0.05 + 0.5**2))
    first = np.arccosh(MAX_ERROR_GROWTH) / rate  # of a change of the angle alone
    times = np.linspace(first, 3.0 * first, 1000)
    last = times[np.argmax(np.sinh(rate * times) / (rate * times) > MAX_ERROR_GROWTH)]
    (until,) = horizons(report.simulation)
    assert first < until < 0.5 * (first + last)  # of three mixed changes


DRIVEN = """<mujoco><option timestep="{step}" integrator="{integrator}" gravity="0 0 0"/><worldbody>
  <body name="mass"><joint name="slide" type="slide" axis="1 0 0"/>
    <inertial pos="0 0 0" mass="2" diaginertia="0.1 0.1 0.1"/></body></worldbody>
  <actuator><motor name="push" joint="slide" ctrlrange="-1 1"/></actuator></mujoco>"""


def test_inputs_are_not_delayed(tmp_path):
    """The control at the start of each step would be late by half a step, 1e-2 of the motion here."""
    path = tmp_path / "driven.xml"
    path.write_text(DRIVEN.format(step=STEP, integrator="RK4"))
    _, report = load_scene(str(path), {"duration": str(DURATION), "excitation": "on"})
    pattern = r"excited: 1 actuator .* amplitudes up to (\S+) \((\S+) % of ctrlrange\)"
    (line,) = (line for line in report.start if line.startswith("excited: "))
    amplitude, percent = map(float, re.match(pattern, line).groups())
    assert percent == pytest.approx(100.0 * amplitude, rel=0.05)  # of a range of 1, with two digits
    assert judge(report.simulation).error.relative < 1e-4


SOFT_LOOPS = """<mujoco><option timestep="0.004" integrator="Euler"/>
  <default><equality solref="0.1 1"/></default>
  <worldbody>
    <body name="crank"><joint name="crank" axis="0 1 0"/>
      <inertial pos="0.3 0 0" mass="2" diaginertia="0.01 0.02 0.02"/></body>
    <body name="gear" pos="0 0 1"><joint name="gear" axis="0 1 0"/>
      <inertial pos="0 0 0" mass="1" diaginertia="0.05 0.05 0.05"/></body>
    <body name="slider" pos="0 0 2"><joint name="slider" type="slide" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="1" diaginertia="0.05 0.05 0.05"/></body>
    <body name="lift" pos="1 0 2"><joint name="lift" type="slide" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="4" diaginertia="0.05 0.05 0.05"/></body>
    <body name="arm" pos="2 0 0"><joint name="arm" axis="0 1 0"/>
      <inertial pos="0.2 0 0" mass="1" diaginertia="0.02 0.02 0.02"/></body>
    <body name="held" pos="2.5 0 0"><freejoint/>
      <inertial pos="0.1 0 0" mass="1" diaginertia="0.02 0.02 0.02"/></body>
  </worldbody>
  <equality>
    <joint name="mesh" joint1="gear" joint2="crank"/>
    <joint name="rack" joint1="slider" joint2="crank" polycoef="0 0.5 0 0 0"/>
    <joint name="chain" joint1="lift" joint2="slider"/>
    <weld name="grasp" body1="arm" body2="held" torquescale="3"/>
  </equality></mujoco>"""


def test_loop_errors_are_those_of_plain_mujoco(tmp_path):
    path = tmp_path / "loops.xml"
    path.write_text(SOFT_LOOPS)
    _, report = load_scene(str(path), {"duration": "0.5", "excitation": "off"})
    found = judge(report.simulation)
    # the same run by hand
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    outputs = np.round(found.run.time / model.opt.timestep).astype(int)
    openings, angles = dict[str, list[float]](), dict[str, list[float]]()
    for step in range(outputs[-1] + 1):
        if step in outputs:
            mujoco.mj_kinematics(model, data)
            x = {name: float(data.joint(name).qpos[0]) for name in ("crank", "gear", "slider", "lift")}
            angles.setdefault("mesh", []).append(abs(x["gear"] - x["crank"]))
            openings.setdefault("rack", []).append(abs(x["slider"] - 0.5 * x["crank"]))
            openings.setdefault("chain", []).append(abs(x["lift"] - x["slider"]))
            arm, held = data.body("arm"), data.body("held")
            turn = arm.xmat.reshape(3, 3)
            gap = held.xpos - arm.xpos - turn @ [0.5, 0.0, 0.0]
            openings.setdefault("grasp", []).append(float(np.linalg.norm(gap)))
            both = turn.T @ held.xmat.reshape(3, 3)
            angles.setdefault("grasp", []).append(float(np.arccos(np.clip((np.trace(both) - 1) / 2, -1, 1))))
        mujoco.mj_step(model, data)
    for largest, (name, time), by_hand in (
        (found.loop_error.opening, found.loop_error.opening_at, openings),
        (found.loop_error.angle, found.loop_error.angle_at, angles),
    ):
        worst = max(by_hand, key=lambda each: max(by_hand[each]))
        assert name == f"equality {worst!r}"
        assert largest == pytest.approx(
            max(by_hand[worst]), rel=0.01
        )  # of a weld's angle, twice the sine of half
        assert time == found.run.time[int(np.argmax(by_hand[worst]))]
