"""Logs of other simulators: known errors, names and units of columns, and a line for each kind of damage."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import crosscheck
import newton_euler
from crosscheck.compare.activity import acting_events, watched
from crosscheck.library import load
from crosscheck.loading.load import load_scene
from crosscheck.logs import reading
from crosscheck.logs.inputs import with_logged_forces
from crosscheck.logs.judge import Log, judge_log
from crosscheck.logs.mistakes import _delay, find_mismatches, find_mistakes
from crosscheck.logs.options import LogOptions
from crosscheck.logs.poses import loop_joints
from crosscheck.logs.table import read_table
from crosscheck.own_run.allowed import AllowedError, ErrorKind, length
from crosscheck.own_run.errors import Band, LoopError
from crosscheck.report.log import log_lines
from crosscheck.report.own_run import percent
from newton_euler import (
    PD,
    Armature,
    Body,
    JointFriction,
    JointSpring,
    Mechanism,
    Polynomial,
    Revolute,
    Scene,
    Sine,
    Sum,
    simulate,
)
from newton_euler.errors import NewtonEulerError
from newton_euler.model.source_file import SourceError
from newton_euler.model.trajectory import IntegrationError
from newton_euler.reading.file_run import Event

FOUR_BAR = """<mujoco><option timestep="{step}" integrator="{integrator}"/>
  <default><equality solref="{softness} 1"/></default><worldbody>
  <body name="crank"><joint name="motor" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 .1" size=".01"/>
    <body name="coupler" pos="0 0 .1"><joint name="elbow" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 .3 0 .15" size=".01"/></body></body>
  <body name="rocker" pos=".3 0 0"><joint name="pivot" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0 0 .25" size=".01"/></body></worldbody>
  <contact><exclude body1="coupler" body2="rocker"/></contact>
  <equality><connect body1="coupler" body2="rocker" anchor=".3 0 .15"/></equality>
  <actuator><motor name="drive" joint="motor"/></actuator></mujoco>"""

OSCILLATOR = """<mujoco><option timestep="{step}" gravity="0 0 0"/><worldbody>
  <body name="mass"><joint name="slide" type="slide" axis="1 0 0" stiffness="50"/>
    <inertial pos="0 0 0" mass="2" diaginertia="0.1 0.1 0.1"/></body></worldbody></mujoco>"""

CLAMPED = """<mujoco><option timestep="0.001" integrator="RK4"/><worldbody><body name="rod" pos="0 0 1">
  <joint name="h" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .5 0 0" size=".02" contype="0"/></body>
  </worldbody><actuator><motor name="u" joint="h" ctrllimited="true" ctrlrange="-1 1"/></actuator></mujoco>"""

FLOATING = """<mujoco><worldbody><body name="rod" pos="0 0 1"><joint name="hinge" axis="0 1 0"/>
  <geom type="capsule" fromto="0 0 0 .5 0 0" size=".02" contype="0"/>
  <body name="tip_body" pos=".2 0 .1"><joint name="tip" axis="0 1 0"/>
    <geom size=".01" contype="0"/></body></body>
  <body name="buoy" pos=".5 0 1"><freejoint name="float"/><geom size=".1" contype="0"/></body></worldbody>
  <equality><connect name="tie" body1="rod" body2="buoy" anchor=".5 0 0"/></equality></mujoco>"""

FALLING = """<mujoco><option timestep="0.001" integrator="RK4" gravity="0 0 {gravity}"/><worldbody>
  <geom type="plane" size="1 1 .1"/><body name="ball" pos="0 0 .15">
  <joint name="z" type="slide" axis="0 0 1"/><geom type="sphere" size=".05" mass="1"/></body>
  </worldbody></mujoco>"""

SMALL_STEP = 2e-4
BODIES = ("crank", "coupler", "rocker")
KICK = np.zeros(3), np.array([5.0, -5.0, 2.0])
"""Start of the four-bar: its pose, and rates with which the coupler begins to translate."""


def run_of(text, steps, every, control=None, start=None):
    """A run by plain MuJoCo: model, and rows of time, qpos, qvel, xpos, xquat, xipos and ctrl."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    if start is not None:
        data.qpos[:], data.qvel[:] = start
    rows = []
    for k in range(steps + 1):
        if control is not None:
            data.ctrl[:] = control(data.time)
        if k % every == 0:
            mujoco.mj_forward(model, data)
            arrays = data.qpos, data.qvel, data.xpos, data.xquat, data.xipos, data.ctrl
            rows.append([data.time, *(array.copy() for array in arrays)])
        mujoco.mj_step(model, data)
    return model, [np.array(column) for column in zip(*rows, strict=True)]


@pytest.fixture(scope="module")
def four_bar(tmp_path_factory):
    """The file, its scene and names, and logs of joints and of bodies by plain MuJoCo at small steps."""
    path = tmp_path_factory.mktemp("logs") / "bar.xml"
    text = FOUR_BAR.format(step=SMALL_STEP, integrator="RK4", softness=2 * SMALL_STEP)
    path.write_text(text)
    scene, report = load_scene(str(path), {"excitation": "off"}, verified=False)
    model, (time, q, v, frame, turn, center, _) = run_of(text, 2500, 25, start=KICK)
    joints, bodies = {"time": time}, {"time": time}
    for k in range(model.njnt):
        joints[model.joint(k).name] = q[:, k]
        joints[f"{model.joint(k).name}_vel"] = v[:, k]
    centers = dict(bodies)
    for name in BODIES:
        number = model.body(name).id
        for where, table in ((frame, bodies), (center, centers)):
            table |= {f"/poses/{name}/position/{c}": where[:, number, i] for i, c in enumerate("xyz")}
            table |= {f"/poses/{name}/orientation/{c}": turn[:, number, i] for i, c in enumerate("wxyz")}
    return path, scene, report.names, joints, bodies, centers


def judged(four_bar, table, **options):
    return judge_log(four_bar[1], four_bar[2], "isaac", Log(table, **options))


@pytest.mark.parametrize("columns", [3, 4, 5])
def test_a_run_at_small_steps_agrees(four_bar, columns):
    found = judged(four_bar, four_bar[columns])
    assert found.error.relative < 2e-4
    assert found.compared == BODIES
    assert found.mistakes == ()
    assert found.points == {3: "", 4: "frame", 5: "center"}[columns]


def test_the_error_of_an_oscillator_is_the_known_one(tmp_path):
    step, speed = 0.004, 0.7
    text = OSCILLATOR.format(step=step)
    path = tmp_path / "mass.xml"
    path.write_text(text)
    _, (time, q, v, *_) = run_of(text, 250, 1, start=(0.0, speed))
    scene, report = load_scene(str(path), {"excitation": "off"}, verified=False)
    log = {"time": time, "slide": q[:, 0], "slide_vel": v[:, 0]}
    found = judge_log(scene, report.names, "log", log)
    expected = np.max(np.abs(q[:, 0] - speed / 5.0 * np.sin(5.0 * time)))
    assert found.error.position == pytest.approx(expected, rel=0.01)
    # the energy that the motion exchanges is that of the mass, and as much of the spring
    energy = v[:, 0] ** 2 + 25.0 * q[:, 0] ** 2
    assert found.has_energy
    assert found.error.energy == pytest.approx(
        np.max(np.abs(energy - energy[0])) / (2.0 * speed**2), rel=0.01
    )
    # a mechanism without loops, whose violation no limit can concern
    assert (found.loop_error, set(found.undetermined)) == (LoopError(), {"opening", "loop_angle"})


def test_a_floating_body_that_a_constraint_ties_is_in_a_loop(tmp_path):
    path = tmp_path / "floating.xml"
    path.write_text(FLOATING)
    mechanism = load_scene(str(path), {"excitation": "off"}, verified=False)[0].mechanism
    # ground, rod, buoy and back; the tip on the rod is in no loop
    assert mechanism.joint_names == ("hinge", "tip", "float", "tie")
    assert loop_joints(mechanism) == ("hinge", "float", "tie")


def renamed(table, new):
    return {new(name): column for name, column in table.items()}


@pytest.mark.parametrize(
    ("new", "options"),
    [
        (lambda name: name.upper(), {}),
        (
            lambda name: name if name == "time" else f"/arm/joint_states/{name.replace('_vel', '/velocity')}",
            {},
        ),
        (lambda name: {"time": "t [s]"}.get(name, name), {}),
        (
            lambda name: {"motor": "q1", "time": "clock_s"}.get(name, name),
            {"columns": {"q1": "coordinate.motor"}},
        ),
    ],
)
def test_names_of_columns(four_bar, new, options):
    found = judged(four_bar, renamed(four_bar[3], new), **options)
    assert found.error.relative < 2e-4
    assert found.unused == ()


def test_units_in_names_and_options(four_bar):
    joints = four_bar[3]
    degrees = {name: column if name == "time" else np.degrees(column) for name, column in joints.items()}
    named = renamed(degrees, lambda n: n if n == "time" else f"{n} [deg{'/s' * n.endswith('vel')}]")
    assert judged(four_bar, named).error.relative < 2e-4
    assert judged(four_bar, degrees, angle="deg").error.relative < 2e-4


def xyzw(table, numbered=False):
    """Quaternions as x, y, z, w under names that say w, x, y, z, or with numbers."""
    found = {}
    for name, column in table.items():
        head, slash, letter = name.rpartition("/")
        if "orientation" not in name:
            found[name] = column
        elif numbered:
            found[f"{head}/{'xyzw'.index(letter)}"] = column
        else:
            found[name] = table[head + slash + "xyzw"["wxyz".index(letter)]]
    if numbered:
        found = dict(sorted(found.items()))
    return found


def held(table, rows):
    """A log that begins some rows before the run."""
    late = {}
    for name, column in table.items():
        late[name] = np.concatenate([np.repeat(column[:1], rows), column])
    step = table["time"][1]
    return late | {"time": step * np.arange(len(table["time"]) + rows)}


def exchanged(table, first, second):
    """A log with the columns of two elements exchanged."""
    names = {first: second, second: first}
    return renamed(table, lambda name: re.sub(rf"\b({first}|{second})(?=\b|_)", lambda m: names[m[1]], name))


DAMAGE = {
    "order of one body": (
        lambda j, b: b | {name: x for name, x in xyzw(b).items() if "coupler" in name},
        "coupler/orientation/w' and 3 more: order x, y, z, w",
        "--log-map '/poses/coupler/orientation/w=quaternion.coupler.x'",
    ),
    "millimeters of one body": (
        lambda j, b: {n: 1e3 * c if "coupler/position" in n else c for n, c in b.items()},
        "coupler/position/x' and 2 more: unit mm",
        "--log-map '/poses/coupler/position/x=position.coupler.x [mm]'",
    ),
    "exchanged joints": (
        lambda j, b: exchanged(j, "motor", "pivot"),
        "'pivot' and 3 more: joints 'pivot' and 'motor' exchanged",
        "--log-map 'pivot=coordinate.motor' --log-map 'pivot_vel=rate.motor'",
    ),
    "exchanged bodies": (
        lambda j, b: exchanged(b, "crank", "rocker"),
        "'/poses/rocker/position/x' and 13 more: bodies 'rocker' and 'crank' exchanged",
        "",
    ),
    "order, by name": (
        lambda j, b: xyzw(b),
        "orientation/w' and 11 more: order x, y, z, w",
        "quaternion=xyzw",
    ),
    "order, by number": (lambda j, b: xyzw(b, True), "orientation/0' and 11 more: order x, y, z, w", "=xyzw"),
    "degrees": (
        lambda j, b: {n: c if n == "time" else np.degrees(c) for n, c in j.items()},
        "'motor' and 5 more: unit deg",
        "--log-set angle=deg",
    ),
    "degrees of one joint": (
        lambda j, b: j | {"elbow": np.degrees(j["elbow"])},
        "column 'elbow': unit deg",
        "--log-map 'elbow=coordinate.elbow [deg]'",
    ),
    "millimeters": (
        lambda j, b: {n: 1e3 * c if "position" in n else c for n, c in b.items()},
        "position/x' and 8 more: unit mm",
        "--log-set length=mm",
    ),
    "milliseconds": (lambda j, b: j | {"time": 1e3 * j["time"]}, "'time': unit ms", "--log-set time=ms"),
    "late": (lambda j, b: held(j, 10), "'time': times 0.05 s earlier", "--log-set offset=0.05"),
    # 150 of 251 rows
    "late by the larger part": (
        lambda j, b: held(j, 150),
        "'time': times 0.75 s earlier, as nothing moves before",
        "--log-set offset=0.75",
    ),
    "late, without velocities": (
        lambda j, b: held({n: c for n, c in j.items() if not n.endswith("_vel")}, 60),
        "'time': times 0.3 s earlier, as nothing moves before",
        "--log-set offset=0.3",
    ),
    "late, from time zero on": (
        lambda j, b: {n: c - 0.3 if n == "time" else c for n, c in held(j, 60).items()},
        "'time': times 0.3 s earlier, as nothing moves before",
        "--log-set offset=0",
    ),
    "first row too early": (
        lambda j, b: {n: c[:-1] if n == "time" else np.delete(c, 1) for n, c in j.items()},
        "'time': times 0.005 s later, or without the first row",
        "",
    ),
}


# 3 to 10 s each: as many readings of the log are compared; others of the same kinds are cheaper
LONG = (
    "millimeters of one body",
    "order of one body",
    "order, by name",
    "exchanged bodies",
    "late, without velocities",
)


@pytest.mark.parametrize(
    "damage", [pytest.param(name, marks=pytest.mark.slow) if name in LONG else name for name in DAMAGE]
)
def test_a_log_that_is_read_wrongly_names_the_column_and_the_option(four_bar, damage):
    change, words, option = DAMAGE[damage]
    try:
        found = judged(four_bar, change(four_bar[3], four_bar[4]))
    except SourceError as error:
        line = str(error)
    else:
        assert found.band is Band.WRONG
        (line,) = (mistake.text for mistake in found.mistakes)
    assert words in line
    assert option in line
    assert "\n" not in line


BROKEN = {
    "component": (
        lambda j, b: {n: c for n, c in b.items() if n != "/poses/crank/orientation/x"},
        "crank.x is m",
    ),
    "time": (lambda j, b: {n: c for n, c in j.items() if n != "time"}, "no column of times"),
    "order of rows": (
        lambda j, b: {n: np.concatenate([c, c]) for n, c in j.items()},
        "'time': 0 s after 0.5 s, in row 101;",
    ),
    "unknown": (lambda j, b: {"time": j["time"], "x": j["motor"]}, "no column is a joint coordinate"),
    "empty": (lambda j, b: j | {"motor": np.nan * j["motor"]}, "'motor' has 0 numbers in 101 rows"),
    "text": (lambda j, b: j | {"motor": np.array(["?"] * 101)}, "'motor': row 0: '?'"),
    "twice": (lambda j, b: j | {"motor/position": j["motor"]}, "'motor' and 'motor/position' are both"),
    "rows": (lambda j, b: {n: c[:2] for n, c in j.items()}, "has 2 rows; needed: 3 or more"),
    "norm": (lambda j, b: b | {"/poses/crank/orientation/w": 2.0 + 0.0 * b["time"]}, "norm"),
}


@pytest.mark.parametrize("damage", BROKEN)
def test_a_log_that_cannot_be_read_gets_one_line(four_bar, damage):
    change, words = BROKEN[damage]
    with pytest.raises(SourceError) as error:
        judged(four_bar, change(four_bar[3], four_bar[4]))
    assert words in str(error.value)
    assert str(error.value).startswith("isaac: ")


def test_a_row_is_named_by_its_place_in_the_log_beside_incomplete_rows(four_bar, tmp_path):
    rows = [f"{k},{'' if k in (1, 4) else 0.5 * k}" for k in range(8)]
    rows[6] = "2,3.0"  # its time comes a second time; the header is line 1
    (tmp_path / "log.csv").write_text("\n".join(["time,motor", *rows]))
    with pytest.raises(SourceError, match="'time': 2 s after 5 s, in line 8;"):
        judged(four_bar, str(tmp_path / "log.csv"))


def test_dates_that_are_missing_make_their_rows_incomplete(four_bar):
    joints = {name: np.insert(column, 3, 0.0) for name, column in four_bar[3].items()}
    dates = np.datetime64("2026-01-01") + (1e9 * joints["time"]).astype("timedelta64[ns]")
    dates[3] = np.datetime64("NaT")
    assert judged(four_bar, joints | {"time": dates}).error.relative < 2e-4


def test_bodies_that_columns_do_not_determine_are_named(four_bar):
    found = judged(four_bar, {n: c for n, c in four_bar[3].items() if "elbow" not in n})
    assert found.error.relative < 2e-4
    assert found.compared == ("crank", "rocker")
    assert found.missing == ("coupler (coordinate.elbow is missing)",)


def test_a_log_that_does_not_determine_the_start_names_a_joint():
    scene = replace(load("tracker"), duration=0.5)
    run = simulate(scene)
    with pytest.raises(SourceError, match=r"column coordinate.slide_13 is missing"):
        judge_log(scene, None, "log", {"time": run.time, "slide_12": run.joint("slide_12").coordinates[:, 0]})


def test_rows_at_any_times_and_from_any_time(four_bar):
    rows = np.unique(np.random.default_rng(0).integers(0, 100, 60))
    table = {name: column[rows] for name, column in four_bar[3].items()}
    assert judged(four_bar, table | {"time": table["time"] + 1.7e9}).error.relative < 2e-4


@pytest.mark.slow
def test_inputs_of_the_log(four_bar):
    path, scene, names, *_ = four_bar
    model, (time, q, v, *_, control) = run_of(
        path.read_text(), 1000, 1, lambda t: 0.2 * np.sin(20.0 * t), KICK
    )
    table = {"time": time, "drive.ctrl": control[:, 0]}
    for k in range(model.njnt):
        table |= {model.joint(k).name: q[:, k], f"{model.joint(k).name}.velocity": v[:, k]}
    log = Log(table)
    assert judge_log(scene, names, "log", log).error.relative < 1e-3
    assert judge_log(scene, names, "log", Log(table, inputs="scene")).error.relative > 0.1
    torque = renamed(table, lambda name: {"drive.ctrl": "motor.effort"}.get(name, name))
    assert judge_log(scene, names, "log", Log(torque)).error.relative < 1e-3


def test_a_later_start_of_inputs_over_time():
    rod = Body("rod", 1.0, [0.5, 0.0, 0.0], np.diag([0.001, 0.1, 0.1]))
    hinge = Revolute("hinge", "ground", "rod", [0.0, 0.0, 0.0], axis=[0.0, 1.0, 0.0], actuated=True)
    drive = PD("hinge", 0.0, 0.5, 0.0, feedforward=Sum((Sine(3.0, 4.0), Polynomial((0.1, 0.2)))))
    scene = Scene("swing", Mechanism([Body.ground(), rod], [hinge]), 2.0, 0.01, (0.0, 0.0, -9.81), [drive])
    run = simulate(scene)
    motion = run.joint("hinge")
    table = {"time": run.time, "hinge": motion.coordinates[:, 0], "hinge.rate": motion.rates[:, 0]}
    later = {name: column[50:] for name, column in table.items()}
    assert judge_log(scene, None, "log", later).error.relative < 1e-6
    shifted = later | {"time": later["time"] + 0.3}
    assert judge_log(scene, None, "log", shifted).band is Band.WRONG
    assert judge_log(scene, None, "log", Log(shifted, offset=0.3)).error.relative < 1e-6


def test_rows_before_the_offset_are_left_out(four_bar):
    _, scene, names, joints, *_ = four_bar
    late = {name: column - 0.3 if name == "time" else column for name, column in held(joints, 60).items()}
    assert judge_log(scene, names, "log", late).rows == len(late["time"])
    found = judge_log(scene, names, "log", Log(late, offset=0.0))
    assert found.rows == len(joints["time"])
    assert found.error.relative < 1e-3


def test_files_and_functions(tmp_path, four_bar):
    pandas = pytest.importorskip("pandas")
    path, scene, names, joints, *_ = four_bar
    pandas.DataFrame(joints).to_csv(tmp_path / "log.csv", index=False)
    pandas.DataFrame(joints).to_parquet(tmp_path / "log.parquet")
    expected = judged(four_bar, joints).error.relative
    for name in ("log.csv", "log.parquet"):
        found = judge_log(scene, names, "log", tmp_path / name)
        assert found.error.relative == pytest.approx(expected, rel=1e-3)
        assert found.engine == str(tmp_path / name)

    def step(state, times):
        run = simulate(replace(scene, initial_state=state, duration=times[-1], output_period=times[1]))
        return [run.state(k) for k in range(len(times))]

    verdict = crosscheck.check(
        str(path), ["newton_euler"], runs={"own": step, "isaac": pandas.DataFrame(joints)}
    )
    assert verdict.logs["own"].error.relative < 1e-9
    assert verdict.logs["isaac"].error.relative == pytest.approx(expected, rel=1e-3)
    assert "isaac  ACCURATE TO" in str(verdict)
    assert verdict.crosscheck.summary()["logs"]["isaac"]["rows"] == 101


def test_unknown_statements_name_the_choices():
    with pytest.raises(NewtonEulerError, match="did you mean 'quaternion'"):
        Log({}, quatrnion="xyzw")
    with pytest.raises(NewtonEulerError, match="wxyz"):
        Log({}, quaternion="zyxw")


def log_of(tmp_path, text, run, columns):
    """The judgement of a run of plain MuJoCo of which some columns are logged."""
    path = tmp_path / "model.xml"
    path.write_text(text)
    scene, report = load_scene(str(path), {"excitation": "off"}, verified=False)

    def watch(simulated, found, data):
        return acting_events(watched(simulated, with_logged_forces(report, data), found))

    return judge_log(scene, report.names, "log", dict(zip(columns, run, strict=True)), watch)


def test_controls_beyond_their_range_are_clipped_as_by_the_engine(tmp_path):
    _, (time, q, v, *_, control) = run_of(CLAMPED, 1000, 1, control=lambda t: 3.0 * np.sin(8.0 * t))
    columns = ["time", "h", "h_vel", "u.ctrl"]
    found = log_of(tmp_path, CLAMPED, [time, q[:, 0], v[:, 0], control[:, 0]], columns)
    assert found.error.relative < 1e-6
    assert found.held_inputs == ()


@pytest.mark.slow
@pytest.mark.parametrize(
    "limits", ['forcerange="-1 1"', 'forcerange="-1 1" ctrlrange="-2 2"', 'ctrlrange="-1 1"']
)
def test_forces_of_a_motor_are_limited_as_by_the_engine(tmp_path, limits):
    text = CLAMPED.replace('ctrllimited="true" ctrlrange="-1 1"', limits)
    _, (time, q, v, *_, control) = run_of(text, 1000, 1, control=lambda t: 3.0 * np.sin(8.0 * t))
    found = log_of(tmp_path, text, [time, q[:, 0], v[:, 0], control[:, 0]], ["time", "h", "h_vel", "u.ctrl"])
    assert found.error.relative < 1e-6
    assert found.events == ()


LIMITED = {
    "force of a servo": (
        '<position name="u" joint="h" kp="2" forcerange="-1 1"/>',
        "",
        "limit of the force of actuator 'u'",
        lambda control, q: 2.0 * (control - q),
    ),
    "forces on a joint": (
        '<motor name="u" joint="h"/>',
        'actuatorfrclimited="true" actuatorfrcrange="-1 1"',
        "limit of actuator forces of joint 'h'",
        lambda control, q: control,
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", LIMITED)
def test_a_limit_that_forces_by_logged_controls_reach_ends_the_comparison(tmp_path, case):
    actuator, joint, element, force_of = LIMITED[case]
    text = CLAMPED.replace('<motor name="u" joint="h" ctrllimited="true" ctrlrange="-1 1"/>', actuator)
    text = text.replace('<joint name="h"', f'<joint name="h" {joint}')
    _, (time, q, v, *_, control) = run_of(text, 250, 1, control=lambda t: 3.0 * np.sin(4.0 * t))
    table = [time, q[:, 0], v[:, 0]]
    found = log_of(tmp_path, text, [*table, control[:, 0]], ["time", "h", "h_vel", "u.ctrl"])
    (event,) = found.events
    force = force_of(control[:, 0], q[:, 0])
    # the control holds during a step of 1 ms, in which the hinge turns by less than 0.01 rad
    assert event.time == pytest.approx(time[np.argmax(np.abs(force) > 1.0)], abs=1.5e-3)
    assert event.element == element
    assert found.error.relative < 1e-4
    # logged forces are within the limits
    forces = np.clip(force, -1.0, 1.0)
    found = log_of(tmp_path, text, [*table, forces], ["time", "h", "h_vel", "h.effort"])
    assert (found.events, found.rows) == ((), 251)


@pytest.mark.slow
def test_an_actuator_without_its_input_is_named(tmp_path):
    _, (time, q, v, *_) = run_of(CLAMPED, 1000, 1, control=lambda t: np.sin(8.0 * t))
    found = log_of(tmp_path, CLAMPED, [time, q[:, 0], v[:, 0]], ["time", "h", "h_vel"])
    assert found.band is Band.WRONG
    assert found.held_inputs == ("u",)
    (note,) = (line for line in log_lines(found).lines if "no input in the log" in line)
    assert note.endswith("u")


@pytest.mark.slow
def test_errors_are_parts_of_the_motion_that_is_compared(tmp_path):
    """Of a ball until its contact, with 5 % too little gravity; the reference falls on through the floor."""
    _, (time, q, v, *_) = run_of(FALLING.format(gravity=-0.95 * 9.81), 1000, 1)
    found = log_of(tmp_path, FALLING.format(gravity=-9.81), [time, q[:, 0], v[:, 0]], ["time", "z", "z_vel"])
    assert [event.time for event in found.events] == [pytest.approx(np.sqrt(0.2 / 9.81), abs=2e-3)]
    assert found.error.relative == pytest.approx(0.05, rel=0.02)


MERGED = """<mujoco><option timestep="0.001" integrator="RK4"/><worldbody><body name="rod" pos="0 0 1">
  <joint name="h" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .5 0 0" size=".02" contype="0"/>
  <body name="tool" pos=".5 0 0" euler="0 30 0">
  <geom type="capsule" fromto="0 0 0 .3 .1 0" size=".03" contype="0"/></body></body></worldbody></mujoco>"""


@pytest.mark.parametrize("body", ["rod", "tool"])
@pytest.mark.parametrize(("column", "point"), [("com", "xipos"), ("frame", "xpos")])
def test_positions_of_a_part_of_a_body_are_of_the_part(tmp_path, body, column, point):
    model, (time, _, _, frame, turn, center, _) = run_of(MERGED, 500, 1)
    number = model.body(body).id
    position = {"xpos": frame, "xipos": center}[point][:, number]
    names = [f"{body}.{column}.{c}" for c in "xyz"] + [f"{body}.q{c}" for c in "wxyz"]
    found = log_of(tmp_path, MERGED, [time, *position.T, *turn[:, number].T], ["time", *names])
    # steps of 1 ms by RK4
    assert found.error.relative < 1e-8
    assert found.compared == ("rod",)


MERGED_LINKS = """<robot name="arm"><link name="base"/>
  <link name="rod"><inertial><origin xyz=".25 0 0"/><mass value="1"/>
    <inertia ixx=".01" iyy=".02" izz=".02" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="tool"><inertial><origin xyz=".1 0 0"/><mass value=".5"/>
    <inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="h" type="continuous"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/></joint>
  <joint name="grip" type="fixed"><origin xyz=".5 0 0" rpy="0 .5 0"/><parent link="rod"/><child link="tool"/>
  </joint></robot>"""


def test_centers_of_links_that_are_parts_of_a_body(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(MERGED_LINKS)
    scene, report = load_scene(str(path), {"excitation": "off", "duration": "0.5"}, verified=False)
    run = simulate(scene)
    angle, zero = run.joint("h").coordinates[:, 0], np.zeros(len(run.time))
    # center of mass of the tool: 0.5 m along the rod, then 0.1 m along the tool, at 0.5 rad from the rod
    x = 0.5 * np.cos(angle) + 0.1 * np.cos(angle + 0.5)
    z = -0.5 * np.sin(angle) - 0.1 * np.sin(angle + 0.5)
    half = 0.5 * (angle + 0.5)
    columns = dict(zip("xyz", (x, zero, z), strict=True))
    table = {"time": run.time} | {f"tool.com.{c}": values for c, values in columns.items()}
    turns = dict(zip("wxyz", (np.cos(half), zero, np.sin(half), zero), strict=True))
    table |= {f"tool.q{c}": values for c, values in turns.items()}
    found = judge_log(scene, report.names, "log", table)
    assert found.error.relative < 1e-6
    assert found.start.moved < 1e-12


def test_a_reference_that_stops_ends_the_comparison_with_a_note(four_bar, monkeypatch):
    def stopping(scene, **options):
        error = IntegrationError(0.26, "joint 'elbow' is too fast")
        error.partial = simulate(scene, **options).first(51)
        raise error

    monkeypatch.setattr(reading, "simulate", stopping)
    found = judged(four_bar, four_bar[3])
    assert (found.rows, found.error.relative < 2e-4) == (51, True)
    assert found.unjudged_from == pytest.approx(0.25)
    assert found.summary()["reference_stop"] == "joint 'elbow' is too fast"
    (note,) = (line for line in log_lines(found).lines if "reference stops" in line)
    assert "0.25 s: joint 'elbow' is too fast" in note


@pytest.fixture(scope="module")
def checked(four_bar):
    """The result of a check with a log."""
    path, joints = four_bar[0], four_bar[3]
    return crosscheck.check(str(path), ["newton_euler"], runs={"isaac": joints}, excitation="off").crosscheck


@pytest.mark.slow
def test_a_reference_that_stops_leaves_a_limit_unfinished(checked):
    stopped = replace(checked.logs["isaac"], reference_stop="a singular pose", unjudged_from=0.25)
    result = replace(checked, logs={"isaac": stopped})
    assert result.outcome.exit_status() == 0  # without a limit
    limited = result.with_allowed_errors([AllowedError(ErrorKind.RELATIVE, 0.5)])
    assert limited.outcome.exit_status() == 3
    assert [(stop.what, stop.reason) for stop in limited.unfinished] == [
        ("isaac", "not judged from 0.25 s on, as the reference stops: a singular pose")
    ]


# two links that fall from nearly upright: a chaotic motion
CHAOTIC = """<mujoco><option timestep="{step}" integrator="RK4"/><worldbody>
  <body name="p1"><joint name="a" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 .1 0 .1" size=".01" mass=".1" contype="0"/>
    <body name="p2" pos=".1 0 .1"><joint name="b" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 .14" size=".01" mass=".1" contype="0"/></body></body>
  </worldbody></mujoco>"""


@pytest.fixture(scope="module")
def chaotic(tmp_path_factory):
    """A scene, and a log of it by plain MuJoCo that starts 1e-5 rad beside another log."""
    path, step = tmp_path_factory.mktemp("chaos") / "chaos.xml", 0.001
    path.write_text(text := CHAOTIC.format(step=step))
    scene, _ = load_scene(str(path), {"excitation": "off"}, verified=False)
    tables = []
    for nudge in (0.0, 1e-5):
        _, (time, q, v, *_) = run_of(text, 4000, 10, start=(np.array([0.0, nudge]), np.zeros(2)))
        tables.append({"time": time, "a": q[:, 0], "b": q[:, 1], "a_vel": v[:, 0], "b_vel": v[:, 1]})
    return scene, *tables


def test_a_chaotic_log_is_judged_until_its_chaos(chaotic):
    scene, table, nudged = chaotic
    found = judge_log(scene, None, "log", table)
    (mechanism,) = found.scale.mechanisms
    # by MuJoCo alone: from then on, a change of the start has grown about a thousand times
    apart = np.maximum(*(np.abs(table[name] - nudged[name]) for name in "ab")) / 1e-5
    assert 0.5 < mechanism.until < 3.5
    assert np.max(apart[table["time"] < 0.5 * mechanism.until]) < 1000.0 < np.max(apart)
    # both runs are of order 4 or more: their difference is small until then, and as large as the motion after
    reference = found.reference
    errors = np.max(np.linalg.norm(found.run.position - reference.position, axis=2), axis=1)
    compared = found.run.time < mechanism.until - 1e-9
    assert found.error.largest_position == pytest.approx(np.max(errors[compared]))
    assert found.band is Band.ACCURATE
    assert found.mistakes == ()
    (note,) = (line for line in log_lines(found).lines if "compared until" in line)
    assert f"compared until {mechanism.until:.3g} s: from then on the motion multiplies any error" in note


@pytest.mark.parametrize("after", [True, False])
def test_a_reference_that_stops_in_chaos_leaves_nothing_unjudged(chaotic, monkeypatch, after):
    scene, table, _ = chaotic
    (mechanism,) = judge_log(scene, None, "log", table).scale.mechanisms
    end = mechanism.until + (0.2 if after else -0.2)

    def stopping(scene, **options):
        run = simulate(scene, **options)
        error = IntegrationError(end, "joint 'b' is too fast")
        error.partial = run.first(int(np.searchsorted(run.time, end)))
        raise error

    monkeypatch.setattr(reading, "simulate", stopping)
    found = judge_log(scene, None, "log", table)
    assert found.reference_stop == "joint 'b' is too fast"
    if after:
        assert found.unjudged_from is None
    else:
        assert found.unjudged_from == pytest.approx(end, abs=0.011)  # an output before it


def broken_off(table, row, value):
    """A log whose columns beside the time have another value from a row on."""
    later = np.arange(len(table["time"])) >= row
    return {name: x if name == "time" else np.where(later, value, x) for name, x in table.items()}


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e200])
@pytest.mark.parametrize("columns", [3, 4])
def test_numbers_that_end_are_a_run_that_diverged(four_bar, columns, value):
    found = judged(four_bar, broken_off(four_bar[columns], 40, value))
    assert (found.rows, found.dropped) == (40, 0)
    assert f"after 0.195 s: {value:.3g} in row 40" in found.stopped
    assert log_lines(found).lines[0].startswith("isaac  DIVERGED: columns ")
    assert (found.band, log_lines(found).verdict) == (Band.WRONG, "fails")
    assert all(kind.of(found) == np.inf for kind in ErrorKind)
    # the errors are those until then: as of the run at small steps
    assert found.error.relative < 2e-4
    assert found.error.position_at[1] < 0.2


@pytest.mark.parametrize("value", [np.inf, 1e12])
def test_rates_that_become_too_large_are_a_run_that_diverged(four_bar, value):
    """Angles that a simulator wraps stay small."""
    rates = broken_off({name: four_bar[3][name] for name in ("time", "motor_vel")}, 40, value)
    found = judged(four_bar, four_bar[3] | rates)
    assert (found.rows, found.dropped) == (40, 0)
    assert "after 0.195 s" in found.stopped
    assert found.band is Band.WRONG


def test_long_logs_state_which_rows_are_compared(four_bar, monkeypatch):
    monkeypatch.setattr(reading, "MAX_ROWS", 50)
    found = judged(four_bar, four_bar[3])
    assert (found.rows, found.stride) == (34, 3)
    assert "34 rows (1 of 3 is compared)" in log_lines(found).lines[1]


def test_a_file_with_empty_cells_at_its_end_is_a_run_that_diverged(four_bar, tmp_path):
    rows = ["time,motor,elbow,pivot"]
    for k in range(101):
        cells = (
            ["", "", ""]
            if k >= 90
            else [f"{four_bar[3][name][k]:.17g}" for name in ("motor", "elbow", "pivot")]
        )
        rows.append(",".join([f"{four_bar[3]['time'][k]:.17g}", *cells]))
    (tmp_path / "log.csv").write_text("\n".join(rows))
    assert "after 0.445 s: nan in line 92" in judged(four_bar, str(tmp_path / "log.csv")).stopped


@pytest.mark.parametrize("end", [101, 100])
def test_empty_cells_between_numbers_are_incomplete_rows(four_bar, end):
    # exports of several topics: every second row has the joints, and the last row has them or has not
    rows = np.arange(101) % 2 == 1
    table = {n: x if n == "time" else np.where(rows, np.nan, x) for n, x in four_bar[3].items()}
    found = judged(four_bar, {name: x[:end] for name, x in table.items()})
    assert (found.stopped, found.dropped, found.rows) == ("", 50, end - 50)
    assert "50 rows without some of the numbers were left out" in log_lines(found).lines[-1]


@pytest.mark.parametrize("name", ["motor_vel", "drive.ctrl"])
def test_a_last_row_without_rates_or_inputs_is_no_divergence(four_bar, name):
    table = four_bar[3] | {"drive.ctrl": np.zeros(101)}
    found = judged(four_bar, table | {name: np.append(table[name][:-1], np.nan)})
    assert (found.stopped, found.dropped, found.rows) == ("", 1, 100)


@pytest.mark.parametrize("turned", [0.0, 0.5])
def test_a_unit_of_times_with_which_nothing_moves_is_no_mistake(tmp_path, turned):
    path = tmp_path / "rod.xml"
    path.write_text(CLAMPED)
    scene, report = load_scene(str(path), {"excitation": "off"}, verified=False)
    # the rod falls 5 mm in 0.02 s, the log rests: in 0.02 ms or less, both are the same
    log = {"time": 0.002 * np.arange(11), "h": np.full(11, turned), "h_vel": np.zeros(11)}
    found = judge_log(scene, report.names, "log", log)
    assert found.band is Band.WRONG
    assert found.mistakes == ()


def test_start_velocities_of_three_rows_have_an_error(four_bar):
    first = {name: x[:3] for name, x in four_bar[3].items() if not name.endswith("_vel")}
    found = judged(four_bar, first)
    assert found.start.is_fitted
    # the crank starts with 5 rad/s; the error of the fit turns it wrongly in the 0.01 s of the log
    speed = np.linalg.norm(found.start.state.angular_velocity[1])
    # it is estimated by a fit without the third row, whose own error is of the same size
    assert found.start_error.rotation == pytest.approx(abs(speed - 5.0) * 0.01, rel=0.5)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["isaac", "deg"])
def test_the_page_shows_the_lines_of_its_logs(name, tmp_path, monkeypatch):
    root = Path(crosscheck.__file__).parents[1]
    page = (root / "docs/how_to/logs.md").read_text()
    (tmp_path / "examples").symlink_to(root / "examples")
    monkeypatch.chdir(tmp_path)
    exec(re.search(r"^```python\n(.*?)^```", page, re.DOTALL | re.MULTILINE)[1], {})  # writes both logs
    scene, report = load_scene("examples/linkage.xml", {"excitation": "off"}, verified=False)
    found = judge_log(scene, report.names, name, f"{name}.csv")
    shown = re.search(rf"^{name}  .*?(?=^\.\.\.$)", page, re.DOTALL | re.MULTILINE)[0]
    # the page breaks lines
    assert " ".join(shown.split()) in " ".join("\n".join(log_lines(found).lines).split())


def test_a_log_without_efforts_of_a_model_without_controllers_names_them(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(MERGED_LINKS)
    scene, report = load_scene(str(path), {"excitation": "off", "duration": "0.5"}, verified=False)
    # a motor holds the arm, which falls in the reference
    held = {"time": 0.01 * np.arange(51), "h": np.zeros(51), "h_vel": np.zeros(51)}
    found = judge_log(scene, report.names, "arm", held)
    assert found.band is Band.WRONG
    assert sum("JOINT.effort" in line for line in log_lines(found).lines) == 1
    with_efforts = judge_log(scene, report.names, "arm", held | {"h.effort": np.zeros(51)})
    assert with_efforts.error.position == pytest.approx(found.error.position, rel=1e-6)  # no force either
    assert not any("JOINT.effort" in line for line in log_lines(with_efforts).lines)
    # an arm that falls is accurate, and needs no advice
    run = simulate(scene)
    motion = run.joint("h")
    fall = {"time": run.time, "h": motion.coordinates[:, 0], "h_vel": motion.rates[:, 0]}
    assert not any("effort" in line for line in log_lines(judge_log(scene, report.names, "arm", fall)).lines)


def test_zeros_have_a_unit():
    assert (length(0.0), percent(0.0)) == ("0 m", "0 %")


MOTOR = CLAMPED.replace('ctrllimited="true" ctrlrange="-1 1"', "")


def motor_log(tmp_path, every, shift=0, **options):
    """Judge a run whose control is logged in every n-th row, or in rows after that of its step."""
    path = tmp_path / "motor.xml"
    path.write_text(MOTOR)
    _, (time, q, v, *_, control) = run_of(MOTOR, 1000, 1, control=lambda t: 3.0 * np.cos(8.0 * t))
    control = np.append(np.zeros(shift), control[: len(control) - shift, 0])
    columns = dict(zip(("time", "h", "h_vel", "u.ctrl"), (time, q[:, 0], v[:, 0], control), strict=True))
    scene, report = load_scene(str(path), {"excitation": "off"}, verified=False)
    table = {name: column[::every] for name, column in columns.items()}
    return judge_log(scene, report.names, "log", Log(table, **options))


def test_inputs_of_every_step_need_no_note(tmp_path):
    found = motor_log(tmp_path, 1)
    assert found.error.relative < 1e-6
    assert found.other_inputs is None


@pytest.mark.slow
def test_inputs_that_are_logged_after_their_step_name_the_option(tmp_path):
    found = motor_log(tmp_path, 1, shift=1)
    # the first control, 3 N m, acts 1 ms too late on an inertia of about 0.2 kg m^2: 0.015 rad/s of 5 rad/s
    assert 1e-3 < found.error.relative < 0.05
    (line,) = (line for line in log_lines(found).lines if "inputs=before" in line)
    assert line.startswith("  mistake column 'u.ctrl': inputs of the step before each row: an error of")
    assert motor_log(tmp_path, 1, shift=1, inputs="before").error.relative < 1e-6


def test_a_usable_log_has_a_note_on_inputs_after_their_step(tmp_path):
    found = motor_log(tmp_path, 1, shift=1, offset=0.8)  # an error of 0.4 %
    assert found.band is Band.OFF
    (line,) = (line for line in log_lines(found).lines if "inputs=before" in line)
    assert line.startswith("  note    with --log-set inputs=before, the error is")
    assert found.other_inputs.error.relative < 1e-6


def test_inputs_of_rows_that_are_far_apart_are_named(tmp_path):
    found = motor_log(tmp_path, 20)
    assert found.error.relative > 1e-3
    # an input that holds for twice as long has about twice the error, so that the change is the error
    assert found.other_inputs.thinned.relative == pytest.approx(found.error.relative, rel=0.5)
    assert any("log them at each step" in line for line in log_lines(found).lines)


@pytest.mark.slow
def test_missing_joints_have_their_names_in_the_file():
    scene, report = load_scene("mjcf/tracker.xml", {"excitation": "off", "duration": "0.1"}, verified=False)
    run, table = simulate(scene), {}
    for name, (key, start) in report.names.coordinates.items():
        table[name] = run.joint(key[0]).coordinates[:, key[1]] + start
    without = {"time": run.time} | {name: x for name, x in table.items() if name != "universal_47_1"}
    found = judge_log(scene, report.names, "log", without)
    assert found.missing == ("panel_7 (coordinate.universal_47_1 is missing)",)


def test_delays_close_to_the_outputs_of_the_reference_are_tried():
    scene, report = load_scene("mjcf/tracker.xml", {"excitation": "off", "duration": "0.1"}, verified=False)
    run = simulate(scene)
    table = {"time": run.time}
    for name, (key, start) in report.names.coordinates.items():
        table[name] = run.joint(key[0]).coordinates[:, key[1]] + start
    log = reading.LogReading(scene, report.names, read_table(table))
    # the log is accurate, so that the search goes on with smaller delays around zero
    assert list(_delay(log.compared(LogOptions()))) == []


@pytest.mark.parametrize(
    ("change", "differs", "option"),
    [
        (np.degrees, True, "; give --log-map 'elbow=coordinate.elbow [deg]'"),
        (np.negative, True, ""),
        (lambda angle: angle + 2.0 * np.pi, False, ""),
    ],
)
def test_a_coordinate_that_contradicts_the_poses_is_named(four_bar, change, differs, option):
    joints, bodies = four_bar[3:5]
    found = judged(four_bar, bodies | {"motor": joints["motor"], "elbow": change(joints["elbow"])})
    assert found.error.relative < 2e-4  # of the poses
    gap = np.angle(np.exp(1j * (change(joints["elbow"]) - joints["elbow"])))
    size = f"{np.degrees(np.max(np.abs(gap))):.3g} deg"
    words = (
        f"column 'elbow': differs by up to {size} from the coordinate of joint 'elbow' in the logged poses"
    )
    assert [mistake.text for mistake in found.mistakes] == ([words + option] if differs else [])
    assert sum(line.startswith("  mistake column 'elbow'") for line in log_lines(found).lines) == differs
    assert [each["text"] for each in found.summary()["mistakes"]] == ([words + option] if differs else [])


@pytest.fixture(scope="module")
def turned_coupler(four_bar):
    """A log with the angle between both bars, and with quaternions of the coupler that contradict it."""
    joints, bodies = four_bar[3:5]
    turned = {name: np.roll(x, 20) if "coupler/orientation" in name else x for name, x in bodies.items()}
    return turned | {"elbow": joints["elbow"]}


@pytest.mark.slow
def test_no_reading_of_coordinates_beside_poses_that_violate_joints_is_searched(four_bar, turned_coupler):
    found = judged(four_bar, turned_coupler)
    assert found.band is Band.WRONG
    assert not any("elbow" in mistake.columns for mistake in found.mistakes)


def test_coordinates_beside_poses_that_violate_joints_are_not_blamed(four_bar, turned_coupler):
    table, options = turned_coupler, LogOptions()
    log = reading.LogReading(four_bar[1], four_bar[2], read_table(table))
    compared = log.compared(options)
    assert compared.error.band is Band.WRONG
    assert find_mismatches(log, options, compared) == ()


@pytest.mark.slow
def test_unknown_parts_of_poses_are_no_errors_of_0(four_bar, checked):
    joints, bodies = four_bar[3:5]
    quaternions = {name: x for name, x in bodies.items() if "coupler/orientation" in name}
    log = {"time": joints["time"], "elbow": joints["elbow"], **quaternions}
    found = judged(four_bar, log)
    assert (found.compared, found.unknown_positions, found.unknown_orientations) == (
        ("coupler",),
        ("coupler",),
        (),
    )
    assert ErrorKind.POSITION in found.undetermined
    assert not {ErrorKind.ROTATION, ErrorKind.RELATIVE} & found.undetermined.keys()
    assert "position of coupler (position.coupler.x to z are missing)" in found.missing
    error = found.summary()["error"]
    assert (error["position"], error["position_at"], error["relative_position"]) == (None, None, None)
    assert error["rotation"] == pytest.approx(found.error.rotation)
    result = replace(checked, logs={"isaac": found})
    limited = result.with_allowed_errors([AllowedError(ErrorKind.POSITION, 1e-7)])
    assert limited.outcome.exit_status() == 3
    assert [(stop.what, stop.reason) for stop in limited.unfinished] == [
        (
            "isaac",
            "its columns do not determine the position of coupler; needed: position.coupler.x to z, or the "
            "coordinates of its joints",
        )
    ]


@pytest.mark.slow
def test_a_log_that_fits_no_state_has_no_reading_with_a_large_error(tmp_path):
    path = tmp_path / "floating.xml"
    path.write_text(FLOATING)
    scene, report = load_scene(str(path), {"excitation": "off"}, verified=False)
    # the buoy does not move as a body that is tied to the rod, and its first row is far from it
    time, zero = 0.01 * np.arange(6), np.zeros(6)
    table = {"time": time, "hinge": 3.0 * np.sin(40.0 * time), "tip": zero}
    table |= {f"buoy.{c}": x for c, x in zip("xyz", (40.0 + time, zero, zero), strict=True)}
    table |= {f"buoy.q{c}": np.full(6, c == "w") for c in "wxyz"}
    reading_of_log = reading.LogReading(scene, report.names, read_table(table))
    assert find_mistakes(reading_of_log, LogOptions(), reading_of_log.data(LogOptions()), None) == ()


def test_a_unit_of_times_with_a_large_error_is_no_mistake(tmp_path):
    path = tmp_path / "rod.xml"
    path.write_text(CLAMPED)
    scene, report = load_scene(str(path), {"excitation": "off"}, verified=False)
    # a motor turns the rod against gravity; in nanoseconds gravity has no effect, either, but the angle has
    # another error of 0.1 rad in 1 s
    time = 0.01 * np.arange(101)
    found = judge_log(scene, report.names, "log", {"time": time, "h": 5.0 * time + 0.1 * time**3})
    assert found.error.relative > 1.0
    assert found.mistakes == ()


@pytest.mark.parametrize(
    ("new", "words"),
    [
        ("motor [rev]", "column 'motor [rev]' has the unit 'rev'; needed: rad, mrad, deg, rad/s"),
        ("motor (rpm)", "column 'motor (rpm)' has the unit 'rpm'; needed: rad, mrad, deg, rad/s"),
        ("time [h]", "column 'time [h]' has the unit 'h'; needed: s, ms, us, ns"),
        ("/poses/crank/position/x [in]", "has the unit 'in'; needed: m, cm, mm, um, m/s"),
    ],
)
def test_units_that_are_unknown_name_the_valid_ones(four_bar, new, words):
    tables = four_bar[3] | {name: x for name, x in four_bar[4].items() if "crank" in name}
    old = re.sub(r" .*", "", new)
    with pytest.raises(SourceError) as error:
        judged(four_bar, renamed(tables, lambda name: new if name == old else name))
    assert words in str(error.value)


@pytest.mark.parametrize("new", ["qpos[motor]", "motor (measured position)", "q.motor [rad]"])
def test_brackets_without_units_are_accepted(four_bar, new):
    found = judged(four_bar, renamed(four_bar[3], lambda name: new if name == "motor" else name))
    assert found.error.relative < 2e-4


def test_numbered_components_of_quaternions(four_bar):
    def numbered(name):
        return re.sub(r"/poses/(\w+)/orientation/(\w)", lambda m: f"{m[1]}.q{'wxyz'.index(m[2])}", name)

    found = judged(four_bar, renamed(four_bar[4], numbered))
    assert (found.error.relative < 2e-4, found.unused, found.compared) == (True, (), BODIES)


@pytest.mark.parametrize("zone", [None, "UTC", "Europe/Berlin"])
def test_times_that_are_dates(four_bar, tmp_path, zone):
    pandas = pytest.importorskip("pandas")
    joints = four_bar[3]
    times = pandas.Timestamp("2026-01-01") + pandas.to_timedelta(joints["time"], unit="s")
    dates = pandas.Series(times).dt.tz_localize(zone)
    table = pandas.DataFrame(joints | {"time": dates})
    # floats of seconds since 1970 are known to 2.4e-7 s
    assert judged(four_bar, table).error.relative < 2e-4
    table.to_parquet(tmp_path / "log.parquet")
    assert judged(four_bar, tmp_path / "log.parquet").error.relative < 2e-4
    table.assign(time=pandas.to_timedelta(joints["time"], unit="s")).to_parquet(tmp_path / "log.parquet")
    assert judged(four_bar, tmp_path / "log.parquet").error.relative < 2e-4


@pytest.mark.parametrize(
    ("logged", "missing"), [("position", "quaternion.buoy.w to z"), ("quaternion", "position.buoy.x to z")]
)
def test_half_of_the_pose_of_a_free_body_names_the_other_half(tmp_path, logged, missing):
    path = tmp_path / "free.xml"
    path.write_text(FLOATING.replace("<connect", "<!--").replace('anchor=".5 0 0"/>', "-->"))
    scene, report = load_scene(str(path), {"excitation": "off"}, verified=False)
    time, letters = 0.01 * np.arange(21), {"position": "xyz", "quaternion": "wxyz"}[logged]
    table = {"time": time, "hinge": 0.0 * time, "tip": 0.0 * time}
    table |= {f"{logged}.buoy.{c}": np.full(21, c == "w") for c in letters}
    with pytest.raises(SourceError) as error:
        judge_log(scene, report.names, "log", table)
    assert f"columns {missing} are missing beside '{logged}.buoy.{letters[0]}'" in str(error.value)


def test_a_column_without_a_name_is_called_so(four_bar):
    found = judged(four_bar, {"": four_bar[3]["time"], **four_bar[3]})
    assert log_lines(found).lines[-1].endswith("of that name: one without a name")


def test_a_log_of_one_row_has_a_singular():
    with pytest.raises(SourceError, match="log: has 1 row; needed: 3 or more"):
        read_table({"time": [0.0], "motor": [0.0]})


def swing(damping=0.4, gravity=9.81, stiffness=2.0, rotor=0.05, friction=0.3):
    """A rod on a hinge with a spring, a damper, dry friction and a rotor, released from horizontal."""
    rod = Body("rod", 1.0, [0.5, 0.0, 0.0], np.diag([0.001, 0.1, 0.1]))
    hinge = Revolute("hinge", "ground", "rod", [0.0, 0.0, 0.0], axis=[0.0, 1.0, 0.0])
    return Scene(
        "swing",
        Mechanism([Body.ground(), rod], [hinge]),
        duration=1.0,
        output_period=0.01,
        gravity=(0.0, 0.0, -gravity),
        forces=[
            JointSpring("hinge", stiffness=stiffness, damping=damping),
            *([JointFriction("hinge", coulomb=friction, transition_speed=0.1)] if friction else []),
        ],
        armatures=[Armature("hinge", rotor)] if rotor else [],
    )


DAMPING, STIFFNESS = "damping of joint 'hinge'", "stiffness of joint 'hinge'"
ROTOR = "armature of joint 'hinge'"


@pytest.mark.parametrize(
    ("changed", "lacks"),
    [
        ({"damping": 0.0}, (DAMPING,)),
        ({"stiffness": 0.0}, (STIFFNESS,)),
        ({"rotor": 0.0}, (ROTOR,)),
        ({"damping": 0.0, "stiffness": 0.0, "rotor": 0.0}, (DAMPING, STIFFNESS, ROTOR)),
        ({"friction": 0.0}, ("friction of joint 'hinge'",)),
        ({"gravity": 0.0}, ("gravity",)),
        ({"damping": 0.3}, None),
        ({}, None),
    ],
)
def test_elements_that_the_simulation_of_a_log_lacks(changed, lacks):
    moving = newton_euler.start(swing(**changed), hinge=(0.0, 1.0))  # rad, rad/s
    run = simulate(moving).joint("hinge")
    table = {"time": moving.times, "hinge": run.coordinates[:, 0], "hinge_vel": run.rates[:, 0]}
    found = judge_log(swing(), None, "log", Log(table))
    assert (found.lack and found.lack.elements) == lacks
    if lacks:
        assert found.lack.before == found.error
        assert found.lack.after.relative < 1e-6
        (note,) = (line for line in log_lines(found).lines if "may lack" in line)
        assert lacks[0] in note


def test_lacks_are_sought_until_something_acts_that_the_reference_does_not_have():
    """From 0.5 s on the log rests, as at a limit; before, it has no damping."""
    moving = newton_euler.start(swing(damping=0.0), hinge=(0.0, 1.0))
    run = simulate(moving).joint("hinge")
    coordinates, rates = run.coordinates[:, 0].copy(), run.rates[:, 0].copy()
    coordinates[50:], rates[50:] = coordinates[50], 0.0
    table = {"time": moving.times, "hinge": coordinates, "hinge_vel": rates}
    limit = Event(0.495, "limits of joint 'hinge'")
    found = judge_log(swing(), None, "log", Log(table), watch=lambda scene, run, data: (limit,))
    assert found.lack is not None
    assert found.lack.elements == (DAMPING,)
    assert found.lack.before == found.error
    assert found.lack.after.relative < 1e-6
