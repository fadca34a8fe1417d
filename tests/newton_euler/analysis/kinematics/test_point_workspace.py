"""Workspace of a point against closed forms: a two-link arm, the excavator, a panel in space."""

from __future__ import annotations

import numpy as np
import planar_excavator as plane
import pytest

from crosscheck.library import load
from newton_euler import Axis, Body, Mechanism, Point, Revolute, Scene, solve_poses, workspace
from newton_euler.errors import MechanismError, UnknownNameError

FIRST, SECOND = 0.6, 0.4  # m, lengths of the links of an arm


def two_link_arm(normal):
    """A scene of an arm along x whose hinges are along a unit vector perpendicular to x, and its tip."""
    bodies = [
        Body.ground(),
        Body("upper", 1.0, [0.5 * FIRST, 0.0, 0.0], 0.01 * np.eye(3)),
        Body("lower", 1.0, [FIRST + 0.5 * SECOND, 0.0, 0.0], 0.01 * np.eye(3)),
    ]
    joints = [
        Revolute("shoulder", "ground", "upper", [0.0, 0.0, 0.0], axis=normal),
        Revolute("elbow", "upper", "lower", [FIRST, 0.0, 0.0], axis=normal),
    ]
    tip = Point("lower", [FIRST + SECOND, 0.0, 0.0])
    return Scene("arm", Mechanism(bodies, joints), duration=1.0, output_period=0.1), tip


ARM_GRID = {"shoulder": np.linspace(-np.pi, np.pi, 13), "elbow": np.linspace(-np.pi, np.pi, 9)}


def test_an_arm_of_two_links_reaches_an_annulus():
    arm, tip = two_link_arm([0.0, 0.0, 1.0])
    found = workspace(arm, ARM_GRID, point=tip)
    assert found.reachable.all()
    np.testing.assert_array_equal(found.directions, np.eye(3)[:2])
    first, second = np.meshgrid(*ARM_GRID.values(), indexing="ij")
    x = FIRST * np.cos(first) + SECOND * np.cos(first + second)
    y = FIRST * np.sin(first) + SECOND * np.sin(first + second)
    np.testing.assert_allclose(found.position, np.stack([x, y, 0.0 * x], axis=-1), atol=1e-14)
    radius = np.linalg.norm(found.position, axis=-1)
    assert [radius.min(), radius.max()] == pytest.approx([FIRST - SECOND, FIRST + SECOND], rel=1e-14)
    # the Jacobian by hand; the arm is stretched or folded where its smaller singular value is zero
    own = [[-y, -SECOND * np.sin(first + second)], [x, SECOND * np.cos(first + second)]]
    values = np.linalg.svd(np.moveaxis(own, (0, 1), (-2, -1)), compute_uv=False)
    np.testing.assert_allclose(found.conditioning, values[..., 1] / values[..., 0], atol=1e-11)
    assert np.max(found.conditioning[:, [0, 4, 8]]) < 1e-11


def test_an_oblique_plane_has_a_horizontal_and_an_upward_direction():
    arm, tip = two_link_arm([0.0, -0.6, 0.8])
    found = workspace(arm, ARM_GRID, point=tip)
    np.testing.assert_allclose(found.directions, [[1.0, 0.0, 0.0], [0.0, 0.8, 0.6]], atol=1e-12)


def test_the_excavator_reaches_as_far_as_plane_trigonometry():
    scene = load("excavator")
    tip = Point("bucket", scene.forces[0].point)
    ends = ((-0.66, 0.51), (-0.36, 1.06), (-0.51, 0.52))  # m, nearly whole strokes
    grid = {name: np.linspace(*each, 5) for name, each in zip(plane.SLIDES, ends, strict=True)}
    found = workspace(scene, grid, point=tip)
    assert found.reachable.all()
    np.testing.assert_array_equal(found.directions, np.eye(3)[[0, 2]])
    mesh = np.stack(np.meshgrid(*grid.values(), indexing="ij"), axis=-1).reshape(-1, 3)
    expected = np.array([plane.tip(each) for each in mesh])
    np.testing.assert_allclose(found.position.reshape(-1, 3)[:, [0, 2]], expected, atol=1e-11)
    # conditioning: derivatives by complex steps; all coordinates are slides
    steps = [[plane.tip(each + 1j * plane.COMPLEX_STEP * e).imag for e in np.eye(3)] for each in mesh]
    values = np.linalg.svd(np.array(steps) / plane.COMPLEX_STEP, compute_uv=False)
    np.testing.assert_allclose(found.conditioning.ravel(), values[:, 1] / values[:, 0], rtol=1e-9)


def test_a_point_in_space_with_two_freedoms():
    scene = load("tracker")
    corner = Point("panel_7", scene.mechanism.body("panel_7").center_of_mass + np.array([0.1, 0.2, 0.0]))
    sliders = "slide_12", "slide_13"
    grid = {name: np.array([0.0, 0.01, 0.02]) for name in sliders}
    found = workspace(scene, grid, Axis("panel_7", [0.0, 0.0, 1.0]), point=corner)
    np.testing.assert_array_equal(found.directions, np.eye(3))
    # positions 1e-4 m around the middle of the grid
    h = 1e-4
    heights = {"slide_12": 0.01 + h * np.array([1, -1, 0, 0]), "slide_13": 0.01 + h * np.array([0, 0, 1, -1])}
    around = solve_poses(scene, heights).positions(corner)
    values = np.linalg.svd(np.stack([around[0] - around[1], around[2] - around[3]]), compute_uv=False)
    assert found.conditioning[1, 1] == pytest.approx(values[1] / values[0], rel=1e-4)
    np.testing.assert_allclose(found.position[1, 1], around.mean(axis=0), atol=1e-6)


def test_points_that_cannot_be_mapped():
    arm, _ = two_link_arm([0.0, 0.0, 1.0])
    with pytest.raises(MechanismError, match="ground"):
        workspace(arm, ARM_GRID, point=Point("ground", [0.0, 0.0, 0.0]))
    with pytest.raises(UnknownNameError, match="hand"):
        workspace(arm, ARM_GRID, point=Point("hand", [0.0, 0.0, 0.0]))
    with pytest.raises(MechanismError, match="sizes of the mechanism"):
        workspace(arm, ARM_GRID, point=Point("lower", [1e200, 0.0, 0.0]))
    with pytest.raises(MechanismError, match="point of body 'hand'"):
        Point("hand", [0.0, np.nan, 0.0])


@pytest.mark.parametrize("windows", [1, 2])
def test_poses_beyond_flat_four_bar_windows_are_marked(windows):
    """Windows that lie flat may fold as parallelograms or as antiparallelograms, two at once alike."""
    angles = np.linspace(-3.0, 3.0, 9)
    found = workspace(load("four_bar", N=windows), {"pivot_0": angles})
    assert found.reachable.all()
    np.testing.assert_array_equal(found.poses.beyond, np.abs(angles) > 0.5 * np.pi)


@pytest.mark.parametrize(("name", "coordinate"), [("slider_crank", "pivot"), ("andrews", "O")])
def test_no_pose_is_marked_without_a_singular_configuration_of_loops(name, coordinate):
    found = workspace(load(name), {coordinate: np.linspace(-3.0, 3.0, 13)})
    assert found.reachable.all()
    assert not found.poses.beyond.any()


def test_a_goal_in_which_windows_lie_flat_does_not_hide_those_beyond():
    """The bars of a window, of equal lengths, lie flat when the crank has turned by a quarter turn."""
    scene, flat = load("four_bar", N=1), 0.5 * np.pi
    poses = solve_poses(scene, {"pivot_0": [flat, 1.7, 3.0, 4.6, 1.5]})
    assert poses.reached.all()
    assert poses.beyond[1:].tolist() == [True, True, True, False]
    angles = np.linspace(-np.pi, np.pi, 9)  # through both flat poses
    found = workspace(scene, {"pivot_0": angles})
    is_flat = np.abs(np.abs(angles) - flat) < 1e-9
    assert found.reachable.all()
    np.testing.assert_array_equal(found.poses.beyond[~is_flat], np.abs(angles[~is_flat]) > flat)


@pytest.mark.parametrize("flat", [-0.5 * np.pi, 0.5 * np.pi])
def test_poses_in_which_windows_lie_flat_are_reachable_from_both_sides(flat):
    """More velocities leave the loops closed there; those of the path must be among them."""
    for start in (0.0, 0.9 * flat):
        poses = solve_poses(load("four_bar", N=1), {"pivot_0": [start, flat]})
        assert poses.reached.all()
        np.testing.assert_allclose(poses.coordinates["pivot_0"], [start, flat], atol=1e-9)
