"""`crosscheck modes`: its table, result files, page and recording."""

from __future__ import annotations

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from command_line import csv_rows, run
from rerun.chunk import RrdReader

from crosscheck.design.modes import analyze, data, stability, table, to_csv
from crosscheck.library import load
from crosscheck.recording.modes import AMPLITUDE, animate_mode
from newton_euler import PD, Body, Mechanism, Revolute, Scene, simulate, solve_poses, statics
from newton_euler.analysis.linear.linear_model import Modes
from newton_euler.analysis.linear.linearization import linearize
from newton_euler.analysis.loads.equilibrium import equilibrium
from newton_euler.analysis.loads.holding import hold
from newton_euler.model.euler_parameters import rotation


def test_modes_prints_a_table_and_writes_a_recording(capsys, tmp_path):
    status, out, err = run(capsys, "modes", "pendulum", "--output", tmp_path)
    assert (status, err) == (0, "")
    assert "pendulum about an equilibrium: 1 degree of freedom" in out
    frequency = np.sqrt(9.81) / (2.0 * np.pi)  # all of its mass at 1 m
    assert "neutral: undamped motions neither die out nor grow; at pivot 1.571 rad" in out
    assert out.splitlines()[5].split()[:6] == ["1", *[f"{frequency:.6g}"] * 2, "0", "-", "dumbbell:"]
    assert all(len(line) <= 80 for line in out.splitlines() if str(tmp_path) not in line)
    (recording,) = RrdReader(tmp_path / "modes.rrd").recordings()
    assert recording.application_id == "crosscheck_pendulum"


def test_result_files_have_all_numbers_and_a_page(capsys, tmp_path):
    """Shapes of joints are those of the coordinates of a small motion, here of a slider-crank on a spring."""
    status, _, err = run(capsys, "modes", "slider_crank", "--pose", "pivot=0.4", "--output", tmp_path)
    assert (status, err) == (0, "")
    content = json.loads((tmp_path / "modes.json").read_text())
    assert content["about"] == "pose"
    assert content["branch"] == {"coordinates": ["pivot"], "passed": 0, "passing_times": [], "beyond": False}
    assert content["pose"]["coordinates"]["pivot"] == pytest.approx(0.4, abs=1e-12)
    rows = csv_rows(tmp_path / "modes.csv")
    assert len(rows) == len(content["modes"]) == 2  # one grows, one decays: the crank falls
    row, mode = rows[1], content["modes"][1]
    assert float(row["eigenvalue real, 1/s"]) == pytest.approx(mode["eigenvalue"][0], rel=1e-8)
    assert float(row["damping ratio"]) == -np.sign(mode["eigenvalue"][0])
    pivot, guide = (complex(*mode["shape"][name]) for name in ("pivot", "guide"))
    assert float(row["guide amplitude, m"]) == pytest.approx(abs(guide), rel=1e-8)
    h, scene = 1e-5, load("slider_crank")
    ends = solve_poses(scene, {"pivot": [0.4 - h, 0.4 + h]}, measure=["guide"]).coordinates["guide"]
    assert guide / pivot == pytest.approx((ends[1] - ends[0]) / (2.0 * h), rel=1e-8)
    assert run(capsys, "report", tmp_path)[0] == 0
    assert "slider_crank about a state that is no equilibrium" in (tmp_path / "report.html").read_text()


def test_modes_about_a_state_that_is_no_equilibrium(capsys, tmp_path):
    folder = ("--output", tmp_path)
    status, out, _ = run(capsys, "modes", "tracker", "--at-start", "--open-loop", *folder)
    assert status == 0
    assert "tracker about a state that is no equilibrium: 2 degrees of freedom" in out
    status, out, err = run(capsys, "modes", "tracker_gravity", *folder, "--set", "excitation=on")
    assert (status, out) == (2, "")
    assert "modes are those of the scene as it stands" in err


@pytest.mark.slow
def test_modes_tell_the_pose_and_whether_it_is_stable(capsys, tmp_path):
    folder = ("--output", tmp_path)
    _, out, _ = run(capsys, "modes", "tracker_gravity", "-v", *folder)
    assert "stable: all motions die out; at slide_12 0.03299 m, slide_13 -0.04267 m" in out
    assert ["2", "2.30255", "3.46629", "0.747"] in [line.split()[:4] for line in out.splitlines()]
    assert "comes to rest in this pose, beyond a singular configuration of slide_12, slide_13" in out
    branch = json.loads((tmp_path / "modes.json").read_text())["branch"]
    assert (branch["passed"], branch["beyond"]) == (1, True)
    assert branch["passing_times"][0] == pytest.approx(0.12, abs=0.01)
    _, out, _ = run(capsys, "modes", "free_top", *folder)
    assert "neutral: modes 1, 2, 3, 4, 5, 6 are rigid, nothing drives them back; at floating[0] 0 m" in out
    assert out.count(" rigid  ") == 6


@pytest.mark.slow
def test_control_laws_hold_the_pose_that_is_asked_for(capsys, tmp_path):
    """The weight overcomes the published gains, which cannot hold the tracker up."""
    pose = ("--pose", "slide_12=0.02", "--pose", "slide_13=0.01", "--output", tmp_path)
    status, out, err = run(capsys, "modes", "tracker_gravity", *pose)
    assert (status, err) == (0, "")
    assert "unstable: mode 1 grows; at slide_12 0.02 m, slide_13 0.01 m" in out
    assert "the control laws hold the pose that was asked for, on the branch of the initial pose" in out
    scene = load("tracker_gravity")
    state = solve_poses(scene, {"slide_12": 0.02, "slide_13": 0.01}).state(0)
    held = hold(scene, state)
    weight = statics(scene, state).actuator_force
    assert [law.feedforward for law in held.control] == pytest.approx(weight.tolist(), rel=1e-12)
    rate = max(value["eigenvalue"][0] for value in json.loads((tmp_path / "modes.json").read_text())["modes"])
    # the run leaves the pose at this rate
    moved = replace(held, initial_state=state, duration=20.0, output_period=0.5)
    moved = replace(moved, control=(replace(held.control[0], target=0.02 + 1e-9), held.control[1]))
    rates = simulate(moved, rtol=1e-12, atol=1e-14).joint("slide_12").rates[:, 0]
    assert np.log(rates[-1] / rates[-11]) / 5.0 == pytest.approx(rate, rel=1e-3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("tracker_gravity", "--pose", "slide_12=high"), "is not of the form JOINT=VALUE, in m or rad"),
        (("tracker_gravity", "--pose", "slide_12=0", "--pose", "slide_12=1"), "slide_12 is given twice"),
        (("tracker_gravity", "--pose", "slide_14=0"), "unknown joint 'slide_14'; did you mean"),
        (("tracker", "--pose", "slide_12=0.033", "--pose", "slide_13=-0.0427"), "pose 0: out of reach"),
        (("tracker", "--at-start", "--pose", "slide_12=0"), "--at-start and --pose choose different poses"),
        (("tracker_sun_day", "--time", "13"), "time is 13.0; needed: a time of the run, 0 to 12 s"),
        (("tracker_sun_day", "--time", "nan"), "time is nan; needed: a time of the run, 0 to 12 s"),
    ],
)
def test_poses_that_cannot_be_are_refused_in_one_line(capsys, tmp_path, arguments, message):
    status, out, err = run(capsys, "modes", *arguments, "--output", tmp_path / "new")
    assert (status, out) == (2, "")
    assert message in err
    assert len(err.splitlines()) == 1
    assert not list((tmp_path / "new").glob("modes.*"))


@pytest.mark.slow
def test_a_mechanism_that_never_rests_is_refused_with_what_to_do(capsys, tmp_path):
    text = """<mujoco><worldbody><body name="stone"><joint name="fall" type="slide" axis="0 0 1"/>
      <geom size="0.1"/></body></worldbody></mujoco>"""
    (tmp_path / "stone.xml").write_text(text)
    status, out, err = run(capsys, "modes", tmp_path / "stone.xml", "--output", tmp_path)
    assert (status, out) == (2, "")
    assert "coordinate 'fall' still accelerates" in err
    assert err.endswith("or another pose: --pose JOINT=VALUE or --at-start\n")


def test_modes_that_grow_are_named():
    grows = Modes(np.array([-1.0 + 2.0j, 0.5 + 3.0j]), np.zeros((2, 1)), np.zeros((2, 1, 6)))
    assert stability(grows) == "unstable: mode 2 grows"


@pytest.mark.slow
def test_drawn_motion_keeps_hinges_closed_to_first_order():
    scene = load("stewart")
    model = linearize(scene, equilibrium(scene))
    modes = model.modes()
    for twist in modes.twists:
        run_of_mode = animate_mode(scene.mechanism, model, twist)
        for equations in scene.mechanism.equations:
            joint, ends = equations.joint, []
            for body, point in ((equations.first, joint.point), (equations.second, joint.point_on_second)):
                arm = scene.mechanism.bodies[body].pose.point_to_body(point)
                turn = np.array([rotation(p) for p in run_of_mode.quaternion[:, body]])
                ends.append(run_of_mode.position[:, body] + turn @ arm)
            if joint.kind == "universal":
                opening = np.linalg.norm(ends[0] - ends[1], axis=1).max()
                assert opening < AMPLITUDE**2 * scene.mechanism.size


def test_a_damped_oscillator_has_its_natural_frequency():
    """A crank of 1 kg m^2 held by 100 N m/rad, damped by 4 N m s/rad: 10 rad/s, ratio 0.2."""
    crank = Body("crank", 1.0, [0.0, 0.0, 0.0], np.eye(3))
    pivot = Revolute("pivot", "ground", "crank", [0.0, 0.0, 0.0], axis=[0.0, 1.0, 0.0], actuated=True)
    law = PD("pivot", 100.0, 4.0, target=0.0)
    scene = Scene("crank", Mechanism([Body.ground(), crank], [pivot]), 1.0, 0.1, control=(law,))
    found = analyze(scene)
    (mode,) = data(found)["modes"]
    assert mode["undamped_frequency"] == pytest.approx(10.0 / (2.0 * np.pi), rel=1e-12)
    assert mode["damping_ratio"] == pytest.approx(0.2, rel=1e-12)
    assert mode["frequency"] == pytest.approx(np.sqrt(96.0) / (2.0 * np.pi), rel=1e-12)
    (row,) = csv.DictReader(to_csv(found).splitlines())
    assert float(row["undamped frequency, Hz"]) == pytest.approx(10.0 / (2.0 * np.pi), rel=1e-8)
    cells = table(scene.mechanism, found.modes).rows[0]
    assert cells[1:4] == ["1.55939", "1.59155", "0.2"]
