"""The sun over places, set-points that face it, and a tracker's day."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from command_line import run

from crosscheck.library import load
from crosscheck.library.tracker_sun import PANEL_NORMAL, sun_tracker
from crosscheck.solar.day import tracker_day
from crosscheck.solar.energy import FACING, FIXED, FLAT, ONE_AXIS, THIS, ClearSky, over_day
from crosscheck.solar.place import Place, Sun, day_times, seconds_of_day, sun_over
from crosscheck.solar.report import hours, verdict
from crosscheck.solar.results import table_of_set_points
from crosscheck.solar.tracking import Tracking
from crosscheck.solar.wind import wind_over_day
from crosscheck.support.errors import CrosscheckError
from newton_euler import Sampled, solve_poses
from newton_euler.model.source_file import SourceError

EQUATOR = Place(0.0, 0.0)


def between(one, other):
    """Angles (n,) between unit vectors (n, 3), rad."""
    across = np.linalg.norm(np.cross(one, other), axis=1)
    return np.arctan2(across, np.sum(one * other, axis=1))


def test_the_sun_is_where_the_published_example_has_it():
    """Reda and Andreas, Solar Energy 76, 2004, Table A5.1: Golden, Colorado.

    Their air is of 820 mbar and 11 degrees Celsius, ours of 812 and 12: refraction differs by 2e-4 degrees.
    """
    time = pd.DatetimeIndex(["2003-10-17 12:30:30-07:00"])
    sun = sun_over(Place(39.742476, -105.1786, 1830.14), time)
    assert abs(90.0 - np.degrees(sun.elevation[0]) - 50.11162) < 5e-4
    assert abs(np.degrees(sun.azimuth[0]) - 194.34024) < 1e-4


def test_directions_are_east_north_and_up():
    noon = Sun(pd.DatetimeIndex([]), np.radians([90.0, 180.0, 0.0]), np.radians([0.0, 45.0, 90.0]))
    expected = [[1.0, 0.0, 0.0], [0.0, -np.sqrt(0.5), np.sqrt(0.5)], [0.0, 0.0, 1.0]]
    assert np.allclose(noon.direction, expected, rtol=0.0, atol=1e-15)


def test_zones_are_those_of_the_place():
    assert Place(11.56, 104.92).zone == "UTC+07:00"
    assert Place(40.0, -105.0).zone == "UTC-07:00"


@pytest.fixture(scope="module")
def sun():
    return sun_over(EQUATOR, day_times("2026-03-21", "UTC", 300.0))


def test_panels_tilt_no_more_than_they_may(sun):
    normals, most = Tracking(max_tilt=40.0).normals(sun), np.radians(40.0)
    tilt = np.arccos(normals[:, 2])
    assert np.max(tilt) < most + 1e-12
    high = sun.elevation > 0.5 * np.pi - most
    assert np.max(between(normals, sun.direction)[high]) < 1e-12
    low = sun.is_up & ~high
    assert np.allclose(
        np.arctan2(*normals[low, :2].T), np.arctan2(*sun.direction[low, :2].T), rtol=0.0, atol=1e-9
    )


def test_panels_wait_at_night_where_the_sun_rises(sun):
    normals, first = Tracking().normals(sun), int(np.flatnonzero(sun.is_up)[0])
    assert np.array_equal(normals[~sun.is_up], np.tile(normals[first], (np.sum(~sun.is_up), 1)))


def test_dead_bands_hold_panels_until_they_are_off_by_more(sun):
    wanted, held = Tracking().normals(sun), Tracking(deadband=5.0).normals(sun)
    assert np.max(between(wanted, held)) < np.radians(5.0) + 1e-9
    jumps = np.flatnonzero(np.any(np.diff(held, axis=0) != 0.0, axis=1))
    assert 0 < len(jumps) < 60.0 / 5.0 + 5  # 60 degrees of tilt both ways at 5 degrees a move


def test_backtracking_leaves_the_next_row_in_the_sun(sun):
    pitch = 2.0
    normals = Tracking(max_tilt=90.0, pitch=pitch).normals(sun)
    up = sun.elevation > np.radians(0.5)
    tilt = np.arccos(normals[up, 2])
    # length of ground between the ends of a panel of length 1 and of its shadow
    shaded = np.cos(tilt) + np.sin(tilt) / np.tan(sun.elevation[up])
    assert np.max(shaded) < pitch + 1e-9
    assert np.min(np.abs(shaded - pitch)) < 1e-9  # no flatter than it has to be
    free = np.sin(sun.elevation[up]) > 1.0 / pitch
    assert np.max(between(normals[up][free], sun.direction[up][free])) < 1e-9


@pytest.mark.parametrize("deadband", [0.0, 40.0])
def test_panels_lie_flat_in_storms(sun, deadband):
    """From a tilt of 30 degrees and back; in a dead band of 40 degrees only the wind moves the panel."""
    wind = np.zeros(len(sun.times))
    wind[100:110] = 25.0
    normals = Tracking(deadband=deadband, stow=20.0).normals(sun, wind)
    assert np.array_equal(normals[100:110], np.tile([0.0, 0.0, 1.0], (10, 1)))
    assert np.degrees(np.arccos(normals[[99, 110], 2])) == pytest.approx([30.0, 30.0])


def test_a_windy_day_is_told_of(tmp_path):
    """Wind that grows from 0 at midnight to 12 m/s at noon: above 6 m/s from 6 h to 18 h."""
    path = tmp_path / "wind.csv"
    path.write_text("time, speed\n0, 0\n43200, 12\n86400, 0\n")
    wind = wind_over_day(str(path), seconds_of_day(3600.0))
    tracking = Tracking(stow=6.0, max_tilt=90.0)
    day = tracker_day(sun_tracker(), PANEL_NORMAL, EQUATOR, "2026-03-21", None, tracking, 3600.0, wind)
    assert np.flatnonzero(day.stowed).tolist() == list(range(6, 19))
    assert not (day.faces & day.stowed).any()
    assert "; lies flat for 12.0 h of daylight, in winds from 6 m/s on" in verdict(day)
    rows = table_of_set_points(day).decode().splitlines()
    assert rows[0].endswith(",wind_m_per_s")
    assert rows[1 + 9].endswith(",9")


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("time,speed\n0,1\n9,x\n86400,1\n", "line 3: speed is 'x'; needed: a finite number"),
        ("time,speed\n0,1\n9,-1\n86400,1\n", "line 3: speed is -1; needed: 0 m/s or more"),
        ("time,speed\n0,1\n,2\n86400,1\n", "line 3: time is missing; needed: a finite number"),
        ("time,speed\n0,1\n0,2\n86400,1\n", "line 3: time is 0; needed: times in ascending order"),
        ("time,speed\n0,1\n9,2\n", "speeds from 0 to 9 s; needed: the whole day, 0 to 86400 s"),
        ("time,wind\n0,1\n", "has time, wind; needed: columns time, s since midnight, and speed, m/s"),
        ("time,speed\n", "has no rows; needed: columns"),
        ("", "has no rows; needed: columns"),
    ],
)
def test_winds_that_are_none(tmp_path, rows, message):
    path = tmp_path / "wind.csv"
    path.write_text(rows)
    with pytest.raises((CrosscheckError, SourceError)) as caught:
        wind_over_day(str(path), seconds_of_day(60.0))
    assert str(caught.value).startswith(f"{path}: {message}")
    with pytest.raises(CrosscheckError, match="--wind is -3; needed: a number of m/s, 0 or more"):
        wind_over_day("-3", seconds_of_day(60.0))


def test_light_on_flat_panels_is_that_of_the_sky(sun):
    """Irradiance on a horizontal plane is what pvlib's model of the sky gives."""
    import pvlib

    flat = np.tile([0.0, 0.0, 1.0], (len(sun.times), 1))
    sky = pvlib.location.Location(0.0, 0.0).get_clearsky(sun.times)["ghi"].to_numpy()
    assert np.max(np.abs(ClearSky(EQUATOR, sun).on(flat) - sky)) < 2.0  # W/m^2; refraction near the horizon


@pytest.fixture(scope="module")
def day():
    return tracker_day(sun_tracker(), PANEL_NORMAL, EQUATOR, "2026-06-21")


@pytest.mark.slow
def test_panels_get_to_their_set_points(day):
    """Just before each next set-point the normal points where it was to; rests end it 1e-8 m/s early."""
    assert day.poses.reached.all()
    assert np.max(between(day.normals[1:], day.wanted[:-1])) < 1e-6


def test_panels_face_the_sun_but_for_its_motion_in_a_period(day):
    assert 2.0 < np.sum(day.faces) / 60.0 < 3.0  # h, of a sun 66 degrees high and a tilt of 30
    assert np.degrees(np.max(day.errors[day.faces])) < 0.26  # 15 degrees an hour, or less


def test_light_falls_by_how_well_panels_face_the_sun(day):
    """At the equator in June the sun is 23 degrees north: off a row on one axis all day, off this tracker in
    the morning and the evening, off a flat panel always."""
    light = day.light
    assert light[FACING] > light[THIS] > light[ONE_AXIS] > light[FLAT]
    assert abs(light[FLAT] - light[FIXED]) < 1e-9 * light[FLAT]  # tilted by no latitude
    beam = np.where(day.sun.is_up, 1.0, 0.0)
    assert over_day(day.seconds, beam) == pytest.approx(12.1, abs=0.1)  # h from sunrise to sunset


def test_sliders_hold_what_weighs_on_the_legs(day):
    """Of forces at rest: the base carries the whole weight, whatever the pose."""
    scene, reactions = day.scene, day.loads.reaction_force
    weight = 9.81 * sum(body.mass for body in scene.mechanism.bodies[1:])
    upward = np.zeros(len(reactions))
    for k, joint in enumerate(scene.mechanism.joints):
        if joint.first == scene.mechanism.body_names[0]:
            upward += reactions[:, k, 2]
    vertical = day.loads.actuator_force.sum(axis=1)  # along the sliders' guides, which stand upright
    assert np.max(np.abs(upward + vertical - weight)) < 1e-10 * weight


def test_work_of_actuators_is_what_they_lift(day):
    """Forces at rest are the slopes of the potential energy over the sliders: what both do together from one
    set-point to the next is its difference, by the trapezoidal rule on steps of a minute."""
    scene, force = day.scene, day.loads.actuator_force
    masses = np.array([body.mass for body in scene.mechanism.bodies])
    height = 9.81 * (day.poses.position[:, 1:, 2] @ masses[1:])
    moved = np.diff(np.stack(list(day.set_points.values()), axis=1), axis=0)
    done = np.sum(0.5 * (force[1:] + force[:-1]) * moved, axis=1)
    small = np.max(np.abs(moved), axis=1) < 1e-3  # m; the way back at night is one step
    # J: h^3 / 12 of the trapezoidal rule, slopes of 15 N over 0.1 m squared
    assert np.max(np.abs(done - np.diff(height))[small]) < 1.3e-7


def test_storms_come_at_set_points():
    with pytest.raises(CrosscheckError, match=r"\(3,\).* 25 finite speeds"):
        tracker_day(sun_tracker(), PANEL_NORMAL, EQUATOR, "2026-06-21", period=3600.0, wind=np.zeros(3))


def test_what_is_out_of_reach_is_faced_as_nearly_as_can_be():
    tracking = Tracking(max_tilt=60.0)
    wanted = tracking.normals(sun_over(EQUATOR, day_times("2026-03-21", "UTC", 3600.0)))
    poses = solve_poses(sun_tracker(), axis=PANEL_NORMAL, towards=wanted)
    assert not poses.reached.all()
    assert poses.closed.all()
    assert all("nearest pose" in line for line in poses.report())


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ((91.0, 0.0), r"latitude 91\.0 is off the globe: -90 to 90 degrees north"),
        ((0.0, 200.0), r"longitude 200\.0 is off the globe"),
        ((0.0, 0.0, 1e5), r"altitude 100000\.0 is off the globe"),
        ((float("nan"), 0.0), "latitude nan is off the globe"),
    ],
)
def test_places_off_the_globe(numbers, message):
    with pytest.raises(CrosscheckError, match=message):
        Place(*numbers)


@pytest.mark.parametrize(
    ("date", "zone", "message"),
    [
        ("2026-13-01", "UTC", "date '2026-13-01' .* YYYY-MM-DD"),
        ("2026-03-21 12:00", "UTC", "date '2026-03-21 12:00' .* YYYY-MM-DD"),
        ("0000-01-01", "UTC", "date '0000-01-01' .* YYYY-MM-DD"),
        ("2026-03-21", "Mars/Olympus", "time zone 'Mars/Olympus' is unknown"),
    ],
)
def test_days_that_are_none(date, zone, message):
    with pytest.raises(CrosscheckError, match=message):
        day_times(date, zone, 60.0)


def test_times_without_a_zone():
    with pytest.raises(CrosscheckError, match="have no time zone"):
        sun_over(EQUATOR, pd.DatetimeIndex(["2026-03-21 12:00"]))


def test_a_sun_that_does_not_rise():
    with pytest.raises(CrosscheckError, match="the sun does not rise on 2026-12-21"):
        tracker_day(sun_tracker(), PANEL_NORMAL, Place(80.0, 0.0), "2026-12-21")


@pytest.mark.parametrize(
    "value",
    [
        {"max_tilt": 120.0},
        {"deadband": -1.0},
        {"pitch": 0.5},
        {"stow": float("nan")},
        {"speed": 0.0},
        {"acceleration": 0.0},
    ],
)
def test_trackings_that_are_none(value):
    (name,) = value
    with pytest.raises(CrosscheckError, match=f"{name} is"):
        Tracking(**value)


def test_set_points_are_those_of_pd_laws():
    scene = load("tracker")
    laws = tuple(Sampled(law.joint, lambda time, x, x_rate: 0.0, 0.01) for law in scene.control)
    with pytest.raises(CrosscheckError, match=r"'tracker'.*PD"):
        tracker_day(replace(scene, control=laws), PANEL_NORMAL, EQUATOR, "2026-03-21")


def test_a_flat_panel_has_a_tilt_of_zero():
    """Round-off makes the normal of a panel that hardly tilts longer than 1."""
    place, tracking = Place(11.5, 0.0), Tracking(max_tilt=1e-9)
    found = tracker_day(sun_tracker(), PANEL_NORMAL, place, "2026-03-21", None, tracking, 3600.0, None)
    tilts = [row[5] for row in hours(found)]
    assert set(tilts) == {"0.0"}


def test_a_folder_that_cannot_be_is_refused_before_the_day_is_simulated(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("crosscheck.solar.day.tracker_day", lambda *_: pytest.fail("simulated"))
    (tmp_path / "file").write_text("")
    status, _, err = run(
        capsys, "sun", "--latitude", "11.5", "--date", "2026-03-21", "--output", tmp_path / "file" / "out"
    )
    assert status == 2
    assert err.startswith("crosscheck: error: cannot write ")
