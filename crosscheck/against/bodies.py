"""Bodies of two models: those that are fixed to each other merged, and how frames lie in each other.

Two files may state one body in different frames and at different poses. What they have in common is what the
body carries: center of mass, inertia, points and axes of joints.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from newton_euler.assemble import initial_state
from newton_euler.equations.system import MassProperties
from newton_euler.model.compound_joint import Compound
from newton_euler.model.euler_parameters import rotation
from newton_euler.model.forces import Force
from newton_euler.model.joint import Joint, Motion
from newton_euler.model.joint_kinds import Fixed
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import OUTPUTS, Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array, cross

COINCIDES = 1e-9
"""Sizes of the mechanism, rad, and shares: what is nearer is the same for the choice of a placement."""

PARALLEL = 1.0 - 1e-6
"""Cosine between axes that are taken for parallel: a small fault of one of the two of a cylindrical joint
leaves both on both bodies."""

Members = Mapping[str, tuple[str, ...]]
"""For each body the names of those that it is made of."""


def merge_fixed(scene: Scene) -> tuple[Scene, Members]:
    """The same mechanism without `fixed` joints, all outputs asked for.

    Bodies that are fixed to the ground become the ground; others take the name and the frame of the first
    of them.
    """
    groups = _groups(scene.mechanism)
    owner = {name: group[0] for group in groups for name in group}
    indices = [[scene.mechanism.body_index(name) for name in group] for group in groups]
    bodies = [scene.mechanism.bodies[0], *(_merged(scene.mechanism, group) for group in indices[1:])]
    joints = [with_bodies(joint, owner) for joint in scene.mechanism.joints]
    mechanism = Mechanism(
        bodies, [joint for joint in joints if joint.first != joint.second], scene.mechanism.couplings
    )
    state = _state(scene, bodies, [group[0] for group in indices])
    forces = forces_with_bodies(scene.forces, owner, bodies[0].name)
    merged = replace(
        scene, mechanism=mechanism, initial_state=state, forces=forces, outputs=frozenset(OUTPUTS)
    )
    return merged, {group[0]: group for group in groups}


def _groups(mechanism: Mechanism) -> list[tuple[str, ...]]:
    """Names of the bodies that move as one, in the mechanism's order; the ground's are the first."""
    owner = {name: name for name in mechanism.body_names}
    for joint in mechanism.joints:
        if isinstance(joint, Fixed):
            kept, other = sorted((owner[joint.first], owner[joint.second]), key=mechanism.body_names.index)
            owner = {name: kept if of == other else of for name, of in owner.items()}
    return [
        tuple(name for name in mechanism.body_names if owner[name] == group)
        for group in dict.fromkeys(owner.values())
    ]


def _merged(mechanism: Mechanism, indices: list[int]) -> Body:
    """One body of several, in the frame of the first."""
    first = mechanism.bodies[indices[0]]
    if len(indices) == 1:
        return first
    found, parts = MassProperties.of(mechanism), [mechanism.bodies[k] for k in indices]
    masses, centers = found.mass[indices], found.center_of_mass[indices]
    center = masses @ centers / masses.sum()
    inertia = found.inertia[indices].sum(axis=0)
    for mass, arm in zip(masses, centers - center, strict=True):
        inertia = inertia + mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    into = first.pose.rotation.T
    local = into @ inertia @ into.T
    return replace(
        first,
        mass=float(masses.sum()),
        center_of_mass=center,
        inertia=0.5 * (local + local.T),
        shapes=tuple(shape for part in parts for shape in part.shapes),
        meshes=tuple(mesh for part in parts for mesh in part.meshes),
        allow_unrealisable_inertia=any(part.allow_unrealisable_inertia for part in parts),
    )


def _state(scene: Scene, bodies: list[Body], indices: list[int]) -> State:
    """The initial state of bodies that have the frames of those of these numbers."""
    start = initial_state(scene)
    position, velocity = start.position[indices], start.linear_velocity[indices]
    for n, (body, index) in enumerate(zip(bodies, indices, strict=True)):
        before = scene.mechanism.bodies[index].pose
        arm = start.frames()[index].rotation @ before.point_to_body(body.center_of_mass)
        position[n] += arm
        velocity[n] += cross(start.angular_velocity[index], arm)
    return State(position, start.quaternion[indices], velocity, start.angular_velocity[indices])


def with_bodies(joint: Joint, names: Mapping[str, str]) -> Joint:
    """A joint between bodies of other names."""
    return replace(joint, first=names[joint.first], second=names[joint.second])


def forces_with_bodies(forces: tuple[Force, ...], names: Mapping[str, str], ground: str) -> tuple[Force, ...]:
    """Forces on bodies of other names, without those that act within a body or on the ground alone."""
    found: list[Force] = []
    for force in forces:
        renamed: dict[str, Any] = {field: names[getattr(force, field)] for field in force.body_fields}
        moved = replace(force, **renamed)
        bodies = {getattr(moved, field) for field in force.body_fields}
        if len(bodies) == len(force.body_fields) and bodies != {ground}:
            found.append(moved)
    return tuple(found)


class Carried(NamedTuple):
    """A joint's side on a body, in the body frame, from the center of mass."""

    point: Array
    """(3,) m."""
    loose: Array
    """(3, n) directions in which the point could be elsewhere and the joint be the same."""
    axes: tuple[tuple[str, Array], ...]
    """ "hinge", "slide" or "normal" of a plane, with its direction; of any sign."""

    def turned(self, turn: Array, center: Array) -> Carried:
        """The same in another frame, whose vectors `turn` (3, 3) takes to this one, `center` from its own."""
        axes = tuple((kind, turn.T @ axis) for kind, axis in self.axes)
        return Carried(center + turn.T @ self.point, turn.T @ self.loose, axes)


def carried(body: Body, joint: Joint) -> Carried:
    """Return a joint's side on a body.

    Slides turn nothing, so that a body carries the axis of a motion if only slides and hinges parallel to it
    are between the two.
    """
    is_first, pose = joint.first == body.name, body.pose
    point = pose.point_to_body(joint.point if is_first else joint.reaction_point)
    if joint.only_closes:
        return Carried(point, np.zeros((3, 0)), ())
    motions = joint.motions if is_first else joint.motions[::-1]
    """From this body to the other."""
    slides = [motion.axis for motion in motions if motion.kind == "slide"]
    hinges = _axes(motions, "hinge")
    axes = [("hinge", axis) for axis in hinges]
    if len(slides) in (3, len(motions)):
        loose = [*np.eye(3)]
    else:
        # a hinge that both bodies carry leaves open where on its line the point is
        others = _axes(motions[::-1], "hinge")
        loose = _axes(motions, "slide") + [axis for axis in hinges if any(axis is other for other in others)]
        if isinstance(joint, Compound) and np.any(joint.offsets):  # of a first hinge or a last one
            loose += hinges[:1]
    if len(slides) == 2 and _keep(motions[: _last_slide(motions)], _normal(*slides)):
        axes.append(("normal", _normal(*slides)))
        loose += slides if len(motions) > 2 else []
    elif len(slides) < 3:
        axes += [("slide", axis) for axis in _axes(motions, "slide")]
    into = pose.rotation.T
    local = tuple((kind, into @ axis) for kind, axis in axes)
    return Carried(point, into @ np.array(loose).reshape(-1, 3).T, local)


def _last_slide(motions: Sequence[Motion]) -> int:
    return max(n for n, motion in enumerate(motions) if motion.kind == "slide")


def _axes(motions: Sequence[Motion], kind: str) -> list[Array]:
    """Axes of the motions of a kind that the body carries from which the motions are counted."""
    found = ((n, motion.axis) for n, motion in enumerate(motions) if motion.kind == kind)
    return [axis for n, axis in found if _keep(motions[:n], axis)]


def _keep(motions: Sequence[Motion], axis: Array) -> bool:
    """True if motions leave a direction where it is, whatever their coordinates are."""
    return all(
        motion.kind == "slide" or (motion.kind == "hinge" and abs(motion.axis @ axis) > PARALLEL)
        for motion in motions
    )


def _normal(a: Array, b: Array) -> Array:
    normal = np.cross(a, b)
    return np.asarray(normal / np.linalg.norm(normal))


class Features(NamedTuple):
    """All that a body carries, and its start."""

    inertia: Array
    joints: tuple[Carried, ...]
    position: Array
    rotation: Array


def features(scene: Scene, number: int, joints: Sequence[str]) -> Features:
    """Features of a body with the joints of these names."""
    mechanism, start = scene.mechanism, initial_state(scene)
    body = mechanism.bodies[number]
    found = tuple(carried(body, mechanism.joint(name)) for name in joints)
    return Features(body.inertia, found, start.position[number], rotation(start.quaternion[number]))


class Placed(NamedTuple):
    """A body of the second model in the frame of the first's."""

    turn: Array
    """(3, 3) takes vectors of the first's frame to the second's."""
    center: Array
    """(3,) the second's center of mass from the first's, in the first's frame, m."""


def place(first: Features, second: Features, size: float) -> Placed:
    """Lay a body of the second model on the first's: as both start, by equal frames, or by joint points.

    The placement in which the most of what the body carries coincides; of equals the first one.
    """
    best, least = Placed(np.eye(3), np.zeros(3)), np.inf
    for way in _ways(first, second):
        parts = list(_distances(first, second, way, size))
        missed = sum(part > COINCIDES for part in parts)
        if missed < least:
            best, least = way, missed
        if not missed:
            break
    return best


def _ways(first: Features, second: Features) -> Iterator[Placed]:
    start = second.rotation.T @ first.rotation
    yield Placed(start, first.rotation.T @ (second.position - first.position))
    for turn in (start, np.eye(3), *_fits(first, second)):
        pairs = zip(first.joints, second.joints, strict=True)
        shifts = [(a.point - turn.T @ b.point, a.loose, turn.T @ b.loose) for a, b in pairs]
        yield from (Placed(turn, across(*shift)) for shift in shifts)
        yield Placed(turn, np.zeros(3))
        yield from (Placed(turn, shift) for shift, *_ in shifts)


def _fits(first: Features, second: Features) -> Iterator[Array]:
    """Least-squares turns by lines from the first joint's point to the others', or to the center of mass of
    a body with one joint, and by an axis, whose sign is unknown.

    W. Kabsch, A solution for the best rotation to relate two sets of vectors, Acta Cryst. A32, 1976.
    """
    if not first.joints:
        return
    lines = [
        np.array([_line(body.joints[0], joint) for joint in body.joints[1:] or (None,)])
        for body in (first, second)
    ]
    length = float(np.max(np.linalg.norm(lines[0], axis=1))) or 1.0
    pairs = zip(first.joints, second.joints, strict=True)
    axes = next(
        ((a.axes[0][1], b.axes[0][1]) for a, b in pairs if a.axes and b.axes), (np.zeros(3), np.zeros(3))
    )
    for sign in (length, -length):
        one, two = np.vstack([lines[0], length * axes[0]]), np.vstack([lines[1], sign * axes[1]])
        u, _, vt = np.linalg.svd(two.T @ one)
        yield u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt


def _line(start: Carried, end: Carried | None) -> Array:
    """From one point to another, or to the center of mass, but for what their kinds leave open."""
    if end is None:
        return across(-start.point, start.loose)
    return across(end.point - start.point, start.loose, end.loose)


def _distances(first: Features, second: Features, way: Placed, size: float) -> Iterator[float]:
    """Compute the distances between all that two bodies carry, in sizes, rad and shares."""
    yield float(np.linalg.norm(way.center)) / size
    yield inertia_apart(first.inertia, way.turn.T @ second.inertia @ way.turn)
    for a, b in zip(first.joints, second.joints, strict=True):
        other = b.turned(*way)
        yield points_apart(a, other) / size
        yield float(np.linalg.norm(other.point - a.point)) / size
        yield axes_apart(a, other)


def inertia_apart(one: Array, two: Array) -> float:
    """Largest difference between inertias (3, 3), relative to the largest entry of the first."""
    return float(np.max(np.abs(two - one)) / max(float(np.max(np.abs(one))), np.finfo(float).tiny))


def points_apart(a: Carried, b: Carried) -> float:
    """Distance of the points of a joint on one body, m, but for what its kind leaves open."""
    return float(np.linalg.norm(across(b.point - a.point, a.loose, b.loose)))


def across(vector: Array, *loose: Array) -> Array:
    """Remove directions from a vector, (3, n) each."""
    u, s, _ = np.linalg.svd(np.hstack([np.zeros((3, 1)), *loose]))
    span = u[:, : int(np.sum(s > 1e-3))]  # axes a little apart are one direction
    return np.asarray(vector - span @ (span.T @ vector))


def axes_apart(a: Carried, b: Carried) -> float:
    """The largest angle between axes of a joint on one body, as lines, rad; of those that both have."""
    found = 0.0
    for kind, axis in a.axes:
        others = [other for its, other in b.axes if its == kind]
        chords = [min(np.linalg.norm(axis - other), np.linalg.norm(axis + other)) for other in others]
        if chords:
            found = max(found, float(2.0 * np.arcsin(0.5 * min(chords))))
    return found
