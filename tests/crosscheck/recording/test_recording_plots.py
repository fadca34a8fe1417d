"""The quantities that recordings plot."""

from __future__ import annotations

import numpy as np

from crosscheck.recording.plots import rotated
from newton_euler.model.euler_parameters import rotation
from newton_euler.model.trajectory import Trajectory


def test_rotated_agrees_with_the_rotation_matrix(runs: dict[str, Trajectory]) -> None:
    vector = np.array([0.3, -0.4, 0.5])
    quaternions = runs["zeta"].quaternion[:, 2]
    expected = [rotation(p) @ vector for p in quaternions]
    np.testing.assert_allclose(rotated(quaternions, vector), expected, atol=1e-15)
