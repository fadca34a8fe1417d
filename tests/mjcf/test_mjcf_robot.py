"""Described bodies of MJCF files move and weigh as in plain MuJoCo."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from mjcf_models import ELEMENTS
from robot_dynamics import Pose, mass_matrix, pose

from mjcf.robot import describe
from newton_euler.reading.robot import JointKind, Robot

ROOT = Path(__file__).parents[2]
TEXTS = ELEMENTS | {
    "linkage": (ROOT / "examples/linkage.xml").read_text(),
    "tracker": (ROOT / "mjcf/tracker.xml").read_text(),
}
ROUND_OFF = 1e-9
"""Largest error relative to the largest entry: MuJoCo's principal axes are exact to 1e-12, times 1e3."""


def pose_of_data(robot: Robot, model: mujoco.MjModel, qpos: np.ndarray) -> Pose:
    """Place a robot at the coordinates of MuJoCo, whose joints are in the same order."""
    coordinates = {}
    joint = 0
    for number, body in enumerate(robot.bodies):
        for k, described in enumerate(body.joints):
            size = {JointKind.BALL: 4, JointKind.FREE: 7}.get(described.kind, 1)
            start = int(model.jnt_qposadr[joint])
            coordinates[number, k] = qpos[start : start + size]
            joint += 1
    return pose(robot, coordinates)


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS.keys())
def test_bodies_move_as_in_mujoco(text: str, tmp_path: Path) -> None:
    path = tmp_path / "model.xml"
    path.write_text(text)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    robot = describe(path).robot
    random = np.random.default_rng(1)
    for _ in range(3):
        mujoco.mj_integratePos(model, data.qpos, random.normal(size=model.nv), 1.0)
        mujoco.mj_forward(model, data)
        at = pose_of_data(robot, model, data.qpos)
        for number, placed in enumerate(at.placements, start=1):
            assert placed.position == pytest.approx(data.xpos[number], abs=ROUND_OFF)
            assert placed.rotation.ravel() == pytest.approx(data.xmat[number], abs=ROUND_OFF)
        expected = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, expected)
        error = np.max(np.abs(mass_matrix(robot, at) - expected), initial=0.0)
        assert error <= ROUND_OFF * np.max(expected, initial=0.0)
