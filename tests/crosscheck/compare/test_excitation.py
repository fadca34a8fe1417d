"""Excited model files: what drives and moves them, against MuJoCo's own runs of the files."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from mechanisms import mass_on_rail, planar_four_bar
from mjcf_models import BOX, PAIR, model, reading, verified
from urdf_files import CHAIN

import newton_euler
import urdf
from crosscheck.cli import main
from crosscheck.compare.coverage import covered_by
from crosscheck.library import load
from crosscheck.studies.benchmark.run import BenchmarkRequest
from mjcf.reader import Reading
from newton_euler.equations.relative import Relative
from newton_euler.equations.system import constraint_rate
from newton_euler.model.control import PD
from newton_euler.model.motions import Sum
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Sine
from newton_euler.reading.activity import Bounds, SampledMotion
from newton_euler.reading.excitation import (
    MAX_START_SPEED,
    MAX_START_SPIN,
    SWING_LENGTH,
    _rooms,
    swings,
    with_start_velocities,
)
from newton_euler.runs.assemble import initial_state

ACTUATORS = (
    '<motor name="free" joint="p"/>'
    '<motor name="end" joint="q" gear="2" ctrllimited="true" ctrlrange="0 0.1"/>'
    '<position name="servo" joint="r" kp="300" kv="5" ctrlrange="-1 1"/>'
    '<general name="slow" joint="p" dyntype="filter" dynprm="0.05" gainprm="3" ctrlrange="-0.2 0.2"/>'
    '<general name="sum" joint="q" dyntype="integrator" gainprm="3" ctrlrange="-2 2" actrange="-0.1 0.3"/>'
    '<general name="of_length" joint="q" gaintype="affine" gainprm="1 2"/>'
)

FILE = model(
    PAIR, f"<actuator>{ACTUATORS}</actuator>", '<option timestep="0.0005" integrator="RK4" gravity="0 0 -1"/>'
)


def sines(scene: Scene) -> dict[tuple[str, int], list[Sine]]:
    """What drives each joint coordinate."""
    found = {}
    for law in scene.control:
        assert isinstance(law, PD)
        push = law.feedforward
        terms = push.terms if isinstance(push, Sum) else [push] if isinstance(push, Sine) else []
        found[law.joint, law.coordinate] = [term for term in terms if isinstance(term, Sine)]
    return found


def test_start_velocities_fit_the_constraints_and_move_all_joints() -> None:
    scene = planar_four_bar()
    moved, words = with_start_velocities(scene)
    system = Relative(moved)
    q, v = system.coordinates(initial_state(moved))
    assert np.abs(constraint_rate(system, q, v)).max() < 1e-12 * MAX_START_SPIN
    omega = initial_state(moved).angular_velocity
    turning = [np.linalg.norm(omega[e.second] - omega[e.first]) for e in moved.mechanism.equations]
    assert min(turning) > 0.01 * MAX_START_SPIN
    assert max(turning) == pytest.approx(MAX_START_SPIN)
    assert words == f"start velocities up to {max(turning):.2g} rad/s"
    again, _ = with_start_velocities(scene)
    assert np.array_equal(initial_state(again).angular_velocity, omega)


def test_a_mass_slides_at_most_so_fast_and_a_motor_moves_it_about_so_far() -> None:
    scene = mass_on_rail(duration=1.0, control=(PD("rail", 0.0, 0.0, 0.0),))
    size = scene.mechanism.size
    speed = np.linalg.norm(initial_state(with_start_velocities(scene)[0]).linear_velocity[1])
    assert speed == pytest.approx(MAX_START_SPEED * size)
    (swing,) = swings(scene, [{("rail", 0): 3.0}])
    push = Sine(3.0 * swing.amplitude, swing.angular_frequency)
    driven = mass_on_rail(duration=1.0, control=(PD("rail", 0.0, 0.0, 0.0, feedforward=push),))
    way = np.abs(newton_euler.simulate(driven).position[:, 1, 2]).max()
    assert 0.5 * SWING_LENGTH * size < way < 1.1 * SWING_LENGTH * size


@pytest.mark.parametrize(("room", "share"), [(10.0, 1.0), (0.5, 0.25), (0.0, 0.05)])
def test_a_motor_moves_a_joint_by_half_of_the_room_that_its_limits_leave(room: float, share: float) -> None:
    """Where the room is given in units of what the motor would move it by."""
    scene = mass_on_rail(control=(PD("rail", 0.0, 0.0, 0.0),))
    reach = SWING_LENGTH * scene.mechanism.size
    bounds = [Bounds(((("rail", 0), 1.0),), -room * reach, 20.0 * reach, "m")]
    (swing,) = swings(scene, [{("rail", 0): 3.0}], bounds)
    assert swing.amplitude_within_limits == pytest.approx(share * swing.amplitude)


def test_controls_swing_within_half_of_their_ranges(tmp_path: Path) -> None:
    found = reading(tmp_path, FILE, excitation=True)
    assert verified(found)
    driven = sines(found.scene)
    frequencies = [sine.angular_frequency / (2.0 * np.pi) for each in driven.values() for sine in each]
    assert len(set(frequencies)) == 5
    assert 0.7 <= min(frequencies) <= max(frequencies) <= 1.9
    (servo,) = driven["two_joints", 0]
    size = found.scene.mechanism.size
    assert servo.amplitude == pytest.approx(300.0 * min(SWING_LENGTH * size, 0.25))
    hows = {entry.element: entry.how for entry in found.report.entries}
    end = hows["actuator 'end'"]  # a quarter of the range off its end, half of that to and fro
    assert "its control 0.025 + 0.0125 sin(" in end
    assert "its control held at 0" in hows["actuator 'of_length'"]
    (line,) = [line for line in found.report.start if line.startswith("excited: ")]
    assert line.startswith(
        f"excited: 5 actuators driven at {min(frequencies):.2g} to {max(frequencies):.2g} Hz, "
    )
    assert "1 control moved inside the ranges of control and force (end from 0 to 0.025), " in line
    assert "1 actuator with the controls of the file (of_length)" in line
    slow = driven["p", 0][1]  # what its filter leaves of the range, at its fastest
    assert 0.0 < slow.amplitude <= 3.0 * 0.5 * 0.2 / np.hypot(1.0, 0.05 * 2.0 * np.pi * 1.9) * (1 + 1e-12)


def test_controls_that_the_file_clips_are_named(tmp_path: Path) -> None:
    """A control of 1 asks for 2 N m of 0.1, and one of 5 is beyond its range."""
    servos = (
        '<position name="weak" joint="p" kp="2" ctrlrange="-3 3" forcerange="-0.1 0.1"/>'
        '<motor name="far" joint="q" ctrlrange="-1 1"/>'
    )
    text = model(PAIR, f'<actuator>{servos}</actuator><keyframe><key name="go" ctrl="1 5"/></keyframe>')
    found = reading(tmp_path, text, excitation=True)
    (line,) = [line for line in found.report.start if line.startswith("excited: ")]
    assert "weak from 1 to " in line
    found = reading(tmp_path, text)
    hows = {entry.element: entry.how for entry in found.report.entries}
    assert "its control 5 is clipped to 1 by its range" in hows["actuator 'far'"]


def test_start_velocities_leave_room_to_the_force_of_a_damped_servo(tmp_path: Path) -> None:
    """At 0.5 rad/s its damping alone would take 200 N m, four times the range of its force."""
    servo = '<position joint="p" kp="4000" kv="400" ctrlrange="-1 1" forcerange="-50 50"/>'
    option = '<option gravity="0 0 0"/>'
    found = reading(tmp_path, model(PAIR, f"<actuator>{servo}</actuator>", option), excitation=True)
    (bound,) = (each for each in found.report.bounds if each.by_rate)
    run = newton_euler.simulate(found.scene)
    motion = SampledMotion(found.scene, run)
    rate = abs(motion.coordinate(bound.terms[0][0])[1][0])
    largest = 0.5 * 50.0 / 400.0
    assert 0.5 * largest <= rate <= largest * (1.0 + 1e-12)  # drawn from the upper half
    assert not bound.judge(motion).active


def test_start_velocities_stay_within_the_limits_of_joints(tmp_path: Path) -> None:
    """One joint starts at its lower limit, one near its upper one, one outside: all move inwards."""
    ranges = {"low": "0 90", "high": "-90 3", "out": "-90 -5"}
    hinge = (
        '<body pos="{} 0 0"><joint name="{}" axis="0 0 1" range="{}"/>' + BOX.format("0.1 0 0") + "</body>"
    )
    bodies = "".join(hinge.format(k, *each) for k, each in enumerate(ranges.items()))
    found = reading(tmp_path, model(bodies), excitation=True, duration=0.5)
    start = initial_state(found.scene)
    rates = {name: found.scene.mechanism.measure((name, 0), start.frames())[1] for name in ranges}
    assert 0.0 < rates["low"] <= MAX_START_SPIN
    assert -MAX_START_SPIN <= rates["high"] < 0.0
    assert -MAX_START_SPIN <= rates["out"] < 0.0
    motion = SampledMotion(found.scene, newton_euler.simulate(found.scene))
    acting = {entry.element for entry in found.report.after(motion).acting}
    assert acting == {"joint 'out'"}


@pytest.mark.parametrize("joint", ["a", "b", "c"])
@pytest.mark.parametrize(("limits", "inwards"), [("-0.5 90", 1.0), ("-90 0.5", -1.0)])
def test_start_velocities_of_a_closed_loop_stay_within_the_limits_of_joints(
    joint: str, limits: str, inwards: float, tmp_path: Path
) -> None:
    """The loop decides how joints move together: all move the way in which the limited one has room."""

    def hinge(name: str) -> str:
        limited = f'range="{limits}"' if name == joint else ""
        return f'<joint name="{name}" axis="0 1 0" {limited}/>'

    bodies = (
        f'<body name="crank">{hinge("a")}{BOX.format("0 0 0.1")}'
        f'<body name="coupler" pos="0 0 0.2">{hinge("b")}{BOX.format("0.25 0 0.05")}'
        '<site name="p" pos="0.5 0 0.1"/></body></body>'
        f'<body name="rocker" pos="0.5 0 0">{hinge("c")}{BOX.format("0 0 0.15")}'
        '<site name="q" pos="0 0 0.3"/></body>'
    )
    loop = '<equality><connect name="loop" site1="p" site2="q"/></equality>'
    option = '<option gravity="0 0 0"/>'
    found = reading(tmp_path, model(bodies, loop, option), excitation=True, duration=0.5)
    start = initial_state(found.scene)
    rates = {name: found.scene.mechanism.measure((name, 0), start.frames())[1] for name in "abc"}
    assert rates[joint] * inwards > 0.0
    assert 0.4 * MAX_START_SPIN < max(map(abs, rates.values())) <= MAX_START_SPIN
    motion = SampledMotion(found.scene, newton_euler.simulate(found.scene))
    assert not found.report.after(motion).acting


def test_start_velocities_of_loops_without_a_common_constraint_are_chosen_apart(tmp_path: Path) -> None:
    """Two loops move inwards from opposite limits, and an arm beside them as fast as without limits."""

    def loop(number: int, limits: str) -> tuple[str, str]:
        bodies = (
            f'<body pos="0 {number} 0"><joint name="a{number}" axis="0 1 0" range="{limits}"/>'
            f'{BOX.format("0 0 0.1")}<body pos="0 0 0.2"><joint axis="0 1 0"/>{BOX.format("0.25 0 0.05")}'
            f'<site name="p{number}" pos="0.5 0 0.1"/></body></body>'
            f'<body pos="0.5 {number} 0"><joint axis="0 1 0"/>{BOX.format("0 0 0.15")}'
            f'<site name="q{number}" pos="0 0 0.3"/></body>'
        )
        return bodies, f'<connect site1="p{number}" site2="q{number}"/>'

    arm = f'<body pos="0 3 0"><joint name="arm" axis="0 1 0"/>{BOX.format("0.2 0 0")}</body>'
    rates = []
    for limits in (("-90 0.5", "-0.5 90"), ("-90 90", "-90 90")):
        (one, first), (two, second) = (loop(k, each) for k, each in enumerate(limits))
        text = model(one + two + arm, f"<equality>{first}{second}</equality>")
        scene = reading(tmp_path, text, excitation=True, duration=0.5).scene
        frames = initial_state(scene).frames()
        rates.append([scene.mechanism.measure((name, 0), frames)[1] for name in ("a0", "a1", "arm")])
    limited, free = rates
    assert limited[0] < 0.0 < limited[1]
    assert np.abs(limited) == pytest.approx(np.abs(free), rel=1e-9)
    assert np.min(np.abs(limited)) > 0.5 * MAX_START_SPIN


@pytest.mark.parametrize("dynamics", ["filter", "filterexact", "integrator"])
def test_an_early_activation_is_read_as_that_of_the_state(tmp_path: Path, dynamics: str) -> None:
    """MuJoCo takes `actearly` activations from the end of its time step, which no motion in time has."""
    actuator = f'<general joint="p" dyntype="{dynamics}" dynprm="0.9" gainprm="3" actearly="true"/>'
    assert verified(reading(tmp_path, model(PAIR, f"<actuator>{actuator}</actuator>"), excitation=True))


@pytest.mark.parametrize("excitation", [False, True])
def test_a_range_without_end_is_read(tmp_path: Path, excitation: bool) -> None:
    """MuJoCo takes controls beyond 1e10 for a mistake, ranges not."""
    text = (
        '<mujoco><worldbody><body><joint name="j"/><geom size="1" pos="1 0 0"/></body></worldbody>'
        '<actuator><motor joint="j" ctrllimited="true" ctrlrange="-1e12 1e12"/></actuator></mujoco>'
    )
    assert verified(reading(tmp_path, text, excitation=excitation))


def controls(found: Reading, time: float) -> list[float]:
    """ctrl of `FILE` with which MuJoCo does what the scene says."""
    driven = sines(found.scene)

    def swing(sine: Sine, gain: float) -> tuple[float, float]:
        w = sine.angular_frequency
        return sine.amplitude / gain * np.sin(w * time), sine.amplitude / gain * w * np.cos(w * time)

    free, slow = driven["p", 0]
    end, total = driven["two_joints", 1]
    (servo,) = driven["two_joints", 0]
    filtered, rate = swing(slow, 3.0)
    return [
        swing(free, 1.0)[0],
        0.025 + swing(end, 2.0)[0],
        swing(servo, 300.0)[0],
        filtered + 0.05 * rate,
        swing(total, 3.0)[1],
        0.0,
    ]


def test_mujoco_moves_alike_with_the_controls_that_swing(tmp_path: Path) -> None:
    """The file itself with these controls, filters and integrators included: 1e-4 m at 0.5 ms, order 1."""
    found = reading(tmp_path, FILE, excitation=True, duration=0.5, output_period=0.1)
    run = newton_euler.simulate(found.scene)
    own, data = found.start.model, mujoco.MjData(found.start.model)
    body = {name: own.body(name).id for name in ("one", "two")}
    start = initial_state(found.scene)
    system = Relative(found.scene)
    seen = system.measured(*system.coordinates(start))
    data.qvel[:] = [seen[key].rate for key in (("p", 0), ("two_joints", 1), ("two_joints", 0))]
    steps = round(0.5 / own.opt.timestep)
    for n in range(steps):
        data.ctrl[:] = controls(found, (n + 0.5) * own.opt.timestep)
        mujoco.mj_step(own, data)
    mujoco.mj_kinematics(own, data)
    names = found.scene.mechanism.body_names
    for name, k in body.items():
        way = run.position[-1, names.index(name)] - run.position[0, names.index(name)]
        assert np.abs(way).max() > 0.01
        assert data.xipos[k] == pytest.approx(run.position[-1, names.index(name)], abs=1e-4)


def test_velocities_of_a_keyframe_are_kept(tmp_path: Path) -> None:
    text = FILE.replace("</mujoco>", '<keyframe><key qvel="1 2 3"/></keyframe></mujoco>')
    as_it_stands, found = (reading(tmp_path, text, excitation=excitation) for excitation in (False, True))
    assert np.array_equal(
        initial_state(as_it_stands.scene).linear_velocity, initial_state(found.scene).linear_velocity
    )


def test_a_reading_is_not_excited_unless_asked_for(tmp_path: Path) -> None:
    found = reading(tmp_path, FILE)
    assert not np.any(initial_state(found.scene).linear_velocity)
    assert not any(sines(found.scene).values())
    assert not any(line.startswith("excited") for line in found.report.start)


@pytest.mark.parametrize("control", [0, 5], ids=["within", "beyond"])
def test_a_force_is_driven_within_its_limit(control: int, tmp_path: Path) -> None:
    motor = '<actuator><motor name="m" joint="p" ctrlrange="-9 9" forcerange="-1 1"/></actuator>'
    key = f'<keyframe><key ctrl="{control}"/></keyframe>'
    found = reading(tmp_path, model(PAIR, f"{motor}{key}"), excitation=True)
    (sine,) = sines(found.scene)["p", 0]
    assert 0.0 < sine.amplitude <= 0.5
    assert abs(sine.offset) + sine.amplitude <= 1.0


def test_a_watched_limit_sees_a_force_that_swings() -> None:
    law = PD("rail", 0.0, 0.0, 0.0, feedforward=Sine(2.0, 7.0))
    scene = mass_on_rail(duration=1.0, control=(law,))
    motion = SampledMotion(scene, newton_euler.simulate(scene))
    for high, active in ((1.9, True), (2.1, False)):
        watch = Bounds((), -2.5, high, "N", Sine(2.0, 7.0))
        assert watch.judge(motion).active == active


def test_a_urdf_moves_at_the_start(tmp_path: Path) -> None:
    path = tmp_path / "chain.urdf"
    path.write_text(CHAIN)
    still, moved = (urdf.read(path, excitation=excitation) for excitation in (False, True))
    assert not np.any(initial_state(still.scene).angular_velocity)
    assert np.all(np.any(initial_state(moved.scene).angular_velocity[1:], axis=1))
    assert any(line.startswith("excited: start velocities up to ") for line in moved.report.start)


def test_excitation_covers_what_a_file_leaves_still(tmp_path: Path) -> None:
    text = FILE.replace('gravity="0 0 -1"', 'gravity="0 0 0"')
    shares = []
    for excitation in (False, True):
        scene = reading(tmp_path, text, excitation=excitation).scene
        covered = covered_by(scene, 1e-6, 1e-6)
        shares.append(1.0 - len(covered.untested) / len(covered.elements))
    assert shares[0] == 0.0
    assert shares[1] >= 0.9


@pytest.mark.slow
@pytest.mark.parametrize(("command", "excited"), [("run", True), ("convert", False)])
def test_runs_excite_by_default(
    command: str, excited: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "model.xml"
    path.write_text(FILE)
    more = ["--output", str(tmp_path / "out"), "--set", "duration=0.1"] if command == "run" else []
    target = [] if command == "run" else [str(tmp_path / "model.yaml")]
    for settings, expected in (([], excited), (["--set", "excitation=off"], False)):
        with pytest.raises(SystemExit) as end:
            main([command, str(path), *target, *more, *settings])
        assert end.value.code == 0
        assert ("excited: " in capsys.readouterr().out) == expected


def test_the_list_names_the_commands_that_excite(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["list"])
    assert "on in run, tune, regress, sweep, bench and tests" in " ".join(capsys.readouterr().out.split())


def test_bench_excites_as_run_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "model.xml"
    path.write_text(FILE)
    moves: list[bool] = []

    def bench(wanted: BenchmarkRequest, *_: object) -> tuple[list[str], list[Path]]:
        moves.append(bool(np.any(initial_state(wanted.scene).linear_velocity)))
        return [], []

    monkeypatch.setattr("crosscheck.studies.benchmark.run.bench", bench)
    for settings in ([], ["--set", "excitation=off"]):
        with pytest.raises(SystemExit):
            main(["bench", str(path), *settings])
    assert moves == [True, False]


@pytest.mark.parametrize("command", [["convert", "{0}", "{0}.urdf"], ["faults", "{0}", "--reading"]])
def test_excitation_without_effect_is_refused(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "model.xml"
    path.write_text(FILE)
    with pytest.raises(SystemExit) as end:
        main([*(word.format(path) for word in command), "--set", "excitation=on"])
    assert end.value.code == 2
    assert "--set excitation=on has no effect here: " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("bound", "down", "up"),
    [
        ({"low": -0.1, "high": 0.5}, 0.1, 0.5),
        ({"low": 0.2, "high": 0.5}, 0.0, 0.5),  # outside of its range at the start: it may move inwards
        ({"low": -0.1, "high": 0.5, "by_value": -2.0}, 0.25, 0.05),
        ({"low": -0.1, "high": 0.5, "constant": 0.2}, 0.3, 0.3),
    ],
)
def test_room_of_a_coordinate_to_its_limits(bound, down, up):
    scene = load("pendulum")
    (joint,) = scene.mechanism.joint_names
    limits = Bounds(terms=(((joint, 0), 1.0),), unit="rad", **bound)
    (room,) = _rooms(Relative(scene), [limits])
    assert (room.down, room.up) == (pytest.approx(down), pytest.approx(up))
