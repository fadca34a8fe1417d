"""Positions of the sun over a year that a face can reach."""

import csv
import io
import json

import numpy as np
import pandas as pd
import pvlib
import pytest
from command_line import run

import mjcf
from crosscheck.library.tracker_sun import PANEL_NORMAL, sun_tracker
from crosscheck.solar.day import tracker_day
from crosscheck.solar.obstacles import Cause
from crosscheck.solar.place import Place
from crosscheck.solar.reach import reach_csv, reach_over_year, reach_picture, reach_table
from crosscheck.solar.report import DAY_FILES, REACH_FILES, day_report
from crosscheck.solar.results import write_day
from crosscheck.solar.tracking import Tracking
from newton_euler import Axis

PLACE, YEAR = Place(37.4, -6.0), 2026

GIMBAL = """<mujoco model="gimbal">
  <worldbody>
    <body name="ring" pos="0 0 2">
      <joint name="turn" type="hinge" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      <body name="table">
        <joint name="tilt" type="hinge" axis="0 1 0"/>
        <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      </body>
    </body>
  </worldbody>
  <actuator><position joint="turn" kp="100"/><position joint="tilt" kp="100"/></actuator>
</mujoco>"""

ROW = """<mujoco model="row">
  <worldbody>
    <body name="table" pos="0 0 2">
      <joint name="tube" type="hinge" axis="0 1 0"/>
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
    </body>
  </worldbody>
  <actuator><position joint="tube" kp="100"/></actuator>
</mujoco>"""


def scene_of(folder, text):
    path = folder / "model.xml"
    path.write_text(text)
    return mjcf.read(path).scene


@pytest.fixture(scope="module")
def few_hours():
    """Every 53rd hour of the year, so that all times of day and of the year are among them."""
    date_range = pd.date_range
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pd, "date_range", lambda *given, **named: date_range(*given, **named)[::53])
        yield sun_of_few_hours(date_range)


def sun_of_few_hours(date_range):
    """Positions of the sun above the horizon, by an own call of pvlib."""
    times = date_range("2026-01-01", "2027-01-01", freq="h", inclusive="left", tz="UTC")[::53]
    found = pvlib.solarposition.get_solarposition(times, PLACE.latitude, PLACE.longitude)
    return found[found["apparent_elevation"] > 0.0]


def test_gimbals_reach_every_direction_but_their_own_axis(tmp_path, few_hours):
    """About an upright axis and one across it: singular where the face is upright, which the sun never is."""
    reach = reach_over_year(
        scene_of(tmp_path, GIMBAL), Axis("table", [1.0, 0.0, 0.0]), PLACE, YEAR, Tracking(max_tilt=60.0)
    )
    assert len(reach.cause) == len(few_hours)
    assert (reach.cause == Cause.FREE).all()
    assert reach.off.max() < 1e-8
    assert np.array_equal(reach.is_within_tilt, few_hours["apparent_zenith"].to_numpy() <= 60.0)
    rows = reach_table(reach).rows
    assert [row[1:3] for row in rows] == [[str(len(few_hours)), "100.0"]]


def test_rows_leave_the_angle_of_incidence_of_pvlib(tmp_path, few_hours):
    reach = reach_over_year(
        scene_of(tmp_path, ROW), Axis("table", [0.0, 0.0, 1.0]), PLACE, YEAR, Tracking(max_tilt=90.0)
    )
    expected = pvlib.tracking.singleaxis(
        few_hours["apparent_zenith"], few_hours["azimuth"], axis_azimuth=0.0, max_angle=90.0, backtrack=False
    )["aoi"]
    by_day = few_hours["apparent_elevation"].to_numpy() > 1.0
    off = np.degrees(reach.off)
    assert (
        np.abs(off - expected.to_numpy())[by_day].max() < 1e-3
    )  # degrees, of refraction at another pressure
    assert (reach.cause == Cause.FREE).all()


@pytest.fixture(scope="module")
def reach(few_hours):
    """What the library's tracker reaches."""
    return reach_over_year(sun_tracker(), PANEL_NORMAL, PLACE, YEAR, Tracking())


def test_the_library_s_tracker_reaches_a_part(few_hours, reach):
    """The reach ends between 33 and 60 degrees of tilt, depending on azimuth."""
    tilt = few_hours["apparent_zenith"].to_numpy()
    assert (reach.cause[tilt < 33.0] == Cause.FREE).all()
    assert (reach.cause[tilt > 70.0] != Cause.FREE).mean() > 0.3
    assert {Cause.COLLISION, Cause.UNREACHABLE} <= set(reach.cause)
    rows = list(csv.DictReader(io.StringIO(reach_csv(reach).decode())))
    assert len(rows) == len(tilt)
    assert [row["blocked"] == "" for row in rows] == (reach.cause == Cause.FREE).tolist()
    counts = [int(row[1]) for row in reach_table(reach).rows]
    assert sum(counts) == len(tilt)
    assert len(reach_picture(reach).axes[0].lines) == len(counts) + 1


@pytest.mark.slow
def test_the_year_is_beside_the_day(tmp_path, reach):
    scene = sun_tracker()
    day = tracker_day(scene, PANEL_NORMAL, PLACE, f"{YEAR}-06-21", period=7200.0)
    paths = [tmp_path / name for name in (*DAY_FILES, *REACH_FILES)]
    report = day_report(day, reach)
    assert write_day(day, report, paths, "tracker_sun", {}, reach) == paths
    assert all(path.is_file() for path in paths)
    assert {"day.png", "day.rrd", "reach.png"} == set(json.loads(paths[0].read_text())["files"])
    assert any("the face can reach" in part.title for part in report.summary)


def test_a_year_is_that_of_one_day(capsys):
    dates = ("--date", "2026-03-21", "--date", "2026-06-21")
    status, _, err = run(capsys, "sun", "--latitude", "10", *dates, "--reach")
    assert status == 2
    assert "--reach is for one place and one date" in err
