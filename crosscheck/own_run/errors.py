"""Error of a run against a reference solution, in absolute numbers and relative to the motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal, assert_never

import numpy as np

from newton_euler.model.euler_parameters import angle_between
from newton_euler.model.trajectory import Trajectory
from newton_euler.reading.file_run import LoopErrors
from newton_euler.scalars import Array

ACCURATE_BELOW, USABLE_BELOW = 1e-3, 1e-2
"""Relative errors that separate the bands. Parameters of real robots are known to about 1 %. A simulation
error below 0.1 % adds nothing to that; above 1 % the simulation is the largest error."""

MIN_SCALE = 1e-3
"""Smallest motion, sizes or rad, that errors are divided by: the motion of a mechanism that nearly rests."""

MAX_ANGLE_SCALE = 1.0
"""Largest rotation, rad, that errors of rotations are divided by: many revolutions excuse no larger error."""

MIN_STATED_POSITION = 0.5
"""Smallest relative error of positions by which reports state the error of a run, as a fraction of the larger
relative error. A smaller one is stated by rotations. People judge lengths more easily than angles."""


class Band(StrEnum):
    """Accuracy of a run in words."""

    ACCURATE = "ACCURATE"
    """The relative error is below 0.1 %."""
    USABLE = "USABLE"
    """The relative error is below 1 %."""
    WRONG = "WRONG"
    """The relative error is 1 % or more, or the run diverged."""

    @property
    def verdict(self) -> Literal["holds", "doubtful", "fails"]:
        """Judgement of tables and colors, see `crosscheck.report.table`."""
        match self:
            case Band.ACCURATE:
                return "holds"
            case Band.USABLE:
                return "doubtful"
            case Band.WRONG:
                return "fails"
            case _:
                assert_never(self)


@dataclass(frozen=True)
class RunError:
    """Largest errors of a run.

    Attributes:
        position: largest error of a body's center of mass, m.
        position_at: body and time, s, of that error.
        rotation: largest error of a body's orientation, rad.
        rotation_at: body and time, s, of that error.
        energy: largest error of the change of total energy, divided by `MotionScale.energy`.
        relative_position: `position`, divided by `MotionScale.length`.
        relative_rotation: `rotation`, divided by `MotionScale.angle`.
    """

    position: float
    position_at: tuple[str, float]
    rotation: float
    rotation_at: tuple[str, float]
    energy: float
    relative_position: float
    relative_rotation: float

    @property
    def relative(self) -> float:
        """Larger one of the relative errors."""
        return max(self.relative_position, self.relative_rotation)

    @property
    def stated_by_position(self) -> bool:
        """True if reports state the error as a length, False for an angle, see `MIN_STATED_POSITION`."""
        return self.relative_position >= MIN_STATED_POSITION * self.relative

    def relative_by(self, position: bool) -> float:
        """Return the relative error of positions if `position` is True, else that of rotations."""
        return self.relative_position if position else self.relative_rotation

    @property
    def band(self) -> Band:
        """The band of the relative error."""
        if self.relative < ACCURATE_BELOW:
            return Band.ACCURATE
        return Band.USABLE if self.relative < USABLE_BELOW else Band.WRONG


@dataclass(frozen=True)
class LoopError:
    """Largest violations of the loop constraints of a run.

    Attributes:
        opening: largest violation of a constraint of lengths, m, such as the gap between two points.
        opening_at: constraint and time, s, of that violation.
        angle: largest violation of a constraint of angles, rad.
        angle_at: constraint and time, s, of that violation.
    """

    opening: float = 0.0
    opening_at: tuple[str, float] = ("", 0.0)
    angle: float = 0.0
    angle_at: tuple[str, float] = ("", 0.0)

    @classmethod
    def of(cls, found: LoopErrors, times: Array) -> LoopError:
        """Find the largest violations up to the last one of the given times, s."""
        if not found.names:
            return cls()
        openings, angles = found.openings[: len(times)], found.angles[: len(times)]
        return cls(*_worst(openings, found.names, times), *_worst(angles, found.names, times))


@dataclass(frozen=True)
class MotionScale:
    """Extent of a motion, by which errors are divided.

    Attributes:
        length: largest displacement of a center of mass, m.
        angle: largest rotation, at most 1 rad.
        energy: largest kinetic energy plus the range of the potential energy, J.
    """

    length: float
    angle: float
    energy: float

    @classmethod
    def of(cls, reference: Trajectory, size: float) -> MotionScale:
        """Measure a reference solution.

        Args:
            reference: run with energies.
            size: size of the mechanism, m.
        """
        moved = float(np.max(np.linalg.norm(reference.position - reference.position[0], axis=2)))
        start = np.broadcast_to(reference.quaternion[0], reference.quaternion.shape)
        turned = float(np.max(angle_between(reference.quaternion, start)))
        kinetic, potential = _energies(reference)
        return cls(
            max(moved, MIN_SCALE * size),
            float(np.clip(turned, MIN_SCALE, MAX_ANGLE_SCALE)),
            float(np.max(kinetic) + np.ptp(potential)),
        )


def run_error(run: Trajectory, reference: Trajectory, scale: MotionScale) -> RunError:
    """Compare a run with a reference solution at the output times that both have.

    Args:
        run: run with the same bodies and output times; it may end early.
        reference: reference solution.
        scale: extent of the reference's motion.
    """
    position, rotation = errors_over_time(run, reference)
    count = len(position)
    energy_changes = []  # of the run and of the reference: total energy (n,), J, minus that of the start
    for each in (run, reference):
        kinetic, potential = _energies(each.first(count))
        energy_changes.append(kinetic + potential - kinetic[0] - potential[0])
    energy_error = float(np.max(np.abs(energy_changes[0] - energy_changes[1])))
    worst_position, worst_rotation = (
        _worst(errors, run.body_names, run.time) for errors in (position, rotation)
    )
    return RunError(
        *worst_position,
        *worst_rotation,
        energy_error / scale.energy if scale.energy else 0.0,
        worst_position[0] / scale.length,
        worst_rotation[0] / scale.angle,
    )


def errors_over_time(run: Trajectory, reference: Trajectory) -> tuple[Array, Array]:
    """Return the errors of the centers of mass, m, and of the orientations, rad, of all bodies, (n, b) each.

    Args:
        run: run with the bodies and output times of the reference; it may end early.
        reference: reference solution.
    """
    count = min(len(run.time), len(reference.time))
    position = np.linalg.norm(run.position[:count] - reference.position[:count], axis=2)
    return position, angle_between(run.quaternion[:count], reference.quaternion[:count])


def _worst(errors: Array, names: Sequence[str], times: Array) -> tuple[float, tuple[str, float]]:
    """Return the largest of errors (n, k) of k named elements at n times, s, and its element and time."""
    output, element = np.unravel_index(int(np.argmax(errors)), errors.shape)
    return float(errors[output, element]), (names[int(element)], float(times[output]))


def _energies(run: Trajectory) -> tuple[Array, Array]:
    """Return kinetic and potential energy (n,), J; zeros for a run without energies."""
    zeros = np.zeros(len(run.time))
    return (
        zeros if run.kinetic_energy is None else run.kinetic_energy,
        zeros if run.potential_energy is None else run.potential_energy,
    )
