"""Scenes with dry friction and stops: in scene files, in MJCF and URDF files, and in commands."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import pytest
from command_line import run

import urdf
from crosscheck.compare.changes import elements
from crosscheck.library.scene_file import read_scene, write_scene
from crosscheck.loading.convert import scene_report, write_as
from crosscheck.loading.robots import describe_model
from mjcf.reader import read as read_mjcf
from mjcf.rigid import RigidMuJoCo
from newton_euler.model.forces import JointSpring
from newton_euler.model.scene import Scene
from newton_euler.model.switched_forces import JointFriction, JointStop

CART = """
name: cart
duration: 0.5
output_period: 0.01
gravity: [0, 0, 0]
bodies:
  - {name: cart, mass: 3, center_of_mass: [0, 0, 0], inertia: [[0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]]}
  - {name: arm, mass: 1, center_of_mass: [0.5, 0, 0], inertia: [[0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]]}
joints:
  - {name: rail, kind: prismatic, first: ground, second: cart, point: [0, 0, 0], axis: [1, 0, 0]}
  - {name: pivot, kind: revolute, first: cart, second: arm, point: [0, 0, 0], axis: [0, 1, 0]}
forces:
  - {kind: joint_spring, joint: pivot, stiffness: 5, damping: 0.1}
  - {kind: joint_friction, joint: rail, coulomb: 2.0, stribeck: 1.0, transition_speed: 0.002}
  - {kind: joint_friction, joint: pivot, coulomb: 0.3, load_coefficient: 0.01}
  - {kind: joint_stop, joint: rail, side: high, limit: 0.1, stiffness: 1.0e+5, dissipation: 1.5}
  - {kind: joint_stop, joint: rail, side: low, limit: -0.2, stiffness: 2.0e+5, dissipation: 0.5}
  - {kind: joint_stop, joint: pivot, side: low, limit: -0.3, stiffness: 4000}
"""


@pytest.fixture
def cart(tmp_path: Path) -> Scene:
    path = tmp_path / "cart.yaml"
    path.write_text(CART)
    return read_scene(path)


def of_joint(scene: Scene, joint: str) -> list[JointFriction | JointStop]:
    """Return dry friction and stops of a joint, stops from low to high."""
    found = [force for force in scene.switched_forces if force.joint == joint]
    return sorted(found, key=lambda force: force.limit if isinstance(force, JointStop) else -1e9)


@pytest.mark.parametrize("suffix", ["yaml", "json"])
def test_scene_files_keep_them(suffix: str, cart: Scene, tmp_path: Path) -> None:
    path = tmp_path / f"written.{suffix}"
    write_scene(cart, path)
    assert read_scene(path).forces == cart.forces


def test_a_written_mjcf_has_friction_and_limits_of_the_same_softness(cart: Scene, tmp_path: Path) -> None:
    report = scene_report(cart)
    write_as(cart, tmp_path / "cart.xml", report)
    found = read_mjcf(tmp_path / "cart.xml", friction="regularized", limits="compliant").scene
    friction, low, high = of_joint(found, "rail")
    assert isinstance(friction, JointFriction)
    assert friction.coulomb == 2.0
    assert friction.transition_speed == pytest.approx(0.002)
    # both limits have the softness of the stiffer stop
    assert isinstance(low, JointStop)
    assert isinstance(high, JointStop)
    assert (low.limit, high.limit) == (-0.2, 0.1)
    for stop in (low, high):
        assert (stop.stiffness, stop.dissipation) == (pytest.approx(2e5), pytest.approx(0.5))
    friction, stop = of_joint(found, "pivot")
    assert (friction, stop.side) == (replace(friction, coulomb=0.3), "low")  # type: ignore[union-attr]
    assert stop.stiffness == pytest.approx(4000.0)  # type: ignore[union-attr]
    approximated = {entry.element for entry in report.of("approximated")}
    assert approximated == {force.element for force in cart.switched_forces}
    left_out = {(entry.element, entry.topic) for entry in report.of("left out") if entry.topic}
    assert left_out == {
        ("friction of joint 'rail'", "Stribeck friction"),
        ("friction of joint 'pivot'", "load coefficient"),
        ("high stop of joint 'rail'", "stiffness"),
    }


def test_a_written_urdf_has_friction_and_limits(cart: Scene, tmp_path: Path) -> None:
    report = scene_report(cart)
    write_as(cart, tmp_path / "cart.urdf", report)
    found = urdf.read(tmp_path / "cart.urdf", friction="regularized", limits="compliant").scene
    friction, low, high = of_joint(found, "rail")
    assert (friction.coulomb, low.limit, high.limit) == (2.0, -0.2, 0.1)  # type: ignore[union-attr]
    friction, stop = of_joint(found, "pivot")  # a limit at one side
    assert (friction.coulomb, stop.limit) == (0.3, -0.3)  # type: ignore[union-attr]
    (damper,) = (force for force in found.forces if isinstance(force, JointSpring))
    assert damper.damping == 0.1
    assert {entry.element for entry in report.of("approximated")} == {
        force.element for force in cart.switched_forces
    }


@pytest.mark.parametrize("suffix", ["xml", "urdf"])
def test_friction_without_coulomb_friction_is_not_said_to_be_written(
    suffix: str, cart: Scene, tmp_path: Path
) -> None:
    loaded, idle = (
        JointFriction(name, 0.0, load_coefficient=c) for name, c in (("rail", 0.3), ("pivot", 0.0))
    )
    scene = replace(cart, forces=(loaded, idle))
    report = scene_report(scene)
    write_as(scene, tmp_path / f"cart.{suffix}", report)
    assert report.of("approximated") == []
    found = {(entry.element, entry.topic, entry.moves_nothing) for entry in report.of("left out")}
    assert {(loaded.element, "load coefficient", False), (idle.element, "", True)} <= found


@pytest.mark.parametrize("suffix", ["xml", "urdf"])
def test_a_stop_without_stiffness_is_no_limit_of_a_written_file(
    suffix: str, cart: Scene, tmp_path: Path
) -> None:
    (soft,) = (force for force in cart.forces if isinstance(force, JointStop) and force.limit == 0.1)
    forces = tuple(replace(force, stiffness=0.0) if force is soft else force for force in cart.forces)
    scene, path = replace(cart, forces=forces), tmp_path / f"cart.{suffix}"
    report = scene_report(scene)
    write_as(scene, path, report)
    assert soft.element not in {entry.element for entry in report.of("approximated")}
    assert {entry.moves_nothing for entry in report.of("left out") if entry.element == soft.element} == {True}
    write_scene(scene, tmp_path / "soft.yaml")
    for file in (path, tmp_path / "soft.yaml"):  # the same robot, so that `diff` finds no difference
        bodies = describe_model(str(file), {}).robot.bodies
        limits = {each.name: each.limits for body in bodies for each in body.joints}
        assert limits["rail"] == (-0.2, math.inf)


def test_mujoco_as_an_engine_has_them_as_forces_alone(cart: Scene) -> None:
    """The constraints of a written file would act a second time."""
    model = RigidMuJoCo(cart).model
    assert not model.jnt_limited.any()
    assert not model.dof_frictionloss.any()


def test_mujoco_holds_the_written_limits(cart: Scene, tmp_path: Path) -> None:
    write_as(cart, tmp_path / "cart.xml", scene_report(cart))
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "cart.xml"))
    data = mujoco.MjData(model)
    data.qpos[0] = 0.1
    for step in range(4000):
        data.qfrc_applied[0] = 200.0 * min(1.0, step / 3000)
        mujoco.mj_step(model, data)
    assert data.qpos[0] == pytest.approx(0.1 + 200.0 / 2e5, abs=2e-5)  # friction is 2 N at most


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ("coulomb: 2.0, ", "", ("joint_friction.coulomb", "missing")),
        ("coulomb: 2.0", "coulom: 2.0", ("joint_friction.coulom", "unknown key")),
        ("friction, joint: rail", "friction, joint: rial", ("friction of joint 'rial'", "unknown joint")),
        ("side: low, limit: -0.2", "side: high, limit: -0.2", ("high stop", "'rail'", "2 of that name")),
        ("side: low, limit: -0.2", "side: left, limit: -0.2", ("joint_stop.side", "'low' or 'high'")),
        ("limit: -0.2, ", "", ("joint_stop.limit", "missing")),
        ("stiffness: 4000", "stiffness: -1", ("low stop of joint 'pivot'", "stiffness is -1")),
        ("transition_speed: 0.002", "transition_speed: 0", ("friction of joint 'rail'", "positive")),
        ("coulomb: 0.3", "coulomb: 0.3, coordinate: 1", ("friction of joint 'pivot'", "below 1")),
        ("kind: joint_stop", "kind: joint_stops", ("'joint_stops'", "'joint_stop'?")),
    ],
)
def test_errors_name_the_element(
    old: str, new: str, parts: tuple[str, ...], tmp_path: Path, capsys: Any
) -> None:
    path = tmp_path / "cart.yaml"
    path.write_text(CART.replace(old, new, 1))
    status, _, error = run(capsys, "list", path)
    assert status == 2
    assert all(part in error for part in parts)


def test_two_stops_of_a_joint_are_two_elements_of_the_coverage(cart: Scene) -> None:
    names = [element.name for element in elements(cart)]
    assert len(set(names)) == len(names)
    assert "stop at the low limit of joint 'rail'" in names


def test_parameters_of_them_are_listed(cart: Scene, tmp_path: Path, capsys: Any) -> None:
    _, listed, _ = run(capsys, "list", tmp_path / "cart.yaml")
    assert all(name in listed for name in ("rail.friction.coulomb", "pivot.low_stop.limit"))


def test_a_difference_of_friction_or_of_a_limit_is_found(cart: Scene, tmp_path: Path, capsys: Any) -> None:
    other, output = tmp_path / "other.yaml", tmp_path / "diff"
    changed = CART.replace("coulomb: 0.3", "coulomb: 0.4").replace("limit: -0.2", "limit: -0.25")
    other.write_text(changed)
    status, _, error = run(capsys, "diff", tmp_path / "cart.yaml", other, "--output", output)
    assert status == 1, error
    text = (output / "diff.json").read_text()
    assert "limits of rail" in text
    assert "dry friction of pivot: 0.3 against 0.4 N m" in text


def test_a_written_mjcf_has_no_other_limits(cart: Scene, tmp_path: Path) -> None:
    """A stop at one side alone, which MJCF does not have, is a range whose other end is far away."""
    write_as(cart, tmp_path / "cart.xml", scene_report(cart))
    described = [describe_model(str(tmp_path / name), {}).robot for name in ("cart.yaml", "cart.xml")]
    numbers = [
        {each.name: (each.friction, each.limits) for body in robot.bodies for each in body.joints}
        for robot in described
    ]
    assert numbers[0] == numbers[1]
    assert numbers[0]["pivot"] == (0.3, (-0.3, math.inf))
