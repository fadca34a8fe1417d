"""How the body frames of two models lie in each other, whatever pose and frame each file gives.

Two files may state one body in different frames, or at different poses. What they have in common is what
the body carries: centre of mass, inertia, points and axes of joints. A body of the second model is laid on
that of the first in every way that its start, its frame or two directions on it suggest, and the way is kept
in which the most of this coincides: a fault leaves everything else where it was.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations, islice
from typing import NamedTuple

import numpy as np

from newton_euler.model.euler_parameters import rotation
from newton_euler.model.joints import Compound, Joint
from newton_euler.model.joints.base import Motion
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array

COINCIDES = 1e-12
"""Sizes of the mechanism, and rad: round-off."""

BETTER = 0.5
"""Decades in all by which another way has to be better than one before it."""

PARALLEL = 1.0 - 1e-6
"""Cosine between axes that are taken for parallel: a small fault of one of the two of a cylindrical joint
leaves both on both bodies."""

MOST_WAYS = 20
"""Pairs of directions that are tried on a body."""


class Held(NamedTuple):
    """What a joint holds on one of its bodies, world frame at the initial pose."""

    point: Array
    """(3,) m."""
    loose: Array
    """(3, n) directions in which the point could be elsewhere and the joint be the same."""
    axes: tuple[tuple[str, Array], ...]
    """ "hinge", "slide" or "normal" of a plane, with its direction, that the body carries; of any sign."""


class Placed(NamedTuple):
    """A body of the second model in the frame of the first's."""

    turn: Array
    """(3, 3) takes vectors of the first's frame to the second's."""
    center: Array
    """(3,) the second's centre of mass from the first's, in the first's frame, m."""


def held(joint: Joint, body: str) -> Held:
    """What a joint holds on the body of that name.

    Slides turn nothing, so that a body carries the axis of a motion if only slides and hinges parallel to it
    are between the two.
    """
    is_first = joint.first == body
    point = joint.point if is_first else joint.reaction_point
    if joint.only_closes:
        return Held(point, np.zeros((3, 0)), ())
    motions = joint.motions if is_first else joint.motions[::-1]
    """From this body to the other."""
    slides = [motion.axis for motion in motions if motion.kind == "slide"]
    if len(slides) == 3 or len(slides) == len(motions):
        loose = [*np.eye(3)]
    else:
        loose = _axes(motions, "slide")
        # a hinge that both bodies carry leaves open where on its line the point is
        others = _axes(motions[::-1], "hinge")
        loose += [axis for axis in _axes(motions, "hinge") if any(axis is other for other in others)]
        if isinstance(joint, Compound) and np.any(joint.offsets):  # of a first hinge or a last one
            loose += _axes(motions, "hinge")[:1]
    axes = [("hinge", axis) for axis in _axes(motions, "hinge")]
    if len(slides) == 2 and _carries_plane(motions, _normal(*slides)):
        axes.append(("normal", _normal(*slides)))
        if len(slides) < len(motions):
            loose += slides
    elif len(slides) < 3:
        axes += [("slide", axis) for axis in _axes(motions, "slide")]
    return Held(point, np.array(loose).reshape(-1, 3).T, tuple(axes))


def _axes(motions: Sequence[Motion], kind: str) -> list[Array]:
    """Axes of the motions of a kind that the body carries from which the motions are counted."""
    return [
        motion.axis
        for n, motion in enumerate(motions)
        if motion.kind == kind and _turns_about(motions[:n], motion.axis)
    ]


def _carries_plane(motions: Sequence[Motion], normal: Array) -> bool:
    """Whether the body carries the plane of two slides."""
    last = max(n for n, motion in enumerate(motions) if motion.kind == "slide")
    return _turns_about(motions[:last], normal)


def _turns_about(motions: Sequence[Motion], axis: Array) -> bool:
    """Whether motions leave a direction where it is, whatever their coordinates are."""
    return all(
        motion.kind == "slide" or (motion.kind == "hinge" and abs(motion.axis @ axis) > PARALLEL)
        for motion in motions
    )


def _normal(a: Array, b: Array) -> Array:
    normal = np.cross(a, b)
    return np.asarray(normal / np.linalg.norm(normal))


class Features(NamedTuple):
    """What a body carries of the joints that both models have, in its frame, from its centre of mass."""

    inertia: Array
    joints: tuple[Held, ...]
    pose: tuple[Array, Array]
    """Where it starts: centre of mass (3,), m, and rotation (3, 3)."""
    stated: Array
    """(3, 3) its rotation where the file states the joints."""


def features(scene: Scene, body: int, joints: Sequence[str]) -> Features:
    """Of body number `body` and the joints of these names that it has, in their order."""
    mechanism, start = scene.mechanism, scene.initial_state
    its = mechanism.bodies[body]
    found = []
    for name in joints:
        joint = mechanism.joints[mechanism.joint_index(name)]
        point, loose, axes = held(joint, its.name)
        into = its.pose.rotation.T
        local = tuple((kind, into @ axis) for kind, axis in axes)
        found.append(Held(its.pose.point_to_body(point), into @ loose, local))
    pose = start.position[body], rotation(start.quaternion[body])
    return Features(its.inertia, tuple(found), pose, its.pose.rotation)


def place(first: Features, second: Features, size: float) -> Placed:
    """The way to lay a body of the second model on the first's in which the most coincides.

    Of ways as good as each other one that leaves centre of mass and inertia as they are, wherever the body
    starts then if it starts elsewhere in both.
    """
    best, least = None, (np.inf, np.inf, False)
    for way in _ways(first, second):
        parts = [*_distances(first, second, way, size), _elsewhere(first, second, way, size)]
        decades = np.log10(np.maximum(parts, COINCIDES))
        own, start = float(np.sum(decades[:-1])), float(decades[-1])
        keeps = max(parts[:2]) <= COINCIDES
        ahead = own + start - (least[0] + least[1])
        if keeps != least[2] and min(start, least[1]) > np.log10(COINCIDES):
            ahead = own - least[0]
        if ahead < -BETTER or (keeps and not least[2] and ahead < BETTER):
            best, least = way, (own, start, keeps)
        if max(parts) <= COINCIDES:
            break
    assert best is not None
    return best


def _ways(first: Features, second: Features) -> Iterator[Placed]:
    """By the starts, by what the files state, by the frames, and by pairs of directions."""
    start = second.pose[1].T @ first.pose[1]
    yield Placed(start, first.pose[1].T @ (second.pose[0] - first.pose[0]))
    aligned = (start, second.stated.T @ first.stated, np.eye(3))
    for turn in (*aligned, *islice(_by_directions(first, second), MOST_WAYS)):
        yield Placed(turn, np.zeros(3))
        for a, b in zip(first.joints, second.joints, strict=True):
            gap = a.point - turn.T @ b.point
            yield Placed(turn, _across(gap, a.loose, turn.T @ b.loose))
            yield Placed(turn, gap)


def _by_directions(first: Features, second: Features) -> Iterator[Array]:
    """Turns that lay two directions on a body of the second model on those of the first's."""
    one, two = _directions(first), _directions(second)
    for a, b in combinations(sorted(one.keys() & two.keys()), 2):
        triads = [_triad(vectors[a], vectors[b]) for vectors in (one, two)]
        if triads[0] is not None and triads[1] is not None:
            for sense in _SENSES[: 2 ** ((a[0] == "axis") + (b[0] == "axis"))]:
                yield triads[1] @ sense @ triads[0].T


_SENSES = [
    np.diag(signs) for signs in ((1.0, 1.0, 1.0), (-1.0, 1.0, -1.0), (1.0, -1.0, -1.0), (-1.0, -1.0, 1.0))
]
"""What becomes of a `_triad` where the first direction, the second or both have the other sign."""


def _directions(carried: Features) -> dict[tuple[str, int, int], Array]:
    """Axes, and lines between points, the centre of mass among them."""
    found = {
        ("axis", k, n): axis
        for k, joint in enumerate(carried.joints)
        for n, (_, axis) in enumerate(joint.axes)
    }
    points = [(np.zeros(3), np.zeros((3, 0))), *((joint.point, joint.loose) for joint in carried.joints)]
    for (i, (a, loose)), (j, (b, other)) in combinations(enumerate(points), 2):
        found["line", i, j] = _across(b - a, loose, other)
    return found


def _triad(a: Array, b: Array) -> Array | None:
    """(3, 3) columns along a, across it to b, and normal to both; None if they lie on one line."""
    normal = np.cross(a, b)
    if np.linalg.norm(normal) <= 1e-6 * np.linalg.norm(a) * np.linalg.norm(b):
        return None
    columns = np.array([a, np.cross(normal, a), normal]).T
    return np.asarray(columns / np.linalg.norm(columns, axis=0))


def _distances(first: Features, second: Features, way: Placed, size: float) -> Iterator[float]:
    """How far apart everything is that a body carries, in sizes, rad and shares."""
    yield float(np.linalg.norm(way.center)) / size
    yield inertia_apart(first.inertia, way.turn.T @ second.inertia @ way.turn)
    for a, b in zip(first.joints, second.joints, strict=True):
        yield points_apart(a, b, way) / size
        yield anyhow_apart(a, b, way) / size
        yield axes_apart(a, b, way)


def _elsewhere(first: Features, second: Features, way: Placed, size: float) -> float:
    """How far apart the body starts in the two models, in sizes and rad."""
    (r, a), (s, b) = first.pose, second.pose
    frame = b @ way.turn
    shift = float(np.linalg.norm(s - frame @ way.center - r)) / size
    return max(shift, float(np.max(np.abs(frame - a))))


def inertia_apart(one: Array, two: Array) -> float:
    """Largest difference between inertias (3, 3), relative to the largest entry of the first."""
    return float(np.max(np.abs(two - one)) / max(float(np.max(np.abs(one))), np.finfo(float).tiny))


def points_apart(a: Held, b: Held, way: Placed) -> float:
    """Distance of the points of a joint on one body, m, but for what its kind leaves open."""
    gap = way.center + way.turn.T @ b.point - a.point
    return float(np.linalg.norm(_across(gap, a.loose, way.turn.T @ b.loose)))


def anyhow_apart(a: Held, b: Held, way: Placed) -> float:
    """Distance of the points of a joint on one body, m, whatever its kind leaves open."""
    nothing = np.zeros((3, 0))
    return points_apart(a._replace(loose=nothing), b._replace(loose=nothing), way)


def _across(vector: Array, *loose: Array) -> Array:
    """What is left of a vector without these directions, (3, n) each."""
    u, s, _ = np.linalg.svd(np.hstack([np.zeros((3, 1)), *loose]))
    span = u[:, : int(np.sum(s > 1e-3))]  # axes a little apart are one direction
    return np.asarray(vector - span @ (span.T @ vector))


def axes_apart(a: Held, b: Held, way: Placed) -> float:
    """The largest angle between axes of a joint on one body, as lines, rad; of those that both have."""
    found = 0.0
    for kind, axis in a.axes:
        others = [way.turn.T @ of for its, of in b.axes if its == kind]
        chords = [min(np.linalg.norm(axis - other), np.linalg.norm(axis + other)) for other in others]
        if chords:
            found = max(found, float(2.0 * np.arcsin(0.5 * min(chords))))
    return found


def carried(mechanism: Mechanism, joints: Mapping[str, str], body: str) -> list[tuple[str, str]]:
    """Names in both models of the joints that both have and that are on a body of the first."""
    found = []
    for name, other in joints.items():
        joint = mechanism.joints[mechanism.joint_index(name)]
        if body in (joint.first, joint.second):
            found.append((name, other))
    return found
