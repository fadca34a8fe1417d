"""Bodies with several joints, such as a universal joint, that are moved with all of them: one row.

In: rows of single elements. Out: fewer rows. The row of a hinge has the part of the motion across its axis.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from crosscheck.differences.difference import Difference, Quantity, Standing, numbers
from crosscheck.differences.frames import CommonFrames, JointPlace
from newton_euler.reading.robot import JointKind
from newton_euler.scalars import Array

MAX_REST = 1e-3
"""Part of a motion of several joints by which one of them may be elsewhere."""


def with_moved_bodies(common: CommonFrames, rows: Sequence[Difference]) -> list[Difference]:
    """Return rows in which the origins of all joints of a body that is moved are one row.

    Args:
        common: both robots.
        rows: rows of single elements.
    """
    of_bodies: dict[tuple[int, int], list[JointPlace]] = defaultdict(list)
    for place in common.joints:
        of_bodies[place.pair.first[0], place.pair.second[0]].append(place)
    found = list(rows)
    for places in of_bodies.values():
        names = [common.joint_name(place.pair) for place in places]
        origins = {
            row.element: row
            for row in found
            if row.quantity is Quantity.JOINT_ORIGIN and row.element in names and not row.cause
            if row.standing is Standing.DIFFERENT
        }
        if len(origins) < 2 or any(place.kind is not JointKind.HINGE for place in places):
            continue
        motion = _common_motion(common, places, [origins.get(name) for name in names])
        if motion is not None:
            largest = max(origins.values(), key=lambda row: row.size)
            point = np.array(largest.first)
            row = replace(
                largest,
                first=numbers(point),
                second=numbers(point + motion),
                size=float(np.linalg.norm(motion)),
                elements=tuple(origins),
                cause="the joints are moved together",
            )
            joined = {id(each) for each in origins.values() if each is not largest}
            found = [row if each is largest else each for each in found if id(each) not in joined]
    return found


def _common_motion(
    common: CommonFrames, places: Sequence[JointPlace], rows: Sequence[Difference | None]
) -> Array | None:
    """Return the motion (3,), m, of a body that moves all of its hinges as their rows tell; None without one.

    Args:
        common: both robots.
        places: the hinges.
        rows: the row of the origin of each hinge; None for one that is not moved across its axis.
    """
    across, shifts = [], []
    for place, row in zip(places, rows, strict=True):
        axis = common.lines(place.pair, place.parent)[0].axis[0]
        across.append(np.eye(3) - np.outer(axis, axis))
        shifts.append(np.zeros(3) if row is None else np.array(row.second) - np.array(row.first))
    matrix = np.concatenate(across)
    right = np.concatenate([p @ shift for p, shift in zip(across, shifts, strict=True)])
    motion = np.linalg.lstsq(matrix, right, rcond=1e-9)[0]
    open_rest = sum(row.uncertainty for row in rows if row is not None)
    rest = float(np.linalg.norm(matrix @ motion - right))
    return motion if rest <= open_rest + MAX_REST * float(np.linalg.norm(motion)) else None
