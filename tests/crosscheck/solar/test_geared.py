"""A day of a tracker whose motors turn lead screws."""

from dataclasses import replace

import numpy as np
import pytest

from crosscheck.library import load
from crosscheck.library.tracker_drive import RATIO
from crosscheck.library.tracker_sun import PANEL_NORMAL, sun_tracker
from crosscheck.solar.day import tracker_day
from crosscheck.solar.geared import Geared
from crosscheck.solar.place import Place
from crosscheck.solar.report import day_report
from crosscheck.solar.tracking import Tracking
from crosscheck.support.errors import CrosscheckError

PLACE, DATE, PERIOD = Place(11.56, 104.92), "2026-03-21", 3600.0


@pytest.fixture(scope="module")
def days():
    tracking = Tracking(most_tilt=30.0)
    scenes = load("tracker_drive"), sun_tracker()
    return [tracker_day(scene, PANEL_NORMAL, PLACE, DATE, None, tracking, PERIOD) for scene in scenes]


def test_motors_turn_to_where_their_screws_take_the_sliders(days):
    geared, direct = days
    for motor, slider in (("motor_2", "slide_12"), ("motor_3", "slide_13")):
        assert geared.set_points[motor] * RATIO == pytest.approx(direct.set_points[slider], abs=1e-12)
        reached = geared.run.joint(slider).coordinates[:, 0]
        # play of 0.05 mm, deflection of 7 N over 5e4 N/m, and the motors' error, some mN m over 0.03 N m/rad
        assert np.abs(reached[1:] - direct.set_points[slider][:-1]).max() < 3e-4


def test_the_first_pose_has_the_motors_where_the_gears_need_them(days):
    geared, _ = days
    start = geared.scene.initial_state
    assert start is not None
    assert start.angles["motor_2", 0] == pytest.approx(geared.set_points["motor_2"][0], rel=1e-12)


def test_motors_do_the_work_of_the_sliders_over_the_efficiency_of_the_screws(days):
    """At least: bearings and rails add to it, and lowering costs work, too, with self-locking screws."""
    geared, _ = days
    motors, sliders = (sum(each.energy for each in day.actuators.values()) for day in days)
    efficiency = geared.geared.scene.forces[0].forward_efficiency
    assert efficiency == pytest.approx(0.372, abs=1e-3)
    assert motors > sliders / efficiency
    assert motors < 5.0 * sliders / efficiency


def test_a_follower_needs_to_be_actuated():
    scene = load("tracker_drive")
    mechanism = scene.mechanism
    joints = [replace(j, actuated=False) if j.name == "slide_12" else j for j in mechanism.joints]
    fixed = replace(scene, mechanism=replace_joints(mechanism, joints))
    with pytest.raises(CrosscheckError, match="'slide_12' is the follower of a gear"):
        Geared.of(fixed)


def replace_joints(mechanism, joints):
    """Return the mechanism with other joints."""
    return type(mechanism)(mechanism.bodies, joints, mechanism.couplings)


def test_a_panel_off_its_set_points_is_not_called_followed():
    """With the gains of the paper, 50 N/m, the loads of a wind of 8 m/s move the sliders by centimeters."""
    soft = replace(load("tracker_gravity"), name="soft")
    wind = np.full(25, 8.0)
    day = tracker_day(soft, PANEL_NORMAL, PLACE, DATE, None, Tracking(most_tilt=30.0), PERIOD, wind, 90.0)
    assert day.off_set_points.any()
    report = day_report(day)
    assert report.judged.verdict == "fails"
    assert "off its set-points" in report.verdict


def test_a_stiff_tracker_follows(days):
    for day in days:
        assert not day.off_set_points.any()
        assert day_report(day).judged.verdict == "holds"
