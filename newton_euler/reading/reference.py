"""A model file as an independent parser compiles it: the reference for a scene imported from the file.

A package for a file format derives from `ReferenceModel`. The subclass evaluates the model of the format's
own parser (MuJoCo or Pinocchio) with that model's coordinates q and velocities v. This module finds
configurations with closed loops (`samples`), and the motions that the constraints leave free in these
configurations. It uses the imported scene only for the initial poses of its bodies.

The constraints are the loops and couplings of the file; J is their Jacobian with respect to dimensionless
velocities. Lengths are divided by the size of the mechanism, and their unit is then called "sizes". A small
singular value of J is *in doubt* if it may be due to rounded digits in the file: the constraints may or may
not hold the motion that belongs to it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from newton_euler.equations.dense import least_squares
from newton_euler.equations.system import MassProperties
from newton_euler.model.balls import rotation_vector
from newton_euler.model.scene import Scene
from newton_euler.reading.quantities import (
    HELD_SINGULAR_VALUE,
    Constraints,
    ForceLimit,
    Forces,
    Freedom,
    Kinematics,
    MassMatrices,
    freedom,
)
from newton_euler.scalars import Array

READING_ROUND_OFF = 1e-12
"""Relative round-off that a compared quantity may have: a generous bound for sums of hundreds of terms with
errors of 1e-16 each."""

MAX_USEFUL_TOLERANCE = 1e-4
"""Relative tolerance of motions above which a comparison at a state would miss most mistakes."""

DERIVATIVE_WEIGHTS = ((1, 4.0 / 5.0), (2, -1.0 / 5.0), (3, 4.0 / 105.0), (4, -1.0 / 280.0))
"""Central difference of order eight: pairs of an offset in steps, and its weight. The weight at the negative
offset is the negative weight."""

DERIVATIVE_STEPS = (2.5e-4, 1e-3)
"""Two time steps, s, of the central difference of J v: relative error 1e-13 for rotations at 1 rad/s.

Short rods rotate faster; tolerances include the difference of the results with the two steps."""

CLOSED_RESIDUAL = 1e-12
"""Constraint error that is round-off, rad or sizes."""

MAX_CLOSING_STEPS = 40
"""Largest number of Newton steps that close loops."""

MAX_FITTING_STEPS = 100
"""Largest number of steps of `ReferenceModel.fit_to_scene`, enough for several joints that are half a
revolution away."""

MAX_STEP_LENGTH = 0.2
"""Largest change of a coordinate in one step that closes loops or fits poses, rad or sizes."""

SAMPLE_AMPLITUDES = (0.2, 0.6, 2.5)
"""Amplitudes of random displacements from the start before loops are closed, rad or sizes."""

MAX_SAMPLE_DISTANCE = 2.9
"""Largest displacement of a sample from the start, rad or sizes: poses determine angles only up to half a
revolution (3.1 rad)."""

MAX_HINGE_ROW_ANGLE = 1.2
"""Largest random angle, rad, of consecutive hinges without a mass between them.

Beyond a quarter turn of the second of three such hinges, the poses of the bodies have a second solution for
the three angles."""

MAX_SAMPLE_CONDITION = 1e4
"""Condition number of the constraint Jacobian above which a random state is next to a singular
configuration."""

MAX_SAMPLE_TRIES = 12
"""Number of random displacements that are tried for each amplitude."""

NEARBY_AMPLITUDES = (1e-2, 1e-3, 1e-4, 1e-5)
"""Displacements along free motions at the start, rad or sizes, that are tried if loops close nowhere else."""

MIN_SAMPLE_DISTANCE = 1e-9
"""Smallest displacement of a sample from the start, rad or sizes; a smaller one is the start itself."""


class ReferenceModel(ABC):
    """Model file as its format's own parser compiles it: the reference for the imported scene.

    A rigid group is a set of links that fixed joints hold together: a body of the scene, or one half of a
    body that the file cuts at a loop.

    Attributes:
        names: (g,) name of the scene's body for each rigid group that can move. Two halves of a body have
            the same name.
        motions: (nv,) name of the joint of each velocity, as reports print it.
        lengths: (nv,) True for velocities of slides and free translations.
        units: (nv,) scales that make velocities dimensionless: `size` for lengths, 1 for angles.
        ranges: (nv,) largest random displacements of coordinates from the start, rad or sizes.
        size: size of the mechanism, m.
        file_state: configuration q and velocities v (nv,) in the file; loops may be open.
        closest: configuration nearest to that in the file, with loops closed as well as possible.
        start: configuration in which the bodies have the initial poses of the scene.
        near_start: constraints of the file at `closest` and at `start`.
        unaccounted: elements of the file that neither the scene nor its import report mentions.
    """

    names: tuple[str, ...]
    motions: tuple[str, ...]
    lengths: Array
    units: Array
    ranges: Array
    size: float
    file_state: tuple[Array, Array]
    closest: Array
    start: Array
    near_start: tuple[Constraints, Constraints]
    unaccounted: tuple[str, ...] = ()

    @abstractmethod
    def integrate(self, q: Array, step: Array) -> Array:
        """Return the configuration that constant velocities `step` (nv,) reach from `q` in 1 s."""

    @abstractmethod
    def difference(self, q: Array, other: Array) -> Array:
        """Return the constant velocities (nv,) that lead from `q` to `other` in 1 s."""

    @abstractmethod
    def mass_properties(self) -> MassProperties:
        """Return mass properties of the rigid groups at the start, in the order of `names`."""

    @abstractmethod
    def kinematics(self, q: Array, v: Array) -> Kinematics:
        """Compute the motion of the rigid groups at configuration `q` and velocities `v` (nv,)."""

    @abstractmethod
    def constraints(self, q: Array) -> Constraints:
        """Compute the constraint rows of all loops and couplings of the file, except those that the import
        report lists as left out."""

    @abstractmethod
    def mass_matrix(self, q: Array) -> tuple[Array, Array]:
        """Compute two mass matrices (nv, nv): of the bodies alone, and of the armatures (rotor inertias)."""

    @abstractmethod
    def forces(self, q: Array, v: Array) -> Forces:
        """Compute the generalized forces without constraint forces."""

    def force_limits(self, q: Array, v: Array) -> list[ForceLimit]:
        """Return the limits of forces in the file, each with the force at this state; in the same order at
        all states."""
        return []

    @abstractmethod
    def energies(self, q: Array, v: Array) -> tuple[float, float]:
        """Compute kinetic energy, and potential energy up to a constant, J."""

    @abstractmethod
    def elements(self, samples: Sequence[Sample]) -> Iterator[tuple[str, list[list[Array]]]]:
        """Yield the name of each force element of the file and the forces of this element alone.

        A mistake in the import of an element changes its forces in one of a few ways. The element has a list
        of forces for each way. A spring, for example, has two: with the rest length of the file, and with
        another rest length. A list has an array (4, nv) for each sample, with a row for each of the
        `newton_euler.reading.quantities.FORCE_KINDS` (gravity, springs, dampers, actuators).
        """

    @abstractmethod
    def armatures(self, samples: Sequence[Sample]) -> Iterator[tuple[str, list[Array]]]:
        """Yield the name of each element with an armature, and its mass matrix (nv, nv) at each sample."""

    @abstractmethod
    def keep_offsets(self) -> None:
        """Redefine each constraint so that it is closed at the start: move its second end to the first end.

        With the rounded digits of a file, loops may stay open by a small offset. An imported scene treats the
        offset as a part of its geometry, and so does the reference model after this call.
        """

    def find_start(self, scene: Scene) -> None:
        """Set `closest`, `start` and `near_start` from `file_state` and the initial poses of a scene.

        Distances between configurations are measured as the readers of MJCF and URDF files measure them:
        lengths are divided by the largest distance of a center of mass or a joint from their mean.
        """
        q, _ = self.file_state
        points = self.points(q)
        length = float(np.max(np.linalg.norm(points - np.mean(points, axis=0), axis=1))) or 1.0
        self.closest = self.close_loops(q, np.where(self.lengths, length, 1.0))[0]
        self.start = self.fit_to_scene(self.closest, scene)
        self.near_start = self.constraints(self.closest), self.constraints(self.start)

    @property
    def offset(self) -> float:
        """Largest constraint error of the file at the start, sizes or rad."""
        return float(np.max(np.abs(self.near_start[1].residual), initial=0.0))

    @abstractmethod
    def points(self, q: Array) -> Array:
        """Return (k, 3) centers of mass and joints of all moving bodies, m."""

    def close_loops(self, q: Array, metric: Array | None = None) -> tuple[Array, float]:
        """Close loops by Newton steps of least norm.

        Args:
            q: configuration to begin with.
            metric: (nv,) scales by which the components of a step are divided in its norm; `units` if None.

        Returns:
            The configuration with the smallest constraint error, and this error, sizes or rad.
        """
        metric = self.units if metric is None else metric
        best, smallest = q, np.inf
        for _ in range(MAX_CLOSING_STEPS):
            residual, rows, _ = self.constraints(q)
            error = float(np.max(np.abs(residual), initial=0.0))
            if error < smallest:
                best, smallest = q, error
            elif smallest < 1e3 * CLOSED_RESIDUAL:
                break  # only round-off is left
            if smallest <= 0.1 * CLOSED_RESIDUAL:
                break
            # Singular values of redundant rows count as zero: with rounded digits, such rows would cause
            # huge steps
            step = least_squares(rows * (metric / self.units), residual, HELD_SINGULAR_VALUE)
            step *= min(1.0, MAX_STEP_LENGTH / max(float(np.max(np.abs(step))), CLOSED_RESIDUAL))
            q = self.integrate(q, -step * metric)
        return best, smallest

    def fit_to_scene(self, q: Array, scene: Scene) -> Array:
        """Fit the configuration to the initial poses of a scene's bodies by Gauss-Newton steps from `q`.

        Returns:
            The configuration with the smallest difference of poses; `q` if the scene lacks a body.
        """
        poses = {body.name: body.pose for body in scene.mechanism.bodies}
        if not set(self.names) <= set(poses):
            return q
        # The first of two halves of a body has the pose of the body
        is_first = [self.names.index(name) == k for k, name in enumerate(self.names)]
        wanted = [poses[name] for name in dict.fromkeys(self.names)]
        best, smallest = q, np.inf
        for _ in range(MAX_FITTING_STEPS):
            found = self.kinematics(q, np.zeros(len(self.units)))
            # Differences of poses: (positions in sizes, rotation vector in rad)
            gap = np.zeros((len(wanted), 6))
            pairs = zip(wanted, found.position[is_first], found.rotation[is_first], strict=True)
            for k, (pose, position, rotation) in enumerate(pairs):
                gap[k, :3] = (pose.position - position) / self.size
                gap[k, 3:] = rotation_vector(pose.rotation @ rotation.T)
            error = float(np.max(np.abs(gap)))
            # Stop at round-off: the error no longer decreases, or by less than a factor of 2
            if error < smallest:
                best, is_slow = q, error > 0.5 * smallest
                smallest = error
                if is_slow and error < 1e3 * CLOSED_RESIDUAL:
                    break
            elif smallest < 1e6 * CLOSED_RESIDUAL:
                break
            rows = found.transformation[is_first] / np.repeat([self.size, 1.0], 3)[:, None] * self.units
            step = least_squares(rows.reshape(-1, len(self.units)), gap.ravel())
            step *= min(1.0, MAX_STEP_LENGTH / max(float(np.max(np.abs(step))), CLOSED_RESIDUAL))
            q = self.integrate(q, self.units * step)
        return best

    @cached_property
    def samples(self) -> list[Sample]:
        """The start, and random states with closed loops near and far from the start.

        All have random velocities that satisfy the constraints. If loops close nowhere else, the start is the
        only sample.
        """
        rng = np.random.default_rng(0)
        start = self._sample(self.start, rng)
        found = [start]
        # Find at most one sample for each amplitude; each attempt has a smaller displacement
        for amplitude in SAMPLE_AMPLITUDES:
            tried = (self._displaced(amplitude * 0.7**attempt, rng) for attempt in range(MAX_SAMPLE_TRIES))
            found += self._first_closed(tried, start, rng)
        # If loops closed nowhere, displace the start a little along its free motions: columns of `basis`
        # (nv, d), one for each of the d independent velocities
        if len(found) == 1 and len(start.freedom.independent):
            basis, scale = start.freedom.basis, self.units[start.freedom.independent]
            steps = (basis @ (scale * rng.uniform(-1.0, 1.0, len(scale))) for _ in NEARBY_AMPLITUDES)
            tried = (
                self.integrate(self.start, amplitude * step)
                for amplitude, step in zip(NEARBY_AMPLITUDES, steps, strict=True)
            )
            found += self._first_closed(tried, start, rng)
        return found

    @property
    def is_informative(self) -> bool:
        """True if a comparison at any sample has a useful tolerance, see `Sample.is_informative`."""
        return any(sample.is_informative for sample in self.samples)

    def _first_closed(
        self, tried: Iterable[Array], start: Sample, rng: np.random.Generator
    ) -> Iterator[Sample]:
        """Yield a sample at the first closed configuration to which one of the tried configurations leads.

        Loops must close about as well as at the start, away from the start and from singular configurations.
        No sample is yielded if all tried configurations fail.

        Args:
            tried: configurations with open loops.
            start: sample at the start of the scene.
            rng: source of the random velocities.
        """
        max_error = max(CLOSED_RESIDUAL, 3.0 * start.closure_error, 10.0 * start.freedom.doubtful_value)
        max_condition = max(MAX_SAMPLE_CONDITION, 10.0 * start.freedom.condition)
        for open_q in tried:
            q, error = self.close_loops(open_q)
            distance = np.max(np.abs(self.difference(self.start, q)) / self.units, initial=0.0)
            if error > max_error or not MIN_SAMPLE_DISTANCE < distance <= MAX_SAMPLE_DISTANCE:
                continue
            sample = self._sample(q, rng)
            if sample.freedom.condition > max_condition:
                continue
            if sample.is_informative or not start.is_informative:
                yield sample
                return

    @cached_property
    def open_loop_samples(self) -> list[Sample]:
        """Random configurations with open loops, at rest; the constraints are ignored, so that all nv
        velocities count as free."""
        rng, count = np.random.default_rng(1), len(self.units)
        free = freedom(np.zeros((0, count)), self.units)
        configurations = [self._displaced(amplitude, rng) for amplitude in SAMPLE_AMPLITUDES]
        return [Sample(self, q, np.zeros(count), 0.0, free) for q in configurations]

    def _displaced(self, amplitude: float, rng: np.random.Generator) -> Array:
        """Return a random configuration, displaced from the start by at most `amplitude`, rad or sizes."""
        reach = np.minimum(amplitude, self.ranges) * self.units
        return self.integrate(self.start, reach * rng.uniform(-1.0, 1.0, len(reach)))

    def _sample(self, q: Array, rng: np.random.Generator) -> Sample:
        """Make a sample at a configuration, with random velocities of about 1 rad/s or 1 size/s along the
        motions that the constraints do not hold."""
        residual, jacobian, _ = self.constraints(q)
        free = freedom(jacobian, self.units)
        v = free.basis @ (self.units[free.independent] * rng.standard_normal(len(free.independent)))
        v = v / max(1.0, float(np.max(np.abs(v / self.units), initial=0.0)))
        return Sample(self, q, v, float(np.max(np.abs(residual), initial=0.0)), free)


@dataclass(frozen=True, eq=False)
class Sample:
    """State of a reference model, at which the file and its scene are compared.

    Other quantities of the state are computed at their first use.

    Attributes:
        reference: model of the file.
        q: configuration.
        v: (nv,) velocities, SI.
        closure_error: largest constraint error, sizes or rad; without the offsets at the start, see
            `ReferenceModel.keep_offsets`.
        freedom: motions that the constraints do not hold, with the condition number of the constraints.
    """

    reference: ReferenceModel
    q: Array
    v: Array
    closure_error: float
    freedom: Freedom

    @property
    def precision(self) -> float:
        """Relative precision of coordinates: `READING_ROUND_OFF`, plus the round-off of the largest distance
        from the origin in sizes."""
        distance = float(np.max(np.abs(self.kinematics.position), initial=0.0)) / self.reference.size
        return READING_ROUND_OFF + 10.0 * float(np.finfo(float).eps) * distance

    @property
    def tolerance(self) -> float:
        """Relative tolerance of forces along independent velocities: precision times condition number.

        The loop-closure error does not count, because both models have bodies at the same poses.
        """
        return self.precision * self.freedom.condition

    @property
    def tolerance_of_motion(self) -> float:
        """Relative tolerance of motions.

        The tolerance is that of forces, plus ten times the sum of the constraint error and the largest
        singular value in doubt (`Freedom.doubtful_value`), times the condition number. Such errors matter
        because different equations of motion omit different combinations of redundant constraint rows.
        """
        error = self.closure_error + self.freedom.doubtful_value
        return self.tolerance + 10.0 * error * self.freedom.condition

    @property
    def is_informative(self) -> bool:
        """True if the tolerance of motions is small enough for a comparison to find mistakes."""
        return self.tolerance_of_motion <= MAX_USEFUL_TOLERANCE

    @cached_property
    def kinematics(self) -> Kinematics:
        """Motion of the rigid groups (links that fixed joints hold together)."""
        return self.reference.kinematics(self.q, self.v)

    @cached_property
    def constraints(self) -> Constraints:
        """Constraint rows at the configuration."""
        return self.reference.constraints(self.q)

    @cached_property
    def mass_matrices(self) -> MassMatrices:
        """Mass matrices (nv, nv) of the bodies and of the armatures."""
        return MassMatrices(*self.reference.mass_matrix(self.q))

    @cached_property
    def forces(self) -> Forces:
        """Generalized forces without constraint forces."""
        return self.reference.forces(self.q, self.v)

    @cached_property
    def energies(self) -> tuple[float, float]:
        """Kinetic and potential energy, J."""
        return self.reference.energies(self.q, self.v)

    @cached_property
    def velocity_products(self) -> tuple[Array, Array]:
        """Products dJ/dt v (k,) along the motion with constant velocities, dimensionless, by central
        differences with each of the two `DERIVATIVE_STEPS`."""
        found = []
        for step in DERIVATIVE_STEPS:
            total = np.zeros(len(self.constraints.residual))
            for number, weight in DERIVATIVE_WEIGHTS:
                for sign in (1.0, -1.0):
                    q = self.reference.integrate(self.q, sign * number * step * self.v)
                    rate = self.reference.constraints(q).jacobian @ (self.v / self.reference.units)
                    total += sign * weight / step * rate
            found.append(total)
        return found[0], found[1]


def whole_body_names(names: Sequence[str], bodies: Sequence[str]) -> tuple[str, ...]:
    """Replace the names of the halves of cut bodies by the names of the bodies.

    The export of scenes to MJCF and URDF cuts a body at a loop and names the second half BODY_at_JOINT.

    Args:
        names: names of bodies and halves in a file.
        bodies: names of the scene's bodies.
    """
    known = set(bodies)
    found = []
    for name in names:
        ends = [k for k in range(len(name)) if name.startswith("_at_", k) and name[:k] in known]
        found.append(name[: ends[-1]] if ends and name not in known else name)
    return tuple(found)
