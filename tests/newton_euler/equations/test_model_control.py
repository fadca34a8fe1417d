"""Laws that know the mechanism: computed torque follows its reference, gravity compensation holds."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from mechanisms import mass_on_rail

import mjcf
import newton_euler
import urdf
from crosscheck.engines.energy import energy_balance
from crosscheck.library import load
from mjcf.rigid import RigidMuJoCo
from mjcf.soft import SoftMuJoCo
from mjcf.write import to_xml
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.model_control import model_control
from newton_euler.equations.relative import Relative
from newton_euler.equations.servos import servos_of
from newton_euler.errors import MechanismError, UnknownNameError
from newton_euler.model.control import PD, ComputedTorque
from newton_euler.model.digital_control import Digital
from newton_euler.model.joint_kinds import Revolute, Translational
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.motions import Sum
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Polynomial, Sine
from newton_euler.model.splines import Steps
from newton_euler.model.wind import WindLoad
from newton_euler.runs.assemble import initial_state
from urdf.dynamics import PinocchioSystem

STIFFNESS, DAMPING = 400.0, 40.0
"""1/s^2 and 1/s of both sliders: critical, errors vanish with exp(-20 t)."""

REFERENCES = {
    "slide_12": Sum((Polynomial((0.01, 0.002)), Sine(0.008, 2.0, -0.5 * np.pi))),
    "slide_13": Sum((Polynomial((0.012,)), Sine(0.008, 3.0, 0.3))),
}
"""m, over a good part of what both sliders reach."""

SYSTEMS = [Relative, Cartesian, PinocchioSystem, RigidMuJoCo, SoftMuJoCo]


def on_reference(scene: Scene) -> Scene:
    starts = {name: (float(r.value(0.0)), float(r.rate(0.0))) for name, r in REFERENCES.items()}
    return newton_euler.start(scene, **starts)


def tracker(duration: float = 0.25, **settings) -> Scene:
    """The tracker under gravity, computed torque on both sliders, from the reference."""
    settings = {"stiffness": STIFFNESS, "damping": DAMPING} | settings
    laws = tuple(ComputedTorque(name, target=r, **settings) for name, r in REFERENCES.items())
    return on_reference(replace(load("tracker_gravity"), control=laws, duration=duration))


def errors(run) -> np.ndarray:
    """(n, 2) m."""
    wanted = [[float(r.value(t)) for r in REFERENCES.values()] for t in run.time]
    return np.hstack([run.joint(name).coordinates for name in REFERENCES]) - wanted


@pytest.mark.slow
def test_computed_torque_follows_its_reference():
    """Newton_euler and Pinocchio: to round-off of 0.1 m over some 100 steps, far below rtol 1e-10."""
    scene = tracker()
    runs = [newton_euler.simulate(scene), urdf.simulate(scene)]
    for run in runs:
        assert np.max(np.abs(errors(run))) < 1e-12
        assert np.max(np.abs(run.actuator_force - runs[0].actuator_force)) < 1e-10  # N, of 6
        balance = energy_balance(scene, run)
        assert np.abs(balance.residual).max() / balance.scale < 1e-8


@pytest.mark.slow
def test_mujocos_loops_are_soft():
    """At 1 ms its closures are off by some 1e-8 m, which the model of closed loops does not know."""
    scene = tracker()
    run = mjcf.simulate(scene)
    assert np.max(np.abs(errors(run))) < 1e-7
    balance = energy_balance(scene, run)
    # what soft loops take up as the weight comes on; a PD law leaves 6e-5 on the same way
    assert np.abs(balance.residual).max() / balance.scale < 1e-5


def test_errors_vanish_as_the_gains_say():
    """e'' + 40 e' + 400 e = 0 from rest: e = e_0 (1 + 20 t) exp(-20 t), whatever the mechanism."""
    scene = tracker()
    starts = {"slide_12": (0.005, float(REFERENCES["slide_12"].rate(0.0)))}
    starts["slide_13"] = (0.02, float(REFERENCES["slide_13"].rate(0.0)))
    run = newton_euler.simulate(newton_euler.start(scene, **starts))
    decay = (1.0 + 20.0 * run.time) * np.exp(-20.0 * run.time)
    found = errors(run)
    assert np.min(np.abs(found[0])) > 1e-3
    assert np.max(np.abs(found - decay[:, None] * found[0])) < 1e-10  # m, at rtol 1e-10


def test_linear_models_know_the_gains():
    """Eigenvalues of e'' + 40 e' + 4 e = 0, of both sliders, whatever the mechanism and where it is."""
    scene = tracker(stiffness=4.0)
    eigenvalues = np.sort(np.linalg.eigvals(newton_euler.linearize(scene).A).real)
    roots = np.sort(np.roots([1.0, DAMPING, 4.0]))
    assert eigenvalues == pytest.approx(np.repeat(roots, 2), rel=1e-9)  # of matrices of some 1e2


@pytest.mark.slow
def test_a_sampled_law_agrees_in_all_engines():
    """1 kHz: a force that is half a period late, 0.5 ms, leaves some 1e-6 m."""
    scene = tracker()
    scene = replace(scene, control=tuple(Digital(law, 1e-3) for law in scene.control))
    runs = [newton_euler.simulate(scene), urdf.simulate(scene), mjcf.simulate(scene)]
    assert 1e-8 < np.max(np.abs(errors(runs[0]))) < 1e-5
    assert np.max(np.abs(runs[1].position - runs[0].position)) < 1e-9
    assert np.max(np.abs(runs[2].position - runs[0].position)) < 1e-7  # soft loops at 1 ms


@pytest.mark.slow
def test_a_wrong_model_leaves_errors_in_all_engines():
    scene = tracker(model={"panel_7.mass": 0.5, "gravity": [0.0, 0.0, -9.0]})
    runs = [newton_euler.simulate(scene), urdf.simulate(scene), mjcf.simulate(scene)]
    assert np.max(np.abs(errors(runs[0]))) > 1e-3
    assert np.max(np.abs(runs[1].position - runs[0].position)) < 1e-9
    assert np.max(np.abs(runs[2].position - runs[0].position)) < 1e-6  # soft loops at 1 ms


@pytest.mark.slow
def test_the_controllers_model_has_no_wind():
    sides = {"first_side": [1.0, 0.0, 0.0], "second_side": [0.0, 1.0, 0.0]}
    laws = (
        ComputedTorque("slide_12", STIFFNESS, DAMPING, 0.01),
        PD("slide_13", 50.0, 20.0, 0.01, gravity_compensation=True),
    )
    calm = replace(load("tracker_gravity"), control=laws, duration=0.01, output_period=0.01)
    center = calm.mechanism.bodies[calm.mechanism.body_index("panel_7")].pose.position
    wind = WindLoad("wind", "panel_7", center, **sides, direction=[1.0, 0.0, 1.0], speed=5.0)
    windy = replace(calm, forces=(*calm.forces, wind))
    for simulate in (newton_euler.simulate, urdf.simulate, mjcf.simulate):
        found, expected = (simulate(scene) for scene in (windy, calm))
        # round-off of the start, with the same pose
        assert found.actuator_force[0] == pytest.approx(expected.actuator_force[0], rel=1e-9)
        assert np.max(np.abs(found.position[-1] - expected.position[-1])) > 1e-7


def test_gravity_compensation_holds():
    """At rest at the targets nothing moves; without compensation the panel sinks."""
    laws = tuple(PD(name, 50.0, 20.0, 0.01, gravity_compensation=True) for name in REFERENCES)
    scene = replace(load("tracker_gravity"), control=laws, duration=0.2)
    scene = newton_euler.start(scene, slide_12=(0.01, 0.0), slide_13=(0.01, 0.0))
    held = newton_euler.statics(scene).actuator_force
    for simulate in (newton_euler.simulate, urdf.simulate):
        run = simulate(scene)
        assert np.max(np.abs(run.position - run.position[0])) < 1e-12
        assert run.actuator_force == pytest.approx(np.tile(held, (len(run.time), 1)), rel=1e-9)
    # the softness of constraints lets loops open by some 1e-7 m under the weight
    run = mjcf.simulate(scene)
    assert np.max(np.abs(run.position - run.position[0])) < 1e-5


@pytest.mark.parametrize("build", SYSTEMS)
def test_single_states_have_the_same_forces(build):
    """While it moves, off the targets, with a law of each kind."""
    laws = (
        PD("slide_12", 50.0, 20.0, 0.01, feedforward=0.5, gravity_compensation=True),
        ComputedTorque("slide_13", STIFFNESS, DAMPING, REFERENCES["slide_13"], feedforward=0.1),
    )
    scene = on_reference(replace(load("tracker_gravity"), control=laws))
    system, reference = build(scene), Relative(scene)
    expected = reference.evaluate(*reference.coordinates(initial_state(scene)))
    found = system.evaluate(*system.coordinates(initial_state(scene)))
    # N, of some 6, by masses of 0.05 to 1 kg
    assert found.actuator_force == pytest.approx(expected.actuator_force, abs=1e-11)


def test_each_engine_has_inverse_dynamics_of_its_own(monkeypatch):
    """A mistake in newton_euler's shows there alone."""
    scene, own = tracker(), Relative.servo_forces

    def forces(build):
        system = build(scene)
        return system.evaluate(*system.coordinates(initial_state(scene))).actuator_force

    expected = forces(Relative)
    monkeypatch.setattr(Relative, "servo_forces", lambda *given: (0.8 * own(*given)[0], own(*given)[1]))
    assert forces(Relative) == pytest.approx(0.8 * expected)
    for build in (PinocchioSystem, RigidMuJoCo, SoftMuJoCo):
        assert forces(build) == pytest.approx(expected, abs=1e-11)  # N, of some 6


def test_laws_know_the_usual_sizes_of_pivots():
    """Those of inverse dynamics by itself, against which a singular configuration is told."""
    scene = tracker()
    keys = tuple(law.key for law in scene.control)
    assert model_control(Relative(scene)).torque.scales == servos_of(scene, keys, keys).scales


def pendulum_on_cart(law) -> Scene:
    """A free pendulum of 0.5 kg on a driven cart of 1 kg, under gravity."""
    cart = Body("cart", 1.0, [0.0, 0.0, 0.0], 0.01 * np.eye(3))
    bob = Body("bob", 0.5, [0.0, 0.0, -0.4], np.diag([0.01, 0.01, 1e-4]))
    rail = Translational("rail", "ground", "cart", [0.0, 0.0, 0.0], axis=[1.0, 0.0, 0.0], actuated=True)
    hinge = Revolute("swing", "cart", "bob", [0.0, 0.0, 0.0], axis=[0.0, 1.0, 0.0])
    mechanism = Mechanism([Body.ground(), cart, bob], [rail, hinge])
    scene = Scene("cart", mechanism, 0.5, 0.01, (0.0, 0.0, -9.81), control=(law,))
    return newton_euler.start(scene, swing=(0.8, 0.0))


def test_freedoms_without_actuators_move_freely():
    """The cart follows its reference with a pendulum on it; poses come from the engine's state."""
    scene = pendulum_on_cart(ComputedTorque("rail", 100.0, 20.0, Sine(0.2, 5.0)))
    scene = newton_euler.start(scene, rail=(0.0, 1.0), swing=(0.8, 0.0))
    runs = [newton_euler.simulate(scene), urdf.simulate(scene), mjcf.simulate(scene)]
    runs.append(newton_euler.simulate(scene, "cartesian"))
    for run in runs:
        assert np.max(np.abs(run.position[:, 1, 0] - 0.2 * np.sin(5.0 * run.time))) < 1e-9  # m, at rtol 1e-10
        assert np.max(np.abs(run.position - runs[0].position)) < 1e-8


@pytest.mark.parametrize("period", [None, 0.005])
def test_angles_beyond_a_revolution(period):
    """A pendulum is led round twice; encoders count on, poses do not."""
    law = ComputedTorque("hinge", 100.0, 20.0, Polynomial((0.3, 12.0)))
    rod = Body("rod", 1.0, [0.0, 0.0, -0.5], np.diag([0.05, 0.05, 1e-3]))
    hinge = Revolute("hinge", "ground", "rod", [0.0, 0.0, 0.0], axis=[0.0, 1.0, 0.0], actuated=True)
    control = (law,) if period is None else (Digital(law, period, resolution=1e-3),)
    scene = Scene(
        "led", Mechanism([Body.ground(), rod], [hinge]), 1.0, 0.01, (0.0, 0.0, -9.81), control=control
    )
    scene = newton_euler.start(scene, hinge=(0.3, 12.0))
    runs = [newton_euler.simulate(scene), urdf.simulate(scene), mjcf.simulate(scene)]
    for run in runs:
        assert run.joint("hinge").coordinates[-1, 0] == pytest.approx(12.3, abs=0.01)
        # N m: of 5, at rtol 1e-10 and RK4 of 1 ms
        assert np.max(np.abs(run.actuator_force - runs[0].actuator_force)) < 1e-6


def test_an_mjcf_has_the_forces_of_the_start():
    """In its key; what changes them is told of."""
    laws = (
        PD("slide_12", 50.0, 20.0, 0.01, gravity_compensation=True),
        ComputedTorque("slide_13", STIFFNESS, DAMPING, REFERENCES["slide_13"]),
    )
    scene = on_reference(replace(load("tracker_gravity"), control=laws))
    model = mujoco.MjModel.from_xml_string(to_xml(scene))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    system = Relative(scene)
    expected = system.evaluate(*system.coordinates(initial_state(scene))).actuator_force
    assert data.actuator_force == pytest.approx(expected, abs=1e-10)  # N, of some 6


def test_encoders_have_to_tell_the_pose():
    scene = pendulum_on_cart(Digital(ComputedTorque("rail", 100.0, 20.0, 0.0), 0.01))
    with pytest.raises(MechanismError, match="coordinates of control laws do not determine the pose"):
        newton_euler.simulate(scene)


@pytest.mark.parametrize(
    ("laws", "error", "words"),
    [
        ([{"model": {"panel_8.mass": 1.0}}, {"model": {"panel_8.mass": 1.0}}], UnknownNameError, "panel_8"),
        ([{"model": {"panel_7.mass": -1.0}}, {"model": {"panel_7.mass": -1.0}}], MechanismError, "-1"),
        ([{"model": {"panel_7.mass": 1.0}}, {}], MechanismError, "one model of the mechanism for all laws"),
        (
            [{"model": {"wind.air_density": 1.0}}] * 2,
            MechanismError,
            "has 'wind.air_density' of",
        ),
        (
            [{"model": {"slide_12.damping": 1.0}}] * 2,
            MechanismError,
            "has 'slide_12.damping' of",
        ),
    ],
)
def test_models_that_cannot_be_are_refused(laws, error, words):
    control = tuple(
        ComputedTorque(name, STIFFNESS, DAMPING, 0.0, **law)
        for name, law in zip(REFERENCES, laws, strict=True)
    )
    with pytest.raises(error, match=words):
        newton_euler.simulate(replace(load("tracker_wind"), control=control))


def test_what_is_no_law_is_refused():
    with pytest.raises(MechanismError, match="model is 3"):
        ComputedTorque("rail", 1.0, 1.0, 0.0, model=3)
    with pytest.raises(MechanismError, match="gravity_compensation is 1"):
        PD("rail", 1.0, 1.0, 0.0, gravity_compensation=1)


def test_a_mass_on_a_rail_by_hand():
    """2 kg: m (r'' - d (x' - r') - k (x - r)), no gravity along the rail but what the scene has."""
    law = ComputedTorque("rail", 9.0, 6.0, Polynomial((0.1, 0.2, 0.5)))
    scene = mass_on_rail(duration=0.1, control=(law,))
    weight = -2.0 * scene.gravity[2]
    system = Relative(scene)
    force = system.evaluate(*system.coordinates(initial_state(scene))).actuator_force[0]
    assert force == pytest.approx(2.0 * (1.0 + 6.0 * 0.2 + 9.0 * 0.1) + weight, rel=1e-14)


def test_a_target_that_jumps_at_rest_has_its_force_at_once():
    """States and times are the same just before the jump and after it; Pinocchio's forces are not."""
    law = ComputedTorque("rail", 100.0, 20.0, Steps((0.0, 0.5), (0.0, 1.0)))
    scene = mass_on_rail(duration=0.6, control=(law,), gravity=(0.0, 0.0, 0.0))
    found, wanted = (engine.simulate(scene, integrator="RK4", step=0.01) for engine in (urdf, newton_euler))
    assert np.max(np.abs(found.position - wanted.position)) < 1e-14  # round-off of 0.3 m
