"""Bodies without mass because their meshes are missing, and large differences as factors."""

from __future__ import annotations

from pathlib import Path

import pytest

import crosscheck
from crosscheck.differences.difference import Quantity
from crosscheck.report.diff import size_text

ARM = """<mujoco><asset><mesh name="m" file="gone.stl"/></asset><worldbody>
<body name="a"><joint name="j" axis="0 1 0"/><inertial pos="0.1 0 0" mass="{a}" diaginertia="0.01 0.02 0.02"/>
<body name="b" pos="0.3 0 0"><joint name="k" axis="0 1 0"/>{b}
<body name="c" pos="0.3 0 0"><joint name="l" axis="0 1 0"/>{c}</body></body></body></worldbody></mujoco>"""
MESH = '<geom type="mesh" mesh="m"/>'


def inertial(mass: float) -> str:
    return f'<inertial pos="0.1 0 0.02" mass="{mass}" diaginertia="0.01 0.02 0.02"/>'


def arm(path: Path, a: float, b: str, c: str) -> str:
    """Write an arm with a mass of its first body, and inertias or meshes of the others."""
    path.write_text(ARM.format(a=a, b=b, c=c))
    return str(path)


@pytest.mark.parametrize("is_first", [True, False])
def test_all_bodies_whose_meshes_are_missing_are_one_row(is_first: bool, tmp_path: Path) -> None:
    files = [
        arm(tmp_path / "lost.xml", 1.0, MESH, MESH),
        arm(tmp_path / "whole.xml", 1.0, inertial(2.0), inertial(3.0)),
    ]
    found = crosscheck.diff(*files) if is_first else crosscheck.diff(*files[::-1])
    (row,) = found.differences
    assert (row.quantity, sorted(row.elements), row.cause) == (
        Quantity.MASS, ["b", "c"], "mesh missing: no mass"
    )  # fmt: skip
    assert (row.first if is_first else row.second) == 0.0
    assert row.effect is not None
    assert row.effect > 0.01


@pytest.mark.parametrize(("mass", "text"), [(8.0, "700 %"), (12.0, "times 12"), (3e7, "times 3e7")])
def test_a_large_difference_is_a_factor(mass: float, text: str, tmp_path: Path) -> None:
    files = [arm(tmp_path / f"{k}.xml", m, inertial(1.0), inertial(1.0)) for k, m in enumerate((1.0, mass))]
    (row,) = crosscheck.diff(*files).differences
    assert size_text(row) == text
