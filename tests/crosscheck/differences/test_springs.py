"""Springs and dampers between points of two bodies, in two files of one robot."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import crosscheck
from crosscheck.compare.outcome import Outcome
from crosscheck.differences.difference import Quantity
from crosscheck.differences.dynamics import Dynamics
from crosscheck.differences.joint_tree import size_of
from crosscheck.differences.motion import Likeness
from crosscheck.library import load
from mjcf.robot import describe
from mjcf.write import write
from newton_euler.scalars import Array

ARM = """
<mujoco><worldbody><site name="hook" pos="0.1 0 0.5"/>
  <body name="upper"><joint name="shoulder" axis="0 1 0"/><site name="mid" pos="0.15 0.02 0"/>
    <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass="1"/>
  <body name="fore" pos=".3 0 0"><joint name="elbow" axis="0 1 0"/><site name="tip" pos="0.2 0 0.03"/>
    <geom type="capsule" fromto="0 0 0 .2 0 0" size=".02" mass=".5"/></body></body></worldbody>
<tendon>
  <spatial name="cord" stiffness="120" damping="3" springlength="0.2">
    <site site="hook"/><site site="mid"/></spatial>
  <spatial name="strut" stiffness="40" springlength="0.1 0.15">
    <site site="mid"/><site site="tip"/></spatial>
</tendon></mujoco>"""


def compared(folder: Path, first: str, second: str) -> crosscheck.Diff:
    paths = [folder / "first.xml", folder / "second.xml"]
    for path, text in zip(paths, (first, second), strict=True):
        path.write_text(text)
    return crosscheck.diff(*map(str, paths))


def coordinate_accelerations(text: str, coordinates: Array, velocities: Array) -> Array:
    """Return the accelerations (states, 2) by MuJoCo."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    found = []
    for data.qpos[:], data.qvel[:] in zip(coordinates, velocities, strict=True):
        mujoco.mj_forward(model, data)
        found.append(data.qacc.copy())
    return np.array(found)


def test_springs_move_the_robot_as_in_mujoco() -> None:
    model = mujoco.MjModel.from_xml_string(ARM)
    robot = describe(model)
    assert not robot.notes
    dynamics = Dynamics([robot.robot], size_of(robot.robot))
    random = np.random.default_rng(0)
    coordinates, velocities = random.normal(size=(2, 1, 5, 2))
    points = np.zeros((1, 2, 3))
    found = dynamics.accelerations(coordinates, velocities, np.zeros((1, 5, 0)), np.zeros(5), points)
    # round-off times the condition of the mass matrix
    expected = coordinate_accelerations(ARM, coordinates[0], velocities[0])
    assert found.coordinates[0] == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize(
    ("before", "after", "element", "quantity", "size"),
    [
        ('stiffness="120"', 'stiffness="126"', "cord", Quantity.STIFFNESS, 0.05),
        ('damping="3"', 'damping="4.5"', "cord", Quantity.DAMPING, 0.5),
        ('springlength="0.2"', 'springlength="0.25"', "cord", Quantity.REST, 0.05),
        ('springlength="0.1 0.15"', 'springlength="0.1 0.13"', "strut", Quantity.REST, 0.02),
        ('name="tip" pos="0.2 0 0.03"', 'name="tip" pos="0.2 0 0.05"', "strut", Quantity.SPRING_POINT, 0.02),
    ],
)
def test_a_number_of_a_spring_is_the_only_row(tmp_path, before, after, element, quantity, size):
    changed = ARM.replace(before, after)
    found = compared(tmp_path, ARM, changed)
    (row,) = found.differences
    assert (row.element, row.element_kind, row.quantity) == (element, "spring", quantity)
    assert row.size == pytest.approx(size)
    assert found.motion.likeness is Likeness.DIFFERENT
    assert row.effect == pytest.approx(found.motion.change, rel=1e-9)
    states = np.random.default_rng(1).normal(size=(2, 20, 2))
    one, two = (coordinate_accelerations(text, *states) for text in (ARM, changed))
    assert np.abs(one - two).max() > 1e-3 * np.abs(one).max()


def test_a_spring_in_one_file_only(tmp_path):
    start, end = ARM.index('<spatial name="strut"'), ARM.index("</tendon>")
    for texts in ((ARM, ARM[:start] + ARM[end:]), (ARM[:start] + ARM[end:], ARM)):
        found = compared(tmp_path, *texts)
        (row,) = found.differences
        assert (row.element, row.element_kind, row.quantity) == ("strut", "spring", Quantity.PRESENCE)
        assert row.effect == pytest.approx(found.motion.change, rel=0.5)


def test_the_order_of_sites_is_no_difference(tmp_path):
    turned = ARM.replace('<site site="mid"/><site site="tip"/>', '<site site="tip"/><site site="mid"/>')
    assert turned != ARM
    assert compared(tmp_path, ARM, turned).outcome is Outcome.SAME


def test_springs_of_a_scene_are_those_of_its_mjcf(tmp_path):
    path = tmp_path / "governor.xml"
    write(load("flyball_governor"), path)
    assert mujoco.MjModel.from_xml_path(str(path)).ntendon == 2
    found = crosscheck.diff("flyball_governor", str(path))
    assert len(found.comparison.first.robot.springs) == 2
    assert found.outcome is Outcome.SAME
    assert found.motion.likeness is Likeness.EQUAL
