"""Error of a run against a reference solution, in absolute numbers and relative to the motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import Literal, assert_never

import numpy as np

from crosscheck.own_run.interpolation import TIME_TOLERANCE, common_outputs
from newton_euler.model.euler_parameters import angle_between
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.trajectory import Trajectory
from newton_euler.reading.file_run import LoopErrors
from newton_euler.scalars import Array

ACCURATE_BELOW, OFF_BELOW = 1e-3, 1e-2
"""Relative errors that separate the bands. Parameters of real robots are known to about 1 %. A simulation
error below 0.1 % adds nothing to that; above 1 % the simulation is the largest error."""

MIN_SCALE = 1e-2
"""Smallest motion, in sizes of the mechanism or rad, that errors are divided by, for a mechanism that nearly
rests. An error of 1e-5 sizes, such as 10 um on a robot of 1 m, is accurate even then."""

MAX_ANGLE_SCALE = 1.0
"""Largest rotation, rad, that errors of rotations are divided by: many revolutions excuse no larger error."""

MIN_STATED_POSITION = 0.5
"""Smallest relative error of positions by which reports state the error of a run, as a fraction of the larger
relative error. A smaller one is stated by rotations. People judge lengths more easily than angles."""


NO_MOTION = 1e-9
"""Largest motion, m or rad, that counts as none."""


class Band(StrEnum):
    """Accuracy of a run in words."""

    ACCURATE = "ACCURATE"
    """The relative error is below 0.1 %."""
    OFF = "OFF"
    """The relative error is below 1 %."""
    WRONG = "WRONG"
    """The relative error is 1 % or more, or the run diverged."""
    NOT_JUDGED = "NOT JUDGED"
    """No output after the start is compared, as the motion is chaotic or an element acts that the reference
    does not simulate; or nothing moves."""

    @property
    def verdict(self) -> Literal["holds", "doubtful", "fails"]:
        """Judgement of tables and colors, see `crosscheck.report.table`."""
        match self:
            case Band.ACCURATE:
                return "holds"
            case Band.OFF | Band.NOT_JUDGED:
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
        relative_position: `position`, divided by `MechanismMotion.length_scale`.
        relative_rotation: `rotation`, divided by `MechanismMotion.angle_scale`.
        largest_position: largest error of any center of mass, m. It is larger than `position` if a body of
            another mechanism that moves farther has this error.
        largest_rotation: largest error of any orientation, rad.
        outputs: number of outputs after the start at which all mechanisms are compared.
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
    outputs: int

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
        if not self.outputs:
            return Band.NOT_JUDGED
        if self.relative < ACCURATE_BELOW:
            return Band.ACCURATE
        return Band.OFF if self.relative < OFF_BELOW else Band.WRONG


@dataclass(frozen=True)
class LoopError:
    """Largest violations of the loop constraints of a run.

    Attributes:
        opening: largest violation of a constraint of lengths, m, such as the gap between two points.
        opening_at: constraint and time, s, of that violation; the name is "" without constraints of lengths.
        angle: largest violation of a constraint of angles, rad.
        angle_at: constraint and time, s, of that violation; the name is "" without constraints of angles.
    """

    opening: float = 0.0
    opening_at: tuple[str, float] = ("", 0.0)
    angle: float = 0.0
    angle_at: tuple[str, float] = ("", 0.0)

    @classmethod
    def of(cls, found: LoopErrors, times: Array) -> LoopError:
        """Find the largest violations up to the last one of the given times, s."""
        lengths = cls._largest(found.openings, found.have_lengths, found.names, times)
        return cls(*lengths, *cls._largest(found.angles, found.have_angles, found.names, times))

    @staticmethod
    def _largest(
        errors: Array, counts: Array, names: tuple[str, ...], times: Array
    ) -> tuple[float, tuple[str, float]]:
        """Return the largest one of errors (n, k) of the constraints that count (k,), and where it is."""
        kept = np.flatnonzero(counts)
        if not len(kept):
            return 0.0, ("", 0.0)
        output, loop = _largest_at(errors[: len(times), kept])
        return float(errors[output, kept[loop]]), (names[kept[loop]], float(times[output]))


@dataclass(frozen=True)
class MechanismMotion:
    """Extent of the motion of one mechanism: of bodies that joints connect without the ground.

    Attributes:
        bodies: names of the bodies.
        size: largest distance between two points of the mechanism at the start, m; points are the joints, or
            those at the root mean square distance of a body's mass from its center of mass.
        length: largest displacement of a center of mass, m.
        angle: largest rotation of a body, rad.
        until: time, s, at which the comparison of the mechanism ends because its motion is chaotic or
            unstable from then on: a change of its start has grown by a factor of 1000. None if it is compared
            to the end.
    """

    bodies: tuple[str, ...]
    size: float
    length: float
    angle: float
    until: float | None

    @property
    def length_scale(self) -> float:
        """Length, m, that errors of positions are divided by."""
        return max(self.length, MIN_SCALE * self.size)

    @property
    def angle_scale(self) -> float:
        """Angle, rad, that errors of orientations are divided by."""
        return min(max(self.angle, MIN_SCALE), MAX_ANGLE_SCALE)

    def moves(self, by_position: bool) -> bool:
        """Return True if errors of positions, or of orientations, are divided by the motion itself."""
        return self.length >= MIN_SCALE * self.size if by_position else self.angle >= MIN_SCALE

    def outputs(self, times: Array) -> int:
        """Return the number of output times, s, at which the mechanism is compared."""
        return outputs_before(times, self.until)


@dataclass(frozen=True)
class MotionScale:
    """Extent of a motion, by which errors are divided.

    Each mechanism has its own scale: a small mechanism beside one that falls far is judged by its own motion.

    Attributes:
        mechanisms: extent of the motion of each mechanism.
        energy: largest kinetic energy plus the range of the potential energy of all bodies, J, while all
            mechanisms are compared; at least the energy of pendulums of the mechanisms' masses and sizes that
            swing by 0.01 rad.
    """

    mechanisms: tuple[MechanismMotion, ...]
    energy: float

    @classmethod
    def of(
        cls, reference: Trajectory, mechanism: Mechanism, horizons: Sequence[float | None] = ()
    ) -> MotionScale:
        """Measure a reference solution.

        Args:
            reference: run with energies.
            mechanism: mechanism of the run.
            horizons: `MechanismMotion.until` of each of `Mechanism.connected_bodies`; empty if none is
                chaotic.
        """
        groups = mechanism.connected_bodies  # indices of the bodies of each mechanism
        moved = np.linalg.norm(reference.position - reference.position[0], axis=2)
        start = np.broadcast_to(reference.quaternion[0], reference.quaternion.shape)
        turned = angle_between(reference.quaternion, start)
        extents = np.array(mechanism.extents)
        motions = []
        for bodies, until in zip(groups, horizons or [None] * len(groups), strict=True):
            group = list(bodies)
            centers, extent = reference.position[0, group], extents[group]
            # (k, k) distances between the outermost points of each two bodies
            gaps = np.linalg.norm(centers[:, None] - centers, axis=2) + extent[:, None] + extent
            count = outputs_before(reference.time, until)
            motions.append(
                MechanismMotion(
                    bodies=tuple(reference.body_names[body] for body in bodies),
                    size=float(np.max(gaps)),
                    length=float(np.max(moved[:count, group])),
                    angle=float(np.max(turned[:count, group])),
                    until=until,
                )
            )
        count = min(motion.outputs(reference.time) for motion in motions)
        kinetic, potential = (energy[:count] for energy in _energies(reference))
        masses = [sum(mechanism.bodies[body].mass for body in bodies) for bodies in groups]
        # energy m g l (1 - cos a) of a pendulum that swings by the angle a, for small angles, g = 9.81 m/s^2
        swings = [
            0.5 * mass * 9.81 * motion.size * MIN_SCALE**2
            for mass, motion in zip(masses, motions, strict=True)
        ]
        return cls(tuple(motions), energy=max(float(np.max(kinetic) + np.ptp(potential)), sum(swings)))

    @cached_property
    def by_body(self) -> Mapping[str, MechanismMotion]:
        """The motion of the mechanism of each body, by the name of the body; the ground is not in it."""
        return {body: motion for motion in self.mechanisms for body in motion.bodies}

    @property
    def rests(self) -> bool:
        """True if no mechanism moves."""
        return all(max(each.length, each.angle) <= NO_MOTION for each in self.mechanisms)

    @property
    def length(self) -> float:
        """Largest length, m, that errors of positions are divided by."""
        return max(motion.length_scale for motion in self.mechanisms)

    @property
    def angle(self) -> float:
        """Largest angle, rad, that errors of orientations are divided by."""
        return max(motion.angle_scale for motion in self.mechanisms)

    def outputs(self, times: Array) -> int:
        """Return the number of output times, s, at which all mechanisms are compared."""
        return min(motion.outputs(times) for motion in self.mechanisms)


def early_chaos_text(scale: MotionScale) -> str:
    """Tell that a motion is chaotic before its first output after the start, and since when."""
    since = min(motion.until for motion in scale.mechanisms if motion.until is not None)
    return f"the motion is chaotic or unstable before its first output after the start, at {since:.3g} s"


def outputs_before(times: Array, end: float | None) -> int:
    """Return the number of output times, s, before an end, but at least 1, for the start.

    Without an end, that is, None, all count.
    """
    if end is None:
        return len(times)
    return max(1, int(np.searchsorted(times, end - TIME_TOLERANCE)))


def run_error(run: Trajectory, reference: Trajectory, scale: MotionScale) -> RunError:
    """Compare a run with a reference solution at the output times that both have.

    Args:
        run: run with the same bodies; it may end early.
        reference: reference solution.
        scale: extent of the reference's motion. A chaotic mechanism is compared until its `until`, the total
            energy while all mechanisms are compared.
    """
    run, reference = common_outputs(run, reference)
    energy_changes = []  # of the run and of the reference: total energy (n,), J, minus that of the start
    for each in (run, reference):
        kinetic, potential = (energy[: scale.outputs(run.time)] for energy in _energies(each))
        energy_changes.append(kinetic + potential - kinetic[0] - potential[0])
    energy_error = float(np.max(np.abs(energy_changes[0] - energy_changes[1])))
    # errors (n, b) of the bodies of mechanisms, zero from the end of their comparison on
    moving = [k for k, name in enumerate(run.body_names) if name in scale.by_body]
    names, times = [run.body_names[k] for k in moving], run.time
    motions = [scale.by_body[name] for name in names]
    compared = np.arange(len(times))[:, None] < [motion.outputs(times) for motion in motions]
    position, rotation = (np.where(compared, errors[:, moving], 0.0) for errors in _distances(run, reference))
    lengths = [motion.length_scale for motion in motions]
    angles = [motion.angle_scale for motion in motions]
    # output and body of the largest errors relative to the motion
    worst, turned = _largest_at(position / lengths), _largest_at(rotation / angles)
    return RunError(
        position=float(position[worst]),
        position_at=(names[worst[1]], float(times[worst[0]])),
        rotation=float(rotation[turned]),
        rotation_at=(names[turned[1]], float(times[turned[0]])),
        energy=energy_error / scale.energy,
        relative_position=float(position[worst]) / lengths[worst[1]],
        relative_rotation=float(rotation[turned]) / angles[turned[1]],
        largest_position=float(np.max(position)),
        largest_rotation=float(np.max(rotation)),
        outputs=min(motion.outputs(times) for motion in motions) - 1,
    )


def errors_over_time(run: Trajectory, reference: Trajectory) -> tuple[Array, Array]:
    """Return the errors of the centers of mass, m, and of the orientations, rad, of all bodies, (n, b) each.

    Args:
        run: run with the bodies and output times of the reference; it may end early.
        reference: reference solution.
    """
    return _distances(*common_outputs(run, reference))


def _distances(run: Trajectory, reference: Trajectory) -> tuple[Array, Array]:
    """Return the errors of `errors_over_time` of two runs with equal output times."""
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
