"""Verification of a scene against the file that it was read from, as an independent reader holds that.

`verify` compares figure by figure, at the start and at closed states around it and far from it, all of them
moving, with springs displaced and actuators on:

1. mass properties of each body, and where it starts;
2. the mass matrix with loops open, bodies placed at random;
3. joints, gears and motions of the scene where the file's own equalities are closed, how fast they open where
   the file lets bodies move, and how far what the scene leaves free opens the file's equalities;
4. forces of gravity, springs, dampers and actuators apart, and armatures, as independent velocities see
   them; a difference is blamed on the element of the file whose own force, alone, is most like it;
5. what a system makes of the scene: poses, energies, and accelerations, put into the file's own equations
   M a = f + J^T lambda and J a = -Jdot v: no solution of these is compared, so no rank decides.

Figures are relative to what the mechanism does at all of the states together, row by row, before anything
cancels: never to what may be round-off. Tolerances are round-off of a hundred operations in a row, and by
how much the states are open, magnified by the condition of the constraints.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from newton_euler.armature import BallArmature
from newton_euler.balls import SPIN, ends
from newton_euler.constraints import Frame
from newton_euler.couplings import couplings, residuals
from newton_euler.euler_parameters import angle_between, from_rotation, product
from newton_euler.errors import VerificationError
from newton_euler.force_terms import body_wrenches
from newton_euler.forces import Wrench
from newton_euler.mapping import Mapping
from newton_euler.original import FREE, KINDS, Original, Sample
from newton_euler.relative import Relative
from newton_euler.scalars import Array
from newton_euler.scene import Scene
from newton_euler.state import MassProperties, State
from newton_euler.system import System, dimensionless_jacobian

ROUND_OFF = 1e-12
"""Relative: some hundred operations in a row, each to 1e-16, on numbers that went through a compiler."""

LOOSEST = 1e-4
"""What a tolerance may be at most: beyond, a figure says nothing."""

STENCIL = ((1, 4.0 / 5.0), (2, -1.0 / 5.0), (3, 4.0 / 105.0), (4, -1.0 / 280.0))
STENCIL_STEPS = (1e-3, 2.5e-4)
"""s, of derivatives of J v along a motion by central differences of eighth order: off by 1e-13 relative to
what turns at 1 rad/s. Short rods turn faster; by how much the two steps differ is allowed for."""

SPREAD = 1e-4
"""Share of the largest scale that any row's is at least, in forces at the size: independent velocities are
known to 1e-16, `ROUND_OFF` times this, and let a row see as much of what acts elsewhere."""

RATE = 1.0
"""rad/s and sizes a second, of the samples' velocities: what mechanisms do at least that do nothing else."""

ALIKE = 1e-3
"""Share of a difference (of squares) that what is blamed may leave unexplained."""

PLACES = "center of mass at the start, m"


class Figure(NamedTuple):
    """One compared figure.

    Attributes:
        quantity: what is compared, with its unit.
        value, tolerance: the largest difference and what it may be at most.
        where: the element of the file, or the body or joint of the scene, of the largest difference.
    """

    quantity: str
    value: float
    tolerance: float
    where: str

    @property
    def agrees(self) -> bool:
        """NaN does not agree with anything."""
        return bool(self.value <= self.tolerance)


def verify(original: Original, system: System) -> Iterator[Figure]:
    """Compare equations of motion of a scene with the file's own.

    The first figure that does not agree tells the most: what is after it may follow from it. Nothing is
    compared after bodies that are not the file's, or that do not start where it has them.

    Raises:
        numpy.linalg.LinAlgError: for numbers that are not finite.
    """
    unknown = set(system.mechanism.body_names[1:]) ^ set(original.names)
    missing = sorted(unknown) + list(original.unaccounted)
    yield Figure("elements unaccounted for", len(missing), 0.5, ", ".join(missing[:5]))
    if unknown:
        return
    compared = _Compared(original, system)
    placed = True
    for figure in compared.model_rows():
        yield figure
        placed = placed and (figure.agrees or figure.quantity != PLACES)
    if placed:
        yield from compared.motion_rows()
        yield from compared.force_rows()
        yield from compared.system_rows()


def check(report: Mapping) -> str:
    """Verify what was read from a file, by the joint-coordinate form of its equations.

    Returns:
        A line for the report.

    Raises:
        VerificationError: naming the quantity, and the element or body, of the first figure that fails.
    """
    found = [figure for original, scene in report.originals for figure in verify(original, Relative(scene))]
    for figure in found:
        if not figure.agrees:
            raise VerificationError(figure.quantity, figure.value, figure.tolerance, figure.where)
    nearest = max(found, key=lambda figure: figure.value / figure.tolerance)
    states = sum(len(original.samples) for original, _ in report.originals)
    return (
        f"verified against the file's own model at {states} moving states in {len(found)} figures, the largest "
        f"of them {nearest.value / nearest.tolerance:.0e} of its tolerance: {nearest.quantity}"
    )


class _Place(NamedTuple):
    """The scene's bodies, ground first, where a sample of the file has them."""

    sample: Sample
    state: State
    rest: State
    transformation: Array
    """(6 b, nv) of the bodies' centers of mass, for the file's velocities."""
    of_parts: Array
    """(6 g, nv) the same for each rigid group of the file that is a part of a body."""
    drift: Array
    """(6 g,) of the groups."""


def _put_together(parts: MassProperties, bodies: Sequence[int]) -> MassProperties:
    """Mass properties of bodies, ground first, out of those of rigid groups that are parts of them."""
    count = max(bodies) + 1
    mass, center, inertia = np.zeros(count), np.zeros((count, 3)), np.zeros((count, 3, 3))
    np.add.at(mass, bodies, parts.mass)
    np.add.at(center, bodies, parts.mass[:, None] * parts.center_of_mass)
    center[1:] /= mass[1:, None]
    for body, m, r, about in zip(bodies, *vars(parts).values(), strict=True):
        arm = r - center[body]
        inertia[body] += about + m * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return MassProperties(mass, center, inertia)


class _Compared:
    """A file and equations of motion of a scene."""

    def __init__(self, original: Original, system: System) -> None:
        self.original, self.system = original, system
        self.scene: Scene = system.scene
        self.mechanism = self.scene.mechanism
        self.bodies = [self.mechanism.body_index(name) for name in original.names]
        self._parts = {body: self.bodies.index(body) for body in self.bodies}
        self.size = original.size
        self.samples = original.samples
        self._poses = [body.pose for body in self.mechanism.bodies]
        self._part_units = np.tile(np.repeat([self.size, 1.0], 3), len(self.bodies))

    def _tolerance(self, sample: Sample) -> float:
        return min((ROUND_OFF + 10.0 * sample.opening) * sample.freedom.condition, LOOSEST)

    @cached_property
    def _loosest(self) -> float:
        return max(self._tolerance(sample) for sample in self.samples)

    def _of_parts(self, values: Array) -> Array:
        """(6 g, ...) dimensionless velocities or accelerations of groups, of (6 b, ...) of bodies."""
        parts = values.reshape(len(self.mechanism.bodies), 6, -1)[self.bodies]
        return (parts.reshape(len(self._part_units), -1).T / self._part_units).T.reshape(
            -1, *values.shape[1:]
        )

    # The scene's bodies where the file has them

    @cached_property
    def _first(self) -> tuple[Array, Array]:
        found = self.original.kinematics(self.original.start, 0.0 * self.original.units)
        return found.position, found.rotation

    @cached_property
    def places(self) -> list[_Place]:
        """At the samples."""
        return [self._place(sample) for sample in self.samples]

    def _place(self, sample: Sample) -> _Place:
        bodies = self.mechanism.bodies
        found = self.original.kinematics(sample.q, sample.v)
        parts, drift = found.transformation.copy(), found.drift.copy()
        rest = State.initial(self.mechanism)
        (centers, turns), nv = self._first, len(sample.v)
        for k in reversed(range(len(parts))):  # of halves the first one tells the pose
            body, turn = self.bodies[k], found.rotation[k] @ turns[k].T
            arm = turn @ (bodies[body].center_of_mass - centers[k])
            rest.position[body] = found.position[k] + arm
            rest.quaternion[body] = product(from_rotation(turn), bodies[body].quaternion)
            parts[k, :3] += np.cross(parts[k, 3:], arm, axisa=0, axisb=0).T
            omega = parts[k, 3:] @ sample.v
            drift[k, :3] += np.cross(drift[k, 3:], arm) + np.cross(omega, np.cross(omega, arm))
        rows = np.zeros((len(bodies), 6, nv))
        rows[list(self._parts)] = parts[list(self._parts.values())]
        linear, angular = np.split(rows @ sample.v, 2, axis=1)
        state = State(rest.position, rest.quaternion, linear, angular)
        return _Place(sample, state, rest, rows.reshape(-1, nv), parts.reshape(-1, nv), drift.ravel())

    # 1 and 2: bodies

    def model_rows(self) -> Iterator[Figure]:
        """Mass properties, where bodies start among them, and the mass matrix with loops open."""
        names, found = self.mechanism.body_names[1:], self.system.mass_properties()
        parts = self.original.mass_properties()
        wanted = MassProperties(*(values[1:] for values in vars(_put_together(parts, self.bodies)).values()))
        row = self._mass_matrix_row(found)
        found = MassProperties(*(values[1:] for values in vars(found).values()))
        reach = self.size + float(np.max(np.abs(wanted.center_of_mass)))
        gaps = np.abs(found.mass / wanted.mass - 1.0)
        yield _figure("mass, rel", gaps, ROUND_OFF, names)
        gaps = np.linalg.norm(found.center_of_mass - wanted.center_of_mass, axis=1)
        tolerance = reach * (ROUND_OFF + 10.0 * self.samples[0].opening)
        yield _figure(PLACES, gaps, tolerance, names)
        largest = np.linalg.norm(wanted.inertia, ord=2, axis=(1, 2))
        gaps = np.linalg.norm(found.inertia - wanted.inertia, ord=2, axis=(1, 2)) / largest
        # arms within a body are differences of places in the world
        arms = wanted.mass * self.size * reach / largest
        yield _figure("inertia, rel", gaps, ROUND_OFF * np.maximum(1.0, np.minimum(arms, 1e3)), names)
        yield row

    def _mass_matrix_row(self, found: MassProperties) -> Figure:
        centers, turns = self._first
        gaps, rows_of = [], np.arange(len(self.original.units))
        halves = len(set(self.bodies)) < len(self.bodies)
        states = [(s.q, s.freedom.basis, s.freedom.rows) for s in self.samples]
        if not halves:
            states = [(q, np.eye(len(rows_of)), rows_of) for q in self.original.far()]
        for q, basis, chosen in states:
            wanted, rotors = self.original.mass_matrix(q)
            placed = self.original.kinematics(q, 0.0 * self.original.units)
            mass = np.zeros_like(wanted)
            for body, k in self._parts.items():
                rows, turn = placed.transformation[k], placed.rotation[k] @ turns[k].T
                arm = turn @ (found.center_of_mass[body] - centers[k])
                linear = rows[:3] + np.cross(rows[3:], arm, axisa=0, axisb=0).T
                inertia = turn @ found.inertia[body] @ turn.T
                mass += found.mass[body] * linear.T @ linear + rows[3:].T @ inertia @ rows[3:]
            scale = np.sqrt(np.diag(basis.T @ (wanted + rotors) @ basis))
            units = self.original.units[chosen]  # links without mass have no scale of their own
            scale = np.maximum(scale, SPREAD * np.max(scale * units, initial=0.0) / units)
            gap = np.zeros(len(rows_of))
            gap[chosen] = np.max(np.abs(basis.T @ (mass - wanted) @ basis) / np.outer(scale, scale), axis=1)
            gaps.append(gap)
        quantity = "mass matrix, loops open, rel"
        return _figure(quantity, np.max(gaps, axis=0), 10.0 * ROUND_OFF, self.original.motions)

    # 3: joints

    def motion_rows(self) -> Iterator[Figure]:
        """Joints of the scene in the file's motions, and equalities of the file in the scene's."""
        found = couplings(self.scene)
        joints = [e.joint.name for e in self.mechanism.equations if e.count]
        names = [*joints, *(coupling.name for coupling in found)]
        open_by, rates, tolerances = [], [], []
        for place in self.places:
            frames = place.state.frames()
            gaps, speeds = [], []
            for e in self.mechanism.equations:
                if e.count:
                    first, second, units = frames[e.first], frames[e.second], e.units(self.size)
                    gaps.append(np.max(np.abs(e.phi(first, second)) / units))
                    speeds.append(np.max(np.abs(e.jacobian(first, second).rate(first, second)) / units))
            units = np.array([self.size if coupling.is_length else 1.0 for coupling in found])
            units *= [sum(map(abs, coupling.factors.values())) for coupling in found]
            phi, rate = residuals(self.mechanism, found, frames, 0.0) if found else (np.zeros(0), np.zeros(0))
            open_by.append([*gaps, *np.abs(phi / units)])
            rates.append([*speeds, *np.abs(rate / units)])
            tolerances.append(10.0 * self._tolerance(place.sample))
        if names:
            limits = np.array(tolerances)[:, None]
            yield _figure("joints open, sizes or rad", np.array(open_by), limits, names)
            yield _figure("joints opening, 1/s", np.array(rates), limits, names)
        yield self._free_row()

    def _free_row(self) -> Figure:
        """Motions that the scene leaves free have to be motions of the file's joints, and free there."""
        worst = Figure("motions free in the scene alone, rel", 0.0, 10.0 * self._loosest, "")
        for place in self.places:
            q, _ = self.system.coordinates(place.rest)
            free = _null(dimensionless_jacobian(self.system, q))
            moved = self.system.velocity_transformation(q) * self.system.velocity_units
            moved = self._of_parts(moved @ free)
            norms = np.linalg.norm(moved, axis=0)
            moved = moved[:, norms > FREE] / norms[norms > FREE]
            if not moved.size:
                continue
            rows = place.of_parts / self._part_units[:, None] * self.original.units
            velocities = np.linalg.lstsq(rows, moved)[0]
            strange = np.abs(rows @ velocities - moved).reshape(len(self.bodies), -1).max(axis=1)
            _, jacobian, owners = self.original.constraints(place.sample.q)
            opened = np.abs(jacobian @ velocities).max(axis=1, initial=0.0)
            names = [*self.original.names, *owners]
            tolerance = min(10.0 * (self._tolerance(place.sample) + place.sample.freedom.doubt), LOOSEST)
            found = _figure(worst.quantity, np.concatenate([strange, opened]), tolerance, names)
            if not found.value / found.tolerance <= worst.value / worst.tolerance:
                worst = found
        return worst

    # 4: forces

    def force_rows(self) -> Iterator[Figure]:
        """Forces of each of the `KINDS`, and armatures, in the file's independent velocities."""
        acting = [self._acting(place) for place in self.places]
        wanted = [self.original.forces(sample.q, sample.v) for sample in self.samples]
        for n, kind in enumerate(KINDS):
            yield self._force_row(n, [each[n] for each in acting], [getattr(each, kind) for each in wanted])
        yield self._rotor_row()

    def _force_row(
        self, kind: int, acting: Sequence[tuple[Array, Array]], wanted: Sequence[Array]
    ) -> Figure:
        left, scales = [], []
        for place, (wrench, magnitude), force in zip(self.places, acting, wanted, strict=True):
            basis = place.sample.freedom.basis
            onto = place.transformation @ basis
            left.append(onto.T @ wrench.ravel() - basis.T @ force)
            scales.append(np.abs(onto).T @ magnitude.ravel() + np.abs(basis).T @ np.abs(force))

        def alone() -> Alone:
            for name, each in self.original.elements(self.samples):
                yield name, [self._reduced([forces[kind] for forces in each])]
            # then what joints might have: constant forces, springs and dampers
            start = self.original.start
            moved = [self.original.difference(start, sample.q) for sample in self.samples]
            for k, name in enumerate(self.original.motions):
                unit = np.eye(len(self.original.motions))[k]
                ways = [
                    [unit] * len(moved),
                    [x[k] * unit for x in moved],
                    [sample.v[k] * unit for sample in self.samples],
                ]
                yield name, [self._reduced(forces) for forces in ways]

        return self._row(f"{KINDS[kind]}, rel", left, self._largest(scales), alone)

    def _rotor_row(self) -> Figure:
        wanted = self._reduced([self.original.mass_matrix(sample.q)[1] for sample in self.samples])
        found = []
        for place in self.places:
            onto = self._spins(place) @ place.transformation @ place.sample.freedom.basis
            found.append(onto.T @ onto)
        pairs = zip(found, wanted, strict=True)
        scale = np.sqrt(self._largest([np.diag(one) + np.abs(np.diag(two)) for one, two in pairs], 2))

        def relative(masses: Sequence[Array]) -> list[Array]:
            units = (_positive(scale[sample.freedom.rows]) for sample in self.samples)
            return [mass / unit for mass, unit in zip(masses, units, strict=True)]

        def alone() -> Alone:
            for name, each in self.original.rotors(self.samples):
                yield name, [relative(self._reduced(each))]

        left = relative([one - two for one, two in zip(found, wanted, strict=True)])
        return self._row("armatures, rel", left, scale, alone)

    def _reduced(self, of_velocities: Sequence[Array]) -> list[Array]:
        """Forces (nv,) or mass matrices (nv, nv) at the samples as their independent velocities see them."""
        found = []
        for sample, whole in zip(self.samples, of_velocities, strict=True):
            basis = sample.freedom.basis
            found.append(basis.T @ (whole @ basis if whole.ndim == 2 else whole))
        return found

    def _largest(self, scales: Sequence[Array], power: int = 1) -> Array:
        """(nv,) the largest of all samples, each in its independent velocities, and a floor of `SPREAD`."""
        units = self.original.units**power
        total = np.zeros(len(units))
        for sample, scale in zip(self.samples, scales, strict=True):
            np.maximum.at(total, sample.freedom.rows, scale)
        return np.maximum(total, SPREAD * np.max(total * units, initial=0.0) / units)

    def _row(self, quantity: str, left: Sequence[Array], scale: Array, alone: Callable[[], Alone]) -> Figure:
        """Differences at each sample, (d,) or (d, ...), relative to (nv,) the largest there is.

        If they are not round-off the element is named whose own part explains most of them.
        """
        shares = [
            (np.abs(gap).T / _positive(scale[sample.freedom.rows])).T
            for gap, sample in zip(left, self.samples, strict=True)
        ]
        worst = Figure(quantity, 0.0, self._loosest, "")
        for share, sample in zip(shares, self.samples, strict=True):
            names = [self.original.motions[k] for k in sample.freedom.rows]
            each = share.reshape(len(names), -1).max(axis=1, initial=0.0)
            found = _figure(quantity, each, self._tolerance(sample), names)
            if not found.value / found.tolerance <= worst.value / worst.tolerance:
                worst = found
        if worst.agrees:
            return worst
        weights = [1.0 / _positive(scale[sample.freedom.rows]) for sample in self.samples]
        return worst._replace(where=_most_alike(left, weights, alone()) or worst.where)

    @cached_property
    def _scenes(self) -> tuple[Scene, Scene, Scene]:
        """The scene with its springs, its dampers, and what else acts beside gravity alone."""
        forces = [force for force in self.scene.forces if not isinstance(force, Wrench)]
        others = tuple(force for force in self.scene.forces if isinstance(force, Wrench))
        springs = tuple(replace(force, damping=0.0) for force in forces if force.stiffness)
        dampers = tuple(replace(force, stiffness=0.0) for force in forces if force.damping)
        alone = replace(self.scene, control=(), forces=springs)
        return alone, replace(alone, forces=dampers), replace(self.scene, forces=others)

    def _acting(self, place: _Place) -> list[tuple[Array, Array]]:
        """(b, 6) wrenches of each of the `KINDS` on the scene's bodies, and the sums of what there is."""
        weight = np.zeros((len(self.mechanism.bodies), 6))
        for k, body in enumerate(self.mechanism.bodies):
            weight[k, :3] = body.mass * self.scene.gravity
        springs, dampers, others = self._scenes
        return [
            (weight, np.abs(weight)),
            self._wrenches(springs, place.rest),
            self._wrenches(dampers, place.state),
            self._wrenches(others, place.state),
        ]

    def _wrenches(self, scene: Scene, state: State) -> tuple[Array, Array]:
        frames = state.frames()
        total = np.array(body_wrenches(scene, self._poses, frames))
        magnitude = np.abs(total)
        for law in scene.joint_forces:
            equations = self.mechanism.equations[self.mechanism.joint_index(law.joint)]
            coordinate = equations.coordinates[law.coordinate]
            first, second = frames[equations.first], frames[equations.second]
            rows = coordinate.jacobian(first, second)
            u = law.force(coordinate.phi(first, second)[0], rows.rate(first, second)[0])
            for body, r, theta in (
                (equations.first, rows.r_first, rows.theta_first),
                (equations.second, rows.r_second, rows.theta_second),
            ):
                push = u * np.concatenate([r[0], theta[0]])
                total[body] += push
                magnitude[body] += np.abs(push)
        return total, magnitude

    def _spins(self, place: _Place) -> Array:
        """(r, 6 b) what armatures see of the bodies' velocities, times the roots of their inertias."""
        frames = place.rest.frames()
        found = np.zeros((0, len(frames), 6))
        for armature in self.scene.armatures:
            if isinstance(armature, BallArmature):
                first, second = ends(self.mechanism, armature.joint)
                rows = SPIN
            else:
                joint, coordinate = armature.key
                equations = self.mechanism.equations[self.mechanism.joint_index(joint)]
                first, second = equations.first, equations.second
                rows = equations.coordinates[coordinate].jacobian(frames[first], frames[second])
            row = np.zeros((len(rows.r_first), len(frames), 6))
            row[:, first] = np.hstack([rows.r_first, rows.theta_first])
            row[:, second] = np.hstack([rows.r_second, rows.theta_second])
            found = np.concatenate([found, np.sqrt(armature.inertia) * row])
        return found.reshape(len(found), 6 * len(frames))

    # 5: what a system makes of it

    def system_rows(self) -> Iterator[Figure]:
        """Poses, energies and accelerations of a system at the samples."""
        coordinates = [self.system.coordinates(place.state) for place in self.places]
        found = [self.system.evaluate(q, v) for q, v in coordinates]
        names, limits = self.mechanism.body_names, np.array([self._tolerance(s) for s in self.samples])
        reach = self.size + max(float(np.max(np.abs(place.state.position))) for place in self.places)
        shift, turn, speed = [], [], []
        for each, place in zip(found, self.places, strict=True):
            mine, wanted = each.state, place.state
            shift.append(np.linalg.norm(mine.position - wanted.position, axis=1) / reach)
            turn.append(angle_between(mine.quaternion, wanted.quaternion))
            linear = np.linalg.norm(mine.linear_velocity - wanted.linear_velocity, axis=1) / reach
            angular = np.linalg.norm(mine.angular_velocity - wanted.angular_velocity, axis=1)
            speed.append(np.maximum(linear, angular))
        wide = 10.0 * limits[:, None]
        yield _figure("positions, rel", np.array(shift), wide, names)
        yield _figure("orientations, rad", np.array(turn), wide, names)
        yield _figure("velocities, rel", np.array(speed), wide, names)
        energies = np.array([self.original.energies(sample.q, sample.v) for sample in self.samples])
        mine = np.array([[each.kinetic_energy, each.potential_energy] for each in found])
        masses = np.array([body.mass for body in self.mechanism.bodies])
        usual = 0.5 * float(masses.sum()) * (self.size * RATE) ** 2
        weight = float(masses.sum() * np.linalg.norm(self.scene.gravity) * reach)
        where = [f"state {k}" for k in range(len(found))]
        for k, quantity in enumerate(("kinetic energy, rel", "potential energy, rel")):
            gap = np.abs(mine[:, k] - energies[:, k] - k * (mine[0, k] - energies[0, k]))
            scale = float(np.max(np.abs([mine[:, k], energies[:, k]]))) + usual + k * weight
            yield _figure(quantity, gap / scale, 10.0 * limits, where)
        yield from self._acceleration_rows(
            [_stacked(e.linear_acceleration, e.angular_acceleration) for e in found]
        )

    def _acceleration_rows(self, accelerations: Sequence[Array]) -> Iterator[Figure]:
        """Accelerations (6 b,) of bodies in the file's own equations of motion and of constraints."""
        strange, left, scales, opening, speeds, owners = [], [], [], [], [], ()
        for place, acceleration in zip(self.places, accelerations, strict=True):
            sample, units = place.sample, self.original.units
            rows = place.of_parts / self._part_units[:, None] * units
            reached, drift = self._of_parts(acceleration), place.drift / self._part_units
            wanted = reached - drift
            own = np.linalg.lstsq(rows, wanted)[0]
            scale = max(RATE**2, float(np.max(np.abs([reached, drift]))))
            strange.append(np.abs(rows @ own - wanted).reshape(-1, 6).max(axis=1) / scale)
            a, basis = units * own, sample.freedom.basis
            mass, forces = sum(self.original.mass_matrix(sample.q)), self.original.forces(sample.q, sample.v)
            push = sum(getattr(forces, kind) for kind in KINDS) - forces.bias
            left.append(basis.T @ (mass @ a - push))
            parts = np.abs(mass) @ np.abs(a) + sum(np.abs(force) for force in forces)
            scales.append(np.abs(basis).T @ parts)
            _, jacobian, owners = self.original.constraints(sample.q)
            rates, coarse = (self._velocity_product(sample, step) for step in STENCIL_STEPS[::-1])
            opening.append(np.maximum(np.abs(jacobian @ own + rates) - np.abs(coarse - rates), 0.0))
            largest = float(np.max(np.abs(jacobian), initial=0.0))
            speeds.append(largest * max(RATE**2, float(np.max(np.abs(own), initial=0.0))))
        limits = np.array([self._tolerance(sample) for sample in self.samples])[:, None]
        doubts = np.array([sample.freedom.doubt for sample in self.samples])[:, None]
        quantity = "accelerations across joints, rel"
        yield _figure(quantity, np.array(strange), 10.0 * limits, self.original.names)
        if len(owners):
            gaps = np.array(opening) / _positive(max(speeds))
            yield _figure("accelerations across loops, rel", gaps, 10.0 * (limits + doubts), owners)
        # multipliers of rows in doubt are large, and what round-off lets them do to free motions is too
        doubt = max(float(np.max(doubts, initial=0.0)), FREE)
        scale = (10.0 + np.finfo(float).eps / (ROUND_OFF * doubt)) * self._largest(scales)
        yield self._row("accelerations, as forces, rel", left, scale, lambda: iter(()))

    def _velocity_product(self, sample: Sample, step: float) -> Array:
        """(k,) dJ/dt v of the file's constraints along the motion of constant velocities."""
        total: Array = np.zeros(1)
        own = sample.v / self.original.units
        for number, weight in STENCIL:
            for sign in (1.0, -1.0):
                q = self.original.moved(sample.q, sign * number * step * sample.v)
                rate = self.original.constraints(q).jacobian @ own
                total = total + sign * weight / step * rate
        return total


Alone = Iterator[tuple[str, list[list[Array]]]]
"""Elements by name, and what each of them does at the samples, a list for each way in which it acts."""


def _stacked(linear: Array, angular: Array) -> Array:
    """(6 b,) of two (b, 3)."""
    return np.hstack([linear, angular]).ravel()


def _positive(scale: Any) -> Any:
    """What differences are relative to; where there is nothing at all, any number is as good."""
    return np.where(np.asarray(scale) > 0.0, scale, np.finfo(float).tiny)


def _figure(quantity: str, gaps: Array, tolerances: Any, names: Sequence[str]) -> Figure:
    """The worst of differences (..., names) for tolerances of a shape that goes with that."""
    limits = np.broadcast_to(tolerances, gaps.shape)
    if not gaps.size:
        return Figure(quantity, 0.0, float(np.max(tolerances, initial=ROUND_OFF)), "")
    shares = np.nan_to_num(gaps / limits, nan=np.inf)
    place = np.unravel_index(int(np.argmax(shares)), gaps.shape)
    return Figure(quantity, float(gaps[place]), float(limits[place]), names[place[-1]])


def _null(jacobian: Array) -> Array:
    """Orthonormal columns that a dimensionless Jacobian leaves free for certain."""
    if not jacobian.size:
        return np.eye(jacobian.shape[1])
    s, vt = np.linalg.svd(jacobian, full_matrices=True)[1:]
    return np.asarray(vt[int(np.sum(s > FREE * max(1.0, s[0]))) :].T)


def _most_alike(left: Sequence[Array], weights: Sequence[Array], alone: Alone) -> str:
    """The first element that explains differences at all states as multiples of what it does; "" if none."""

    def weighed(values: Sequence[Array]) -> Array:
        return np.concatenate(
            [(each.T * weight).T.ravel() for each, weight in zip(values, weights, strict=True)]
        )

    gap, best, name = weighed(left), ALIKE, ""
    for element, ways in alone:
        columns = np.array([weighed(values) for values in ways]).T
        rest = gap - columns @ np.linalg.lstsq(columns, gap)[0]
        share = float(rest @ rest) / float(gap @ gap)
        if share < 0.5 * best:
            best, name = share, element
    return name
