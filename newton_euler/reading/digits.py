"""Change the numbers in the XML text of a model file within the rounding of their digits.

A number in a file is known to half a unit of its last digit. `NumbersOfText` finds all numbers in attributes,
and writes variants of the text in which each number has moved by this half unit, up or down at random. A
reader of the format makes a robot of each variant. The spread of any quantity over the robots is the
uncertainty of the quantity.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Container, Iterator

import numpy as np

VARIANTS = 16
"""Number of variants of a file; the largest of 16 random sums is close to the bound of the sum."""

SIGNIFICANT_DIGITS = 6
"""Digits after which a number counts as rounded even if it ends earlier, as in files that tools write.

`mass="0.1"` means a tenth of a kilogram, not any mass from 0.05 to 0.15 kg. Tools write six digits."""

# fmt: off
TAG = re.compile(
    r"<!--.*?-->|<!\[CDATA\[.*?\]\]>|<\?.*?\?>"  # comment, text, instruction
    r"""|<([\w:.-]+)((?>[^<>"']+|"[^"]*"|'[^']*')*)>""",  # start of an element, with its attributes
    re.DOTALL,
)
# fmt: on
"""Pattern of the start of an element in well-formed XML: its tag, None of comments, and its attributes."""

ATTRIBUTE = re.compile(r"""([\w:.-]+)\s*=\s*(?:"([^"]*)"|'([^']*)')""")
"""Pattern of an attribute: its name, and its value between quotation marks of either kind."""

TOKEN = re.compile(r"\S+")
"""Pattern of a word or number in the value of an attribute."""

NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
"""Pattern of a finite number."""


FRACTIONS_OF_PI = math.pi / 12 * np.union1d(np.arange(2, 49, 2), np.arange(3, 49, 3))
"""rad, angles that files write with few decimals: multiples of 30 and 45 degrees up to two revolutions."""


def half_unit(number: str, is_angle: bool = False) -> float:
    """Return half a unit of the last digit of a number, at most of its sixth significant digit.

    Zeros, whole numbers and numbers beyond the largest double are exact, and have 0. A fraction or multiple
    of pi that is written with few decimals, such as 1.57, has its distance from the exact one.

    Args:
        number: text of the number.
        is_angle: whether the number is an angle, which can be a fraction of pi.

    Examples:
        >>> half_unit("0.123"), half_unit("0.12345678"), half_unit("50")
        (5e-07, 5e-09, 0.0)
        >>> half_unit("1.57"), round(half_unit("1.57", is_angle=True), 7)
        (5e-06, 0.0007963)
    """
    value = float(number)
    if value.is_integer() or math.isinf(value):
        return 0.0
    mantissa, _, exponent = number.lower().partition("e")
    decimals = mantissa.partition(".")[2]
    last_digit = int(exponent or 0) - len(decimals)
    last_significant_digit = math.floor(math.log10(abs(value))) - SIGNIFICANT_DIGITS + 1
    half = 0.5 * 10.0 ** min(last_digit, last_significant_digit)
    if is_angle and not exponent:
        half = max(half, _error_of_short_pi(abs(value), len(decimals.rstrip("0"))))
    return half


def _error_of_short_pi(angle: float, decimals: int) -> float:
    """Return the distance, rad, of an angle from the fraction of pi that it abbreviates; 0.0 for others.

    The fraction is rounded to at least two decimals and three digits, or cut off after at least three.
    """
    unit = 10.0**-decimals
    exact = float(FRACTIONS_OF_PI[np.abs(FRACTIONS_OF_PI - angle).argmin()])
    is_rounded = abs(exact - angle) <= 0.5 * unit
    is_cut = 0.0 < exact - angle < unit and decimals >= 3
    return abs(exact - angle) if decimals >= 2 and angle >= 100.0 * unit and (is_rounded or is_cut) else 0.0


class NumbersOfText:
    """Numbers in an XML text, which it changes within the rounding of their digits."""

    def __init__(
        self,
        text: str,
        is_number: Callable[[str], bool],
        number_tags: Container[str] = (),
        is_angle: Callable[[str, str], bool] = lambda tag, attribute: False,
    ) -> None:
        """Find the numbers of a well-formed text.

        Args:
            text: content of the file.
            is_number: returns False for attributes that hold no numbers, such as names.
            number_tags: tags of elements that hold numbers between their start and their end.
            is_angle: returns True for the tag and the name of an attribute that holds angles.
        """
        # text before each number and after the last one; value and half unit of each number
        self._between: list[str] = []
        values: list[float] = []
        half_units: list[float] = []
        end = 0  # position up to which the text is stored
        for start, stop, has_angles in _values(text, is_number, number_tags, is_angle):
            for token in TOKEN.finditer(text, start, stop):
                if NUMBER.fullmatch(token[0]) and (half := half_unit(token[0], has_angles)):
                    self._between.append(text[end : token.start()])
                    values.append(float(token[0]))
                    half_units.append(half)
                    end = token.end()
        self._between.append(text[end:])
        self._values, self._half_units = np.array(values), np.array(half_units)

    def variant(self, random: np.random.Generator) -> str:
        """Return the text with each number changed by plus or minus its half unit; the signs are random."""
        signs = random.choice((-1.0, 1.0), len(self._values))
        numbers = map(repr, (self._values + signs * self._half_units).tolist())
        parts = [self._between[0]]
        for number, after in zip(numbers, self._between[1:], strict=True):
            parts += number, after
        return "".join(parts)


def _values(
    text: str,
    is_number: Callable[[str], bool],
    number_tags: Container[str],
    is_angle: Callable[[str, str], bool],
) -> Iterator[tuple[int, int, bool]]:
    """Yield start and end of each text that can hold numbers, and whether they are angles.

    For the arguments see `NumbersOfText`.
    """
    for tag in TAG.finditer(text):
        if tag[1] is None:
            continue
        for attribute in ATTRIBUTE.finditer(text, tag.start(2), tag.end(2)):
            if is_number(attribute[1]):
                span = attribute.span(2 if attribute[2] is not None else 3)
                yield *span, is_angle(tag[1], attribute[1])
        if tag[1] in number_tags:
            yield tag.end(), text.find("<", tag.end()), False
