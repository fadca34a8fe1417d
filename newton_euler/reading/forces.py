"""Compare forces and armatures of an imported scene with the file's reference model.

The reference model is the model file as an independent parser compiles it. Its *samples* are states at which
file and scene are compared; the bodies of the scene are placed at the poses and velocities of the samples.
Forces of the scene (`found`) and of the reference model (`wanted`) are compared along the motions that the
constraints leave free: d of the nv velocities of the file are independent, and `Freedom.basis` (nv, d) gives
all velocities from them. A difference is attributed to the element of the file whose force alone explains
most of the difference. Armatures are inertias of motors' rotors; they are compared as parts of the mass
matrix.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from newton_euler.equations.dense import least_squares
from newton_euler.model.balls import SPIN, joint_bodies
from newton_euler.model.constraints import Frame
from newton_euler.model.forces import Spring
from newton_euler.model.motions import TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.switched_forces import SwitchedForce
from newton_euler.reading.activity import Bounds
from newton_euler.reading.checks import (
    MIN_SCALE_SHARE,
    ReadingCheck,
    closest_to_failing,
    positive,
    worst_entry,
)
from newton_euler.reading.placement import SamplePlacement, ScenePlacement
from newton_euler.reading.quantities import FORCE_KINDS
from newton_euler.reading.reference import ReferenceModel
from newton_euler.reading.wrenches import Wrenches
from newton_euler.scalars import Array

MAX_UNEXPLAINED_SHARE = 1e-3
"""Largest fraction of the difference's sum of squares that an element may leave unexplained, if the
difference is attributed to the element."""

ElementForces = Iterator[tuple[str, list[list[Array]]]]
"""Pairs of an element's name and its forces. The forces are a list for each way in which the element can act;
each list has one array for each sample."""


def force_checks(placed: ScenePlacement) -> Iterator[ReadingCheck]:
    """Check forces of all `FORCE_KINDS`, armatures, and limited forces.

    Friction and stops are checked if the scene or the file has any.
    """
    scenes = _split_by_kind(placed.scene)
    found = [_wrenches_by_kind(placed, place, scenes) for place in placed.placements]
    wanted_forces = [place.sample.forces for place in placed.placements]
    for kind, name in enumerate(FORCE_KINDS):
        if name == "friction_and_stops" and not (
            placed.scene.switched_forces or np.any([forces[kind] for forces in wanted_forces])
        ):
            continue
        yield _force_check(
            placed, kind, [each[kind] for each in found], [each[kind] for each in wanted_forces]
        )
    yield _armature_check(placed)
    _, velocities = placed.reference.file_state
    if placed.reference.force_limits(placed.reference.start, velocities):  # the file has limits
        yield _limit_check(placed)


def _limit_check(placed: ScenePlacement) -> ReadingCheck:
    """Check the imported limits of forces, and the limited forces at the samples.

    Scenes do not simulate limits; after a run, the import report tests with these values whether a limit
    would have acted. A difference is divided by the largest sum of the magnitudes of a force's terms at any
    sample. In this sum a joint coordinate has at least the magnitude `MIN_SCALE_SHARE` times 1 rad or the
    size of the mechanism.
    """
    reference = placed.reference
    gaps, scales, names = [], [], list[str]()
    for place in placed.placements:
        limits = reference.force_limits(place.sample.q, place.sample.v)
        names = [limit.element for limit in limits]
        # `watched`: limit and force as the reader imported them. Different limits count as an infinite gap
        frames = place.state.frames()
        forces = [_limited_force(placed, frames, limit.watched) for limit in limits]
        scales.append([scale for _, scale in forces])
        gaps.append(
            [
                abs(force - limit.force)
                if (limit.watched.low, limit.watched.high) == (limit.low, limit.high)
                else np.inf
                for limit, (force, _) in zip(limits, forces, strict=True)
            ]
        )
    relative = np.array(gaps) / positive(np.max(scales, axis=0))
    return worst_entry("limits of forces, rel", relative, np.array(placed.force_tolerances)[:, None], names)


def _limited_force(placed: ScenePlacement, frames: list[Frame], bounds: Bounds) -> tuple[float, float]:
    """Compute a limited force constant + by_value * x + by_rate * dx/dt, N or N m, at a sample.

    Args:
        placed: bodies of the scene at the poses of the file.
        frames: pose and velocity of each body at the sample.
        bounds: the imported limit; x is the sum of joint coordinates times factors, `bounds.terms`.

    Returns:
        The force, and the sum of the magnitudes of its terms.
    """
    assert not isinstance(bounds.constant, TimeFunction)  # control inputs of the samples are constant
    force = bounds.constant
    scale = abs(force)
    for (joint, index), factor in bounds.terms:
        equations = placed.mechanism.joint_equations(joint)
        unit = placed.reference.size if equations.coordinates[index].is_length else 1.0
        for gain, x in zip((bounds.by_value, bounds.by_rate), equations.measure(index, frames), strict=True):
            force += gain * factor * x
            scale += abs(gain * factor) * max(abs(x), MIN_SCALE_SHARE * unit)
    return float(force), float(scale)


def _force_check(
    placed: ScenePlacement, kind: int, found: Sequence[tuple[Array, Array]], wanted: Sequence[Array]
) -> ReadingCheck:
    """Check forces of one kind in independent velocities of the file.

    Args:
        placed: bodies of the scene at the poses of the file.
        kind: number of the kind in `FORCE_KINDS`.
        found: for each sample, the scene's wrenches on bodies and the sums of the magnitudes of their terms,
            see `_wrenches_by_kind`.
        wanted: for each sample, the generalized forces (nv,) of the reference model.
    """
    reference, differences, scales = placed.reference, [], []
    for place, (wrench, magnitude), force in zip(placed.placements, found, wanted, strict=True):
        basis = place.sample.freedom.basis
        body_velocities = place.transformation @ basis  # (6 b, d) per independent velocity
        differences.append(body_velocities.T @ wrench.ravel() - basis.T @ force)
        scales.append(np.abs(body_velocities).T @ magnitude.ravel() + np.abs(basis).T @ np.abs(force))

    def of_elements() -> ElementForces:
        """Yield the force of each element of the file alone."""
        for name, ways in reference.elements(reference.samples):
            yield name, [_projected(reference, [forces[kind] for forces in each]) for each in ways]

    def at_joints() -> ElementForces:
        """Yield a constant force, a spring and a damper at each joint, with the name of the joint."""
        displacements = [reference.difference(reference.start, sample.q) for sample in reference.samples]
        for k, name in enumerate(reference.motions):
            unit = np.eye(len(reference.motions))[k]
            springs = [x[k] * unit for x in displacements]
            dampers = [sample.v[k] * unit for sample in reference.samples]
            ways = ([unit] * len(displacements), springs, dampers)
            yield name, [_projected(reference, forces) for forces in ways]

    # A difference that no element of the file explains is attributed to a joint
    quantity = f"{FORCE_KINDS[kind].replace('_', ' ')}, rel"
    scale = row_scales(reference, scales)
    tolerances = placed.force_tolerances
    return row_check(reference, quantity, differences, scale, tolerances, of_elements, at_joints)


def _armature_check(placed: ScenePlacement) -> ReadingCheck:
    """Check armatures as parts of the mass matrix of independent velocities."""
    reference = placed.reference
    wanted = _projected(reference, [sample.mass_matrices.armatures for sample in reference.samples])
    found = []
    for place in placed.placements:
        speeds = _armature_speeds(placed, place) @ place.transformation @ place.sample.freedom.basis
        found.append(speeds.T @ speeds)
    sums = [np.diag(one) + np.abs(np.diag(two)) for one, two in zip(found, wanted, strict=True)]
    scale = np.sqrt(row_scales(reference, sums, 2))  # square roots of inertias, one for each velocity

    def with_scaled_columns(masses: Sequence[Array]) -> list[Array]:
        """Divide the columns of mass matrices (d, d) by scales; `row_check` divides the rows."""
        units = (positive(scale[sample.freedom.independent]) for sample in reference.samples)
        return [mass / unit for mass, unit in zip(masses, units, strict=True)]

    def of_elements() -> ElementForces:
        """Yield the mass matrix of each armature of the file alone."""
        for name, each in reference.armatures(reference.samples):
            yield name, [with_scaled_columns(_projected(reference, each))]

    def at_other_joints() -> ElementForces:
        """Yield each armature of the file together with an armature at another joint.

        Such a pair explains the difference if the scene has the armature at the wrong joint.
        """
        units = [np.diag(unit) for unit in np.eye(len(reference.motions))]
        others = [
            with_scaled_columns(_projected(reference, [unit] * len(reference.samples))) for unit in units
        ]
        for name, (at_joint,) in of_elements():
            yield from ((name, [at_joint, other]) for other in others)

    differences = with_scaled_columns([one - two for one, two in zip(found, wanted, strict=True)])
    tolerances = placed.force_tolerances
    return row_check(
        reference, "armatures, rel", differences, scale, tolerances, of_elements, at_other_joints
    )


def _projected(reference: ReferenceModel, values: Sequence[Array]) -> list[Array]:
    """Project forces (nv,) or mass matrices (nv, nv), one for each sample, on independent velocities."""
    found = []
    for sample, value in zip(reference.samples, values, strict=True):
        basis = sample.freedom.basis
        found.append(basis.T @ (value @ basis if value.ndim == 2 else value))
    return found


def row_scales(reference: ReferenceModel, scales: Sequence[Array], power: int = 1) -> Array:
    """Return the scale (nv,) of the forces or inertias of each velocity: the largest one of all samples.

    Each scale is at least `MIN_SCALE_SHARE` times the largest scale, where those of slides are multiplied by
    the size of the model (forces) or its square (masses).

    Args:
        reference: the model of the file.
        scales: one array (d,) for each sample, in the independent velocities of the sample.
        power: 1 for forces, 2 for masses.
    """
    units = reference.units**power
    total = np.zeros(len(units))
    for sample, scale in zip(reference.samples, scales, strict=True):
        np.maximum.at(total, sample.freedom.independent, scale)
    return np.maximum(total, MIN_SCALE_SHARE * np.max(total * units, initial=0.0) / units)


def row_check(
    reference: ReferenceModel,
    quantity: str,
    differences: Sequence[Array],
    scale: Array,
    tolerances: Sequence[float],
    *candidates: Callable[[], ElementForces],
) -> ReadingCheck:
    """Check differences at all samples, and attribute a difference that is too large to an element.

    Args:
        reference: the model of the file.
        quantity: name and unit.
        differences: differences at each sample, (d,) of forces or (d, d) of mass matrices, in the d
            independent velocities of the sample.
        scale: (nv,) scale of each velocity, by which rows of differences are divided.
        tolerances: relative tolerance at each sample.
        candidates: functions that yield possible causes: elements with their forces. The functions are called
            in order until one has an element that explains the difference.
    """
    found, weights = [], []
    for difference, sample, tolerance in zip(differences, reference.samples, tolerances, strict=True):
        weights.append(1.0 / positive(scale[sample.freedom.independent]))
        relative = (np.abs(difference).T * weights[-1]).T
        relative = relative.max(axis=1, initial=0.0) if relative.ndim == 2 else relative
        names = [reference.motions[k] for k in sample.freedom.independent]
        found.append(worst_entry(quantity, relative, tolerance, names))
    worst = closest_to_failing(found)
    if worst.agrees:
        return worst
    at_fault = (_best_explanation(differences, weights, elements()) for elements in candidates)
    return worst._replace(where=next(filter(None, at_fault), worst.where))


def _best_explanation(differences: Sequence[Array], weights: Sequence[Array], elements: ElementForces) -> str:
    """Name the element whose forces, times constants, explain differences at all samples best; "" if none.

    Args:
        differences: (d,) or (d, d) at each sample.
        weights: (d,) factors of the differences' rows at each sample.
        elements: names and forces of elements.
    """

    def weighted(values: Sequence[Array]) -> Array:
        """Multiply the rows of the arrays of all samples by their weights, and join them to one vector."""
        pairs = zip(values, weights, strict=True)
        return np.concatenate([(each.T * weight).T.ravel() for each, weight in pairs])

    gap, smallest, name = weighted(differences), MAX_UNEXPLAINED_SHARE, ""
    for element, ways in elements:
        columns = np.array([weighted(values) for values in ways]).T
        rest = gap - columns @ least_squares(columns, gap)
        unexplained = float(rest @ rest) / float(gap @ gap)
        if unexplained < smallest:
            smallest, name = unexplained, element
    return name


def _split_by_kind(scene: Scene) -> tuple[Scene, Scene, Scene, Scene]:
    """Return the scene with its springs, dampers, all other forces, and dry friction and stops alone.

    A spring of a scene may have damping; it is then in the first and in the second result.
    """
    with_damping = [force for force in scene.forces if isinstance(force, Spring)]
    others = tuple(force for force in scene.forces if not isinstance(force, Spring | SwitchedForce))
    springs = tuple(replace(force, damping=0.0) for force in with_damping if force.stiffness)
    dampers = tuple(replace(force, stiffness=0.0) for force in with_damping if force.damping)
    springs_alone = replace(scene, control=(), forces=springs)
    return (
        springs_alone,
        replace(springs_alone, forces=dampers),
        replace(scene, forces=others),
        replace(springs_alone, forces=scene.switched_forces),
    )


def _wrenches_by_kind(
    placed: ScenePlacement, place: SamplePlacement, scenes: tuple[Scene, Scene, Scene, Scene]
) -> list[tuple[Array, Array]]:
    """Compute the scene's wrenches (b, 6) of each of the `FORCE_KINDS`, and the sums of their magnitudes.

    A wrench is a force and a torque about the center of mass of a body, N and N m, world frame.

    Args:
        placed: bodies of the scene at the poses of the file.
        place: the same bodies at one sample: `state` has their velocities, `rest` has the same poses without
            velocities.
        scenes: the scene with one kind of forces each, see `_split_by_kind`.
    """
    weight = np.zeros((len(placed.mechanism.bodies), 6))
    for wrench, body in zip(weight, placed.mechanism.bodies, strict=True):
        wrench[:3] = body.mass * placed.scene.gravity
    springs, dampers, others, friction_and_stops = scenes
    return [
        (weight, np.abs(weight)),
        _wrenches(springs, place.rest),
        _wrenches(dampers, place.state),
        _wrenches(others, place.state),
        _wrenches(friction_and_stops, place.state),
    ]


def _wrenches(scene: Scene, state: State) -> tuple[Array, Array]:
    """Compute the wrenches (b, 6) of all forces of a scene except gravity, and the sums of their
    magnitudes."""
    found = Wrenches(scene.mechanism, state)
    found.add_forces(scene)
    return found.total, found.magnitude


def _armature_speeds(placed: ScenePlacement, place: SamplePlacement) -> Array:
    """Return the Jacobian (r, 6 b) of the r armature speeds with respect to body velocities, each row times
    sqrt(inertia).

    The squared norm of its product with body velocities is twice the kinetic energy of the armatures.
    """
    mechanism, frames = placed.mechanism, place.rest.frames()
    found = [np.zeros((0, len(frames), 6))]
    for armature in placed.scene.armatures:
        if armature.on_ball:
            first, second = joint_bodies(mechanism, armature.joint)
            rows = SPIN  # Jacobian of the relative angular velocity (3,)
        else:
            joint, coordinate = armature.key
            equations = mechanism.joint_equations(joint)
            first, second = equations.first, equations.second
            rows = equations.coordinates[coordinate].jacobian(frames[first], frames[second])
        jacobian = np.zeros((len(rows.r_first), len(frames), 6))
        jacobian[:, first] = np.hstack([rows.r_first, rows.theta_first])
        jacobian[:, second] = np.hstack([rows.r_second, rows.theta_second])
        found.append(np.sqrt(armature.inertia) * jacobian)
    return np.concatenate(found).reshape(-1, 6 * len(frames))
