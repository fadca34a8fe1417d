"""The quantities that recordings plot."""

from __future__ import annotations

import numpy as np
from recordings import TILT

from crosscheck.recording.plots import joint_coordinate, rotated
from newton_euler.model.euler_parameters import from_rotation_vector, product, rotation
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array


def turning(mechanism: Mechanism, quaternions: dict[int, Array]) -> Trajectory:
    """A motion in which some bodies turn, (n, 4) each, and the others stay."""
    n = len(next(iter(quaternions.values())))
    state = State.initial(mechanism)
    quaternion = np.tile(state.quaternion, (n, 1, 1))
    for body, values in quaternions.items():
        quaternion[:, body] = values
    position = np.tile(state.position, (n, 1, 1))
    names = (mechanism.body_names, mechanism.joint_names)
    return Trajectory("made up", {}, 0.0, np.arange(n) * 0.1, *names, position, quaternion)


def test_hinge_angle_counts_whole_turns_and_ignores_signs(scene: Scene) -> None:
    mechanism = scene.mechanism
    angles = np.linspace(0.0, 15.0, 40)
    spin = np.array([from_rotation_vector(a * np.array([0.0, 1.0, 0.0])) for a in angles])
    spin *= np.where(np.arange(40) % 3 == 0, -1.0, 1.0)[:, None]
    carried = from_rotation_vector(np.array([0.4, 0.5, -0.6]))
    lid = np.array([product(carried, product(p, TILT)) for p in spin])
    run = turning(mechanism, {1: np.tile(carried, (40, 1)), 2: lid})
    found = joint_coordinate(mechanism, "hinge", 0, run)
    np.testing.assert_allclose(found, angles, atol=1e-12)


def test_rotated_agrees_with_the_rotation_matrix(runs: dict[str, Trajectory]) -> None:
    vector = np.array([0.3, -0.4, 0.5])
    quaternions = runs["zeta"].quaternion[:, 2]
    expected = [rotation(p) @ vector for p in quaternions]
    np.testing.assert_allclose(rotated(quaternions, vector), expected, atol=1e-15)
