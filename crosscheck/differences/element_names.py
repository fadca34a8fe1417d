"""Likeness of names of bodies and joints in two model files, by the words that the names consist of.

`FL_hip_joint`, `left_front_hip` and `hip-left-front` have the same words; `panda_joint1` and `joint1` have,
if all names of the first file begin with `panda_`.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable

GENERIC = frozenset({"joint", "jnt", "link", "body", "actuator", "motor", "revolute", "hinge", "the"})
"""Words that say only what kind of element it is."""

SAME_WORDS = {
    "l": "left",
    "r": "right",
    "fl": "left front",
    "lf": "left front",
    "fr": "right front",
    "rf": "right front",
    "rl": "left hind",
    "bl": "left hind",
    "hl": "left hind",
    "lh": "left hind",
    "rr": "right hind",
    "br": "right hind",
    "hr": "right hind",
    "rh": "right hind",
    "f": "front",
    "fore": "front",
    "back": "hind",
    "rear": "hind",
    "aa": "abduction",
    "haa": "hip abduction",
    "hfe": "hip flexion",
    "kfe": "knee",
    "abad": "abduction",
    "abd": "abduction",
    "leftfront": "left front",
    "rightfront": "right front",
    "lefthind": "left hind",
    "righthind": "right hind",
}
"""Words in common use for others, in lower case."""

OPPOSITES = ({"left", "right"}, {"front", "hind"}, {"upper", "lower"})
"""Words of which names of one element cannot have different ones."""

SIDE_WEIGHT = 2.0
"""Weight of words of `OPPOSITES`; others have the weight 1."""

COMMON_FRACTION = 0.7
"""Fraction of the names of a file above which a word, such as the robot's name, distinguishes nothing."""

SIDES = frozenset().union(*OPPOSITES)
"""All words of `OPPOSITES`."""


def words_of(name: str) -> frozenset[str]:
    """Split a name at separators, capitals and digits, and replace words by those in common use."""
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", name)
    found: set[str] = set()
    for word in re.split(r"[^0-9a-z]+", spaced.lower()):
        for part in re.findall(r"[a-z]+(?=\d)|\d+|[a-z]+", word) if len(word) > 2 else [word]:
            found.update(SAME_WORDS.get(part, part.lstrip("0") or "0").split())
    return frozenset(found - GENERIC)


class Names:
    """Names of the elements of one kind in two files, by which elements are compared.

    Attributes:
        words: words of each name that distinguish it from the other names of its file, for each file, and
            their weight.
    """

    def __init__(self, first: Iterable[str], second: Iterable[str]) -> None:
        """Split the names of both files into words."""
        self.words = _distinctive(set(first)), _distinctive(set(second))

    def likeness(self, first: str, second: str) -> float:
        """Return how like two names are: 1 for equal ones, 0 without a common word or for opposite sides."""
        if first == second:
            return 1.0 if first else 0.0
        (one, weight), (two, other_weight) = self.words[0][first], self.words[1][second]
        common = one & two
        if not common:
            return 0.0
        for pair in OPPOSITES if one & SIDES != two & SIDES else ():
            if one & pair and two & pair and one & pair != two & pair:
                return 0.0
        return 0.95 * 2.0 * _weight(common) / (weight + other_weight)

    def best(self, first: Iterable[str], second: Iterable[str]) -> float:
        """Return the largest likeness of a name of the first file to one of the second."""
        others = tuple(second)
        return max((self.likeness(one, two) for one in first for two in others), default=0.0)


def _distinctive(names: set[str]) -> dict[str, tuple[frozenset[str], float]]:
    """Return the words of each name without those that most names of the file have, and their weight."""
    words = {name: words_of(name) for name in names}
    counts = Counter(word for found in words.values() for word in found)
    few = max(3.0, COMMON_FRACTION * len(names))
    common = {word for word, count in counts.items() if count > few}
    return {name: (found - common, _weight(found - common)) for name, found in words.items()}


def _weight(words: Iterable[str]) -> float:
    return sum(SIDE_WEIGHT if word in SIDES else 1.0 for word in words)
