"""Compare bodies, initial state and joints of a scene with the file's reference model."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from newton_euler.equations.couplings import couplings, residuals
from newton_euler.equations.dense import least_squares, singular_values
from newton_euler.equations.system import MassProperties, dimensionless_jacobian
from newton_euler.reading.checks import MIN_SCALE_SHARE, ReadingCheck, closest_to_failing, worst_entry
from newton_euler.reading.placement import SamplePlacement, ScenePlacement, shifted
from newton_euler.reading.quantities import FREE_SINGULAR_VALUE, Freedom
from newton_euler.reading.reference import READING_ROUND_OFF, ReferenceModel
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array

OFFSET_FACTOR = 10.0
"""Allowed difference of two initial poses, as a multiple of loop offsets times the condition number."""

STALLED_RATIO = 10.0
"""Loop-closure error of `ReferenceModel.closest`, divided by the error of the scene's start, for loops that
share joints. Loops above this ratio are not compared with `closest`."""

MIN_STALLED_ERROR = 1e-9
"""Loop-closure error, sizes or rad, below which closing never counts as stalled."""

CENTER_CHECK = "center of mass at the start, m"
"""Quantity of the check of initial places; later checks make no sense if this check fails."""

MAX_INERTIA_LOSS = 1e3
"""Largest error of an inertia that is a difference of places in the world, as a multiple of round-off."""


def body_checks(placed: ScenePlacement) -> Iterator[ReadingCheck]:
    """Check mass properties, including the initial centers of mass, and the mass matrix with open loops."""
    reference, names = placed.reference, placed.mechanism.body_names[1:]
    stated = placed.system.mass_properties()
    found = _moving(stated)
    wanted = _moving(_put_together(reference.mass_properties(), placed.bodies))
    reach = reference.size + float(np.max(np.abs(wanted.center_of_mass)))
    yield worst_entry("mass, rel", np.abs(found.mass / wanted.mass - 1.0), READING_ROUND_OFF, names)
    gaps = np.linalg.norm(found.center_of_mass - wanted.center_of_mass, axis=1)
    kept = reference.offset if placed.halved else 0.0
    yield worst_entry(CENTER_CHECK, gaps, reach * (READING_ROUND_OFF + 10.0 * kept), names)
    largest = np.linalg.norm(wanted.inertia, ord=2, axis=(1, 2))
    gaps = np.linalg.norm(found.inertia - wanted.inertia, ord=2, axis=(1, 2)) / largest
    arms = np.clip(wanted.mass * reference.size * reach / largest, 1.0, MAX_INERTIA_LOSS)
    yield worst_entry("inertia, rel", gaps, READING_ROUND_OFF * arms, names)
    yield _mass_matrix_check(placed, stated)


def _moving(properties: MassProperties) -> MassProperties:
    """Return the mass properties without the ground."""
    return MassProperties(properties.mass[1:], properties.center_of_mass[1:], properties.inertia[1:])


def _put_together(parts: MassProperties, bodies: Sequence[int]) -> MassProperties:
    """Combine mass properties of rigid groups to mass properties of bodies, ground first."""
    count = max(bodies) + 1
    mass, center, inertia = np.zeros(count), np.zeros((count, 3)), np.zeros((count, 3, 3))
    np.add.at(mass, bodies, parts.mass)
    np.add.at(center, bodies, parts.mass[:, None] * parts.center_of_mass)
    center[1:] /= mass[1:, None]
    for body, m, r, about in zip(bodies, parts.mass, parts.center_of_mass, parts.inertia, strict=True):
        arm = r - center[body]
        inertia[body] += about + m * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return MassProperties(mass, center, inertia)


def _mass_matrix_check(placed: ScenePlacement, stated: MassProperties) -> ReadingCheck:
    """Check the mass matrix of the scene's bodies, without rotors, in the velocities of the file.

    The configurations have open loops. Only if the file cuts bodies into halves, loops are closed.
    """
    reference, (centers, turns) = placed.reference, placed.first
    found, quantity = [], "mass matrix, loops open, rel"
    for sample in reference.samples if placed.halved else reference.far:
        basis, chosen = sample.freedom.basis, sample.freedom.rows
        if not len(chosen):
            continue
        (wanted, rotors), there = sample.mass_matrices, sample.kinematics
        mass = np.zeros_like(wanted)
        for body, k in placed.parts.items():
            turn = there.rotation[k] @ turns[k].T
            rows = shifted(there.transformation[k], turn @ (stated.center_of_mass[body] - centers[k]))
            inertia = turn @ stated.inertia[body] @ turn.T
            mass += stated.mass[body] * rows[:3].T @ rows[:3] + rows[3:].T @ inertia @ rows[3:]
        scale = np.sqrt(np.diag(basis.T @ (wanted + rotors) @ basis))
        units = reference.units[chosen]  # links without mass take their scale from the others
        scale = np.maximum(scale, MIN_SCALE_SHARE * np.max(scale * units) / units)
        gaps = np.max(np.abs(basis.T @ (mass - wanted) @ basis) / np.outer(scale, scale), axis=1)
        names = [reference.motions[k] for k in chosen]
        found.append(worst_entry(quantity, gaps, sample.precision, names))
    return closest_to_failing(found) if found else ReadingCheck(quantity, 0.0, READING_ROUND_OFF, "")


def joint_checks(placed: ScenePlacement) -> Iterator[ReadingCheck]:
    """Check joints at the file's motions, and the file's constraints at the scene's free motions."""
    found = [_joint_gaps(placed, place) for place in placed.places]
    limits = np.array([place.sample.tolerance_of_motion for place in placed.places])[:, None]
    names = [e.joint.name for e in placed.mechanism.equations if e.count]
    names += [coupling.name for coupling in couplings(placed.scene)]
    yield worst_entry("joints open, sizes or rad", np.array([gaps for gaps, _ in found]), limits, names)
    yield worst_entry("joints opening, 1/s", np.array([rates for _, rates in found]), limits, names)
    yield closest_to_failing(_free_motion_check(placed, place) for place in placed.places)


def _joint_gaps(placed: ScenePlacement, place: SamplePlacement) -> tuple[list[float], list[float]]:
    """Return constraint errors of joints and couplings of the scene, sizes or rad, and their rates, 1/s."""
    frames, size = place.state.frames(), placed.reference.size
    gaps, rates = list[float](), list[float]()
    for e in placed.mechanism.equations:
        if e.count:
            first, second, units = frames[e.first], frames[e.second], e.units(size)
            gaps.append(float(np.max(np.abs(e.phi(first, second)) / units)))
            rates.append(float(np.max(np.abs(e.jacobian(first, second).rate(first, second)) / units)))
    coupled = couplings(placed.scene)
    seen = residuals(placed.mechanism, coupled, frames, 0.0, place.state.angles)
    of_couplings = zip(coupled, seen.phi, seen.rate, seen.sensitivity, strict=True)
    for coupling, phi, rate, sensitivity in of_couplings:
        unit = (size if coupling.is_length else 1.0) * sensitivity
        gaps.append(abs(phi) / unit)
        rates.append(abs(rate) / unit)
    return gaps, rates


def _free_motion_check(placed: ScenePlacement, place: SamplePlacement) -> ReadingCheck:
    """Check that joints and constraints of the file allow each free motion of the scene."""
    reference, system, sample = placed.reference, placed.system, place.sample
    q, _ = system.coordinates(place.rest)
    free = _null(dimensionless_jacobian(system, q))
    moved = placed.of_parts(system.velocity_transformation(q) * system.velocity_units @ free)
    norms = np.linalg.norm(moved, axis=0)
    moved = moved[:, norms > FREE_SINGULAR_VALUE] / norms[norms > FREE_SINGULAR_VALUE]
    rows = place.of_parts / placed.part_units[:, None] * reference.units
    velocities = least_squares(rows, moved)
    strange = np.abs(rows @ velocities - moved).reshape(len(placed.bodies), -1).max(axis=1, initial=0.0)
    _, jacobian, owners = sample.constraints
    opened = np.abs(jacobian @ velocities).max(axis=1, initial=0.0)
    limit = sample.tolerance_of_motion
    names = [*reference.names, *owners]
    return worst_entry(
        "motions free in the scene alone, rel", np.concatenate([strange, opened]), limit, names
    )


def _null(jacobian: Array) -> Array:
    """Return orthonormal columns of motions that a dimensionless Jacobian certainly leaves free."""
    if not jacobian.size:
        return np.eye(jacobian.shape[1])
    _, s, vt = singular_values(jacobian, full=True)
    return np.asarray(vt[int(np.sum(s > FREE_SINGULAR_VALUE * max(1.0, s[0]))) :].T)


def start_checks(placed: ScenePlacement) -> Iterator[ReadingCheck]:
    """Check loop closure, pose and velocities at the start of the scene."""
    reference, place = placed.reference, placed.places[0]
    free, limit = place.sample.freedom, place.sample.tolerance
    closest, opened = reference.open
    of_rows, of_motions = _components(reference)
    offsets = np.zeros(len(of_rows) + len(of_motions))
    np.maximum.at(offsets, of_rows, np.abs(closest.residual))
    limits = limit + OFFSET_FACTOR * offsets * free.condition
    if len(of_rows):
        gaps, names = np.abs(opened.residual), opened.owners
        yield worst_entry("loops open at the start, sizes or rad", gaps, limits[of_rows], names)
    # distance from the pose at which the loops of the file close next to its stated pose
    away = np.abs(reference.difference(reference.closest, reference.start)) / reference.units
    judged = np.flatnonzero(~_stalled(reference))
    if len(judged):
        motions = [reference.motions[k] for k in judged]
        yield worst_entry("start, sizes or rad", away[judged], limits[of_motions[judged]], motions)
    # velocities of the scene, and the consistent velocities nearest to the file's
    state = initial_state(placed.scene)
    reached = placed.of_parts(np.hstack([state.linear_velocity, state.angular_velocity]).ravel())
    rows = place.of_parts / placed.part_units[:, None] * reference.units
    own = least_squares(rows, reached)
    stated = reference.stated[1] / reference.units
    wanted = _nearest(stated, rows, free, reference.units)
    scale = max(1.0, float(np.max(np.abs(stated), initial=0.0)))
    yield worst_entry(
        "velocities at the start, rel",
        np.abs(own - wanted) / scale,
        place.sample.tolerance_of_motion,
        reference.motions,
    )


def starts_not_compared(reference: ReferenceModel) -> list[str]:
    """Return the names of joints whose loops do not close in the file."""
    return list(dict.fromkeys(reference.motions[k] for k in np.flatnonzero(_stalled(reference))))


def _stalled(reference: ReferenceModel) -> Array:
    """Mark (nv,) velocities in loops that `ReferenceModel.closest` closes less well than the scene.

    Next to a singular configuration, closing the loops of the file may stall, and the file has no start to
    compare with. Loops that share no joint are judged separately.
    """
    of_rows, of_motions = _components(reference)
    closest, opened = openings = np.zeros((2, len(of_rows) + len(of_motions)))
    for opening, constraints in zip(openings, reference.open, strict=True):
        np.maximum.at(opening, of_rows, np.abs(constraints.residual))
    return np.asarray(~(closest <= np.maximum(MIN_STALLED_ERROR, STALLED_RATIO * opened))[of_motions])


def _components(reference: ReferenceModel) -> tuple[Array, Array]:
    """Label the connected component of each row (k,) and each velocity (nv,) of a file's constraints."""
    # the maximum over two configurations, because a lever arm may vanish in one of them
    jacobian = np.maximum(*(np.abs(constraints.jacobian) for constraints in reference.open))
    joined = jacobian > READING_ROUND_OFF
    of_rows, of_velocities = np.arange(len(jacobian)), np.arange(jacobian.shape[1]) + len(jacobian)
    for row, velocities in zip(of_rows.copy(), joined, strict=True):
        # everything that the row connects takes the label of the row
        others = of_velocities[velocities]
        of_rows[np.isin(of_rows, others)] = row
        of_velocities[np.isin(of_velocities, others)] = row
    return of_rows, of_velocities


def _nearest(stated: Array, rows: Array, free: Freedom, units: Array) -> Array:
    """Return consistent velocities (nv,) at which bodies move most like at the stated velocities."""
    basis = free.basis * units[free.rows] / units[:, None]
    # Euler parameters have half the rate of angles
    metric = np.tile(np.repeat([1.0, 0.5], 3), len(rows) // 6)[:, None] * rows
    return np.asarray(basis @ least_squares(metric @ basis, metric @ stated))
