"""Motions of actuators and drives against closed forms, an energy balance and an own calculation."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from mechanisms import MASS as CARRIED
from mechanisms import mass_on_rail

from newton_euler.analysis.loads.actuator_motions import ActuatorMotion, actuator_motions, demand
from newton_euler.analysis.loads.drives import Drive, Screw, hottest_rms, motor_motion, size
from newton_euler.model.control import PD
from newton_euler.model.smooth_functions import Sine
from newton_euler.runs.simulate import simulate

MASS, GRAVITY, LEAD, RATIO = 20.0, 9.81, 0.005, 3.0

SCREW = Screw(LEAD, efficiency=0.4, back_efficiency=-0.3, inertia=2e-5)

DRIVE = Drive(
    "drive",
    rated_torque=0.5,
    peak_torque=1.0,
    rated_speed=400.0,
    friction_torque=0.02,
    motor_inertia=4e-5,
    resistance=0.8,
    torque_constant=0.05,
    gear_ratio=RATIO,
    gear_efficiency=0.9,
    gear_back_efficiency=0.85,
    gear_inertia=1e-5,
    screw=SCREW,
)


def lift() -> ActuatorMotion:
    """A mass that is lifted with a trapezoidal speed of at most 0.1 m/s, rests, and comes back."""
    spans = [0.2, 0.4, 0.2, 0.2, 0.2, 0.4, 0.2]
    speeds = np.array([0.0, 0.1, 0.1, 0.0, 0.0, -0.1, -0.1, 0.0])
    time = np.concatenate([[0.0], np.cumsum(spans)])
    # two times at each corner: the force jumps with the acceleration
    accelerations = np.diff(speeds) / spans
    at = np.stack([time[:-1] + 1e-12, time[1:]], axis=1).ravel()
    force = MASS * (GRAVITY + np.repeat(accelerations, 2))
    speed = np.interp(at, time, speeds)
    positions = np.concatenate([[0.0], np.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * spans)])
    position = np.stack([positions[:-1], positions[1:]], axis=1).ravel()
    position[0::2] += 1e-12 * speed[0::2]
    return ActuatorMotion("slide", True, at, force, position, speed)


def test_demand_of_a_trapezoidal_lift():
    """Force m (g + a), power F v, work m g h up and back, rest between."""
    found = demand(lift())
    height = 0.1 * (0.4 + 0.2)
    assert found.peak_force == pytest.approx(MASS * (GRAVITY + 0.5))
    assert found.holding_force == pytest.approx(MASS * GRAVITY)
    square = (4 * 0.2 * (GRAVITY**2 + 0.5**2) + (0.8 + 0.2) * GRAVITY**2) / 1.8
    assert found.rms_force == pytest.approx(MASS * math.sqrt(square), rel=1e-6)
    assert found.peak_speed == pytest.approx(0.1)
    assert found.peak_power == pytest.approx(MASS * (GRAVITY + 0.5) * 0.1)
    assert found.braking_power == pytest.approx(MASS * (GRAVITY + 0.5) * 0.1)
    assert found.work == pytest.approx(MASS * GRAVITY * height, rel=1e-6)
    assert found.braking_work == pytest.approx(MASS * GRAVITY * height, rel=1e-6)
    assert found.mean_power == pytest.approx(MASS * GRAVITY * height / 1.8, rel=1e-6)
    assert found.duty == pytest.approx(1.6 / 1.8)
    assert (found.stroke, found.distance) == pytest.approx((height, 2.0 * height), rel=1e-6)


def test_motor_of_a_trapezoidal_lift():
    """Torques of the seven parts by hand: force to screw to gearbox to motor; rms, voltage and energy."""
    travel, inertia = LEAD / (2.0 * math.pi), 5e-5
    torques, powers, voltages = [], [], []
    spans = [0.2, 0.4, 0.2, 0.2, 0.2, 0.4, 0.2]
    for span, begin, end in zip(
        spans, [0, 0.1, 0.1, 0, 0, -0.1, -0.1], [0.1, 0.1, 0, 0, -0.1, -0.1, 0], strict=True
    ):
        turn = np.array([begin, end]) / travel  # rad/s of the screw
        spin = (turn[1] - turn[0]) / span
        load = MASS * (GRAVITY + spin * travel) * travel
        if begin == end == 0:
            torque = 0.0  # the screw is self-locking
        elif begin + end > 0:  # up
            torque = (load / 0.4 + 2e-5 * spin) / 0.9 / RATIO + inertia * RATIO * spin + 0.02
        else:  # down: the screw must be driven, in the direction of the motion
            at_screw = -0.3 * load + 2e-5 * spin
            assert at_screw < 0.0
            torque = at_screw / 0.9 / RATIO + inertia * RATIO * spin - 0.02
        torques.append(torque)
        middle, ends = RATIO * turn.mean(), RATIO * turn
        powers.append([0.8 * (torque / 0.05) ** 2 + torque * each for each in (ends[0], middle, ends[1])])
        voltages += [0.8 * torque / 0.05 + 0.05 * each for each in ends]
    energy = 0.0
    for span, power in zip(spans, powers, strict=True):
        energy += span * np.dot(np.maximum(power, 0.0), [1, 4, 1]) / 6.0
    found = size(replace(DRIVE, voltage=24.0), lift())
    limits = {limit.name: limit for limit in found.limits}
    assert limits["peak torque"].needed == pytest.approx(max(map(abs, torques)), rel=1e-6)
    rms = math.sqrt(np.dot(spans, np.square(torques)) / 1.8)
    assert limits["rms torque"].needed == pytest.approx(rms, rel=1e-6)
    assert limits["motor speed"].needed == pytest.approx(0.1 / travel * RATIO, rel=1e-9)
    assert limits["voltage"].needed == pytest.approx(max(map(abs, voltages)), rel=1e-6)
    assert found.energy == pytest.approx(energy, rel=1e-6)
    assert found.holds
    assert DRIVE.is_self_locking
    assert limits["peak torque"].margin == pytest.approx(1.0 - max(map(abs, torques)) / 1.0)
    assert found.failing() is None
    assert found.failing(0.9).name == "motor speed"


def test_rms_of_an_inertia_with_a_trapezoidal_speed():
    """Textbook: the torque J v / t in both ramps, 0 between: rms = J v / t sqrt(2 t / T)."""
    drive = Drive("rotor", 1.0, 1.0, 1000.0, motor_inertia=0.01)
    time = np.array([0.0, 0.5, 2.0, 2.5, 4.0])
    speed = np.array([0.0, 30.0, 30.0, 0.0, 0.0])
    position = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time))])
    motion = ActuatorMotion("hinge", False, time, np.zeros(5), position, speed)
    limits = {limit.name: limit.needed for limit in size(drive, motion).limits}
    assert limits["peak torque"] == pytest.approx(0.6)
    assert limits["rms torque"] == pytest.approx(0.6 * math.sqrt(2 * 0.5 / 4.0))


def sine(backwards: bool = False) -> ActuatorMotion:
    """A slide with mass, spring and constant force on a sine, 2000 times."""
    time = np.linspace(0.0, 2.0, 2001)
    position = 0.05 * np.sin(3.0 * time) * (-1 if backwards else 1)
    speed = 0.15 * np.cos(3.0 * time) * (-1 if backwards else 1)
    force = 30.0 + 400.0 * position - 5.0 * 9.0 * position
    return ActuatorMotion("slide", True, time, force, position, speed)


@pytest.mark.parametrize("back", [0.5, -0.4])
@pytest.mark.parametrize("backwards", [False, True])
def test_energy_balance_of_a_drive(back, backwards):
    """Work of the motor = work on the load + losses of screw, gearbox and bearings + rotational energy."""
    drive = replace(DRIVE, screw=Screw(0.01, 0.6, back, inertia=3e-5), recovery=1.0)
    motion = sine(backwards)
    motor = motor_motion(drive, motion)
    speed = np.stack([motor.speed[:-1], motor.speed[1:]])
    spans = np.diff(motion.time)
    motor_work = np.sum((motor.torque * speed).mean(axis=0) * spans)

    # an own calculation at each time: power through each stage
    turn = motion.speed * 2.0 * math.pi / 0.01
    spin = np.gradient(turn, motion.time, edge_order=2)
    at_load = motion.force * motion.speed
    at_screw = np.array([p / 0.6 if p > 0 else p * back for p in at_load]) + 3e-5 * spin * turn
    at_gear = np.array([p / 0.9 if p > 0 else p * 0.85 for p in at_screw])
    at_motor = at_gear + 5e-5 * RATIO**2 * spin * turn + 0.02 * RATIO * np.abs(turn)
    integral = np.sum(0.5 * (at_motor[1:] + at_motor[:-1]) * spans)
    assert motor_work == pytest.approx(integral, rel=2e-3)
    # losses are positive, so that the motor works more than the load and the rotors gain
    gained = np.sum(0.5 * (at_load[1:] + at_load[:-1]) * spans)
    gained += 0.5 * (3e-5 + 5e-5 * RATIO**2) * (turn[-1] ** 2 - turn[0] ** 2)
    assert motor_work > gained
    # electric energy with full recovery: heat of the winding and the work
    heat = np.sum(0.8 * (motor.torque / 0.05) ** 2 @ spans / 2.0)
    energy = size(drive, motion).energy
    assert energy == pytest.approx(heat + motor_work, rel=1e-3)
    without = size(replace(drive, recovery=0.0), motion).energy
    assert without >= energy


def test_efficiency_of_a_motor():
    """A motor that drives, then is driven: energy / efficiency, and the returned energy times efficiency."""
    time = np.array([0.0, 1.0, 2.0])
    position, speed = np.array([0.0, 0.5, 0.0]), np.array([1.0, 0.0, -1.0])
    motion = ActuatorMotion("hinge", False, time, np.full(3, 2.0), position, speed)
    drive = Drive("motor", 5.0, 5.0, 10.0, motor_efficiency=0.8)
    assert size(drive, motion).energy == pytest.approx(2.0 * 0.5 / 0.8)
    returned = size(replace(drive, recovery=0.5), motion).energy
    assert returned == pytest.approx(2.0 * 0.5 / 0.8 - 0.5 * 2.0 * 0.5 * 0.8)
    assert size(replace(drive, motor_efficiency=None), motion).energy is None


def test_hottest_part_of_a_long_motion():
    """12 s with 3 N m in a day, with the ramps: 600 s around them have the rms 3 sqrt(12 / 600)."""
    time = np.array([0.0, 40_000.0, 40_001.0, 40_011.0, 40_012.0, 86_400.0])
    speed = np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0])
    position = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time))])
    motion = ActuatorMotion("hinge", False, time, np.full(6, 3.0), position, speed)
    locking = Drive("worm", 1.0, 5.0, 2.0, gear_efficiency=1.0, gear_back_efficiency=-0.1)
    motor = motor_motion(locking, motion)
    assert np.all(motor.torque[:, [0, -1]] == 0.0)
    assert hottest_rms(motor, 600.0) == pytest.approx(3.0 * math.sqrt(12.0 / 600.0))
    assert hottest_rms(motor, 1e9) == pytest.approx(3.0 * math.sqrt(12.0 / 86_400.0))
    assert hottest_rms(motor, 5.0) == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("screw_back", "gear_back", "friction", "torque"),
    [
        (0.5, 0.8, 0.0, 100.0 * 0.001 * 0.5 * 0.8 / 4.0),
        (0.5, 0.8, 0.004, 100.0 * 0.001 * 0.5 * 0.8 / 4.0 - 0.004),
        (0.5, 0.8, 0.02, 0.0),
        (-0.1, 0.8, 0.0, 0.0),
        (0.5, -0.2, 0.0, 0.0),
    ],
)
def test_holding_torque(screw_back, gear_back, friction, torque):
    """At rest each stage passes its back efficiency of the load, and the motor's friction helps."""
    still = ActuatorMotion(
        "slide", True, np.array([0.0, 1.0]), np.array([-80.0, -100.0]), np.ones(2), np.zeros(2)
    )
    screw = Screw(0.001 * 2.0 * math.pi, 0.7, screw_back)
    drive = Drive(
        "drive", 1.0, 1.0, 1.0, friction, gear_ratio=4.0, gear_back_efficiency=gear_back, screw=screw
    )
    found = size(drive, still)
    assert found.holding_torque == pytest.approx(torque, abs=1e-15)
    assert found.holds == (torque == 0.0)
    motor = motor_motion(drive, still)
    assert motor.torque[1, 0] == pytest.approx(-torque, abs=1e-15)
    assert demand(still).holding_force == 100.0
    assert demand(still).duty == 0.0


def test_screws_are_for_slides():
    assert size(replace(DRIVE, screw=None), lift()).mismatch == "no screw"
    hinge = replace(lift(), is_slide=False)
    found = size(DRIVE, hinge)
    assert (found.mismatch, found.limits, found.holds) == ("has a screw", (), False)


def test_limits_of_screw_and_gearbox():
    screw = replace(SCREW, max_force=100.0, stroke=0.05, buckling_force=500.0, critical_speed=100.0)
    found = size(replace(DRIVE, screw=screw, gear_torque=1.0), lift())
    limits = {limit.name: limit for limit in found.limits}
    peak = MASS * (GRAVITY + 0.5)
    assert limits["screw force"].margin == pytest.approx(1.0 - peak / 100.0)
    assert limits["stroke"].margin == pytest.approx(1.0 - 0.06 / 0.05)
    assert limits["buckling"].needed == pytest.approx(peak)
    assert limits["critical speed"].needed == pytest.approx(0.1 * 2.0 * math.pi / LEAD)
    spin = 0.5 * 2.0 * math.pi / LEAD
    assert limits["gear torque"].needed == pytest.approx(peak * LEAD / (2.0 * math.pi) / 0.4 + 2e-5 * spin)
    assert found.failing().name == "stroke"
    assert found.tightest.name == "screw force"


def test_motion_of_a_run():
    """A mass on a vertical rail: the force is m (g + a), and its work the energy of the mass."""
    law = PD("rail", 800.0, 40.0, target=Sine(0.1, angular_frequency=2.0), feedforward=CARRIED * GRAVITY)
    scene = mass_on_rail(gravity=(0.0, 0.0, -GRAVITY), duration=1.0, control=(law,))
    scene = replace(scene, output_period=0.002)
    run = simulate(scene)
    (motion,) = actuator_motions(scene, run)
    assert (motion.name, motion.is_slide) == ("rail", True)
    acceleration = np.gradient(motion.speed, motion.time, edge_order=2)
    settled = motion.time > 0.1
    assert motion.force[settled] == pytest.approx(CARRIED * (GRAVITY + acceleration)[settled], abs=0.005)
    energy = run.kinetic_energy + run.potential_energy
    found = demand(motion)
    assert found.work - found.braking_work == pytest.approx(energy[-1] - energy[0], rel=1e-3)


def test_rms_of_a_linear_force_and_direction_at_a_reversal():
    """The rms of a line from 0 to 3 is sqrt(3). An interval without a way has its last direction."""
    time = np.array([0.0, 2.0, 4.0])
    motion = ActuatorMotion(
        "slide", True, time, np.array([0.0, 3.0, 0.0]), np.array([1.0, 1.0, 0.0]), np.array([1.0, -1.0, 0.0])
    )
    assert demand(motion).rms_force == pytest.approx(math.sqrt(3.0))
    assert motion.direction.tolist() == [-1.0, -1.0]


def test_the_end_of_a_slow_transient_is_no_motion():
    """A speed that falls from 1.5 times the speed of rest to 0 in 30 s: at rest for 29.999 of 32 s."""
    time, speed = np.array([0.0, 1.0, 2.0, 2.001, 32.0]), np.array([1.0, 1.0, 1.0, 1.5e-3, 0.0])
    position = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time))])
    motion = ActuatorMotion("lift", True, time, np.full(5, 10.0), position, speed)
    found = demand(motion)
    assert found.duty == pytest.approx(2.001 / 32.0, rel=1e-12)
    assert found.holding_force == 10.0


def test_vibrations_at_rest_need_no_torque():
    """A tenth of the speed below which an actuator is at rest, with a high acceleration."""
    time = np.array([0.0, 1.0, 2.0, 2.001])
    speed, position = np.array([1.0, 1.0, 0.0, 1e-4]), np.array([0.0, 1.0, 1.5, 1.5])
    motion = ActuatorMotion("slide", True, time, np.full(4, 10.0), position, speed)
    motor = motor_motion(replace(DRIVE, screw=replace(SCREW, inertia=1.0)), motion)
    assert motor.torque[:, -1] == pytest.approx(0.0, abs=1e-15)
    assert motor.gear_torque[:, -1] == pytest.approx(0.0, abs=1e-15)


def test_a_stage_without_back_efficiency_locks():
    assert replace(DRIVE, screw=None, gear_back_efficiency=0.0).is_self_locking
    assert not replace(DRIVE, screw=None, gear_back_efficiency=0.01).is_self_locking
