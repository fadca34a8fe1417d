"""Scene files: what they can hold, and what is refused in one line."""

from __future__ import annotations

import copy
import json
import os
from dataclasses import replace

import numpy as np
import pytest
from command_line import check_refused, command, run, scene_file, verdict_of

from crosscheck.library import load
from crosscheck.library.scene_file import write_scene
from crosscheck.support.errors import CrosscheckError
from newton_euler.model.control import PD, ComputedTorque, StateFeedback
from newton_euler.model.couplings import Gear
from newton_euler.model.digital_control import Digital, Sampled
from newton_euler.model.forces import JointSpring
from newton_euler.model.joint_kinds import Cylindrical
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.motions import PrescribedMotion, Sum
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Polynomial, Sine
from newton_euler.runs.assemble import initial_state
from newton_euler.runs.variation import start


def changed(content, path, value):
    """A copy of nested content with one element replaced (or removed, for value ...)."""
    content = copy.deepcopy(content)
    at = content
    for key in path[:-1]:
        at = at[key]
    if value is ...:
        del at[path[-1]]
    else:
        at[path[-1]] = value
    return content


BAD_SCENES = {
    "negative mass": (("bodies", 1, "mass"), -1.0, "body 'coupler': mass is -1 kg; needed: a positive"),
    "zero mass": (("bodies", 1, "mass"), 0.0, "body 'coupler': mass is 0 kg"),
    "NaN": (("bodies", 0, "mass"), float("nan"), "bodies.0.mass: Input should be a valid number"),
    "infinite point": (("joints", 0, "point"), [0.0, float("inf"), 0.0], "joints.0.revolute.point.1"),
    "huge point": (("joints", 0, "point"), [0.0, 1e308, 0.0], "point.1: Input should be at most 1e+100"),
    "truth for a number": (("bodies", 0, "mass"), True, "bodies.0.mass: Input should be a valid number"),
    "truth for an index": (("control", 0, "coordinate"), True, "control.0.coordinate: Input should be a"),
    "asymmetric inertia": (("bodies", 1, "inertia", 0, 1), 0.001, "body 'coupler': inertia differs from"),
    "indefinite inertia": (("bodies", 1, "inertia", 0, 0), -0.004, "a positive definite inertia"),
    "unrealisable inertia": (("bodies", 1, "inertia", 0, 0), 0.9, "body 'coupler': principal moments"),
    "quaternion not of unit norm": (("bodies", 1, "quaternion"), [1.0, 0.1, 0, 0], "quaternion has norm"),
    "quaternion of three": (("bodies", 1, "quaternion"), [1.0, 0.0, 0.0], "bodies.1.quaternion"),
    "missing axis": (("joints", 0, "axis"), ..., "joints.0.revolute.axis: missing"),
    "unknown body": (("joints", 1, "second"), "piston", "connects an unknown body 'piston'; needed: one of"),
    "joint to itself": (("joints", 1, "second"), "crank", "connects 'crank' to itself"),
    "unknown joint kind": (
        ("joints", 1, "kind"),
        "rubber",
        "joints.1.kind: 'rubber'; choose from: fixed, revolute, ",
    ),
    "open loop": (("joints", 1, "point_on_second"), [0, 0, 0.201], "joint 'elbow': is open by 0.001 m"),
    "duplicate body": (("bodies", 1, "name"), "crank", "body 'crank': 2 of that name; needed: unique"),
    "duplicate joint": (("joints", 1, "name"), "motor", "joint 'motor': 2 of that name"),
    "unusable name": (("bodies", 1, "name"), "a/b <c>", "has an unusable name"),
    "control of a passive joint": (("joints", 0, "actuated"), False, "the joint is not actuated"),
    "control of an unknown joint": (
        ("control", 0, "joint"),
        "engine",
        "is on an unknown joint 'engine'; needed",
    ),
    "zero duration": (("duration",), 0.0, "duration is 0.0; needed: a positive number of seconds"),
    "name of markup": (("name",), "[/red]", "scene: name is '[/red]'"),
    "description that is no line": (("description",), "a\x1b[31m", "description is 'a\\x1b[31m'"),
    "outputs that are not compared": (
        ("outputs",),
        ["velocities"],
        "does not ask for the output 'reactions'",
    ),
    "angle of an unknown joint": (("initial_angles",), {"moon": 1.0}, "unknown joint coordinate"),
    "angle that is text": (("initial_angles",), {"motor": "wound"}, "initial_angles.motor"),
    "angle of another pose": (("initial_angles",), {"motor": 7.0}, "joint 'motor': coordinate 0 is 7 rad"),
    "angle of too many revolutions": (("initial_angles",), {"motor": 1e10}, "at most 1e+09"),
    "angle of a ball": (("initial_angles",), {"elbow": 1.0}, "unknown joint coordinate"),
    "state of an unknown body": (("initial_state",), {"moon": {}}, "unknown body 'moon'"),
    "state of an open joint": (
        ("initial_state",),
        {"crank": {"position": [0.0, 0.0, 0.11]}},
        "joint 'motor': is open by 0.01 m in the initial state",
    ),
    "state of a joint that opens": (
        ("initial_state",),
        {"crank": {"linear_velocity": [0.0, 0.5, 0.0]}},
        "joint 'motor': opens at 0.5 m/s in the initial state",
    ),
    "misspelt key": (("gravitty",), [0, 0, 0], "gravitty: unknown key"),
    "missing key": (("joints",), ..., "joints: missing"),
    "text for a number": (("duration",), "long", "duration: Input should be a valid number"),
}


@pytest.mark.parametrize("kind", BAD_SCENES)
def test_bad_scene_files(capsys, tmp_path, good, kind):
    path, value, message = BAD_SCENES[kind]
    check_refused(capsys, tmp_path, scene_file(tmp_path, changed(good, path, value)), message=message)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not YAML"),
        ("", "not a mapping from keys to values"),
        ("- 1\n- 2\n", "not a mapping from keys to values"),
        ("[" * 5000, "nested too deeply"),
        ("a: !!python/object/apply:os.system [true]", "not YAML: line 1: tags are not allowed"),
        ("name: a\nduration: !!int abc", "not YAML: line 2: tags are not allowed"),
        ("duration: !!float abc", "not YAML: line 1: tags are not allowed"),
        ("name: 2001-99-99", "duration: missing"),
        (f"duration: {'9' * 5000}", "name: missing"),
        ("name: a\nground: b\nname: c", "not YAML: line 3: key 'name' is given twice"),
        ("? [a]\n: b", "not YAML: line 1: a key is not a text"),
        ("name: a\n---\nname: b", "not YAML: line 2: a second document"),
        ('name: "a\\ud800b"', "not YAML: line 1: found invalid Unicode character"),
        ("a: " + "x" * 1_000_000, "1.000003 MB, at most 1; to allow it: --set scene_size=2"),
        # each line doubles the one before: 2^40 numbers
        ("a: &a0 1\n" + "".join(f"b{k}: &a{k + 1} [*a{k}, *a{k}]\n" for k in range(40)), "aliases are not"),
    ],
)
def test_files_that_are_no_scenes(capsys, tmp_path, text, message):
    check_refused(capsys, tmp_path, scene_file(tmp_path, text), message=message)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{\n"a":,\n}', "not JSON: line 2: Expecting value"),
        ('{"name": "a", "name": "b"}', "key 'name' is given twice"),
        ('{"a": ' + "9" * 5000 + "}", "not JSON: Exceeds the limit"),
        ("[" * 100_000, "nested too deeply"),
    ],
)
def test_json_files_that_are_no_scenes(capsys, tmp_path, text, message):
    check_refused(capsys, tmp_path, scene_file(tmp_path, text, "scene.json"), message=message)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (True, "a number, not a truth value (got True)"),
        (10**400, "duration: Input should be a"),
        (float("nan"), "duration: Input should be a finite number"),
    ],
)
def test_json_numbers(capsys, tmp_path, good, value, message):
    text = json.dumps(good | {"duration": value})
    check_refused(capsys, tmp_path, scene_file(tmp_path, text, "scene.json"), message=message)


def test_json_is_read_as_json(tmp_path, good):
    # YAML forbids tabs at the beginning of a line
    path = scene_file(tmp_path, json.dumps(good, indent="\t"), "scene.json")
    scene, same = load(str(path)), load(str(scene_file(tmp_path, good)))
    assert scene.name == same.name == "four_bar"
    assert [body.mass for body in scene.mechanism.bodies] == [0.0, 0.5, 1.0, 0.8]
    assert scene.control == same.control


def test_everything_that_a_scene_file_can_hold(tmp_path, good):
    content = copy.deepcopy(good)
    box = {"kind": "box", "half_sizes": [0.01, 0.02, 0.1], "center": [0.0, 0.0, 0.1]}
    bar = {"kind": "capsule", "start": [0.0, 0.0, 0.0], "end": [0.0, 0.0, 0.2], "radius": 0.01}
    rod, ball = bar | {"kind": "cylinder"}, {"kind": "sphere", "center": [0.0, 0.0, 0.1], "radius": 0.02}
    content["bodies"][0]["shapes"] = [box, bar, rod, ball]
    content["bodies"][0]["inertia"][2][2] = 0.01
    content["bodies"][0]["allow_unrealisable_inertia"] = True
    content["outputs"] = ["energy", "velocities"]
    # the coupler may turn about the line from elbow to wrist; both of them and its center stay in place
    line = [0.6, 0.1, 0.1]
    content["bodies"][1]["center_of_mass"] = [0.3, 0.05, 0.25]
    content["joints"][2] |= {"kind": "spherical"}
    del content["joints"][2]["axis_on_first"], content["joints"][2]["axis_on_second"]
    content["initial_state"] = {"coupler": {"angular_velocity": line}}
    scene = load(str(scene_file(tmp_path, content)))
    kinds = [type(shape).__name__ for shape in scene.mechanism.bodies[1].shapes]
    assert kinds == ["Box", "Capsule", "Cylinder", "Sphere"]
    assert scene.outputs == {"energy", "velocities"}
    assert initial_state(scene).angular_velocity.tolist() == [[0.0] * 3, [0.0] * 3, line, [0.0] * 3]
    assert initial_state(scene).position[2].tolist() == [0.3, 0.05, 0.25]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("path", "value"),
    [(("control", 0, "stiffness"), 1e99), (("gravity",), [0.0, 0.0, -1e99])],
)
def test_absurd_magnitudes_are_one_line(capsys, tmp_path, good, path, value):
    scene = scene_file(tmp_path, changed(good, path, value))
    status, out, err = run(capsys, "run", scene, "--engines", "newton_euler", "--output", tmp_path / "out")
    assert (status, err) == (3, "")
    assert verdict_of(out).startswith("UNFINISHED: newton_euler")


def test_a_pipe_is_no_scene_file(tmp_path):
    os.mkfifo(tmp_path / "pipe.yaml")
    done = command(tmp_path, "run", "pipe.yaml")
    assert (done.returncode, done.stderr) == (2, "crosscheck: error: pipe.yaml: not a regular file\n")


def test_binary_and_missing_files_and_folders(capsys, tmp_path):
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"\xff\xfe\x00\x80")
    check_refused(capsys, tmp_path, binary, message="binary.yaml: not")
    check_refused(capsys, tmp_path, tmp_path / "missing.yaml", message="No such file")
    (tmp_path / "folder.yaml").mkdir()
    check_refused(capsys, tmp_path, tmp_path / "folder.yaml", message="not a regular file")


def with_forces(content):
    """The example with one of each force."""
    content = copy.deepcopy(content)
    content["forces"] = [
        {"kind": "joint_spring", "joint": "motor", "stiffness": 2.0, "damping": 0.1, "rest": 0.2},
        {
            "kind": "point_spring", "name": "tie", "first": "frame", "second": "rocker",
            "point_on_first": [0.6, 0.5, 0.0], "point_on_second": [0.6, 0.1, 0.3],
            "stiffness": 10.0, "rest_length": 0.3,
        },
        {"kind": "wrench", "name": "push", "body": "coupler", "point": [0.3, 0.05, 0.25], "force": [0, 0, 2]},
        {
            "kind": "wind_load", "name": "wind", "body": "rocker", "point": [0.6, 0.1, 0.3],
            "first_side": [0, 0.2, 0], "second_side": [0, 0, 0.3], "direction": [1, 0, 0],
            "speed": {"kind": "sine", "amplitude": 1.0, "angular_frequency": 2.0, "offset": 3.0},
        },
    ]  # fmt: skip
    return content


def test_forces_are_those_of_their_classes(tmp_path, good):
    spring, tie, push, wind = load(str(scene_file(tmp_path, with_forces(good)))).forces
    assert spring == JointSpring("motor", stiffness=2.0, damping=0.1, rest=0.2)
    assert (tie.name, tie.first, tie.second, tie.stiffness, tie.rest_length) == (
        "tie", "frame", "rocker", 10.0, 0.3,
    )  # fmt: skip
    assert list(tie.point_on_first) == [0.6, 0.5, 0.0]
    assert (push.name, push.body, list(push.force), push.frame) == (
        "push",
        "coupler",
        [0.0, 0.0, 2.0],
        "world",
    )
    assert (wind.area, wind.speed, wind.air_density) == (0.06, Sine(1.0, 2.0, offset=3.0), 1.225)


def test_gears_and_motions_are_those_of_their_classes(tmp_path):
    turning = {"mass": 1.0, "inertia": [[0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]]}
    nut = {"name": "nut", "center_of_mass": [0, 0, 0], **turning}
    wheel = {"name": "wheel", "center_of_mass": [1, 0, 0], **turning}
    thread = {"name": "thread", "kind": "screw", "first": "ground", "second": "nut", "point": [0, 0, 0]}
    axle = {"name": "axle", "kind": "revolute", "first": "ground", "second": "wheel", "point": [1, 0, 0]}
    content = {
        "name": "geared", "duration": 1.0, "output_period": 0.1, "bodies": [nut, wheel],
        "joints": [thread | {"axis": [0, 0, 1], "pitch": 0.01}, axle | {"axis": [0, 0, 1]}],
        "couplings": [
            {"kind": "gear", "name": "pair", "driver": "axle", "follower": "thread", "ratio": -2.0,
             "follower_coordinate": 1},
        ],
        "motions": [
            {"joint": "axle", "function": {"kind": "sum", "terms": [
                {"kind": "polynomial", "coefficients": [0.0, 1.5]},
                {"kind": "sine", "amplitude": 0.2, "angular_frequency": 3.0},
            ]}},
        ],
    }  # fmt: skip
    scene = load(str(scene_file(tmp_path, content)))
    assert scene.mechanism.joints[0].pitch == 0.01
    assert scene.mechanism.couplings == (Gear("pair", "axle", "thread", -2.0, follower_coordinate=1),)
    assert scene.motions == (PrescribedMotion("axle", Sum((Polynomial((0.0, 1.5)), Sine(0.2, 3.0)))),)
    # the start follows: 1.5 + 0.2 * 3 rad/s, through the gear, at 0.01 m a radian
    assert initial_state(scene).linear_velocity[1, 2] == pytest.approx(-2.0 * 2.1 * 0.01, rel=1e-9)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("forces", 0, "kind"), "magnet", "forces.0.kind: 'magnet'; choose from: joint_spring, "),
        (
            ("forces", 0, "joint"),
            "engine",
            "spring of joint 'engine': is on an unknown joint 'engine'; needed",
        ),
        (("forces", 1, "stiffness"), -1.0, "point spring 'tie': stiffness is -1.0; needed"),
        (("forces", 2, "frame"), "moon", "Input should be 'world' or 'body'"),
        (("forces", 2, "mass"), 1.0, "mass: unknown key"),
        (("forces", 3, "second_side"), [0, 1, 1], "wind load 'wind': its sides have a cosine of 0.707"),
    ],
)
def test_bad_forces(capsys, tmp_path, good, path, value, message):
    content = changed(with_forces(good), path, value)
    check_refused(capsys, tmp_path, scene_file(tmp_path, content), message=message)


def test_a_screw_needs_its_pitch(capsys, tmp_path, good):
    content = changed(good, ("joints", 0, "kind"), "screw")
    message = "joints.0.screw.pitch: missing"
    check_refused(capsys, tmp_path, scene_file(tmp_path, content), message=message)


LAWS = [
    PD("motor", 1.0, 2.0, Sine(0.1, 2.0), gravity_compensation=True),
    StateFeedback(
        "motor", {"motor": (1.0, 2.0), "pivot": (3.0, 4.0)}, 0.1, targets={"pivot": Sine(0.1, 2.0)}
    ),
    ComputedTorque("motor", 4.0, 5.0, 0.1, model={"rocker.mass": 1.0, "gravity": [0.0, 0.0, -9.0]}),
    Digital(PD("motor", 1.0, 2.0, 0.1), 0.01, 2, 1e-5, 10.0, stroke=(-0.1, np.inf)),
    Digital(ComputedTorque("motor", 4.0, 5.0, 0.1), 0.01),
]


@pytest.mark.parametrize("suffix", ["yaml", "json"])
@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
def test_control_laws_come_back(tmp_path, good, law, suffix):
    scene = replace(load(str(scene_file(tmp_path, good))), control=(law,))
    write_scene(scene, tmp_path / f"written.{suffix}")
    assert load(str(tmp_path / f"written.{suffix}")).control == (law,)


@pytest.mark.parametrize(
    ("law", "message"),
    [
        ({"kind": "pid"}, "control.0"),
        ({"kind": "computed_torque", "damping": 1.0, "target": 0.0}, "stiffness: missing"),
        (
            {"kind": "digital", "period": 0.01, "law": {"joint": "motor", "stiffness": 1.0}},
            "damping: missing",
        ),
        ({"kind": "state_feedback", "gains": {"door": [1.0, 2.0]}}, "gains has 'door'"),
    ],
)
def test_control_laws_that_cannot_be(capsys, tmp_path, good, law, message):
    given = law if law["kind"] == "digital" else {"joint": "motor"} | law
    check_refused(capsys, tmp_path, scene_file(tmp_path, good | {"control": [given]}), message=message)


@pytest.mark.parametrize(
    ("law", "words"),
    [
        (
            StateFeedback("motor", {("motor", 1): (1.0, 2.0)}),
            "scene files can only name the first coordinate",
        ),
        (
            Sampled("motor", lambda time, x, x_rate: 0.0, 0.01),
            "a controller in Python cannot be written to a scene file",
        ),
    ],
)
def test_control_laws_that_files_cannot_hold(tmp_path, law, words):
    motor = Cylindrical("motor", "ground", "rod", [0.0, 0.0, 0.0], axis=[0.0, 0.0, 1.0], actuated=True)
    mechanism = Mechanism([Body.ground(), Body("rod", 1.0, [0.0, 0.0, 0.0], np.eye(3))], [motor])
    scene = Scene("rod", mechanism, 1.0, 0.1, control=(law,))
    with pytest.raises(CrosscheckError, match=words):
        write_scene(scene, tmp_path / "rod.yaml")


@pytest.mark.parametrize("suffix", [".yaml", ".json"])
def test_wound_angles_are_written_and_read_back(tmp_path, good, suffix):
    """The file starts at the initial pose after 3 revolutions, `start` 0.1 rad further."""
    scene = load(str(scene_file(tmp_path, good)))
    turns = 6.0 * np.pi
    wound = changed(good, ("initial_angles",), {"motor": turns})
    read = load(str(scene_file(tmp_path, wound, "wound.yaml")))
    assert initial_state(read).angles == {("motor", 0): turns}
    assert initial_state(scene).angles == {("motor", 0): 0.0}
    moved = start(read, motor=(turns + 0.1, 0.0))
    write_scene(moved, tmp_path / f"again{suffix}")
    again = initial_state(load(str(tmp_path / f"again{suffix}")))
    assert again.angles == initial_state(moved).angles
    assert np.array_equal(again.quaternion, initial_state(moved).quaternion)
