"""Force and motion of actuators, and what they must supply: peak and rms force, power, work, duty.

`actuator_motions` takes the force, position and speed of each actuator from a run, and `demand` computes what
the actuator must supply. Between the times of a motion, force and speed are linear in time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from newton_euler.analysis.loads.envelope import work_and_energy
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

REST_FRACTION = 1e-3
"""Speed as a fraction of the actuator's largest speed below which the actuator is at rest: the friction of
the drive then holds the load."""


@dataclass(frozen=True, eq=False)
class ActuatorMotion:
    """Force and motion of an actuator at n times.

    Attributes:
        name: label of the joint coordinate that the actuator acts on.
        is_slide: True for N and m, False for N m and rad.
        time: (n,) s, ascending.
        force: (n,) N or N m, in the direction in which the position grows.
        position: (n,) m or rad.
        speed: (n,) m/s or rad/s.
    """

    name: str
    is_slide: bool
    time: Array
    force: Array
    position: Array
    speed: Array

    @cached_property
    def spans(self) -> Array:
        """(n - 1,) durations of the intervals, s."""
        return np.diff(self.time)

    @cached_property
    def direction(self) -> Array:
        """(n - 1,) direction of the motion in each interval: 1, -1, or 0 at rest."""
        mean = np.diff(self.position) / self.spans
        least = REST_FRACTION * np.max(np.abs(self.speed))
        is_moving = 0.5 * (np.abs(self.speed[:-1]) + np.abs(self.speed[1:])) > least
        return np.where(is_moving, np.sign(np.where(mean == 0.0, self.speed[1:], mean)), 0.0)

    @cached_property
    def forces(self) -> Array:
        """(2, n - 1) forces at the begin and the end of each interval."""
        return interval_ends(self.force)


class Demand(NamedTuple):
    """Forces, speeds, powers and works that an actuator must supply for its motion.

    Forces are in N and speeds in m/s at slides, N m and rad/s at hinges.

    Attributes:
        peak_force: largest magnitude of the force.
        peak_time: its time, s.
        rms_force: root mean square of the force over time.
        holding_force: largest magnitude of the force at rest; None if the actuator is never at rest.
        peak_speed: largest magnitude of the speed.
        peak_power: largest power of the actuator, W.
        braking_power: largest power that the load returns, W.
        mean_power: work divided by the duration, W.
        work: positive work of the actuator, J.
        braking_work: work that the load returns, J.
        duty: fraction of the time in which the actuator moves.
        stroke: difference of the largest and the smallest position, m or rad.
        distance: length of the way, m or rad.
    """

    peak_force: float
    peak_time: float
    rms_force: float
    holding_force: float | None
    peak_speed: float
    peak_power: float
    braking_power: float
    mean_power: float
    work: float
    braking_work: float
    duty: float
    stroke: float
    distance: float


def actuator_motions(scene: Scene, run: Trajectory) -> tuple[ActuatorMotion, ...]:
    """Return force and motion of each actuator in a run.

    Args:
        scene: the scene of the run; each control law is an actuator.
        run: run of any engine with velocities and actuator forces.
    """
    assert run.actuator_force is not None
    # a trajectory measures joint coordinates by its mechanism, which a run of another engine may lack
    measured, mechanism = replace(run, mechanism=scene.mechanism), scene.mechanism
    motions = []
    for k, law in enumerate(scene.control):
        motion = measured.joint(law.joint)
        assert motion.rates is not None
        motions.append(
            ActuatorMotion(
                name=mechanism.coordinate_labels[law.key],
                is_slide=mechanism.is_slide(*law.key),
                time=run.time,
                force=run.actuator_force[:, k],
                position=motion.coordinates[:, law.coordinate],
                speed=motion.rates[:, law.coordinate],
            )
        )
    return tuple(motions)


def demand(motion: ActuatorMotion) -> Demand:
    """Compute what an actuator must supply for a motion."""
    peak = int(np.argmax(np.abs(motion.force)))
    duration = float(motion.time[-1] - motion.time[0])
    power = motion.force * motion.speed
    work, positive_work = (float(values[-1]) for values in work_and_energy(motion.force, motion.position))
    is_resting = motion.direction == 0.0
    return Demand(
        peak_force=float(abs(motion.force[peak])),
        peak_time=float(motion.time[peak]),
        rms_force=float(np.sqrt(np.sum(squares(motion.forces, motion.spans)) / duration)),
        holding_force=float(np.max(np.abs(motion.forces[:, is_resting]))) if is_resting.any() else None,
        peak_speed=float(np.max(np.abs(motion.speed))),
        peak_power=float(max(0.0, np.max(power))),
        braking_power=float(max(0.0, -np.min(power))),
        mean_power=positive_work / duration,
        work=positive_work,
        braking_work=positive_work - work,
        duty=float(np.sum(motion.spans[~is_resting]) / duration),
        stroke=float(np.ptp(motion.position)),
        distance=float(np.sum(np.abs(np.diff(motion.position)))),
    )


def interval_ends(values: Array) -> Array:
    """Return the values (2, n - 1) at begin and end of each interval, from those at n times."""
    return np.stack([values[:-1], values[1:]])


def squares(values: Array, spans: Array) -> Array:
    """Integrate the square of a quantity that is linear in each interval: (n - 1,).

    Args:
        values: (2, n - 1) at begin and end of each interval.
        spans: (n - 1,) s, durations of the intervals.
    """
    begin, end = values
    return np.asarray(spans * (begin * begin + begin * end + end * end) / 3.0)
