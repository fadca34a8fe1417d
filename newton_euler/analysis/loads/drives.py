"""Sizing of drives: the torque, speed and energy that the motor of an actuator needs for a motion.

A drive is a motor, a gearbox and, for a slide, a screw. `size` compares a drive with the motion of an
actuator: torques over time, limits with their margins, energy, and whether the drive holds the load with the
motor off.

The motion is given: a drive does not change it. Torques are computed at both ends of each interval with the
direction of motion in the interval, so that friction jumps between intervals, not inside of them. Friction
depends on the direction of power in each stage: from the motor to the load, a stage has its efficiency; from
the load to the motor, its back efficiency.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from newton_euler.analysis.loads.actuator_motions import ActuatorMotion, interval_ends, squares
from newton_euler.scalars import Array


@dataclass(frozen=True)
class Screw:
    """A lead screw, ball screw, rack or belt, which turns the rotation of the gearbox into motion of a slide.

    Attributes:
        lead: motion of the slide per turn, m.
        efficiency: work on the load per work at the screw if the screw drives the load.
        back_efficiency: work at the screw per work of the load if the load drives, 0 or below if the screw is
            self-locking.
        inertia: about the axis of the screw, kg m^2.
        max_force: largest axial force, N; None for no limit, as for the following.
        stroke: m.
        buckling_force: N.
        critical_speed: rad/s.
    """

    lead: float
    efficiency: float
    back_efficiency: float
    inertia: float = 0.0
    max_force: float | None = None
    stroke: float | None = None
    buckling_force: float | None = None
    critical_speed: float | None = None


@dataclass(frozen=True)
class Drive:
    """A motor and a gearbox, and for a slide a screw. None stands for an unknown value or no limit.

    Attributes:
        name: name of the drive.
        rated_torque, peak_torque: torques of the motor that it has for ever and for short times, N m.
        rated_speed: largest speed of the motor, rad/s.
        friction_torque: friction of the motor's bearings, brushes and seals, N m.
        motor_inertia: kg m^2.
        motor_efficiency: mechanical work per electric energy, also of the motor as a generator.
        resistance: of the winding, ohm; replaces `motor_efficiency`.
        torque_constant: torque per current, N m/A.
        voltage: of the supply, V.
        thermal_time: duration over which the motor averages its heat, s.
        recovery: fraction of the returned electric energy that is used again.
        gear_ratio: turns of the motor per turn of the gearbox output.
        gear_efficiency, gear_back_efficiency: as those of `Screw`.
        gear_inertia: of the gearbox at its input, kg m^2.
        gear_torque: largest torque at the output, N m.
        screw: None for a drive of a hinge.
    """

    name: str
    rated_torque: float
    peak_torque: float
    rated_speed: float
    friction_torque: float = 0.0
    motor_inertia: float = 0.0
    motor_efficiency: float | None = None
    resistance: float | None = None
    torque_constant: float | None = None
    voltage: float | None = None
    thermal_time: float = 600.0
    recovery: float = 0.0
    gear_ratio: float = 1.0
    gear_efficiency: float = 1.0
    gear_back_efficiency: float = 1.0
    gear_inertia: float = 0.0
    gear_torque: float | None = None
    screw: Screw | None = None

    @property
    def travel(self) -> float:
        """Motion of the actuator per radian at the output of the gearbox: m, or 1 rad without a screw."""
        return self.screw.lead / (2.0 * math.pi) if self.screw else 1.0

    @property
    def is_self_locking(self) -> bool:
        """True if the load cannot move the drive: a stage has a back efficiency of 0 or below."""
        return min(self.gear_back_efficiency, self.screw.back_efficiency if self.screw else 1.0) <= 0.0


class Limit(NamedTuple):
    """A limit of a drive.

    Attributes:
        name: such as "rms torque".
        needed: magnitude that the motion needs.
        allowed: value of the drive.
        unit: unit of both.
    """

    name: str
    needed: float
    allowed: float
    unit: str

    @property
    def margin(self) -> float:
        """The unused fraction of the allowed value; negative if the drive is too weak."""
        return 1.0 - self.needed / self.allowed


@dataclass(frozen=True, eq=False)
class MotorMotion:
    """Torque and speed of a motor at n times.

    Attributes:
        time: (n,) s.
        speed: (n,) rad/s.
        torque: (2, n - 1) N m of the motor at begin and end of each interval.
        gear_torque: (2, n - 1) N m at the output of the gearbox.
    """

    time: Array
    speed: Array
    torque: Array
    gear_torque: Array


class Sized(NamedTuple):
    """A drive compared with the motion of an actuator.

    Attributes:
        drive: the drive.
        actuator: name of the actuator.
        mismatch: reason why the drive does not fit the kind of the actuator: "no screw" for a slide, "has a
            screw" for a hinge. It is empty if the drive fits; otherwise the other attributes are.
        limits: limits of the drive, in the order in which they are checked.
        energy: electric energy of the motion, J; None if the drive has no efficiency.
        holding_torque: motor torque, N m, that holds the largest force of the motion at rest; 0 if friction
            holds the force.
    """

    drive: Drive
    actuator: str
    mismatch: str = ""
    limits: tuple[Limit, ...] = ()
    energy: float | None = None
    holding_torque: float = 0.0

    @property
    def holds(self) -> bool:
        """True if the drive holds the largest force of the motion with the motor off."""
        return not self.mismatch and self.holding_torque == 0.0

    @property
    def tightest(self) -> Limit | None:
        """The limit with the smallest margin."""
        return min(self.limits, key=lambda limit: limit.margin, default=None)

    def failing(self, margin: float = 0.0) -> Limit | None:
        """Return the first limit with less than a margin, such as 0.2 for 20 %; None if there is none."""
        return next((limit for limit in self.limits if limit.margin < margin), None)


def size(drive: Drive, motion: ActuatorMotion) -> Sized:
    """Compare a drive with the motion of an actuator."""
    if motion.is_slide and drive.screw is None:
        return Sized(drive, motion.name, "no screw")
    if not motion.is_slide and drive.screw is not None:
        return Sized(drive, motion.name, "has a screw")
    motor = motor_motion(drive, motion)
    return Sized(
        drive,
        motion.name,
        limits=tuple(_limits(drive, motion, motor)),
        energy=_energy(drive, motor),
        holding_torque=_holding_torque(drive, float(np.max(np.abs(motion.force)))),
    )


def motor_motion(drive: Drive, motion: ActuatorMotion) -> MotorMotion:
    """Compute the torque and speed of a motor: inertia times acceleration, friction and load.

    At rest, a drive needs the smallest torque that holds the load, since friction helps. Rotating parts have
    the acceleration of the motion, constant in each interval.
    """
    direction = motion.direction
    # speeds and accelerations at the output of the gearbox, rad/s and rad/s^2
    speed = motion.speed / drive.travel
    acceleration = np.where(direction == 0.0, 0.0, np.diff(speed) / motion.spans)
    # from the load to the motor
    gear_torque = motion.forces * drive.travel
    if drive.screw:
        stage = (drive.screw.efficiency, drive.screw.back_efficiency)
        gear_torque = _through_stage(gear_torque, direction, *stage) + drive.screw.inertia * acceleration
    stage = (drive.gear_efficiency, drive.gear_back_efficiency)
    load = _through_stage(gear_torque, direction, *stage) / drive.gear_ratio
    inertia = drive.motor_inertia + drive.gear_inertia
    moving = load + inertia * drive.gear_ratio * acceleration + drive.friction_torque * direction
    resting = np.sign(load) * np.maximum(np.abs(load) - drive.friction_torque, 0.0)
    torque = np.where(direction == 0.0, resting, moving)
    return MotorMotion(motion.time, speed * drive.gear_ratio, torque, gear_torque)


def _through_stage(output: Array, direction: Array, efficiency: float, back_efficiency: float) -> Array:
    """Compute the torque at the input of a stage of ratio 1.

    Args:
        output: (..., n - 1) torque at the output.
        direction: (n - 1,) direction of motion; 0 at rest, where friction holds the load.
        efficiency, back_efficiency: see `Screw`.
    """
    returned = output * np.where(direction == 0.0, max(back_efficiency, 0.0), back_efficiency)
    return np.where(output * direction > 0.0, output / efficiency, returned)


def _holding_torque(drive: Drive, force: float) -> float:
    """Return the motor torque, N m, that holds a force, N or N m, at rest; 0 if friction holds the force."""
    screw = drive.screw.back_efficiency if drive.screw else 1.0
    load = force * drive.travel * max(screw, 0.0) * max(drive.gear_back_efficiency, 0.0) / drive.gear_ratio
    return max(load - drive.friction_torque, 0.0)


def _limits(drive: Drive, motion: ActuatorMotion, motor: MotorMotion) -> Iterator[Limit]:
    """Yield the limits of a drive in a motion: those of the screw, the gearbox and the motor."""
    peak_force, peak_speed = float(np.max(np.abs(motion.force))), float(np.max(np.abs(motor.speed)))
    peak_torque = float(np.max(np.abs(motor.torque)))
    needs = [
        ("motor speed", peak_speed, drive.rated_speed, "rad/s"),
        ("peak torque", peak_torque, drive.peak_torque, "N m"),
        ("rms torque", hottest_rms(motor, drive.thermal_time), drive.rated_torque, "N m"),
        ("gear torque", float(np.max(np.abs(motor.gear_torque))), drive.gear_torque, "N m"),
    ]
    if drive.voltage is not None:
        assert drive.resistance is not None
        assert drive.torque_constant is not None
        current = motor.torque / drive.torque_constant
        voltage = drive.resistance * current + drive.torque_constant * interval_ends(motor.speed)
        needs.append(("voltage", float(np.max(np.abs(voltage))), drive.voltage, "V"))
    if drive.screw:
        screw = drive.screw
        needs += [
            ("stroke", float(np.ptp(motion.position)), screw.stroke, "m"),
            ("screw force", peak_force, screw.max_force, "N"),
            ("buckling", peak_force, screw.buckling_force, "N"),
            ("critical speed", peak_speed / drive.gear_ratio, screw.critical_speed, "rad/s"),
        ]
    for name, needed, allowed, unit in needs:
        if allowed is not None:
            yield Limit(name, needed, allowed, unit)


def hottest_rms(motor: MotorMotion, window: float) -> float:
    """Return the largest root mean square of the torque, N m, over any part of the motion.

    Args:
        motor: motion of the motor.
        window: duration of the part, s; the whole motion if that is shorter.
    """
    time = motor.time
    window = min(window, float(time[-1] - time[0]))
    # integral of the squared torque up to each time, linear in between
    heat = np.concatenate([[0.0], np.cumsum(squares(motor.torque, np.diff(time)))])
    begins = np.concatenate([time[time <= time[-1] - window], time[time >= time[0] + window] - window])
    if not len(begins):  # round-off of the sum
        begins = time[:1]
    parts = np.interp(begins + window, time, heat) - np.interp(begins, time, heat)
    return float(np.sqrt(np.max(parts) / window))


def _energy(drive: Drive, motor: MotorMotion) -> float | None:
    """Return the electric energy of a motion, J, by Simpson's rule; None without an efficiency.

    Energy that the motor returns is lost but for the fraction `recovery`. A motor with an efficiency, not a
    resistance, needs no power at rest.
    """
    speed_ends, (begin, end) = interval_ends(motor.speed), motor.torque
    torque = np.stack([begin, 0.5 * (begin + end), end])
    speed = np.stack([speed_ends[0], speed_ends.mean(axis=0), speed_ends[1]])
    power = torque * speed
    if drive.resistance is not None and drive.torque_constant is not None:
        power = power + drive.resistance * (torque / drive.torque_constant) ** 2
    elif drive.motor_efficiency is not None:
        power = np.where(power > 0.0, power / drive.motor_efficiency, power * drive.motor_efficiency)
    else:
        return None
    power = np.where(power > 0.0, power, drive.recovery * power)
    return float(np.sum(np.diff(motor.time) * (power[0] + 4.0 * power[1] + power[2]) / 6.0))
