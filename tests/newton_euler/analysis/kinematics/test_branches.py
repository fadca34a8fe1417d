"""Assembly branches against searches by hand that miss none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import tracker_loops
from mechanisms import planar_four_bar

from crosscheck.library import load
from newton_euler import (
    Axis,
    assembly_branches,
    solve_poses,
    statics,
)
from newton_euler.analysis.kinematics.crossings import passage
from newton_euler.errors import MechanismError, OptionError
from newton_euler.model.euler_parameters import rotations

SLIDERS = "slide_12", "slide_13"


def distances(rotation, others):
    """Largest differences (n,) of a rotation (3, 3) from others (n, 3, 3)."""
    return np.max(np.abs(np.asarray(others) - rotation), axis=(1, 2))


@pytest.mark.slow
@pytest.mark.parametrize("heights", [(0.0, 0.0), (-0.05, 0.03), (0.1, 0.1), (-0.1, 0.2)])
def test_branches_of_the_tracker_are_those_of_its_loop_equations(heights):
    """Each twice, for leg 5 may be turned about itself by half a revolution as well."""
    scene = load("tracker")
    branches = assembly_branches(scene, dict(zip(SLIDERS, heights, strict=True)))
    panel = scene.mechanism.body_index("panel_7")
    first = rotations(scene.mechanism.bodies[panel].quaternion)
    expected = [tracker_loops.panel(angles) @ first for angles in tracker_loops.solutions(heights)]
    assert branches.complete
    assert branches.scattered == 0
    assert len(branches) == 2 * len(expected)
    if expected:
        found = rotations(branches.poses.quaternion[:, panel])
        for rotation in expected:
            assert np.sum(distances(rotation, found) < 1e-9) == 2


@pytest.mark.slow
def test_each_branch_is_followed_from_its_pose():
    scene, heights = load("tracker"), {"slide_12": 0.01, "slide_13": 0.02}
    branches = assembly_branches(scene, heights)
    signs = []
    for k in range(len(branches)):
        start = branches.poses.state(k)
        near = solve_poses(scene, {"slide_12": [0.01, 0.0101], "slide_13": 0.02}, start=start)
        assert near.reached.all()
        np.testing.assert_allclose(near.position[0], branches.poses.position[k], rtol=0.0, atol=1e-9)
        signs.append(branches.labels[k][-1])
    assert branches.labels[0] == "0 +"  # the one of the published pose
    assert signs.count("+") == signs.count("-")  # sheets join in pairs, one of each sign
    assert branches.labels == assembly_branches(scene, heights).labels
    # in a connected region of the slider heights the initial pose reaches one of the poses
    assert branches.poses.beyond.tolist() == [False] + [True] * (len(branches) - 1)
    assert statics(replace(scene, initial_state=branches.poses.state(3)), branches.poses).beyond.tolist() == [
        k != 3 for k in range(len(branches))
    ]


def test_the_rocker_of_a_folding_four_bar_is_beyond_where_it_changed_its_side():
    """Both assembly modes are poses of one motion. It passes coupler and rocker in line: the crank returns.

    No side turns all around, as the shortest and the longest are longer together than the others (Grashof).
    """
    a, b, c, d = (0.0, 0.0), (0.3, 0.4), (0.7, 0.7), (1.2, 0.0)
    lengths = [np.linalg.norm(np.subtract(*ends)) for ends in ((b, a), (c, b), (c, d), (d, a))]
    assert min(lengths) + max(lengths) > 0.5 * sum(lengths)
    scene = planar_four_bar(b, c, d[0])
    found = assembly_branches(scene, {"at_a": 0.1}, measure=("at_d",))
    assert found.poses.beyond.tolist() == [False, True]
    # the rocker turns through all of its range, and so through both modes; the crank turns back and forth
    angles = found.poses.coordinates["at_d"]
    between = solve_poses(scene, {"at_d": np.linspace(angles[0], angles[1], 50)}, measure=("at_a",))
    assert between.reached.all()
    assert between.coordinates["at_a"][-1] == pytest.approx(0.1, abs=1e-9)
    path = [between.state(k) for k in range(50)]
    assert len(passage(scene, path, coordinates=["at_a"]).rows) == 1
    assert passage(scene, path, coordinates=["at_a"]).beyond
    assert passage(scene, path, coordinates=["at_d"]).rows == ()


def test_elbows_of_a_flat_four_bar():
    """Both crossings of two circles; three rows of its loop are redundant."""
    scene, angle = planar_four_bar(), 0.3
    branches = assembly_branches(scene, {"at_a": angle}, measure=("at_d",))
    first = np.arctan2(0.1, 0.4) + angle
    pin = np.hypot(0.1, 0.4) * np.array([np.sin(first), np.cos(first)])
    reach = np.array([1.0, 0.0]) - pin
    distance, coupler, rocker = np.hypot(*reach), np.hypot(0.8, 0.3), np.hypot(0.1, 0.7)
    along = (distance**2 + coupler**2 - rocker**2) / (2.0 * distance)
    up = np.sqrt(coupler**2 - along**2) * np.array([1.0, -1.0])
    joints = pin + (along * reach + up[:, None] * np.array([-reach[1], reach[0]])) / distance
    angles = np.arctan2(joints[:, 0] - 1.0, joints[:, 1]) - np.arctan2(-0.1, 0.7)
    assert branches.labels == ("0 +", "1 -")
    assert branches.poses.beyond.tolist() == [False, True]  # elbow up and elbow down
    assert branches.poses.reached.tolist() == [True, False]
    (line,) = branches.poses.report()
    assert line == "pose 1: meets its goals, but only beyond a singular configuration"
    assert branches.blocks == (("at_d", "at_b"),)
    np.testing.assert_allclose(branches.poses.coordinates["at_d"], angles, rtol=0.0, atol=1e-12)


def test_slider_crank_has_both_sides_and_both_turns_of_its_rod():
    branches = assembly_branches(load("slider_crank"), {"pivot": 0.3}, measure=("guide",))
    x = np.sqrt(0.3**2 - (0.1 - 0.08 * np.sin(0.3)) ** 2 - (0.12 + 0.08 * np.cos(0.3)) ** 2)
    expected = np.array([x, x, -x, -x]) - 0.2
    np.testing.assert_allclose(branches.poses.coordinates["guide"], expected, rtol=0.0, atol=1e-12)
    assert branches.labels == ("0 +", "1 -", "2 -", "3 +")
    # the slider's distance from the crank's plane is a root of positive numbers: it never changes its side
    assert branches.poses.beyond.tolist() == [False, True, True, True]


def test_windows_have_a_sign_each_and_folded_ones_none():
    branches = assembly_branches(load("four_bar"), {"pivot_0": 0.3})
    assert branches.labels == ("0 ++", "1 +-", "2 -0")
    assert branches.blocks == (("pivot_1", "hinge_0"), ("pivot_2", "hinge_1"))
    assert branches.complete


def test_a_direction_has_branches_of_its_own():
    """Slider heights that point the panel straight up: both legs above or below their ends, in two yaws."""
    normal = Axis("panel_7", [0.0, 0.0, 1.0])
    branches = assembly_branches(load("tracker"), axis=normal, towards=[0.0, 0.0, 1.0], measure=SLIDERS)
    heights = np.stack([branches.poses.coordinates[name] for name in SLIDERS], axis=1)
    np.testing.assert_allclose(heights[0], 0.046 - 0.0246, rtol=0.0, atol=1e-12)  # the paper's target
    assert len(branches) == 16
    assert np.max(branches.poses.angle) < 1e-12
    mirrored = heights[:, ::-1]  # in the plane of symmetry of the design
    assert all(np.min(np.max(np.abs(mirrored - pair), axis=1)) < 1e-9 for pair in heights)


@pytest.mark.slow  # 5,000 starts, for a continuous family never lets the search end early
def test_continuous_families_are_told_from_branches():
    branches = assembly_branches(load("bricard"), {"hinge_1": 0.1})
    assert branches.labels == ("0 +", "1 +")
    assert branches.complete
    assert branches.scattered > 1000


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        (({"slide_12": 0.0},), OptionError, "as many as degrees of freedom, 2; an axis counts as two"),
        (({"slide_12": [0.0, 0.1], "slide_13": 0.0},), OptionError, "one of each coordinate"),
        (({"slide_12": np.inf, "slide_13": 0.0},), MechanismError, "a finite number"),
    ],
)
def test_impossible_goals_are_refused_in_one_line(arguments, error, words):
    with pytest.raises(error) as caught:
        assembly_branches(load("tracker"), *arguments)
    assert words in str(caught.value)
