"""The command `loads`: cases, its table, and what it writes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import csv_rows, run
from plate_coefficients import blended

from crosscheck.compare import singularity
from crosscheck.design.load_plots import load_figure
from crosscheck.design.load_report import negligible_force
from crosscheck.design.loads import coarse_peak
from crosscheck.design.wind_validity import wind_ranges
from crosscheck.library import LOAD_CASES, load, load_sun_tracker
from crosscheck.library.tracker import PANEL
from crosscheck.library.tracker_wind import tilted_directions
from newton_euler import (
    Axis,
    Body,
    Free,
    Mechanism,
    Scene,
    WindLoad,
    load_envelope,
    rest_case,
    simulate,
    solve_poses,
    statics,
)
from newton_euler.analysis.loads.rest import wind_at_peak

EXAMPLE = str(Path(__file__).parents[2] / "examples" / "four_bar.yaml")


def ranges(folder: Path) -> dict[tuple[str, str], dict[str, str]]:
    return {(row["element"], row["quantity"]): row for row in csv_rows(folder / "loads.csv")}


def lines_of(out: str, title: str) -> dict[str, list[str]]:
    """Cells of the table below a title, by the first cell of each row."""
    rows = out.split(f"{title}\n", 1)[1].split("\n\n", 1)[0].splitlines()[2:]
    return {row.split()[0]: row.split()[1:] for row in rows}


def test_cases_of_a_scene(capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("COLUMNS", "80")
    cases = ("--case", "calm:speed=0", "--case", "windy:speed=15,wind_from=180")
    status, out, err = run(
        capsys, "loads", "tracker_wind", "--set", "wind=steady", *cases, "--output", tmp_path
    )
    assert (status, err) == (0, "")
    assert out.startswith("tracker_wind: loads over cases calm, windy\nlargest force ")
    assert "case windy: wind=steady, speed=15, wind_from=180, vertical=0, pose=moving" in " ".join(
        out.split()
    )
    assert "case windy: starts at slide_12 0 m, slide_13 0 m" in out
    assert max(map(len, out.splitlines())) <= 80 + len(str(tmp_path)) * 5
    found = ranges(tmp_path)
    assert {row["maximum_case"] for row in found.values()} == {"calm", "windy"}
    row = found["universal_47", "force"]
    peak, *_, case, _, time, _ = lines_of(out, "Envelope: forces of joints")["universal_47"]
    assert peak == f"{float(row['maximum']):.3g}"
    assert (case, float(time)) == (row["maximum_case"], pytest.approx(float(row["maximum_time"]), rel=1e-3))
    assert (tmp_path / "loads.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "loads.rrd").stat().st_size > 10_000
    assert run(capsys, "report", tmp_path)[0] == 0
    page = (tmp_path / "report.html").read_text()
    assert "largest force" in page
    assert "Peak torque of every case" in page
    assert "data:image/png" in page


@pytest.mark.slow
def test_every_case_is_in_all_results(capsys, tmp_path):
    """Rest is quick: cases of 5 and 10 m/s; their static wind forces differ by a factor of 4."""
    cases = ("--case", "weak:speed=5", "--case", "calm:speed=0", "--case", "strong:speed=10")
    arguments = ("--at-rest", "--set", "wind=steady", *cases, "--output", tmp_path)
    status, out, _ = run(capsys, "loads", "tracker_wind", *arguments)
    assert status == 0
    rows = csv_rows(tmp_path / "cases.csv")
    envelope = ranges(tmp_path)
    assert len(rows) == 3 * len(envelope)
    assert {row["case"] for row in rows} == {"weak", "calm", "strong"}
    content = json.loads((tmp_path / "loads.json").read_text())
    assert content["options"]["weak"] == {"wind": "steady", "speed": "5"}
    assert len(content["envelope"]) == len(envelope)
    in_table = lines_of(out, "Peak force of every case")
    for joint, texts in in_table.items():
        of_joint = [row for row in rows if (row["element"], row["quantity"]) == (joint, "force")]
        peaks = {row["case"]: float(row["maximum"]) for row in of_joint}
        in_json = {
            case: each["maximum"]
            for case, loads in content["loads_of_cases"].items()
            for each in loads
            if (each["element"], each["quantity"]) == (joint, "force")
        }
        assert in_json == peaks
        governing = max(peaks, key=lambda case: peaks[case])
        assert [row["case"] for row in of_joint if row["governs"] == "1"] == [governing]
        assert texts == [f"{'*' if case == governing else ''}{peak:.3g}" for case, peak in peaks.items()]
        assert float(envelope[joint, "force"]["maximum"]) == peaks[governing]


@pytest.mark.slow
def test_wind_at_rest_has_the_largest_speed_of_its_run(capsys, tmp_path):
    """The gust of 10 m/s peaks at 10 + 0.74 * 5 m/s: the loads are those of a steady wind with this speed."""
    arguments = ("--case", "gust:wind=gust", "--case", "steady:wind=steady,speed=13.7", "--output", tmp_path)
    status, out, _ = run(capsys, "loads", "tracker_wind", "--at-rest", *arguments)
    assert status == 0
    assert "at rest: actuators hold the initial pose" in out
    content = json.loads((tmp_path / "loads.json").read_text())
    (held,) = content["held_winds"]["gust"]
    assert held["speed"] == pytest.approx(13.7, rel=1e-6)
    assert held["time"] == pytest.approx(2.5, abs=0.01)
    assert content["held_winds"]["steady"] == []
    for each, other in zip(*content["loads_of_cases"].values(), strict=True):
        assert each["maximum"] == pytest.approx(other["maximum"], rel=1e-5, abs=1e-12)


@pytest.mark.slow
def test_the_default_cases_load_a_stowed_panel_from_both_sides(capsys, tmp_path):
    """In stow the panel is flat: of the ground's vertical force, weight -+ the normal force of the wind."""
    status, out, _ = run(capsys, "loads", "tracker_wind", "--at-rest", "--output", tmp_path)
    assert status == 0
    content = json.loads((tmp_path / "loads.json").read_text())
    assert content["cases"] == ["operating", "gust", "gust_west", "stow_up", "stow_down"]
    assert "is not reliable" not in out
    vertical = {}
    for case in ("stow_up", "stow_down"):
        found = {
            (each["element"], each["quantity"]): each["maximum"] for each in content["loads_of_cases"][case]
        }
        names = ("slide_12", "slide_13")
        vertical[case] = sum(found[name, "actuator force"] for name in names) + found["hinge_14", "force z"]
    moving = sum(body.mass for body in load("tracker").mechanism.bodies[1:])
    for case, sign in {"stow_up": -1.0, "stow_down": 1.0}.items():
        (flow,) = content["winds"][case]
        assert flow["maximum_attack"] == pytest.approx(np.degrees(np.arctan2(10.0, 40.0)), rel=1e-6)
        # normal force by the formulas of `WindLoad`, on a panel with sides of twice `PANEL`
        coefficient, _ = blended(flow["maximum_attack"], flow["maximum_ratio"], max(PANEL) / min(PANEL))
        force = 0.5 * 1.225 * (40.0**2 + 10.0**2) * 4.0 * PANEL[0] * PANEL[1] * coefficient
        # plates of the sliders carry horizontal forces only; the square of 0.01 m/s is added to that of
        # 10 m/s across the panel, so that the load is smooth at 0
        assert vertical[case] == pytest.approx(9.81 * moving + sign * force, rel=1e-6)


def plate_over_ground(width: float, height: float) -> Scene:
    """A plate of 1 m along the wind and `width` across it, level at a height above the origin."""
    mechanism = Mechanism(
        [Body.ground(), Body("plate", 1e3, [0.0, 0.0, height], np.diag([1e2, 1e2, 2e2]))],
        [Free("floats", "ground", "plate", [0.0, 0.0, 0.0])],
    )
    x, y, z = np.eye(3)
    wind = WindLoad(
        "wind", "plate", [0.0, 0.0, height], first_side=x, second_side=width * y, direction=x, speed=10.0,
        vertical_speed=10.0 * np.tan(np.radians(20.0)),
    )  # fmt: skip
    return Scene("plate", mechanism, 1e-3, 1e-3, gravity=-9.81 * z, forces=(wind,))


@pytest.mark.parametrize(
    ("width", "height", "warnings"),
    [
        (2.0, 1.0, ()),
        (8.0, 1.0, ("span / chord is 8",)),
        (0.1, 1.0, ("span / chord is 0.1",)),
        (2.0, 0.3, ("0.3 chords above the height 0",)),
    ],
)
def test_wind_outside_of_its_coefficients_is_a_warning(width, height, warnings):
    scene = plate_over_ground(width, height)
    (found,) = wind_ranges(scene, simulate(scene))
    assert (found.minimum_attack, found.maximum_attack) == pytest.approx((20.0, 20.0), abs=0.1)
    assert found.minimum_ratio == pytest.approx(width, rel=1e-6)
    assert found.clearance == pytest.approx(height, rel=1e-3)
    assert bool(found.warning) == bool(warnings)
    for warning in warnings:
        assert warning in found.warning


def test_round_off_is_no_load_and_rest_is_told(capsys, tmp_path):
    """A planar linkage, whose torques across its plane are 1e-15 N m, and one that nothing moves."""
    linkage = Path(EXAMPLE).with_name("linkage.xml")
    _, out, _ = run(capsys, "loads", linkage, "--set", "duration=0.1", "--output", tmp_path)
    assert "nothing moves" not in out
    (line,) = [line.split() for line in out.splitlines() if line.startswith("elbow") and "e-" not in line][1:]
    assert line == ["elbow", "0", "0", "0", "0"]
    still = tmp_path / "still.xml"
    still.write_text(
        '<mujoco><option gravity="0 0 0"/><worldbody><body name="a"><joint name="j" axis="0 1 0"/>'
        '<geom size="0.1" pos="0.5 0 0"/></body></worldbody></mujoco>'
    )
    _, out, _ = run(capsys, "loads", still, "--output", tmp_path)
    assert "no joint carries a force" in out
    assert "nothing moves in the run: these are loads at rest; --set excitation=on moves" in " ".join(
        out.split()
    )


@pytest.mark.slow
def test_advice_on_excitation_is_for_model_files_alone(capsys, tmp_path):
    """Scenes of the library and scene files do not have the option `excitation`."""
    status, out, _ = run(
        capsys, "loads", "tracker_wind", "--case", "held:pose=stow,wind=steady,speed=0", "--output", tmp_path
    )
    assert status == 0
    assert "nothing moves in cases held: these are loads at rest" in out
    assert "--set excitation" not in out


def test_a_file_at_rest_has_one_case(capsys, tmp_path):
    status, out, _ = run(capsys, "loads", EXAMPLE, "--at-rest", "--output", tmp_path)
    assert status == 0
    assert out.startswith("four_bar: loads at rest, initial pose\n")
    assert {row["maximum_time"] for row in ranges(tmp_path).values()} == {"0.0"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "told"),
    [
        ("bricard", "1 redundant constraint at joints hinge_1,"),
        ("four_bar", "2 redundant constraints at joints pivot_0, "),  # of the plane, zero in the tree
    ],
)
def test_loads_that_are_not_determined_are_told(capsys, tmp_path, scene, told):
    """The four-bar lies flat at 0.71 s, the Bricard mechanism meets no singular configuration."""
    _, out, _ = run(capsys, "loads", scene, "--output", tmp_path)
    assert f"reactions not unique: {told}" in " ".join(out.split())
    assert ("passes a singular configuration at 0.71" in out) == (scene == "four_bar")
    assert list(json.loads((tmp_path / "loads.json").read_text())["singular"]) == (
        ["run"] if scene == "four_bar" else []
    )
    assert "stiffness decides how these joints share loads" in out


def test_a_search_for_singular_configurations_that_fails_is_a_note(capsys, monkeypatch, tmp_path):
    monkeypatch.setattr(singularity, "MAX_JACOBIAN_ELEMENTS", 1)
    status, out, _ = run(capsys, "loads", EXAMPLE, "--output", tmp_path)
    assert status == 0
    assert "searching singular configurations: left out, as " in " ".join(out.split())


def test_elements_that_act_and_are_not_simulated_are_named(capsys, tmp_path):
    """A pendulum that falls from the horizontal past its limit, with a case whose run ends before."""
    model = tmp_path / "falls.xml"
    model.write_text(
        '<mujoco><compiler angle="radian"/><worldbody><body><joint name="j" axis="0 1 0" range="-1 0.1"/>'
        '<inertial pos="1 0 0" mass="1" diaginertia="0.001 0.001 0.001"/></body></worldbody></mujoco>'
    )
    output = ("--output", tmp_path / "out")
    cases = ("--case", "long:duration=0.5", "--case", "short:duration=0.1")
    status, out, _ = run(capsys, "loads", model, *cases, *output)
    assert status == 4
    told = " ".join(out.split())
    assert "REDUCED MODEL: largest force " in told
    assert "; case long: not simulated: limits of joint 'j' passed from " in told
    assert "case short: not" not in told
    content = json.loads((tmp_path / "out" / "loads.json").read_text())
    ((case, (entry,)),) = content["not_simulated"].items()
    assert (case, entry["element"], entry["topic"]) == ("long", "joint 'j'", "limits")
    # x = g t^2 / 2 l as long as x is small
    assert entry["since"] == pytest.approx((2.0 * 0.1 * 1.001 / 9.81) ** 0.5, rel=0.05)
    assert run(capsys, "loads", model, *cases, *output, "--allow-reduced")[0] == 0
    status, out, _ = run(capsys, "loads", model, "--set", "duration=0.1", *output)
    assert (status, "REDUCED" in out) == (0, False)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--case", "a b:speed=3"), "--case 'a b:speed=3' is not of the form NAME:OPTION=VALUE"),
        (("--case", "a", "--case", "a"), "--case a is given twice"),
        (
            ("--case", "gust"),
            "--case gust has no options; needed: gust:OPTION=VALUE,... with the options wind=",
        ),
        (
            ("--case", "a:speed=10", "--case", "b:wind=turbulent,seed=1"),
            "--case b has the same options as a; needed: b:OPTION=VALUE,... with the options wind=",
        ),
        (("--case", "a:speed"), "--case a: 'speed' is not of the form OPTION=VALUE"),
        (("--case", "a:sped=1"), "unknown option 'sped' of scene 'tracker_wind'; did you mean 'speed'?"),
        (
            ("--case", "a:speed=99"),
            "speed of scene 'tracker_wind' is '99'; choose a number from 0 to 60 m/s",
        ),
    ],
)
def test_bad_cases_are_one_line(capsys, tmp_path, arguments, message):
    status, out, err = run(capsys, "loads", "tracker_wind", *arguments, "--output", tmp_path / "out")
    assert (status, out, len(err.splitlines())) == (2, "", 1)
    assert message in err
    assert not (tmp_path / "out").exists()


def test_what_nothing_holds_is_named(capsys, tmp_path):
    status, _, err = run(capsys, "loads", "pendulum", "--at-rest", "--output", tmp_path)
    assert status == 2
    assert "needed: actuators that hold it" in err


def test_the_worst_pose_has_the_largest_actuator_force_of_all_poses():
    """Against statics on another grid of poses, in wind from the south; its direction by trigonometry."""
    options = {"wind": "steady", "speed": 14, "wind_from": 180}
    worst = load("tracker_wind", pose="worst", **options)
    (wind,) = worst.forces
    np.testing.assert_allclose(wind.direction, [0.0, 1.0, 0.0], atol=1e-15)  # towards the north
    found = np.abs(statics(worst).actuator_force).max()
    tilt, azimuth = (
        each.ravel() for each in np.meshgrid([0.2, 0.4, np.radians(30.0)], np.arange(0.1, 6.3, 0.5))
    )
    towards = np.stack([np.sin(tilt) * np.sin(azimuth), np.sin(tilt) * np.cos(azimuth), np.cos(tilt)], axis=1)
    scene = load("tracker_wind", pose="tilted", **options)
    poses = solve_poses(scene, axis=Axis("panel_7", [0.0, 0.0, 1.0]), towards=towards)
    assert found > 0.999 * np.abs(statics(scene, poses).actuator_force).max()
    # the pose is within the largest tilt, and the force larger than in the paper's pose
    pose = solve_poses(
        scene,
        dict(zip(("slide_12", "slide_13"), (law.target for law in worst.control), strict=True)),
        axis=Axis("panel_7", [0.0, 0.0, 1.0]),
    )
    assert pose.direction[0, 2] > np.cos(np.radians(30.0)) - 1e-6
    assert found > 1.1 * np.abs(statics(scene).actuator_force).max()


@pytest.mark.slow  # 24 directions, each with compiled equations
def test_wind_of_the_default_cases_comes_from_the_worst_direction():
    """Against statics of all directions in steps of 15 degrees, in all poses up to the largest tilt.

    The poses are those of `pose=worst`: flat, and tilted by 10, 20 and 30 degrees.
    """
    tilt, azimuth = (
        each.ravel() for each in np.meshgrid(np.radians([0.0, 10.0, 20.0, 30.0]), np.arange(24) * np.pi / 12)
    )
    towards = np.stack([np.sin(tilt) * np.sin(azimuth), np.sin(tilt) * np.cos(azimuth), np.cos(tilt)], axis=1)
    towards = np.unique(towards.round(12), axis=0)
    assert len(towards) == 73  # flat once
    axis = Axis("panel_7", [0.0, 0.0, 1.0])
    poses = {
        "worst": solve_poses(load("tracker_wind"), axis=axis, towards=towards),
        "stow": solve_poses(load("tracker_wind"), axis=axis, towards=[[0.0, 0.0, 1.0]]),
    }
    for case, options in LOAD_CASES["tracker_wind"].items():
        # the gust at rest is a steady wind with its largest speed
        given = {**options, "pose": "tilted"}
        at_peak, _ = wind_at_peak(load("tracker_wind", **given))
        (wind,) = at_peak.forces
        largest = {}
        for degrees in range(0, 360, 15):
            angle = np.radians(degrees)
            load_of_direction = replace(wind, direction=[-np.sin(angle), -np.cos(angle), 0.0])
            scene = replace(at_peak, forces=(load_of_direction,))
            force = np.abs(statics(scene, poses[options["pose"]]).actuator_force)
            largest[degrees] = (
                force[..., 0].max() if case == "gust_west" else force.max()
            )  # of the first slider
        assert max(largest, key=largest.get) == float(options["wind_from"]), case


def test_the_poses_that_are_searched_differ():
    """Flat once, and three tilts at 24 azimuths."""
    directions = tilted_directions(30.0)
    assert len(np.unique(directions.round(9), axis=0)) == len(directions) == 73
    tilts = np.degrees(np.arccos(directions[:, 2]))
    np.testing.assert_allclose(np.unique(tilts.round(6)), [0.0, 10.0, 20.0, 30.0])
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)


def panel_inertia(**options: float) -> np.ndarray:
    return (
        load_sun_tracker({key: str(value) for key, value in options.items()})
        .mechanism.body("panel_7")
        .inertia
    )


PAPER = np.array([[1.209e-3, 0.0, 1e-4], [0.0, 1.209e-3, 0.0], [1e-4, 0.0, 2.39e-3]])
"""kg m^2, the paper's inertia of the panel of 0.14 m by 0.11 m and 0.8905 kg."""


def plate_inertia(width: float, height: float, mass: float) -> np.ndarray:
    """A box 4 mm thick."""
    squares = np.array([width, height, 0.004]) ** 2
    return np.diag(mass / 12.0 * (squares.sum() - squares))


def test_the_inertia_of_the_panel_is_continuous_in_its_size_and_mass():
    np.testing.assert_allclose(panel_inertia(), PAPER, rtol=1e-12)
    np.testing.assert_allclose(panel_inertia(panel_mass=1.781), 2.0 * PAPER, rtol=1e-12)
    for sign in (1.0, -1.0):
        near = {"panel_width": 0.14 + sign * 1e-7, "panel_height": 0.11 - sign * 1e-7, "panel_mass": 0.8905}
        np.testing.assert_allclose(panel_inertia(**near), PAPER, rtol=1e-5, atol=1e-9)


def test_the_inertia_of_a_large_panel_is_that_of_a_plate():
    plate = plate_inertia(1.0, 0.9, 8.905)
    np.testing.assert_allclose(
        panel_inertia(panel_width=1.0, panel_height=0.9, panel_mass=8.905),
        plate + 10.0 * (PAPER - plate_inertia(0.14, 0.11, 0.8905)),
        rtol=1e-12,
    )
    assert (
        np.abs(
            panel_inertia(panel_width=1.0, panel_height=1.0, panel_mass=8.905) / 8.905
            - plate_inertia(1.0, 1.0, 1.0)
        ).max()
        < 0.005 * plate_inertia(1.0, 1.0, 1.0).max()
    )


@pytest.mark.parametrize("width", [0.02, 0.1, 0.14, 0.2, 1.0])
@pytest.mark.parametrize("height", [0.02, 0.08, 0.11, 0.2, 1.0])
def test_the_inertia_of_a_panel_of_any_size_is_possible(width, height):
    """No principal moment is more than the sum of both others."""
    moments = np.linalg.eigvalsh(panel_inertia(panel_width=width, panel_height=height))
    assert moments[0] > 0.0
    assert moments[0] + moments[1] > moments[2]


def test_a_panel_of_another_size_has_its_weight_its_inertia_and_its_wind():
    """A square plate of 0.2 m and 2 kg, by the formulas of a box 4 mm thick and of the wind."""
    scene = load(
        "tracker_wind",
        panel_width=0.2,
        panel_height=0.2,
        panel_mass=2.0,
        pose="stow",
        wind="steady",
        speed=40,
        vertical=-10,
    )
    plate = scene.mechanism.body("panel_7")
    difference = PAPER - plate_inertia(0.14, 0.11, 0.8905)
    expected = plate_inertia(0.2, 0.2, 2.0) + 2.0 / 0.8905 * difference
    np.testing.assert_allclose(plate.inertia, expected, rtol=1e-12)
    held = statics(scene)
    up = held.actuator_force.sum() + held.reaction_force[held.joint_names.index("hinge_14"), 2]
    weight = 9.81 * (sum(body.mass for body in load("tracker").mechanism.bodies[1:-1]) + 2.0)
    coefficient, _ = blended(np.degrees(np.arctan2(10.0, 40.0)), 1.0, 1.0)
    assert up - weight == pytest.approx(0.5 * 1.225 * (40.0**2 + 10.0**2) * 0.04 * coefficient, rel=1e-3)


@pytest.mark.slow
def test_loads_at_round_off_have_no_plot():
    """Pins of a planar arm carry no torque; hydraulic cylinders, as joints and as actuators, are drawn."""
    scene = load("excavator")
    run_at_rest = rest_case(scene)
    envelope = load_envelope(scene, {"rest": run_at_rest})
    figure = load_figure(scene, {"rest": run_at_rest}, negligible_force(scene, envelope))
    shown = [ax for ax in figure.axes if ax.axison]
    names = {ax.get_ylabel() for ax in shown}
    assert {"boom_cylinder", "boom_cylinder\nactuator", "boom_pin"} <= names
    heights = [max(abs(bar.get_height()) for bar in ax.patches) for ax in shown]
    assert min(heights) > 1.0  # N or N m; round-off is below 1e-8


def test_the_tracker_of_the_sun_has_the_options_of_its_panel(capsys):
    assert load_sun_tracker({"panel_mass": "2"}).mechanism.body("panel_7").mass == 2.0
    _, out, _ = run(capsys, "list")
    assert "panel_mass=0.01..50 kg" in out.split("tracker_sun: ")[1].split("MJCF")[0]
    status, out, _ = run(capsys, "list", "tracker_sun", "--set", "panel_mass=2")
    assert status == 0
    assert any(line.split()[0::2] == ["panel_7.mass", "2"] for line in out.splitlines())


def test_a_long_output_period_is_reported():
    """Outputs every 10 ms of a crank that turns once in 209 ms cut off the peak of its guide, 35.32 N."""
    scene = load("examples/planar_slider_crank.yaml")
    fine, rough = (simulate(replace(scene, output_period=period)) for period in (0.001, 0.01))
    assert coarse_peak(scene, fine) is None
    coarse = coarse_peak(scene, rough)
    assert coarse is not None
    assert coarse.joint == "guide"
    peaks = [load_envelope(scene, run).of("guide", "force").peak for run in (fine, rough)]
    # the parabola misses about a tenth of the excess of 1 %
    assert coarse.excess == pytest.approx(peaks[0] / peaks[1] - 1.0, rel=0.2)
