"""Redundant constraints and mechanisms of any size: what is unique must not depend on either."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from constrained_motion import states_near_start
from mechanisms import (
    REGULAR,
    ball_loop,
    bolted,
    parallel_cranks,
    planar_four_bar,
    scaled,
    seven_hinges,
)
from overconstrained import LOOPS, linkage

import newton_euler
from crosscheck.engines.registry import ENGINES
from crosscheck.library import load
from crosscheck.studies.stress.configurations import with_flat_start
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.dense import independent_rows, minimum_norm, rank, solve_constrained
from newton_euler.equations.redundancy import mobility
from newton_euler.equations.relative import Relative
from newton_euler.equations.row_choice import rows_in_use
from newton_euler.equations.sparse import to_array
from newton_euler.equations.undetermined import undetermined
from newton_euler.errors import NewtonEulerError
from newton_euler.integrators.projection import project_position
from newton_euler.model.couplings import Gear
from newton_euler.model.euler_parameters import rotation
from newton_euler.model.joint_kinds import Fixed, Revolute, Spherical
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.parallel_hinges import ParallelHinges
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.reading.excitation import random_states
from newton_euler.runs.assemble import initial_state

FORMULATIONS = (Relative, Cartesian)


def systems(scene, *but):
    """All equations of motion, those of some engines left out."""
    chosen = (engine for engine in ENGINES.values() if engine.name not in but)
    return [system for engine in chosen for system in engine.systems(scene)]


def accelerations(system, state):
    at = system.evaluate(*system.coordinates(state))
    return np.array([at.linear_acceleration, at.angular_acceleration])


LEAST_INERTIA = 1e-14
"""kg m^2 of a body whose half MuJoCo takes: it refuses 1e-15."""


@pytest.mark.parametrize("factor", [1e-3, 1e-2, 1.0, 100.0, 1e3])
@pytest.mark.parametrize(
    "build", [planar_four_bar, ball_loop, seven_hinges, parallel_cranks], ids=lambda build: build.__name__
)
def test_accelerations_scale_with_the_mechanism(factor, build):
    scene = build()
    states = states_near_start(scene, 3)
    wanted = [accelerations(Relative(scene), state) for state in states]
    small = scaled(scene, factor)
    least = min(np.linalg.eigvalsh(body.inertia)[0] for body in small.mechanism.bodies[1:])
    for system in systems(small, *(["mujoco"] if least < LEAST_INERTIA else [])):
        for state, (linear, angular) in zip(states, wanted, strict=True):
            grown = replace(
                state, position=factor * state.position, linear_velocity=factor * state.linear_velocity
            )
            found = accelerations(system, grown)
            # dimensionless systems of condition below 1e5
            assert np.abs(found[0] / factor - linear).max() < 1e-10 * np.abs(linear).max(), system.name
            assert np.abs(found[1] - angular).max() < 1e-10 * np.abs(angular).max(), system.name


@pytest.mark.parametrize("kind", [Fixed, Spherical, Revolute], ids=lambda kind: kind.kind)
def test_a_second_bolt_changes_nothing(kind):
    """Its rows are round-off, or one row that says something among six."""
    axes = {"axis": [0.3, 0.5, -0.2]} if kind is Revolute else {}
    one, two = bolted(None), bolted(kind, **axes)
    for state in random_states(one, 3):
        wanted = accelerations(Relative(one), state)
        for system in systems(two):
            # condition below 1e4
            tolerance = 1e-11 if isinstance(system, FORMULATIONS) else 1e-10
            found = accelerations(system, state)
            for x, y in zip(found, wanted, strict=True):
                assert np.abs(x - y).max() < tolerance * np.abs(y).max(), system.name


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_redundant_reactions_are_the_smallest(formulation):
    """Of all multipliers with the same accelerations: orthogonal to those that do nothing."""
    system = formulation(planar_four_bar())
    state = random_states(system.scene, 1)[0]
    q, v = system.coordinates(state)
    if formulation is Cartesian:
        rows, units = system.Phi_q_and_B(q, v)[0], system.phi_units[: system.rows]
        multipliers = system.solve(q, v)[1]
    else:
        rows, units = system.phi_and_jacobian(q)[1], system.phi_units
        multipliers = system.solve(q, v)[1]
    left = (to_array(rows, system.nv) * system.velocity_units / units[:, None]).T
    _, s, vt = np.linalg.svd(left)
    idle = vt[np.sum(s > 1e-9) :]
    assert len(idle) == 3  # a flat loop in space has three equations too many
    assert np.abs(idle @ (units * multipliers)).max() < 1e-10 * np.abs(units * multipliers).max()


def test_rank_is_absolute_as_well_as_relative():
    assert rank(1e-15 * np.eye(3)) == 0
    assert rank(np.diag([1e6, 1.0, 1e-8])) == 2
    assert rank(np.zeros((0, 3))) == 0
    ones = np.ones(3)
    assert independent_rows(np.array([[1.0, 0, 0], [2.0, 0, 0], [0, 1e-14, 0]]), ones, ones).shape == (3, 1)
    x = minimum_norm(np.array([[1.0, 1.0, 0.0]]), np.array([2.0]), np.ones(1), np.array([1.0, 1.0, 5.0]))
    assert x == pytest.approx([1.0, 1.0, 0.0])


def test_no_more_combinations_than_the_rank_are_kept():
    ones, open_loop = np.ones(2), np.array([[1.0, 0.0], [1.0, 1e-7]])
    assert independent_rows(open_loop, ones, ones).shape == (2, 2)
    assert independent_rows(open_loop, ones, ones, max_rank=1).shape == (2, 1)


@pytest.mark.parametrize("gears", [(), (Gear("same", "foot_0", "foot_1", 1.0),)], ids=["loops", "gear"])
def test_open_redundant_loops_have_the_accelerations_of_closed_ones(gears):
    """Loops open by 1e-6 m have a larger rank; difference quotients and implicit stages look at such."""
    loops = parallel_cranks().mechanism
    scene = replace(parallel_cranks(), mechanism=Mechanism(loops.bodies, loops.joints, gears))
    state = random_states(scene, 1)[0]
    for system in systems(scene):
        q, v = system.coordinates(state)
        away = 1e-6 * np.random.default_rng(0).standard_normal(system.nv)
        closed, opened = system.acceleration(q, v), system.acceleration(system.retract(q, away), v)
        # 1e-6 times the derivative of accelerations, which is below 100 /s^2
        assert np.abs(opened - closed).max() < 1e-4, system.name


@pytest.mark.parametrize("build", REGULAR, ids=lambda build: build.__name__)
def test_assembly_closes_a_disturbed_state(build):
    scene = build()
    rng = np.random.default_rng(4)
    start = State.initial(scene.mechanism)
    loose = State(
        start.position
        + 1e-3 * rng.standard_normal(start.position.shape) * (start.position != 0.0).any(axis=1)[:, None],
        start.quaternion,
        rng.standard_normal(start.position.shape),
        rng.standard_normal(start.position.shape),
    )
    state = newton_euler.assemble(scene, loose)
    frames = state.frames()
    for equations in scene.mechanism.equations:
        i, j = frames[equations.first], frames[equations.second]
        assert np.abs(equations.phi(i, j)).max(initial=0.0) < 1e-14
        assert np.abs(equations.jacobian(i, j).rate(i, j)).max(initial=0.0) < 1e-13
    assert np.array_equal(state.position[0], start.position[0])
    assert np.abs(state.position - loose.position).max() < 1e-2  # no farther than it must
    assert initial_state(replace(scene, initial_state=state)) is state


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_a_flat_start_leaves_no_pivot_that_is_usually_zero(formulation):
    """A parallelogram that lies flat: one row is exactly zero there, and nowhere near."""
    thin = np.diag([1e-4, 0.02, 0.02])
    bodies = [
        Body.ground(),
        Body("crank", 1.0, [0.25, 0.0, 0.0], thin),
        Body("coupler", 1.0, [1.0, 0.0, 0.0], thin),
        Body("rocker", 1.0, [1.25, 0.0, 0.0], thin),
    ]
    joints = [
        Revolute("a", "ground", "crank", [0.0, 0.0, 0.0], axis=[0.0, 1.0, 0.0]),
        Revolute("b", "crank", "coupler", [0.5, 0.0, 0.0], axis=[0.0, 1.0, 0.0]),
        Revolute("c", "ground", "rocker", [1.0, 0.0, 0.0], axis=[0.0, 1.0, 0.0]),
        Spherical("d", "coupler", "rocker", [1.5, 0.0, 0.0]),
    ]
    scene = Scene("flat", Mechanism(bodies, joints), 1.0, 0.1, (0.0, 0.0, -9.81))
    rows = rows_in_use(formulation(scene))
    # of pivots that are 1 in a unit of their own; round-off is below 1e-15 of that
    assert min(rows.scales) > 1e-9 * max(rows.scales)
    with pytest.raises(NewtonEulerError, match=r"at t = 0 s: the run starts at rest at a singular.*joint '"):
        newton_euler.simulate(scene, "relative" if formulation is Relative else "cartesian")


@pytest.mark.parametrize("own", [False, True], ids=["a state of upright bars", "drawn flat"])
@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("windows", [2, 5])
def test_from_flat_bars_the_rows_are_those_of_upright_ones(windows, formulation, own):
    """Where bars lie flat a row a window is dependent that is not elsewhere."""
    upright = load("four_bar", N=windows)
    flat = with_flat_start(upright, windows)
    if own:
        flat = replace(flat, mechanism=drawn_at(flat.mechanism, initial_state(flat)))
    assert len(rows_in_use(formulation(flat)).numbers) == len(rows_in_use(formulation(upright)).numbers)
    assert len(mobility(flat).redundant) == len(mobility(upright).redundant)


def drawn_at(mechanism: Mechanism, state: State) -> Mechanism:
    """The mechanism of hinges with another state's pose as its own."""
    bodies = [
        replace(body, center_of_mass=state.position[k], quaternion=state.quaternion[k])
        for k, body in enumerate(mechanism.bodies)
    ]
    joints = []
    for joint in mechanism.joints:
        k = mechanism.body_index(joint.first)
        body, turned = mechanism.bodies[k], rotation(state.quaternion[k])
        arm = rotation(body.quaternion).T @ (joint.point - body.center_of_mass)
        point = state.position[k] + turned @ arm
        joints.append(replace(joint, point=point, point_on_second=point))
    return Mechanism(bodies, joints)


@pytest.mark.parametrize("name", LOOPS)
@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("size", [1e-6, 1e-3])
def test_redundant_rows_that_come_open_do_not_misdirect_projection(size, formulation, name):
    """Off the constraints redundant rows seem independent. The nearest closed pose is no farther than the one
    that the pose was moved from."""
    scene, rng = linkage(name), np.random.default_rng(1)
    system = formulation(scene)
    q, _ = system.coordinates(scene.initial_state)
    for _ in range(5):
        moved = system.retract(q, size * rng.normal(size=system.nv) * system.velocity_units)
        closed = project_position(system, moved)
        steps = ((step / system.velocity_units) for step in (closed - moved, moved - q))
        back, away = map(np.linalg.norm, steps)
        assert back < (1.0 + 10.0 * size) * away


def test_what_is_redundant_does_not_depend_on_masses():
    """The third row repeats the second but for a light body; the first row holds a heavy body."""
    mass, force = np.diag([1e4, 1.0, 1e-8]), np.array([1e4, 1.0, 0.0])
    jacobian = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 1e-5]])
    acceleration, _ = solve_constrained(mass, force, jacobian, np.zeros(3), np.ones(3), np.ones(3), 2)
    assert acceleration[0] == pytest.approx(0.0, abs=1e-12)  # round-off of 1 m/s^2, that of a free body


@pytest.mark.parametrize("axis", [[1.0, 2.0, 3.0], [-0.66, -0.75, -0.06], [0.3, -0.5, 0.8], [7.0, 0.2, 1.1]])
def test_a_gear_between_locked_hinges_holds_nothing(axis):
    """A pendulum of two bodies that are welded, and joined by two parallel hinges: its one freedom stays.

    Nothing but round-off turns the two hinges. Next to the weld, they add four redundant constraints, and the
    gear between them one more.
    """
    mechanism = Mechanism(
        [Body.ground(), *(Body(f"bar_{x}", 1.0, [x, 0.1, 0.2], 0.01 * np.eye(3)) for x in (0.1, 0.3))],
        [
            Revolute("pivot", "ground", "bar_0.1", [0.0, 0.0, 0.0], axis=axis),
            Fixed("weld", "bar_0.1", "bar_0.3", [0.2, 0.0, 0.1]),
            ParallelHinges(
                "pair", "bar_0.3", "bar_0.1", [0.31, 0.13, 0.02], axis=axis, offset=[0.1, 0.2, 0.7]
            ),
        ],
        couplings=[Gear("gear", "pair", "pair", ratio=-0.7, driver_coordinate=0, follower_coordinate=1)],
    )
    for angle in (0.0, 0.3, -1.1, 2.0):
        scene = newton_euler.start(Scene("locked", mechanism, 1.0, 0.1), pivot=(angle, 1.0))
        assert mobility(scene).degrees_of_freedom == 1
        assert undetermined(scene, scene.initial_state).shape[1] == 5
        two = [accelerations(system, scene.initial_state) for system in systems(scene)]
        for other in two[1:]:
            np.testing.assert_allclose(other, two[0], rtol=0.0, atol=1e-12)
