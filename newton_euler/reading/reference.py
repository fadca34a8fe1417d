"""A model file as an independent reader holds it, to verify a scene that was read from the file.

A package for a file format derives from `ReferenceModel`: the subclass evaluates the model of the format's
own parser, in that model's velocities. Closed states and the free motions of these states are computed here,
without the scene under test.
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
    freedom,
)
from newton_euler.scalars import Array

READING_ROUND_OFF = 1e-12
"""Relative error of some hundred operations, each with an error of 1e-16, on compiled numbers."""

MAX_USEFUL_TOLERANCE = 1e-4
"""Relative tolerance above which a state tests next to nothing."""
DERIVATIVE_WEIGHTS = ((1, 4.0 / 5.0), (2, -1.0 / 5.0), (3, 4.0 / 105.0), (4, -1.0 / 280.0))
"""Offsets and weights of central differences of order eight."""

DERIVATIVE_STEPS = (2.5e-4, 1e-3)
"""Steps, s, of the derivative of J v along a motion: relative error 1e-13 for rotations at 1 rad/s.

Short rods turn faster; tolerances include the difference of the two steps."""

CLOSED_RESIDUAL = 1e-12
"""Constraint error, sizes or rad, that is round-off."""

MAX_CLOSING_STEPS = 40
"""Largest number of Newton steps that close loops."""

MAX_ALIGNING_STEPS = 100
"""Largest number of steps of `ReferenceModel.aligned`, for several joints that are half a revolution away."""

MAX_CLOSING_STEP = 0.2
"""Largest change of a coordinate in one step, rad or sizes."""

SAMPLE_AMPLITUDES = (0.2, 0.6, 2.5)
"""Amplitudes of random displacements from the start before loops are closed, rad or sizes."""

MAX_SAMPLE_DISTANCE = 2.9
"""Largest displacement of a sample, rad or sizes: poses determine angles up to half a revolution."""

MAX_HINGE_ROW_ANGLE = 1.2
"""Largest random angle of hinges in a row without a mass between them, rad.

Beyond a quarter turn of the second of three hinges, poses determine other angles."""

MAX_SAMPLE_CONDITION = 1e4
"""Condition number of constraints above which a random state is next to a singular configuration."""

MAX_SAMPLE_TRIES = 12
"""Number of random displacements per amplitude before the amplitude is given up."""

NEARBY_AMPLITUDES = (1e-2, 1e-3, 1e-4, 1e-5)
"""Displacements along free motions at the start, rad or sizes, if loops close nowhere else."""

MIN_SAMPLE_DISTANCE = 1e-9
"""Smallest displacement of a sample from the start, rad or sizes."""


class ReferenceModel(ABC):
    """Model file as its format's own parser compiles it: the reference for the imported scene.

    Attributes:
        names: names in the scene of the rigid groups of moving bodies. Two halves of a body that a loop was
            cut through have the same name.
        motions: (nv,) name of the joint of each velocity, as reports print it.
        lengths: (nv,) True for velocities of slides and free translations.
        units: (nv,) units of velocities: `size` for lengths, 1 for angles.
        ranges: (nv,) largest random displacements of coordinates from the start, rad or sizes.
        size: size of the mechanism, m.
        stated: configuration q and velocities (nv,) in the file; loops may be open.
        closest: configuration next to the stated one with loops closed as well as possible.
        start: configuration in which bodies are at their initial poses in the scene.
        open: constraints of the file at `closest` and at `start`.
        unaccounted: elements that neither the scene nor its report mentions.
    """

    names: tuple[str, ...]
    motions: tuple[str, ...]
    lengths: Array
    units: Array
    ranges: Array
    size: float
    stated: tuple[Array, Array]
    closest: Array
    start: Array
    open: tuple[Constraints, Constraints]
    unaccounted: tuple[str, ...] = ()

    @abstractmethod
    def moved(self, q: Array, step: Array) -> Array:
        """Return the configuration after velocities `step` (nv,) for 1 s."""

    @abstractmethod
    def difference(self, q: Array, other: Array) -> Array:
        """Return the step (nv,) from configuration `q` to configuration `other`."""

    @abstractmethod
    def mass_properties(self) -> MassProperties:
        """Return mass properties of the rigid groups at the start, in the order of `names`."""

    @abstractmethod
    def kinematics(self, q: Array, v: Array) -> Kinematics:
        """Compute the motion of the rigid groups."""

    @abstractmethod
    def constraints(self, q: Array) -> Constraints:
        """Compute rows of all loops and couplings of the file that the report does not leave out."""

    @abstractmethod
    def mass_matrix(self, q: Array) -> tuple[Array, Array]:
        """Compute the mass matrices (nv, nv) of the bodies and of the rotors."""

    @abstractmethod
    def forces(self, q: Array, v: Array) -> Forces:
        """Compute the generalized forces without constraint forces."""

    def force_limits(self, q: Array, v: Array) -> list[ForceLimit]:
        """Return the watched limits of forces, the same elements at all states."""
        return []

    @abstractmethod
    def energies(self, q: Array, v: Array) -> tuple[float, float]:
        """Compute kinetic energy, and potential energy up to a constant, J."""

    @abstractmethod
    def elements(self, samples: Sequence[Sample]) -> Iterator[tuple[str, list[list[Array]]]]:
        """Yield the name of each element and its forces alone (4, nv), of all `FORCE_KINDS`, at each sample.

        An element has a list of forces for each way in which it can act, such as a spring with its own and
        with another rest length.
        """

    @abstractmethod
    def rotors(self, samples: Sequence[Sample]) -> Iterator[tuple[str, list[Array]]]:
        """Yield the name of each element with an armature and its mass matrix (nv, nv) at each sample."""

    @abstractmethod
    def keep_offsets(self) -> None:
        """Define each constraint as closed at the start: move its second end to the first.

        The rounded digits of a file may not close its loops. Scenes keep the remaining offsets.
        """

    def begin(self, scene: Scene) -> None:
        """Find the closed configuration next to the stated one, and the start of the scene.

        The metric is the one of readers: lengths are divided by the spread of centers of mass and joints.
        """
        q, _ = self.stated
        points = self.points(q)
        length = float(np.max(np.linalg.norm(points - np.mean(points, axis=0), axis=1))) or 1.0
        self.closest = self.closed(q, np.where(self.lengths, length, 1.0))[0]
        self.start = self.aligned(self.closest, scene)
        self.open = self.constraints(self.closest), self.constraints(self.start)

    @property
    def offset(self) -> float:
        """Largest offset of loops at the start, sizes or rad."""
        return float(np.max(np.abs(self.open[1].residual), initial=0.0))

    @abstractmethod
    def points(self, q: Array) -> Array:
        """Return (k, 3) centers of mass and joints of all moving bodies, m."""

    def closed(self, q: Array, metric: Array | None = None) -> tuple[Array, float]:
        """Close loops by Newton steps of least norm.

        Args:
            q: configuration to begin with.
            metric: (nv,) units of distances, `units` if None.

        Returns:
            The configuration with the smallest constraint error, and this error, sizes or rad.
        """
        metric = self.units if metric is None else metric
        best, least = q, np.inf
        for _ in range(MAX_CLOSING_STEPS):
            residual, rows, _ = self.constraints(q)
            now = float(np.max(np.abs(residual), initial=0.0))
            if now < least:
                best, least = q, now
            elif least < 1e3 * CLOSED_RESIDUAL:
                break
            if least <= 0.1 * CLOSED_RESIDUAL:
                break
            step = least_squares(rows * (metric / self.units), residual, HELD_SINGULAR_VALUE)
            step *= min(1.0, MAX_CLOSING_STEP / max(float(np.max(np.abs(step))), CLOSED_RESIDUAL))
            q = self.moved(q, -step * metric)
        return best, least

    def aligned(self, q: Array, scene: Scene) -> Array:
        """Fit the configuration to the initial poses of a scene's bodies, beginning at q."""
        poses = {body.name: body.pose for body in scene.mechanism.bodies}
        if not set(self.names) <= set(poses):
            return q
        first = [self.names.index(name) == k for k, name in enumerate(self.names)]
        wanted = [poses[name] for name in dict.fromkeys(self.names)]
        best, least = q, np.inf
        for _ in range(MAX_ALIGNING_STEPS):
            found = self.kinematics(q, np.zeros(len(self.units)))
            gap = np.zeros((len(wanted), 6))
            pairs = zip(wanted, found.position[first], found.rotation[first], strict=True)
            for k, (pose, position, rotation) in enumerate(pairs):
                gap[k, :3] = (pose.position - position) / self.size
                gap[k, 3:] = rotation_vector(pose.rotation @ rotation.T)
            now = float(np.max(np.abs(gap)))
            if now < least:
                best, worse = q, now > 0.5 * least
                least = now
                if worse and now < 1e3 * CLOSED_RESIDUAL:
                    break
            elif least < 1e6 * CLOSED_RESIDUAL:
                break
            rows = found.transformation[first] / np.repeat([self.size, 1.0], 3)[:, None] * self.units
            step = least_squares(rows.reshape(-1, len(self.units)), gap.ravel())
            step *= min(1.0, MAX_CLOSING_STEP / max(float(np.max(np.abs(step))), CLOSED_RESIDUAL))
            q = self.moved(q, self.units * step)
        return best

    @cached_property
    def samples(self) -> list[Sample]:
        """Start and random closed states near and far, all with random velocities.

        If loops close nowhere else, the start is the only sample.
        """
        rng = np.random.default_rng(0)
        start = self._sample(self.start, rng)
        found = [start]
        for amplitude in SAMPLE_AMPLITUDES:
            tried = (self._far(amplitude * 0.7**attempt, rng) for attempt in range(MAX_SAMPLE_TRIES))
            found += self._first_closed(tried, start, rng)
        if len(found) == 1 and len(start.freedom.rows):
            basis, scale = start.freedom.basis, self.units[start.freedom.rows]
            steps = (basis @ (scale * rng.uniform(-1.0, 1.0, len(scale))) for _ in NEARBY_AMPLITUDES)
            tried = (
                self.moved(self.start, reach * step)
                for reach, step in zip(NEARBY_AMPLITUDES, steps, strict=True)
            )
            found += self._first_closed(tried, start, rng)
        return found

    @property
    def tells(self) -> bool:
        """True if any sample shows motions that differ by more than `MAX_USEFUL_TOLERANCE`."""
        return any(sample.tells for sample in self.samples)

    def _first_closed(
        self, tried: Iterable[Array], start: Sample, rng: np.random.Generator
    ) -> Iterator[Sample]:
        """Yield the first configuration, if any, next to which loops close as well as at the start."""
        allowed = max(CLOSED_RESIDUAL, 3.0 * start.opening, 10.0 * start.freedom.doubt)
        worst = max(MAX_SAMPLE_CONDITION, 10.0 * start.freedom.condition)
        for q in tried:
            q, opening = self.closed(q)
            away = np.max(np.abs(self.difference(self.start, q)) / self.units, initial=0.0)
            if opening > allowed or not MIN_SAMPLE_DISTANCE < away <= MAX_SAMPLE_DISTANCE:
                continue
            sample = self._sample(q, rng)
            if sample.freedom.condition <= worst and (sample.tells or not start.tells):
                yield sample
                return

    @cached_property
    def far(self) -> list[Sample]:
        """Random configurations with open loops."""
        rng, count = np.random.default_rng(1), len(self.units)
        free = freedom(np.zeros((0, count)), self.units)
        places = [self._far(amplitude, rng) for amplitude in SAMPLE_AMPLITUDES]
        return [Sample(self, q, np.zeros(count), 0.0, free) for q in places]

    def _far(self, amplitude: float, rng: np.random.Generator) -> Array:
        reach = np.minimum(amplitude, self.ranges) * self.units
        return self.moved(self.start, reach * rng.uniform(-1.0, 1.0, len(reach)))

    def _sample(self, q: Array, rng: np.random.Generator) -> Sample:
        residual, jacobian, _ = self.constraints(q)
        free = freedom(jacobian, self.units)
        v = free.basis @ (self.units[free.rows] * rng.standard_normal(len(free.rows)))
        v = v / max(1.0, float(np.max(np.abs(v / self.units), initial=0.0)))
        return Sample(self, q, v, float(np.max(np.abs(residual), initial=0.0)), free)


@dataclass(frozen=True, eq=False)
class Sample:
    """State of a reference model, with quantities that are computed at their first use.

    Attributes:
        reference: model of the file.
        q: configuration.
        v: (nv,) velocities, SI.
        opening: constraint error beyond the offsets at the start, sizes or rad.
        freedom: motions that the constraints do not hold.
    """

    reference: ReferenceModel
    q: Array
    v: Array
    opening: float
    freedom: Freedom

    @property
    def precision(self) -> float:
        """Relative precision of coordinates: round-off, plus round-off of the distance from the origin."""
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
        """Relative tolerance of motions: adds ten times the constraint error and the singular value in doubt.

        Different equations of motion omit different combinations of redundant rows.
        """
        return self.tolerance + 10.0 * (self.opening + self.freedom.doubt) * self.freedom.condition

    @property
    def tells(self) -> bool:
        """True if the state shows motions that differ by more than `MAX_USEFUL_TOLERANCE`."""
        return self.tolerance_of_motion <= MAX_USEFUL_TOLERANCE

    @cached_property
    def kinematics(self) -> Kinematics:
        """Motion of the rigid groups."""
        return self.reference.kinematics(self.q, self.v)

    @cached_property
    def constraints(self) -> Constraints:
        """Constraint rows at the configuration."""
        return self.reference.constraints(self.q)

    @cached_property
    def mass_matrices(self) -> tuple[Array, Array]:
        """Mass matrices (nv, nv) of the bodies and of the rotors."""
        return self.reference.mass_matrix(self.q)

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
        """Products dJ/dt v (k,) along the motion with constant velocities, with both `DERIVATIVE_STEPS`."""
        found = []
        for step in DERIVATIVE_STEPS:
            total = np.zeros(len(self.constraints.residual))
            for number, weight in DERIVATIVE_WEIGHTS:
                for sign in (1.0, -1.0):
                    q = self.reference.moved(self.q, sign * number * step * self.v)
                    rate = self.reference.constraints(q).jacobian @ (self.v / self.reference.units)
                    total += sign * weight / step * rate
            found.append(total)
        return found[0], found[1]


def names_of_wholes(names: Sequence[str], bodies: Sequence[str]) -> tuple[str, ...]:
    """Replace names of halves, which `weld_loops` makes, by the names of their bodies."""
    known = set(bodies)
    found = []
    for name in names:
        places = [k for k in range(len(name)) if name.startswith("_at_", k) and name[:k] in known]
        found.append(name[: places[-1]] if places and name not in known else name)
    return tuple(found)
