"""Combine several elementary motions between two bodies into one joint of this project.

MJCF and URDF files place several hinges, slides or balls in a row between two bodies that have mass,
sometimes with massless links between them. `combine_motions` finds the joint class with the same motions: for
example `Universal` for two perpendicular hinges whose axes meet, and `Compound` if no special class fits. The
readers of both formats use it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from newton_euler.errors import MechanismError
from newton_euler.model.compound_joint import Compound
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import Cylindrical, Prismatic, Revolute, Spherical, Universal
from newton_euler.model.parallel_hinges import ParallelHinges
from newton_euler.scalars import Array

MEETING_TOLERANCE = 1e-10
"""Distance, m, from a common point below which hinge axes count as meeting there: well above the round-off of
points in meters."""

ALIGNMENT_TOLERANCE = 1e-12
"""Sine (cosine) of the angle between axes below which they count as parallel (perpendicular): round-off."""


class Part(NamedTuple):
    """One elementary motion of a row of motions between two bodies, world frame at the initial pose.

    Attributes:
        name: name in the model file.
        kind: "hinge", "slide" or "ball".
        axis: (3,) unit axis; unused for a ball.
        anchor: (3,) m, a point on the axis of a hinge, or the center of a ball; for a slide, the position of
            the joint in the model file, which does not affect the motion.
    """

    name: str
    kind: str
    axis: Array
    anchor: Array


def common_name(names: Sequence[str]) -> str:
    """Return the common stem of n names that end in "_1" to "_n"; an empty string for other names.

    When this project writes a model file, it numbers the parts of one joint in this way: "hip_1", "hip_2" for
    the joint "hip".
    """
    bases = {name.rpartition("_")[0] for name in names}
    numbers = sorted(name.rpartition("_")[2] for name in names)
    same = len(bases) == 1 and numbers == [str(k + 1) for k in range(len(names))]
    return bases.pop() if same else ""


def combine_motions(
    name: str, parent: str, child: str, parts: Sequence[Part], actuated: bool
) -> tuple[Joint, dict[str, int]]:
    """Build one joint that allows several elementary motions in a row.

    Args:
        name: name of the joint.
        parent, child: names of the two bodies.
        parts: the motions in their order from the parent to the child.
        actuated: True if a control law may drive the joint.

    Returns:
        The joint, and for each hinge and slide, by name, the index of its joint coordinate. The coordinates
        measure the motion of the child relative to the parent and are zero at the initial pose.

    Raises:
        MechanismError: for a row that no joint class describes: slides between hinges, more than two parallel
            hinges, or a ball and other rotations. `Compound` also raises for axes of slides, or of hinges,
            that are linearly dependent, such as two hinges on one line.
    """
    # Joint classes have slides before hinges: if the slides come last, go from the child to the parent. With
    # reversed axes the coordinates still measure the motion of the child relative to the parent
    ends, row = (parent, child), list(parts)
    rotates = [part.kind != "slide" for part in row]
    if rotates != sorted(rotates):  # sorted: False (slides) before True
        ends, row = (child, parent), [part._replace(axis=-part.axis) for part in reversed(row)]
        rotates.reverse()
    if rotates != sorted(rotates):
        raise MechanismError(
            f"body {child!r}", "has slides between its hinges", "slides first, or slides last"
        )

    # Refuse three or more parallel hinges. The massless links between them have no equations of motion, and
    # the poses of the two bodies do not determine their angles: three hinges have two solutions, more
    # hinges have infinitely many
    rotational = [part for part in row if part.kind != "slide"]
    hinges = [part for part in rotational if part.kind == "hinge"]
    for first in hinges:
        parallel = [part.name for part in hinges if are_parallel(first.axis, part.axis)]
        if len(parallel) > 2:
            problem = f"has {len(parallel)} parallel hinges with no mass between them: {', '.join(parallel)}"
            needed = "at most two, or mass and inertia of the links between them"
            raise MechanismError(f"body {child!r}", problem, needed)

    # Refuse a ball beside hinges or other balls, so that a ball is the only rotation
    if len(rotational) > 1 and len(hinges) < len(rotational):
        names = ", ".join(part.name for part in rotational)
        problem = f"has a ball and other rotations with no mass between them: {names}"
        needed = "a ball as the only rotation, or mass and inertia of the links between them"
        raise MechanismError(f"body {child!r}", problem, needed)

    # The joint point: where all hinge axes meet, the center of a ball, or a point on the first hinge axis if
    # they do not meet. For slides alone any point serves
    anchors = [part.anchor for part in rotational]
    meeting = _meeting_point(rotational) if rotational else row[-1].anchor
    point = anchors[0] if meeting is None else meeting

    # Each hinge and slide has an axis and a joint coordinate. A ball has neither: its state is a quaternion
    with_axis = [part for part in row if part.kind != "ball"]
    axes = [part.axis for part in with_axis]
    coordinates = {part.name: k for k, part in enumerate(with_axis)}

    # Choose the most special joint class
    joint: Joint
    match [part.kind for part in row]:
        case ["hinge"]:
            joint = Revolute(name, *ends, point, axis=axes[0], actuated=actuated)
        case ["slide"]:
            joint = Prismatic(name, *ends, point, axis=axes[0], actuated=actuated)
        case ["ball"]:
            joint = Spherical(name, *ends, point, actuated=actuated)
        case ["hinge", "hinge"] if meeting is not None and abs(axes[0] @ axes[1]) < ALIGNMENT_TOLERANCE:
            a, b = axes
            joint = Universal(name, *ends, point, axis_on_first=a, axis_on_second=b, actuated=actuated)
        case ["hinge", "hinge"] if are_parallel(axes[0], axes[1]) and meeting is None:
            joint = ParallelHinges(
                name,
                *ends,
                point,
                axis=axes[0],
                offset=anchors[1] - anchors[0],
                opposed=bool(axes[0] @ axes[1] < 0.0),
                actuated=actuated,
            )
        # equal axes; opposite axes do not fit, because both coordinates of the class are about one axis
        case ["slide", "hinge"] if np.linalg.norm(axes[0] - axes[1]) < ALIGNMENT_TOLERANCE:
            joint = Cylindrical(name, *ends, point, axis=axes[0], actuated=actuated)
        case _:
            joint = Compound(
                name,
                *ends,
                point,
                slides=np.array([part.axis for part in row if part.kind == "slide"]),
                hinges=np.array([part.axis for part in row if part.kind == "hinge"]),
                offsets=None if meeting is not None else np.diff(anchors, axis=0),
                ball=row[-1].kind == "ball",
                actuated=actuated,
            )
    return joint, coordinates


def are_parallel(first: Array, second: Array) -> bool:
    """Return True if two unit axes (3,) are parallel within `ALIGNMENT_TOLERANCE`; their signs may differ."""
    return bool(np.linalg.norm(np.cross(first, second)) < ALIGNMENT_TOLERANCE)


def _meeting_point(parts: Sequence[Part]) -> Array | None:
    """Compute the point (3,), m, that lies on all hinge axes and in all ball centers; None if there is none.

    The point is the least-squares solution of P_k x = P_k a_k. a_k is the anchor of part k, and P_k projects
    onto the plane perpendicular to its axis (identity for a ball).
    """
    first = parts[0].anchor
    if all(np.linalg.norm(part.anchor - first) <= MEETING_TOLERANCE for part in parts):
        return first
    projections = [np.eye(3) - (part.kind != "ball") * np.outer(part.axis, part.axis) for part in parts]
    projected = [p @ part.anchor for p, part in zip(projections, parts, strict=True)]  # P_k a_k
    point = np.linalg.lstsq(np.vstack(projections), np.concatenate(projected), rcond=None)[0]
    missed = max(np.linalg.norm(p @ point - a) for p, a in zip(projections, projected, strict=True))
    return None if missed > MEETING_TOLERANCE else np.asarray(point)
