"""The quantities that recordings plot."""

from __future__ import annotations

import numpy as np
from recordings import TILT

from crosscheck.recording.plots import hinge_angle, plots, rotated, slide_position
from newton_euler.model.euler_parameters import from_rotation_vector, product, rotation
from newton_euler.model.joint_kinds import Prismatic, Spherical, Universal
from newton_euler.model.mechanism import Body, Mechanism
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
    hinge = mechanism.joints[1]
    angles = np.linspace(0.0, 15.0, 40)
    spin = np.array([from_rotation_vector(a * np.array([0.0, 1.0, 0.0])) for a in angles])
    spin *= np.where(np.arange(40) % 3 == 0, -1.0, 1.0)[:, None]
    carried = from_rotation_vector(np.array([0.4, 0.5, -0.6]))
    lid = np.array([product(carried, product(p, TILT)) for p in spin])
    run = turning(mechanism, {1: np.tile(carried, (40, 1)), 2: lid})
    found = hinge_angle(mechanism, hinge, hinge.motions[0], run)
    np.testing.assert_allclose(found, angles, atol=1e-12)


def test_both_angles_of_a_universal_joint() -> None:
    x, y = np.eye(3)[:2]
    cardan = Universal("cardan", "ground", "disc", np.zeros(3), axis_on_first=x, axis_on_second=y)
    disc = Body("disc", 1.0, [0.0, 0.0, 0.1], np.eye(3))
    mechanism = Mechanism((Body.ground(), disc), (cardan,))
    a, b = np.linspace(0.0, 2.0, 9), np.linspace(0.0, -1.2, 9)
    turns = [
        product(from_rotation_vector(s * x), from_rotation_vector(t * y)) for s, t in zip(a, b, strict=True)
    ]
    run = turning(mechanism, {1: np.array(turns)})
    for motion_, expected in zip(cardan.motions, (a, b), strict=True):
        found = hinge_angle(mechanism, cardan, motion_, run)
        np.testing.assert_allclose(found, expected, atol=1e-12)
    titles = [p.path for p in plots(Scene("s", mechanism, 0.8, 0.1), {"e": run}, {})][:2]
    assert titles == [("joint_angle", "cardan:0"), ("joint_angle", "cardan:1")]


def test_slide_position_is_seen_from_a_first_body_that_turns() -> None:
    x, z = np.eye(3)[[0, 2]]
    arm = Body("arm", 1.0, [0.0, 0.0, 0.2], np.eye(3), TILT)
    rod = Body("rod", 1.0, [0.3, 0.0, 0.2], np.eye(3))
    joints = (
        Spherical("ball", "ground", "arm", np.zeros(3)),
        Prismatic("slide", "arm", "rod", [0.1, 0.0, 0.2], axis=x),
    )
    mechanism = Mechanism((Body.ground(), arm, rod), joints)
    turn = from_rotation_vector(0.7 * z)
    run = turning(mechanism, {1: product(turn, TILT)[None]})
    run.position[0, 2] = run.position[0, 1] + rotation(turn) @ [0.5, 0.0, 0.0]
    found = slide_position(mechanism, joints[1], joints[1].motions[0], run)
    np.testing.assert_allclose(found, [0.5], atol=1e-15)


def test_rotated_agrees_with_the_rotation_matrix(runs: dict[str, Trajectory]) -> None:
    vector = np.array([0.3, -0.4, 0.5])
    quaternions = runs["zeta"].quaternion[:, 2]
    expected = [rotation(p) @ vector for p in quaternions]
    np.testing.assert_allclose(rotated(quaternions, vector), expected, atol=1e-15)
