"""Compare bodies, initial state and joints of an imported scene with the file's reference model.

The reference model is the model file as an independent parser compiles it. Its rigid groups (links that fixed
joints hold together) are the bodies of the scene, or parts of bodies that the file cuts at loops. *Samples*
are states at which scene and file are compared; `ScenePlacement` has the scene's bodies at the poses of the
samples. Values of the scene are called `found`, those of the reference model `wanted`. Dimensionless numbers
have lengths divided by the size of the mechanism ("sizes").
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from newton_euler.equations.coupling_equations import residuals
from newton_euler.equations.couplings import couplings
from newton_euler.equations.dense import least_squares, singular_values
from newton_euler.equations.system import MassProperties, dimensionless_jacobian
from newton_euler.reading.checks import MIN_SCALE_SHARE, ReadingCheck, closest_to_failing, worst_entry
from newton_euler.reading.placement import SamplePlacement, ScenePlacement, shifted_to
from newton_euler.reading.quantities import FREE_SINGULAR_VALUE, Freedom
from newton_euler.reading.reference import READING_ROUND_OFF, ReferenceModel
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array

OFFSET_FACTOR = 10.0
"""Allowed difference of the initial poses of scene and file, as a multiple of the file's loop-closure error.
For joint coordinates, the condition number of the constraints is a further factor."""

STALLED_RATIO = 10.0
"""Ratio of loop-closure errors above which Newton steps have not closed the loops of the file: the error at
`ReferenceModel.closest`, divided by the error at the start of the scene. The start of these loops is not
compared."""

MIN_STALLED_ERROR = 1e-9
"""Loop-closure error, rad or sizes, below which loops count as closed in any case."""

CENTER_CHECK = "center of mass at the start, m"
"""Quantity of the check of initial centers of mass; later checks make no sense if this check fails."""

MAX_INERTIA_LOSS = 1e3
"""Largest relative error of an inertia, as a multiple of round-off. Inertias lose digits if they are small
differences of terms with the distance from the origin."""


def body_checks(placed: ScenePlacement) -> Iterator[ReadingCheck]:
    """Check mass properties, including the initial centers of mass, and the mass matrix with open loops."""
    reference, names = placed.reference, placed.mechanism.body_names[1:]
    of_scene = placed.system.mass_properties()
    found = _without_ground(of_scene)
    wanted = _without_ground(_combined(reference.mass_properties(), placed.body_of_group))
    reach = reference.size + float(np.max(np.abs(wanted.center_of_mass)))  # m, scale of positions
    yield worst_entry("mass, rel", np.abs(found.mass / wanted.mass - 1.0), READING_ROUND_OFF, names)
    gaps = np.linalg.norm(found.center_of_mass - wanted.center_of_mass, axis=1)
    # The two halves of a cut body may be apart by the loop-closure error of the file at the start
    offset = reference.offset if placed.has_cut_bodies else 0.0
    yield worst_entry(CENTER_CHECK, gaps, reach * (READING_ROUND_OFF + OFFSET_FACTOR * offset), names)
    largest = np.linalg.norm(wanted.inertia, ord=2, axis=(1, 2))  # largest principal moment of each body
    gaps = np.linalg.norm(found.inertia - wanted.inertia, ord=2, axis=(1, 2)) / largest
    # Terms of the parallel-axis theorem, divided by the inertia
    losses = np.clip(wanted.mass * reference.size * reach / largest, 1.0, MAX_INERTIA_LOSS)
    yield worst_entry("inertia, rel", gaps, READING_ROUND_OFF * losses, names)
    yield _mass_matrix_check(placed, of_scene)


def _without_ground(properties: MassProperties) -> MassProperties:
    """Return the mass properties of all bodies but the first, the ground."""
    return MassProperties(properties.mass[1:], properties.center_of_mass[1:], properties.inertia[1:])


def _combined(groups: MassProperties, bodies: Sequence[int]) -> MassProperties:
    """Combine mass properties of rigid groups to mass properties of bodies, ground first.

    Args:
        groups: mass properties of g groups, world frame.
        bodies: (g,) index of the body of which each group is a part.
    """
    count = max(bodies) + 1
    mass, center, inertia = np.zeros(count), np.zeros((count, 3)), np.zeros((count, 3, 3))
    np.add.at(mass, bodies, groups.mass)
    np.add.at(center, bodies, groups.mass[:, None] * groups.center_of_mass)
    center[1:] /= mass[1:, None]
    for body, m, r, about in zip(bodies, groups.mass, groups.center_of_mass, groups.inertia, strict=True):
        arm = r - center[body]  # parallel-axis theorem
        inertia[body] += about + m * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return MassProperties(mass, center, inertia)


def _mass_matrix_check(placed: ScenePlacement, of_scene: MassProperties) -> ReadingCheck:
    """Check the mass matrix of the scene's bodies, without armatures, in the velocities of the file.

    The configurations have open loops, so that all velocities are compared. If the file cuts bodies into
    halves, which open loops would separate, the configurations are the samples with closed loops.

    Args:
        placed: bodies of the scene at the poses of the file.
        of_scene: mass properties of the scene's bodies at the start, world frame.
    """
    reference, (start_centers, start_rotations) = placed.reference, placed.start_frames
    found, quantity = [], "mass matrix, loops open, rel"
    for sample in reference.samples if placed.has_cut_bodies else reference.open_loop_samples:
        # basis (nv, d) of the free velocities of the file, and the numbers (d,) of those that determine all
        basis, chosen = sample.freedom.basis, sample.freedom.independent
        if not len(chosen):
            continue
        wanted, of_armatures = sample.mass_matrices
        motion = sample.kinematics
        # M = sum over bodies of J_v^T m J_v + J_w^T I J_w, with the Jacobians of the velocities of the center
        # of mass and of the angular velocities. `turn` is the rotation of a group since the start
        mass = np.zeros_like(wanted)
        for body, k in placed.first_groups.items():
            turn = motion.rotation[k] @ start_rotations[k].T
            arm = turn @ (of_scene.center_of_mass[body] - start_centers[k])
            rows = shifted_to(motion.transformation[k], arm)
            inertia = turn @ of_scene.inertia[body] @ turn.T
            mass += of_scene.mass[body] * rows[:3].T @ rows[:3] + rows[3:].T @ inertia @ rows[3:]
        scale = np.sqrt(np.diag(basis.T @ (wanted + of_armatures) @ basis))
        # Links without mass would have the scale 0; the scale is at least a fraction of the largest one
        units = reference.units[chosen]
        scale = np.maximum(scale, MIN_SCALE_SHARE * np.max(scale * units) / units)
        gaps = np.max(np.abs(basis.T @ (mass - wanted) @ basis) / np.outer(scale, scale), axis=1)
        names = [reference.motions[k] for k in chosen]
        found.append(worst_entry(quantity, gaps, sample.precision, names))
    return closest_to_failing(found) if found else ReadingCheck(quantity, 0.0, READING_ROUND_OFF, "")


def joint_checks(placed: ScenePlacement) -> Iterator[ReadingCheck]:
    """Check the scene's joints at motions of the file, and the file's constraints at the scene's motions."""
    found = [_joint_errors(placed, place) for place in placed.placements]
    tolerances = np.array([place.sample.tolerance_of_motion for place in placed.placements])[:, None]
    # Joints with constraints (a free joint has none), then couplings of joint coordinates, such as gears
    names = [equations.joint.name for equations in placed.mechanism.equations if equations.count]
    names += [coupling.name for coupling in couplings(placed.scene)]
    yield worst_entry(
        "loop-closure error, sizes or rad", np.array([gaps for gaps, _ in found]), tolerances, names
    )
    yield worst_entry("joints opening, 1/s", np.array([rates for _, rates in found]), tolerances, names)
    yield closest_to_failing(_free_motion_check(placed, place) for place in placed.placements)


def _joint_errors(placed: ScenePlacement, place: SamplePlacement) -> tuple[list[float], list[float]]:
    """Return the largest constraint error of each joint and coupling of the scene at a sample, rad or sizes,
    and the largest rate of these errors, 1/s."""
    frames, size = place.state.frames(), placed.reference.size
    gaps, rates = list[float](), list[float]()
    for equations in placed.mechanism.equations:
        if equations.count:
            first, second, units = frames[equations.first], frames[equations.second], equations.units(size)
            gaps.append(float(np.max(np.abs(equations.phi(first, second)) / units)))
            jacobian = equations.jacobian(first, second)
            rates.append(float(np.max(np.abs(jacobian.rate(first, second)) / units)))
    # The error of a coupling is divided by the sum of the magnitudes of its derivatives with respect to the
    # joint coordinates, its sensitivity
    coupled = couplings(placed.scene)
    errors = residuals(placed.mechanism, coupled, frames, time=0.0, known=place.state.angles)
    of_couplings = zip(coupled, errors.phi, errors.rate, errors.sensitivity, strict=True)
    for coupling, phi, rate, sensitivity in of_couplings:
        unit = (size if coupling.is_length else 1.0) * sensitivity
        gaps.append(abs(phi) / unit)
        rates.append(abs(rate) / unit)
    return gaps, rates


def _free_motion_check(placed: ScenePlacement, place: SamplePlacement) -> ReadingCheck:
    """Check that joints and constraints of the file allow each free motion of the scene."""
    reference, system, sample = placed.reference, placed.system, place.sample
    # Velocities of the rigid groups, one column of norm 1 for each free motion of the scene at the poses of
    # the sample (`place.rest`)
    q, _ = system.coordinates(place.rest)
    free = _free_motions(dimensionless_jacobian(system, q))
    motions = placed.group_rows(system.velocity_transformation(q) * system.velocity_units @ free)
    norms = np.linalg.norm(motions, axis=0)
    motions = motions[:, norms > FREE_SINGULAR_VALUE] / norms[norms > FREE_SINGULAR_VALUE]
    # The part of each motion that no joint of the file allows, and the rates of the file's constraints
    rows = place.group_transformation / placed.group_units[:, None] * reference.units
    velocities = least_squares(rows, motions)
    across_joints = np.abs(rows @ velocities - motions)
    across_joints = across_joints.reshape(len(placed.body_of_group), -1).max(axis=1, initial=0.0)
    _, jacobian, owners = sample.constraints
    constraint_rates = np.abs(jacobian @ velocities).max(axis=1, initial=0.0)
    return worst_entry(
        "motions free in the scene alone, rel",
        np.concatenate([across_joints, constraint_rates]),
        sample.tolerance_of_motion,
        [*reference.names, *owners],
    )


def _free_motions(jacobian: Array) -> Array:
    """Return orthonormal columns (nv, d) of the motions whose singular values of a dimensionless constraint
    Jacobian (k, nv) are round-off."""
    if not jacobian.size:
        return np.eye(jacobian.shape[1])
    _, s, vt = singular_values(jacobian, full=True)
    return np.asarray(vt[int(np.sum(s > FREE_SINGULAR_VALUE * max(1.0, s[0]))) :].T)


def start_checks(placed: ScenePlacement) -> Iterator[ReadingCheck]:
    """Check loop closure, pose and velocities at the start of the scene."""
    reference, place = placed.reference, placed.placements[0]
    free = place.sample.freedom
    # Tolerance of each group of loops that share joints (label): includes the error that remains in these
    # loops at the configuration of the file with closed loops (`closest`)
    at_closest, at_start = reference.near_start
    row_labels, motion_labels = _components(reference)
    offsets = np.zeros(len(row_labels) + len(motion_labels))
    np.maximum.at(offsets, row_labels, np.abs(at_closest.residual))
    tolerances = place.sample.tolerance + OFFSET_FACTOR * offsets * free.condition
    if len(row_labels):
        gaps, names = np.abs(at_start.residual), at_start.owners
        yield worst_entry("loops open at the start, sizes or rad", gaps, tolerances[row_labels], names)
    # Distance of the scene's start from the closed configuration nearest to that in the file, for the joints
    # of loops that this configuration closes
    distance = np.abs(reference.difference(reference.closest, reference.start)) / reference.units
    judged = np.flatnonzero(~_stalled(reference))
    if len(judged):
        motions = [reference.motions[k] for k in judged]
        yield worst_entry("start, sizes or rad", distance[judged], tolerances[motion_labels[judged]], motions)
    # Initial velocities of the scene, and the velocities nearest to the file's that satisfy the constraints
    state = initial_state(placed.scene)
    of_groups = placed.group_rows(np.hstack([state.linear_velocity, state.angular_velocity]).ravel())
    rows = place.group_transformation / placed.group_units[:, None] * reference.units
    found = least_squares(rows, of_groups)
    in_file = reference.file_state[1] / reference.units
    wanted = _nearest_consistent(in_file, rows, free, reference.units)
    scale = max(1.0, float(np.max(np.abs(in_file), initial=0.0)))
    yield worst_entry(
        "velocities at the start, rel",
        np.abs(found - wanted) / scale,
        place.sample.tolerance_of_motion,
        reference.motions,
    )


def starts_not_compared(reference: ReferenceModel) -> list[str]:
    """Return the names of the joints in loops that Newton steps from the file's configuration do not close,
    so that the start of the scene cannot be compared."""
    return list(dict.fromkeys(reference.motions[k] for k in np.flatnonzero(_stalled(reference))))


def _stalled(reference: ReferenceModel) -> Array:
    """Mark the velocities (nv,) of joints in loops that are less well closed at `ReferenceModel.closest` than
    at the start of the scene.

    Next to a singular configuration, the Newton steps that close the loops of the file may stall. Loops that
    share no joint are judged separately.
    """
    row_labels, motion_labels = _components(reference)
    errors = np.zeros((2, len(row_labels) + len(motion_labels)))  # largest constraint error of each component
    for error, constraints in zip(errors, reference.near_start, strict=True):
        np.maximum.at(error, row_labels, np.abs(constraints.residual))
    at_closest, at_start = errors
    has_closed = at_closest <= np.maximum(MIN_STALLED_ERROR, STALLED_RATIO * at_start)
    return np.asarray(~has_closed[motion_labels])


def _components(reference: ReferenceModel) -> tuple[Array, Array]:
    """Label the groups of constraint rows and velocities of a file that depend on each other.

    The groups are the connected components of a graph: a row and a velocity are connected if the row's
    Jacobian has a nonzero entry for the velocity.

    Returns:
        Labels of the rows (k,) and of the velocities (nv,), from 0 to k + nv - 1.
    """
    # The maximum over two configurations, because a lever arm may vanish in one of them
    jacobian = np.maximum(*(np.abs(constraints.jacobian) for constraints in reference.near_start))
    is_connected = jacobian > READING_ROUND_OFF
    row_labels, velocity_labels = np.arange(len(jacobian)), np.arange(jacobian.shape[1]) + len(jacobian)
    for row, velocities in zip(row_labels.copy(), is_connected, strict=True):
        # All rows and velocities that the row connects take the label of the row
        others = velocity_labels[velocities]
        row_labels[np.isin(row_labels, others)] = row
        velocity_labels[np.isin(velocity_labels, others)] = row
    return row_labels, velocity_labels


def _nearest_consistent(stated: Array, rows: Array, free: Freedom, units: Array) -> Array:
    """Find the velocities (nv,) that satisfy the constraints and move the bodies most like the given ones.

    Args:
        stated: (nv,) dimensionless velocities in the file.
        rows: (6 g, nv) dimensionless Jacobian of the velocities of the rigid groups.
        free: motions that the constraints of the file leave free.
        units: (nv,) scales of velocities: the size of the model, m, or 1 for angles.
    """
    basis = free.basis * units[free.independent] / units[:, None]
    # The norm is that of `newton_euler.runs.assemble`, by which readers make the velocities of a file
    # consistent. Its coordinates are quaternions, whose rates are half of angular velocities
    metric = np.tile(np.repeat([1.0, 0.5], 3), len(rows) // 6)[:, None] * rows
    return np.asarray(basis @ least_squares(metric @ basis, metric @ stated))
