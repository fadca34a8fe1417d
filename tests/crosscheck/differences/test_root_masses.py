"""Mass of the root of two URDFs, which do not tell whether the root is fixed or floats."""

from __future__ import annotations

from pathlib import Path

import pytest
from urdf_files import CHAIN, link

import crosscheck
from crosscheck.compare.outcome import Outcome
from crosscheck.differences.difference import Difference, Quantity, Standing
from crosscheck.differences.rows import IF_FLOATING


def compared(
    folder: Path, bases: tuple[str | None, str | None], root: str = "base", more: str = ""
) -> crosscheck.Diff:
    """Compare two files of a chain whose roots have other masses.

    Args:
        folder: for the files.
        bases: option `base` of each file; None without the option.
        root: name of the root link.
        more: elements that only the second file has.
    """
    paths = []
    for mass, added in ((1.0, ""), (2.0, more)):
        text = CHAIN.replace('<link name="base"/>', link("base", mass)).replace(
            "</robot>", f"{added}</robot>"
        )
        paths.append(folder / f"{mass:g}.urdf")
        paths[-1].write_text(text.replace('"base"', f'"{root}"'))
    options = [{} if base is None else {"base": base} for base in bases]
    first, second = map(str, paths)
    return crosscheck.diff(first, second, first_options=options[0], second_options=options[1])


def mass_row(found: crosscheck.Diff) -> Difference:
    """Return the row of the mass of the root."""
    (row,) = (row for row in found.comparison.rows if row.quantity is Quantity.MASS)
    return row


def test_the_mass_of_a_root_that_may_float_is_a_difference_without_effect(tmp_path: Path) -> None:
    found = compared(tmp_path, (None, None))
    row = mass_row(found)
    assert (row.standing, row.effect, row.cause) == (Standing.DIFFERENT, 0.0, IF_FLOATING)
    assert (found.outcome, found.motion.change) == (Outcome.DIFFERENT, 0.0)


@pytest.mark.parametrize(
    ("bases", "root"),
    [
        (("fixed", "fixed"), "base"),
        (("fixed", None), "base"),
        ((None, "fixed"), "base"),
        ((None, None), "world"),
    ],
)
def test_the_mass_of_a_root_that_is_known_to_be_fixed_is_a_convention(
    bases: tuple[str | None, str | None], root: str, tmp_path: Path
) -> None:
    found = compared(tmp_path, bases, root)
    row = mass_row(found)
    assert (row.standing, row.effect) == (Standing.CONVENTION, 0.0)
    assert IF_FLOATING not in row.cause
    assert found.outcome is Outcome.SAME


def test_the_mass_of_a_root_that_floats_changes_the_motion(tmp_path: Path) -> None:
    found = compared(tmp_path, ("free", "free"))
    row = mass_row(found)
    assert row.standing is Standing.DIFFERENT
    assert IF_FLOATING not in row.cause
    assert found.motion.change > 0.01
    assert row.effect == pytest.approx(found.motion.change, rel=1e-9)


@pytest.mark.parametrize("base", [None, "fixed"])
def test_a_part_of_the_root_that_one_file_has(base: str | None, tmp_path: Path) -> None:
    plate = f'{link("plate")}<joint name="p" type="fixed"><parent link="base"/><child link="plate"/></joint>'
    found = compared(tmp_path, (base, base), more=plate)
    assert all(IF_FLOATING in row.cause for row in found.differences)
    assert (found.outcome is Outcome.SAME) == (base == "fixed")
