"""Days on a base that leans to the east: frames of results, causes of errors, flat panels, zeros."""

import csv

import numpy as np
import pytest

from crosscheck.solar.base import Base
from crosscheck.solar.day import MAX_DEVIATION, tracker_day
from crosscheck.solar.place import Place
from crosscheck.solar.report import verdict, zeros
from crosscheck.solar.results import table_of_set_points
from crosscheck.solar.tracking import Tracking
from newton_euler import PD, Axis, Body, Box, Mechanism, Revolute, Scene, Universal

NORMAL, PLACE, DATE, PERIOD = Axis("panel", [0.0, 0.0, 1.0]), Place(37.4, -6.0), "2026-06-21", 3600.0

LEAN = np.radians(20.0)
"""Pitch of the base, which lowers its x axis in the east: the sun is behind its plane in the evening."""

BASE = Base.at_rest(pitch=20.0)


def day_of(joint, base=BASE, wind=None, **rules):
    """Return a day of a panel on a joint with a controller at each coordinate."""
    panel = Body.solid("panel", Box([0.5, 0.5, 0.02], center=[0.1, 0.0, 0.2]), density=100)
    coordinates = (0, 1) if isinstance(joint, Universal) else (0,)
    control = [PD("j", 2000.0, 200.0, 0.0, coordinate) for coordinate in coordinates]
    scene = Scene(
        "panel", Mechanism([Body.ground(), panel], [joint]), 1.0, 0.1, gravity=[0, 0, -9.81], control=control
    )
    winds = None if wind is None else np.full(25, wind)
    rules = {"max_tilt": 90.0} | rules
    return tracker_day(scene, NORMAL, PLACE, DATE, None, Tracking(**rules), PERIOD, winds, base=base)


def gimbal():
    """Return a joint that turns the panel about y and x."""
    return Universal(
        "j", "ground", "panel", [0, 0, 0], axis_on_first=[0, 1, 0], axis_on_second=[1, 0, 0], actuated=True
    )


def row():
    """Return a hinge from south to north."""
    return Revolute("j", "ground", "panel", [0, 0, 0], axis=[0, 1, 0], actuated=True)


@pytest.fixture(scope="module")
def day():
    return day_of(gimbal())


def test_normals_of_the_table_are_east_north_and_up(day):
    """While nothing limits the panel, its wanted normal is the sun's direction by azimuth and elevation."""
    rows = list(csv.DictReader(table_of_set_points(day).decode().splitlines()))
    azimuth, elevation = (
        np.radians([float(each[f"sun_{name}_deg"]) for each in rows]) for name in ("azimuth", "elevation")
    )
    sun = np.stack(
        [np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth), np.sin(elevation)], axis=1
    )
    free = [each["may_face_sun"] == "1" for each in rows]
    assert sum(free) >= 8
    for kind in ("wanted", "faced"):
        normals = np.array([[float(each[f"{kind}_{axis}"]) for axis in "xyz"] for each in rows])
        assert normals[free] == pytest.approx(sun[free], abs=1e-7)


def test_a_sun_behind_the_base_is_no_error_of_one_axis(day):
    """It is one of the tilt, which is at most 90 degrees: the sun's angle below the plane of the base."""
    below = -np.arcsin(day.sun.direction @ [np.sin(LEAN), 0.0, np.cos(LEAN)])
    behind = day.sun.is_up & (below > 0.0)
    assert behind.any()
    assert day.error_parts["one axis only"].max() == 0.0
    tilt = day.error_parts["limits of tilt, shadow and wind"]
    assert tilt[behind] == pytest.approx(below[behind], abs=1e-7)
    assert (sum(day.error_parts.values()) > day.errors - 1e-9).all()


@pytest.mark.slow
def test_a_row_off_its_set_points_is_told_while_the_sun_is_behind_the_base():
    """At 0.05 mrad/s the row lags behind the sun, 0.073 mrad/s, and moves all day."""
    day = day_of(row(), speed=5e-5)
    behind = day.sun.is_up & (day.sun.direction @ [np.sin(LEAN), 0.0, np.cos(LEAN)] < 0.0)
    is_off = day.error_parts["motion, control and wind load"] > MAX_DEVIATION
    assert (behind & is_off).any()
    assert day.off_set_points[behind & is_off].all()


@pytest.mark.slow
def test_only_a_level_panel_has_no_load_in_a_horizontal_wind():
    """The panel lies flat on its base all day; on a level base it never does in a weak wind."""
    leaning, level, weak = (
        day_of(gimbal(), base, wind, stow=15.0)
        for base, wind in ((BASE, 20.0), (Base(), 20.0), (Base(), 3.0))
    )
    assert leaning.wind_acts
    assert leaning.stowed.all()
    assert [day.is_level.all() for day in (leaning, level)] == [False, True]
    texts = [verdict(day) for day in (leaning, level, weak)]
    assert ["without a load" in text for text in texts] == [False, True, False]
    assert "lies flat for 0.0 h" in texts[2]


def test_zeros_have_the_normal_of_the_face(tmp_path):
    """A hinge through the center of mass: only the normal tells the keyframe, 0.5 rad, from another pose."""
    import mjcf

    path = tmp_path / "row.xml"
    path.write_text(
        '<mujoco><worldbody><body name="panel" pos="0 0 2"><joint name="j" axis="0 1 0"/>'
        '<geom type="box" size="1 2 0.02" mass="30"/></body></worldbody>'
        '<actuator><position joint="j" kp="20000" kv="2000"/></actuator>'
        '<keyframe><key qpos="0.5"/></keyframe></mujoco>'
    )
    day = tracker_day(mjcf.read(path).scene, NORMAL, PLACE, DATE, None, Tracking(), PERIOD)
    (sentence,) = zeros(day)
    assert f"({np.sin(0.5):.5f}, 0, {np.cos(0.5):.5f})" in sentence
    assert "(0.0, 0.0, 2000.0) mm" in sentence
