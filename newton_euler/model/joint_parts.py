"""One joint out of parts: hinges, slides and balls in a row, as robot models put them between two bodies."""

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

MEET = 1e-10  # m, by which hinges in a row may miss a common point
ALIGNED = 1e-12  # sine or cosine of the angle between axes in a row that are parallel or perpendicular


class Part(NamedTuple):
    """One motion of a row, world frame at the initial pose.

    Attributes:
        name: for errors.
        kind: "hinge", "slide" or "ball".
        axis: (3,) unit; unused for a ball.
        anchor: (3,) a point on the axis of a hinge, the center of a ball.
    """

    name: str
    kind: str
    axis: Array
    anchor: Array


def common_name(names: Sequence[str]) -> str:
    """Find the common beginning of the names of the parts of one joint, numbered from 1; empty if none."""
    bases = {name.rpartition("_")[0] for name in names}
    numbers = sorted(name.rpartition("_")[2] for name in names)
    same = len(bases) == 1 and numbers == [str(k + 1) for k in range(len(names))]
    return bases.pop() if same else ""


def combined(
    name: str, parent: str, child: str, parts: Sequence[Part], actuated: bool
) -> tuple[Joint, dict[str, int]]:
    """Build the joint of these motions in a row from parent to child.

    Returns:
        The joint, and for each hinge and slide, by name, which of its coordinates it is. Coordinates are
        the motions' own: of the child against the parent, zero at the initial pose.

    Raises:
        MechanismError: for a row that no joint is: slides between hinges, axes that depend on each other.
    """
    ends, row = (parent, child), list(parts)
    turned = [part.kind != "slide" for part in row]
    if turned != sorted(turned):  # seen from the child, the slides come first
        ends, row = (child, parent), [part._replace(axis=-part.axis) for part in reversed(row)]
        turned.reverse()
    if turned != sorted(turned):
        raise MechanismError(
            f"body {child!r}", "has slides between its hinges", "slides first, or slides last"
        )
    turning = [part for part in row if part.kind != "slide"]
    hinges = [part for part in turning if part.kind == "hinge"]
    for first in hinges:
        parallel = [part.name for part in hinges if np.linalg.norm(np.cross(first.axis, part.axis)) < ALIGNED]
        if len(parallel) > 2:
            problem = f"has {len(parallel)} parallel hinges with no mass between them: {', '.join(parallel)}"
            needed = "at most two, or mass and inertia of the links between them"
            raise MechanismError(f"body {child!r}", problem, needed)
    single = [part for part in row if part.kind != "ball"]
    anchors = [part.anchor for part in turning]
    meeting = _meeting(turning) if turning else row[-1].anchor
    point = anchors[0] if meeting is None else meeting
    axes = [part.axis for part in single]
    coordinates = {part.name: k for k, part in enumerate(single)}
    joint: Joint
    match [part.kind for part in row]:
        case ["hinge"]:
            joint = Revolute(name, *ends, point, axis=axes[0], actuated=actuated)
        case ["slide"]:
            joint = Prismatic(name, *ends, point, axis=axes[0], actuated=actuated)
        case ["ball"]:
            joint = Spherical(name, *ends, point, actuated=actuated)
        case ["hinge", "hinge"] if meeting is not None and abs(axes[0] @ axes[1]) < ALIGNED:
            a, b = axes
            joint = Universal(name, *ends, point, axis_on_first=a, axis_on_second=b, actuated=actuated)
        case ["hinge", "hinge"] if np.linalg.norm(np.cross(axes[0], axes[1])) < ALIGNED and meeting is None:
            joint = ParallelHinges(
                name,
                *ends,
                point,
                axis=axes[0],
                offset=anchors[1] - anchors[0],
                opposed=bool(axes[0] @ axes[1] < 0.0),
                actuated=actuated,
            )
        case ["slide", "hinge"] if np.linalg.norm(axes[0] - axes[1]) < ALIGNED:
            joint = Cylindrical(name, *ends, point, axis=axes[0], actuated=actuated)
        case _:
            joint = Compound(
                name,
                *ends,
                point,
                slides=np.array([part.axis for part in row if part.kind == "slide"]),
                hinges=np.array([part.axis for part in row if part.kind == "hinge"]),
                offsets=None if meeting is not None else np.diff(anchors, axis=0),
                ball=any(part.kind == "ball" for part in row),
                actuated=actuated,
            )
    return joint, coordinates


def _meeting(parts: Sequence[Part]) -> Array | None:
    """Find the point that lies on all axes; None if there is none."""
    first = parts[0].anchor
    if all(np.linalg.norm(part.anchor - first) <= MEET for part in parts):
        return first
    across = [np.eye(3) - (part.kind != "ball") * np.outer(part.axis, part.axis) for part in parts]
    lines = [p @ part.anchor for p, part in zip(across, parts, strict=True)]
    point = np.linalg.lstsq(np.vstack(across), np.concatenate(lines), rcond=None)[0]
    missed = max(np.linalg.norm(p @ point - line) for p, line in zip(across, lines, strict=True))
    return None if missed > MEET else np.asarray(point)
