"""Compare forces and armatures of a scene with the file's reference model.

Bodies of the scene are placed at the poses of the file. Forces are compared in independent velocities of the
file. A difference is attributed to the element of the file whose own force explains most of the difference.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from newton_euler.equations.dense import least_squares
from newton_euler.model.balls import SPIN, ends
from newton_euler.model.forces import Spring
from newton_euler.model.motions import TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
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
"""Largest unexplained fraction (of squares) of a difference that is attributed to an element."""

ElementForces = Iterator[tuple[str, list[list[Array]]]]
"""Name of each element, and its forces at the samples: one list for each way in which the element can act."""


def force_checks(placed: ScenePlacement) -> Iterator[ReadingCheck]:
    """Check forces of each of the `FORCE_KINDS`, armatures, and limited forces."""
    scenes = _apart(placed.scene)
    acting = [_acting(placed, place, scenes) for place in placed.places]
    wanted = [place.sample.forces for place in placed.places]
    for n in range(len(FORCE_KINDS)):
        yield _force_check(placed, n, [each[n] for each in acting], [each[n] for each in wanted])
    yield _armature_check(placed)
    if placed.reference.force_limits(placed.reference.start, placed.reference.stated[1]):
        yield _limit_check(placed)


def _limit_check(placed: ScenePlacement) -> ReadingCheck:
    """Check the limits that runs are watched for, and the limited forces at the samples.

    Differences are relative to the largest terms of a force at any sample. Coordinates count in the terms
    with at least `MIN_SCALE_SHARE` times 1 rad or the size.
    """
    reference = placed.reference
    gaps, scales, names = [], [], list[str]()
    for place in placed.places:
        limits = reference.force_limits(place.sample.q, place.sample.v)
        names = [limit.element for limit in limits]
        worked_out = [_watched(placed, place, limit.watched) for limit in limits]
        scales.append([scale for _, scale in worked_out])
        gaps.append(
            [
                abs(force - limit.force)
                if (limit.watched.low, limit.watched.high) == (limit.low, limit.high)
                else np.inf
                for limit, (force, _) in zip(limits, worked_out, strict=True)
            ]
        )
    relative = np.array(gaps) / positive(np.max(scales, axis=0))
    return worst_entry("limits of forces, rel", relative, np.array(placed.limits)[:, None], names)


def _watched(placed: ScenePlacement, place: SamplePlacement, bounds: Bounds) -> tuple[float, float]:
    """Return the force that a run is watched for, and the sum of the magnitudes of its terms."""
    assert not isinstance(bounds.constant, TimeFunction)  # controls are held
    force, frames = bounds.constant, place.state.frames()
    scale = abs(force)
    for (joint, number), factor in bounds.terms:
        equations = placed.mechanism.joint_equations(joint)
        least = MIN_SCALE_SHARE * (placed.reference.size if equations.coordinates[number].is_length else 1.0)
        for gain, x in zip((bounds.by_value, bounds.by_rate), equations.measure(number, frames), strict=True):
            force += gain * factor * x
            scale += abs(gain * factor) * max(abs(x), least)
    return float(force), float(scale)


def _force_check(
    placed: ScenePlacement, kind: int, acting: Sequence[tuple[Array, Array]], wanted: Sequence[Array]
) -> ReadingCheck:
    reference, left, scales = placed.reference, [], []
    for place, (wrench, magnitude), force in zip(placed.places, acting, wanted, strict=True):
        basis = place.sample.freedom.basis
        onto = place.transformation @ basis
        left.append(onto.T @ wrench.ravel() - basis.T @ force)
        scales.append(np.abs(onto).T @ magnitude.ravel() + np.abs(basis).T @ np.abs(force))

    def alone() -> ElementForces:
        for name, ways in reference.elements(reference.samples):
            yield name, [_reduced(reference, [forces[kind] for forces in each]) for each in ways]

    def at_joints() -> ElementForces:
        """Yield constant forces, springs and dampers at each joint, for forces that no element explains."""
        moved = [reference.difference(reference.start, sample.q) for sample in reference.samples]
        for k, name in enumerate(reference.motions):
            unit = np.eye(len(reference.motions))[k]
            springs, dampers = [x[k] * unit for x in moved], [s.v[k] * unit for s in reference.samples]
            ways = ([unit] * len(moved), springs, dampers)
            yield name, [_reduced(reference, forces) for forces in ways]

    scale = row_scales(reference, scales)
    return row_check(reference, f"{FORCE_KINDS[kind]}, rel", left, scale, placed.limits, alone, at_joints)


def _armature_check(placed: ScenePlacement) -> ReadingCheck:
    """Check armatures as parts of the mass matrix of independent velocities."""
    reference = placed.reference
    wanted = _reduced(reference, [sample.mass_matrices[1] for sample in reference.samples])
    found = []
    for place in placed.places:
        onto = _spins(placed, place) @ place.transformation @ place.sample.freedom.basis
        found.append(onto.T @ onto)
    sums = [np.diag(one) + np.abs(np.diag(two)) for one, two in zip(found, wanted, strict=True)]
    scale = np.sqrt(row_scales(reference, sums, 2))

    def relative(masses: Sequence[Array]) -> list[Array]:
        units = (positive(scale[sample.freedom.rows]) for sample in reference.samples)
        return [mass / unit for mass, unit in zip(masses, units, strict=True)]

    def alone() -> ElementForces:
        for name, each in reference.rotors(reference.samples):
            yield name, [relative(_reduced(reference, each))]

    def at_other_joints() -> ElementForces:
        """Yield armatures that were placed at another joint."""
        units = [np.diag(unit) for unit in np.eye(len(reference.motions))]
        others = [relative(_reduced(reference, [unit] * len(reference.samples))) for unit in units]
        for name, (own,) in alone():
            yield from ((name, [own, other]) for other in others)

    left = relative([one - two for one, two in zip(found, wanted, strict=True)])
    return row_check(reference, "armatures, rel", left, scale, placed.limits, alone, at_other_joints)


def _reduced(reference: ReferenceModel, of_velocities: Sequence[Array]) -> list[Array]:
    """Project forces (nv,) or mass matrices (nv, nv) at the samples on their independent velocities."""
    found = []
    for sample, whole in zip(reference.samples, of_velocities, strict=True):
        basis = sample.freedom.basis
        found.append(basis.T @ (whole @ basis if whole.ndim == 2 else whole))
    return found


def row_scales(reference: ReferenceModel, scales: Sequence[Array], power: int = 1) -> Array:
    """Return (nv,) the largest scale of each velocity over all samples, and at least `MIN_SCALE_SHARE`.

    Args:
        reference: the model of the file.
        scales: one array for each sample, in the independent velocities of the sample.
        power: 1 for forces, 2 for masses.
    """
    units = reference.units**power
    total = np.zeros(len(units))
    for sample, scale in zip(reference.samples, scales, strict=True):
        np.maximum.at(total, sample.freedom.rows, scale)
    return np.maximum(total, MIN_SCALE_SHARE * np.max(total * units, initial=0.0) / units)


def row_check(
    reference: ReferenceModel,
    quantity: str,
    left: Sequence[Array],
    scale: Array,
    limits: Sequence[float],
    *alone: Callable[[], ElementForces],
) -> ReadingCheck:
    """Check differences at all samples, and attribute a difference to an element.

    Args:
        reference: the model of the file.
        quantity: name and unit.
        left: (d,) or (d, d) differences at each sample, in independent velocities.
        scale: (nv,) largest value of each velocity.
        limits: relative tolerance at each sample.
        alone: kinds of elements. The first kind that explains the difference names the element at fault.
    """
    found, weights = [], []
    for gap, sample, limit in zip(left, reference.samples, limits, strict=True):
        weights.append(1.0 / positive(scale[sample.freedom.rows]))
        shares = (np.abs(gap).T * weights[-1]).T
        shares = shares.max(axis=1, initial=0.0) if shares.ndim == 2 else shares
        names = [reference.motions[k] for k in sample.freedom.rows]
        found.append(worst_entry(quantity, shares, limit, names))
    most = closest_to_failing(found)
    named = (_most_alike(left, weights, elements()) for elements in alone)
    return most if most.agrees else most._replace(where=next(filter(None, named), most.where))


def _most_alike(left: Sequence[Array], weights: Sequence[Array], alone: ElementForces) -> str:
    """Name the element whose forces, times constants, explain differences at all states best; "" if none."""

    def weighed(values: Sequence[Array]) -> Array:
        pairs = zip(values, weights, strict=True)
        return np.concatenate([(each.T * weight).T.ravel() for each, weight in pairs])

    gap, best, name = weighed(left), MAX_UNEXPLAINED_SHARE, ""
    for element, ways in alone:
        columns = np.array([weighed(values) for values in ways]).T
        rest = gap - columns @ least_squares(columns, gap)
        share = float(rest @ rest) / float(gap @ gap)
        if share < best:
            best, name = share, element
    return name


def _apart(scene: Scene) -> tuple[Scene, Scene, Scene]:
    """Split a scene into springs, dampers, and all other forces except gravity."""
    both = [force for force in scene.forces if isinstance(force, Spring)]
    others = tuple(force for force in scene.forces if not isinstance(force, Spring))
    springs = tuple(replace(force, damping=0.0) for force in both if force.stiffness)
    dampers = tuple(replace(force, stiffness=0.0) for force in both if force.damping)
    sprung = replace(scene, control=(), forces=springs)
    return sprung, replace(sprung, forces=dampers), replace(scene, forces=others)


def _acting(
    placed: ScenePlacement, place: SamplePlacement, scenes: tuple[Scene, Scene, Scene]
) -> list[tuple[Array, Array]]:
    """Compute the wrenches (b, 6) of each of the `FORCE_KINDS` on the bodies, and the sums of magnitudes."""
    weight = np.zeros((len(placed.mechanism.bodies), 6))
    for wrench, body in zip(weight, placed.mechanism.bodies, strict=True):
        wrench[:3] = body.mass * placed.scene.gravity
    springs, dampers, others = scenes
    return [
        (weight, np.abs(weight)),
        _wrenches(springs, place.rest),
        _wrenches(dampers, place.state),
        _wrenches(others, place.state),
    ]


def _wrenches(scene: Scene, state: State) -> tuple[Array, Array]:
    """Compute the wrenches (b, 6) of all forces of a scene except gravity, and the sums of magnitudes."""
    found = Wrenches(scene.mechanism, state)
    found.add_forces(scene)
    return found.total, found.magnitude


def _spins(placed: ScenePlacement, place: SamplePlacement) -> Array:
    """Return the Jacobian (r, 6 b) of rotor speeds for velocities of the bodies, times sqrt(inertia)."""
    mechanism, frames = placed.mechanism, place.rest.frames()
    found = [np.zeros((0, len(frames), 6))]
    for armature in placed.scene.armatures:
        if armature.on_ball:
            first, second = ends(mechanism, armature.joint)
            rows = SPIN
        else:
            joint, coordinate = armature.key
            equations = mechanism.joint_equations(joint)
            first, second = equations.first, equations.second
            rows = equations.coordinates[coordinate].jacobian(frames[first], frames[second])
        row = np.zeros((len(rows.r_first), len(frames), 6))
        row[:, first] = np.hstack([rows.r_first, rows.theta_first])
        row[:, second] = np.hstack([rows.r_second, rows.theta_second])
        found.append(np.sqrt(armature.inertia) * row)
    return np.concatenate(found).reshape(-1, 6 * len(frames))
