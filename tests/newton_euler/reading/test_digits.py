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
    ],
)
def test_half_units_by_hand(number: str, expected: float) -> None:
    assert half_unit(number) == pytest.approx(expected, rel=1e-12)


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
