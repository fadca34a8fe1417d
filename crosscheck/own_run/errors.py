"""Error of a run against a reference solution, in absolute numbers and relative to the motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal, assert_never

import numpy as np

from crosscheck.own_run.interpolation import common_outputs
from newton_euler.model.euler_parameters import angle_between
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.trajectory import Trajectory
from newton_euler.reading.file_run import LoopErrors
from newton_euler.scalars import Array

ACCURATE_BELOW, USABLE_BELOW = 1e-3, 1e-2
"""Relative errors that separate the bands. Parameters of real robots are known to about 1 %. A simulation
error below 0.1 % adds nothing to that; above 1 % the simulation is the largest error."""

MIN_SCALE = 1e-2
"""Smallest motion, sizes or rad, that errors are divided by: the motion of a mechanism that nearly rests. An
error of 1e-5 sizes, such as 10 um on a robot of 1 m, is accurate even then."""

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
        position: error of the center of mass of the body whose error is the largest part of the motion, m.
        position_at: body and time, s, of that error.
        rotation: error of the orientation of the body whose error is the largest part of the motion, rad.
        rotation_at: body and time, s, of that error.
        energy: largest error of the change of total energy, divided by `MotionScale.energy`.
        relative_position: `position`, divided by the body's scale in `MotionScale.lengths`.
        relative_rotation: `rotation`, divided by the body's scale in `MotionScale.angles`.
        largest_position: largest error of any center of mass, m. It is larger than `position` if a body of
            another mechanism that moves farther has this error.
        largest_rotation: largest error of any orientation, rad.
    """

    position: float
    position_at: tuple[str, float]
    rotation: float
    rotation_at: tuple[str, float]
    energy: float
    relative_position: float
    relative_rotation: float
    largest_position: float
    largest_rotation: float

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
        (opened, loop), (turned, other) = _largest_at(openings), _largest_at(angles)
        return cls(
            opening=float(openings[opened, loop]),
            opening_at=(found.names[loop], float(times[opened])),
            angle=float(angles[turned, other]),
            angle_at=(found.names[other], float(times[turned])),
        )


@dataclass(frozen=True)
class MotionScale:
    """Extent of a motion, by which errors are divided.

    Bodies that joints connect without the ground are one mechanism, and have one scale. A small mechanism
    beside one that falls far is judged by its own motion.

    Attributes:
        lengths: for each body, by name: largest displacement of a center of mass of its mechanism, m.
        angles: for each body, by name: largest rotation of a body of its mechanism, at most 1 rad.
        energy: largest kinetic energy plus the range of the potential energy of all bodies, J.
    """

    lengths: Mapping[str, float]
    angles: Mapping[str, float]
    energy: float

    @classmethod
    def of(cls, reference: Trajectory, mechanism: Mechanism) -> MotionScale:
        """Measure a reference solution.

        Args:
            reference: run with energies.
            mechanism: mechanism of the run.
        """
        lengths = np.max(np.linalg.norm(reference.position - reference.position[0], axis=2), axis=0)
        start = np.broadcast_to(reference.quaternion[0], reference.quaternion.shape)
        angles = np.max(angle_between(reference.quaternion, start), axis=0)
        extents = np.array(mechanism.extents)
        for bodies in mechanism.connected_bodies:  # indices of the bodies of one mechanism
            group = list(bodies)
            lengths[group] = max(np.max(lengths[group]), MIN_SCALE * np.max(extents[group]))
            angles[group] = np.clip(np.max(angles[group]), MIN_SCALE, MAX_ANGLE_SCALE)
        lengths[0], angles[0] = np.max(lengths), np.max(angles)  # the ground has no error
        kinetic, potential = _energies(reference)
        names = reference.body_names
        return cls(
            lengths=dict(zip(names, lengths.tolist(), strict=True)),
            angles=dict(zip(names, angles.tolist(), strict=True)),
            energy=float(np.max(kinetic) + np.ptp(potential)),
        )

    @property
    def length(self) -> float:
        """Largest displacement of any center of mass, m."""
        return max(self.lengths.values())

    @property
    def angle(self) -> float:
        """Largest rotation of any body, at most 1 rad."""
        return max(self.angles.values())


def run_error(run: Trajectory, reference: Trajectory, scale: MotionScale) -> RunError:
    """Compare a run with a reference solution at the output times that both have.

    Args:
        run: run with the same bodies; it may end early.
        reference: reference solution.
        scale: extent of the reference's motion.
    """
    run, reference = common_outputs(run, reference)
    energy_changes = []  # of the run and of the reference: total energy (n,), J, minus that of the start
    for each in (run, reference):
        kinetic, potential = _energies(each)
        energy_changes.append(kinetic + potential - kinetic[0] - potential[0])
    energy_error = float(np.max(np.abs(energy_changes[0] - energy_changes[1])))
    position, rotation = errors_over_time(run, reference)
    names, times = run.body_names, run.time
    lengths, angles = ([each[name] for name in names] for each in (scale.lengths, scale.angles))
    # output and body of the largest errors relative to the motion
    worst, turned = _largest_at(position / lengths), _largest_at(rotation / angles)
    return RunError(
        position=float(position[worst]),
        position_at=(names[worst[1]], float(times[worst[0]])),
        rotation=float(rotation[turned]),
        rotation_at=(names[turned[1]], float(times[turned[0]])),
        energy=energy_error / scale.energy if scale.energy else 0.0,
        relative_position=float(position[worst]) / lengths[worst[1]],
        relative_rotation=float(rotation[turned]) / angles[turned[1]],
        largest_position=float(np.max(position)),
        largest_rotation=float(np.max(rotation)),
    )


def errors_over_time(run: Trajectory, reference: Trajectory) -> tuple[Array, Array]:
    """Return the errors of the centers of mass, m, and of the orientations, rad, of all bodies, (n, b) each.

    Args:
        run: run with the bodies and output times of the reference; it may end early.
        reference: reference solution.
    """
    run, reference = common_outputs(run, reference)
    position = np.linalg.norm(run.position - reference.position, axis=2)
    return position, angle_between(run.quaternion, reference.quaternion)


def _largest_at(errors: Array) -> tuple[int, int]:
    """Return the indices of the largest one of errors (n, k): output time and element."""
    output, element = np.unravel_index(int(np.argmax(errors)), errors.shape)
    return int(output), int(element)


def _energies(run: Trajectory) -> tuple[Array, Array]:
    """Return kinetic and potential energy (n,), J; zeros for a run without energies."""
    zeros = np.zeros(len(run.time))
    return (
        zeros if run.kinetic_energy is None else run.kinetic_energy,
        zeros if run.potential_energy is None else run.potential_energy,
    )
