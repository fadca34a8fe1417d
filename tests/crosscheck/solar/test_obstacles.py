"""Directions that a tracker cannot face, and the nearest ones that it can."""

from dataclasses import replace

import numpy as np
import pytest

from crosscheck.library.tracker_sun import PANEL_NORMAL, sun_tracker
from crosscheck.solar.day import tracker_day
from crosscheck.solar.moves import plan_moves
from crosscheck.solar.obstacles import Cause, Obstacles, face
from crosscheck.solar.place import Place, day_times, sun_over, tilted
from crosscheck.solar.report import obstacles_table, verdict
from crosscheck.solar.tracking import Tracking
from mjcf.clearance import clearances, closest
from newton_euler import PD, Axis, Body, Box, Fixed, Mechanism, Revolute, Scene, solve_poses

KEYS = [("slide_12", 0), ("slide_13", 0)]
TRACKING = Tracking(max_tilt=60.0)
BLOCKED = tilted(np.radians([36.0, 45.0, 60.0]), np.radians([257.0, 262.0, 268.0]))
"""Towards the sun in the west: a leg comes near the base, and then the poses are out of reach."""


@pytest.fixture(scope="module")
def day():
    """Every 20 minutes with a tilt of up to 60 degrees: the afternoon is blocked from 14:20 on."""
    place = Place(11.56, 104.92)
    return tracker_day(sun_tracker(), PANEL_NORMAL, place, "2026-03-21", tracking=TRACKING, period=1200.0)


@pytest.mark.slow
def test_blocked_directions_are_replaced_by_free_ones(day):
    faced = day.faced
    assert np.flatnonzero(faced.replaced).tolist() == list(range(43, 55))  # 14:20 to 18:00
    assert (faced.checks.cause == Cause.FREE).all()
    assert (faced.checks.clearance >= TRACKING.clearance).all()
    assert (faced.checks.to_singular >= TRACKING.to_singular).all()
    assert np.array_equal(faced.directions[~faced.replaced], day.wanted[~faced.replaced])


@pytest.mark.slow
def test_no_nearer_direction_is_free(day):
    """Directions in rings around the wanted ones, up to 0.1 degrees before the one that was chosen. Free
    ones among them are beyond blocked ones: the panel would have to pass these on its way from flat."""
    scene, obstacles = sun_tracker(), Obstacles(sun_tracker(), PANEL_NORMAL, TRACKING)
    rows = np.flatnonzero(day.faced.replaced)[[0, 3, 11]]
    for wanted, chosen in zip(day.wanted[rows], day.faced.directions[rows], strict=True):
        east = np.cross([0.0, 0.0, 1.0], wanted)
        east /= np.linalg.norm(east)
        turn = np.arccos(wanted @ chosen) - np.radians(0.1)
        radius, angle = (
            each.ravel() for each in np.meshgrid(turn * np.array([0.5, 0.9, 1.0]), np.linspace(0, 6.2, 32))
        )
        sideways = np.cos(angle)[:, None] * east + np.sin(angle)[:, None] * np.cross(wanted, east)
        nearer = np.cos(radius)[:, None] * wanted + np.sin(radius)[:, None] * sideways
        nearer = nearer[np.arccos(nearer[:, 2]) < np.radians(60.0)]
        poses = solve_poses(scene, axis=PANEL_NORMAL, towards=nearer, measure=KEYS)
        clear = clearances(scene.mechanism, poses.position, poses.quaternion) >= TRACKING.clearance
        free = clear & ~poses.beyond & (poses.independence(KEYS) >= TRACKING.to_singular)
        for direction in nearer[free]:
            tilt, azimuth = np.arccos(direction[2]), np.arctan2(*direction[:2])
            below = tilted(np.linspace(0.0, tilt, 40), np.full(40, azimuth))
            assert (obstacles.check(obstacles.poses(below)).cause != Cause.FREE).any()


@pytest.mark.slow
def test_distances_from_singular_poses_have_the_right_jacobian(day):
    """The Jacobian behind them, of the sliders by turns of the normal, against finite differences."""
    row, step = int(np.flatnonzero(day.faced.replaced)[3]), 1e-5
    direction, poses_of_day = day.faced.directions[row], day.faced.poses
    east = np.cross([0.0, 0.0, 1.0], direction)
    east /= np.linalg.norm(east)
    both = np.array([east, np.cross(direction, east)])
    towards = np.concatenate([direction + step * both, direction - step * both])
    poses = solve_poses(
        sun_tracker(), axis=PANEL_NORMAL, towards=towards, measure=KEYS, start=poses_of_day.state(row)
    )
    x = np.stack([poses.coordinates[key] for key in KEYS], axis=1)
    differences = (x[:2] - x[2:]).T / (2.0 * step)  # m/rad, columns: the two turns of the normal
    of_poses = poses_of_day.jacobian(KEYS, [PANEL_NORMAL])[row] @ both.T
    assert np.abs(differences - of_poses).max() < 1e-6


def test_the_closest_bodies_have_names():
    """Two boxes on bodies that no joint connects: a leg's distance from the base is the smallest of all."""
    poses = solve_poses(sun_tracker(), axis=PANEL_NORMAL, towards=BLOCKED[:1], measure=KEYS)
    mechanism = sun_tracker().mechanism
    found = closest(mechanism, poses.position, poses.quaternion)
    pair = frozenset(mechanism.body_names[k] for k in found.bodies[0])
    assert pair == {"base", "leg_6"}
    assert found.distance[0] == clearances(mechanism, poses.position, poses.quaternion)[0]
    others = closest(mechanism, poses.position, poses.quaternion, left_out=[pair])
    assert others.distance[0] > found.distance[0]


def test_bodies_that_always_overlap_are_left_out():
    """A box around the base, in which a leg stands in each pose."""
    scene = sun_tracker()
    base = replace(scene.mechanism.body("base"), shapes=[Box([0.3, 0.3, 0.3], [0.0, 0.0, 0.0])])
    bodies = [base if body.name == "base" else body for body in scene.mechanism.bodies]
    crowded = replace(scene, mechanism=Mechanism(bodies, scene.mechanism.joints))
    obstacles = Obstacles(crowded, PANEL_NORMAL, TRACKING)
    assert obstacles.can_avoid
    assert {"base", "panel_7"} in obstacles.left_out


@pytest.mark.parametrize(
    ("gap", "left_out", "near", "blocked"), [(-2e-4, True, False, False), (2e-4, False, True, True)]
)
def test_bodies_that_are_near_if_the_panel_lies_flat_may_not_overlap_later(gap, left_out, near, blocked):
    """A panel as a box that turns about x, 0.2 mm above or in a fixed block: the turned
    panel cuts into the block by 0.5 sin(20 degrees) m less the gap."""
    bodies = [
        Body.ground(),
        Body.solid("panel", Box([0.5, 0.5, 0.01], [0.0, 0.0, 1.0]), density=100.0),
        Body.solid("block", Box([0.1, 0.5, 0.1], [0.0, 0.0, 0.89 - gap]), density=100.0),
    ]
    joints = [
        Revolute("tilt", "ground", "panel", [0.0, 0.0, 1.0], axis=[1.0, 0.0, 0.0], actuated=True),
        Fixed("shelf", "ground", "block", [0.0, 0.0, 0.89]),
    ]
    scene = Scene("shelf", Mechanism(bodies, joints), 1.0, 0.1, control=(PD("tilt", 1.0, 1.0, target=0.0),))
    obstacles = Obstacles(scene, Axis("panel", [0.0, 0.0, 1.0]), Tracking(to_singular=0.0))
    pair = frozenset(("panel", "block"))
    assert (pair in obstacles.left_out, pair in obstacles.near) == (left_out, near)
    assert obstacles.can_avoid
    assert len(obstacles.notes) == 1
    assert "block and panel" in obstacles.notes[0]
    checks = obstacles.check(solve_poses(scene, {("tilt", 0): [0.0, np.radians(20.0)]}))
    assert (checks.cause == Cause.COLLISION).tolist() == [False, blocked]


def test_ways_of_long_moves_are_examined():
    """Between two free poses the sliders cross a region where the panel is nearly singular."""
    tracking = Tracking(max_tilt=60.0, to_singular=0.3)
    scene, directions = (
        sun_tracker(),
        tilted(np.radians([20.0, 20.0, 21.0]), np.radians([80.0, 265.0, 265.0])),
    )
    obstacles = Obstacles(scene, PANEL_NORMAL, tracking)
    poses = obstacles.poses(directions)
    x = np.stack([poses.coordinates[key] for key in KEYS], axis=1)
    plan = plan_moves(np.array([0.0, 60.0, 120.0, 180.0]), np.vstack([x, x[2:]]), 0.01, 0.02)
    ways = obstacles.ways(plan, poses)
    assert ways.begin.tolist() == [60.0]  # the second move turns the panel by a degree
    middle = solve_poses(scene, {key: x[0, k] + 0.5 * (x[1, k] - x[0, k]) for k, key in enumerate(KEYS)})
    assert ways.checks.to_singular[0] <= middle.independence(KEYS)[0] + 1e-9


@pytest.mark.slow
def test_a_day_tells_what_is_blocked(day):
    assert not (day.faces & day.faced.replaced).any()
    turned = day.error_parts["obstacles"]
    assert np.degrees(turned.max()) == pytest.approx(22.6, abs=0.3)
    assert 100.0 < day.lost_light < 150.0  # W h/m^2
    rows = {row[0]: row for row in obstacles_table(day).rows}
    assert rows["too close"][1] == "40"
    assert rows["too close"][4] == "base, leg_6"
    assert "for 240 min the wanted direction is blocked" in verdict(day)


def test_nothing_is_avoided_if_the_flat_panel_is_blocked():
    tracking = Tracking(to_singular=0.9)
    faced = face(sun_tracker(), PANEL_NORMAL, BLOCKED[:1], tracking)
    assert not faced.obstacles.can_avoid
    assert np.array_equal(faced.directions, BLOCKED[:1])
    assert faced.checks.cause[0] != Cause.FREE


def test_an_axis_may_be_another_one():
    faced = face(sun_tracker(), Axis("panel_7", [0.0, 0.0, 2.0]), np.array([[0.0, 0.0, 1.0]]), Tracking())
    assert not faced.replaced.any()


def test_leg_and_base_collide_for_19_minutes_of_an_afternoon():
    """Set-points of each minute, with a clearance of 0, are those that `crosscheck workspace` counts as
    collisions: 14:24 to 14:42."""
    scene, tracking = sun_tracker(), Tracking(max_tilt=60.0, clearance=0.0)
    sun = sun_over(Place(11.56, 104.92), day_times("2026-03-21", "UTC+07:00", 60.0)[860:885])
    obstacles = Obstacles(scene, PANEL_NORMAL, tracking)
    poses = obstacles.poses(tracking.towards(sun))
    too_close = obstacles.check(poses).cause == Cause.COLLISION
    overlapping = clearances(scene.mechanism, poses.position, poses.quaternion) < 0.0
    assert np.array_equal(too_close, overlapping)
    assert [f"{time:%H:%M}" for time in sun.times[too_close][[0, -1]]] == ["14:24", "14:42"]
    assert too_close.sum() == 19
