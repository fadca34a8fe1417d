"""MuJoCo and Pinocchio against this package: every joint, coupling, prescribed motion and force."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest
import yaml
from elements import ELEMENTS, FORCES, JOINTS, MOTIONS, forced, gear_train, moved, rod_loop, screw_press
from mechanisms import pendulum

import mjcf
import newton_euler
import urdf
from mjcf import benchmark_kernels as mjcf_kernels
from mjcf.errors import MjcfError
from mjcf.rigid import RigidMuJoCo
from mjcf.soft import SoftMuJoCo
from newton_euler.equations.system import System
from newton_euler.errors import OptionError
from newton_euler.model.euler_parameters import angle_between
from newton_euler.model.forces import Wrench
from newton_euler.model.motions import PrescribedMotion
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Polynomial
from newton_euler.model.trajectory import Trajectory
from newton_euler.runs.assemble import initial_state
from urdf import benchmark_kernels as urdf_kernels
from urdf.dynamics import PinocchioSystem
from urdf.errors import UrdfError

ENGINES = (RigidMuJoCo, PinocchioSystem)


@pytest.mark.parametrize(
    "function",
    [
        newton_euler.simulate,
        newton_euler.compile_scene,
        newton_euler.simulate_batch,
        newton_euler.initial_state,
        lambda scene: newton_euler.assemble(scene, None),
        mjcf.simulate,
        mjcf.to_xml,
        urdf.simulate,
        urdf.to_urdf,
        urdf.to_loops,
    ],
)
@pytest.mark.parametrize("scene", [None, [], "pendulum"])
def test_what_is_no_scene_is_refused(function, scene) -> None:
    with pytest.raises(OptionError, match=r"scene is .*; needed: a Scene$"):
        function(scene)


@cache
def run(name: str) -> Trajectory:
    return newton_euler.simulate(ELEMENTS[name])


def error(found: Trajectory, wanted: Trajectory) -> float:
    """m or rad, over all bodies and times."""
    return max(
        float(np.max(np.abs(found.position - wanted.position))),
        float(np.max(angle_between(found.quaternion, wanted.quaternion))),
    )


WIND = "wind, cut at a ball"
RUBBED = ["friction and stops", "friction and stops, cut at a ball"]

RUNS = [*JOINTS, *MOTIONS, "forces, ball_loop", "spring without length", "control and forces", WIND, *RUBBED]


@pytest.mark.parametrize("name", RUNS)
def test_runs_of_pinocchio(name: str) -> None:
    """Both at rtol 1e-12: errors of 1e-12 of angles of 1 rad, larger by what motions magnify."""
    tight = {"rtol": 1e-12, "atol": 1e-14}
    found, wanted = (simulate(ELEMENTS[name], **tight) for simulate in (urdf.simulate, newton_euler.simulate))
    assert error(found, wanted) < 1e-8
    assert_work(found, wanted, 1e-8)


@pytest.mark.parametrize("name", RUNS)
def test_runs_of_mujoco(name: str) -> None:
    """Loops, couplings and motions are springs of two steps: 1e-4 rad at most at 1 ms here, order 2."""
    coarse, fine = (mjcf.simulate(ELEMENTS[name], timestep=h) for h in (1e-3, 5e-4))
    wanted = run(name)
    assert error(fine, wanted) < 1e-4
    # trees without any of them are exact to order 4, down to the reference's own error; derivatives that jump
    # somewhere within a step make the order irregular
    ratio = 1.5 if name in RUBBED else 3.0
    assert error(fine, wanted) < max(error(coarse, wanted) / ratio, 1e-9)
    # forces of soft constraints stay 0.2 % off, and with them the work of motions
    assert_work(fine, wanted, 4e-3)


def assert_work(found: Trajectory, wanted: Trajectory, tolerance: float) -> None:
    """Relative to the energy that there is."""
    if wanted.work is None:
        assert found.work is None
        return
    assert found.work is not None
    assert wanted.kinetic_energy is not None
    scale = np.max(np.abs(wanted.work)) + np.max(wanted.kinetic_energy)
    assert np.max(np.abs(found.work - wanted.work)) < tolerance * scale


def test_work_only_where_something_does_work() -> None:
    """And where energy is asked for."""
    assert mjcf.simulate(replace(pendulum(), duration=0.1)).work is None
    scene = replace(forced(pendulum()), duration=0.1)
    assert mjcf.simulate(scene).work is not None
    silent = replace(scene, outputs=frozenset({"velocities"}))
    assert mjcf.simulate(silent).work is None
    assert urdf.simulate(silent).work is None


@pytest.mark.parametrize("engine", ENGINES, ids=lambda engine: engine.name)
def test_angles_of_several_turns(engine: type[System]) -> None:
    """Poses do not tell turns; gears and motions do."""
    scene = moved(gear_train(), PrescribedMotion("axle", Polynomial((7.0, 1.0))))
    system = engine(scene)  # type: ignore[call-arg]
    q, _ = system.coordinates(initial_state(scene))
    assert np.max(np.abs(system.phi(q))) < 1e-9  # as closed as a state has to be
    assert np.max(np.abs(q)) == pytest.approx(2.5 * 7.0, abs=1e-9)


# What the files hold


def test_stock_mujoco_runs_a_written_file() -> None:
    """Forces, gears and rods are in the file; the reference is good to 1e-9, the springs of rods to 1e-5."""
    scene = forced(rod_loop())
    model = mujoco.MjModel.from_xml_string(mjcf.to_xml(scene))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, round(scene.duration / model.opt.timestep))
    wanted = newton_euler.simulate(scene)
    for body, position in zip(scene.mechanism.bodies[1:], wanted.position[-1, 1:], strict=True):
        # softness of 1 ms steps, measured 7e-4
        assert np.max(np.abs(data.body(body.name).xpos - position)) < 2e-3


def test_elements_of_the_mjcf() -> None:
    root = ET.fromstring(mjcf.to_xml(gear_train()))
    found = {e.get("name"): (e.get("joint1"), e.get("joint2"), e.get("polycoef")) for e in root.iter("joint")}
    assert found["gear mesh"] == ("shaft", "axle", "0 -2.5 0 0 0")
    root = ET.fromstring(mjcf.to_xml(forced(rod_loop())))
    names = [tendon.get("name") for tendon in root.iter("spatial")]
    assert names == ["spring spring_0", "spring spring_1", "spring spring_2", "rod coupler", "rod stay"]
    assert [e.get("tendon1") for e in root.iter("tendon") if e.get("tendon1")] == ["rod coupler", "rod stay"]


def test_a_motion_is_held_where_it_begins_in_the_file() -> None:
    scene = moved(pendulum(), PrescribedMotion("pivot", Polynomial((0.3, 2.0))))
    model = mujoco.MjModel.from_xml_string(mjcf.to_xml(scene))
    assert model.eq_data[0, 0] == 0.3
    assert model.key_qpos[0, 0] == pytest.approx(0.3, abs=1e-9)  # as closed as a state has to be


def test_wind_is_that_of_the_start_in_the_file() -> None:
    scene = FORCES[WIND]
    model = mujoco.MjModel.from_xml_string(mjcf.to_xml(scene))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    rigid = RigidMuJoCo(scene)
    rigid.mass_and_force(*rigid.coordinates(initial_state(scene)))
    assert data.actuator_force == pytest.approx(rigid.data.actuator_force, rel=1e-9)
    assert np.min(np.abs(data.actuator_force)) > 0.01


def test_callbacks_of_others_are_put_back() -> None:
    def other(model: object, data: object) -> None: ...

    soft = SoftMuJoCo(moved(pendulum(), PrescribedMotion("pivot", Polynomial((0.0, 2.0)))))
    mujoco.set_mjcb_control(other)
    try:
        with soft.following():
            assert mujoco.get_mjcb_control() is not other
        assert mujoco.get_mjcb_control() is other
    finally:
        mujoco.set_mjcb_control(None)


def test_soft_motions_ask_for_their_acceleration() -> None:
    """On its motion a row asks for f'' exactly, and softness takes 1e-4 of what it lacks: of 9.81 / 1 m."""
    scene = moved(pendulum(), PrescribedMotion("pivot", Polynomial((0.0, 2.0, 3.0))))
    soft = SoftMuJoCo(scene)
    found = soft.evaluate(*soft.coordinates(initial_state(scene)))
    assert found.angular_acceleration[1, 1] == pytest.approx(6.0, abs=3e-3)


def test_the_loop_file_holds_rods_and_couplings() -> None:
    document = yaml.safe_load(urdf.to_loops(rod_loop()))
    assert document["type"] == ["rod", "rod"]
    assert "coupled" not in document
    assert yaml.safe_load(urdf.to_loops(screw_press()))["coupled"] == [
        {"spindle_1": 1.0, "spindle_2": -0.1},
        {"lid_1": 1.0, "lid_2": 0.05},
    ]


# What the benchmark kernels refuse


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("motion of gears", "motion of joint 'axle': MuJoCo has no time-dependent equality"),
        (WIND, "wind load 'wind': MuJoCo has no such actuator, and benchmark kernels call no Python"),
    ],
)
def test_tight_mujoco_refuses_what_needs_python(name: str, message: str) -> None:
    with pytest.raises(MjcfError, match=message):
        mjcf_kernels.compiled(ELEMENTS[name])


@pytest.mark.parametrize("name", ["rods", "gears", "screw", "control and forces"])
def test_tight_mujoco_is_the_same_model(name: str) -> None:
    scene = ELEMENTS[name]
    kernel, soft = mjcf_kernels.compiled(scene), SoftMuJoCo(scene)
    found, wanted = (s.evaluate(*s.coordinates(initial_state(scene))) for s in (kernel, soft))
    # the solver's tolerance, with a warm start or without
    assert found.linear_acceleration == pytest.approx(wanted.linear_acceleration, rel=1e-9, abs=1e-9)


def pushed() -> Scene:
    push = Wrench("push", "rod", np.zeros(3), force=np.ones(3))
    return replace(pendulum(), forces=(push,))


@pytest.mark.parametrize(
    ("scene", "element"),
    [
        (JOINTS["rods"], "joint 'coupler'"),
        (JOINTS["screw"], "joint 'spindle'"),
        (JOINTS["gears"], "gear 'mesh'"),
        (MOTIONS["motion, cut"], "motion of joint 'at_c'"),
        (pushed(), "wrench 'push'"),
        (FORCES["spring without length"], "point spring 'elastic'"),
        (FORCES[WIND], "wind load 'wind'"),
    ],
    ids=["rod", "screw", "gear", "motion", "wrench", "point spring", "wind"],
)
def test_tight_pinocchio_has_what_its_recursion_has_no_place_for(scene: Scene, element: str) -> None:
    """1e-12: the same equations in another order; that they are right is asserted of the system above."""
    equations = urdf_kernels.equations_of(scene, 10.0, None)
    system = equations.system
    wanted = system.acceleration(*system.coordinates(initial_state(scene)))
    rates = equations.rates(0.0, equations.start)
    assert system.map.v_from_pinocchio(rates[equations.nq :]) == pytest.approx(wanted, rel=1e-12)
    assert np.abs(wanted).max() > 1e-3
    with pytest.raises(UrdfError, match=f"^{element}: Pinocchio's lcaba supports only"):
        urdf_kernels.equations_of(scene, 10.0, (1e-6, 10))


def test_tight_pinocchio_has_springs_of_joints() -> None:
    """1e-12: the same equations in other units."""
    scene = forced(pendulum())
    springs = replace(scene, forces=scene.forces[:1])
    equations = urdf_kernels.equations_of(springs, 10.0, None)
    wanted = equations.system.acceleration(*equations.system.coordinates(initial_state(springs)))
    assert equations.acceleration() == pytest.approx(wanted, rel=1e-12)
    assert np.abs(wanted).max() > 1.0
