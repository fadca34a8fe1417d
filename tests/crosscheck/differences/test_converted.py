"""A scene and the model file that it is converted to: all that the format can hold is the same.

The files are written by `crosscheck convert`, and described by the readers of `crosscheck diff`, which share
nothing with the description of the scene. What a format cannot hold is listed here by scene.
"""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import pinocchio as pin
import pytest

from crosscheck.differences.difference import Quantity as Q
from crosscheck.differences.difference import Standing
from crosscheck.differences.motion import Likeness
from crosscheck.differences.result import FileComparison, compare_models
from crosscheck.library import SCENES
from crosscheck.loading.convert import scene_report, write_as
from crosscheck.loading.load import load_scene
from urdf.robot import describe

FAST = ("tracker", "pendulum", "four_bar", "bricard", "free_top")

LOST = {
    # a URDF has no springs of joints and between points
    ("stewart", ".urdf"): {("joint", Q.STIFFNESS)},
    ("andrews", ".urdf"): {("spring", Q.PRESENCE)},
    ("flyball_governor", ".urdf"): {("spring", Q.PRESENCE)},
    # prescribed motions, which no file can hold; in an MJCF their joints are held
    ("tracker_on_boat", ".xml"): {("coupling", Q.PRESENCE), ("joint", Q.SETTING)},
    ("tracker_on_boat", ".urdf"): {("joint", Q.SETTING)},
    # controls that depend on time, and wind, become constant motors
    ("tracker_wind", ".xml"): {("drive", Q.GAIN), ("drive", Q.CONSTANT), ("drive", Q.PRESENCE)},
    ("tracker_computed_torque", ".xml"): {("drive", Q.PRESENCE)},
    ("tracker_sun_day", ".xml"): {("drive", Q.PRESENCE)},
    ("tracker_drive", ".xml"): {("drive", Q.GAIN)},
    # the same, and the force on the bucket becomes a motor
    ("excavator", ".xml"): {("drive", Q.GAIN), ("drive", Q.CONSTANT), ("drive", Q.PRESENCE)},
    # the description of a scene has no forces on bodies; the MJCF has a motor
    ("andrews", ".xml"): {("drive", Q.PRESENCE)},
}
"""Kind of element and quantity of the differences, by scene and suffix of the file."""


def converted(name: str, suffix: str, folder: Path) -> FileComparison:
    """Convert a scene and compare it with the file."""
    scene, _ = load_scene(name, {})
    path = folder / f"model{suffix}"
    write_as(scene, path, scene_report(scene))
    options = {"loops": str(path.with_suffix(".loops.yaml"))} if suffix == ".urdf" else {}
    return compare_models((name, path), ({}, options), {}, None, lambda stage: None)


@pytest.mark.parametrize("suffix", [".xml", ".urdf"])
@pytest.mark.parametrize(
    "name", [name if name in FAST else pytest.param(name, marks=pytest.mark.slow) for name in SCENES]
)
def test_a_scene_is_the_same_as_the_file_that_it_is_converted_to(name, suffix, tmp_path):
    found = converted(name, suffix, tmp_path)
    assert {(row.element_kind, row.quantity) for row in found.differences} == LOST.get((name, suffix), set())
    # effects tell which of the numbers move the robot otherwise
    if not any(row.effect for row in found.differences):
        # a top has no joint but that of its base
        assert found.motion.likeness is (Likeness.UNDECIDED if name == "free_top" else Likeness.EQUAL)
    # all numbers are written with all digits, so that nothing is rounded
    assert not found.of_standing(Standing.ROUNDING)


def test_joints_of_a_written_urdf_have_no_limits_for_any_reader(tmp_path):
    """MuJoCo and Pinocchio read the file, with ranges that nothing reaches; ours has no limits."""
    path = tmp_path / "model.urdf"
    scene, _ = load_scene("four_bar", {})
    write_as(scene, path, scene_report(scene))
    model = mujoco.MjModel.from_xml_path(str(path))
    assert model.njnt == 5
    assert (model.jnt_range[:, 1] == 1e300).all()
    assert (model.jnt_actfrcrange[:, 0] == -1e300).all()
    parsed = pin.buildModelFromUrdf(str(path))
    assert (parsed.nq, parsed.nv) == (5, 5)
    assert (parsed.upperPositionLimit == 1e300).all()
    joints = [joint for body in describe(path).robot.bodies for joint in body.joints]
    assert {(*joint.limits, joint.effort[1], joint.speed) for joint in joints} == {
        (-math.inf, math.inf, math.inf, math.inf)
    }


def test_a_large_limit_of_a_stranger_stays_a_limit(tmp_path):
    path = tmp_path / "model.urdf"
    scene, _ = load_scene("pendulum", {})
    write_as(scene, path, scene_report(scene))
    text = path.read_text()
    assert text.count("1e+300") == 4
    path.write_text(text.replace("1e+300", "1000"))
    (joint,) = [joint for body in describe(path).robot.bodies for joint in body.joints]
    assert (joint.limits, joint.effort, joint.speed) == ((-1000.0, 1000.0), (-1000.0, 1000.0), 1000.0)
