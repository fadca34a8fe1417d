"""Trackers of one axis and other scenes: the rows of pvlib, closed forms, result files and pages."""

import json

import numpy as np
import pvlib
import pytest
from command_line import csv_rows, run

import mjcf
from crosscheck.report.page import write_report
from crosscheck.solar.day import tracker_day
from crosscheck.solar.one_axis import aim_of, turns_about_one_axis
from crosscheck.solar.place import Place, day_times, sun_over
from crosscheck.solar.tracking import Tracking
from newton_euler import Axis
from newton_euler.analysis.loads.actuator_motions import demand
from newton_euler.analysis.loads.motion_files import read_motions

SEVILLE, DATE = Place(37.4, -6.0), "2026-06-21"
MASS, HEIGHT, G = 30.0, 0.1, 9.81
"""kg, m, m/s^2: the panel's center of mass is above the tube."""

ROW = """<mujoco model="row">
  <option gravity="0 0 -9.81"/>
  <worldbody>
    <body name="table" pos="0 0 2">
      <joint name="tube" type="hinge" axis="0 {0} {1}"/>
      <geom type="box" size="1 2 0.02" mass="30" pos="0 0 0.1"/>
    </body>
  </worldbody>
  <actuator><position name="drive" joint="tube" kp="20000" kv="2000"/></actuator>
</mujoco>"""


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """A row that turns about a horizontal axis from south to north."""
    path = tmp_path_factory.mktemp("row") / "row.xml"
    path.write_text(ROW.format(1, 0))
    return path


@pytest.fixture(scope="module")
def scene(model):
    return mjcf.read(model).scene


def rows_of_pvlib(sun, **options):
    """Normals (n, 3) of pvlib's tracker; NaN at night."""
    found = pvlib.tracking.singleaxis(90.0 - np.degrees(sun.elevation), np.degrees(sun.azimuth), **options)
    tilt, azimuth = (np.radians(np.asarray(found[f"surface_{name}"])) for name in ("tilt", "azimuth"))
    return np.stack([np.sin(tilt) * np.sin(azimuth), np.sin(tilt) * np.cos(azimuth), np.cos(tilt)], axis=1)


@pytest.mark.parametrize(
    ("tracking", "options"),
    [
        (Tracking(max_tilt=60.0), {"max_angle": 60.0, "backtrack": False}),
        (Tracking(max_tilt=60.0, pitch=2.5), {"max_angle": 60.0, "backtrack": True, "gcr": 1.0 / 2.5}),
    ],
)
def test_rows_turn_as_those_of_pvlib(scene, tracking, options):
    """1e-6 rad, with and without backtracking: set-points of the hinge, by day."""
    day = tracker_day(scene, Axis("table", [0.0, 0.0, 1.0]), SEVILLE, DATE, None, tracking, 1800.0)
    expected = rows_of_pvlib(day.sun, axis_azimuth=0.0, **options)
    by_day = day.sun.elevation > np.radians(0.1)
    angle = np.arctan2(expected[:, 0], expected[:, 2])
    assert by_day.sum() > 25
    assert np.abs(day.set_points["tube"] - angle)[by_day].max() < 1e-6
    assert not day.faced.replaced.any()
    # what one axis leaves of the way to the sun, where nothing limits it
    assert day.faces.sum() > 5
    left = np.arccos(np.sum(expected * day.sun.direction, axis=1))
    assert np.abs(day.error_parts["one axis only"] - left)[day.faces].max() < 1e-6


def test_moves_at_night_may_last_longer_than_a_period(scene):
    """At 0.5 mrad/s the row follows the sun; the 120 degrees to the next morning take 70 minutes."""
    tracking = Tracking(max_tilt=60.0, speed=5e-4)
    day = tracker_day(scene, Axis("table", [0.0, 0.0, 1.0]), SEVILLE, DATE, None, tracking, 1800.0)
    assert np.degrees(day.error_parts["motion, control and wind load"]).max() > 20.0
    assert not day.off_set_points.any()


def test_tilted_axes_turn_as_those_of_pvlib(tmp_path):
    """An axis that rises to the north by 20 degrees, and a face that looks south at rest."""
    path, tilt = tmp_path / "tilted.xml", np.radians(20.0)
    path.write_text(ROW.format(np.cos(tilt), np.sin(tilt)))
    sun = sun_over(SEVILLE, day_times("2026-03-21", "UTC", 1800.0))
    aim = aim_of(mjcf.read(path).scene, Axis("table", [0.0, -np.sin(tilt), np.cos(tilt)]), sun)
    expected = rows_of_pvlib(sun, axis_tilt=20.0, axis_azimuth=180.0, max_angle=90.0, backtrack=False)
    by_day = sun.elevation > np.radians(2.0)
    across = np.linalg.norm(np.cross(aim.direction, expected), axis=1)[by_day]
    assert by_day.sum() > 20
    assert across.max() < 1e-6


def test_mechanisms_with_two_freedoms_aim_at_the_sun():
    from crosscheck.library.tracker_sun import PANEL_NORMAL, sun_tracker

    sun = sun_over(SEVILLE, day_times(DATE, "UTC", 3600.0))
    assert aim_of(sun_tracker(), PANEL_NORMAL, sun) is sun


def test_planar_arms_turn_a_face_about_one_axis(tmp_path):
    """Two hinges with parallel axes, and two that are not parallel."""
    second = (
        '<body name="{0}"><joint name="{0}" type="hinge" axis="{1}"/><geom size="0.1" pos="0 0 1"/>{2}</body>'
    )
    for axis, expected in (("0 1 0", True), ("1 0 0", False)):
        path = tmp_path / "arm.xml"
        inner = second.format("hand", axis, "")
        actuators = '<position joint="arm" kp="9"/><position joint="hand" kp="9"/>'
        arm = second.format("arm", "0 1 0", inner)
        path.write_text(f"<mujoco><worldbody>{arm}</worldbody><actuator>{actuators}</actuator></mujoco>")
        arm_scene = mjcf.read(path).scene
        assert turns_about_one_axis(arm_scene, Axis("hand", [0.0, 0.0, 1.0])) == expected


@pytest.fixture(scope="module")
def results(model, tmp_path_factory):
    """Result folder of the command for the row, with a set-point every hour."""
    from click.testing import CliRunner

    from crosscheck.cli import cli

    folder = tmp_path_factory.mktemp("results")
    place = ["--latitude", "37.4", "--longitude", "-6", "--date", DATE, "--period", "3600"]
    arguments = [
        "sun",
        str(model),
        "--axis",
        "table=0,0,1",
        "--max-tilt",
        "60",
        *place,
        "--output",
        str(folder),
    ]
    done = CliRunner().invoke(cli, arguments, standalone_mode=False)
    assert done.exception is None
    return folder


def test_set_points_and_forces_are_in_a_table(results):
    """The torque that holds the panel is that of its weight: the center of mass is above the tube."""
    rows = csv_rows(results / "set_points.csv")
    assert len(rows) == 25
    angle, holding = (
        np.array([float(row[name]) for row in rows]) for name in ("tube_rad", "tube_holding_N_m")
    )
    # just before each set-point, the panel is where the previous one was
    expected = -MASS * G * HEIGHT * np.sin(angle[:-1])
    assert np.abs(holding[1:] - expected).max() < 1e-5
    noon = rows[12]
    normal = [float(noon[f"wanted_{axis}"]) for axis in "xyz"]
    assert normal == pytest.approx([np.sin(angle[12]), 0.0, np.cos(angle[12])], abs=1e-7)
    assert noon["clearance_m"] == ""  # no two bodies without a common joint
    assert float(noon["irradiance_W_per_m2"]) > 900.0
    assert (rows[3]["may_face_sun"], rows[14]["may_face_sun"]) == ("0", "1")


def test_sums_are_in_a_json(results):
    content = json.loads((results / "sun.json").read_text())
    drive = content["actuators"]["tube"]
    # the file of forces and motion, for the sizing of drives, has the same largest values
    (motion,) = read_motions(str(results / "motion.csv"))
    assert (motion.name, motion.is_slide) == ("tube", False)
    found = demand(motion)
    assert found.work == pytest.approx(drive["energy"], rel=1e-12)
    assert found.peak_speed == pytest.approx(drive["speed"], rel=1e-12)
    # at rest includes the slow end of the transient after a move
    assert found.holding_force == pytest.approx(abs(drive["holding"]["force"]), rel=0.02)
    assert drive["unit"] == "N m"
    largest = MASS * G * HEIGHT * np.sin(np.radians(60.0))
    assert abs(drive["holding"]["force"]) == pytest.approx(largest, rel=1e-4)
    # the speed of the set-points is limited to 0.01 rad/s, with an overshoot of the controller
    assert 0.01 <= drive["speed"] < 0.011
    assert content["blocked_hours"] == {"too close": 0.0, "near singular": 0.0, "out of reach": 0.0}
    assert content["irradiation"]["facing the sun"] > content["irradiation"]["this tracker"]


def test_results_have_a_page(results):
    page = write_report(results, lambda _: None).path.read_text()
    assert "largest forces of actuators at rest and in motion" in page
    assert page.count("data:image/png;base64") >= 1


@pytest.mark.slow
@pytest.mark.parametrize("name", [(), ("tracker_sun",)])
def test_the_tracker_has_a_name(capsys, tmp_path, name):
    """With its name it has the same results as without, and a tilt of at most 30 degrees."""
    given = ("--latitude", "37.4", "--date", DATE, "--period", "7200", "--output", tmp_path)
    assert run(capsys, "sun", *name, *given)[0] == 0
    content = json.loads((tmp_path / "sun.json").read_text())
    assert (content["source"], content["scene"]) == ("tracker_sun", "tracker_sun")
    tilts = [float(each["wanted_z"]) for each in csv_rows(tmp_path / "set_points.csv")]
    assert min(tilts) == pytest.approx(np.cos(np.radians(30.0)), abs=1e-9)


@pytest.mark.parametrize("command", ["run", "loads"])
def test_other_commands_tell_the_scene_to_run(capsys, command):
    status, _, err = run(capsys, command, "tracker_sun")
    assert (status, "the scene to run is 'tracker_sun_day'" in err) == (2, True)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("tracker_gravity", "--axis", "bob=0,0,1"), "unknown body 'bob'"),
        (("pendulum",), "needed: --axis BODY=X,Y,Z"),
        (("--set", "wind=gust"), "unknown option 'wind' of scene 'tracker_sun'"),
        (("tracker_computed_torque",), "set-points need PD controllers"),
        (("tracker_wind",), "wind load 'wind' has a function of time (speed)"),
        (("tracker_gravity", "--axis", "panel_7"), "not of the form BODY=X,Y,Z"),
    ],
)
def test_scenes_that_cannot_follow_the_sun(capsys, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    status, _, err = run(capsys, "sun", *arguments, "--latitude", "10", "--date", DATE, "--period", "3600")
    assert status == 2
    assert message in err
