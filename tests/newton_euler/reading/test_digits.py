"""Numbers of a text are changed by half a unit of their last digit, and nothing else is."""

from __future__ import annotations

import re

import numpy as np
import pytest

from newton_euler.reading.digits import NumbersOfText, half_unit

TEXT = """<?xml version="1.0"?>
<!-- <body mass="0.123"/> -->
<robot name="1.5">
  <body mass = "0.123" pos='1 -0.0456789012 2.50e-3' note="a > 0.5" file="0.75">0.125</body>
  <pose frame="a">0.25 0 1e-05
  </pose>
</robot>
"""


@pytest.mark.parametrize(
    ("number", "expected"),
    [
        ("0.123", 0.5e-6),  # the sixth significant digit
        ("0.1234567", 0.5e-7),  # the last digit
        ("-12.3456789", 0.5e-7),
        ("1.5e-7", 0.5e-12),
        ("1234567.5", 0.05),
        ("3.14159265358979", 0.5e-14),
        ("0", 0.0),
        ("-0.0", 0.0),
        ("50", 0.0),
        ("2.00", 0.0),
        ("1e3", 0.0),
        ("1e999", 0.0),
    ],
)
def test_half_units_by_hand(number: str, expected: float) -> None:
    assert half_unit(number) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("number", "expected"),
    [
        ("1.57", 7.963268e-4),  # pi / 2 = 1.5707963268
        ("-1.571", 2.036732e-4),
        ("1.5700", 7.963268e-4),
        ("1.5708", 5e-6),  # the sixth digit; the distance is 3.7e-6
        ("3.14", 1.5926536e-3),
        ("3.1415", 9.26536e-5),  # cut off
        ("0.785", 3.981634e-4),
        ("0.523", 5.987756e-4),  # cut off
        ("2.36", 3.8055098e-3),
        ("1.57079632679", 5e-12),
        ("1.6", 5e-6),  # two digits
        ("1.04", 5e-6),  # pi / 3 is 1.047
        ("1.5692", 5e-6),
        ("12.6", 5e-5),  # one decimal
        ("3", 0.0),
    ],
)
def test_short_fractions_of_pi_are_as_uncertain_as_their_distance(number: str, expected: float) -> None:
    assert half_unit(number, is_angle=True) == pytest.approx(expected, rel=1e-6)


def test_only_angles_are_fractions_of_pi() -> None:
    text = '<link mass="3.14" rpy="3.14 0 0"/>'
    numbers = NumbersOfText(text, lambda name: True, is_angle=lambda *names: names == ("link", "rpy"))
    values = re.findall(r"\d\.\d+", numbers.variant(np.random.default_rng(0)))
    # by hand: half a unit of the sixth digit, and pi - 3.14
    assert [abs(float(value) - 3.14) for value in values] == pytest.approx([5e-6, 1.5926536e-3], rel=1e-6)


def test_numbers_change_and_nothing_else() -> None:
    numbers = NumbersOfText(TEXT, lambda name: name not in ("name", "file", "note"), ("pose",))
    random = np.random.default_rng(0)
    variants = [numbers.variant(random) for _ in range(20)]
    # the text, with a group for each number that changes
    pattern = re.escape(TEXT)
    for number in ("0\\.123", "\\-0\\.0456789012", "2\\.50e\\-3", "0\\.25", "1e\\-05"):
        # the first occurrence of 0.123 is in a comment
        before, found, after = pattern.rpartition(number)
        pattern = f"{before}(\\S+?){after}" if found else pattern
    values = np.array([re.fullmatch(pattern, variant).groups() for variant in variants], float)
    written = np.array([0.123, -0.0456789012, 0.0025, 0.25, 1e-5])
    half_units = np.array([0.5e-6, 0.5e-10, 0.5e-8, 0.5e-6, 0.5e-10])
    # doubles of the changed numbers are exact to 1e-17
    assert np.abs(values - written) == pytest.approx(np.tile(half_units, (20, 1)), abs=1e-16)
    assert np.all(np.any(values > written, axis=0))
    assert np.all(np.any(values < written, axis=0))


def test_variants_depend_on_the_seed_only() -> None:
    numbers = NumbersOfText(TEXT, lambda name: name == "mass")
    first, second = (numbers.variant(np.random.default_rng(3)) for _ in range(2))
    assert first == second
