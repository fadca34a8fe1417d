"""Forces of actuators and static loads against closed forms, forward dynamics, Pinocchio and rigid MuJoCo."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from finite_difference import derivative
from mechanisms import bar

from crosscheck.library import load
from mjcf.rigid import RigidMuJoCo
from newton_euler import start
from newton_euler.analysis.kinematics.poses import solve_poses
from newton_euler.analysis.loads.inverse_dynamics import inverse_dynamics
from newton_euler.analysis.loads.statics import statics
from newton_euler.codegen.expression import Graph
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.parameters import measuring
from newton_euler.equations.relative import Relative
from newton_euler.equations.servos import servos_of
from newton_euler.equations.system import at_time
from newton_euler.errors import MechanismError, NewtonEulerError
from newton_euler.model.control import PD
from newton_euler.model.euler_parameters import rotation
from newton_euler.model.forces import JointSpring, PointSpring, Wrench
from newton_euler.model.joint_kinds import Prismatic, Revolute
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.motions import PrescribedMotion
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Polynomial
from newton_euler.model.splines import Spline
from newton_euler.model.state import State
from newton_euler.reading.excitation import random_states
from newton_euler.runs.assemble import initial_state
from newton_euler.runs.simulate import simulate
from urdf.dynamics import PinocchioSystem

G = 9.81
X, Y, Z = np.eye(3)

LEGS = tuple((f"leg_{k}", 0) for k in range(1, 7))

ACTUATED = {
    "tracker_gravity": ("slide_12", "slide_13"),
    "stewart": LEGS,
    "four_bar": ("pivot_0",),
    "slider_crank": ("pivot",),
}
"""Coordinates that determine the motion, by scene."""


def cart_pole() -> Scene:
    """A cart of 2 kg on a rail along x with a pole of 1 kg and 1 m, 0.3 rad from hanging down."""
    tip = np.array([np.sin(0.3), 0.0, -np.cos(0.3)])
    cart = Body("cart", 2.0, np.zeros(3), np.eye(3))
    mechanism = Mechanism(
        [Body.ground(), cart, bar("pole", [0.0, 0.0, 0.0], tip.tolist())],
        [
            Prismatic("rail", "ground", "cart", np.zeros(3), axis=X),
            Revolute("pin", "cart", "pole", np.zeros(3), axis=-Y),
        ],
    )
    return Scene("cart_pole", mechanism, 1.0, 0.1, gravity=-G * Z)


def controlled(scene: Scene, joints: tuple[str, ...], forces: np.ndarray) -> Scene:
    """The scene with constant forces on these joints as its control."""
    keys = [scene.mechanism.coordinate(name) for name in joints]
    driven = {joint for joint, _ in keys}
    actuated = [
        replace(joint, actuated=True) if joint.name in driven else joint for joint in scene.mechanism.joints
    ]
    mechanism = Mechanism(scene.mechanism.bodies, actuated, scene.mechanism.couplings)
    laws = tuple(
        PD(joint, 0.0, 0.0, 0.0, k, feedforward=u) for (joint, k), u in zip(keys, forces, strict=True)
    )
    return replace(scene, mechanism=mechanism, control=laws)


def accelerations(scene: Scene, state: State, joints: tuple[str, ...]) -> np.ndarray:
    """Forward dynamics of joint coordinates, by the dense solver."""
    keys, known = [scene.mechanism.coordinate(name) for name in joints], Relative(scene).places
    idle = tuple(JointSpring(*key[:1], 0.0) for key in keys if key not in known)  # to measure them
    system = Relative(replace(scene, forces=(*scene.forces, *idle)))
    q, v = system.coordinates(state)
    vdot, measured = system.acceleration(q, v), system.measured(q, v)
    rows = [measured[key] for key in keys]
    return np.array([sum(vdot[k] * x for k, x in row.jacobian.items()) - row.gamma for row in rows])


@pytest.mark.parametrize("wanted", [0.0, 3.0])
def test_pendulum_and_cart_pole_are_the_closed_forms(wanted):
    scene = start(cart_pole(), pin=(0.2, 1.5))
    angle, rate, mass, length = 0.5, 1.5, 1.0, 0.5
    inertia = scene.mechanism.bodies[2].inertia
    a = rotation(scene.mechanism.bodies[2].quaternion)
    about = (a @ inertia @ a.T)[1, 1] + mass * length**2

    # both driven: the pin gets theta'' = 1, the rail x'' = wanted
    found = inverse_dynamics(scene, initial_state(scene), {"pin": 1.0, "rail": wanted})
    pull = mass * length * np.cos(angle)
    torque = about + pull * wanted + mass * G * length * np.sin(angle)
    force = 3.0 * wanted + pull - mass * length * np.sin(angle) * rate**2
    assert found.actuator_force == pytest.approx([torque, force], rel=1e-13)

    # the pin moves freely where only the rail is driven
    swing = -(pull * wanted + mass * G * length * np.sin(angle)) / about
    found = inverse_dynamics(scene, initial_state(scene), {"rail": wanted})
    force = 3.0 * wanted + pull * swing - mass * length * np.sin(angle) * rate**2
    assert found.actuator_force == pytest.approx([force], rel=1e-13)


def test_held_slider_crank_balances_the_slope_of_its_energy():
    """Torque on the crank = dV/dtheta, V of crank, rod and a wrench on the slider, in closed form."""
    push = 7.0
    scene = load("slider_crank")
    scene = replace(scene, initial_state=None, forces=(Wrench("push", "slider", 0.2 * X, force=-push * X),))
    for angle in (0.3, 1.1, -0.8):
        held = statics(scene, initial_state(start(scene, pivot=(angle, 0.0))), ["pivot"])

        def energy(theta):
            pin = np.array([0.0, 0.1 - 0.08 * np.sin(theta), 0.12 + 0.08 * np.cos(theta)])
            slider = np.sqrt(0.3**2 - pin[1] ** 2 - pin[2] ** 2)
            return G * (0.12 * 0.5 * (pin[2] + 0.12) + 0.5 * 0.5 * pin[2]) + push * slider

        slope = derivative(lambda step, angle=angle: energy(angle + step))
        assert held.actuator_force[0] == pytest.approx(slope, rel=1e-10)  # round-off of the difference


@pytest.mark.parametrize("name", ["tracker", "stewart", "four_bar"])
def test_forces_of_a_forward_solution_come_back(name):
    joints = ACTUATED.get(name, ("slide_12", "slide_13"))
    scene = load(name)
    rng = np.random.default_rng(1)
    weight = G * sum(body.mass for body in scene.mechanism.bodies)
    for state in random_states(scene, 4):
        forces = 0.3 * weight * rng.standard_normal(len(joints))
        driven = controlled(scene, joints, forces)
        wanted = accelerations(driven, state, joints)
        found = inverse_dynamics(scene, state, dict(zip(joints, wanted, strict=True)), joints)
        assert found.actuator_force == pytest.approx(forces, abs=1e-10 * np.abs(forces).max())


@pytest.mark.parametrize("engine", [PinocchioSystem, RigidMuJoCo])
@pytest.mark.parametrize("name", ["tracker_gravity", "stewart", "four_bar"])
def test_forces_are_those_of_the_other_engines_equations(name, engine):
    """T^T (M vdot - f) of the engine's own M, f, J, with J T = 0 and J_z T = I."""
    joints = ACTUATED[name]
    scene = replace(load(name), control=())
    system = engine(scene)
    tree = system._tree if engine is PinocchioSystem else system.tree
    on_v = [tree.place(*scene.mechanism.coordinate(name))[1] for name in joints]
    rng = np.random.default_rng(2)
    for state in random_states(scene, 2):
        q, v = system.coordinates(state)
        rows = np.concatenate([system.phi_jacobian(q), np.eye(system.nv)[on_v]])
        units = np.concatenate([system.phi_units, np.ones(len(joints))])[:, None]
        right = np.concatenate([np.zeros((len(rows) - len(joints), len(joints))), np.eye(len(joints))])
        tangent = np.linalg.lstsq(rows / units, right / units, rcond=1e-10)[0]
        wanted = rng.standard_normal(len(joints))
        free = system.acceleration(q, v)
        mass, force = system.mass_and_force(q, v)
        expected = tangent.T @ (mass @ (free + tangent @ (wanted - free[on_v])) - force)
        found = inverse_dynamics(scene, state, dict(zip(joints, wanted, strict=True)))
        assert found.actuator_force == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


@pytest.mark.slow
def test_redundant_actuators_share_by_least_norm_in_newton_meters(tracker):
    scene = replace(tracker, gravity=-G * Z)
    actuators = ("slide_12", "slide_13", "hinge_14")
    wanted = {"slide_12": 0.3, "slide_13": -0.2}
    (state,) = random_states(scene, 1)
    found = inverse_dynamics(scene, state, wanted, actuators).actuator_force
    again = accelerations(controlled(scene, actuators, found), state, tuple(wanted))
    assert again == pytest.approx(list(wanted.values()), rel=1e-10)
    # forces without effect span what may be added: the shortest ones are perpendicular to them
    rest = replace(scene, gravity=np.zeros(3))
    pushed = [
        accelerations(controlled(rest, actuators, u), state, tuple(wanted))
        - accelerations(controlled(rest, actuators, np.zeros(3)), state, tuple(wanted))
        for u in np.eye(3)
    ]
    nothing = np.linalg.svd(np.transpose(pushed))[2][-1]
    units = np.array([scene.mechanism.size] * 2 + [1.0])
    cosine = (
        (found * units) @ (nothing * units) / np.linalg.norm(found * units) / np.linalg.norm(nothing * units)
    )
    assert abs(cosine) < 1e-9


@pytest.mark.slow
def test_actuators_on_other_coordinates_than_the_wanted_ones(tracker):
    scene = replace(tracker, gravity=-G * Z)
    wanted = {"hinge_14": 0.4, "slide_13": -0.2}
    for state in random_states(scene, 3):
        found = inverse_dynamics(scene, state, wanted)
        assert found.actuators == ("slide_12", "slide_13")
        again = accelerations(controlled(scene, found.actuators, found.actuator_force), state, tuple(wanted))
        assert again == pytest.approx(list(wanted.values()), rel=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("coordinates", "actuators"),
    [
        (("slide_12", "slide_13"), ("slide_12", "slide_13")),
        (("slide_12", "slide_13"), ("slide_12", "slide_13", "hinge_14")),
        ((("universal_47", 0), ("universal_47", 1)), (("universal_47", 0), ("universal_47", 1))),
        (("hinge_14", ("universal_47", 1)), ("slide_12", "slide_13")),
    ],
)
def test_both_forms_traced_and_in_floats_agree_with_a_model_of_other_gravity(tracker, coordinates, actuators):
    """As a control law calls it: at q and v of a plant, whose equations are in either form."""
    scene, model = tracker, replace(tracker, gravity=-G * (Z + X))
    keys, acting = (tuple(map(scene.mechanism.coordinate, names)) for names in (coordinates, actuators))
    wanted = [0.3, -0.2]
    (state,) = random_states(scene, 1)
    found = []
    for form in (Relative, Cartesian):
        servos, measured = servos_of(model, keys, acting, form), measuring(model, [*keys, *acting])
        plant, inner = form(scene), form(measured)
        q, v = plant.coordinates(state)
        forces, _ = inner.servo_forces(inner.coordinates_from(plant, q), v, servos, wanted)
        graph = Graph()
        x = graph.variables(plant.nq + plant.nv)
        inner = form(measured)
        same = inner.coordinates_from(plant, x[: plant.nq])
        traced, _ = inner.servo_forces(same, x[plant.nq :], servos, wanted)
        found += [forces, graph.prune(traced).run(np.concatenate([q, v]))]
    for forces in found[1:]:
        assert forces == pytest.approx(found[0], rel=1e-10)


def loaded_tracker() -> Scene:
    """The tracker under gravity with a wrench, a spring between points and one on a joint."""
    scene = load("tracker_gravity")
    panel = scene.mechanism.body("panel_7").center_of_mass
    forces = (
        Wrench("wind", "panel_7", panel + 0.1 * X, force=[5.0, -20.0, 8.0], torque=[1.0, 2.0, -1.0]),
        PointSpring("cord", "base", "panel_7", panel + X, panel, stiffness=30.0, rest_length=0.1),
        JointSpring("hinge_14", 4.0, rest=0.1),
    )
    return replace(scene, forces=forces)


def test_static_loads_balance_weight_wrenches_and_springs():
    """Sums over all bodies of forces and of moments about the origin, at poses of a run."""
    scene = loaded_tracker()
    run = simulate(replace(scene, duration=0.4, output_period=0.1))
    held = statics(scene, run)
    mechanism, resting = scene.mechanism, zip(run.position, run.quaternion, strict=True)
    still = np.zeros_like(run.position[0])
    for k, (position, quaternion) in enumerate(resting):
        state = State(position, quaternion, still, still)
        at = Relative(scene).surroundings(*Relative(scene).coordinates(state))
        force, moment = np.zeros(3), np.zeros(3)
        for body, r in zip(mechanism.bodies[1:], position[1:], strict=True):
            force += body.mass * scene.gravity
            moment += np.cross(r, body.mass * scene.gravity)
        for each in scene.body_forces:
            for body, wrench in each.wrenches(at):
                if body:
                    force += wrench[:3]
                    moment += np.cross(position[body], wrench[:3]) + wrench[3:]
        for j, equations in enumerate(mechanism.equations):
            if 0 not in (equations.first, equations.second):
                continue
            sign, second = (1.0, equations.second) if equations.first == 0 else (-1.0, equations.second)
            arm = mechanism.bodies[second].pose.point_to_body(equations.joint.point_on_second)
            point = position[second] + rotation(quaternion[second]) @ arm
            force += sign * held.reaction_force[k, j]
            moment += sign * (held.reaction_torque[k, j] + np.cross(point, held.reaction_force[k, j]))
        # forces on coordinates of the ground's joints act beside the reactions
        for name, u in zip(held.actuators, held.actuator_force[k], strict=True):
            joint = mechanism.joint(name)
            force += u * joint.axis
            moment += np.cross(joint.point, u * joint.axis)
        at_hinge = Relative(scene).measured(*Relative(scene).coordinates(state))["hinge_14", 0]
        moment -= 4.0 * (at_hinge.x - 0.1) * mechanism.joint("hinge_14").axis
        scale = np.abs(held.reaction_force[k]).max()
        assert np.abs(force).max() < 1e-10 * scale
        assert np.abs(moment).max() < 1e-10 * scale


@pytest.mark.parametrize("engine", [PinocchioSystem, RigidMuJoCo])
def test_static_reactions_are_those_of_the_other_engines(engine):
    scene = loaded_tracker()
    state = initial_state(start(scene, slide_12=(0.02, 0.0), slide_13=(-0.01, 0.0)))
    held = statics(scene, state)
    system = engine(controlled(scene, held.actuators, held.actuator_force))
    found = system.evaluate(*system.coordinates(state))
    scale = np.abs(held.reaction_force).max()
    assert held.reaction_force == pytest.approx(found.reaction_force, abs=1e-8 * scale)
    assert held.reaction_torque == pytest.approx(found.reaction_torque, abs=1e-8 * scale)
    weight = sum(body.mass for body in scene.mechanism.bodies)
    assert np.abs(found.linear_acceleration).max() * weight < 1e-8 * scale


@pytest.mark.slow
def test_poses_with_rates_are_the_states_of_a_run(tracker):
    """Forces of the laws from coordinates, rates and accelerations alone, no state of the run."""
    run = simulate(replace(tracker, duration=1.0, output_period=0.1))
    names, wanted = ("slide_12", "slide_13"), []
    for k in range(len(run.time)):
        row = run.position[k], run.quaternion[k], run.linear_velocity[k], run.angular_velocity[k]
        wanted.append(accelerations(tracker, State(*row), names))
    motion = {name: run.joint(name) for name in names}
    poses = solve_poses(tracker, {name: motion[name].coordinates[:, 0] for name in names})
    rates = {name: motion[name].rates[:, 0] for name in names}
    found = inverse_dynamics(tracker, poses, dict(zip(names, np.transpose(wanted), strict=True)), rates=rates)
    scale = np.abs(run.actuator_force).max()
    # poses are solved to 1e-12 of the mechanism's size, and forces have its stiffness
    assert found.actuator_force == pytest.approx(run.actuator_force, abs=1e-9 * scale)
    assert found.reaction_force == pytest.approx(run.reaction_force, abs=1e-9 * scale)
    held = statics(load("tracker_gravity"), poses)
    again = statics(load("tracker_gravity"), run)
    assert held.actuator_force == pytest.approx(again.actuator_force, rel=1e-9)


def test_rates_of_some_coordinates_move_others_with_the_least_energy():
    """The pole of a cart turns so that the energy at a given rate of the cart is the least."""
    scene = cart_pole()
    still = initial_state(scene)
    a, inertia = rotation(scene.mechanism.bodies[2].quaternion), scene.mechanism.bodies[2].inertia
    about = (a @ inertia @ a.T)[1, 1] + 0.5**2
    turning = start(scene, rail=(0.0, 1.0), pin=(0.0, -0.5 * np.cos(0.3) / about))
    found = inverse_dynamics(scene, still, {"rail": 0.5}, rates={"rail": 1.0})
    expected = inverse_dynamics(scene, initial_state(turning), {"rail": 0.5})
    assert found.actuator_force == pytest.approx(expected.actuator_force, rel=1e-12)
    with pytest.raises(NewtonEulerError, match="rate of 'pin': has no acceleration beside it"):
        inverse_dynamics(scene, still, {"rail": 0.5}, rates={"pin": 1.0})


@pytest.mark.slow
def test_prescribed_motions_act_with_their_functions_at_each_time(tracker):
    """A spline and a polynomial that is the same: the slider's force under one and under the other."""
    times = np.linspace(0.0, 1.0, 21)
    quadratic = Polynomial((0.0, 0.02, 0.01))
    spline = Spline(times, [quadratic.value(t) for t in times])
    forces = []
    for function in (quadratic, spline):
        motions = (PrescribedMotion("slide_13", function),)
        scene = replace(tracker, control=(), motions=motions, gravity=-G * Z, duration=1.0, output_period=0.1)
        run = simulate(scene)
        forces.append(inverse_dynamics(scene, run, {"slide_12": 0.1}, time=run.time).actuator_force)
        state = State(run.position[5], run.quaternion[5], run.linear_velocity[5], run.angular_velocity[5])
        one = inverse_dynamics(scene, state, {"slide_12": 0.1}, time=0.5)
        assert one.actuator_force == pytest.approx(forces[-1][5], rel=1e-12)
        scene = controlled(scene, ("slide_12",), one.actuator_force)
        system = at_time(Relative(scene), 0.5)
        vdot = system.acceleration(*system.coordinates(state))
        assert vdot[system.places["slide_12", 0][1]] == pytest.approx(0.1, rel=1e-10)
    assert forces[1] == pytest.approx(forces[0], rel=1e-7)  # accelerations of a spline through round-off


@pytest.mark.slow
def test_static_loads_of_redundant_constraints_and_of_springs_alone(tracker):
    """Bricard's loop has multipliers to choose; the platform of 1.2 t rests on its springs."""
    bricard = load("bricard")
    held = statics(bricard, actuators=[bricard.mechanism.joint_names[0]])
    system = Relative(controlled(bricard, held.actuators, held.actuator_force))
    found = system.evaluate(*system.coordinates(replace(initial_state(bricard))))
    assert held.reaction_force == pytest.approx(found.reaction_force, abs=1e-9)
    with pytest.raises(NewtonEulerError, match=r"body 'platform': is left with a force of .* N at state 0"):
        statics(load("stewart"))


@pytest.mark.parametrize(
    ("name", "wanted", "actuators", "message"),
    [
        ("tracker", {"slide_99": 0.0}, None, "unknown joint 'slide_99'"),
        (
            "tracker",
            {("slide_12", 3): 0.0},
            None,
            "joint 'slide_12': coordinate is 3; needed: an index below 1",
        ),
        (
            "tracker",
            {"universal_47": 0.0},
            None,
            r"has 2 coordinates; needed: which one, as \('universal_47', 0",
        ),
        ("tracker", {"slide_12": np.nan, "slide_13": 0.0}, None, "acceleration of 'slide_12' is nan"),
        ("tracker", {"slide_12": 0.0}, ["slide_12", "slide_13"], "has 2 degrees of freedom, and 1 coord"),
        (
            "tracker",
            {"slide_12": 0.0, "slide_13": 0.0},
            ["slide_12"],
            "coordinate 'slide_13': is moved by no",
        ),
        (
            "tracker",
            {"slide_12": 0.0, "slide_13": 0.0},
            ["slide_12"] * 2,
            "actuator 'slide_12': is named twice",
        ),
        (
            "four_bar",
            {"pivot_0": 0.0, "pivot_1": 0.0},
            None,
            "coordinate 'pivot_.': depends on loops and the",
        ),
    ],
)
def test_choices_that_cannot_be(name, wanted, actuators, message):
    scene = load(name)
    with pytest.raises(NewtonEulerError, match=message):
        inverse_dynamics(scene, initial_state(scene), wanted, actuators)


def test_states_that_cannot_be(tracker):
    wanted = {"slide_12": 0.0, "slide_13": 0.0}
    with pytest.raises(NewtonEulerError, match=r"states is 3; needed: a State .* or a Poses"):
        inverse_dynamics(tracker, 3, wanted)
    state = initial_state(tracker)
    apart = replace(state, position=state.position + 0.01 * np.arange(21).reshape(7, 3))
    with pytest.raises(NewtonEulerError, match=r"state 0: joint '.*' is open by .* needed: closed loops"):
        inverse_dynamics(tracker, apart, wanted)
    flat = replace(load("four_bar", N=1), initial_state=None)
    flat = initial_state(start(flat, pivot_0=(-np.pi / 2, 0.0)))
    with pytest.raises(NewtonEulerError, match=r"singular at joint '.*': the loops at state 0 do not"):
        statics(load("four_bar", N=1), flat, [])
    # a crank at its dead center cannot be accelerated by the slider
    crank = replace(load("slider_crank"), initial_state=None)
    for angle in (1.0, 2.0):
        crank = start(crank, pivot=(angle, 0.0))
    dead = start(crank, pivot=(np.pi - np.arctan2(0.1, 0.12), 0.0))
    with pytest.raises(
        NewtonEulerError, match=r"singular at joint 'guide': at state 0 the coordinate depends"
    ):
        inverse_dynamics(crank, initial_state(dead), {"guide": 1.0})


@pytest.mark.parametrize("angle", [-2.9, 0.5, 1.7])
def test_actuator_holds_balanced_wheel_against_its_spring(angle: float) -> None:
    """Torques alone act: no reaction force and no weight, which round-off could be measured against."""
    wheel = Body("wheel", 2.0, [0.0, 0.0, 0.0], np.diag([0.03, 0.02, 0.05]))
    hinge = Revolute("axle", "ground", "wheel", [0.0, 0.0, 0.0], axis=Z)
    mechanism = Mechanism([Body.ground(), wheel], [hinge])
    scene = Scene("wheel", mechanism, 1.0, 0.5, forces=[JointSpring("axle", stiffness=0.7)])
    held = statics(start(scene, axle=(angle, 0.0)), actuators=["axle"])
    assert held.actuator_force == pytest.approx([0.7 * angle], rel=1e-12)  # some roundings


def two_arms(masses, lengths, gravity):
    """Return two rods in a row on hinges about y, the second on the first, at 0.4 and 1.3 rad."""
    (m1, m2), (l1, l2) = masses, lengths
    first = Body("first", m1, [l1 / 2.0, 0.0, 0.0], m1 * l1**2 / 12.0 * np.eye(3))
    second = Body("second", m2, [l1 + l2 / 2.0, 0.0, 0.0], m2 * l2**2 / 12.0 * np.eye(3))
    hinges = [
        Revolute("shoulder", "ground", "first", [0.0, 0.0, 0.0], axis=[0.0, 1.0, 0.0]),
        Revolute("elbow", "first", "second", [l1, 0.0, 0.0], axis=[0.0, 1.0, 0.0]),
    ]
    mechanism = Mechanism([Body.ground(), first, second], hinges)
    scene = Scene("arms", mechanism, 1.0, 0.5, gravity=[0.0, 0.0, -gravity])
    return start(scene, shoulder=(0.4, 0.0), elbow=(0.9, 0.0))


@pytest.mark.parametrize(
    ("masses", "lengths", "gravity"),
    [
        ((1.0, 1e6), (1.0, 1.0), 9.81),
        ((1e6, 1.0), (1.0, 1.0), 9.81),
        ((1e6, 1e-3), (1e3, 1e-3), 9.81),
        ((1e-6, 1e-6), (1e-3, 1e-3), 9.81),
        ((1.0, 1e-3), (1.0, 1.0), 1e6),
        ((1e3, 1e-3), (1.0, 1.0), 1e-6),
    ],
)
def test_statics_of_masses_lengths_and_gravity_of_any_size(masses, lengths, gravity):
    """Torques of two arms under their weights, from levers; each body is held or not by its own forces."""
    scene = two_arms(masses, lengths, gravity)
    (m1, m2), (l1, l2) = masses, lengths
    elbow = -m2 * gravity * l2 / 2.0 * np.cos(1.3)
    shoulder = -(m1 / 2.0 + m2) * gravity * l1 * np.cos(0.4) + elbow
    held = statics(scene, actuators=["shoulder", "elbow"]).actuator_force
    # the light arm's torque comes out of points 1e6 of its lengths away: 1e-16 times that
    assert held == pytest.approx([shoulder, elbow], rel=1e-9)
    with pytest.raises(MechanismError, match="body 'second': is left with"):
        statics(scene, actuators=["shoulder"])


def test_springs_that_hold_each_other_are_in_balance():
    """Two springs along a slide pull with 0.56 N each and nothing else acts: round-off is no motion."""
    along = np.array([0.3, 0.2, 0.1]) / np.linalg.norm([0.3, 0.2, 0.1])
    body = Body("carriage", 1.0, [0.0, 0.0, 0.0], 0.01 * np.eye(3))
    mechanism = Mechanism(
        [Body.ground(), body], [Prismatic("rail", "ground", "carriage", [0.0, 0.0, 0.0], axis=along)]
    )
    springs = [
        PointSpring("fore", "ground", "carriage", 1.1 * along, 0.0 * along, stiffness=0.7, rest_length=0.3),
        PointSpring("aft", "ground", "carriage", -1.3 * along, 0.0 * along, stiffness=0.56, rest_length=0.3),
    ]
    scene = Scene("rail", mechanism, 1.0, 0.5, gravity=[0.0, 0.0, 0.0], forces=springs)
    assert np.abs(statics(scene, actuators=[]).reaction_force).max() < 1e-15  # of 0.56 N
    slack = replace(springs[1], stiffness=0.56 * (1.0 + 1e-6))
    with pytest.raises(MechanismError, match=r"left with a force of 5\.6e-07 N"):
        statics(replace(scene, forces=[springs[0], slack]), actuators=[])
