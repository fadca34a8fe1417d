"""Pairs of bodies and joints of two robots that play the same role, and how their frames and zeros differ.

In: two descriptions, `newton_euler.reading.robot.Robot`. Out: an `Alignment`, from which
`crosscheck.differences.rows` compares numbers and `crosscheck.differences.motion` compares motions. The work
is done in `crosscheck.differences.pairing`.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from crosscheck.differences.links import LinkTree
from crosscheck.differences.pairing import Pairing, pair
from crosscheck.support.errors import CrosscheckError
from newton_euler.reading.robot import FileJoint, JointKind, Placement, Robot

JointKey = tuple[int, int]
"""Index of a body in `Robot.bodies`, and index of a joint in `FileBody.joints`."""


class NamesError(CrosscheckError):
    """Pairs of names that the user demands and that two robots cannot have."""


@dataclass(frozen=True, eq=False)
class BodyPair:
    """Rigid bodies of two robots that play the same role.

    Attributes:
        first, second: indices of the bodies in `Robot.bodies`. Bodies that are fixed to each other are one
            rigid body; the first index is that of the body next to the root, whose frame counts. If a joint
            is fixed in one robot only, both of its bodies are in the tuple of the other robot too.
        placement: of the second robot's body frame in the first robot's body frame.
    """

    first: tuple[int, ...]
    second: tuple[int, ...]
    placement: Placement


@dataclass(frozen=True)
class JointPair:
    """Joints of two robots that play the same role.

    Attributes:
        first, second: for each robot, index of the body and index of the joint in `FileBody.joints`.
        sense: 1, or -1 if the joint counts its coordinate the other way in the second robot.
        offset: coordinate in the second robot minus `sense` times the coordinate in the first, rad or m, if
            both are in the same pose.
    """

    first: tuple[int, int]
    second: tuple[int, int]
    sense: int
    offset: float


@dataclass(frozen=True)
class JointGroups:
    """Joints of two robots that connect the same bodies but are of other kinds: a ball and three hinges.

    Attributes:
        first, second: joints of each robot, from the parent outwards, as in `JointPair`.
    """

    first: tuple[JointKey, ...]
    second: tuple[JointKey, ...]


@dataclass(frozen=True)
class LoopPair:
    """Joint of one robot that is a loop of the other robot: the files cut the mechanism at other joints.

    Attributes:
        joint: the joint, as in `JointPair`.
        loop: index in `Robot.loops` of the other robot.
        in_first: True if the joint is in the first robot and the loop in the second one.
    """

    joint: JointKey
    loop: int
    in_first: bool


@dataclass(frozen=True, eq=False)
class Alignment:
    """Correspondence of two robots.

    Attributes:
        bodies: pairs of rigid bodies, parents before children.
        joints: pairs of joints.
        first_bodies, second_bodies: indices of bodies without partner in each robot.
        first_joints, second_joints: joints without partner, as in `JointPair`.
        base: how the roots are held, if that differs, such as "floating in the first, fixed in the second".
        renamed: pairs of other names, first and second, that were found by structure.
        groups: joints that have partners together, not one by one.
        loops: joints of one robot that are loops of the other robot.
    """

    bodies: tuple[BodyPair, ...]
    joints: tuple[JointPair, ...]
    first_bodies: tuple[int, ...] = ()
    second_bodies: tuple[int, ...] = ()
    first_joints: tuple[tuple[int, int], ...] = ()
    second_joints: tuple[tuple[int, int], ...] = ()
    base: str = ""
    renamed: tuple[tuple[str, str], ...] = ()
    groups: tuple[JointGroups, ...] = ()
    loops: tuple[LoopPair, ...] = ()

    def reversed(self) -> Alignment:
        """Return the same correspondence with the second robot as the first."""
        first_base, separator, second_base = self.base.partition(" in the first, ")
        second_base = second_base.removesuffix(" in the second")
        return Alignment(
            tuple(BodyPair(pair.second, pair.first, pair.placement.inverse()) for pair in self.bodies),
            tuple(
                JointPair(pair.second, pair.first, pair.sense, -pair.sense * pair.offset)
                for pair in self.joints
            ),
            self.second_bodies,
            self.first_bodies,
            self.second_joints,
            self.first_joints,
            f"{second_base}{separator}{first_base} in the second" if self.base else "",
            tuple((other, name) for name, other in self.renamed),
            tuple(JointGroups(group.second, group.first) for group in self.groups),
            tuple(replace(pair, in_first=not pair.in_first) for pair in self.loops),
        )


def align(first: Robot, second: Robot, names: Mapping[str, str]) -> Alignment:
    """Find which bodies and joints of two robots play the same role.

    Args:
        first, second: the robots.
        names: names of bodies or joints of the first robot, and those of their partners in the second robot,
            which are paired in any case.

    Raises:
        NamesError: for a name that a robot does not have, or several partners.

    Examples:
        >>> alignment = align(describe("panda.xml").robot, describe("panda.urdf").robot, {})
        >>> alignment.joints[0]
        JointPair(first=(1, 0), second=(1, 0), sense=1, offset=0.0)
    """
    trees = LinkTree(first), LinkTree(second)
    pairing = pair(*trees, *_demanded(trees, names))
    bodies = []
    for links in pairing.links:
        one = sorted(index for k in links.first for index in trees[0].links[k].bodies)
        two = sorted(index for k in links.second for index in trees[1].links[k].bodies)
        if one and two:
            frames = trees[0].frame_of[one[0]], trees[1].frame_of[two[0]]
            placement = frames[0].inverse() @ links.motion @ frames[1]
            bodies.append(BodyPair(tuple(one), tuple(two), placement))
    joints = [
        JointPair(trees[0].key(k.first), trees[1].key(k.second), k.sense, k.offset) for k in pairing.joints
    ]
    groups = [
        JointGroups(tuple(map(trees[0].key, one)), tuple(map(trees[1].key, two)))
        for one, two in pairing.groups
    ]
    loops = _loops(trees, pairing, joints)
    joined = (
        {k.first for k in joints}
        | {key for k in groups for key in k.first}
        | {k.joint for k in loops if k.in_first},
        {k.second for k in joints}
        | {key for k in groups for key in k.second}
        | {k.joint for k in loops if not k.in_first},
    )
    paired = {k for body in bodies for k in body.first}, {k for body in bodies for k in body.second}
    found = Alignment(
        bodies=tuple(bodies),
        joints=tuple(joints),
        first_bodies=tuple(k for k in range(len(first.bodies)) if k not in paired[0]),
        second_bodies=tuple(k for k in range(len(second.bodies)) if k not in paired[1]),
        first_joints=tuple(link.key for link in trees[0].links if link.key and link.key not in joined[0]),
        second_joints=tuple(link.key for link in trees[1].links if link.key and link.key not in joined[1]),
        base=_base(trees, pairing.base),
        groups=tuple(groups),
        loops=tuple(loops),
    )
    return replace(found, renamed=tuple(_renamed(first, second, found, names)))


def _demanded(
    trees: tuple[LinkTree, LinkTree], names: Mapping[str, str]
) -> tuple[dict[int, int], dict[int, int]]:
    """Return the partners that the user demands of links, and of joints, by indices of links."""
    links: dict[int, int] = {}
    joints: dict[int, int] = {}
    for name, other in names.items():
        found = _elements(trees[0], name, "first"), _elements(trees[1], other, "second")
        both = found[0].keys() & found[1].keys()
        if not both:
            kinds = [" and ".join(sorted(k)) for k in found]
            raise NamesError(
                f"names: '{name}' is a {kinds[0]} of the first robot, '{other}' a {kinds[1]} of the second; "
                "needed: two bodies or two joints"
            )
        if "joint" in both:
            joints[found[0]["joint"]] = found[1]["joint"]
        ends = [found[k]["body" if "body" in both else "joint"] for k in (0, 1)]
        if ends[0] in trees[0].branches and ends[1] in trees[1].branches:
            links[ends[0]] = ends[1]
        elif ends[0] and ends[1]:
            joints[ends[0]] = ends[1]
    for found_pairs in (links, joints):
        if len({*found_pairs.values()}) < len(found_pairs):
            others = list(names.values())
            shared = [f"{one!r}: {other!r}" for one, other in names.items() if others.count(other) > 1]
            # bodies and joints of other names may be one link
            pairs = " and ".join(shared or [f"{one!r}: {other!r}" for one, other in names.items()])
            raise NamesError(
                f"names: {pairs} have the same partner in the second robot; needed: one for each"
            )
    return links, joints


def _elements(tree: LinkTree, name: str, which: str) -> dict[str, int]:
    """Return the link of the body, and the link of the joint, with a name; only those that exist."""
    found = {}
    for index, body in enumerate(tree.robot.bodies):
        if body.name == name:
            found["body"] = tree.link_of[index]
    for link in tree.links[1:]:
        if link.joint is not None and link.joint.name == name:
            found["joint"] = link.index
    if not found:
        known = [k.name for k in tree.robot.bodies] + [k.joint.name for k in tree.links if k.joint]
        closest = difflib.get_close_matches(name, sorted({k for k in known if k}), n=5, cutoff=0.0)
        raise NamesError(
            f"names: the {which} robot has no body or joint '{name}'; closest: {', '.join(closest)}"
        )
    return found


def _loops(trees: tuple[LinkTree, LinkTree], pairing: Pairing, joints: Sequence[JointPair]) -> list[LoopPair]:
    """Find joints of one robot that are loops of the other robot between the same bodies."""
    found = []
    taken = {k.first for k in joints}, {k.second for k in joints}
    pairs = (
        {k: number for number, links in enumerate(pairing.links) for k in links.first},
        {k: number for number, links in enumerate(pairing.links) for k in links.second},
    )
    for side, other in ((0, 1), (1, 0)):
        loops: dict[frozenset[int | None], int] = {}
        for number, loop in enumerate(trees[other].robot.loops):
            ends = [trees[other].link_of[k] if k >= 0 else 0 for k in (loop.first, loop.second)]
            loops.setdefault(frozenset(pairs[other].get(k) for k in ends), number)
        for link in trees[side].links[1:]:
            key = frozenset((pairs[side].get(link.index), pairs[side].get(link.parent)))
            if link.key and link.key not in taken[side] and None not in key and key in loops:
                found.append(LoopPair(link.key, loops[key], in_first=side == 0))
    return found


def _base(trees: tuple[LinkTree, LinkTree], roots: tuple[int, int]) -> str:
    """Describe how the roots are held, if that differs."""
    if roots == (0, 0):
        return ""
    held = [
        _held([k.joint for k in tree.path(root, 0) if k.joint])
        for tree, root in zip(trees, roots, strict=True)
    ]
    return f"{held[0]} in the first, {held[1]} in the second"


def _held(joints: Sequence[FileJoint]) -> str:
    """Describe how joints hold a base."""
    if not joints:
        return "fixed"
    if joints[0].kind is JointKind.FREE:
        return "floating"
    return f"held by {', '.join(joint.name for joint in joints)}"


def _renamed(
    first: Robot, second: Robot, alignment: Alignment, names: Mapping[str, str]
) -> Iterable[tuple[str, str]]:
    """Yield the names of pairs of bodies and of joints that have other names in the second robot."""
    found: list[tuple[str, str]] = []
    for bodies in alignment.bodies:
        one, two = (
            [first.bodies[k].name for k in bodies.first],
            [second.bodies[k].name for k in bodies.second],
        )
        if not set(one) & set(two):
            found.append((one[0], two[0]))
    for joints in alignment.joints:
        (body, number), (other, place) = joints.first, joints.second
        found.append((first.bodies[body].joints[number].name, second.bodies[other].joints[place].name))
    for one_name, two_name in dict.fromkeys(found):
        if one_name and two_name and one_name != two_name and names.get(one_name) != two_name:
            yield one_name, two_name
