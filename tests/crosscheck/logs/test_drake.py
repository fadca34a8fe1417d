"""A log of Drake, with names of columns by `MultibodyPlant.GetStateNames`, beside MuJoCo at small steps.

`drake_linkage.csv` has the first 0.1 s of `examples/linkage.xml` in Drake 1.51.1, from the keyframe. It was
made by a discrete `MultibodyPlant` with steps of 1 ms and the SAP solver, from the parsed file. Its parser
leaves out the loop, the spring and the damping of the servo, so that these lines add them before `Finalize`:

    coupler, rocker = map(plant.GetBodyByName, ("coupler", "rocker"))
    plant.AddBallConstraint(coupler, [0.3, 0.0, 0.15], rocker, [0.0, 0.0, 0.25])
    plant.AddForceElement(RevoluteSpring(plant.GetJointByName("pivot"), 0.0, 0.5))
    servo = plant.GetJointActuatorByName("servo")
    servo.set_controller_gains(PdControllerGains(p=2.0, d=0.05))

The desired state is the constant (1, 0). `LogVectorOutput` wrote the state each 5 ms.
"""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

from crosscheck import check
from crosscheck.library import load
from crosscheck.loading.load import load_scene
from crosscheck.logs.judge import Log, judge_log
from crosscheck.logs.names import Elements, identified
from crosscheck.own_run.allowed import OWN_RUN, AllowedError, ErrorKind
from crosscheck.own_run.errors import Band
from crosscheck.report.log import log_lines
from crosscheck.report.run import junit, report
from crosscheck.report.summary import judged_runs
from newton_euler import simulate
from newton_euler.model.source_file import SourceError

pytestmark = pytest.mark.slow

MODEL = "examples/linkage.xml"
PATH = Path(__file__).parent / "drake_linkage.csv"
JOINTS, BODIES = ("motor", "elbow", "pivot"), ("crank", "coupler", "rocker")


@pytest.fixture(scope="module")
def log():
    """The columns of the log."""
    with open(PATH) as file:
        header, *rows = csv.reader(file)
    return dict(zip(header, np.array(rows, dtype=float).T, strict=True))


def judged(table, **options):
    scene, report = load_scene(MODEL, {"excitation": "off"}, verified=False)
    return judge_log(scene, report.names, "drake", Log(table, **options))


@pytest.fixture(scope="module")
def motions(log):
    """Centers of mass and quaternions of the bodies: of plain MuJoCo at small steps, and of the log."""
    model = mujoco.MjModel.from_xml_path(MODEL)
    model.opt.timestep, model.opt.integrator = 1e-5, mujoco.mjtIntegrator.mjINT_RK4
    model.eq_solref[:], model.eq_solimp[:, :2] = (4e-5, 1.0), 0.9999  # nearly rigid
    data, logged = mujoco.MjData(model), mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    bodies = [model.body(name).id for name in BODIES]
    found = []
    for k, time in enumerate(log["time"]):
        while data.time < time - 5e-6:
            mujoco.mj_step(model, data)
        logged.qpos[:] = [log[f"linkage_{joint}_q"][k] for joint in JOINTS]
        for each in (data, logged):
            mujoco.mj_forward(model, each)
        found.append([[each.xipos[bodies], each.xquat[bodies]] for each in (data, logged)])
    return [
        [np.array([row[run][part] for row in found]) for part in (0, 1)]  # (rows, bodies, 3 or 4)
        for run in (0, 1)
    ]


@pytest.mark.slow
def test_the_error_of_a_log_of_drake_is_that_beside_plain_mujoco(log, motions):
    (reference, turns), (position, quaternion) = motions
    found = judged(str(PATH))
    # Drake's error of steps of 1 ms is about 700 um; MuJoCo's constraint and steps are good to 1e-8 m
    assert found.error.position == pytest.approx(
        np.max(np.linalg.norm(position - reference, axis=2)), rel=1e-4
    )
    cosines = np.abs(np.sum(turns * quaternion, axis=2))
    # acos near 1 has the errors of a square root: 1e-8 rad of 0.014 rad
    assert found.error.rotation == pytest.approx(np.max(2.0 * np.arccos(np.minimum(cosines, 1.0))), rel=1e-4)
    assert found.band is Band.WRONG
    assert found.compared == BODIES
    assert (found.unused, found.mistakes, found.start.differences) == ((), (), ())
    assert found.has_energy


@pytest.mark.slow
def test_the_loop_opening_of_a_log_is_the_distance_of_the_ends_of_the_loop(log):
    model = mujoco.MjModel.from_xml_path(MODEL)
    data = mujoco.MjData(model)
    gaps = []
    for row in zip(*(log[f"linkage_{joint}_q"] for joint in JOINTS), strict=True):
        data.qpos[:] = row
        mujoco.mj_forward(model, data)
        ends = [  # the points of the ball constraint in Drake
            data.body(body).xpos + data.body(body).xmat.reshape(3, 3) @ point
            for body, point in (("coupler", [0.3, 0.0, 0.15]), ("rocker", [0.0, 0.0, 0.25]))
        ]
        gaps.append(np.linalg.norm(ends[1] - ends[0]))
    found = judged(log)
    assert found.loop_error.opening_at == ("loop", log["time"][int(np.argmax(gaps))])
    # rounding of positions of 0.3 m
    assert found.loop_error.opening == pytest.approx(max(gaps), abs=1e-15)


def first_rows(table):
    """Six rows, 0.025 s, whose error is small enough that no other readings are searched."""
    return {name: column[:6] for name, column in table.items()}


@pytest.mark.parametrize(
    "joints",
    [
        pytest.param(("motor",), marks=pytest.mark.slow),
        ("motor", "elbow"),
        pytest.param(("motor", "pivot"), marks=pytest.mark.slow),
    ],
)
def test_a_log_without_a_body_of_a_loop_has_no_loop_opening(log, joints):
    # the loop has the crank, the coupler and the rocker: each selection of joints lacks one or two of them
    columns = {f"linkage_{joint}_q" for joint in joints}
    found = judged({name: x for name, x in first_rows(log).items() if name == "time" or name in columns})
    assert set(found.undetermined) == {ErrorKind.OPENING, ErrorKind.LOOP_ANGLE, ErrorKind.ENERGY}
    assert found.summary()["loop_error"] is None
    assert not any("loop" in line for line in log_lines(found).lines)


def poses_of(log, motions):
    """The log as poses of bodies, with names of columns as of a user of `EvalBodyPoseInWorld`."""
    _, (_, quaternion) = motions
    model = mujoco.MjModel.from_xml_path(MODEL)
    data = mujoco.MjData(model)
    position = []
    for row in zip(*(log[f"linkage_{joint}_q"] for joint in JOINTS), strict=True):
        data.qpos[:] = row
        mujoco.mj_forward(model, data)
        position.append(data.xpos[1:].copy())
    table = {"time": log["time"]}
    for k, body in enumerate(BODIES):
        place = model.body(body).id - 1
        table |= {f"{body}_{c}": np.array(position)[:, place, i] for i, c in enumerate("xyz")}
        table |= {f"{body}_q{c}": quaternion[:, k, i] for i, c in enumerate("wxyz")}
    return table


@pytest.mark.slow
def test_poses_without_velocities_start_with_those_of_the_model(log, motions):
    found = judged(poses_of(log, motions))
    # the same run as the log of joints; a fit of velocities to the first rows has errors of 1 deg
    assert found.error.position == pytest.approx(judged(log).error.position, rel=1e-6)
    assert found.points == "frame"
    assert not found.start.is_fitted
    assert len(found.start.differences) == 21
    assert np.max(np.abs(found.start.state.angular_velocity)) == 0.0


def swapped(table):
    """The poses with the names of two bodies exchanged."""
    return {
        name.replace("crank", "@").replace("rocker", "crank").replace("@", "rocker"): column
        for name, column in table.items()
    }


def late(table):
    """A log that begins 5 rows, 0.025 s, before the motion."""
    held = {name: np.concatenate([np.repeat(x[:1], 5), x]) for name, x in table.items()}
    return held | {"time": 0.005 * np.arange(26)}


DAMAGE = {
    "order of quaternions": (
        lambda joints, poses: {
            n[:-1] + "xyzw"["wxyz".index(n[-1])] if "_q" in n else n: x for n, x in poses.items()
        },
        "columns 'crank_qw' and 11 more: order w, x, y, z",
        "--log-set quaternion=wxyz",
    ),
    "degrees": (
        lambda joints, poses: {n: x if n == "time" else np.degrees(x) for n, x in joints.items()},
        "columns 'linkage_motor_q' and 5 more: unit deg",
        "--log-set angle=deg",
    ),
    "offset": (lambda joints, poses: late(poses), "times 0.025 s earlier", "--log-set offset=0.025"),
    "missing component": (
        lambda joints, poses: {n: x for n, x in poses.items() if n != "coupler_qy"},
        "column quaternion.coupler.y is missing beside 'coupler_qw'",
        "--log-map",
    ),
    "missing joint": (
        lambda joints, poses: {n: x for n, x in joints.items() if "elbow" not in n},
        "not compared: coupler (coordinate.elbow is missing)",
        "",
    ),
    "name of a body": (
        lambda joints, poses: {n.replace("coupler", "link2"): x for n, x in first_rows(poses).items()},
        "not read, as the model has no joint, body or quantity of that name: link2_x",
        "",
    ),
    "names of two bodies": (
        lambda joints, poses: swapped(poses),
        "starts 300 mm",
        "name of another body",
    ),
}


# 6 to 12 s each; tests/crosscheck/logs/test_logs.py has these kinds at other logs
LONG = ("offset", "names of two bodies", "order of quaternions")


@pytest.mark.parametrize(
    "damage", [pytest.param(name, marks=pytest.mark.slow) if name in LONG else name for name in DAMAGE]
)
def test_a_damaged_log_of_drake_gets_one_line_that_names_it(log, motions, damage):
    change, words, option = DAMAGE[damage]
    try:
        found = judged(change(log, poses_of(log, motions)))
    except SourceError as error:
        lines = [str(error)]
    else:
        lines = [*(mistake.text for mistake in found.mistakes), *log_lines(found).lines]
    assert [line for line in lines if words in line and option in line]
    if not option:  # no statement on the log makes up for columns that are missing
        assert not any("--log-" in line for line in lines)
    assert not any("\n" in line for line in lines)


def test_a_start_that_columns_do_not_determine_names_columns_that_were_not_read():
    run = simulate(replace(load("tracker"), duration=0.1))
    table = {"time": run.time, "slide_12": run.joint("slide_12").coordinates[:, 0], "slider3": run.time}
    with pytest.raises(SourceError, match=r"coordinate.slide_13 is missing.*not read.*'slider3'"):
        judge_log(load("tracker"), None, "log", table)


@pytest.mark.parametrize(
    ("name", "kind", "element"),
    [
        ("tracker_slide_12_x", "coordinate", "slide_12"),
        ("tracker_slide_12_v", "rate", "slide_12"),
        ("tracker_hinge_26_q", "coordinate", "hinge_26"),
        ("tracker_hinge_26_w", "rate", "hinge_26"),
        ("panel_7_qw", "quaternion", "panel_7"),
        ("panel_7_x", "position", "panel_7"),
        ("panel_7_wx", "angular_velocity", "panel_7"),
        ("panel_7_vx", "linear_velocity", "panel_7"),
    ],
)
def test_names_of_states_of_drake(name, kind, element):
    target = identified(name, Elements(load("tracker").mechanism, None)).target
    assert (target.kind, target.element) == (kind, element)


@pytest.fixture(scope="module")
def verdict(log, motions):
    """The verdict on the model with logs of states, of poses, which have no energy, and of one joint."""
    crank = {"time": log["time"], "motor": log["linkage_motor_q"]}
    runs = {"states": str(PATH), "poses": poses_of(log, motions), "crank": crank}
    return check(MODEL, ["newton_euler", "mujoco"], runs=runs)


@pytest.mark.slow
def test_allowed_errors_are_those_of_logs(verdict):
    # the run with the settings of the file has an error of 3 %, which no limit concerns beside logs
    assert verdict.own_run.error.relative > 0.03
    verdict.assert_accurate(0.02)
    with pytest.raises(
        AssertionError, match=r"errors of the log states: position 701 um, allowed 500 um; .* log poses"
    ):
        verdict.assert_accurate(None, position=5e-4)
    result = verdict.crosscheck.with_allowed_errors([AllowedError(ErrorKind.POSITION, 5e-4)])
    assert result.outcome.exit_status() == 5
    assert set(result.exceeded) == {"states", "poses", "crank"}
    # the terminal and the test cases tell that the run of the file has no limit
    *_, own_run = judged_runs(result)
    assert own_run.lines[0].startswith("your settings  WRONG BY ")
    assert own_run.lines[-1] == "  note    --max-error limits the logs, not this run"
    page = ElementTree.fromstring(junit(result, report(result), "linkage", allow_reduced=False))
    (case,) = (each for each in page.iter("testcase") if "your settings" in each.get("classname", ""))
    assert case.get("name") == "accuracy"
    assert case.find("skipped").get("message").endswith("no --max-error limits it")
    assert [each["exceeded"] for each in result.summary()["allowed_errors"]] == [True]


def test_the_energy_of_a_log_without_velocities_cannot_be_limited(verdict):
    result = verdict.crosscheck.with_allowed_errors([AllowedError(ErrorKind.ENERGY, 0.1)])
    assert [(stop.what, "velocities" in stop.reason) for stop in result.unfinished] == [
        ("poses", True),
        ("crank", True),
    ]
    assert (result.exceeded, result.limits_of("poses"), result.limits_of(OWN_RUN)) == ({}, [], ())


@pytest.mark.parametrize("kind", [ErrorKind.OPENING, ErrorKind.LOOP_ANGLE])
def test_the_loop_error_of_a_log_without_all_bodies_of_the_loop_cannot_be_limited(verdict, kind):
    limit = AllowedError(kind, 1.0)
    result = verdict.crosscheck.with_allowed_errors([limit])
    assert [(stop.what, "violation of loops" in stop.reason) for stop in result.unfinished] == [
        ("crank", True)
    ]
    assert result.outcome.exit_status() == 3
    assert [list(result.limits_of(name)) for name in ("states", "poses", "crank")] == [[limit], [limit], []]
    # the limit is a skipped test case of the log, and a passed one of the others
    page = ElementTree.fromstring(junit(result, report(result), "linkage", allow_reduced=False))
    cases = {
        case.get("classname"): case.find("skipped")
        for case in page.iter("testcase")
        if case.get("name", "").startswith(f"{kind} error at most")
    }
    assert len(cases) == 3
    assert sum(skipped is not None for skipped in cases.values()) == 1
