"""Pairs of links and joints of two robots, from the root outwards, with the motions between their frames.

In: two `LinkTree` and the partners that the user demands. Out: a `Pairing`. The trees are matched by
`TreeMatch`, without geometry in a common frame. From the root on, `register` finds where the second robot's
link coincides with its partner, and there the axes and points of joints tell equal branches apart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise

from crosscheck.differences.followers import Followers, is_unclear
from crosscheck.differences.joint_matches import MatchedJoint, joints_in_order, matched_joint
from crosscheck.differences.links import Link, LinkTree, composite
from crosscheck.differences.registration import (
    line_value,
    register,
    rigid,
)
from crosscheck.differences.rigid_motions import principal_rotations
from crosscheck.differences.tree_match import FORCED, TreeMatch, assignment
from newton_euler.reading.robot import IN_PLACE, JointKind, Placement
from newton_euler.scalars import Array

MIN_MOVED_VALUE = 0.4
"""Smallest value of a pair of links that hang on other parents; a half of that of an equal name and joint."""

UNCLEAR = 1.5
"""Difference of values of subtrees below which places of branches decide; sides in names are worth more."""

ADDED_MASS = 1e-3
"""Largest difference, relative to the mass of a link, if it was added to another link's mass."""


@dataclass(eq=False)
class LinkPair:
    """Two rigid links that play the same role.

    Attributes:
        first, second: indices of the links; several if their joints are fixed in the other robot.
        above: pair of the parents; None for the roots, and for links that hang on parents that are no pair.
        heads: links whose joints, which are partners, hold the two links; None if their joints are not.
        motion: takes the second robot's link to the first robot's, both in the pose of the file.
        same_pose: whether the motion of the parents explains the numbers of the links as well.
    """

    first: list[int]
    second: list[int]
    above: LinkPair | None = None
    heads: tuple[Link, Link] | None = None
    motion: Placement = IN_PLACE
    same_pose: bool = True


@dataclass
class Pairing:
    """Links and joints of two robots that play the same roles.

    Attributes:
        links: pairs of links, parents before children.
        joints: pairs of joints.
        groups: joints between two pairs of links that do not correspond one by one, by links' indices.
        base: indices of the links of both robots that are the roots; 0 is the ground.
    """

    links: list[LinkPair] = field(default_factory=list)
    joints: list[MatchedJoint] = field(default_factory=list)
    groups: list[tuple[tuple[int, ...], tuple[int, ...]]] = field(default_factory=list)
    base: tuple[int, int] = (0, 0)


def pair(
    first: LinkTree, second: LinkTree, forced: Mapping[int, int], forced_joints: Mapping[int, int]
) -> Pairing:
    """Pair the links and the joints of two robots.

    Args:
        first, second: trees of both robots.
        forced: index of the partner of each link that the user has chosen.
        forced_joints: index of the link whose joint is the partner of a link's joint, if the user has chosen.
    """
    pairer = _Pairer(first, second, forced, forced_joints)
    if swapped := pairer.swapped():
        pairer = _Pairer(first, second, {**swapped, **forced}, forced_joints)
    return pairer.pairing


class _Pairer:
    """Pairing of two robots while it grows from the root outwards."""

    def __init__(
        self, first: LinkTree, second: LinkTree, forced: Mapping[int, int], forced_joints: Mapping[int, int]
    ) -> None:
        """Pair the roots, all that hangs on them, and then what hangs on another parent."""
        self.first, self.second = first, second
        self.match = TreeMatch(first, second, forced)
        self.size = max(first.size, second.size)
        self._forced_joints = forced_joints
        self.pairing = Pairing()
        self._of_first: dict[int, LinkPair] = {}
        self._of_second: dict[int, LinkPair] = {}
        self._followers = Followers(first, second, self.match, self.size)
        self._grow(*self._root())
        while (moved := self._moved()) is not None:
            self._grow(*moved)
        for links in self.pairing.links:
            if links.heads:
                above = links.above.motion if links.above else links.motion
                own = above if links.same_pose else links.motion
                self.pairing.joints.append(matched_joint(*links.heads, above, own))

    def swapped(self) -> dict[int, int]:
        """Return partners by name of links that follow each other the other way round in the second robot."""
        found: dict[int, int] = {}
        for links in self.pairing.links:
            if links.above is None or links.above.first[0] in found:
                continue
            (a, c), (b, d) = (
                (k[0], m[0])
                for k, m in zip(
                    (links.above.first, links.above.second), (links.first, links.second), strict=True
                )
            )
            likeness = self.match.name_likeness
            nodes = {(a, b), (c, d)} <= self.match.own.keys()
            if nodes and likeness(a, d) == likeness(c, b) == 1.0 > max(likeness(a, b), likeness(c, d)):
                found.update({a: d, c: b})
        return found

    def _root(self) -> tuple[int, int]:
        """Pair the roots: both grounds, or the ground with the base that another joint holds in one robot."""
        choices = [(0, 0)]
        floating = _floating(self.first), _floating(self.second)
        if self.second.links[0].bodies or not floating[1]:
            choices += [
                (k, 0) for k in self.first.branches[0] if k in floating[0] or self.second.links[0].bodies
            ]
        if self.first.links[0].bodies or not floating[0]:
            choices += [
                (0, k) for k in self.second.branches[0] if k in floating[1] or self.first.links[0].bodies
            ]
        root = max(choices, key=lambda pair: (self._root_value(*pair), pair == (0, 0)))
        self.pairing.base = root
        extra = _whole_motions(self.first.below(root[0]), self.second.below(root[1]))
        self._add(LinkPair([root[0]], [root[1]]), extra=extra)
        return root

    def _root_value(self, a: int, b: int) -> float:
        """Return the value of two roots and all below; a base of another mass is a base all the same."""
        own = self.match.own[a, b]
        return self.match.value[a, b] - own + (max(own, 0.01) if abs(own) < FORCED / 2 else own)

    def _add(
        self,
        links: LinkPair,
        pieces: tuple[Sequence[Link], Sequence[Link]] = ((), ()),
        extra: Sequence[Placement] = (),
    ) -> LinkPair:
        """Find the motion of a new pair of links.

        Args:
            links: the pair.
            pieces: links that may be parts of the partner in the other robot.
            extra: motions to try.
        """
        below = self._unmatched_below(links.first[0], links.second[0])
        for side in (0, 1):
            self._fuse(links, side, [*pieces[side], *below[side]])
        self.pairing.links.append(links)
        self._of_first.update(dict.fromkeys(links.first, links))
        self._of_second.update(dict.fromkeys(links.second, links))
        above = links.above.motion if links.above else IN_PLACE
        one, two = links.heads or (None, None)
        ends = (
            rigid([self.first.links[k] for k in links.first], self.first.links, one),
            rigid([self.second.links[k] for k in links.second], self.second.links, two),
        )
        on_ground = links.first[0] == links.second[0] == 0
        is_open = on_ground or is_unclear(*ends, self.size)
        further = self._followers.further(*ends) if is_open else None
        likeness = self._followers.likeness
        found = register(*ends, above, self.size, likeness, extra, further, pose_first=on_ground)
        links.motion, links.same_pose = found.motion, found.same_pose
        return links

    def _unmatched_below(self, a: int, b: int) -> tuple[list[Link], list[Link]]:
        """Return the links of both robots next below two nodes that no links of the other robot match."""
        if (a, b) not in self.match.children:
            return [], []
        pairs = assignment(*self.match.children[a, b], self.match.subtree)
        matched = [self.match.matched(*pair) for pair in pairs]
        found: tuple[list[Link], list[Link]] = ([], [])
        for side, (tree, top) in enumerate(((self.first, a), (self.second, b))):
            ends = {pair[side] for pair in matched}
            links = [tree.links[top]]
            for link in links:
                links += [tree.links[child] for child in link.children if child not in ends]
            found[side].extend(links[1:])
        return found

    def _fuse(self, links: LinkPair, side: int, candidates: Sequence[Link]) -> None:
        """Add links of one robot to a pair if they are parts of the partner in the other robot.

        Args:
            links: the pair.
            side: 0 for links of the first robot, 1 for those of the second.
            candidates: the links, parents first.
        """
        tree, other_tree = (self.first, self.second)[:: -1 if side else 1]
        own, others = (links.first, links.second)[:: -1 if side else 1]
        other_names = {name for k in others for name in other_tree.links[k].names}
        other_mass = sum(other_tree.links[k].mass for k in others)
        free = [link for link in candidates if link.index not in own]
        named = [link for link in free if other_names & set(link.names)]
        # without names, masses tell: the sum of the first links, or of one, is what the partner has more
        mass = sum(tree.links[k].mass for k in own)
        choices = [named] if named else [free[:count] for count in range(len(free), 0, -1)]
        choices += [] if named else [[link] for link in free[1:]]
        for choice in choices:
            added = sum(link.mass for link in choice)
            if named or abs(mass + added - other_mass) < ADDED_MASS * added:
                own.extend(link.index for link in choice)
                own.sort()
                return

    def _grow(self, a: int, b: int) -> None:
        """Pair what hangs on two paired nodes."""
        grown = [(a, b)]
        for one, two in grown:
            forest = self.match.children[one, two]
            free = (
                [k for k in forest.first if k not in self._of_first],
                [k for k in forest.second if k not in self._of_second],
            )
            places = self._place_values(*free, self._of_first[one], one, two)
            for c, d in assignment(*free, partial(self._branch_value, places)):
                nodes = self.match.matched(c, d)
                if nodes[0] in self._of_first or nodes[1] in self._of_second:
                    continue
                self._walk(one, two, *nodes)
                grown.append(nodes)

    def _branch_value(self, places: Mapping[tuple[int, int], float], c: int, d: int) -> float:
        """Return the value of two branches as partners, with that of their places by the pair."""
        return self.match.subtree(c, d) + places.get((c, d), 0.0)

    def _place_values(
        self, first: Sequence[int], second: Sequence[int], above: LinkPair, a: int, b: int
    ) -> dict[tuple[int, int], float]:
        """Return how well branches of two paired nodes fit by their places, for pairs that can be partners.

        Args:
            first, second: nodes of the branches.
            above: pair of the nodes that hold them.
            a, b: the nodes that hold them.
        """
        if len(first) < 2 and len(second) < 2:
            return {}
        found = {}
        for c in first:
            trees = {d: self.match.subtree(c, d) for d in second}
            best = max(trees.values(), default=0.0)
            for d in (d for d, tree in trees.items() if 0 < tree < FORCED / 2):
                # the links next to the paired nodes, on the paths to the branches
                starts = self.first.path(c, a)[0], self.second.path(d, b)[0]
                found[c, d] = line_value(*starts, above.motion, self.size)
                if best - trees[d] < UNCLEAR and starts[0].kind == starts[1].kind:
                    ends = (
                        rigid(starts[:1], self.first.links, starts[0]),
                        rigid(starts[1:], self.second.links, starts[1]),
                    )
                    found[c, d] += register(*ends, above.motion, self.size, self._followers.likeness).value
        return found

    def _walk(self, a: int, b: int, end: int, other_end: int) -> None:
        """Pair the joints and the links on the paths between two paired nodes and two nodes below them.

        Args:
            a, b: paired nodes.
            end, other_end: the nodes below, which become partners.
        """
        paths = self.first.path(end, a), self.second.path(other_end, b)
        joints = joints_in_order(
            *paths, partial(self._joint_value, self._of_first[a].motion), keep_all=not self._forced_joints
        )
        starts = [(-1, -1), *joints, (len(paths[0]), len(paths[1]))]
        current = self._of_first[a]
        for (i, k), (next_i, next_k) in pairwise(starts):
            pieces = paths[0][max(i, 0) : next_i], paths[1][max(k, 0) : next_k]
            if i < 0:
                if all(pieces):
                    self._group(pieces)
                    ends = pieces[0][-1], pieces[1][-1]
                    current = self._add(LinkPair([ends[0].index], [ends[1].index], current))
                continue
            heads = pieces[0][0], pieces[1][0]
            rest = pieces[0][1:], pieces[1][1:]
            if all(rest):
                # another joint or joints of other kinds follow in both robots
                current = self._add(LinkPair([heads[0].index], [heads[1].index], current, heads))
                self._group(rest)
                current = self._add(LinkPair([rest[0][-1].index], [rest[1][-1].index], current))
                continue
            main = self._main_links(pieces, (end, other_end))
            current = self._add(LinkPair([main[0].index], [main[1].index], current, heads), pieces)

    def _group(self, pieces: tuple[Sequence[Link], Sequence[Link]]) -> None:
        """Note joints that do not correspond one by one."""
        self.pairing.groups.append(
            (tuple(link.index for link in pieces[0]), tuple(link.index for link in pieces[1]))
        )

    def _main_links(
        self, pieces: tuple[Sequence[Link], Sequence[Link]], ends: tuple[int, int]
    ) -> tuple[Link, Link]:
        """Return the links of two pieces that have most in common, or the ends of both paths."""
        if pieces[0][-1].index == ends[0] and pieces[1][-1].index == ends[1]:
            return pieces[0][-1], pieces[1][-1]
        values = {
            (one.index, two.index): self.match.own.get((one.index, two.index), -1.0)
            for one in pieces[0]
            for two in pieces[1]
        }
        a, b = max(values, key=lambda key: values[key])
        return self.first.links[a], self.second.links[b]

    def _joint_value(self, motion: Placement, one: Link, two: Link) -> float:
        """Return the value of a pair of joints; not positive if they cannot be partners."""
        demanded = self._forced_joints.get(one.index)
        contradicts = two.index in self._forced_joints.values() if demanded is None else demanded != two.index
        links_contradict = self.match.own.get((one.index, two.index), 0.0) < -FORCED / 2
        if one.kind != two.kind or contradicts or links_contradict:
            return -FORCED
        if demanded is not None:
            return FORCED
        assert one.joint is not None
        assert two.joint is not None
        names = self.match.joint_names.likeness(one.joint.name, two.joint.name)
        return 0.2 + 2.0 * names + line_value(one, two, motion, self.size)

    def _moved(self) -> tuple[int, int] | None:
        """Pair two nodes without partner that are alike but hang on other parents; None if there are none."""
        own = self.match.own
        free = [(a, b) for a, b in own if a and b and a not in self._of_first and b not in self._of_second]
        if not free:
            return None
        a, b = max(free, key=lambda pair: (own[pair], self.match.value[pair], -pair[0], -pair[1]))
        if own[a, b] < MIN_MOVED_VALUE:
            return None
        above = _paired_above(self.first, a, self._of_first)
        other = _paired_above(self.second, b, self._of_second)
        if self._of_first.get(above) is self._of_second.get(other) is not None:
            self._walk(above, other, a, b)
            return a, b
        ends = self.first.links[a], self.second.links[b]
        heads = {k.index for links in self.pairing.links if links.heads for k in links.heads[:1]}
        others = {k.index for links in self.pairing.links if links.heads for k in links.heads[1:]}
        free_joints = a not in heads and b not in others and ends[0].kind == ends[1].kind
        joined = free_joints and not self._closes(*ends)
        parents = self._of_first.get(above, self.pairing.links[0])
        self._add(LinkPair([a], [b], None, ends if joined else None), extra=[parents.motion])
        return a, b

    def _closes(self, one: Link, two: Link) -> bool:
        """Return True if the joint of a link is a loop in the other robot, or the joint of its partner is."""
        for tree, of_own, link, other, of_other in (
            (self.second, self._of_second, two, one, self._of_first),
            (self.first, self._of_first, one, two, self._of_second),
        ):
            parent = of_other.get(other.parent)
            for loop in tree.robot.loops:
                ends = [tree.link_of[k] if k >= 0 else 0 for k in (loop.first, loop.second)]
                for end, far in (ends, ends[::-1]):
                    if end == link.index and parent is not None and of_own.get(far) is parent:
                        return True
        return False


def _whole(links: Sequence[Link]) -> tuple[float, Array, Array]:
    """Return mass, center of mass and inertia of links in the pose of the file."""
    return composite([(link.mass, link.center, link.inertia) for link in links], links[0].point)


def _whole_motions(first: Sequence[Link], second: Sequence[Link]) -> list[Placement]:
    """Return motions that bring the principal axes of two whole robots together, in their files' poses."""
    one, two = _whole(first), _whole(second)
    if not (one[0] > 0 and two[0] > 0):
        return []
    turns = principal_rotations(one[2], two[2])
    return [Placement(one[1] - turn @ two[1], turn) for turn in turns]


def _floating(tree: LinkTree) -> list[int]:
    """Return the links with a free joint."""
    return [link.index for link in tree.links if link.kind is JointKind.FREE]


def _paired_above(tree: LinkTree, index: int, paired: Mapping[int, LinkPair]) -> int:
    """Return the nearest link above a link that has a partner; -1 if there is none."""
    above = tree.links[index].parent
    while above >= 0 and above not in paired:
        above = tree.links[above].parent
    return above
