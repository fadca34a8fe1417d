"""A day of a tracker whose motors turn lead screws."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from crosscheck.library import load
from crosscheck.library.tracker_drive import RATIO
from crosscheck.library.tracker_sun import PANEL_NORMAL, sun_tracker
from crosscheck.solar.base import Base, following_on_base
from crosscheck.solar.day import REST_RATE, tracker_day
from crosscheck.solar.geared import Geared
from crosscheck.solar.obstacles import Cause
from crosscheck.solar.place import Place, tilted
from crosscheck.solar.reach import reach_over_year
from crosscheck.solar.report import day_report, zeros
from crosscheck.solar.tracking import Tracking
from crosscheck.solar.weather import Weather
from crosscheck.solar.year import Limit, tracker_year
from crosscheck.support.errors import CrosscheckError
from newton_euler import compile_scene

PLACE, DATE, PERIOD = Place(11.56, 104.92), "2026-03-21", 3600.0


@pytest.fixture(scope="module")
def days():
    tracking = Tracking(max_tilt=30.0)
    scenes = load("tracker_drive"), sun_tracker()
    return [tracker_day(scene, PANEL_NORMAL, PLACE, DATE, None, tracking, PERIOD) for scene in scenes]


@pytest.mark.slow
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


def test_zeros_of_set_points_are_stated(days):
    """The heights of the sliders at zero: those of the poses, less the set-points."""
    for day in days:
        sentences = list(zeros(day))
        assert len(sentences) == 2
        for sentence, slider, key in zip(sentences, ("slider_2", "slider_3"), day.geared.keys, strict=True):
            body = day.scene.mechanism.body_index(slider)
            height = 1e3 * (day.poses.position[5, body, 2] - day.poses.coordinates[key][5])
            point = re.search(rf"'{slider}' at \(([^)]*)\) mm", sentence)[1]
            assert float(point.split(",")[2]) == pytest.approx(height, abs=0.051)
            assert "(0, 0, 1)" in sentence


def test_energies_are_integrals_of_the_power(days):
    """Simulated again with 4 ms between the outputs of a move: the work of the table, and the power of the
    file, integrated by an own trapezoidal rule. The motors' inertia makes the torque fall in steps."""
    day, _ = days
    starts, ends = day.plan.begin, day.plan.end
    fine = [np.arange(start, end + 1.0, 0.004) for start, end in zip(starts, ends, strict=True)]
    times = np.unique(np.concatenate([day.plan.samples(day.seconds), *fine]))
    run = compile_scene(day.scene).simulate(times=times[times <= day.seconds[-1]], rest=REST_RATE)
    for k, motion in enumerate(day.motions):
        rate = run.joint(motion.name).rates[:, 0]
        reference = np.trapezoid(np.maximum(run.actuator_force[:, k] * rate, 0.0), run.time)
        power = np.maximum(motion.force * motion.speed, 0.0)
        assert np.trapezoid(power, motion.time) == pytest.approx(reference, rel=5e-3)
        assert day.actuators[motion.name].energy == pytest.approx(reference, rel=5e-3)


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


@pytest.mark.slow
def test_a_panel_off_its_set_points_is_not_called_followed():
    """With the gains of the paper, 50 N/m, the loads of a wind of 8 m/s move the sliders by centimeters."""
    soft = replace(load("tracker_gravity"), name="soft")
    wind = np.full(25, 8.0)
    day = tracker_day(soft, PANEL_NORMAL, PLACE, DATE, None, Tracking(max_tilt=30.0), PERIOD, wind, 90.0)
    assert day.off_set_points.any()
    report = day_report(day)
    assert report.judged.verdict == "fails"
    assert "off its set-points" in report.verdict


def test_a_stiff_tracker_follows(days):
    for day in days:
        assert not day.off_set_points.any()
        assert day_report(day).judged.verdict == "holds"


def test_motors_of_a_year_turn_to_where_their_screws_take_the_sliders():
    """Set-points of a day are those of driven sliders over the lead; a stroke is in rad of the motor."""
    times = pd.date_range("2026-03-21 00:30", periods=24, freq="h", tz="UTC+07:00")
    light = np.full(24, 100.0)
    weather = Weather(PLACE, "sample", times, 1.0, light, light, light)
    geared, direct = (
        tracker_year(scene, PANEL_NORMAL, weather, Tracking())
        for scene in (load("tracker_drive"), sun_tracker())
    )
    for motor, slider in (("motor_2", "slide_12"), ("motor_3", "slide_13")):
        assert np.ptp(direct.coordinates[slider]) > 0.02  # m
        assert geared.coordinates[motor] * RATIO == pytest.approx(direct.coordinates[slider], abs=1e-9)
    assert geared.light == pytest.approx(direct.light, rel=1e-9)
    stopped = tracker_year(
        geared.scene, PANEL_NORMAL, weather, Tracking(), strokes={"motor_2": (-100.0, 100.0)}
    )
    beyond = geared.coordinates["motor_2"] > 100.0
    assert 0 < beyond.sum() < 24
    assert stopped.coordinates["motor_2"][beyond] == pytest.approx(np.full(beyond.sum(), 100.0))
    assert (stopped.limits[beyond & (geared.limits != Limit.DOWN)] == Limit.STROKE).all()


def test_positions_near_singular_configurations_are_those_of_the_sliders(monkeypatch):
    """Motors behind gears determine their own angles only: the sliders determine the panel's."""
    date_range = pd.date_range
    monkeypatch.setattr(pd, "date_range", lambda *given, **named: date_range(*given, **named)[::101])
    tracking = Tracking(to_singular=0.4)
    geared, direct = (
        reach_over_year(scene, PANEL_NORMAL, Place(37.4, -6.0), 2026, tracking).cause
        for scene in (load("tracker_drive"), sun_tracker())
    )
    assert (direct == Cause.SINGULAR).sum() >= 3
    assert (geared == Cause.SINGULAR)[direct == Cause.SINGULAR].all()


@pytest.mark.slow
def test_motors_on_a_moving_base_have_the_set_points_and_forces_of_the_sliders():
    base, wanted = Base.at_rest(roll=10.0, heading=80.0), tilted(np.full(8, 0.3), np.linspace(0.0, 1.0, 8))
    (geared, _), (direct, _) = (
        following_on_base(scene, PANEL_NORMAL, wanted, base, 0.5)
        for scene in (load("tracker_drive"), sun_tracker())
    )
    for motor, slider in zip(geared.control, direct.control, strict=True):
        for time in (0.0, 1.3, 3.5):
            assert motor.target.value(time) * RATIO == pytest.approx(slider.target.value(time), abs=1e-9)
            held = slider.feedforward.value(time)
            assert abs(held) > 1.0  # N
            assert motor.feedforward.value(time) == pytest.approx(held * RATIO, rel=1e-6)
    start = geared.initial_state
    assert start.angles["motor_2", 0] == pytest.approx(geared.control[0].target.value(0.0), rel=1e-9)
