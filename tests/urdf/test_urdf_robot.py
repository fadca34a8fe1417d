"""Described links of URDF files move and weigh as in plain Pinocchio."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from robot_dynamics import mass_matrix, pose
from urdf_files import CHAIN, TIPS, robot

from urdf.robot import describe

ROOT = Path(__file__).parents[2]
TEXTS = {
    "chain": CHAIN,
    "tips": robot(*TIPS),
    "tracker": (ROOT / "urdf/tracker.urdf").read_text(),
}
ROUND_OFF = 1e-12
"""Largest error relative to the largest entry: both sum the same numbers, in another order."""


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS.keys())
def test_links_move_as_in_pinocchio(text: str, tmp_path: Path) -> None:
    path = tmp_path / "model.urdf"
    path.write_text(text)
    model = pin.buildModelFromXML(text)
    data = model.createData()
    described = describe(path).robot
    random = np.random.default_rng(1)
    for _ in range(3):
        q = pin.integrate(model, pin.neutral(model), random.normal(size=model.nv))
        coordinates = {}
        for number, body in enumerate(described.bodies):
            for k, joint in enumerate(body.joints):
                in_model = model.joints[model.getJointId(joint.name)]
                # a continuous joint has cosine and sine
                x = q[in_model.idx_q : in_model.idx_q + in_model.nq]
                coordinates[number, k] = x if len(x) == 1 else np.array([np.arctan2(x[1], x[0])])
        at = pose(described, coordinates)
        pin.framesForwardKinematics(model, data, q)
        for body, placed in zip(described.bodies, at.placements, strict=True):
            frame = data.oMf[model.getFrameId(body.name, pin.FrameType.BODY)]
            assert placed.position == pytest.approx(frame.translation, abs=ROUND_OFF)
            assert placed.rotation == pytest.approx(frame.rotation, abs=ROUND_OFF)
        columns = [model.joints[model.getJointId(column.name)].idx_v for column in at.columns]
        upper = np.triu(pin.crba(model, data, q))
        expected = (upper + np.triu(upper, 1).T)[np.ix_(columns, columns)]
        assert mass_matrix(described, at) == pytest.approx(expected, abs=ROUND_OFF * np.max(expected))
