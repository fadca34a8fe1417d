"""Model files on the command line: runs with a report, conversions, and files that are hostile or broken."""

from __future__ import annotations

import inspect
import json
from dataclasses import replace

import numpy as np
import pytest
from armed_scenes import COMPOUNDS, armed, sprung
from command_line import check_refused, run, verdict_of
from elements import ELEMENTS as SCENES
from mechanisms import GRAVITY
from mjcf_models import ELEMENTS, FOUR_BARS
from urdf_files import CHAIN, joint, link, robot

import mjcf
import urdf
from crosscheck.library import load
from crosscheck.library.model_files import MJCF_OPTIONS, URDF_OPTIONS, read_model
from crosscheck.library.scene_file import write_scene
from mjcf import read as read_mjcf
from newton_euler.equations.relative import Relative
from newton_euler.equations.system import Evaluation
from newton_euler.model.forces import JointSpring
from newton_euler.model.scene import Scene
from newton_euler.model.source_file import Request
from newton_euler.runs.assemble import initial_state

FOUR_BAR = FOUR_BARS["cut at C by a connect"]


FALLING = "<mujoco><worldbody>{}</worldbody></mujoco>"
BALL = '<body name="b{0}" pos="0 0 0.3{0}"><freejoint/><geom size="0.1" contype="0" conaffinity="0"/></body>'


@pytest.mark.slow
def test_a_motion_that_tests_nothing_is_no_plain_agreement(capsys, tmp_path):
    """In free fall no mass and no inertia shows; the table lists all of them, the terminal counts."""
    path, out = tmp_path / "balls.xml", tmp_path / "out"
    path.write_text(FALLING.format("".join(BALL.format(k) for k in range(10))))
    options = ("--set", "duration=0.1", "--set", "excitation=off", "--output", out)
    status, text, _ = run(capsys, "run", path, *options)
    assert status == 0
    verdict = verdict_of(text)
    assert verdict.startswith("AGREE AT RANDOM STATES ONLY: ")
    assert "; motion covers 0 of 20 elements" in verdict
    names = [f"{what} of body 'b{k}'" for k in range(10) for what in ("mass", "inertia")]
    (line,) = [line for line in text.splitlines() if line.startswith("untested by the motion")]
    assert sum(name in line for name in names) == 12
    assert line.endswith(" and 8 more, all in summary.json and on the page of `crosscheck report`")
    found = json.loads((out / "summary.json").read_text())["report"]
    assert found["judged"] == {"text": "AGREE AT RANDOM STATES ONLY", "verdict": "doubtful", "about": ""}
    (table,) = [part for part in found["parts"] if part["title"].startswith("untested by the motion")]
    assert [row[0] for row in table["rows"]] == names


def test_an_inertia_that_no_mass_has_is_named(capsys, tmp_path):
    """A URDF may have one, so that it is run, but not in silence."""
    path = tmp_path / "arm.urdf"
    arm = robot(link("a"), joint("first", "continuous", "base", "a"))
    path.write_text(arm.replace('izz="0.025"', 'izz="0.25"'))
    _, text, _ = run(capsys, "run", path, "--engines", "newton_euler", "--output", tmp_path / "out")
    assert "impossible-inertia: body 'a'" in text


AFAR = """<mujoco><worldbody>
<body name="a" pos="{0} 0 0"><joint axis="0 1 0" stiffness="{3}"/>
<inertial pos="{2} 0 0" mass="1" diaginertia="{3} {3} {3}"/>
<body name="b" pos="{1} 0 0"><joint axis="0 1 0"/>
<inertial pos="{2} 0 0" mass="1" diaginertia="{3} {3} {3}"/></body></body>
<body name="c" pos="{4} 0 -{1}"><joint axis="0 1 0"/>
<inertial pos="0 0 {2}" mass="1" diaginertia="{3} {3} {3}"/></body></worldbody>
<equality><connect body1="b" body2="c" anchor="{2} 0 0"/></equality></mujoco>"""


@pytest.mark.slow
@pytest.mark.parametrize(("distance", "size"), [(1e4, 1.0), (5e5, 1.0), (1e3, 0.01)])
def test_far_from_the_origin_models_agree_as_far_as_their_coordinates_have_digits(
    capsys, tmp_path, distance, size
):
    """Map coordinates of a mechanism of 1 m leave 10 digits of a point on it."""
    path = tmp_path / "afar.xml"
    path.write_text(AFAR.format(distance, size, 0.5 * size, 0.02 * size**2, distance + 1.5 * size))
    options = ("--set", "duration=0.02", "--engines", "newton_euler,mujoco", "--output", tmp_path / "out")
    assert verdict_of(run(capsys, "run", path, *options)[1]).startswith("AGREE")


def test_an_mjcf_is_run_with_its_report(capsys, tmp_path):
    path = tmp_path / "model.xml"
    path.write_text(FOUR_BAR)
    status, out, err = run(
        capsys, "run", path, "-v", "--set", "duration=0.1", "--advice", "--output", tmp_path / "out"
    )
    assert (status, err) == (0, "")
    lines = out.splitlines()
    counted = "6 elements read exactly, 1 rigid here and soft in the file (1 equality)"
    assert f"elements of the file: {counted}" in lines
    assert lines.count(f"the file: {counted}") == 2  # among all notes, and in the summary
    assert "  equality 'c': spherical joint 'c'" in out
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["outcome"] == "AGREE"
    assert len(summary["coverage"]) == 10
    assert all(element["tested"] for element in summary["coverage"])
    assert {entry["fate"] for entry in summary["mapping"]} == {"exactly", "left out"}
    assert summary["start"][0].startswith("starts from qpos0")
    (start,) = [line for line in lines if line.startswith("start: same pose to ")]
    assert all(f"{engine} " in start for engine in ("newton_euler", "mujoco", "pinocchio"))
    advised = list(dict.fromkeys(line for line in lines if line.startswith("advice, ")))
    topics = [entry["topic"] for entry in summary["advice"]]
    assert [line.split(": ")[0].removeprefix("advice, ") for line in advised] == topics
    assert set(topics) == {"redundancy"}


@pytest.mark.slow
def test_a_urdf_is_run_with_its_loops(capsys, tmp_path):
    assert run(capsys, "convert", "tracker_aligned", tmp_path / "tracker.urdf")[0] == 0
    status, out, _ = run(
        capsys, "run", "-v", tmp_path / "tracker.urdf", "--set", f"loops={tmp_path / 'tracker.loops.yaml'}",
        "--set", "duration=0.05", "--output", tmp_path / "out",
    )  # fmt: skip
    assert status == 0
    assert "starts from coordinates 0: all loops closed" in out


def start_of(scene: Scene) -> Evaluation:
    system = Relative(scene)
    return system.evaluate(*system.coordinates(initial_state(scene)))


def assert_same_scene(one: Scene, two: Scene) -> None:
    """Bodies and accelerations at the start."""
    own, found = start_of(one), start_of(two)
    for k, body in enumerate(one.mechanism.bodies[1:], start=1):
        i = two.mechanism.body_index(body.name)
        other = two.mechanism.bodies[i]
        assert other.mass == pytest.approx(body.mass, rel=1e-15)
        assert other.center_of_mass == pytest.approx(body.center_of_mass, abs=1e-14)
        for array in ("linear_acceleration", "angular_acceleration"):
            x, y = getattr(own, array)[k], getattr(found, array)[i]
            # 1e-12 of the largest: seventeen digits in the file, and condition numbers of 1e3
            assert np.max(np.abs(x - y)) < 1e-12 * max(1.0, np.max(np.abs(getattr(own, array)))), body.name


SPRINGLESS = ("spring without length",)
"""MuJoCo's line of a spring of no length has an error of 1e-12 of its own."""

BACK = {
    name: scene
    for name, scene in SCENES.items()
    if not scene.motions
    and name not in SPRINGLESS
    and all(joint.kind != "fixed" for joint in scene.mechanism.joints)
}
BACK |= {name: sprung(armed(scene)) for name, scene in COMPOUNDS.items()}


@pytest.mark.parametrize("name", BACK)
def test_mjcf_there_and_back(name, tmp_path):
    mjcf.write(BACK[name], tmp_path / "model.xml")
    found = read_mjcf(tmp_path / "model.xml").scene
    assert_same_scene(BACK[name], found)
    # `weld_loops` halves bodies, and reading puts them together again
    assert len(found.mechanism.bodies) == len(BACK[name].mechanism.bodies)


@pytest.mark.parametrize("name", [*SCENES, *COMPOUNDS])
@pytest.mark.parametrize("suffix", [".yaml", ".json"])
def test_scene_files_there_and_back(name, suffix, tmp_path):
    scene = SCENES[name] if name in SCENES else sprung(armed(COMPOUNDS[name]))
    path = tmp_path / f"scene{suffix}"
    write_scene(scene, path)
    back = load(str(path))
    assert_same_scene(scene, back)
    assert back.mechanism.joint_names == scene.mechanism.joint_names
    assert (back.duration, back.outputs) == (scene.duration, scene.outputs)


def test_convert_says_what_a_format_cannot_hold(capsys, tmp_path):
    model = tmp_path / "model.xml"
    model.write_text(ELEMENTS["springs and dampers"].replace("<joint", '<joint armature="0.3"'))
    status, out, _ = run(capsys, "convert", model, tmp_path / "model.urdf")
    assert status == 0
    rotors = "  armature of joint 'p', armature of joint 'two_joints', armature of joint 'two_joints'"
    assert f"{rotors}: a URDF has no rotors" in out
    assert out.splitlines()[-1].startswith("wrote ")
    assert run(capsys, "convert", model, tmp_path / "model.yaml")[0] == 0
    assert run(capsys, "convert", tmp_path / "model.yaml", tmp_path / "again.xml")[0] == 0
    assert_same_scene(read_mjcf(model).scene, read_mjcf(tmp_path / "again.xml").scene)
    status, _, err = run(capsys, "convert", model, tmp_path / "model.txt")
    assert (status, "ends in .xml, .mjcf, .urdf, .yaml, .yml, .json" in err) == (2, True)


def dampings(scene: Scene) -> dict[tuple[str, int], float]:
    """Damping along hinges and slides, N s/m or N m s/rad, by joint and coordinate."""
    found = [force for force in scene.forces if isinstance(force, JointSpring)]
    return {(force.joint, force.coordinate): force.damping for force in found}


def test_a_urdf_keeps_the_damping_of_joints_there_and_back(capsys, tmp_path):
    model, target, again = (tmp_path / name for name in ("model.xml", "model.urdf", "again.urdf"))
    model.write_text(ELEMENTS["springs and dampers"].replace('stiffness="20"', ""))
    status, out, _ = run(capsys, "convert", model, target, "-v")
    own = read_mjcf(model).scene
    assert status == 0
    assert "joint 'p', joint 'q', joint 'r': its damping 2 as a damper" in out
    assert "a URDF has no forces" not in out
    assert dampings(own) == dampings(urdf.read(target).scene)
    assert set(dampings(own).values()) == {2.0}
    assert_same_scene(replace(own, gravity=GRAVITY), urdf.read(target, tmp_path / "model.loops.yaml").scene)
    status, out, _ = run(capsys, "convert", target, again)
    assert (status, "a URDF has no forces" in out) == (0, False)
    assert dampings(urdf.read(again).scene) == dampings(own)


def test_a_urdf_keeps_the_damping_of_springs_and_says_that_they_are_left_out(capsys, tmp_path):
    model, target = tmp_path / "model.xml", tmp_path / "model.urdf"
    model.write_text(ELEMENTS["springs and dampers"])
    _, out, _ = run(capsys, "convert", model, target)
    left_out = out[out.index("\nleft out:") :]
    assert "its stiffness 20 and damping 2 as a spring: a URDF has no forces" in left_out
    assert dampings(urdf.read(target).scene) == dampings(read_mjcf(model).scene)


@pytest.mark.parametrize("suffix", [".xml", ".urdf"])
def test_what_is_no_file(suffix, capsys, tmp_path):
    (tmp_path / f"folder{suffix}").mkdir()
    check_refused(capsys, tmp_path, tmp_path / f"folder{suffix}", message="not a regular file")
    check_refused(capsys, tmp_path, tmp_path / f"none{suffix}", message="cannot be read: No such file")
    (tmp_path / f"binary{suffix}").write_bytes(b"\xff\x00\xfe")
    check_refused(capsys, tmp_path, tmp_path / f"binary{suffix}", message="not ")


def test_gravity_of_a_urdf(capsys, tmp_path):
    path = tmp_path / "chain.urdf"
    path.write_text(CHAIN)
    for given, gravity in (("0", (0.0, 0.0, 0.0)), ("0,0.5,-1.62", (0.0, 0.5, -1.62))):
        scene, report = read_model(str(path), {"gravity": given})
        assert tuple(scene.gravity) == gravity
        said = " ".join(f"{g:g}" for g in gravity)
        assert report.start[-1].startswith(f"gravity is {said} m/s^2, a URDF has none; ")
    assert tuple(load(str(path)).gravity) == GRAVITY
    for given in ("9.81", "0,0", "down", "0,0,-9.81,0", "0,0,inf"):
        message = f"gravity is '{given}'; needed: X,Y,Z in m/s^2, at most 1e+15, or 0"
        check_refused(capsys, tmp_path, path, "--set", f"gravity={given}", message=message)


@pytest.mark.parametrize(
    ("options", "reader"), [(MJCF_OPTIONS, read_mjcf), (URDF_OPTIONS, urdf.read)], ids=["mjcf", "urdf"]
)
def test_options_of_models_are_listed_with_their_defaults(capsys, options, reader):
    _, out, _ = run(capsys, "list")
    defaults = {
        name: of.default
        for of_one in (reader, Request)
        for name, of in inspect.signature(of_one).parameters.items()
        if name not in ("model", "q", "verified", "options")
    }
    assert options.keys() == defaults.keys()
    for name, option in options.items():
        assert f"    --set {name}={option.values}  [default: {option.default}]\n" in out
        if defaults[name] is not None:
            assert option.read(option.default) == defaults[name]


def test_a_model_of_several_folders_needs_the_option_root(capsys, tmp_path):
    inner = tmp_path / "package" / "robots"
    inner.mkdir(parents=True)
    (tmp_path / "package" / "all.xml").write_text("<mujoco><option gravity='0 0 -1'/></mujoco>")
    path = inner / "model.xml"
    path.write_text(FOUR_BAR.replace("<mujoco>", '<mujoco><include file="../all.xml"/>'))
    trusted = f"if you trust the file: --set root={tmp_path / 'package'}"
    check_refused(capsys, tmp_path, path, message=trusted)
    assert load(str(path), root=str(tmp_path / "package")).gravity[2] == -1.0
