"""Workspace and singular configurations against loop equations by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import tracker_loops
from finite_difference import jacobian

from crosscheck.library import load
from newton_euler import Axis, Polynomial, PrescribedMotion, Scene, singular_poses, workspace
from newton_euler.errors import OptionError

SLIDERS = "slide_12", "slide_13"

NORMAL = Axis("panel_7", [0.0, 0.0, 1.0])


def test_map_of_the_tracker():
    grid = {"slide_12": np.linspace(-0.06, 0.08, 15), "slide_13": np.linspace(-0.04, 0.08, 13)}
    found = workspace(load("tracker"), grid, NORMAL)
    assert found.reachable.shape == (15, 13)
    assert 60 < found.reachable.sum() < 140
    for values in (found.driving, found.pointing, found.elevation, found.azimuth):
        np.testing.assert_array_equal(np.isnan(values), ~found.reachable)
    for k, place in enumerate(np.argwhere(found.reachable)):
        heights = [values[n] for values, n in zip(grid.values(), place, strict=True)]
        assert [found.poses.coordinates[name][k] for name in SLIDERS] == pytest.approx(heights, abs=1e-14)
        elevation, azimuth = found.elevation[tuple(place)], found.azimuth[tuple(place)]
        flat = np.cos(elevation) * np.array([np.cos(azimuth), np.sin(azimuth)])
        np.testing.assert_allclose(found.poses.direction[k], [*flat, np.sin(elevation)], atol=1e-14)


@pytest.mark.slow
def test_singular_curves_of_the_tracker_are_those_of_its_loop_equations():
    """There the equations by hand have a double solution: two more on one side of the curve."""
    scene = load("tracker")
    poses = singular_poses(scene, SLIDERS, 60)
    assert len(poses) > 30
    possible = poses.jacobian(SLIDERS, SLIDERS)
    for k in range(4):
        height = np.array([poses.coordinates[name][k] for name in SLIDERS])
        frames, angles = poses.state(k).frames(), []
        for joint, number in (("hinge_14", 0), ("universal_47", 0), ("universal_47", 1)):
            equations = scene.mechanism.joint_equations(joint)
            measure = equations.coordinates[number]
            angles.append(measure.phi(frames[equations.first], frames[equations.second])[0])
        assert np.max(np.abs(tracker_loops.residuals(np.array(angles), height))) < 1e-12
        by_hand = jacobian(lambda d, at=angles, x=height: tracker_loops.residuals(at + d, x), 3)
        assert np.linalg.svd(by_hand, compute_uv=False)[-1] < 1e-10
        across = 1e-4 * np.linalg.svd(possible[k])[0][:, 1]  # m, where the sliders cannot move
        counts = [len(tracker_loops.solutions(height + side * across, angles, 0.05)) for side in (-1.0, 1.0)]
        assert abs(counts[1] - counts[0]) == 2  # next to a cusp there is a third


def test_dead_centers_of_the_slider_crank():
    poses = singular_poses(load("slider_crank"), ["guide"], 100)
    center = np.hypot(0.1, 0.12)
    ends = np.sqrt(0.3**2 - np.array([center + 0.08, center - 0.08]) ** 2)
    expected = np.sort([*(ends - 0.2), *(-ends - 0.2)])
    np.testing.assert_allclose(np.unique(poses.coordinates["guide"].round(8)), expected, rtol=0.0, atol=1e-8)
    assert np.max(poses.independence(["guide"])) < 1e-10


@pytest.mark.parametrize("names", [["slide_12"], ["slide_12", "slide_13", "hinge_14"]])
def test_as_many_coordinates_as_freedoms(names):
    with pytest.raises(OptionError, match="as many as degrees of freedom, 2"):
        workspace(load("tracker"), {name: [0.0, 0.1] for name in names})
    with pytest.raises(OptionError, match="as many as degrees of freedom, 2"):
        singular_poses(load("tracker"), names)


def turning_slider_crank() -> Scene:
    """Return the slider-crank whose crank turns at its initial speed of 6 rad/s."""
    return replace(load("slider_crank"), motions=(PrescribedMotion("pivot", Polynomial((0.0, 6.0))),))


def test_coordinates_replace_prescribed_motions():
    turning, angles = turning_slider_crank(), np.linspace(-3.0, 3.0, 7)
    found = workspace(turning, {"pivot": angles})
    np.testing.assert_allclose(found.poses.coordinates["pivot"], angles, rtol=0.0, atol=1e-12)
    assert len(singular_poses(turning, ["pivot"], 10)) == 0  # the rod is long enough for a full turn


def test_other_motions_hold_their_joints():
    turning = turning_slider_crank()
    with pytest.raises(OptionError) as caught:
        workspace(turning, {"guide": [0.0, 0.01]})
    assert "degrees of freedom, 0 while motions hold 'pivot'" in caught.value.needed
    with pytest.raises(OptionError) as caught:
        singular_poses(turning, ["guide"])
    assert "degrees of freedom, 0 while motions hold 'pivot'" in caught.value.needed


def test_a_negative_count_is_refused():
    with pytest.raises(OptionError, match="count is -1; needed: a whole number"):
        singular_poses(load("slider_crank"), ["guide"], -1)
