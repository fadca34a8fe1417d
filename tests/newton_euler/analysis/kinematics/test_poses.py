"""Forward and inverse kinematics against closed forms, finite differences and each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from finite_difference import derivative
from mechanisms import planar_four_bar, slider_tree
from scipy.ndimage import label

from crosscheck.library import load
from crosscheck.library.slider_crank import PIN, PIVOT, WRIST
from newton_euler import (
    Axis,
    Body,
    Mechanism,
    PrescribedMotion,
    Scene,
    Screw,
    Sine,
    solve_poses,
)
from newton_euler.analysis.kinematics.continuation import follow
from newton_euler.analysis.kinematics.poses import STATIONARY_SLOPE, goals_of
from newton_euler.errors import MechanismError, NewtonEulerError, OptionError, UnknownNameError
from newton_euler.model.euler_parameters import rotations

SLIDERS = "slide_12", "slide_13"

NORMAL = Axis("panel_7", [0.0, 0.0, 1.0])

CRANK, ROD = float(np.linalg.norm(PIN - PIVOT)), float(np.linalg.norm(WRIST - PIN))


def grid(low: float, high: float, count: int) -> dict[str, np.ndarray]:
    """Heights of both sliders, m."""
    heights = np.linspace(low, high, count)
    return dict(zip(SLIDERS, (x.ravel() for x in np.meshgrid(heights, heights)), strict=True))


def guide(angle):
    """Position of the slider-crank's slider from its initial one, m, in closed form."""
    pin = PIVOT[:, None] + CRANK * np.array([0.0 * angle, -np.sin(angle), np.cos(angle)])
    return np.sqrt(ROD**2 - pin[1] ** 2 - pin[2] ** 2) - WRIST[0]


def test_inverse_after_forward_kinematics_is_where_it_began():
    """2,500 poses, none of which is next to a singular one, so that round-off is all there is."""
    scene, heights = load("tracker"), grid(0.005, 0.08, 50)
    forward = solve_poses(scene, heights, NORMAL)
    assert forward.reached.all()
    normal = rotations(forward.quaternion[:, 6])[:, :, 2]
    np.testing.assert_allclose(forward.direction, normal, rtol=0.0, atol=1e-15)
    inverse = solve_poses(scene, axis=NORMAL, towards=forward.direction, measure=SLIDERS)
    assert inverse.reached.all()
    for name in SLIDERS:
        np.testing.assert_allclose(inverse.coordinates[name], heights[name], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(inverse.position, forward.position, rtol=0.0, atol=1e-12)
    least = [np.min(forward.independence(SLIDERS)), np.min(inverse.independence([NORMAL]))]
    assert min(least) > 0.1


def test_all_joints_are_closed_and_measured_as_by_the_scene():
    scene = load("tracker")
    poses = solve_poses(scene, grid(0.0, 0.06, 4), NORMAL, measure=("hinge_14", ("universal_47", 1)))
    for k in range(len(poses)):
        frames = poses.state(k).frames()
        scene.mechanism.check_closed(frames, "in a solved pose")
        for joint, number, name in (
            ("slide_12", 0, "slide_12"),
            ("hinge_14", 0, "hinge_14"),
            ("universal_47", 1, ("universal_47", 1)),
        ):
            equations = scene.mechanism.joint_equations(joint)
            measured = equations.coordinates[number].phi(frames[equations.first], frames[equations.second])
            assert poses.coordinates[name][k] == pytest.approx(measured[0], abs=1e-13)


def test_slider_crank_agrees_with_its_closed_form():
    angles = np.linspace(-3.1, 3.1, 200)
    poses = solve_poses(load("slider_crank"), {"pivot": angles}, measure=["guide"])
    assert poses.reached.all()
    np.testing.assert_allclose(poses.coordinates["guide"], guide(angles), rtol=0.0, atol=1e-14)
    step = 1e-5  # its square is the error of the differences
    slope = (guide(angles + step) - guide(angles - step)) / (2.0 * step)
    np.testing.assert_allclose(poses.jacobian(["guide"], ["pivot"])[:, 0, 0], slope, rtol=0.0, atol=1e-9)


def test_four_bar_with_redundant_rows_agrees_with_its_closed_form():
    """The rocker's angle from the crossing of two circles, on the side of the initial pose."""
    angles = np.linspace(-np.pi, np.pi, 101)
    poses = solve_poses(planar_four_bar(), {"at_a": angles}, measure=["at_d"])
    assert poses.reached.all()
    first = np.arctan2(0.1, 0.4) + angles
    pin = np.hypot(0.1, 0.4) * np.array([np.sin(first), np.cos(first)])
    reach = np.array([1.0, 0.0])[:, None] - pin
    distance, coupler, rocker = np.hypot(*reach), np.hypot(0.8, 0.3), np.hypot(0.1, 0.7)
    along = (distance**2 + coupler**2 - rocker**2) / (2.0 * distance)
    up = np.sqrt(coupler**2 - along**2)
    joint = pin + (along * reach + up * np.array([-reach[1], reach[0]])) / distance
    rocker_angle = np.arctan2(joint[0] - 1.0, joint[1]) - np.arctan2(-0.1, 0.7)
    off = np.remainder(poses.coordinates["at_d"] - rocker_angle + np.pi, 2.0 * np.pi) - np.pi
    np.testing.assert_allclose(off, 0.0, atol=1e-13)


@pytest.mark.parametrize("gap", [0.03, 0.003, -0.003])
def test_linkages_that_are_almost_parallelograms_stay_on_their_branch(gap):
    """Crank and rocker of 1, coupler of 2, feet 2 + gap apart: in line, the true branch turns back sharply.

    The rocker's angle is that of the crossing of two circles on the side of the initial pose. A pose of the
    other branch is near; a stride used to jump there.
    """
    ground, first = 2.0 + gap, 1.0  # angle of the crank at the initial pose

    def wrist(crank):
        """Points (n, 2) in x and z at which coupler and rocker meet."""
        pin = np.stack([np.cos(crank), np.sin(crank)], axis=1)
        reach = np.array([ground, 0.0]) - pin
        distance = np.linalg.norm(reach, axis=1, keepdims=True)
        along = (distance**2 + 2.0**2 - 1.0) / (2.0 * distance)
        up = np.sqrt(2.0**2 - along**2)
        return pin + (along * reach + up * np.stack([-reach[:, 1], reach[:, 0]], axis=1)) / distance

    (end,) = wrist(np.array([first]))
    scene = planar_four_bar((np.cos(first), np.sin(first)), tuple(end), ground)
    angles = np.linspace(-3.1, 3.1, 63)  # rotations about y turn z towards x
    crank = first - angles
    poses = solve_poses(scene, {"at_a": angles}, measure=["at_d"])
    distance = np.sqrt(1.0 + ground**2 - 2.0 * ground * np.cos(crank))
    possible = (distance < 3.0) & (distance > 1.0)
    assert np.array_equal(poses.reached, possible)
    points = wrist(crank[possible]) - [ground, 0.0]
    expected = np.arctan2(end[1], end[0] - ground) - np.arctan2(points[:, 1], points[:, 0])
    off = np.remainder(poses.coordinates["at_d"][possible] - expected + np.pi, 2.0 * np.pi) - np.pi
    np.testing.assert_allclose(off, 0.0, atol=1e-9)


def test_jacobians_agree_with_differences_and_invert_each_other():
    scene, heights = load("tracker"), grid(0.01, 0.06, 5)
    poses = solve_poses(scene, heights, NORMAL)
    jacobian = poses.jacobian([NORMAL], SLIDERS)
    for k, name in enumerate(SLIDERS):

        def direction(change, name=name):
            return solve_poses(scene, heights | {name: heights[name] + change}, NORMAL).direction

        # per m: rounding of the directions over a step of 0.1 mm
        np.testing.assert_allclose(jacobian[:, :, k], derivative(direction, 1e-4), rtol=0.0, atol=1e-10)
    product = poses.jacobian(SLIDERS, [NORMAL]) @ jacobian
    np.testing.assert_allclose(product, np.tile(np.eye(2), (25, 1, 1)), rtol=0.0, atol=1e-11)


def test_joint_out_of_reach_goes_to_its_dead_center():
    goals = np.array([-0.1, 0.0, 0.05, 0.0901, 0.2, 5.0])
    poses = solve_poses(load("slider_crank"), {"guide": goals})
    assert poses.reached.tolist() == [False, True, True, True, False, False]
    center = np.hypot(*PIVOT[1:])
    near, far = (np.sqrt(ROD**2 - (center + sign * CRANK) ** 2) - WRIST[0] for sign in (1.0, -1.0))
    expected = np.clip(goals, near, far)
    np.testing.assert_allclose(poses.coordinates["guide"], expected, rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(poses.missing["guide"], expected - goals, rtol=0.0, atol=1e-14)
    assert np.max(poses.slope) < STATIONARY_SLOPE
    assert poses.closed.all()
    assert not poses.beyond.any()
    assert [line.split(",")[0] for line in poses.report()] == [f"pose {k}: out of reach" for k in (0, 4, 5)]
    assert f"'guide' by {near + 0.1:.6g}" in poses.report()[0]


def test_goals_farther_than_steps_go_come_to_an_end():
    poses = solve_poses(load("free_top"), {("floating", 0): [0.1, 1e5]})
    assert poses.reached.tolist() == [True, False]
    assert np.isfinite(poses.position).all()
    assert "nearest pose not found" in poses.report()[0]


@pytest.mark.slow
def test_direction_out_of_reach_has_the_smallest_angle():
    """Compared with all poses of a grid, none of which is nearer."""
    scene = load("tracker")
    reachable = solve_poses(scene, grid(-0.1, 0.2, 60), NORMAL)
    azimuth = np.radians(np.arange(0.0, 360.0, 30.0))
    down = np.stack([np.cos(azimuth), np.sin(azimuth), np.full(12, -3.0)], axis=1)
    poses = solve_poses(scene, axis=NORMAL, towards=down)
    assert tuple(poses.coordinates) == SLIDERS  # those of the control laws, as no others are asked for
    assert not poses.reached.any()
    assert np.max(poses.slope) < STATIONARY_SLOPE
    assert poses.closed.all()
    cosines = (down / np.linalg.norm(down, axis=1, keepdims=True)) @ reachable.direction[reachable.reached].T
    least = np.arccos(np.max(cosines, axis=1))
    assert np.all(poses.angle < least)
    near = ~poses.beyond
    assert np.sum(near) >= 4
    assert np.all(poses.angle[near] > least[near] - 1e-3)  # of the grid's spacing of 5 mm
    assert "beyond a singular configuration" in poses.report()[np.flatnonzero(poses.beyond)[0]]


def test_directions_that_only_a_jump_reaches_are_not_reached():
    """Compared with the directions of a grid that is connected without singular configurations.

    Both determinants keep their signs there: of the sliders, and of the panel's normal. Strides of a quarter
    of a radian used to jump past two singular configurations at once.
    """
    scene = load("tracker")
    heights = np.arange(-0.16, 0.32, 0.012)
    mesh = np.meshgrid(heights, heights, indexing="ij")
    chain, _, goal = goals_of(
        scene, dict(zip(SLIDERS, map(np.ravel, mesh), strict=True)), NORMAL, None, (), None
    )
    begin = chain.at(chain.start[None])
    configs, reached, _ = follow(begin, goal)

    def determinants(configs):
        """Of the loops with the sliders, and with rotations about two axes across the normal."""
        across = np.cross(configs.direction, [1.0, 0.0, 0.0])
        across = np.stack([across, np.cross(configs.direction, across)], axis=1)
        loops = configs.jacobian[:, chain.independent]
        return np.array(
            [
                np.linalg.det(np.concatenate([loops, rows], axis=1))
                for rows in (configs.coordinate_jacobian, across @ configs.axis_jacobian)
            ]
        )

    same_sign = np.all(determinants(configs) * determinants(begin) > 0.0, axis=0)
    regions, _ = label((reached & same_sign).reshape(mesh[0].shape))
    start = np.argmin(np.abs(heights))
    directions = configs.direction[(regions == regions[start, start]).ravel()]
    goals = np.random.default_rng(1).normal(size=(50, 3))
    goals /= np.linalg.norm(goals, axis=1, keepdims=True)
    poses = solve_poses(scene, axis=NORMAL, towards=goals, measure=SLIDERS)
    angle = np.arccos(np.clip(np.max(goals @ directions.T, axis=1), -1.0, 1.0))
    step = 0.2  # rad between the grid's directions at the edges of the region, where the normal turns fast
    assert np.max(angle[poses.reached]) < step
    assert poses.reached[angle < 0.02].all()
    assert np.sum(poses.reached) > 8
    others = poses.angle < 1e-9
    assert np.sum(others & ~poses.reached) > 2  # poses on other branches, which are marked
    assert poses.beyond[others & ~poses.reached].all()


def test_joints_and_a_direction_together_and_freedom_that_is_left():
    scene = load("stewart")
    normal = Axis("platform", [0.0, 0.0, 1.0])
    tilted = solve_poses(scene, axis=normal, towards=[0.2, 0.1, 1.0])
    assert tilted.reached.all()
    assert tilted.angle[0] < 1e-14
    both = solve_poses(scene, {("leg_1", 0): [0.1, 0.2]}, normal, [0.2, 0.1, 1.0])
    assert both.reached.all()
    np.testing.assert_allclose(both.coordinates["leg_1", 0], [0.1, 0.2], rtol=0.0, atol=1e-14)
    assert np.max(both.angle) < 1e-14


def test_screws_count_revolutions_and_other_angles_do_not():
    rod = Body("nut", 1.0, [0.1, 0.0, 0.2], np.diag([0.01, 0.02, 0.02]))
    spindle = Screw("spindle", "ground", "nut", [0.0, 0.0, 0.0], axis=[0.0, 0.0, 1.0], pitch=0.01)
    scene = Scene("press", Mechanism([Body.ground(), rod], [spindle]), 1.0, 0.1)
    turned = solve_poses(scene, {("spindle", 1): [15.0, -15.0]}, measure=[("spindle", 0)])
    np.testing.assert_allclose(turned.coordinates["spindle", 0], [0.15, -0.15], atol=1e-14)
    hinged = solve_poses(slider_tree(), {("sleeve_on_cart", 1): [7.0, 7.0 - 2.0 * np.pi]})
    np.testing.assert_allclose(hinged.position[0], hinged.position[1], atol=1e-14)


def test_motions_are_held_where_they_begin_and_released_where_chosen():
    flat = planar_four_bar()
    scene = replace(flat, motions=(PrescribedMotion("at_a", Sine(0.3, 2.0, offset=0.2)),))
    held = solve_poses(scene, {"at_d": [0.0]}, measure=["at_a"])
    assert held.coordinates["at_a"] == pytest.approx(0.2, abs=1e-12)
    assert not held.reached[0]
    chosen = solve_poses(scene, {"at_a": [0.4]}, measure=["at_d"])
    free = solve_poses(flat, {"at_a": [0.4]}, measure=["at_d"])
    assert chosen.coordinates["at_d"] == pytest.approx(free.coordinates["at_d"], abs=1e-13)


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        (({"slide_21": 0.0},), UnknownNameError, "unknown joint 'slide_21'; did you mean"),
        (({"ball_57": 0.0},), MechanismError, "a joint with a hinge or a slide"),
        (({"universal_47": 0.0},), MechanismError, "has 2 coordinates; needed: which one"),
        (({("universal_47", 2): 0.0},), MechanismError, "an index below 2"),
        (({"slide_12": [0.0, np.nan]},), MechanismError, "2 finite numbers"),
        (({"slide_12": [0.0, -1e300]},), MechanismError, "coordinate is 1e+300; needed: "),
        (({"slide_12": "high"},), MechanismError, "a finite number"),
        (({"slide_12": [0.0, 0.1], "slide_13": [0.0, 0.1, 0.2]},), OptionError, "numbers of values"),
        (({"slide_12": []},), OptionError, "numbers of values"),
        (({"slide_12": 0.0, ("slide_12", 0): 0.0},), OptionError, "each joint coordinate once"),
        (({"slide_12": [0.0, 0.1]}, NORMAL, np.ones((3, 3))), OptionError, "numbers of values"),
        ((None, NORMAL, [0.0, 0.0, 0.0]), MechanismError, "not all of them 0"),
        ((None, NORMAL, [[0.0, 0.0, 1.0], [0.0, np.inf, 0.0]]), MechanismError, "finite numbers"),
        ((None, NORMAL, [0.0, 1.0]), MechanismError, "rows of them"),
        ((None, None, [0.0, 0.0, 1.0]), OptionError, "an axis of a body"),
        ((None, Axis("panel", [0.0, 0.0, 1.0]), [0.0, 0.0, 1.0]), UnknownNameError, "unknown body 'panel'"),
        ((None, NORMAL), OptionError, "values of one joint or more"),
    ],
)
def test_impossible_goals_are_refused_in_one_line(arguments, error, words):
    with pytest.raises(error) as caught:
        solve_poses(load("tracker"), *arguments)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("axis", [[0.0, 0.0, 0.0], [1.0, 0.0], [[0.0, 0.0, 1.0]], "up", [0.0, np.nan, 1.0]])
def test_axes_without_a_direction_are_refused(axis):
    with pytest.raises(NewtonEulerError, match="axis of body 'panel_7'"):
        Axis("panel_7", axis)


def test_quantities_that_were_not_asked_for_are_refused():
    poses = solve_poses(load("tracker"), {"slide_12": 0.0})
    with pytest.raises(OptionError, match="one of 'slide_12'"):
        poses.jacobian(["slide_13"], ["slide_12"])
