"""Springs, dampers and rotors on balls in files, in comparisons of models, and planted faults."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from ball_scenes import AXIS, SCENES, sphere, twisted_loop
from command_line import run
from mechanisms import ball_loop
from mjcf_models import model, reading, verified

import crosscheck
import mjcf
import newton_euler
from crosscheck.engines.registry import ENGINES
from crosscheck.library import load
from crosscheck.library.model_files import read_model
from crosscheck.library.scene_file import write_scene
from crosscheck.studies.faults import injection
from crosscheck.studies.faults.catalog import catalog
from crosscheck.studies.faults.find import FaultFree, find_fault
from crosscheck.studies.faults.injection import Injection
from crosscheck.support.errors import CrosscheckError
from mjcf.loops import body_acceleration
from newton_euler import BallArmature, BallSpring, JointSpring
from newton_euler.compiled.formulations import FORMULATIONS, formulate
from newton_euler.equations.relative import Relative
from newton_euler.model.euler_parameters import from_rotation_vector, rotation
from newton_euler.reading.excitation import random_states
from newton_euler.runs.assemble import initial_state
from urdf.benchmark_kernels import equations_of
from urdf.dynamics import PinocchioSystem
from urdf.errors import UrdfError

both = pytest.mark.parametrize("formulation", FORMULATIONS)

DEFAULTS = """
<default>
  <default class="soft"><joint armature="0.02" damping="0.3" stiffness="4" springref="0.2"/></default>
</default>"""

LOOP = f"""
<mujoco model="loop">{DEFAULTS}<option gravity="0 0 -9.81"/>
  <worldbody>
    <body name="crank"><joint name="a" axis="0.2 1 0.1" class="soft"/>
      <geom type="capsule" fromto="0 0 0 0.1 0.1 0.5" size="0.03"/>
      <body name="coupler" pos="0.1 0.1 0.5" quat="0.9 0.1 -0.2 0.3">
        <joint name="b" type="ball" class="soft"/>
        <geom type="box" size="0.1 0.04 0.3" pos="0.2 0.1 0"/><site name="c1" pos="0.5 0.1 0.2"/>
      </body></body>
    <body name="rocker" pos="1 0.2 0.1"><joint name="d" type="ball" class="soft"/>
      <geom type="box" size="0.05 0.1 0.3" pos="0 0 0.3"/><site name="c2" pos="-0.1 0.1 0.7"/></body>
  </worldbody>
  <equality><connect name="c" site1="c1" site2="c2"/></equality>
  <keyframe><key name="bent" qpos="0.1 0.98 0.1 0 0.17 0.98 0 0.17 0.1"/></keyframe>
</mujoco>"""
"""A loop of a hinge, two balls and a third that closes it, two of them with a class of soft joints."""

FLOATING = f"""
<mujoco model="floating">{DEFAULTS}<option gravity="0 0 -9.81"/>
  <worldbody>
    <body name="base" pos="0.1 0.2 1" quat="0.8 0.2 -0.4 0.4">
      <joint name="root" type="free" class="soft"/><geom type="box" size="0.2 0.1 0.05" pos="0.1 0 0.05"/>
      <body name="leg" pos="0.3 0 0" quat="0.9 0.1 0 0.3"><joint name="hip" type="ball" class="soft"/>
        <geom type="capsule" fromto="0 0 0 0.1 0 -0.4" size="0.03"/>
        <body name="foot" pos="0.1 0 -0.4"><joint name="ankle" type="ball" pos="0 0.02 0" class="soft"/>
          <joint name="sole" type="slide" axis="1 0.2 0" class="soft"/>
          <geom type="box" size="0.1 0.05 0.02" pos="0.05 0 -0.1"/></body></body></body>
  </worldbody>
  <keyframe><key name="thrown" qpos="0.3 -0.2 1.4 0.6 0.1 0.5 -0.3 0.8 0.3 -0.2 0.4 0.7 -0.1 0.5 0.4 0.1"
    qvel="1 -2 0.5 3 1 -2 0.5 2 -1 4 -3 1 0.6"/></keyframe>
</mujoco>"""
"""A free joint, a ball, and a ball with a slide after it, all soft, in motion away from where they rest."""


@pytest.mark.parametrize("key", ["bent", "qpos0"])
def test_a_file_with_soft_balls_in_a_loop(capsys, key: str, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    text = LOOP if key == "bent" else LOOP.replace("bent", "also")
    path = tmp_path / "model.xml"
    path.write_text(text)
    found = mjcf.read(path) if key == "bent" else mjcf.read(path, key="qpos0")
    assert verified(found)
    assert not [entry for entry in found.report.entries if entry.element in ("joint 'b'", "joint 'd'")
                and entry.fate != "exactly"]  # fmt: skip
    told = {entry.how for entry in found.report.of("exactly") if entry.element == "joint 'b'"}
    assert {"its armature 0.02", "its stiffness 4 and damping 0.3 as a spring of all its motions"} <= told
    springs = {force.joint: force for force in found.scene.forces}
    assert springs["a"].rest != 0.0
    # no such spring rests at its springref, which is of hinges and slides only, but in the pose of qpos0
    assert np.any(springs["b"].rest)
    for name in ("scene.yaml", "again.xml"):  # one after the other
        source = path if name == "scene.yaml" else tmp_path / "scene.yaml"
        options = ("--set", f"key={key}") if name == "scene.yaml" else ()
        status, out, _ = run(capsys, "convert", source, tmp_path / name, *options)
        assert (status, "left out: joint" in out) == (0, False)
    again = mjcf.read(tmp_path / "again.xml")
    assert verified(again)


@both
def test_soft_joints_in_motion_are_mujocos(formulation: str, tmp_path: Path) -> None:
    """A tree, which MuJoCo solves exactly, at a keyframe with velocities: 1e-11: condition 1e3."""
    found = reading(tmp_path, FLOATING)
    scene = found.scene
    assert [a.joint for a in scene.armatures if isinstance(a, BallArmature)] == ["root", "hip", "foot_joints"]
    stock = mujoco.MjModel.from_xml_string(FLOATING)
    data = mujoco.MjData(stock)
    mujoco.mj_resetDataKeyframe(stock, data, 0)
    stock.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    mujoco.mj_forward(stock, data)
    mujoco.mj_rnePostConstraint(stock, data)
    system = formulate(scene, formulation)
    wanted = system.evaluate(*system.coordinates(initial_state(scene)))
    for name in ("base", "leg", "foot"):
        k = scene.mechanism.body_index(name)
        linear, angular = body_acceleration(stock, data, stock.body(name).id)
        assert wanted.linear_acceleration[k] == pytest.approx(linear, rel=1e-11, abs=1e-11)
        assert wanted.angular_acceleration[k] == pytest.approx(angular, rel=1e-11, abs=1e-11)
    mujoco.mj_energyPos(stock, data)
    mujoco.mj_energyVel(stock, data)
    assert [wanted.potential_energy, wanted.kinetic_energy] == pytest.approx(data.energy, rel=1e-12)


def test_springs_that_yield_rest_where_the_key_says(tmp_path: Path) -> None:
    """A hinge, a ball and a tendon; what yields within a turn is told."""
    joint = '<joint name="{0}" {1} stiffness="2" springyield="{2}"/>'
    hinge, ball = joint.format("p", 'axis="0 1 0"', 0.5), joint.format("q", 'type="ball"', 3.0)
    inner = f'<body name="b" pos="0.3 0 0">{ball}<geom type="box" size="0.1 0.2 0.05" pos="0.1 0 0"/></body>'
    outer = f'<body name="a">{hinge}<geom type="box" size="0.1 0.2 0.05" pos="0.2 0 0"/>{inner}</body>'
    tendon = (
        '<tendon><fixed name="t" stiffness="3" springyield="0.2"><joint joint="p" coef="2"/></fixed></tendon>'
    )
    plastic = "0.3 0.8 0 0.6 0 0.25 0.25"
    key = f'<keyframe><key name="bent" qpos="0.1 1 0 0 0" plastic="{plastic}"/></keyframe>'
    found = reading(tmp_path, model(outer, tendon + key, '<compiler angle="radian"/>'))
    assert verified(found)
    yields = [e.element for e in found.report.of("left out") if e.topic == "yield"]
    assert sorted(yields) == ["joint 'p'", "joint 'q'", "tendon 't'"]
    first, second = found.scene.forces
    assert isinstance(first, JointSpring)
    assert isinstance(second, BallSpring)
    # the hinge's of 2 N m/rad rests 0.2 rad on, and the tendon's, of 3 twice over, 0.025 rad on
    assert (first.stiffness, first.rest) == pytest.approx((14.0, (2.0 * 0.2 + 12.0 * 0.025) / 14.0))
    turned = rotation(from_rotation_vector(np.array([0.0, 0.1, 0.0])))  # of the hinge
    assert second.rest == pytest.approx(turned @ [0.0, 2.0 * np.arctan2(0.6, 0.8), 0.0], abs=1e-12)


@pytest.mark.parametrize("name", [name for name in SCENES if "on the way back" not in name])
def test_there_and_back(name: str, tmp_path: Path) -> None:
    """Scene, MJCF or YAML and scene again, in a state of motion away from where springs rest."""
    scene = SCENES[name]
    (state,) = random_states(scene, 1)
    scene = replace(scene, initial_state=state)
    write_scene(scene, tmp_path / "scene.yaml")
    mjcf.write(scene, tmp_path / "model.xml")
    for back in (load(str(tmp_path / "scene.yaml")), mjcf.read(tmp_path / "model.xml").scene):
        found, wanted = (
            system.evaluate(*system.coordinates(initial_state(system.scene)))
            for system in (Relative(back), Relative(scene))
        )
        for k, body in enumerate(scene.mechanism.bodies):
            i = back.mechanism.body_index(body.name) if k else 0
            for array in ("linear_acceleration", "angular_acceleration"):
                x, y = getattr(found, array)[i], getattr(wanted, array)[k]
                # the start is closed again to 1e-14, times the stiffness and condition numbers of 1e4
                assert np.max(np.abs(x - y)) < 1e-9 * max(1.0, np.max(np.abs(getattr(wanted, array))))


def test_a_urdf_has_neither(capsys, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "model.xml"
    path.write_text(LOOP)
    status, out, _ = run(capsys, "convert", path, tmp_path / "model.urdf")
    assert status == 0
    assert "armature of the ball of joint 'b'" in out
    assert "joint 'b', joint 'd': its stiffness 4 and damping 0.3 as a spring of all its motions" in out
    forces = read_model(str(tmp_path / "model.urdf"), {})[0].forces
    assert [(force.joint, force.stiffness, force.damping) for force in forces] == [("a", 0.0, 0.3)]  # a hinge


def test_lcaba_has_no_place_for_springs_of_balls() -> None:
    """1e-12: the same equations in another order."""
    scene = twisted_loop()
    equations = equations_of(scene, 10.0, None)
    wanted = equations.system.acceleration(*equations.system.coordinates(initial_state(scene)))
    rates = equations.rates(0.0, equations.start)
    assert equations.system.map.v_from_pinocchio(rates[equations.nq :]) == pytest.approx(wanted, rel=1e-12)
    with pytest.raises(
        UrdfError, match=r"^spring of the ball of joint 'at_c': Pinocchio's lcaba supports only"
    ):
        equations_of(scene, 10.0, (1e-6, 10))
    rotor = replace(scene, forces=())
    system = PinocchioSystem(rotor)
    exact = system.map.v_to_pinocchio(system.acceleration(*system.coordinates(initial_state(rotor))))
    quick = equations_of(rotor, 0.0, (1e-4, 30)).acceleration()
    assert quick == pytest.approx(exact, rel=1e-9, abs=1e-9)  # what the regularization leaves


def test_a_benchmark_solves_the_equations_at_every_call(monkeypatch: pytest.MonkeyPatch) -> None:
    """Although the system keeps its latest solution, which equations by elimination need again."""
    calls = []
    solve = PinocchioSystem._solve_by_elimination
    monkeypatch.setattr(
        PinocchioSystem, "_solve_by_elimination", lambda *args: calls.append(args) or solve(*args)
    )
    equations = equations_of(load("tracker_on_boat"), 0.0, None)
    before = len(calls)
    wanted = equations.acceleration()
    assert equations.acceleration() == pytest.approx(wanted, rel=1e-6)
    assert len(calls) - before == 2


def test_numbers_of_a_spring_vary_in_a_batch() -> None:
    scene = replace(sphere(BallSpring("ball", 1.0)), duration=1.0)
    values = {
        "ball.ball.stiffness": [4.0, 2.0],
        "ball.ball.damping": [0.1, 0.0],
        "ball.ball.rest": [[0.0, 0.0, 0.0], [0.3, -0.2, 0.5]],
    }
    for k, found in enumerate(newton_euler.simulate_batch(scene, parameters=values)):
        spring = BallSpring("ball", *(column[k] for column in values.values()))
        wanted = newton_euler.simulate(replace(scene, forces=(spring,)))
        for name in ("angular_velocity", "work", "potential_energy"):
            assert getattr(found, name) == pytest.approx(getattr(wanted, name), abs=1e-9), name


@pytest.mark.parametrize(
    ("change", "quantities"),
    [
        (injection.entry_values("forces", 0, stiffness=3.001), ["stiffness"]),
        (injection.entry_values("forces", 0, damping=0.2001), ["damping"]),
        (lambda s: replace(s, forces=()), ["stiffness", "damping"]),
        (injection.entry_values("armatures", 0, inertia=0.3001), ["armature"]),
        (lambda s: replace(s, armatures=()), ["armature"]),
    ],
)
def test_models_are_told_apart_by_the_joint_of_the_ball(change: Injection, quantities: list[str]) -> None:
    spring, rotor = BallSpring("at_c", 3.0, 0.2, 0.5 * AXIS), BallArmature("at_c", 0.3)
    scene = replace(ball_loop(), forces=(spring,), armatures=(rotor,))
    found = crosscheck.diff(scene, change(scene)).differences
    assert [(row.element, row.quantity) for row in found] == [("at_c", quantity) for quantity in quantities]


@pytest.mark.parametrize("size", [1e-1, 1e-4])
def test_faults_of_balls_are_found_and_blamed(size: float) -> None:
    scene = twisted_loop()
    own = FaultFree(scene)
    of_balls = [fault for fault in catalog(scene, (size,)) if "its ball" in fault.detail]
    assert [fault.kind for fault in of_balls] == ["gain", "damping", "armature"]
    for fault in of_balls:
        for name in ("mujoco", "pinocchio"):
            found = find_fault(fault, ENGINES[name], own)
            assert found.located, (fault.name, name)
            assert found.located_by_motion, (fault.name, name)


def test_a_rotor_of_a_scene_file_is_on_a_ball_or_a_coordinate(tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    write_scene(replace(sphere(), armatures=(BallArmature("ball", 0.5),)), path)
    assert load(str(path)).armatures == (BallArmature("ball", 0.5),)
    path.write_text(path.read_text().replace("ball: true", "ball: true\n  coordinate: 0"))
    with pytest.raises(CrosscheckError, match="armature of joint 'ball': has a ball and a coordinate"):
        load(str(path))
