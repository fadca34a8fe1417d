"""Matching of the links of two robots by names, masses, kinds of joints and the structure of the trees.

In: two `LinkTree`. Out: for each pair of nodes, the value of a match of all that hangs on them. All measures
are independent of frames, zeros and poses; `pairing.py` adds geometry where frames are known.

The method is dynamic programming from the leaves to the root, as for the constrained edit distance of
unordered trees (K. Zhang, Algorithmica 15, 1996): the children of two matched nodes are assigned to each
other, and a link that only one robot has may be skipped or be replaced by its children.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from crosscheck.differences.element_names import Names
from crosscheck.differences.links import Link, LinkTree
from newton_euler.reading.robot import JointKind

NAME_WEIGHT = 1.0
KIND_WEIGHT = 0.4
MASS_WEIGHT = 0.5
INERTIA_WEIGHT = 0.3
GEOMETRY_WEIGHT = 0.6
SIZE_WEIGHT = 0.2
"""Values that equal names, joints, masses, principal inertias, distances and numbers of links below add."""

PAIR_COST = 0.7
"""Value of a pair that is subtracted, so that links with less in common stay without partner."""

SKIP_COST = 0.05
"""Value that a skipped link costs, so that links are not skipped without need."""

FORCED = 1e4
"""Value of a pair that the user demands, and cost of a pair that contradicts one."""

EXACT = 1e-4
"""Relative difference, or angle in rad, at which a number counts half as equal: above digits of files."""

NEAR = 0.15
"""Relative difference, or angle in rad, at which a number counts half as similar."""


def agreement(difference: float) -> float:
    """Return 1 for equal numbers, about 0.4 for similar ones and 0 for different ones.

    Args:
        difference: relative difference, or angle in rad.
    """
    return 0.6 / (1.0 + (difference / EXACT) ** 2) + 0.4 / (1.0 + (difference / NEAR) ** 2)


FREEDOMS = {JointKind.HINGE: 1, JointKind.SLIDE: 1, JointKind.BALL: 3, JointKind.FREE: 6}
"""Degrees of freedom of a joint."""

LOCATED = (JointKind.HINGE, JointKind.BALL)
"""Joints whose place matters; a slide is the same along each parallel axis."""


class Forest(NamedTuple):
    """Nodes of both trees whose subtrees are assigned to each other.

    Attributes:
        first, second: indices of the links of the first and the second robot.
    """

    first: tuple[int, ...]
    second: tuple[int, ...]


class _Facts(NamedTuple):
    """Numbers and names of a node that do not depend on its frame and on the pose.

    Attributes:
        kinds: kinds of the joints on the path from the parent node.
        mass: kg.
        moments: (3,) principal moments of inertia, in ascending order, kg m^2.
        lengths: distances of the joint's axis to the center of mass, and to the axis before or the center of
            mass of the parent node, m; nan if there is none.
        twist: absolute cosine of the angle between the joint's axis and the axis before; nan without one.
        links: number of nodes below.
        joints: names of the joints on the path.
    """

    kinds: tuple[JointKind, ...]
    mass: float
    moments: tuple[float, ...]
    lengths: tuple[float, ...]
    twist: float
    links: int
    joints: tuple[str, ...]

    @property
    def freedoms(self) -> int:
        """Number of degrees of freedom of the joints on the path."""
        return sum(FREEDOMS[kind] for kind in self.kinds)


class TreeMatch:
    """Values of all pairs of subtrees of two robots.

    Attributes:
        first, second: trees of both robots.
        body_names, joint_names: names of both robots, by words.
        value: of a match of two nodes and all below, by the indices of both links.
        children: forest of the best match below two nodes, by the indices of both links.
    """

    def __init__(self, first: LinkTree, second: LinkTree, forced: Mapping[int, int]) -> None:
        """Match all subtrees of two robots.

        Args:
            first, second: trees of both robots.
            forced: index of the partner of links of the first robot that the user has chosen.
        """
        self.first, self.second = first, second
        self.body_names = Names(_body_names(first), _body_names(second))
        self.joint_names = Names(_joint_names(first), _joint_names(second))
        self._forced, self._taken = forced, {other: link for link, other in forced.items()}
        self._facts = _facts(first), _facts(second)
        self.own: dict[tuple[int, int], float] = {}
        self.value: dict[tuple[int, int], float] = {}
        self.children: dict[tuple[int, int], Forest] = {}
        self._below: dict[tuple[int, int], float] = {}
        self._with_skips: dict[tuple[int, int], float] = {}
        self._skip: dict[tuple[int, int], tuple[int, int]] = {}
        for a in reversed(first.nodes):
            for b in reversed(second.nodes):
                self._match(a, b)

    def subtree(self, a: int, b: int) -> float:
        """Return the value of a match below or at two nodes, with links of one robot skipped above it."""
        return self._with_skips[a, b]

    def matched(self, a: int, b: int) -> tuple[int, int]:
        """Return the two nodes that are matched if the subtrees of two nodes are assigned to each other."""
        while (further := self._skip[a, b]) != (a, b):
            a, b = further
        return a, b

    def _match(self, a: int, b: int) -> None:
        """Compute all values of two nodes from those of the nodes below."""
        branches, others = self.first.branches[a], self.second.branches[b]
        plain = Forest(tuple(branches), tuple(others))
        below, forest = self._assigned(plain), plain
        choices: list[tuple[float, Forest]] = []
        if len(branches) == 1:
            deeper = branches[0], b
            choices.append((self._below[deeper] - SKIP_COST, self.children[deeper]))
        if len(others) == 1:
            deeper = a, others[0]
            choices.append((self._below[deeper] - SKIP_COST, self.children[deeper]))
        if below < 0.5 * max(len(branches), len(others)) or len(branches) != len(others):
            choices.extend(self._replaced(plain))
        for value, choice in choices:
            if value > below:
                below, forest = value, choice
        self._below[a, b], self.children[a, b] = below, forest
        self.own[a, b] = self._likeness(a, b)
        self.value[a, b] = self.own[a, b] + below
        best, skip = self.value[a, b], (a, b)
        for deeper in [(child, b) for child in branches] + [(a, child) for child in others]:
            if self._with_skips[deeper] - SKIP_COST > best:
                best, skip = self._with_skips[deeper] - SKIP_COST, deeper
        self._with_skips[a, b], self._skip[a, b] = best, skip

    def _replaced(self, plain: Forest) -> list[tuple[float, Forest]]:
        """Return forests in which one node is replaced by the branches below it, with their values."""
        found = []
        for node in plain.first if len(plain.first) > 1 or plain.second else ():
            if below := _branches_below(self.first, node):
                forest = Forest(tuple(k for k in plain.first if k != node) + below, plain.second)
                found.append((self._assigned(forest) - SKIP_COST, forest))
        for node in plain.second if len(plain.second) > 1 or plain.first else ():
            if below := _branches_below(self.second, node):
                forest = Forest(plain.first, tuple(k for k in plain.second if k != node) + below)
                found.append((self._assigned(forest) - SKIP_COST, forest))
        return found

    def _assigned(self, forest: Forest) -> float:
        """Return the value of the best assignment of the subtrees of two forests."""
        if len(forest.first) == len(forest.second) == 1:
            return max(0.0, self._with_skips[forest.first[0], forest.second[0]])
        pairs = assignment(forest.first, forest.second, self.subtree)
        return sum(self._with_skips[pair] for pair in pairs)

    def _likeness(self, a: int, b: int) -> float:
        """Return the value of a pair of two nodes alone."""
        if self._forced.get(a, b) != b or self._taken.get(b, a) != a:
            return -FORCED
        if a in self._forced:
            return FORCED
        one, two = self._facts[0][a], self._facts[1][b]
        value = NAME_WEIGHT * self.name_likeness(a, b) - PAIR_COST
        if one.kinds == two.kinds:
            value += KIND_WEIGHT
        elif one.kinds and two.kinds:
            # joints that only one robot has, or a ball instead of hinges, are less unlike than other kinds
            alike = one.kinds[-1] == two.kinds[-1] or one.freedoms == two.freedoms
            value += 0.5 * KIND_WEIGHT if alike else -KIND_WEIGHT
        if one.mass > 0 and two.mass > 0:
            value += MASS_WEIGHT * agreement(abs(math.log(one.mass / two.mass)))
            largest = max(one.moments[2], two.moments[2]) or 1.0
            apart = max(abs(x - y) for x, y in zip(one.moments, two.moments, strict=True))
            value += INERTIA_WEIGHT * agreement(apart / largest)
        elif one.mass == two.mass:
            value += MASS_WEIGHT + INERTIA_WEIGHT
        size = max(self.first.size, self.second.size)
        differences = [abs(x - y) / size for x, y in zip(one.lengths, two.lengths, strict=True)]
        differences.append(abs(one.twist - two.twist))
        parts = [agreement(difference) for difference in differences if not math.isnan(difference)]
        value += GEOMETRY_WEIGHT * (sum(parts) / len(parts) if parts else 0.5)
        return value + SIZE_WEIGHT * (1 + min(one.links, two.links)) / (1 + max(one.links, two.links))

    def name_likeness(self, a: int, b: int) -> float:
        """Return how like the names of two links and of their joints are, from 0 to 1."""
        one, two = self.first.links[a], self.second.links[b]
        joints = self._facts[0][a].joints, self._facts[1][b].joints
        found = []
        if one.names and two.names:
            found.append(self.body_names.best(one.names, two.names))
        if any(joints[0]) and any(joints[1]):
            found.append(self.joint_names.best(*joints))
        return sum(found) / len(found) if found else 0.0


def assignment(
    first: Sequence[int], second: Sequence[int], value: Callable[[int, int], float]
) -> list[tuple[int, int]]:
    """Return pairs of elements with the largest sum of values; elements may stay alone.

    The method is the Hungarian algorithm with potentials (H. W. Kuhn, 1955).

    Args:
        first, second: elements.
        value: value of a pair; pairs without a positive value are not made.
    """
    if len(first) > len(second):
        swapped = assignment(second, first, lambda two, one: value(one, two))
        return sorted((one, two) for two, one in swapped)
    rows, columns = len(first), len(second)
    cost = [[-max(0.0, value(a, b)) for b in second] for a in first]
    row_potential, column_potential = [0.0] * (rows + 1), [0.0] * (columns + 1)
    row_of, before = [0] * (columns + 1), [0] * (columns + 1)
    for row in range(1, rows + 1):
        # shortest augmenting path from the new row to a free column; column 0 stands for the new row
        row_of[0], column = row, 0
        slack, done = [math.inf] * (columns + 1), [False] * (columns + 1)
        while row_of[column]:
            done[column] = True
            current, step, following = row_of[column], math.inf, 0
            for k in range(1, columns + 1):
                if done[k]:
                    continue
                reduced = cost[current - 1][k - 1] - row_potential[current] - column_potential[k]
                if reduced < slack[k]:
                    slack[k], before[k] = reduced, column
                if slack[k] < step:
                    step, following = slack[k], k
            for k in range(columns + 1):
                if done[k]:
                    row_potential[row_of[k]] += step
                    column_potential[k] -= step
                else:
                    slack[k] -= step
            column = following
        while column:
            row_of[column] = row_of[before[column]]
            column = before[column]
    pairs = [(row_of[k] - 1, k - 1) for k in range(1, columns + 1) if row_of[k]]
    return sorted((first[i], second[k]) for i, k in pairs if cost[i][k] < 0)


def _facts(tree: LinkTree) -> dict[int, _Facts]:
    """Collect the numbers and names of all nodes."""
    found: dict[int, _Facts] = {}
    parents = {child: node for node, children in tree.branches.items() for child in children}
    for node in reversed(tree.nodes):
        link = tree.links[node]
        path = tree.path(node, parents[node]) if node in parents else []
        to_center, to_previous, twist = math.nan, math.nan, math.nan
        if path:
            above, first = tree.links[parents[node]], path[0]
            if link.kind in LOCATED and link.mass > 0:
                to_center = distance_from_axis(link, link.center)
            if first.kind in LOCATED and above.kind in LOCATED:
                to_previous = line_distance(above, first)
            elif first.kind in LOCATED and above.mass > 0:
                to_previous = distance_from_axis(first, above.center)
            if above.axis.any() and first.axis.any():
                twist = abs(float(above.axis @ first.axis))
        found[node] = _Facts(
            kinds=tuple(part.joint.kind for part in path if part.joint),
            mass=link.mass,
            moments=tuple(np.linalg.eigvalsh(link.inertia).tolist()),
            lengths=(to_center, to_previous),
            twist=twist,
            links=sum(1 + found[child].links for child in tree.branches[node]),
            joints=tuple(part.joint.name for part in path if part.joint),
        )
    return found


def distance_from_axis(link: Link, point: np.ndarray) -> float:
    """Return the distance of a point from the axis, or from the center, of a link's joint, m."""
    arm = point - link.point
    return float(np.linalg.norm(arm - (arm @ link.axis) * link.axis))


def line_distance(one: Link, two: Link) -> float:
    """Return the distance between the axes, or the centers, of two links' joints, m."""
    arm = two.point - one.point
    normal = _cross(one.axis, two.axis)
    length = float(np.linalg.norm(normal))
    if length > 1e-3:  # rad; otherwise the axes are parallel to the digits of files
        return abs(float(arm @ normal)) / length
    return distance_from_axis(one if one.axis.any() else two, (two if one.axis.any() else one).point)


def _cross(one: np.ndarray, two: np.ndarray) -> np.ndarray:
    """Return the cross product of two vectors; faster than `numpy.cross` for single ones."""
    return np.array(
        [
            one[1] * two[2] - one[2] * two[1],
            one[2] * two[0] - one[0] * two[2],
            one[0] * two[1] - one[1] * two[0],
        ]
    )


def _branches_below(tree: LinkTree, node: int) -> tuple[int, ...]:
    """Return the branches at the first branching at or below a node; nothing if there is none."""
    while len(tree.branches[node]) == 1:
        node = tree.branches[node][0]
    return tuple(tree.branches[node])


def _body_names(tree: LinkTree) -> list[str]:
    return [body.name for body in tree.robot.bodies]


def _joint_names(tree: LinkTree) -> list[str]:
    return [joint.name for body in tree.robot.bodies for joint in body.joints]
