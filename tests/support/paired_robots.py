"""Alignment of two robots by equal names, frames and senses, apart from what a test says."""

from __future__ import annotations

from crosscheck.differences.alignment import Alignment, BodyPair, JointPair
from newton_euler.reading.robot import IN_PLACE, JointKind, Robot


def pairs_by_name(first: Robot, second: Robot, flipped: tuple[str, ...] = ()) -> Alignment:
    """Pair bodies and joints of the same names.

    Args:
        first, second: robots with the same pose in their files; if only one floats, relative to the base.
        flipped: names of joints that count the other way in the second robot.
    """
    one, two = first.placements(), second.placements()
    groups = [_groups(robot) for robot in (first, second)]
    names = [
        {robot.bodies[group[0]].name: group for group in found}
        for robot, found in zip((first, second), groups, strict=True)
    ]
    shared = [(names[0][name], names[1][name]) for name in names[0] if name in names[1]]
    free = [
        any(j.kind is JointKind.FREE for body in robot.bodies for j in body.joints)
        for robot in (first, second)
    ]
    # a fixed base may be at another place than a floating one
    origin = one[shared[0][0][0]] @ two[shared[0][1][0]].inverse() if free[0] != free[1] else IN_PLACE
    bodies = tuple(BodyPair(a, b, one[a[0]].inverse() @ origin @ two[b[0]]) for a, b in shared)
    joints = [
        {joint.name: (b, j) for b, body in enumerate(robot.bodies) for j, joint in enumerate(body.joints)}
        for robot in (first, second)
    ]
    kept = {body for pair in bodies for body in pair.first}, {body for pair in bodies for body in pair.second}
    pairs = []
    for name in joints[0]:
        if name in joints[1]:
            a, b = joints[0][name], joints[1][name]
            sense = -1 if name in flipped else 1
            offset = second.bodies[b[0]].joints[b[1]].zero - sense * first.bodies[a[0]].joints[a[1]].zero
            pairs.append(JointPair(a, b, sense, offset))
    return Alignment(
        bodies,
        tuple(pairs),
        tuple(k for k in range(len(first.bodies)) if k not in kept[0]),
        tuple(k for k in range(len(second.bodies)) if k not in kept[1]),
        tuple(joints[0][name] for name in joints[0] if name not in joints[1]),
        tuple(joints[1][name] for name in joints[1] if name not in joints[0]),
        base="" if free[0] == free[1] else "floating in one, fixed in the other",
    )


def _groups(robot: Robot) -> list[tuple[int, ...]]:
    """Return groups of bodies that are fixed to each other, without the ground."""
    groups: dict[int, list[int]] = {}
    owner: dict[int, int] = {}
    for index, body in enumerate(robot.bodies):
        owner[index] = index if body.joints or body.parent < 0 else owner[body.parent]
        groups.setdefault(owner[index], []).append(index)
    return [tuple(group) for group in groups.values()]
