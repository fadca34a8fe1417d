"""Snapshots: commands print and write the text in `tests/snapshots`, which `make snapshots` updates."""

from __future__ import annotations

import pytest
from snapshots import FOLDER, SNAPSHOTS, masked, snapshot

SLOW = ("disagree",)  # 18 s: tests/crosscheck/test_odd_one_out.py has such verdicts of shorter runs


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name for name in SNAPSHOTS]
)
def test_what_commands_show(name):
    assert snapshot(name).splitlines() == (FOLDER / f"{name}.txt").read_text().splitlines(), "make snapshots"


def test_there_is_no_other_snapshot():
    assert {path.stem for path in FOLDER.iterdir()} == set(SNAPSHOTS)


def test_numbers_of_a_processor_are_masked():
    assert (
        masked("rod    1.5e-07  in 43.8 ms\n1 of 12 bodies, 2 s") == "rod  #  in # s\n1 of 12 bodies, # s\n"
    )
