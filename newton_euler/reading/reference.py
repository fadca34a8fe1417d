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
    DOUBT,
    Constraints,
    ForceLimit,
    Forces,
    Freedom,
    Kinematics,
    freedom,
)
from newton_euler.scalars import Array

ROUND_OFF = 1e-12  # relative: some hundred operations, each to 1e-16, on numbers that were compiled
LOOSEST = 1e-4  # tolerance beyond which a state says next to nothing
STENCIL = ((1, 4.0 / 5.0), (2, -1.0 / 5.0), (3, 4.0 / 105.0), (4, -1.0 / 280.0))
STEPS = (2.5e-4, 1e-3)
"""s, of derivatives of J v along a motion by central differences of eighth order: off by 1e-13 relative to
what turns at 1 rad/s. Short rods turn faster; by how much the two steps differ is allowed for."""

CLOSED = 1e-12  # of residuals in sizes or rad that are round-off
NEWTON_STEPS = 40
ALIGNING_STEPS = 100  # of `ReferenceModel.aligned`, enough for several joints that are half a revolution away
LONGEST_STEP = 0.2  # rad or sizes, of one step of closing
AMPLITUDES = (0.2, 0.6, 2.5)  # rad or sizes, by which coordinates are moved from the start before loops close
REACH = 2.9  # rad, that an angle may be from where it starts, so that poses tell it, and sizes

SEVERAL_HINGES = 1.2
"""rad, that hinges in a row without a mass between them are moved from the start: beyond a quarter turn of
the second of three, poses tell other angles."""

WORST_CONDITION = 1e4  # of constraints at a random state: beyond, it is next to a singular one
ATTEMPTS = 12
NEAR = (1e-2, 1e-3, 1e-4, 1e-5)  # rad or sizes, along free motions at the start, if loops close nowhere else
ELSEWHERE = 1e-9  # rad or sizes, from the start: less is the start itself


class ReferenceModel(ABC):
    """A file's own model.

    Attributes:
        names: rigid groups of bodies that move, by the names that a scene has for them; halves of a body that
            a loop was cut through have one name.
        motions: (nv,) what reports call the joint of each velocity.
        lengths: (nv,) true for velocities of slides and free translations.
        units: (nv,) of velocities: the model's size for lengths, 1 for angles.
        ranges: (nv,) how far coordinates may be moved from the start, rad or sizes.
        size: m.
        stated: q and velocities (nv,) that the file itself starts from, loops open or not.
        closest: q next to that where the file's own loops are closed as well as can be.
        start: q where the scene starts, by its bodies.
        open: constraints as the file has them at `closest` and at `start`.
        unaccounted: elements that neither the scene nor its report can be held to.
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
        """q after velocities `step` (nv,) for a unit of time."""

    @abstractmethod
    def difference(self, q: Array, other: Array) -> Array:
        """(nv,) the step from one configuration to another."""

    @abstractmethod
    def mass_properties(self) -> MassProperties:
        """Of the rigid groups at the start, in the order of `names`."""

    @abstractmethod
    def kinematics(self, q: Array, v: Array) -> Kinematics:
        """Of the rigid groups."""

    @abstractmethod
    def constraints(self, q: Array) -> Constraints:
        """Rows of all that the file closes and couples and a report does not leave out."""

    @abstractmethod
    def mass_matrix(self, q: Array) -> tuple[Array, Array]:
        """(nv, nv) of the bodies, and of the rotors."""

    @abstractmethod
    def forces(self, q: Array, v: Array) -> Forces:
        """Of everything but constraints."""

    def force_limits(self, q: Array, v: Array) -> list[ForceLimit]:
        """Limits of forces that are watched; the same ones at all states."""
        return []

    @abstractmethod
    def energies(self, q: Array, v: Array) -> tuple[float, float]:
        """Kinetic, and potential to within a constant, J."""

    @abstractmethod
    def elements(self, samples: Sequence[Sample]) -> Iterator[tuple[str, list[list[Array]]]]:
        """Forces (4, nv) of each element alone, of all `KINDS`, at each sample, by the element's name.

        A list for each way in which it acts, such as that of a spring, and of one with another rest length.
        """

    @abstractmethod
    def rotors(self, samples: Sequence[Sample]) -> Iterator[tuple[str, list[Array]]]:
        """Mass matrix (nv, nv) of each element's armature alone at each sample, by the element's name."""

    @abstractmethod
    def keep_offsets(self) -> None:
        """Let each constraint be closed where it is at the start, its second end put to the first.

        Digits of a file may not close its loops; the offset that is left at the start is the loop's, and a
        scene keeps it.
        """

    def begin(self, scene: Scene) -> None:
        """Find where the file's loops close next to what it states, and where the scene starts.

        Readers close loops in the same metric: lengths count in the spread of centers of mass and joints.
        """
        q, _ = self.stated
        points = self.points(q)
        length = float(np.max(np.linalg.norm(points - np.mean(points, axis=0), axis=1))) or 1.0
        self.closest = self.closed(q, np.where(self.lengths, length, 1.0))[0]
        self.start = self.aligned(self.closest, scene)
        self.open = self.constraints(self.closest), self.constraints(self.start)

    @property
    def offset(self) -> float:
        """Largest residual of loops that their offsets keep, sizes or rad."""
        return float(np.max(np.abs(self.open[1].residual), initial=0.0))

    @abstractmethod
    def points(self, q: Array) -> Array:
        """(k, 3) centers of mass and places of joints of all that moves, m."""

    def closed(self, q: Array, metric: Array | None = None) -> tuple[Array, float]:
        """The configuration next to one where loops are closed as well as can be, and how well that is.

        Distances are in units (nv,) of a metric, those of velocities if None.
        """
        metric = self.units if metric is None else metric
        best, least = q, np.inf
        for _ in range(NEWTON_STEPS):
            residual, rows, _ = self.constraints(q)
            now = float(np.max(np.abs(residual), initial=0.0))
            if now < least:
                best, least = q, now
            elif least < 1e3 * CLOSED:
                break
            if least <= 0.1 * CLOSED:
                break
            step = least_squares(rows * (metric / self.units), residual, DOUBT)
            step *= min(1.0, LONGEST_STEP / max(float(np.max(np.abs(step))), CLOSED))
            q = self.moved(q, -step * metric)
        return best, least

    def aligned(self, q: Array, scene: Scene) -> Array:
        """The configuration next to q in which bodies are where a scene has them, as far as they can be."""
        poses = {body.name: body.pose for body in scene.mechanism.bodies}
        if not set(self.names) <= set(poses):
            return q
        first = [self.names.index(name) == k for k, name in enumerate(self.names)]
        wanted = [poses[name] for name in dict.fromkeys(self.names)]
        best, least = q, np.inf
        for _ in range(ALIGNING_STEPS):
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
                if worse and now < 1e3 * CLOSED:
                    break
            elif least < 1e6 * CLOSED:
                break
            rows = found.transformation[first] / np.repeat([self.size, 1.0], 3)[:, None] * self.units
            step = least_squares(rows.reshape(-1, len(self.units)), gap.ravel())
            step *= min(1.0, LONGEST_STEP / max(float(np.max(np.abs(step))), CLOSED))
            q = self.moved(q, self.units * step)
        return best

    @cached_property
    def samples(self) -> list[Sample]:
        """The start, and closed states at random around it and far from it, all with random velocities.

        The start alone where loops close nowhere else.
        """
        rng = np.random.default_rng(0)
        start = self._sample(self.start, rng)
        found = [start]
        for amplitude in AMPLITUDES:
            tried = (self._far(amplitude * 0.7**attempt, rng) for attempt in range(ATTEMPTS))
            found += self._first_closed(tried, start, rng)
        if len(found) == 1 and len(start.freedom.rows):
            basis, scale = start.freedom.basis, self.units[start.freedom.rows]
            steps = (basis @ (scale * rng.uniform(-1.0, 1.0, len(scale))) for _ in NEAR)
            tried = (self.moved(self.start, reach * step) for reach, step in zip(NEAR, steps, strict=True))
            found += self._first_closed(tried, start, rng)
        return found

    @property
    def tells(self) -> bool:
        """True if motions that differ by more than `LOOSEST` show at any of the samples."""
        return any(sample.tells for sample in self.samples)

    def _first_closed(
        self, tried: Iterable[Array], start: Sample, rng: np.random.Generator
    ) -> Iterator[Sample]:
        """The first configuration, if any, next to which loops close as well as at the start."""
        allowed = max(CLOSED, 3.0 * start.opening, 10.0 * start.freedom.doubt)
        worst = max(WORST_CONDITION, 10.0 * start.freedom.condition)
        for q in tried:
            q, opening = self.closed(q)
            away = np.max(np.abs(self.difference(self.start, q)) / self.units, initial=0.0)
            if opening > allowed or not ELSEWHERE < away <= REACH:
                continue
            sample = self._sample(q, rng)
            if sample.freedom.condition <= worst and (sample.tells or not start.tells):
                yield sample
                return

    @cached_property
    def far(self) -> list[Sample]:
        """Configurations at random, loops open."""
        rng, count = np.random.default_rng(1), len(self.units)
        free = freedom(np.zeros((0, count)), self.units)
        places = [self._far(amplitude, rng) for amplitude in AMPLITUDES]
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
    """A state, and what the file's own model says there, each worked out when first asked for.

    Attributes:
        reference: the model.
        q, v: configuration, and velocities (nv,), SI.
        opening: of the constraints there, in sizes or rad, beyond the offsets that they keep.
        freedom: motions that these do not hold.
    """

    reference: ReferenceModel
    q: Array
    v: Array
    opening: float
    freedom: Freedom

    @property
    def precision(self) -> float:
        """Relative, of coordinates: round-off, far from the origin that of the distance."""
        distance = float(np.max(np.abs(self.kinematics.position), initial=0.0)) / self.reference.size
        return ROUND_OFF + 10.0 * float(np.finfo(float).eps) * distance

    @property
    def tolerance(self) -> float:
        """Relative, of forces along independent velocities: round-off, times the condition of these.

        Both sides have bodies where the file has them, however far loops are open.
        """
        return self.precision * self.freedom.condition

    @property
    def tolerance_of_motion(self) -> float:
        """The same of motions, which are known to ten times what is open and the singular value in doubt.

        Each form of the equations omits another combination of the rows.
        """
        return self.tolerance + 10.0 * (self.opening + self.freedom.doubt) * self.freedom.condition

    @property
    def tells(self) -> bool:
        """True if differences of more than `LOOSEST` show there."""
        return self.tolerance_of_motion <= LOOSEST

    @cached_property
    def kinematics(self) -> Kinematics:
        """Of the rigid groups."""
        return self.reference.kinematics(self.q, self.v)

    @cached_property
    def constraints(self) -> Constraints:
        """At the configuration."""
        return self.reference.constraints(self.q)

    @cached_property
    def mass_matrices(self) -> tuple[Array, Array]:
        """(nv, nv) of the bodies, and of the rotors."""
        return self.reference.mass_matrix(self.q)

    @cached_property
    def forces(self) -> Forces:
        """Of everything but constraints."""
        return self.reference.forces(self.q, self.v)

    @cached_property
    def energies(self) -> tuple[float, float]:
        """Kinetic and potential, J."""
        return self.reference.energies(self.q, self.v)

    @cached_property
    def velocity_products(self) -> tuple[Array, Array]:
        """(k,) dJ/dt v of the constraints along the motion of constant velocities, at both `STEPS`."""
        found = []
        for step in STEPS:
            total = np.zeros(len(self.constraints.residual))
            for number, weight in STENCIL:
                for sign in (1.0, -1.0):
                    q = self.reference.moved(self.q, sign * number * step * self.v)
                    rate = self.reference.constraints(q).jacobian @ (self.v / self.reference.units)
                    total += sign * weight / step * rate
            found.append(total)
        return found[0], found[1]


def wholes(names: Sequence[str], bodies: Sequence[str]) -> tuple[str, ...]:
    """Names with those of halves, as of `weld_loops`, replaced by their bodies'."""
    known = set(bodies)
    found = []
    for name in names:
        places = [k for k in range(len(name)) if name.startswith("_at_", k) and name[:k] in known]
        found.append(name[: places[-1]] if places and name not in known else name)
    return tuple(found)
