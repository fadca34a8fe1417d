"""Wind on the panel of a tracker over a day, and stowing in it."""

from dataclasses import replace

import numpy as np
import pytest
from command_line import run
from plate_coefficients import blended

from crosscheck.library.tracker_sun import PANEL_NORMAL, sun_tracker
from crosscheck.solar.day import tracker_day
from crosscheck.solar.place import Place
from crosscheck.solar.report import verdict
from crosscheck.solar.tracking import Tracking
from crosscheck.solar.wind import panel_box, wind_on_panel
from newton_euler import Axis, Mechanism, solve_poses
from newton_euler.model.euler_parameters import rotations

G, STIFFNESS = 9.81, 5000.0
LENGTH, WIDTH = 0.14, 0.11
"""m, sides of the panel, `crosscheck.library.tracker.PANEL` twice."""


@pytest.fixture(scope="module")
def day():
    """A wind of 12 m/s from the west, every half hour."""
    wind = np.full(49, 12.0)
    return tracker_day(
        sun_tracker(),
        PANEL_NORMAL,
        Place(11.56, 104.92),
        "2026-03-21",
        period=1800.0,
        wind=wind,
        wind_from=270.0,
    )


def wind_force(normal, first_side, wind=np.array([12.0, 0.0, 0.0])):  # noqa: B008
    """N, normal force, and m, distance of its point from the center along the wind, by the formulas that
    `WindLoad` cites, for a wind (3,), m/s; east, north, up."""
    speed = np.linalg.norm(wind)
    second_side = np.cross(normal, first_side)
    along = wind - (wind @ normal) * normal
    along /= np.linalg.norm(along)
    first, second = along @ first_side, along @ second_side
    ratio = np.hypot(LENGTH * second, WIDTH * first) / np.hypot(LENGTH * first, WIDTH * second)
    sine = abs(wind @ normal) / speed
    degrees = np.degrees(np.arcsin(sine))
    coefficient, moment = blended(degrees, ratio, LENGTH / WIDTH)
    pressure = 0.5 * 1.225 * LENGTH * WIDTH * speed**2
    force = pressure * coefficient * np.sign(wind @ normal) * normal
    # ahead of the center, in proportion to the components along both sides
    lead = moment / coefficient
    return force, -lead * (LENGTH * first * first_side + WIDTH * second * second_side)


@pytest.mark.parametrize("row", [16, 26, 34])  # 8, 13 and 17 h
def test_actuators_hold_weight_and_wind_by_virtual_work(day, row):
    scene, step = sun_tracker(), 1e-5
    masses = np.array([body.mass for body in scene.mechanism.bodies])[1:]
    panel = scene.mechanism.body_index("panel_7")
    # positions of the sliders: set-points and deflections of the controllers
    pose = int(day.plan.heading(day.seconds[[row]])[0])
    actuators = day.actuators
    x = {}
    for name, values in day.set_points.items():
        weight = day.loads.actuator_force[pose, list(day.set_points).index(name)]
        x[name] = values[pose] + (weight - actuators[name].holding[row]) / STIFFNESS
    for name, actuator in actuators.items():
        moved = {each: np.array([value] * 3) for each, value in x.items()}
        moved[name] = x[name] + step * np.array([-1.0, 0.0, 1.0])
        poses = solve_poses(scene, moved, axis=PANEL_NORMAL, start=day.poses.state(pose))
        height = poses.position[:, 1:, 2] @ masses
        # the first side of the panel is along the first axis of its body
        frames = rotations(poses.quaternion[:, panel])
        force, arm = wind_force(frames[1][:, 2], frames[1][:, 0])
        local = frames[1].T @ arm
        points = [
            center + frame @ local for center, frame in zip(poses.position[:, panel], frames, strict=True)
        ]
        by_wind = force @ (points[2] - points[0]) / (2.0 * step)
        expected = G * (height[2] - height[0]) / (2.0 * step) - by_wind
        assert abs(by_wind) > 0.02
        assert actuator.holding[row] == pytest.approx(expected, abs=2e-5)


def test_the_wind_turns_the_panel(day):
    turned = np.degrees(day.error_parts["motion, control and wind load"])
    assert turned.max() > 0.5  # 1.0 degree at 18 h; 1e-8 degrees without wind
    assert day.wind_acts


def test_panels_are_boxes_across_the_normal():
    scene = sun_tracker()
    _box, sides = panel_box(scene, PANEL_NORMAL)
    assert np.linalg.norm(sides, axis=1) == pytest.approx([LENGTH, WIDTH])
    assert panel_box(scene, Axis("panel_7", [0.3, 0.0, 1.0])) is None
    bare = [replace(body, shapes=()) for body in scene.mechanism.bodies]
    bare_scene = replace(scene, mechanism=Mechanism(bare, scene.mechanism.joints))
    assert wind_on_panel(bare_scene, PANEL_NORMAL, np.array([0.0]), np.array([3.0]), 0.0) is None


def test_winds_from_the_north_blow_to_the_south():
    for blows_from, towards in ((0.0, [0.0, -1.0, 0.0]), (90.0, [-1.0, 0.0, 0.0])):
        load = wind_on_panel(sun_tracker(), PANEL_NORMAL, np.array([0.0]), np.array([3.0]), blows_from)
        assert load.direction == pytest.approx(towards, abs=1e-12)


@pytest.mark.slow
def test_vertical_gusts_lift_a_panel_that_lies_flat():
    """Force and arm of an upward wind by the formulas of `WindLoad`; the sliders' part by virtual work."""
    wind, up, row = np.full(13, 20.0), 0.25, 6
    place, tracking = Place(11.56, 104.92), Tracking(stow=15.0)
    calm, gusty = (
        tracker_day(
            sun_tracker(),
            PANEL_NORMAL,
            place,
            "2026-03-21",
            None,
            tracking,
            7200.0,
            wind,
            270.0,
            wind_up=each,
        )
        for each in (0.0, up)
    )
    assert calm.stowed.all()
    scene, step = sun_tracker(), 1e-5
    panel = scene.mechanism.body_index("panel_7")
    at = {
        name: motion.position[gusty.rows[row]]
        for name, motion in zip(gusty.actuators, gusty.motions, strict=True)
    }
    for name in at:
        moved = {each: np.array([value] * 3) for each, value in at.items()}
        moved[name] = at[name] + step * np.array([-1.0, 0.0, 1.0])
        poses = solve_poses(scene, moved, axis=PANEL_NORMAL, start=gusty.poses.state(row))
        frames, centers = rotations(poses.quaternion[:, panel]), poses.position[:, panel]
        masses = np.array([body.mass for body in scene.mechanism.bodies])[1:]
        height = poses.position[:, 1:, 2] @ masses
        force, arm = wind_force(frames[1][:, 2], frames[1][:, 0], np.array([20.0, 0.0, 20.0 * up]))
        assert force[2] > 0.5
        points = [center + frame @ (frames[1].T @ arm) for center, frame in zip(centers, frames, strict=True)]
        by_wind = force @ (points[2] - points[0]) / (2.0 * step)
        expected = G * (height[2] - height[0]) / (2.0 * step) - by_wind
        assert gusty.actuators[name].holding[row] == pytest.approx(expected, abs=2e-4)
        assert abs(gusty.actuators[name].holding[row] - calm.actuators[name].holding[row]) > 0.1
    assert "without a load: the wind is horizontal" in verdict(calm)
    assert "without a load" not in verdict(gusty)


@pytest.mark.parametrize("option", [("--stow", "12"), ("--wind-from", "90"), ("--wind-up", "0.2")])
def test_options_of_the_wind_need_one(capsys, option):
    status, _, err = run(capsys, "sun", "--latitude", "10", "--date", "2026-03-21", *option)
    assert status == 2
    assert f"{option[0]} has no effect without --wind" in err
