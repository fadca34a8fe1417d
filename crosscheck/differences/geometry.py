"""Rows of shapes of bodies: those that touch others, and those that are drawn. They do not change the motion.

In: the common frames of two robots, and the shapes of both files. Out: rows, one for one cause. A shape is
compared with the nearest one of the same body, in the common frame of the bodies. Meshes are compared by
their vertices, as files are renamed and move the frames of meshes.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np

from crosscheck.differences.causes import with_causes
from crosscheck.differences.difference import Difference, Quantity, Value, difference, numbers
from crosscheck.differences.frames import IN_WORLD, CommonFrames, has_joint_above
from crosscheck.differences.stack import ROUND_OFF, Poses, Side, angle, distance, relative, turn_angle
from crosscheck.differences.tree_match import assignment
from newton_euler.reading.file_shapes import GROUND, FileShape, FileShapes
from newton_euler.scalars import Array

SAME_SURFACE = 1e-4
"""Largest distance of vertices of one surface, relative to the diagonal of the box around it."""

CLEAR = 1e-3
"""rad, turn that is clearly more than rounding, as of a symmetric shape; and relative change of a size."""

MIN_TURN = 1e-6
"""rad, smallest turn of a shape that is reported; vertices of meshes have single precision."""

CUBE = [
    np.eye(3)[list(order)] * signs
    for order in permutations(range(3))
    for signs in product((-1.0, 1.0), repeat=3)
    if np.linalg.det(np.eye(3)[list(order)] * signs) > 0.0
]
"""Rotations (3, 3) of a cube, after which a box has its axes along the same lines."""

HALF_TURN = np.diag([1.0, -1.0, -1.0])
"""Rotation after which a cylinder has its axis along the same line."""

SYMMETRIES = {
    "box": CUBE,
    "ellipsoid": CUBE,
    "cylinder": [np.eye(3), HALF_TURN],
    "capsule": [np.eye(3), HALF_TURN],
}
"""Rotations (3, 3) after which a shape has its axes along the same lines, by kind of the shape."""

SORTED_SIZES = ("box", "ellipsoid")
"""Kinds of shapes with one size along each axis."""

AXIAL = ("cylinder", "capsule", "plane")
"""Kinds of shapes whose orientation is that of their z axis."""


@dataclass(frozen=True, eq=False)
class _Placed:
    """Shape in the common frame of its body.

    Attributes:
        shape: the shape.
        pose: of its frame, as it is written and in the variants.
        size: (V, k), see `FileShape.size`.
        scale: (V, 3), see `FileShape.scale`.
        contact: (V, k), by name, see `FileShape.contact`.
        vertices: (n, 3) m, of a mesh, in the common frame; None as in `FileShape.vertices`.
    """

    shape: FileShape
    pose: Poses
    size: Array
    scale: Array
    contact: dict[str, Array]
    vertices: Array | None

    @property
    def center(self) -> Array:
        """Middle (3,) of a mesh; origin of other shapes; m."""
        if self.vertices is None:
            return np.asarray(self.pose.position[0])
        return np.asarray(0.5 * (self.vertices.min(axis=0) + self.vertices.max(axis=0)))


def geometry_rows(common: CommonFrames, shapes: tuple[FileShapes, FileShapes]) -> list[Difference]:
    """Return the differences of the shapes of two files, which have no effect on the compared motion.

    Args:
        common: both robots with the common frames of their bodies.
        shapes: shapes of both files.
    """
    first = _placed(common, common.first, shapes[0])
    second = _placed(common, common.second, shapes[1])
    rows: list[Difference] = []
    for number in dict.fromkeys((*first, *second)):
        pairs, *alone = _pairs(first[number], second[number])
        for one, two in pairs:
            rows += _rows(common, number, one, two)
        for side, those in enumerate(alone):
            rows += [_presence_row(each.shape, side) for each in those]
    found = with_causes(rows, common.first.file, common.second.file, common.judge.tolerance)
    return [replace(row, effect=0.0) for row in found]


def _placed(common: CommonFrames, side: Side, shapes: FileShapes) -> dict[int, list[_Placed]]:
    """Return the shapes of one file by the number of their pair of bodies.

    Bodies that only this file has are a row with all that they carry. If they are fixed to the ground, their
    shapes are those of the ground.
    """
    robot = side.file.robot
    is_first = side is common.first
    number_of = common.first_of if is_first else common.second_of
    body_of = {body.name: index for index, body in enumerate(robot.bodies)}
    found: dict[int, list[_Placed]] = defaultdict(list)
    for index, shape in enumerate(shapes.shapes):
        number, body = IN_WORLD, -1
        if shape.body != GROUND:
            body = body_of.get(shape.body, -1)  # halves of one body may have become one for the comparison
            if body in number_of:
                number = number_of[body]
            elif body < 0 or has_joint_above(robot, body):
                continue
        of_variants = [shape, *(variant[index] for variant in shapes.variants)]
        pose = Poses.of([each.placement for each in of_variants])
        frame = common.frames[number].first if is_first else common.frames[number].second
        if body >= 0:
            pose = _product(_product(frame.inverse(), side.world[body]), pose)
        vertices = shape.vertices
        if vertices is not None:
            vertices = pose.position[0] + vertices @ pose.rotation[0].T
        size, scale = (np.array([getattr(each, name) for each in of_variants]) for name in ("size", "scale"))
        contact = {name: np.array([each.contact[name] for each in of_variants]) for name in shape.contact}
        found[number].append(_Placed(shape, pose, size, scale, contact, vertices))
    return found


def _product(frame: Poses, inner: Poses) -> Poses:
    """Return where frames inside of frames are; of two numbers of variants, the smaller one counts."""
    count = min(len(frame.position), len(inner.position))
    return Poses(*(each[:count] for each in frame)) @ Poses(*(each[:count] for each in inner))


def _pairs(
    first: Sequence[_Placed], second: Sequence[_Placed]
) -> tuple[list[tuple[_Placed, _Placed]], list[_Placed], list[_Placed]]:
    """Return pairs of the nearest shapes of a body, and the shapes of each file without partner.

    Shapes of one purpose and one kind are paired first, then those of one purpose. If numbers of contacts
    decide on the purpose in both files, shapes of one kind follow.
    """
    ones, twos = list(first), list(second)
    pairs: list[tuple[_Placed, _Placed]] = []
    keys: list[Callable[[_Placed], tuple[str, ...]]] = [
        lambda each: (each.shape.role, each.shape.kind),
        lambda each: (each.shape.role,),
    ]
    if all(each.shape.contact for each in (*first, *second)):
        keys.append(lambda each: (each.shape.kind,))
    for key in keys:
        for group in dict.fromkeys(map(key, ones)):
            found = _nearest(*([each for each in side if key(each) == group] for side in (ones, twos)))
            pairs += found
            ones = [each for each in ones if each not in [one for one, _ in found]]
            twos = [each for each in twos if each not in [two for _, two in found]]
    return pairs, ones, twos


def _nearest(ones: list[_Placed], twos: list[_Placed]) -> list[tuple[_Placed, _Placed]]:
    """Return pairs of shapes with the smallest sum of distances; the others stay alone."""
    costs = np.array([[_unlikeness(one, two) for two in twos] for one in ones])
    values = costs.max(initial=0.0) + 1.0 - costs
    pairs = assignment(range(len(ones)), range(len(twos)), lambda one, two: float(values[one, two]))
    return [(ones[one], twos[two]) for one, two in pairs]


def _unlikeness(one: _Placed, two: _Placed) -> float:
    """Return the distance of two shapes, m, with the difference of their sizes."""
    apart = float(np.linalg.norm(one.center - two.center))
    if one.shape.kind == two.shape.kind and one.vertices is None:
        apart += float(np.linalg.norm(one.size[0] - two.size[0]))
    elif one.vertices is not None and two.vertices is not None:
        apart += float(np.linalg.norm(np.ptp(one.vertices, axis=0) - np.ptp(two.vertices, axis=0)))
    return apart


def _presence_row(shape: FileShape, side: int) -> Difference:
    """Return the row of a shape that only one file has, the first (0) or the second (1)."""
    values: tuple[Value, Value] = (None, shape.kind) if side else (shape.kind, None)
    kind = f"{shape.role} {shape.kind}"
    return difference(shape.body, kind, Quantity.PRESENCE, values, (1.0, 0.0))


def _rows(common: CommonFrames, number: int, one: _Placed, two: _Placed) -> Iterator[Difference]:
    """Yield the rows of two shapes of a pair of bodies."""
    name, role, kinds = one.shape.body, one.shape.role, (one.shape.kind, two.shape.kind)
    if kinds[0] != kinds[1]:
        yield difference(name, f"{role} shape", Quantity.KIND, kinds, (1.0, 0.0))
        return
    kind = f"{role} {kinds[0]}"
    found = [each for each in _differing(common, number, one, two) if each[2][0]]
    different = {quantity for quantity, _, (size, uncertainty) in found if size > uncertainty}
    if Quantity.SIZE in different and len(different) > 1:
        found = [(Quantity.SHAPE, (_shape_text(one), _shape_text(two)), (1.0, 0.0))]
    for quantity, values, sizes in found:
        cause = f"another {kinds[0]}" if quantity is Quantity.SHAPE else ""
        yield difference(name, kind, quantity, values, sizes, cause)
    for what in one.shape.contact if two.shape.contact else ():
        pair = one.shape.contact[what], two.shape.contact[what]
        sizes = common.judge.compare(one.contact[what], two.contact[what], relative)
        if sizes[0]:
            values = pair if len(pair[0]) > 1 else (pair[0][0], pair[1][0])
            yield difference(name, kind, Quantity(what), values, sizes)


Found = tuple[Quantity, tuple[Value, Value], tuple[float, float]]
"""Quantity, values in both files, and size and uncertainty of the difference."""


def _differing(common: CommonFrames, number: int, one: _Placed, two: _Placed) -> Iterator[Found]:
    """Yield what differs between two shapes of one kind, or may differ by rounding."""
    own = one.shape.vertices, two.shape.vertices
    if own[0] is None or own[1] is None or one.vertices is None or two.vertices is None:
        yield from _size_and_place(common, number, one, two)
    elif _coincide(own[0], own[1]):
        found = list(_size_and_place(common, number, one, two))
        is_turned = any(quantity is Quantity.ORIENTATION and size > CLEAR for quantity, _, (size, _) in found)
        if not (is_turned and _coincide(one.vertices, two.vertices)):  # a symmetric mesh
            yield from found
    elif _coincide(one.vertices, two.vertices):
        return  # the file of the mesh has another frame
    elif _coincide(own[0] * two.scale[0], own[1] * one.scale[0]):
        values = numbers(one.scale[0]), numbers(two.scale[0])
        yield Quantity.MESH_SCALE, values, common.judge.compare(one.scale, two.scale, relative)
        yield from _size_and_place(common, number, one, two)
    else:
        yield Quantity.SHAPE, (_mesh_text(one.vertices), _mesh_text(two.vertices)), (1.0, 0.0)


def _size_and_place(common: CommonFrames, number: int, one: _Placed, two: _Placed) -> Iterator[Found]:
    """Yield size, place and orientation of two shapes of one kind."""
    kind = one.shape.kind
    turn = min(SYMMETRIES.get(kind, [np.eye(3)]), key=lambda turn: _misfit(one, two, turn))
    size = two.size @ np.abs(turn) if kind in SORTED_SIZES else two.size
    if one.size.size:
        values = numbers(one.size[0]), numbers(size[0])
        yield Quantity.SIZE, values, common.judge.compare(one.size, size, relative)
    values = _point(one), _point(two)
    yield Quantity.PLACE, values, common.compare(number, one.pose.position, two.pose.position, distance)
    if kind == "sphere":
        return
    rotations = one.pose.rotation, two.pose.rotation @ turn
    if kind in AXIAL:
        sizes = common.compare(number, rotations[0][..., 2], rotations[1][..., 2], angle)
    else:
        sizes = common.compare(number, *rotations, turn_angle)
    if sizes[0] > MIN_TURN:
        yield Quantity.ORIENTATION, (0.0, sizes[0]), sizes


def _misfit(one: _Placed, two: _Placed, turn: Array) -> tuple[int, bool, float]:
    """Return how much two shapes of one kind differ if the second one is turned, for a choice of the turn.

    Returns:
        Number of size and orientation that differ, whether the size does, and how much both do.
    """
    size = two.size[0] @ np.abs(turn) if one.shape.kind in SORTED_SIZES else two.size[0]
    columns = [2] if one.shape.kind in AXIAL else [0, 1, 2]
    rotation = two.pose.rotation[0] @ turn - one.pose.rotation[0]
    errors = (
        float(np.linalg.norm(size - one.size[0]) / (np.linalg.norm(one.size[0]) or 1.0)),
        float(np.linalg.norm(rotation[:, columns])),
    )
    differ = [error > CLEAR for error in errors]
    return sum(differ), differ[0], sum(errors)


def _coincide(one: Array, two: Array) -> bool:
    """Return whether two sets of vertices (n, 3), m, are those of one surface.

    Files may repeat vertices, and have them in any order.
    """
    from scipy.spatial import KDTree

    boxes = [np.array([each.min(axis=0), each.max(axis=0)]) for each in (one, two)]
    allowed = SAME_SURFACE * float(np.linalg.norm(np.ptp(boxes[0], axis=0)))
    if np.abs(boxes[0] - boxes[1]).max() > allowed:
        return False
    return all(
        float(KDTree(a).query(b, distance_upper_bound=2.0 * allowed + ROUND_OFF)[0].max()) <= allowed
        for a, b in ((one, two), (two, one))
    )


def _point(shape: _Placed) -> tuple[float, ...]:
    """Return the place (3,) of a shape, m, without the round-off of frames."""
    return numbers(np.round(shape.pose.position[0], 9))


def _shape_text(shape: _Placed) -> str:
    """Describe the size and the place of a shape in words, m."""
    sides, point = (" ".join(f"{value:.3g}" for value in each) for each in (shape.size[0], _point(shape)))
    return f"{sides} at {point} m"


def _mesh_text(vertices: Array) -> str:
    """Describe a mesh in words: number of vertices and sides of the box around it, m."""
    sides = " x ".join(f"{side:.3g}" for side in np.ptp(vertices, axis=0))
    return f"{len(np.unique(vertices, axis=0))} vertices in {sides} m"
