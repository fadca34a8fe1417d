"""Numbers with units: no exponent where a number rounds up to the next unit."""

from __future__ import annotations

import re

import numpy as np
import pytest

from crosscheck.own_run.allowed import length
from crosscheck.report.table import seconds
from crosscheck.studies.benchmark.timing import time_text
from crosscheck.support.units import TIME_UNITS, quantity_text, significant


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.9994, "999 ms"),
        (0.9996, "1 s"),
        (999.6e-6, "1 ms"),
        (999.4e-6, "999 us"),
        (999.6e-9, "1 us"),
        (1e-3, "1 ms"),
        (59.96, "60 s"),
        (1234.0, "1230 s"),
        (3e-12, "0.003 ns"),
    ],
)
def test_three_digits(value, text):
    assert quantity_text(value, TIME_UNITS) == time_text(value) == text


@pytest.mark.parametrize(
    ("value", "text"), [(0.0994, "99 ms"), (0.0996, "0.1 s"), (0.234, "0.23 s"), (9.96e-5, "0.1 ms")]
)
def test_two_digits(value, text):
    assert quantity_text(value, TIME_UNITS, digits=2) == text


def test_numbers_from_picometers_to_kilometers_have_no_exponent():
    # 400 values a factor of ten: 0.9995 and 0.9999 of each unit are among them
    for value in 10.0 ** np.arange(-12.0, 4.0, 1.0 / 400.0):
        for text, digits in ((length(value), 3), (length(value, 5), 5), (seconds(value), 3)):
            number, unit = text.split()
            if unit != "ms" or value > 1e-7:
                assert re.fullmatch(r"[0-9.]+", number), text
            size = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "nm": 1e-9, "pm": 1e-12, "s": 1.0, "ms": 1e-3}[unit]
            # half of the last of the digits; 1.01 for round-off
            assert float(number) * size == pytest.approx(value, rel=1.01 * 0.5 * 10.0 ** (1 - digits))


def test_exponents_begin_at_a_million():
    assert [significant(value) for value in (999.6, 999_600.0, 2.5e7)] == ["1000", "1e+06", "2.5e+07"]
