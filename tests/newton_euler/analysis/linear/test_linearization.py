"""Linear models against closed forms, finite differences, Pinocchio and simulated small motions."""

from __future__ import annotations

import importlib.util
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from finite_difference import derivative
from mechanisms import bar, carts, planar_four_bar

from crosscheck.library import load
from newton_euler import BranchWarning, start
from newton_euler.analysis.linear.linear_model import LinearModel, Modes
from newton_euler.analysis.linear.linearization import linearize
from newton_euler.analysis.loads.equilibrium import at_rest, equilibrium
from newton_euler.analysis.loads.statics import statics
from newton_euler.equations.relative import Relative
from newton_euler.errors import NewtonEulerError, SingularityError
from newton_euler.integrators.projection import project_position, project_velocity
from newton_euler.model.control import PD
from newton_euler.model.digital_control import Sampled
from newton_euler.model.forces import JointSpring
from newton_euler.model.joint_kinds import PointOnLine, Prismatic, Revolute, Spherical
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.motions import PrescribedMotion, Steps
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Polynomial
from newton_euler.model.splines import Spline
from newton_euler.model.state import State
from newton_euler.model.switched_forces import JointFriction
from newton_euler.reading.excitation import random_states
from newton_euler.runs.assemble import initial_state
from newton_euler.runs.simulate import compile_scene, simulate
from urdf.dynamics import PinocchioSystem

G = 9.81
X, Y, Z = np.eye(3)
MASS, STIFFNESS, DAMPING = 2.0, 50.0, 3.0


def mass_on_rail(**fields: object) -> Scene:
    """A mass on a horizontal rail, actuated."""
    cart = Body("cart", MASS, np.zeros(3), np.eye(3))
    rail = Prismatic("rail", "ground", "cart", np.zeros(3), axis=X, actuated=True)
    return Scene("rail", Mechanism([Body.ground(), cart], [rail]), 1.0, 0.1, **fields)


def double_pendulum() -> Scene:
    """Two bars of 1 m that hang down."""
    bodies = [
        Body.ground(),
        bar("upper", [0, 0, 0], [0, 0, -1.0]),
        bar("lower", [0, 0, -1.0], [0, 0, -2.0], 2.0),
    ]
    joints = [
        Revolute("shoulder", "ground", "upper", np.zeros(3), axis=Y),
        Revolute("elbow", "upper", "lower", -Z, axis=Y),
    ]
    return Scene("double_pendulum", Mechanism(bodies, joints), 1.0, 0.1, gravity=-G * Z)


def test_mass_on_a_spring_under_a_law():
    law = PD("rail", 20.0, 1.0, 0.3)
    scene = mass_on_rail(forces=(JointSpring("rail", STIFFNESS, DAMPING),), control=(law,))
    model = linearize(scene, inputs=["rail", "rail.target", "cart.mass"], outputs=["rail", "cart"])
    assert pytest.approx(model.A, rel=1e-14) == [[0.0, 1.0], [-70.0 / MASS, -4.0 / MASS]]
    assert pytest.approx(model.f, rel=1e-14) == [0.0, 6.0 / MASS]
    assert pytest.approx(model.B, rel=1e-14) == [[0, 0, 0], [1.0 / MASS, 20.0 / MASS, -6.0 / MASS**2]]
    assert model.C.tolist() == [[1.0, 0.0], [1.0, 0.0]] + [[0.0, 0.0]] * 5
    assert model.D.tolist() == [[0.0] * 3] * 7
    assert model.outputs[:2] == ("rail", "cart.x")
    assert model.outputs[-1] == "cart.rz"
    assert not model.is_equilibrium

    modes = linearize(scene, equilibrium(scene)).modes()
    decay = 2.0 / MASS
    assert modes.eigenvalues == pytest.approx([-decay + 1j * np.sqrt(35.0 - decay**2)], rel=1e-13)
    assert modes.frequencies == pytest.approx([np.sqrt(35.0 - decay**2) / (2.0 * np.pi)], rel=1e-13)
    assert modes.angular_frequencies == pytest.approx([np.sqrt(35.0)], rel=1e-13)
    assert modes.damping_ratios == pytest.approx([decay / np.sqrt(35.0)], rel=1e-13)

    held = linearize(scene, closed_loop=False)
    assert pytest.approx(held.A, rel=1e-14) == [[0.0, 1.0], [-STIFFNESS / MASS, -DAMPING / MASS]]
    assert pytest.approx(held.f, rel=1e-14) == [0.0, 6.0 / MASS]


def test_friction_has_the_slope_of_its_piece():
    """Viscous below the transition speed, Stribeck's curve above it, and no slope where both meet."""
    coulomb, stribeck, speed, transition = 4.0, 1.5, 0.02, 1e-3
    scene = mass_on_rail(forces=(JointFriction("rail", coulomb, stribeck, speed, transition),))

    def damping(rate: float) -> float:
        return -MASS * linearize(start(scene, rail=(0.0, rate))).A[1, 1]

    assert damping(0.0) == pytest.approx((coulomb + stribeck) / transition, rel=1e-12)
    for rate in (0.01, -0.05):
        slope = -2.0 * stribeck * abs(rate) / speed**2 / (1.0 + (rate / speed) ** 2) ** 2
        assert damping(rate) == pytest.approx(slope, rel=1e-12)
    with pytest.raises(SingularityError, match="accelerations are not determined at the state"):
        damping(transition)


def test_laws_that_depend_on_time_are_those_of_the_time():
    """A target along a spline: its value and rate at the time move the mass, not the model's matrices."""
    times = np.linspace(0.0, 2.0, 41)
    target = Spline(times, np.sin(times))
    model = linearize(mass_on_rail(control=(PD("rail", 20.0, 1.0, target),)), time=1.5)
    assert pytest.approx(model.A, rel=1e-14) == [[0.0, 1.0], [-20.0 / MASS, -1.0 / MASS]]
    assert model.f[1] == pytest.approx((20.0 * np.sin(1.5) + np.cos(1.5)) / MASS, rel=1e-7)


@pytest.mark.parametrize("function", [Spline, Steps])
def test_samples_of_functions_are_inputs(function):
    """Columns are differences between scenes with other samples, in which accelerations are linear."""
    times, values = np.linspace(0.0, 2.0, 6), np.array([1.0, 3.0, -2.0, 0.5, 4.0, 2.0])

    def model(change: float, at: int, time: float, **inputs: list[str]) -> LinearModel:
        target = function(times, values + change * (np.arange(6) == at))
        return linearize(mass_on_rail(control=(PD("rail", 20.0, 1.0, target),)), time=time, **inputs)

    for time, at in ((0.1, 0), (0.1, 1), (1.1, 2)):
        found = model(0.0, at, time, inputs=["rail.target", "rail.stiffness"]).B[:, at]
        alone = model(0.0, at, time, inputs=[f"rail.target.{at}"]).B[:, 0]
        expected = model(1.0, at, time).f - model(0.0, at, time).f
        assert found == pytest.approx(expected, rel=1e-12, abs=1e-12)
        assert alone == pytest.approx(expected, rel=1e-12, abs=1e-12)
        assert (abs(expected[1]) > 0.1) == (function is Spline or at != 1)


def test_sampled_controllers_are_held_or_refused():
    scene = mass_on_rail(control=(Sampled("rail", lambda time, x, rate: 4.0 - x[0], 0.1),))
    assert linearize(scene, closed_loop=False).f[1] == 4.0 / MASS
    with pytest.raises(NewtonEulerError, match="joint 'rail': has no derivative, being sampled"):
        linearize(scene)


def test_double_pendulum_is_its_textbook_matrices():
    scene = double_pendulum()
    model = linearize(scene, inputs=["shoulder", "elbow"], coordinates=["shoulder", "elbow"])
    upper, lower = 1.01 / 12.0, 2.0 * 1.01 / 12.0
    # absolute angles: M = [[I1 + m1/4 + m2, m2/2], [m2/2, I2 + m2/4]], K = G diag(m1/2 + m2, m2/2)
    mass = np.array([[upper + 0.25 + 2.0, 1.0], [1.0, lower + 0.5]])
    stiffness = G * np.diag([0.5 + 2.0, 1.0])
    relative = np.array([[1.0, 0.0], [1.0, 1.0]])
    mass, stiffness = (relative.T @ each @ relative for each in (mass, stiffness))
    expected = np.block(
        [[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(mass, stiffness), np.zeros((2, 2))]]
    )
    assert pytest.approx(expected, abs=1e-12) == model.A
    assert model.B[2:] == pytest.approx(np.linalg.inv(mass), rel=1e-13)
    assert model.is_equilibrium
    modes = model.modes()
    squares = np.sort(np.linalg.eigvals(np.linalg.solve(mass, stiffness)))
    assert modes.angular_frequencies**2 == pytest.approx(squares, rel=1e-12)
    assert modes.damping_ratios == pytest.approx([0.0, 0.0], abs=1e-12)


def test_sleeping_top_is_its_precession_and_nutation():
    """xi'' - i (I3/I1) W xi' - (m g l / I1) xi = 0 in space; seen from the top lambda - i W."""
    across, axial, mass, arm, spin = 0.05, 0.02, 1.5, 0.3, 40.0
    top = Body("top", mass, arm * Z, np.diag([across, across, axial]))
    mechanism = Mechanism([Body.ground(), top], [Spherical("tip", "ground", "top", np.zeros(3))])
    turning = replace(State.initial(mechanism), angular_velocity=np.array([np.zeros(3), spin * Z]))
    scene = Scene("top", mechanism, 1.0, 0.1, gravity=-G * Z, initial_state=turning)
    model = linearize(scene)
    assert model.coordinates == ("tip.ball.x", "tip.ball.y", "tip.ball.z")
    about = across + mass * arm**2
    roots = np.roots([1.0, -1j * axial / about * spin, -mass * G * arm / about]) - 1j * spin
    expected = np.concatenate([roots, roots.conj(), [0.0, 0.0]])
    found = np.linalg.eigvals(model.A)
    for each in expected:
        assert np.abs(found - each).min() < 1e-12 * spin
    assert not model.is_equilibrium  # it moves on


def accelerations(scene: Scene, state: State, names: tuple[str, ...], change: np.ndarray) -> np.ndarray:
    """Forward dynamics next to a state, by the dense solver: change (2 d,) of coordinates and rates."""
    keys = [scene.mechanism.coordinate(name) for name in names]
    idle = tuple(JointSpring(joint, 0.0, coordinate=k) for joint, k in keys)
    forces = [each for each in idle if each.key not in {known.key for known in scene.joint_forces}]
    scene = replace(scene, forces=(*scene.forces, *forces))
    system = Relative(scene)
    now = system.measured(*system.coordinates(state))
    motions = tuple(
        PrescribedMotion(joint, Polynomial((now[joint, k].x + x, now[joint, k].rate + rate)), k)
        for (joint, k), x, rate in zip(keys, *np.split(change, 2), strict=True)
    )
    driven = Relative(replace(scene, motions=(*scene.motions, *motions)))
    q, v = driven.coordinates(state)
    q = project_position(driven, q)
    moved = driven.state(q, project_velocity(driven, q, v))
    q, v = system.coordinates(moved)
    vdot, measured = system.acceleration(q, v), system.measured(q, v)
    rows = [measured[key] for key in keys]
    return np.array([sum(vdot[k] * x for k, x in row.jacobian.items()) - row.gamma for row in rows])


LEGS = tuple((f"leg_{k}", 0) for k in range(1, 7))

MOVING = [
    ("tracker", ("slide_12", "slide_13")),
    ("tracker_gravity", ("hinge_14", ("universal_47", 1))),
    ("stewart", LEGS),
    ("slider_crank", ("guide",)),
    ("four_bar", ("hinge_0",)),
    ("flyball_governor", None),
]
"""Scenes and coordinates, of which some are on joints that the tree cuts."""


@pytest.mark.parametrize(
    ("name", "names"),
    # 4 s; the tracker has cut loops, too
    [pytest.param(*each, marks=pytest.mark.slow) if each[0] == "stewart" else each for each in MOVING],
)
def test_a_is_the_finite_difference_of_accelerations_in_motion(name, names):
    scene = load(name)
    (state,) = random_states(scene, 1, seed=3)
    model = linearize(scene, state, names)
    names, d = model.coordinates, len(model.coordinates)
    size = np.tile(model.units, 2)
    exact = (model.A * size / size[:, None])[d:]
    scale = max(1.0, np.abs(exact).max())
    for direction in np.random.default_rng(5).uniform(-1.0, 1.0, (2, 2 * d)):
        found = derivative(
            lambda s, e=size * direction: accelerations(scene, state, names, s * e) / model.units, 2e-4
        )
        assert exact @ direction == pytest.approx(found, abs=1e-7 * scale)  # round-off over the step
    own = accelerations(scene, state, names, np.zeros(2 * d)) / model.units
    assert model.f[d:] / model.units == pytest.approx(own, abs=1e-9 * scale)


@pytest.mark.slow
def test_inputs_and_outputs_are_finite_differences():
    scene = load("tracker_gravity")
    (state,) = random_states(scene, 1, seed=4)
    names, outputs = ("slide_12", "slide_13"), ["hinge_14", "panel_7"]
    inputs = ["hinge_14", "slide_12.target", "panel_7.mass", "gravity"]
    model = linearize(scene, state, names, inputs, outputs)
    assert model.inputs == (
        "hinge_14",
        "slide_12.target",
        "panel_7.mass",
        "gravity[0]",
        "gravity[1]",
        "gravity[2]",
    )

    def with_target(s):
        first, second = scene.control
        return replace(scene, control=(replace(first, target=first.target + s), second))

    def with_gravity(s):
        return replace(scene, gravity=scene.gravity + s * Y)

    def with_mass(s):
        bodies = [replace(b, mass=b.mass + s) if b.name == "panel_7" else b for b in scene.mechanism.bodies]
        return replace(scene, mechanism=Mechanism(bodies, scene.mechanism.joints))

    def pushed(s):
        spring = JointSpring("hinge_14", 1e-6, rest=s * 1e6)  # as good as a constant force
        return replace(scene, forces=(spring,))

    for column, change in ((0, pushed), (1, with_target), (2, with_mass), (4, with_gravity)):
        found = derivative(lambda s, c=change: accelerations(c(s), state, names, np.zeros(4)))
        assert model.B[2:, column] == pytest.approx(found, rel=1e-6)


def transition(
    scene: Scene, state: State, names: tuple[str, ...], span: float, amplitude: float
) -> np.ndarray:
    """Changes (2 d, 2 d) after a span, s, by small changes of a state at rest, of runs that are exact."""
    code = compile_scene(replace(scene, duration=span, output_period=span, initial_state=state))
    base = code.scene
    mechanism, columns = base.mechanism, []

    def measured(run):
        rows = [run.joint(joint) for joint, _ in map(mechanism.coordinate, names)]
        numbers = [k for _, k in map(mechanism.coordinate, names)]
        x = [row.coordinates[:, k] for row, k in zip(rows, numbers, strict=True)]
        rates = [row.rates[:, k] for row, k in zip(rows, numbers, strict=True)]
        return np.concatenate([np.array(x)[:, -1], np.array(rates)[:, -1]]), np.array(x)[:, 0]

    rest = measured(code.simulate(rtol=1e-12, atol=1e-14))[1]
    for e in np.eye(2 * len(names)):
        ends = []
        for sign in (1.0, -1.0):
            x, rates = np.split(sign * amplitude * e, 2)
            given = {}
            for name, value, rate in zip(names, rest + x, rates, strict=True):
                joint, k = mechanism.coordinate(name)
                pairs = [None] * len(mechanism.joint(joint).coordinate_kinds)
                pairs[k] = (value, rate)
                given[joint] = pairs if len(pairs) > 1 else pairs[0]
            ends.append(measured(code.with_scene(start(base, **given)).simulate(rtol=1e-12, atol=1e-14))[0])
        columns.append((ends[0] - ends[1]) / (2.0 * amplitude))
    return np.column_stack(columns)


def lightly_damped_tracker() -> Scene:
    scene = load("tracker_gravity")
    return replace(scene, control=tuple(replace(law, damping=1.0) for law in scene.control))


def sprung_four_bar() -> Scene:
    scene = replace(load("four_bar"), initial_state=None)
    return replace(scene, forces=(JointSpring("pivot_0", 60.0, 2.0, rest=0.4),))


SMALL = [
    (lightly_damped_tracker, ("slide_12", "slide_13"), 0.02, (1e-5, 5e-6)),
    (sprung_four_bar, ("pivot_0",), 0.2, (1e-3, 5e-4)),
    pytest.param(lambda: load("stewart"), LEGS, 0.15, (1e-4,), marks=pytest.mark.slow),  # 4 s
]
"""Scene, coordinates, span (s, less than half a period) and amplitudes (m or rad)."""


@pytest.mark.parametrize(("scene_of", "names", "span", "amplitudes"), SMALL)
def test_modes_are_those_of_simulated_small_motions(scene_of, names, span, amplitudes):
    """Eigenvalues exp(lambda t) of the transition matrix, the square of amplitudes extrapolated away."""
    scene = scene_of()
    state = equilibrium(scene)
    modes = linearize(scene, state, names).modes()
    assert len(modes.eigenvalues) >= len(names)
    first, *second = (transition(scene, state, names, span, amplitude) for amplitude in amplitudes)
    matrix = (4.0 * second[0] - first) / 3.0 if second else first
    found = np.log(np.linalg.eigvals(matrix).astype(complex)) / span
    for each in modes.eigenvalues:
        assert np.abs(found - each).min() < 1e-7 * abs(each)  # errors of runs over the amplitude


@pytest.mark.slow
def test_modes_of_the_tracker_are_those_of_small_motions_where_its_run_ends():
    """The weight pulls the sliders far down. The pose is the end of a run of 20 s, without any search."""
    scene, names = load("tracker_gravity"), ("slide_12", "slide_13")
    run = simulate(replace(scene, duration=20.0, output_period=1.0, outputs=frozenset({"velocities"})))
    first, second = (transition(scene, run.state(-1), names, 0.05, amplitude) for amplitude in (2e-5, 1e-5))
    found = np.log(np.linalg.eigvals((4.0 * second - first) / 3.0).astype(complex)) / 0.05
    pair = found[found.imag > 1.0]
    assert pair.imag / (2.0 * np.pi) == pytest.approx([2.303], abs=5e-4)
    assert -pair.real / np.abs(pair) == pytest.approx([0.747], abs=6e-4)
    with pytest.warns(BranchWarning):
        modes = linearize(scene, equilibrium(scene)).modes()
    assert len(modes.eigenvalues) == 3
    for each in modes.eigenvalues:
        assert np.abs(found - each).min() < 1e-6 * abs(each)  # errors of runs over the amplitude


def test_critical_damping_has_real_double_eigenvalues():
    """m x'' + c x' + k x = 0 with c^2 = 4 m k, twice: round-off makes pairs of the eigenvalues -c / (2 m)."""
    laws = tuple(PD(joint, stiffness=200.0, damping=40.0, target=0.0) for joint in ("rail_0", "rail_1"))
    modes = linearize(carts(*laws)).modes()
    assert not modes.frequencies.any()
    assert modes.damping_ratios.tolist() == [1.0] * 4
    assert modes.eigenvalues == pytest.approx([-10.0] * 4, rel=1e-6)


def test_accelerations_by_coordinates_and_rates_are_pinocchios():
    scene = replace(load("chain", N=5), forces=(), control=())
    (state,) = random_states(scene, 1)
    system = PinocchioSystem(scene)
    q, v = system.coordinates(state)
    own, data = system.closed.model, system.closed.model.createData()
    pin_q, pin_v = system.map.q_to_pinocchio(q), system.map.v_to_pinocchio(v)
    pin.computeABADerivatives(own, data, pin_q, pin_v, np.zeros(own.nv))
    names = [joint.name for joint in scene.mechanism.joints]
    places = [system._tree.place(name, 0)[1] for name in names]
    order = np.argmax(np.abs([system.map.v_to_pinocchio(e) for e in np.eye(system.nv)[places]]), axis=1)
    model = linearize(scene, state, names)
    d, grid = len(names), np.ix_(order, order)
    assert model.A[d:, :d] == pytest.approx(data.ddq_dq[grid], abs=1e-10 * np.abs(data.ddq_dq).max())
    assert model.A[d:, d:] == pytest.approx(data.ddq_dv[grid], abs=1e-10 * np.abs(data.ddq_dv).max())
    inverse = np.linalg.inv(system.mass_matrix(q)[np.ix_(places, places)])
    assert linearize(scene, state, names, names).B[d:] == pytest.approx(inverse, rel=1e-9)


def test_coordinates_that_are_always_zero_have_zero_rows():
    """A point on a line in the plane of a four-bar does not move along the line."""
    flat = planar_four_bar()
    hinge = flat.mechanism.joint("at_c")
    pin = PointOnLine("at_c", "coupler", "rocker", hinge.point, axis=[0.0, 1.0, 0.0])
    joints = [pin if joint.name == "at_c" else joint for joint in flat.mechanism.joints]
    scene = replace(flat, mechanism=Mechanism(flat.mechanism.bodies, joints))
    model = linearize(scene, outputs=["at_c", "at_a"], coordinates=["at_a"])
    np.testing.assert_allclose(model.C, [[0.0, 0.0], [1.0, 0.0]], rtol=0.0, atol=1e-14)


def test_modes_have_twists_of_all_bodies_and_rigid_ones_are_zero():
    scene = mass_on_rail()
    modes = linearize(scene).modes()
    assert isinstance(modes, Modes)
    assert modes.eigenvalues.tolist() == [0.0]
    assert np.abs(modes.twists[0, 1]).tolist() == [scene.mechanism.size, 0.0, 0.0, 0.0, 0.0, 0.0]
    assert not modes.twists[0, 0].any()
    scene = double_pendulum()
    modes = linearize(scene, coordinates=["shoulder", "elbow"]).modes()
    for shape, twist in zip(modes.shapes, modes.twists, strict=True):
        turn = np.array([shape[0], shape.sum()])
        assert twist[1:, 4] == pytest.approx(turn, abs=1e-14)
        assert twist[1:, 0] == pytest.approx([-0.5 * turn[0], -turn[0] - 0.5 * turn[1]], abs=1e-14)
        assert max(np.abs(twist[:, :3]).max() / scene.mechanism.size, np.abs(twist[:, 3:]).max()) == 1.0


def test_a_mechanism_that_cannot_move_has_loads_and_no_modes():
    scene = mass_on_rail(motions=(PrescribedMotion("rail", Polynomial((0.0,))),), gravity=-G * (X + Z))
    with pytest.raises(NewtonEulerError, match="scene 'rail': has no degree of freedom; needed: a mechanism"):
        linearize(scene)
    held = statics(scene, actuators=[])
    assert held.actuator_force.shape == (0,)
    assert held.reaction_force[0] == pytest.approx([MASS * G, 0.0, MASS * G], rel=1e-14)


def test_models_go_to_scipy_and_control():
    model = linearize(load("tracker"), inputs=["slide_12.target"], outputs=["panel_7", ("universal_47", 1)])
    system = model.to_scipy()
    for name in "ABCD":
        assert np.array_equal(getattr(system, name), getattr(model, name))
    if importlib.util.find_spec("control"):
        named = model.to_control()
        assert named.input_labels == ["slide_12_target"]
        assert named.output_labels[-2:] == ["panel_7_rz", "universal_47_1"]
        assert named.state_labels[-1] == "slide_13_rate"


def test_equilibrium_of_a_mass_on_a_spring_is_where_it_hangs():
    rail = Prismatic("rail", "ground", "cart", np.zeros(3), axis=Z)
    mechanism = Mechanism([Body.ground(), Body("cart", MASS, np.zeros(3), np.eye(3))], [rail])
    scene = Scene("hanging", mechanism, 1.0, 0.1, gravity=-G * Z)
    with pytest.raises(
        NewtonEulerError,
        match="scene 'hanging': has no equilibrium on the branch of its start: coordinate 'rail'",
    ):
        equilibrium(scene)
    state = equilibrium(replace(scene, forces=(JointSpring("rail", STIFFNESS),)))
    assert state.position[1, 2] == pytest.approx(-MASS * G / STIFFNESS, rel=1e-12)


def test_states_that_cannot_be(tracker):
    state = initial_state(tracker)
    apart = replace(state, position=state.position + 0.01 * np.arange(21).reshape(7, 3))
    with pytest.raises(NewtonEulerError, match=r"joint '.*' is open by .* needed: closed loops"):
        linearize(tracker, apart)
    torn = replace(state, linear_velocity=state.linear_velocity + 0.01 * np.arange(21).reshape(7, 3))
    with pytest.raises(NewtonEulerError, match=r"joint '.*' opens at .* needed: closed loops"):
        linearize(tracker, torn)


@pytest.mark.slow
def test_equilibrium_holds_prescribed_motions_where_they_begin(tracker):
    motion = PrescribedMotion("slide_13", Polynomial((0.005, 0.02)))
    scene = replace(tracker, control=tracker.control[:1], motions=(motion,))
    held = at_rest(scene)
    state = equilibrium(scene)
    model = linearize(held, state, outputs=["slide_12", "slide_13"])
    assert model.is_equilibrium
    assert model.coordinates == ("slide_12",)
    assert pytest.approx([0.0, 0.0], abs=1e-15) == model.C[1]
    system = Relative(held)
    measured = system.measured(*system.coordinates(state))
    assert measured["slide_12", 0].x == pytest.approx(tracker.control[0].target, abs=1e-12)
    assert measured["slide_13", 0].x == pytest.approx(0.005, abs=1e-12)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"coordinates": ["slide_12"]}, "coordinates are 'slide_12'; needed: 2 different ones for 2 degrees"),
        ({"coordinates": ["slide_12", "slide_12"]}, "needed: 2 different ones for 2 degrees of freedom"),
        ({"coordinates": ["slide_12", "ball_67"]}, "joint 'ball_67': coordinate is 0; needed: a joint with"),
        ({"coordinates": ["slide_12", "slide_14"]}, "unknown joint 'slide_14'; did you mean"),
        (
            {"inputs": ["slide_12.targets"]},
            "input 'slide_12.targets'; did you mean 'slide_12.target'",
        ),
        ({"outputs": ["panel"]}, "unknown output 'panel'; did you mean 'panel_7'"),
        ({"state": 3}, "state is 3; needed: a State"),
    ],
)
def test_choices_that_cannot_be(tracker, arguments, message):
    with pytest.raises(NewtonEulerError, match=message):
        linearize(tracker, **arguments)


def test_coordinates_that_do_not_determine_the_motion_at_a_state():
    """The slider of a crank at its dead center."""
    crank = replace(load("slider_crank"), initial_state=None)
    dead = start(crank, pivot=(np.pi - np.arctan2(0.1, 0.12), 0.0))
    with pytest.raises(NewtonEulerError, match="singular at joint 'guide': the coordinate depends on loops"):
        linearize(crank, initial_state(dead), ["guide"])
    assert linearize(crank, initial_state(dead)).coordinates != ("guide",)
