"""Angles that files write with few decimals of pi are uncertain by them; other turns of this size are not."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import crosscheck
from crosscheck.compare.outcome import Outcome
from crosscheck.differences.difference import Quantity
from crosscheck.differences.motion import Likeness
from crosscheck.differences.result import FileComparison

ARM = """<robot name="arm"><link name="base"/>
<joint name="lift" type="revolute"><parent link="base"/><child link="upper"/>
<origin xyz="0 0 1" rpy="{turn}"/><axis xyz="0 1 0"/>
<limit lower="{lower}" upper="1.2" effort="10" velocity="3"/></joint>
<link name="upper"><inertial><origin xyz="0.05 0.01 -0.2" rpy="{axes}"/><mass value="{mass}"/>
<inertia ixx="0.021" iyy="0.022" izz="0.013" ixy="0.001" ixz="0.002" iyz="-0.001"/></inertial></link>
<joint name="bend" type="revolute"><parent link="upper"/><child link="fore"/>
<origin xyz="0.01 0.02 -0.4"/><axis xyz="1 0 0"/>
<limit lower="-0.9" upper="0.8" effort="5" velocity="3"/></joint>
<link name="fore"><inertial><origin xyz="0.02 0.03 -0.15"/><mass value="0.7"/>
<inertia ixx="0.011" iyy="0.012" izz="0.003" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""


def compared(folder: Path, first: dict[str, str], second: dict[str, str]) -> FileComparison:
    """Compare two arms whose numbers are as given."""
    paths = []
    for name, values in (("first", first), ("second", second)):
        text = ARM.format(**{"turn": "0.1 0.2 0.3", "lower": "-1.1", "axes": "0 0 0", "mass": "1.2"} | values)
        (folder / f"{name}.urdf").write_text(text, encoding="utf-8")
        paths.append(folder / f"{name}.urdf")
    return crosscheck.diff(*paths).comparison


@pytest.mark.parametrize(
    ("key", "first", "second", "quantity"),
    [
        ("lower", "-1.57", "-1.5708", Quantity.LIMITS),
        ("lower", "-1.57", "-1.571", Quantity.LIMITS),
        ("lower", "-3.14", "-3.142", Quantity.LIMITS),
        ("lower", "-1.57", "-1.57079632679", Quantity.LIMITS),
        ("lower", "-0.523", "-0.524", Quantity.LIMITS),  # cut off, and rounded
        ("turn", "0 0 1.57", "0 0 1.5708", Quantity.JOINT_AXIS),
        ("turn", "0 1.57 0", "0 1.570796327 0", Quantity.ZERO),  # about the axis of the joint
        ("turn", "1.57 0 0", "1.5707963267948966 0 0", Quantity.JOINT_AXIS),
        ("axes", "1.57 0 0", "1.5708 0 0", Quantity.INERTIA),
    ],
)
def test_a_fraction_of_pi_with_few_decimals_is_rounding(tmp_path, key, first, second, quantity):
    found = compared(tmp_path, {key: first}, {key: second})
    assert found.outcome is Outcome.SAME_TO_ROUNDING
    assert {row.quantity for row in found.rows} == {quantity}
    assert found.motion.likeness in (Likeness.EQUAL, Likeness.ROUNDING)


@pytest.mark.parametrize(
    ("key", "first", "second", "quantity", "size"),
    [
        # turns by the distances of 1.57 and 3.14 from pi / 2 and pi, of angles that are no fractions of pi
        ("turn", "0.1 0 0", "0.100796 0 0", Quantity.JOINT_AXIS, 0.000796),
        ("turn", "0.1 0 0", "0.101593 0 0", Quantity.JOINT_AXIS, 0.001593),
        ("turn", "0 1.57 0", "0 1.5749 0", Quantity.ZERO, 0.0049),
        ("lower", "-1.234", "-1.23431", Quantity.LIMITS, 0.00031),
        ("lower", "-1.04", "-1.05", Quantity.LIMITS, 0.01),
        ("mass", "3.14", "3.1416", Quantity.MASS, 0.0016 / 3.14),  # no angle
    ],
)
def test_other_numbers_are_known_to_six_digits(tmp_path, key, first, second, quantity, size):
    [row] = compared(tmp_path, {key: first}, {key: second}).differences
    assert (row.quantity, row.size) == (quantity, pytest.approx(size, rel=1e-4))


def test_the_motion_knows_the_digits_of_pi(tmp_path):
    # MuJoCo's own reading: a roll of 1.57 instead of pi / 2 changes accelerations by more than six digits can
    rolls = {"turn": "1.57 0 0"}, {"turn": "1.5707963267948966 0 0"}
    found = compared(tmp_path, *rolls)
    accelerations = []
    for name in ("first", "second"):
        model = mujoco.MjModel.from_xml_path(str(tmp_path / f"{name}.urdf"))
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        accelerations.append(data.qacc.copy())
    change = np.linalg.norm(accelerations[0] - accelerations[1]) / np.linalg.norm(accelerations[1])
    assert change > 1e-4
    assert found.motion.change > 1e-4
    assert found.motion.likeness is Likeness.ROUNDING


def test_angles_of_an_mjcf(tmp_path):
    text = """<mujoco><compiler angle="radian"/><worldbody><body name="link">
      <joint name="turn" range="-{0} {1}"/>
      <inertial pos="0.1 0 {2}" euler="{0} 0 0" mass="1" diaginertia="0.1 0.12 0.13"/>
      </body></worldbody></mujoco>"""
    paths = [tmp_path / "short.xml", tmp_path / "long.xml"]
    for path, values in zip(paths, (("1.57", "2.36", "0"), ("1.5707963267949", "2.3562", "0")), strict=True):
        path.write_text(text.format(*values), encoding="utf-8")
    assert crosscheck.diff(*paths).outcome is Outcome.SAME_TO_ROUNDING
    paths[0].write_text(text.format("1.57", "2.36", "0.785"), encoding="utf-8")
    paths[1].write_text(text.format("1.57", "2.36", "0.7854"), encoding="utf-8")
    [row] = crosscheck.diff(*paths).differences
    assert row.quantity is Quantity.CENTER
    assert row.size == pytest.approx(0.0004, rel=1e-6)
