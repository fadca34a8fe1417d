"""Links that follow a pair of links: they tell how links are turned whose own numbers fit several ways.

A link of revolution, and a link without mass between the axes of a universal joint, look the same after half
a turn about their joint. `pairing.py` lets `register` compare what hangs on such links, too.
"""

from __future__ import annotations

from crosscheck.differences.links import Link, LinkTree
from crosscheck.differences.registration import (
    Further,
    Rigid,
    looks_same_after_half_turn,
    register,
    rigid,
)
from crosscheck.differences.tree_match import TreeMatch
from newton_euler.reading.robot import JointKind, Placement


class Followers:
    """Values of the links that follow pairs of links of two robots."""

    def __init__(self, first: LinkTree, second: LinkTree, match: TreeMatch, size: float) -> None:
        """Find the nodes below all links.

        Args:
            first, second: trees of both robots.
            match: values of all pairs of subtrees.
            size: typical length of the robots, m.
        """
        self._first, self._second, self._match, self._size = first, second, match, size
        self._nodes_below = _nodes_below(first), _nodes_below(second)

    def likeness(self, one: Link, two: Link) -> float:
        """Return the value of a match of all that hangs on two links; 0 unless they are partners then."""
        nodes = self._nodes_below[0].get(one.index, 0), self._nodes_below[1].get(two.index, 0)
        return self._match.subtree(*nodes) if all(nodes) and self._match.matched(*nodes) == nodes else 0.0

    def further(self, one: Rigid, two: Rigid) -> Further:
        """Return the value of the links that follow a link and its partner, by the motion between both."""
        choices = [
            [
                (rigid([a], self._first.links, a), rigid([b], self._second.links, b))
                for b in two.branches
                if a.kind == b.kind and self.likeness(a, b) > 0
            ]
            for a in one.branches
            if a.kind is not JointKind.FREE
        ]
        return lambda motion: sum(
            max((self._value(*pair, motion) for pair in pairs), default=0.0) for pairs in choices
        )

    def _value(self, one: Rigid, two: Rigid, above: Placement) -> float:
        """Return the value of a link and its partner, by the motion between their parents."""
        further = self.further(one, two) if is_unclear(one, two, self._size) else None
        return register(one, two, above, self._size, self.likeness, (), further).value


def is_unclear(one: Rigid, two: Rigid, size: float) -> bool:
    """Return whether what follows a link and its partner has to tell how the links are turned.

    Args:
        one, two: the link and its partner.
        size: typical length of the robots, m.
    """
    if not one.mass and not two.mass and len(one.branches) == len(two.branches) == 1:
        return True
    return looks_same_after_half_turn(one, size) and looks_same_after_half_turn(two, size)


def _nodes_below(tree: LinkTree) -> dict[int, int]:
    """Return the node at or below each link that is no branching without a node."""
    found: dict[int, int] = {}
    for link in reversed(tree.links):
        if link.index in tree.branches:
            found[link.index] = link.index
        elif link.children:
            found[link.index] = found[link.children[0]]
    return found
