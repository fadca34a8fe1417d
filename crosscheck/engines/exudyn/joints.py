"""Joints of a scene as generic joints of Exudyn, which constrain axes between the frames of two markers.

`ObjectJointGeneric` has a flag for each of three translations and three rotations. The meaning of an equation
depends on the other flags:

- One or two translations are along axes of the first marker, but three translations are along the world's.
- Three rotations keep z, z and x of the first marker perpendicular to y, x and y of the second one.
- Two rotations, about x and y, keep z of the first marker perpendicular to x and y of the second one.
- A single rotation, about z, keeps x of the first marker perpendicular to y of the second one.

Therefore a redundant equation is not left out by clearing its flag: the others would change. Instead, the
joint is divided into generic joints of one equation each, see `rows`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from newton_euler.model.compound_joint import Compound
from newton_euler.model.geometry import UNIT_TOLERANCE
from newton_euler.model.joint import AxisJoint, Joint, perpendicular_pair
from newton_euler.model.joint_kinds import Universal
from newton_euler.scalars import Array

Flags = tuple[int, int, int, int, int, int]
"""Constrained translations along x, y, z and rotations about x, y, z: 1 if constrained, else 0."""

SINGLE_ROTATION: Flags = (0, 0, 0, 0, 0, 1)
"""Flags of a joint that keeps x of the first marker perpendicular to y of the second one."""

AXIS_FLAGS: dict[str, Flags] = {
    "revolute": (1, 1, 1, 1, 1, 0),
    "cylindrical": (1, 1, 0, 1, 1, 0),
    "screw": (1, 1, 0, 1, 1, 0),
    "prismatic": (1, 1, 0, 1, 1, 1),
    "translational": (1, 1, 0, 1, 1, 1),
    "planar": (0, 0, 1, 1, 1, 0),
    "point_on_line": (1, 1, 0, 0, 0, 0),
}
"""Flags of the joints with one axis, by kind; the axis is z of both markers. The thread of a screw is a
coupling."""


PERPENDICULAR: dict[tuple[int, ...], tuple[tuple[int, int], ...]] = {
    (0, 0, 0): (),
    (0, 0, 1): ((0, 1),),
    (1, 1, 0): ((2, 0), (2, 1)),
    (1, 1, 1): ((2, 1), (2, 0), (0, 1)),
}
"""Equations of constrained rotations, by their flags: number of the axis of the first marker, and of the axis
of the second marker that is perpendicular to it."""


class Part(NamedTuple):
    """A generic joint between two bodies; a compound joint may have two of them.

    Attributes:
        axes: (3, 3) axes of the markers, in columns, world frame at the initial pose.
        flags: constrained axes.
    """

    axes: Array
    flags: Flags


def parts(joint: Joint) -> list[Part]:
    """Return the generic joints that have the constraints of a joint; none for a free joint.

    Raises:
        ValueError: for a joint without such generic joints, see `why_not`.
    """
    if reason := why_not(joint):
        raise ValueError(reason)
    if isinstance(joint, Universal):
        return [Part(_universal_axes(joint.axis_on_first, joint.axis_on_second), (1, 1, 1, 0, 0, 1))]
    if isinstance(joint, AxisJoint):
        return [Part(_axes_about(joint.axis), AXIS_FLAGS[joint.kind])]
    if isinstance(joint, Compound):
        both = (_translations(joint.slides), _rotations(joint.hinges, joint.ball))
        return [part for part in both if any(part.flags)]
    flags: dict[str, Flags] = {"fixed": (1, 1, 1, 1, 1, 1), "spherical": (1, 1, 1, 0, 0, 0)}
    return [Part(np.eye(3), flags[joint.kind])] if joint.kind in flags else []


def rows(part: Part) -> list[Part]:
    """Divide a generic joint into generic joints of one equation each, in the order of its flags.

    Together they allow the same motions. Each can be left out without a change of the others.
    """
    translations = [
        Part(part.axes, (int(k == 0), int(k == 1), int(k == 2), 0, 0, 0)) for k in range(3) if part.flags[k]
    ]
    rotations = []
    for first, second in PERPENDICULAR[part.flags[3:]]:
        x, y = part.axes[:, first], part.axes[:, second]
        rotations.append(Part(np.column_stack([x, y, np.cross(x, y)]), SINGLE_ROTATION))
    return translations + rotations


def why_not(joint: Joint) -> str:
    """Return why generic joints cannot have the constraints of a joint; "" if they can.

    A rod is a connector of its own kind, and no generic joint.
    """
    if isinstance(joint, Compound):
        if joint.has_offsets:
            return "its hinge axes do not meet, and Exudyn has no joint with massless links"
        if len(joint.hinges) == 2 and abs(float(joint.hinges[0] @ joint.hinges[1])) > UNIT_TOLERANCE:
            return "its two hinges are not perpendicular, as those of Exudyn's universal joint are"
        return ""
    if joint.kind in (*AXIS_FLAGS, "universal", "fixed", "spherical", "rod", "free"):
        return ""
    return f"Exudyn has no joint of the kind {joint.kind}"


def _axes_about(axis: Array) -> Array:
    """Return axes (3, 3), in columns, of which the last one is a given unit axis."""
    return np.column_stack([*perpendicular_pair(axis), axis])


def _universal_axes(on_first: Array, on_second: Array) -> Array:
    """Return the axes of the markers of a universal joint: x is fixed in the first body, y in the second."""
    return np.column_stack([on_first, on_second, np.cross(on_first, on_second)])


def _translations(slides: Array) -> Part:
    """Return the generic joint that lets a point move along slides (n, 3) only."""
    if len(slides) == 1:
        return Part(_axes_about(slides[0]), (1, 1, 0, 0, 0, 0))
    if len(slides) == 2:
        normal = np.cross(*slides)
        return Part(_axes_about(normal / np.linalg.norm(normal)), (0, 0, 1, 0, 0, 0))
    free = len(slides) == 3
    return Part(np.eye(3), (0, 0, 0, 0, 0, 0) if free else (1, 1, 1, 0, 0, 0))


def _rotations(hinges: Array, ball: bool) -> Part:
    """Return the generic joint that lets a body turn about hinges (m, 3) in a row, or as a ball."""
    if len(hinges) == 1:
        return Part(_axes_about(hinges[0]), (0, 0, 0, 1, 1, 0))
    if len(hinges) == 2:
        return Part(_universal_axes(hinges[0], hinges[1]), (0, 0, 0, 0, 0, 1))
    free = ball or len(hinges) == 3
    return Part(np.eye(3), (0, 0, 0, 0, 0, 0) if free else (0, 0, 0, 1, 1, 1))
