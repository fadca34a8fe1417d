"""`crosscheck modes`: its table and its recording."""

from __future__ import annotations

import numpy as np
from command_line import run
from rerun.chunk import RrdReader

from crosscheck.design.modes import stability
from crosscheck.library import load
from crosscheck.recording.modes import AMPLITUDE, animate_mode
from newton_euler.analysis.linear.linear_model import Modes
from newton_euler.analysis.linear.linearization import linearize
from newton_euler.analysis.loads.equilibrium import equilibrium
from newton_euler.model.euler_parameters import rotation


def test_modes_prints_a_table_and_writes_a_recording(capsys, tmp_path):
    path = tmp_path / "modes.rrd"
    status, out, err = run(capsys, "modes", "pendulum", "--save", path)
    assert (status, err) == (0, "")
    assert "pendulum about an equilibrium: 1 degree of freedom" in out
    frequency = np.sqrt(9.81) / (2.0 * np.pi)  # all of its mass at 1 m
    assert "neutral: undamped motions neither die out nor grow; at pivot 1.571 rad" in out
    assert out.splitlines()[5].split()[:5] == ["1", f"{frequency:.6g}", "0", "-", "dumbbell:"]
    assert all(len(line) <= 80 for line in out.splitlines() if str(tmp_path) not in line)
    (recording,) = RrdReader(path).recordings()
    assert recording.application_id == "crosscheck_pendulum"


def test_modes_about_a_state_that_is_no_equilibrium(capsys, tmp_path):
    save = ("--save", tmp_path / "modes.rrd")
    status, out, _ = run(capsys, "modes", "tracker", "--at-start", "--open-loop", *save)
    assert status == 0
    assert "tracker about a state that is no equilibrium: 2 degrees of freedom" in out
    status, out, err = run(capsys, "modes", "tracker_gravity", *save, "--set", "excitation=on")
    assert (status, out) == (2, "")
    assert "modes are those of the scene as it stands" in err


def test_modes_tell_the_pose_and_whether_it_is_stable(capsys, tmp_path):
    save = ("--save", tmp_path / "modes.rrd")
    _, out, _ = run(capsys, "modes", "tracker_gravity", "-v", *save)
    assert "stable: all motions die out; at slide_12 -0.01094 m, slide_13 0.02297 m" in out
    assert ["2", "-12.0417338", "16.4855241"] in [line.split() for line in out.splitlines()]
    _, out, _ = run(capsys, "modes", "free_top", *save)
    assert "neutral: modes 1, 2, 3, 4, 5, 6 are rigid, nothing drives them back; at floating[0] 0 m" in out
    assert out.count(" rigid  ") == 6


def test_modes_that_grow_are_named():
    grows = Modes(np.array([-1.0 + 2.0j, 0.5 + 3.0j]), np.zeros((2, 1)), np.zeros((2, 1, 6)))
    assert stability(grows) == "unstable: mode 2 grows"


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
