"""A year of solar tracking: irradiation against calls of pvlib, limits, modules, bases that are not level."""

import json
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pvlib
import pytest
import synthetic_weather as synthetic
from command_line import csv_rows, run

from crosscheck.library.tracker_sun import PANEL_NORMAL, sun_tracker
from crosscheck.solar.base import Base, base_of, following_on_base
from crosscheck.solar.day import tracker_day
from crosscheck.solar.energy import FACING, FIXED, FLAT, ONE_AXIS, THIS
from crosscheck.solar.place import Place
from crosscheck.solar.tracking import Tracking
from crosscheck.solar.weather import Weather, check_place
from crosscheck.solar.year import FLAT_ON_BASE, Limit, Module, stroke_of, tracker_year
from crosscheck.support.errors import CrosscheckError
from newton_euler import (
    Axis,
    Body,
    Cylinder,
    Fixed,
    Mechanism,
    Revolute,
    Scene,
    Sine,
    Spline,
    simulate,
    solve_poses,
)

PLACE = Place(synthetic.LATITUDE, synthetic.LONGITUDE, synthetic.ALTITUDE)

NORMAL = Axis("panel", [0.0, 0.0, 1.0])

GIMBAL_MJCF = """<mujoco>
  <worldbody>
    <body name="frame">
      <joint name="roll" axis="0 1 0"/>
      <geom size="0.1" mass="1"/>
      <body name="panel">
        <joint name="tilt" axis="1 0 0"/>
        <geom type="box" size="0.5 0.5 0.01" mass="1"/>
      </body>
    </body>
  </worldbody>
</mujoco>"""
"""Two axes: one from south to north, one across it in the panel."""


@pytest.fixture(scope="module")
def weather():
    """Twelve days of synthetic weather, one in each month."""
    days = [
        pd.date_range(f"2015-{month:02d}-{month + 10}", periods=24, freq="h", tz="UTC")
        for month in range(1, 13)
    ]
    middles = days[0].append(days[1:]) + pd.Timedelta(minutes=30)
    data = synthetic.sky(middles)
    light = {name: data[name].to_numpy() for name in ("dni", "ghi", "dhi")}
    air, wind = data["temp_air"].to_numpy(), data["wind_speed"].to_numpy()
    rows = tuple(f"line {k}" for k in range(len(middles)))
    return Weather(PLACE, "sample", middles, 1.0, **light, temperature=air, wind=wind, rows=rows)


def panel_scene(*axes):
    """A panel on hinges with these axes, one after the other."""
    names = [*(f"frame_{k}" for k in range(len(axes) - 1)), "panel"]
    bodies = [
        Body.solid(name, Cylinder([0, 0, -0.1], [0, 0, 0.1], radius=0.1), density=1000) for name in names
    ]
    joints = [
        Revolute(f"hinge_{k}", before, name, [0, 0, 0], axis=axis)
        for k, (before, name, axis) in enumerate(zip(["ground", *names], names, axes, strict=False))
    ]
    return Scene("panel", Mechanism([Body.ground(), *bodies], joints), 1.0, 0.1)


@pytest.fixture(scope="module")
def gimbal():
    return panel_scene([0, 1, 0], [1, 0, 0])


def on_panel(weather, tilt, azimuth):
    """kWh/m^2 on a panel with tilt and azimuth (n,), degrees, by an own call of pvlib."""
    sun = pvlib.solarposition.get_solarposition(
        weather.times, PLACE.latitude, PLACE.longitude, PLACE.altitude, method="nrel_numpy"
    )
    total = pvlib.irradiance.get_total_irradiance(
        surface_tilt=tilt(sun) if callable(tilt) else tilt,
        surface_azimuth=azimuth(sun) if callable(azimuth) else azimuth,
        solar_zenith=sun["apparent_zenith"],
        solar_azimuth=sun["azimuth"],
        dni=pd.Series(weather.dni, weather.times),
        ghi=pd.Series(weather.ghi, weather.times),
        dhi=pd.Series(weather.dhi, weather.times),
        dni_extra=pvlib.irradiance.get_extra_radiation(weather.times),
        albedo=0.2,
        model="haydavies",
    )
    return float(np.nansum(total["poa_global"])) / 1000.0


def test_irradiation_is_that_of_pvlib(weather):
    """This tracker points as close to the sun as 30 degrees allow, in its azimuth."""
    year = tracker_year(sun_tracker(), PANEL_NORMAL, weather, Tracking(max_tilt=30.0))
    expected = {
        THIS: on_panel(
            weather, lambda sun: np.minimum(sun["apparent_zenith"], 30.0), lambda sun: sun["azimuth"]
        ),
        FLAT: on_panel(weather, 0.0, 180.0),
        FIXED: on_panel(weather, PLACE.latitude, 180.0),
        FACING: on_panel(weather, lambda sun: sun["apparent_zenith"], lambda sun: sun["azimuth"]),
    }
    for name, value in expected.items():
        assert year.light[name] == pytest.approx(value, rel=1e-9), name
        assert year.by_month[name].sum() == pytest.approx(year.light[name])
    assert np.all(year.by_month[THIS] > 0.0)
    # the strokes are those of the poses
    low, high = year.strokes["slide_12"]
    assert -0.02 < low < high < 0.07


def test_two_axes_always_face_the_sun(weather, gimbal):
    year = tracker_year(gimbal, NORMAL, weather, Tracking(max_tilt=90.0))
    up = year.sun.is_up
    assert np.max(year.off_sun[up]) < 1e-6
    assert year.light[THIS] == pytest.approx(year.light[FACING], rel=1e-3)  # below the horizon it waits
    assert year.hours(Limit.NONE) == np.sum(up)
    assert abs(year.lost_by(Limit.NONE)) < 1e-6


def test_one_axis_is_that_of_pvlib(weather):
    """The nearest pose to the sun of a hinge from south to north; pvlib's row turns by 90 degrees at most."""
    year = tracker_year(panel_scene([0, 1, 0]), NORMAL, weather, Tracking(max_tilt=90.0))
    up = year.sun.is_up
    zenith, azimuth = 90.0 - np.degrees(year.sun.elevation), np.degrees(year.sun.azimuth)
    row = pvlib.tracking.singleaxis(zenith, azimuth, max_angle=90, backtrack=False)
    assert np.max(np.abs(np.degrees(year.off_sun) - row["aoi"])[up]) < 1e-4
    assert year.hours(Limit.REACH) > 0.95 * np.sum(up)
    assert year.light[ONE_AXIS] < year.light[THIS] < year.light[FACING]


def test_losses_add_up_to_what_the_panel_lacks(weather, gimbal):
    tracking = Tracking(max_tilt=50.0, pitch=2.0, stow=6.0)
    year = tracker_year(gimbal, NORMAL, weather, tracking)
    lost = {limit: year.lost_by(limit) for limit in Limit}
    assert sum(lost.values()) == pytest.approx(year.light[FACING] - year.light[THIS])
    assert sum(year.hours(limit) for limit in Limit) == len(weather.times)
    up = year.sun.is_up
    windy = up & (weather.wind >= 6.0)
    assert year.hours(Limit.WIND) == np.sum(windy) > 0
    assert np.allclose(year.normals[windy], [0.0, 0.0, 1.0], rtol=0.0, atol=1e-9)
    # by the elevation alone: a tilt above 50 degrees below 40; shadows on rows 2 lengths away below 30
    elevation, calm = np.degrees(year.sun.elevation), up & ~windy
    sine = 2.0 * np.sin(np.maximum(year.sun.elevation, 0.0))
    without_shadow = np.degrees(np.arcsin(np.minimum(sine, 1.0))) - elevation
    shadowed = calm & (sine < 1.0) & (without_shadow < 50.0)
    assert np.array_equal(calm & (elevation >= 40.0), year.limits == Limit.NONE)
    assert np.array_equal(shadowed, year.limits == Limit.SHADOW)
    assert np.array_equal(calm & (elevation < 40.0) & ~shadowed, year.limits == Limit.TILT)
    assert np.sum(shadowed) > 0


def test_dead_bands_cost_a_little(weather, gimbal):
    year = tracker_year(gimbal, NORMAL, weather, Tracking(deadband=5.0, max_tilt=90.0))
    off = np.degrees(year.off_sun[year.sun.is_up])
    assert 2.0 < np.max(off) < 5.0 + 0.1
    assert 0.0 < year.lost_by(Limit.NONE) < (1.0 - np.cos(np.radians(5.0))) * year.light[FACING]
    # a dead band of 60 degrees does not keep the panel from lying flat in wind
    windy = year.sun.is_up & (weather.wind >= 6.0)
    stows = tracker_year(gimbal, NORMAL, weather, Tracking(deadband=60.0, max_tilt=90.0, stow=6.0))
    assert np.allclose(stows.normals[windy], [0.0, 0.0, 1.0], rtol=0.0, atol=1e-9)


def test_strokes_stop_both_axes(weather, gimbal):
    """The normal is R_y(a) R_x(b) z = (sin a cos b, -sin b, cos a cos b); both angles stop at 20 degrees."""
    ends = (-np.radians(20.0), np.radians(20.0))
    strokes = {"hinge_0": ends, "hinge_1": ends}
    year = tracker_year(gimbal, NORMAL, weather, Tracking(max_tilt=90.0), strokes=strokes)
    up = year.sun.is_up
    x, y, z = year.sun.direction[up].T
    a, b = (np.clip(each, *ends) for each in (np.arctan2(x, z), -np.arcsin(y)))
    expected = np.stack([np.sin(a) * np.cos(b), -np.sin(b), np.cos(a) * np.cos(b)], axis=1)
    assert np.max(np.abs(year.normals[up] - expected)) < 1e-7
    stopped = (np.abs(np.arctan2(x, z)) > ends[1]) | (np.abs(np.arcsin(y)) > ends[1])
    assert year.hours(Limit.STROKE) == np.sum(stopped) > 0.5 * np.sum(up)
    for low, high in year.strokes.values():
        assert (low, high) == pytest.approx(ends)
    with pytest.raises(CrosscheckError, match="stroke of 'hinge_2'"):
        tracker_year(gimbal, NORMAL, weather, Tracking(), strokes={"hinge_2": ends})
    assert stroke_of("slide=-1:2") == ("slide", (-1.0, 2.0))
    for text in ("", "a", "a=1", "a=2:1", "=1:2", "a=1:2:3", "a=x:y"):
        with pytest.raises(CrosscheckError, match="--stroke"):
            stroke_of(text)


@pytest.mark.slow
def test_a_bar_turns_until_it_comes_close_to_the_ground(weather):
    """A bar of 2 x 0.5 m turns about y, 0.3 m above a beam; it keeps 0.01 m: sin(angle) is 0.29 / 0.5."""
    beam = Cylinder([-1.0, 0.0, -0.31], [1.0, 0.0, -0.31], radius=0.01)
    bar = Body.solid("bar", Cylinder([-0.5, 0.0, 0.0], [0.5, 0.0, 0.0], radius=0.001), density=1000)
    frame = Body.solid("frame", Cylinder([0, -0.01, 0], [0, 0.01, 0], radius=0.001), density=1000)
    joints = [
        Revolute("turn", "ground", "frame", [0, 0, 0], axis=[0, 1, 0]),
        Fixed("weld", "frame", "bar", [0, 0, 0]),
    ]
    scene = Scene("bar", Mechanism([Body.ground(shapes=(beam,)), frame, bar], joints), 1.0, 0.1)
    year = tracker_year(scene, Axis("bar", [0, 0, 1]), weather, Tracking(max_tilt=90.0, clearance=0.01))
    blocked = year.limits == Limit.COLLISION
    tilt = np.degrees(np.arccos(np.clip(year.normals[:, 2], -1.0, 1.0)))
    assert np.sum(blocked) > 20
    largest = np.degrees(np.arcsin((0.3 - 0.01) / 0.5))
    assert np.max(np.abs(tilt[blocked] - largest)) < 0.5
    assert np.max(tilt) < largest + 0.5
    assert year.notes == ()
    # bodies that are nearer than the clearance in the flat pose are too close where they overlap
    near = tracker_year(scene, Axis("bar", [0, 0, 1]), weather, Tracking(max_tilt=90.0, clearance=0.4))
    blocked = near.limits == Limit.COLLISION
    tilt = np.degrees(np.arccos(np.clip(near.normals[:, 2], -1.0, 1.0)))
    assert np.sum(blocked) > 20
    assert np.max(np.abs(tilt[blocked] - np.degrees(np.arcsin(0.3 / 0.5)))) < 0.5
    (note,) = near.notes
    assert "nearer than the clearance" in note
    assert "bar" in note


def test_wind_is_needed_for_stowing(weather, gimbal):
    with pytest.raises(CrosscheckError, match="sample has no wind, which --stow needs"):
        tracker_year(gimbal, NORMAL, replace(weather, wind=None), Tracking(stow=6.0))
    dark = replace(weather, place=Place(90.0, 0.0), ghi=0.0 * weather.ghi)
    winter = np.arange(24)
    dark = replace(
        dark, times=weather.times[winter], **dict.fromkeys(("dni", "ghi", "dhi"), weather.ghi[winter] * 0.0)
    )
    with pytest.raises(CrosscheckError, match="the sun never rises"):
        tracker_year(gimbal, NORMAL, dark, Tracking())


def test_power_of_a_module(weather, gimbal):
    """PVWatts with Faiman's temperature, written out."""
    module = Module(area=1.7, efficiency=0.21, temperature_coefficient=-0.004)
    year = tracker_year(gimbal, NORMAL, weather, Tracking(max_tilt=90.0), module=module)
    light = year.irradiance[THIS]
    cell = weather.temperature + light / (25.0 + 6.84 * weather.wind)
    expected = 1.7 * 0.21 * light * (1.0 - 0.004 * (cell - 25.0))
    assert np.allclose(year.power, expected, rtol=1e-12, atol=1e-9)
    simple = replace(year, module=Module(1.7, 0.21))
    assert np.allclose(simple.power, 1.7 * 0.21 * light, rtol=1e-12, atol=1e-9)
    for numbers in ((0.0, 0.2), (1.0, 20.0), (1.0, 0.2, -0.35)):
        with pytest.raises(CrosscheckError):
            Module(*numbers)


def rotation_matrix(roll, pitch, yaw):
    """Rotation of a base, written out: yaw, then pitch about its y, then roll about its x; angles in rad."""
    (sr, sp, sy), (cr, cp, cy) = np.sin([roll, pitch, yaw]), np.cos([roll, pitch, yaw])
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def test_rotations_of_a_base():
    motions = {"roll": Sine(0.3, 1.1), "pitch": Sine(0.2, 0.7), "yaw": Sine(2.0, 0.1, phase=0.4)}
    times = np.array([0.0, 1.3, 7.7])
    expected = [
        rotation_matrix(0.3 * np.sin(1.1 * t), 0.2 * np.sin(0.7 * t), 2.0 * np.sin(0.1 * t + 0.4))
        for t in times
    ]
    assert np.allclose(Base(motions).rotations(times), expected, rtol=0.0, atol=1e-14)
    # a ship that heads north: its x axis points north, its y axis west
    north = Base.at_rest(heading=0.0).rotations(np.zeros(1))[0]
    assert np.allclose(north, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], rtol=0.0, atol=1e-15)
    assert np.allclose(
        base_of("roll=20,heading=0").rotations(np.zeros(1))[0],
        rotation_matrix(np.radians(20.0), 0.0, np.pi / 2),
    )
    for text in ("", "roll", "roll=x", "roll=1,roll=2", "yaw=3", "roll=400"):
        with pytest.raises(CrosscheckError, match="--base"):
            base_of(text)
    with pytest.raises(CrosscheckError, match="unknown motion 'rol'"):
        Base({"rol": Sine(0.3, 1.1)})


def test_a_base_that_leans_by_the_latitude_carries_a_fixed_panel(weather):
    """The flat panel on it is tilted by the latitude; the tracker's largest tilt is relative to the base."""
    leaning = Base.at_rest(roll=PLACE.latitude)
    year = tracker_year(sun_tracker(), PANEL_NORMAL, weather, Tracking(max_tilt=30.0), base=leaning)
    assert year.light[FLAT_ON_BASE] == pytest.approx(year.light[FIXED], rel=1e-12)
    axis = rotation_matrix(np.radians(PLACE.latitude), 0.0, 0.0) @ [0.0, 0.0, 1.0]
    lit = year.lit
    from_base = np.degrees(np.arccos(np.clip(year.normals[lit] @ axis, -1.0, 1.0)))
    assert np.max(from_base) < 30.0 + 1e-6
    # within these 30 degrees it faces the sun
    near = year.sun.direction @ axis > np.cos(np.radians(30.0))
    assert np.max(year.off_sun[near & year.sun.is_up]) < 1e-6
    # a base with its x axis to the south leans to the south by its pitch
    turned = Base.at_rest(heading=180.0, pitch=PLACE.latitude)
    other = tracker_year(sun_tracker(), PANEL_NORMAL, weather, Tracking(max_tilt=30.0), base=turned)
    assert other.light[THIS] == pytest.approx(year.light[THIS], rel=1e-9)


def test_a_turning_base_does_not_keep_two_axes_from_the_sun(weather, gimbal):
    """A ship that turns all the time and leans up to 10 degrees."""
    hours = 3600.0 * np.arange(len(weather.times) + 1.0)
    sway = Spline(hours, np.radians(10.0) * np.sin(hours / 5e4))
    base = Base({"yaw": Spline(hours, hours / 3e4), "roll": sway})
    year = tracker_year(gimbal, NORMAL, weather, Tracking(max_tilt=90.0), base=base)
    faces = year.limits == Limit.NONE
    assert np.sum(faces) > 0.9 * np.sum(year.sun.is_up)
    assert np.max(year.off_sun[faces]) < 1e-6


def test_a_day_on_a_base_that_leans():
    """Normals turned to the world face the sun; sliders hold the turned weight by virtual work; the panel has
    the light of one that faces the sun, less that of a lag of 7.5 degrees, 0.9 % of the beam."""
    base, bodies = Base.at_rest(heading=60.0, roll=8.0, pitch=-5.0), slice(1, None)
    place = Place(11.56, 104.92)
    day = tracker_day(sun_tracker(), PANEL_NORMAL, place, "2026-03-21", period=1800.0, base=base)
    turn = rotation_matrix(np.radians(8.0), np.radians(-5.0), np.radians(30.0))
    assert day.faces.sum() >= 5
    sun = pvlib.solarposition.get_solarposition(
        day.sun.times, place.latitude, place.longitude, method="nrel_numpy"
    )
    zenith, azimuth = (np.radians(sun[name].to_numpy()) for name in ("apparent_zenith", "azimuth"))
    towards = np.stack(
        [np.sin(zenith) * np.sin(azimuth), np.sin(zenith) * np.cos(azimuth), np.cos(zenith)], axis=1
    )
    rows = np.flatnonzero(day.faces)[1:]
    off = np.linalg.norm(np.cross(day.normals[rows] @ turn.T, towards[rows - 1]), axis=1)
    assert off.max() < 1e-4
    assert day.irradiance[THIS][rows] == pytest.approx(day.irradiance[FACING][rows], rel=0.012)
    # the weight in the axes of the base, along the poses of a slider's motion
    k, step = int(rows[2]) - 1, 1e-4
    weight = turn.T @ [0.0, 0.0, -9.81]
    at = {name: values[k] for name, values in day.set_points.items()}
    for name, actuator in day.actuators.items():
        moved = {each: np.array([value, value]) for each, value in at.items()}
        moved[name] = at[name] + step * np.array([-1.0, 1.0])
        poses = solve_poses(sun_tracker(), moved, start=day.poses.state(k))
        each = np.array([body.mass for body in day.scene.mechanism.bodies])[bodies]
        low, high = -np.einsum("nbi,i,b->n", poses.position[:, bodies], weight, each)
        assert actuator.holding[k + 1] == pytest.approx((high - low) / (2.0 * step), abs=1e-5)
    with pytest.raises(CrosscheckError, match="yaw varies with time; needed: a base at rest"):
        tracker_day(sun_tracker(), PANEL_NORMAL, place, "2026-03-21", base=Base({"yaw": Sine(0.1, 1.0)}))


@pytest.mark.slow
def test_set_points_face_the_sun_from_a_moving_base():
    """Simulated: the panel follows a fixed direction while its base rolls by 6 degrees and turns by 20."""
    period, count = 0.25, 13
    towards = np.array([0.2, -0.25, 1.0]) / np.linalg.norm([0.2, -0.25, 1.0])
    base = Base({"roll": Sine(0.1, 0.8), "yaw": Sine(0.35, 0.3), "heave": Sine(0.05, 0.8)})
    scene, poses = following_on_base(sun_tracker(), PANEL_NORMAL, np.tile(towards, (count, 1)), base, period)
    assert poses.reached.all()
    # the poses, turned by an own calculation
    times = period * np.arange(count)
    turned = [
        rotation_matrix(0.1 * np.sin(0.8 * t), 0.0, 0.35 * np.sin(0.3 * t)) @ direction
        for t, direction in zip(times, poses.direction, strict=True)
    ]
    assert np.max(np.abs(turned - towards)) < 1e-8
    # the motion: from the quaternion of the panel to its z axis
    simulated = simulate(scene)
    w, x, y, z = simulated.quaternion[:, simulated.body_names.index("panel_7")].T
    normals = np.stack([2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)], axis=1)
    settled = simulated.time > 1.0
    assert np.max(np.linalg.norm(np.cross(normals, towards), axis=1)[settled]) < 1e-4
    # at rest the weight is fed forward in the axes of the base: nothing moves
    still, _ = following_on_base(
        sun_tracker(), PANEL_NORMAL, np.tile(towards, (6, 1)), Base.at_rest(roll=10.0, heading=80.0), period
    )
    slide = simulate(still).joint("slide_12").coordinates
    assert np.ptp(slide) < 1e-9
    with pytest.raises(CrosscheckError, match="set-points need PD controllers"):
        following_on_base(panel_scene([0, 1, 0]), NORMAL, np.tile(towards, (6, 1)), base, period)


@pytest.mark.parametrize(
    ("latitude", "longitude", "away"),
    [
        (PLACE.latitude + 0.4, PLACE.longitude, None),
        (PLACE.latitude, PLACE.longitude - 0.6, None),  # 0.6 degrees by the cosine of the latitude
        (PLACE.latitude - 0.6, PLACE.longitude, 0.6),
        (PLACE.latitude, -PLACE.longitude, None),
        (-PLACE.latitude, PLACE.longitude, 2.0 * abs(PLACE.latitude)),
    ],
)
def test_weather_is_of_the_place(weather, latitude, longitude, away):
    """The angle between both places by the spherical law of cosines."""
    north = np.radians([PLACE.latitude, latitude])
    turn = np.cos(np.radians(longitude - PLACE.longitude))
    angle = np.degrees(np.arccos(np.prod(np.sin(north)) + np.prod(np.cos(north)) * turn))
    assert away is None or angle == pytest.approx(away, abs=1e-6)
    if angle < 0.5:
        check_place(weather, Place(latitude, longitude))
        return
    with pytest.raises(
        CrosscheckError, match=rf"sample is of .*, {angle:.1f} degrees \({111.2 * angle:.0f} km\)"
    ):
        check_place(weather, Place(latitude, longitude))


def test_the_place_of_a_weather_file_is_checked(tmp_path, capsys):
    file = tmp_path / "town.csv"
    file.write_text(synthetic.tmy3()[0])
    given = [
        "year",
        "--weather",
        file,
        "--latitude",
        "-33",
        "--longitude",
        "151",
        "--output",
        tmp_path / "out",
    ]
    status, _, error = run(capsys, *given)
    assert (status, "needed: weather of a place within 0.5 degrees" in " ".join(error.split())) == (2, True)
    assert not (tmp_path / "out" / "year.json").exists()


@pytest.mark.slow
def test_the_command_writes_what_it_prints(tmp_path, capsys):
    """Any mechanism with a face; sums of the files by an own addition."""
    model, file, out = tmp_path / "gimbal.xml", tmp_path / "town.csv", tmp_path / "out"
    model.write_text(GIMBAL_MJCF)
    file.write_text(synthetic.tmy3()[0])
    given = ["year", model, "--axis", "panel=0,0,1", "--weather", file, "--output", out]
    given += ["--area", "2", "--efficiency", "0.2", "--max-tilt", "60"]
    status, printed, _ = run(capsys, *given)
    assert status == 0
    content = json.loads((out / "year.json").read_text())
    hours, months = csv_rows(out / "hours.csv"), csv_rows(out / "months.csv")
    total = sum(float(row["this_tracker_W_per_m2"]) for row in hours) / 1000.0
    assert content["irradiation"][THIS] == pytest.approx(total, rel=1e-6)
    assert sum(float(row["this tracker kWh/m^2"]) for row in months) == pytest.approx(total, rel=1e-5)
    assert content["electric"][THIS] == pytest.approx(0.4 * total, rel=1e-6)
    fixed = sum(float(row["tilted_by_the_latitude_W_per_m2"]) for row in hours) / 1000.0
    assert content["electric"][FIXED] == pytest.approx(0.4 * fixed, rel=1e-6)
    assert re.search(rf"electric, kWh +{0.4 * total:.1f} .* {0.4 * fixed:.1f} ", printed)
    assert content["hours"]["none"] == sum(row["limit"] == "none" for row in hours)
    assert re.search(rf"^year +{total:.1f} ", printed, re.MULTILINE)
    # the page, and the folder is protected
    assert run(capsys, "report", out)[0] == 0
    assert "lost" in (out / "report.html").read_text()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "needed: --weather FILE, or --latitude, --longitude and --year for a clear sky"),
        (
            ["--latitude", "5"],
            "needed: --weather FILE, or --latitude, --longitude and --year for a clear sky",
        ),
        (["--weather", "none.csv", "--latitude", "5"], "--latitude and --longitude check the place of"),
        (["--weather", "none.csv", "--altitude", "5"], "--weather has the altitude; leave out --altitude"),
        (["--weather", "none.csv"], "none.csv: cannot be read: No such file"),
        (
            ["pendulum", "--latitude", "5", "--year", "2026"],
            "needed: --axis BODY=X,Y,Z, the normal of a face; ",
        ),
        (["--latitude", "5", "--year", "2026", "--area", "2"], "--area, --efficiency and --temp"),
        (["--latitude", "5", "--year", "2026", "--set", "x=1"], "unknown option 'x' of scene 'tracker_sun'"),
        (["tracker_sun", "--latitude", "5", "--year", "2026", "--set", "x=1"], "unknown option 'x' of scene"),
        (["--latitude", "5", "--year", "2026", "--stow", "9"], "clear sky of 2026 has no wind"),
        (["--latitude", "95", "--year", "2026"], "latitude 95.0 is off the globe"),
    ],
)
def test_usage_of_the_command(tmp_path, capsys, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    status, _, error = run(capsys, "year", *arguments)
    assert status == 2
    assert " ".join(error.split()).startswith(f"crosscheck: error: {message}")
