"""The MJCF of a scene, and what MuJoCo compiles from it."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from mechanisms import at_rest

import mjcf
import urdf
from crosscheck.library.tracker import tracker as make_tracker
from mjcf import read as read_mjcf
from mjcf.errors import ModelError
from mjcf.model import MujocoScene
from newton_euler.equations.system import MassProperties
from newton_euler.errors import NewtonEulerError
from newton_euler.model.control import PD
from newton_euler.model.euler_parameters import angle_between, rotation
from newton_euler.model.joint_kinds import Free, Revolute, Universal
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import unweld_loops, weld_loops
from newton_euler.reading.excitation import random_states
from urdf import read as read_urdf
from urdf.write import loops_path

NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")

MODEL = 1e-13
"""Relative: MuJoCo's own diagonalisation of an inertia is good to 2e-14."""


def compiled(scene: Scene) -> Any:
    return mujoco.MjModel.from_xml_string(mjcf.to_xml(scene))


def one_body(body: Body) -> Scene:
    free = Free("float", "ground", body.name, body.center_of_mass)
    return Scene("one", Mechanism([Body.ground(), body], [free]), 1.0, 0.1)


def test_tracker_xml_is_what_the_writer_writes(tracker: Scene) -> None:
    stored = files("mjcf").joinpath("tracker.xml").read_text(encoding="utf-8")
    written = mjcf.to_xml(tracker)
    assert NUMBER.sub("#", written) == NUMBER.sub("#", stored)
    found, wanted = (np.array([float(x) for x in NUMBER.findall(text)]) for text in (written, stored))
    # equal but for the last digit, in which processors that fuse multiply and add differ
    assert np.all(np.abs(found - wanted) <= 4e-16 * np.maximum(1.0, np.abs(wanted)))


def test_import_and_writing_do_not_need_mujoco() -> None:
    code = (
        "import sys, mjcf; from crosscheck.library.tracker import tracker; mjcf.to_xml(tracker()); "
        "sys.exit('mujoco' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_write_leaves_a_whole_file_or_none(tracker: Scene, tmp_path: Path) -> None:
    mjcf.write(tracker, tmp_path / "models" / "tracker.xml")
    assert (tmp_path / "models" / "tracker.xml").read_text() == mjcf.to_xml(tracker)
    body = Body("world", 1.0, np.zeros(3), np.eye(3))
    with pytest.raises(ModelError, match="'world'"):
        mjcf.write(one_body(body), tmp_path / "bad.xml")
    assert [path.name for path in tmp_path.iterdir()] == ["models"]


def test_a_path_that_cannot_be_written_is_named(tracker: Scene, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(mjcf.MjcfError, match=r"cannot write .*file/tracker\.xml': ") as caught:
        mjcf.write(tracker, tmp_path / "file" / "tracker.xml")
    assert isinstance(caught.value, NewtonEulerError)


@pytest.mark.parametrize("panel_inertia", ["realisable", "literal"])
def test_compiled_masses_centers_and_inertias(panel_inertia: Any) -> None:
    scene = make_tracker(panel_inertia=panel_inertia)
    found, wanted = MujocoScene(scene).mass_properties(), MassProperties.of(scene.mechanism)
    assert np.array_equal(found.mass, wanted.mass)
    assert np.max(np.abs(found.center_of_mass - wanted.center_of_mass)) < MODEL * 0.1
    scale = np.max(np.abs(wanted.inertia), axis=(1, 2), keepdims=True)
    assert np.max(np.abs(found.inertia - wanted.inertia) / scale) < MODEL


def test_halves_of_a_cut_body_add_up() -> None:
    bodies = [Body.ground()]
    for k, axis in enumerate(np.eye(3)):
        bodies.append(Body(f"body_{k}", 1.0 + k, axis, np.diag([0.1, 0.15, 0.2]) * (1.0 + k)))
    names = [body.name for body in bodies]
    joints = [
        Revolute(f"hinge_{i}{j}", names[i], names[j], [i, j, 0.5], axis=[i, j, 1.0])
        for i, j in ((0, 1), (1, 2), (2, 3), (3, 0), (1, 3), (0, 2))
    ]
    scene = Scene("two_loops_and_more", Mechanism(bodies, joints), 1.0, 0.1)
    system = MujocoScene(scene)
    assert system.model.nbody > len(bodies)
    found, wanted = system.mass_properties(), MassProperties.of(scene.mechanism)
    assert np.allclose(found.mass, wanted.mass, rtol=MODEL)
    assert np.allclose(found.inertia, wanted.inertia, rtol=MODEL, atol=MODEL * 0.1)
    assert np.allclose(found.center_of_mass, wanted.center_of_mass, rtol=0.0, atol=MODEL)


def test_flat_bodies_in_any_orientation_are_accepted() -> None:
    """A + B = C exactly, which round-off breaks for MuJoCo more often than not."""
    rng = np.random.default_rng(0)
    for _ in range(50):
        axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        a, b = rng.uniform(1e-3, 2e-3, 2)
        inertia = axes @ np.diag([a, b, a + b]) @ axes.T
        scene = one_body(Body("plate", 1.0, np.zeros(3), 0.5 * (inertia + inertia.T)))
        found = MujocoScene(scene).mass_properties().inertia[1]
        assert np.max(np.abs(found - inertia)) < MODEL * (a + b)
        standalone = compiled(scene).body_inertia[1]
        # what the text itself says is off by the slack it keeps, 1e-12, at most
        assert np.max(np.abs(np.sort(standalone) - np.sort([a, b, a + b]))) < 3e-12 * (a + b)


@pytest.mark.parametrize("turn", [1e-9, 3e-7, 1.2e-6, 5e-6, 1e-3])
def test_axes_of_inertia_that_are_nearly_the_bodys_own_are_kept(turn: float, tmp_path: Path) -> None:
    """MuJoCo's own principal axes leave out turns of less than 1.4e-6 rad."""
    axes = rotation(np.array([np.cos(0.5 * turn), 0.0, 0.0, np.sin(0.5 * turn)]))
    inertia = axes @ np.diag([1e-3, 2e-3, 2.5e-3]) @ axes.T
    scene = one_body(Body("plate", 1.0, np.zeros(3), 0.5 * (inertia + inertia.T)))
    wanted = scene.mechanism.bodies[1].inertia
    assert np.max(np.abs(MujocoScene(scene).mass_properties().inertia[1] - wanted)) < MODEL * 2.5e-3
    mjcf.write(scene, tmp_path / "plate.xml")
    back = read_mjcf(tmp_path / "plate.xml").scene.mechanism.bodies[1]
    found = rotation(back.quaternion) @ back.inertia @ rotation(back.quaternion).T
    assert np.max(np.abs(found - wanted)) < MODEL * 2.5e-3


def test_joints_are_named_in_their_own_order() -> None:
    x, y, _ = np.eye(3)
    bodies = [Body.ground(), Body("arm", 1.0, np.zeros(3), np.eye(3))]
    cross = Universal("cross", "arm", "ground", np.zeros(3), axis_on_first=x, axis_on_second=y)
    model = compiled(Scene("cross", Mechanism(bodies, [cross]), 1.0, 0.1))
    # the arm is the first body, so from the ground the second axis comes first, and both point back
    assert [model.joint(k).name for k in range(2)] == ["cross_2", "cross_1"]
    assert np.array_equal(model.jnt_axis, [-y, -x])


def test_keyframe_holds_the_initial_state_and_the_targets(tracker: Scene) -> None:
    state = random_states(tracker, 1)[0]
    scene = replace(tracker, initial_state=state)
    model = compiled(scene)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    mujoco.mj_forward(model, data)
    assert np.array_equal(data.ctrl, [law.target for law in scene.control])
    for k, name in enumerate(scene.mechanism.body_names[1:], start=1):
        body = data.body(name)
        # joint angles out of rotation matrices and back, products of order 1
        assert np.max(np.abs(body.xpos - state.position[k])) < 1e-14
        assert angle_between(body.xquat, state.quaternion[k]) < 1e-14
        assert np.max(np.abs(body.cvel[:3] - state.angular_velocity[k])) < 1e-13


def test_stock_mujoco_brings_the_tracker_to_its_target(tracker: Scene) -> None:
    model = mujoco.MjModel.from_xml_path(str(files("mjcf").joinpath("tracker.xml")))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    mujoco.mj_step(model, data, 5000)
    # K_d / K_p is 0.4 and 0.5 s: after 5 s e^-10 of 21 mm is left
    assert data.body("slider_2").xpos[2] == pytest.approx(0.046, abs=2e-6)
    assert data.body("slider_3").xpos[2] == pytest.approx(0.046, abs=2e-6)


def test_a_clash_of_names_is_reported_with_mujocos_reason() -> None:
    bodies = [Body.ground()] + [Body(f"body_{k}", 1.0, np.zeros(3), np.eye(3)) for k in range(2)]
    x, y, z = np.eye(3)
    joints = [
        Universal("a", "ground", "body_0", np.zeros(3), axis_on_first=x, axis_on_second=y),
        Revolute("a_1", "body_0", "body_1", np.zeros(3), axis=z),
    ]
    with pytest.raises(ModelError, match="a_1"):
        MujocoScene(Scene("clash", Mechanism(bodies, joints), 1.0, 0.1))


def test_damping_that_feeds_energy_is_refused(tracker: Scene) -> None:
    control = (PD("slide_12", 50.0, -2.0, 0.0),)
    with pytest.raises(ModelError, match="'slide_12' is -2"):
        mjcf.to_xml(replace(tracker, control=control))


def test_a_body_that_is_too_light_is_named_with_what_is_needed() -> None:
    light = Body("light", 1.0, np.zeros(3), 1e-20 * np.eye(3))
    hinge = Revolute("hinge", "ground", "light", np.zeros(3), axis=np.eye(3)[2])
    reason = "body 'light': mass 1 kg, least principal moment 1e-20 kg m^2; needed: more than 1e-14 of both"
    with pytest.raises(ModelError, match=re.escape(reason)):
        MujocoScene(Scene("light", Mechanism([Body.ground(), light], [hinge]), 1.0, 0.1))


WELD_CLOSED = """<mujoco><worldbody>
<body name="crank"><joint name="A" axis="0 1 0"/>
  <geom type="capsule" size="0.02" fromto="0 0 0 0.1 0 0.5"/>
  <body name="coupler" pos="0.1 0 0.5"><joint name="B" axis="0 1 0"/>
    <geom type="capsule" size="0.02" fromto="0 0 0 0.9 0 0.2"/>
    <body name="tip" pos="0.9 0 0.2" quat="0.9 0.1 0.3 -0.2">{joint}
      <geom type="box" size="0.03 0.02 0.01"/></body></body></body>
<body name="rocker" pos="1 0 0"><joint name="D" axis="0 1 0"/>
  <geom type="capsule" size="0.02" fromto="0 0 0 0 0 0.7"/></body>
</worldbody><equality><weld name="C_weld" body1="{first}" body2="{second}" {anchor}/></equality></mujoco>"""
"""A four-bar linkage closed by a weld, which is named as the cut of its joint C would be."""

WELDS = {
    "hinge": ('<joint name="C" axis="-6 17 -6"/>', "tip", "rocker", 'anchor="0 0 0.7"'),
    "turned round": ('<joint name="C" axis="-6 17 -6"/>', "rocker", "tip", 'anchor="0.01 0 0"'),
    "to the world": ('<joint name="C" type="ball"/>', "world", "tip", 'anchor="0.01 0 0"'),
    "ball": ('<joint name="C" type="ball"/>', "tip", "rocker", 'anchor="0 0 0.7"'),
}


@pytest.mark.parametrize("suffix", ["xml", "urdf"])
@pytest.mark.parametrize("name", WELDS)
def test_a_loop_that_a_weld_closes_goes_there_and_back(name: str, suffix: str, tmp_path: Path) -> None:
    joint, first, second, anchor = WELDS[name]
    text = WELD_CLOSED.format(joint=joint, first=first, second=second, anchor=anchor)
    (tmp_path / "model.xml").write_text(text)
    scenes = [read_mjcf(tmp_path / "model.xml").scene]
    for number in range(2):
        path = tmp_path / f"{number}.{suffix}"
        if suffix == "xml":
            mjcf.write(scenes[-1], path)
            scenes.append(read_mjcf(path).scene)
        else:
            urdf.write(scenes[-1], path)
            scenes.append(read_urdf(path, loops_path(path)).scene)
    own, *found = [replace(scene, initial_state=None) for scene in scenes]
    wanted = at_rest(own)
    for scene in found:
        assert set(scene.mechanism.joint_names) == set(own.mechanism.joint_names)
        assert set(scene.mechanism.body_names[1:]) == set(own.mechanism.body_names[1:])
        back = at_rest(scene)
        for k, body in enumerate(own.mechanism.bodies[1:], start=1):
            i = scene.mechanism.body_index(body.name)
            other = scene.mechanism.bodies[i]
            # seventeen digits in the files, and condition numbers below 1e3
            assert other.mass == pytest.approx(body.mass, rel=1e-12)
            assert other.center_of_mass == pytest.approx(body.center_of_mass, abs=1e-12)
            turn = rotation(body.quaternion).T @ rotation(other.quaternion)
            inertia = turn @ other.inertia @ turn.T
            assert np.allclose(inertia, body.inertia, rtol=0.0, atol=1e-12 * np.max(body.inertia))
            for array in ("linear_acceleration", "angular_acceleration"):
                x, y = getattr(wanted, array)[k], getattr(back, array)[i]
                assert np.max(np.abs(x - y)) < 1e-12 * max(1.0, np.max(np.abs(getattr(wanted, array))))


def test_a_cut_is_named_as_nothing_else_is(tmp_path: Path) -> None:
    """An engine halves a body at joint C, whose weld would be named as the user's own."""
    joint, first, second, anchor = WELDS["hinge"]
    text = WELD_CLOSED.format(joint=joint, first=first, second=second, anchor=anchor)
    (tmp_path / "model.xml").write_text(text.replace('name="B"', 'name="keep"'))
    mechanism = read_mjcf(tmp_path / "model.xml").scene.mechanism
    welded = weld_loops(mechanism)
    assert len(welded.mechanism.bodies) == len(mechanism.bodies) + 1
    back = unweld_loops(welded.mechanism)
    assert back.joint_names == mechanism.joint_names
    assert [body.mass for body in back.bodies] == pytest.approx([body.mass for body in mechanism.bodies])
