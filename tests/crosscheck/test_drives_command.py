"""The command `drives`: catalogs, motions in CSV files, its tables, and what it writes."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from command_line import csv_rows, run

from crosscheck.design.drive_catalog import COLUMNS, read_catalog
from crosscheck.design.drive_plots import BINS, SPEED_BINS, drive_figure, envelope
from crosscheck.design.drive_report import DriveResults, Requirements
from newton_euler.analysis.loads.actuator_motions import ActuatorMotion
from newton_euler.analysis.loads.drives import size
from newton_euler.analysis.loads.motion_files import motions_csv, read_motions
from newton_euler.analysis.loads.power_screws import ENDS, Thread, buckling_force, critical_speed
from newton_euler.model.source_file import SourceError

CATALOG = Path(__file__).parents[2] / "examples" / "drives.csv"

HEADER = "name,rated_torque [N cm],rated_speed [rpm]"

MOTION = "time,lift.force,lift.position\n0,10,0\n1,10,0.1\n2,10,0.3\n3,-5,0.2\n"


def catalog(tmp_path: Path, text: str) -> str:
    path = tmp_path / "catalog.csv"
    path.write_text(text)
    return str(path)


def test_a_motion_and_the_example(capsys, monkeypatch, tmp_path):
    """Results in files and tables, the page, and the same numbers from the written motion."""
    monkeypatch.setenv("COLUMNS", "80")
    motion, folder = tmp_path / "lift.csv", tmp_path / "out"
    motion.write_text(MOTION)
    status, out, err = run(capsys, "drives", motion, "--catalog", CATALOG, "--output", folder)
    assert (status, err) == (0, "")
    assert out.splitlines()[1] == "each actuator has a suitable drive"
    assert max(len(line) for line in out.splitlines() if "/" not in line) <= 80
    table = csv_rows(folder / "drives.csv")
    assert {row["actuator"] for row in table} == {"lift"}
    assert len(table) == len(read_catalog(str(CATALOG)))
    suits = {row["drive"] for row in table if row["suits"] == "1"}
    assert suits == {"servo ball 80x25", "servo ball 80x40"}
    assert {row["fails"] for row in table if row["drive"] == "worm gear"} == {"no screw"}
    # the first limit with a negative margin is named
    for row in table:
        of_drive = [each for each in csv_rows(folder / "limits.csv") if each["drive"] == row["drive"]]
        failing = [each["name"] for each in of_drive if float(each["margin"]) < 0.0]
        assert row["fails"] in (failing[:1] or ["", "no screw"])
        for each in of_drive:
            margin = 1.0 - float(each["needed"]) / float(each["allowed"])
            assert float(each["margin"]) == pytest.approx(margin, rel=1e-12)
    assert "required: no margin to limits (--margin)" in " ".join(out.split())
    (demand,) = csv_rows(folder / "demand.csv")
    assert (demand["unit"], float(demand["peak_force"])) == ("N", 10.0)
    assert float(demand["stroke"]) == pytest.approx(0.3)
    content = json.loads((folder / "drives.json").read_text())
    assert content["source"] == str(motion)
    assert len(content["drives"]) == len(table)
    assert (folder / "drives.png").read_bytes().startswith(b"\x89PNG")
    assert run(capsys, "report", folder)[0] == 0
    assert "data:image/png" in (folder / "report.html").read_text()
    assert "servo ball 80x40" in (folder / "report.html").read_text()
    again = tmp_path / "again"
    arguments = ("drives", folder / "motion.csv", "--catalog", CATALOG, "--output", again)
    assert run(capsys, *arguments)[0] == 0
    assert csv_rows(again / "limits.csv") == csv_rows(folder / "limits.csv")


def test_envelopes_of_long_motions():
    """Smallest and largest value of three bins, at both of their borders; then bins of which one is empty."""
    x = np.array([0.0, 0.5, 1.0, 2.5, 3.0])
    borders, low, high = envelope(np.arange(4.0), x, np.array([4.0, -2.0, 7.0, 1.0, 5.0]))
    assert borders.tolist() == [0.0, 1.0, 1.0, 2.0, 2.0, 3.0]
    assert low.tolist() == [-2.0, -2.0, 7.0, 7.0, 1.0, 1.0]
    assert high.tolist() == [4.0, 4.0, 7.0, 7.0, 5.0, 5.0]
    borders, *_ = envelope(np.arange(4.0), x[[0, 3]], np.ones(2))
    assert borders.tolist() == [0.0, 1.0, 2.0, 3.0]


def test_a_day_of_moves_is_drawn_as_an_envelope():
    """A move every three seconds, 4001 times: each line of the torque has two points for each bin."""
    time = np.linspace(0.0, 4000.0, 4001)
    speed = 1e-5 * np.sin(time) ** 2
    position = 1e-5 * (0.5 * time - 0.25 * np.sin(2.0 * time))
    force = np.where(speed == 0.0, 12.0, 10.0)
    motion = ActuatorMotion("lift", True, time, force, position, speed)
    drives = read_catalog(str(CATALOG))
    sized = {(drive.name, "lift"): size(drive, motion) for drive in drives}
    figure = drive_figure(DriveResults("day", "catalog", (motion,), drives, sized, Requirements()))
    torque_plot, force_plot = figure.axes
    assert max(len(line.get_xdata()) for line in torque_plot.lines) == 2 * BINS
    assert len(torque_plot.lines) % 2 == 0
    drawn = force_plot.lines[0]
    assert len(drawn.get_xdata()) <= 2 * SPEED_BINS
    # the largest speed and force are on the lines; the force is largest at rest
    assert drawn.get_xdata().max() == pytest.approx(speed.max(), rel=1e-12)
    assert drawn.get_ydata().max() == 12.0


@pytest.mark.slow
def test_drives_of_a_scene(capsys, tmp_path):
    """The two sliders of the tracker; requirements of the user make other drives fail, and the status 5."""
    motion = tmp_path / "motion"
    given = ("drives", "tracker_wind", "--set", "wind=steady", "--catalog", CATALOG, "--output", motion)
    assert run(capsys, *given)[0] == 0
    # with the written motion, which is the same, nothing is simulated again
    common = ("drives", motion / "motion.csv", "--catalog", CATALOG, "--output", tmp_path / "out")
    assert {row["actuator"] for row in csv_rows(motion / "drives.csv")} == {"slide_12", "slide_13"}
    chosen = {row["drive"] for row in csv_rows(motion / "drives.csv") if row["suits"] == "1"}
    assert "small Tr8x6" in chosen
    assert run(capsys, *common, "--must-hold")[0] == 0
    failed = {
        row["drive"]: row["fails"] for row in csv_rows(tmp_path / "out" / "drives.csv") if row["suits"] == "0"
    }
    assert failed["small Tr8x6"] == "holding"
    assert run(capsys, *common, "--margin", "40%")[0] == 0
    failed = {
        row["drive"]: row["fails"] for row in csv_rows(tmp_path / "out" / "drives.csv") if row["suits"] == "0"
    }
    assert failed["small Tr8x1.5"] == "motor speed"
    status, out, _ = run(capsys, *common, "--margin", "99.9%")
    assert (status, "no drive suits slide_12, slide_13" in out) == (5, True)


def test_a_scene_without_actuators(capsys, tmp_path):
    status, out, err = run(capsys, "drives", "pendulum", "--catalog", CATALOG, "--output", tmp_path)
    assert (status, out) == (2, "")
    assert "'pendulum' has no actuators; needed: a control law at a joint" in err


def test_elements_that_act_and_are_not_simulated_are_named(capsys, tmp_path):
    """A hinge that its motor drives past a limit, with a rotor whose inertia is in the force."""
    model = tmp_path / "arm.xml"
    model.write_text(
        '<mujoco><compiler angle="radian"/><worldbody><body>'
        '<joint name="j" axis="0 1 0" range="-0.1 0.1" armature="0.01"/>'
        '<inertial pos="1 0 0" mass="1" diaginertia="0.001 0.001 0.001"/></body></worldbody>'
        '<actuator><position name="m" joint="j" kp="50" kv="5"/></actuator></mujoco>'
    )
    path = catalog(tmp_path, f"{HEADER}\nbig,2000,3000\n")
    common = ("drives", model, "--set", "duration=0.5", "--catalog", path, "--output", tmp_path / "out")
    status, out, _ = run(capsys, *common)
    assert (status, "REDUCED MODEL: not simulated: limits of joint 'j' passed" in " ".join(out.split())) == (
        4,
        True,
    )
    assert "rotor inertias of the scene at j" in " ".join(out.split())
    assert run(capsys, *common, "--allow-reduced")[0] == 0


def test_numbers_of_a_catalog(tmp_path):
    """Units, defaults and derived numbers."""
    text = (
        "# a comment\n"
        f"{HEADER},peak_torque [mN m],gear_efficiency,lead [mm],pitch_diameter [mm],friction,"
        "flank_angle [deg],screw_length,screw_ends,screw_efficiency,root_diameter [mm]\n"
        "one,5,3000,,0.8,4,18,0.1,15,0.5,fixed,,\n"
        "two,5,3000,70,,4,,,,0.5,,0.9,16\n"
        "three,5,3000,,,,,,,,,,\n"
    )
    one, two, three = read_catalog(catalog(tmp_path, text))
    assert one.rated_torque == one.peak_torque == pytest.approx(0.05)
    assert two.peak_torque == pytest.approx(0.07)
    assert one.rated_speed == pytest.approx(100.0 * math.pi)
    assert (one.gear_back_efficiency, two.gear_back_efficiency) == pytest.approx((0.75, 1.0))
    thread = Thread(0.004, 0.018, 0.1, math.radians(15.0))
    assert one.screw.efficiency == pytest.approx(thread.efficiency)
    assert one.screw.back_efficiency == pytest.approx(thread.back_efficiency)
    assert one.screw.buckling_force == pytest.approx(buckling_force(0.016, 0.5, ENDS["fixed"]))
    assert two.screw.back_efficiency == pytest.approx(2.0 - 1.0 / 0.9)
    assert two.screw.critical_speed == pytest.approx(critical_speed(0.016, 0.5, ENDS["supported"]))
    assert three.screw is None
    assert (three.thermal_time, three.friction_torque, three.motor_efficiency) == (600.0, 0.0, None)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "has no drives"),
        (HEADER, "has no drives"),
        ("name,rated_torque\na,1", "line 1: has no column rated_speed"),
        (f"{HEADER},rated_sped\na,1,1,1", "line 1: unknown column 'rated_sped'; did you mean 'rated_speed'?"),
        (
            f"{HEADER},lead [inch]\na,1,1,1",
            "line 1: column lead has the unit 'inch'; choose from: m, cm, mm, um",
        ),
        (f"{HEADER},friction [1]\na,1,1,1", "line 1: column friction has the unit '1'; needed: none"),
        (f"{HEADER},lead,lead\na,1,1,1,1", "line 1: column 'lead' is there twice"),
        (f"{HEADER}\na,1", "line 2: has 2 cells; needed: 3"),
        (f"{HEADER}\n,1,1", "line 2: name is missing"),
        (f"{HEADER}\na,,1", "line 2: rated_torque is missing"),
        (f"# x\n{HEADER}\na,1,1\na,2,2", "line 4: name is 'a' again"),
        (f"{HEADER}\na,x,1", "line 2: rated_torque is 'x'; needed: a number above 0"),
        (f"{HEADER}\na,0,1", "line 2: rated_torque is '0'; needed: a number above 0"),
        (
            f"{HEADER}\na,1e300,1",
            "line 2: rated_torque is '1e300'; needed: a number above 0, at most 1e+09 N m",
        ),
        (f"{HEADER}\na,1e-300,1", "line 2: rated_torque is '1e-300'"),
        (f"{HEADER},peak_torque\na,100,1,0.5", "line 2: peak_torque is below rated_torque"),
        (
            f"{HEADER},gear_efficiency\na,1,1,1.1",
            "line 2: gear_efficiency is '1.1'; needed: a number above 0, at",
        ),
        (f"{HEADER},resistance\na,1,1,1", "line 2: resistance and torque_constant: one is missing"),
        (f"{HEADER},voltage\na,1,1,1", "line 2: voltage without resistance"),
        (
            f"{HEADER},motor_efficiency,resistance,torque_constant\na,1,1,1,1,1",
            "line 2: has motor_efficiency and resistance",
        ),
        (f"{HEADER},stroke\na,1,1,1", "line 2: has stroke without lead"),
        (f"{HEADER},lead\na,1,1,1", "line 2: lead without friction; needed: pitch_diameter and friction, or"),
        (f"{HEADER},lead,friction\na,1,1,1,0.1", "line 2: friction without pitch_diameter"),
        (
            f"{HEADER},lead,friction,screw_efficiency\na,1,1,1,0.1,0.9",
            "line 2: has friction and screw_efficiency",
        ),
        (
            f"{HEADER},lead,collar_friction,screw_efficiency\na,1,1,1,0.1,0.9",
            "line 2: has collar_friction without friction",
        ),
        (
            f"{HEADER},lead,pitch_diameter,friction\na,1,1,1,0.1,0.5",
            "line 2: no torque moves the screw",
        ),
        (
            f"{HEADER},lead,screw_efficiency,screw_length\na,1,1,1,1,1",
            "line 2: screw_length without root_diameter",
        ),
        (
            f"{HEADER},lead,screw_efficiency,screw_length,pitch_diameter\na,1,1,1,1,1,0.5",
            "line 2: pitch_diameter is below half of the lead",
        ),
        (
            f"{HEADER},lead,screw_efficiency,screw_ends\na,1,1,1,1,fixed",
            "line 2: screw_ends without screw_length",
        ),
        (
            f"{HEADER},lead,screw_efficiency,screw_length,root_diameter,screw_ends\na,1,1,1,1,1,1,fixt",
            "line 2: screw_ends is 'fixt'; choose from: fixed-free, supported, fixed-supported, fixed",
        ),
    ],
)
def test_errors_of_a_catalog_name_line_and_column(tmp_path, text, problem):
    with pytest.raises(SourceError) as caught:
        read_catalog(catalog(tmp_path, text))
    assert caught.value.problem.startswith(problem)


COMMENT = '# Motors; "new\t(2026), 5" screws\n'
"""Comment with other separators than commas, an open quotation and a control character."""


def test_comments_may_have_any_text(tmp_path):
    """Before the header and between rows; errors name the line of the file."""
    (drive,) = read_catalog(catalog(tmp_path, f"{COMMENT}{HEADER}\n{COMMENT}one,5,3000\n  {COMMENT}"))
    assert drive.name == "one"
    path = tmp_path / "motion.csv"
    path.write_text(f"{COMMENT}time,torque,angle\n0,1,0\n{COMMENT}1,2,1\n")
    (only,) = read_motions(str(path))
    assert only.time.tolist() == [0.0, 1.0]
    path.write_text(f"{COMMENT}time,torque,angle\n0,1,0\n{COMMENT}1;2;1\n")
    with pytest.raises(SourceError, match="line 5: has 1 cells"):
        read_motions(str(path))
    path.write_text(f"{COMMENT}time;torque;angle\n0;1;0\n")
    with pytest.raises(SourceError, match="line 2: columns are separated by ';'"):
        read_motions(str(path))


def test_motions_of_slides_and_hinges(tmp_path):
    """Speeds are given or the derivative; a single actuator may be without a name."""
    path = tmp_path / "motion.csv"
    path.write_text(
        "time,a.force,a.position,a.speed,b.torque,b.angle\n0,1,0,2,5,0\n1,2,1,3,6,2\n3,3,5,4,7,6\n"
    )
    slide, hinge = read_motions(str(path))
    assert (slide.name, slide.is_slide, hinge.name, hinge.is_slide) == ("a", True, "b", False)
    assert slide.speed.tolist() == [2.0, 3.0, 4.0]
    assert hinge.speed == pytest.approx([2.0, 2.0, 2.0])
    path.write_text(motions_csv([slide, hinge]))
    for again, motion in zip(read_motions(str(path)), (slide, hinge), strict=True):
        assert (again.name, again.is_slide) == (motion.name, motion.is_slide)
        for name in ("time", "force", "position", "speed"):
            assert np.array_equal(getattr(again, name), getattr(motion, name))
    path.write_text("time,torque,angle\n0,1,0\n1,2,1\n")
    (only,) = read_motions(str(path))
    assert (only.name, only.is_slide) == ("actuator", False)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("a,b\n1,2", "has no column time"),
        ("time\n0\n1", "has no actuators"),
        ("time,a.force,a.position\n0,1,1", "has 1 rows; needed: 2 times or more"),
        ("time,a.forse\n0,1\n1,1", "line 1: column 'a.forse'"),
        ("time,a.force\n0,1\n1,1", "actuator 'a' has force"),
        ("time,a.force,a.angle\n0,1,1\n1,1,1", "actuator 'a' has force, angle"),
        ("time,force,position\n0,1,1\n0,1,1", "line 3: time is 0; needed: times in ascending order"),
        ("time,force,position\n0,1,1\n1,1,1e20", "line 3: position is 1e+20; needed: a number up to 1e+15"),
        ("time,force,position\n0,1,1\n1,x,1", "line 3: force is 'x'; needed: a finite number"),
    ],
)
def test_errors_of_a_motion_name_line_and_column(tmp_path, text, problem):
    path = tmp_path / "motion.csv"
    path.write_text(text)
    with pytest.raises(SourceError) as caught:
        read_motions(str(path))
    assert caught.value.problem.startswith(problem)


def test_options_have_no_effect_on_a_motion(capsys, tmp_path):
    motion = tmp_path / "lift.csv"
    motion.write_text(MOTION)
    status, _, err = run(
        capsys, "drives", motion, "--set", "speed=1", "--catalog", CATALOG, "--output", tmp_path
    )
    assert (status, "--set speed has no effect on the CSV" in err) == (2, True)


def test_results_do_not_replace_the_motion_that_they_are_of(capsys, tmp_path):
    motion = tmp_path / "motion.csv"
    motion.write_text(MOTION)
    status, _, err = run(capsys, "drives", motion, "--catalog", CATALOG, "--output", tmp_path)
    assert (status, "would overwrite the input file" in err) == (2, True)
    assert motion.read_text() == MOTION


def test_every_column_is_in_the_reference():
    page = (CATALOG.parents[1] / "docs" / "reference" / "files_drives.md").read_text()
    assert [name for name in COLUMNS if f"`{name}`" not in page] == []
