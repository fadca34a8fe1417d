"""Keyframes of two files of one robot: they change the run, and not the robot."""

from __future__ import annotations

from pathlib import Path

import mujoco
import pytest

import crosscheck
from crosscheck.compare.outcome import Outcome
from crosscheck.differences.difference import Difference, Quantity, Standing

ARM = """
<mujoco><compiler angle="radian"/><worldbody><body name="upper">
    <joint name="shoulder" axis="0 1 0" range="-1 2" limited="true"/>
    <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass="1"/>
  <body name="fore" pos=".3 0 0"><joint name="rail" type="slide" axis="1 0 0"/>
    <geom type="capsule" fromto="0 0 0 .2 0 0" size=".02" mass=".5"/></body></body></worldbody>
  <keyframe><key name="home" qpos="0.5 0.02" qvel="0.1 0"/><key name="bent" qpos="1 0.1"/></keyframe>
</mujoco>"""


def starts(folder: Path, first: str, second: str) -> list[Difference]:
    """Return the rows about starts; the robots are the same."""
    paths = [folder / "first.xml", folder / "second.xml"]
    for path, text in zip(paths, (first, second), strict=True):
        path.write_text(text)
    found = crosscheck.diff(*map(str, paths))
    assert found.outcome is Outcome.SAME
    quantities = Quantity.START, Quantity.START_SPEED
    rows = [row for row in found.comparison.rows if row.quantity in quantities]
    assert all(row.standing is Standing.CONVENTION for row in rows)
    return rows


def test_equal_keyframes_have_no_row(tmp_path):
    assert not starts(tmp_path, ARM, ARM)


@pytest.mark.parametrize(
    ("before", "after", "quantity", "element", "values", "unit"),
    [
        ('qpos="0.5 0.02"', 'qpos="0.7 0.02"', Quantity.START, "shoulder", (0.5, 0.7), "rad"),
        ('qpos="1 0.1"', 'qpos="1 0.15"', Quantity.START, "rail", (0.1, 0.15), "m"),
        ('qvel="0.1 0"', 'qvel="0.3 0"', Quantity.START_SPEED, "shoulder", (0.1, 0.3), "rad/s"),
    ],
)
def test_another_number_of_a_keyframe_is_named(tmp_path, before, after, quantity, element, values, unit):
    (row,) = starts(tmp_path, ARM, ARM.replace(before, after))
    assert (row.element, row.quantity, row.unit) == (element, quantity, unit)
    assert (row.first, row.second) == pytest.approx(values)


def test_keyframes_without_names_are_paired_by_their_order(tmp_path):
    unnamed = ARM.replace('name="home" ', "").replace('name="bent" ', "")
    assert not starts(tmp_path, unnamed, unnamed)
    (row,) = starts(tmp_path, unnamed, unnamed.replace('qpos="0.5 0.02"', 'qpos="0.7 0.02"'))
    assert (row.element, row.first, row.second) == ("shoulder", 0.5, 0.7)
    assert row.cause.startswith("keyframe 0 ")
    named = '<keyframe><key name="rest" qpos="-0.5 0"/>'
    (row,) = starts(
        tmp_path,
        unnamed,
        unnamed.replace("<keyframe>", named).replace('qpos="1 0.1"', 'qpos="1 0.15"'),
    )
    assert (row.element, row.first, row.second) == ("rail", 0.1, 0.15)
    assert row.cause.startswith("keyframe 1 ")


def test_a_keyframe_in_the_other_sense_is_the_same_pose(tmp_path):
    """The joint counts the other way, and so does its keyframe; MuJoCo puts the bodies to the same place."""
    turned = ARM.replace('axis="0 1 0" range="-1 2"', 'axis="0 -1 0" range="-2 1"')
    turned = turned.replace('qpos="0.5 0.02" qvel="0.1 0"', 'qpos="-0.5 0.02" qvel="-0.1 0"')
    turned = turned.replace('qpos="1 0.1"', 'qpos="-1 0.1"')
    places = []
    for text in (ARM, turned):
        model = mujoco.MjModel.from_xml_string(text)
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 1)
        mujoco.mj_forward(model, data)
        places.append(data.xpos[2].copy())
    assert places[0] == pytest.approx(places[1], abs=1e-15)
    assert not starts(tmp_path, ARM, turned)
    # keyframes as they were are at other places
    wrong = turned.replace('qpos="-1 0.1"', 'qpos="1 0.1"')
    (row,) = starts(tmp_path, ARM, wrong)
    assert (row.first, row.second) == pytest.approx((1.0, -1.0))


def test_digits_of_keyframes_are_rounding(tmp_path):
    assert not starts(tmp_path, ARM.replace("0.02", "0.0212345"), ARM.replace("0.02", "0.02123451"))


def test_a_joint_without_a_name_is_in_no_keyframe(tmp_path):
    text = ARM.replace('name="shoulder" ', "")
    (row,) = starts(tmp_path, text, text.replace('qpos="0.5 0.02"', 'qpos="0.7 0.03"'))
    assert (row.element, row.quantity, row.first, row.second) == ("rail", Quantity.START, 0.02, 0.03)
