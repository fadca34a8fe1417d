"""Overconstrained loops whose constraints are redundant in another way in every configuration.

Any rows that imply the others become dependent somewhere within a revolution, while the rank of all rows
stays the same: nothing there is singular.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hanging_chains import hanging_chain
from overconstrained import LOOPS, SPEED, centers, linkage, side_by_side
from scipy.optimize import minimize_scalar

import newton_euler
from crosscheck.engines.registry import ENGINES
from crosscheck.library import load
from newton_euler.compiled.constraint_groups import constraint_groups
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.redundancy import mobility
from newton_euler.equations.relative import Relative
from newton_euler.equations.row_choice import exchangeable_rows, exchanged
from newton_euler.equations.system import dimensionless_jacobian
from newton_euler.integrators.options import Options
from newton_euler.model.joint_kinds import Revolute
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.state import State
from newton_euler.runs.simulate import run as run_system
from newton_euler.runs.variation import start

FORMULATIONS = ("relative", "cartesian")
# in Cartesian form, most take 7 to 9 s to compile
QUICK = ("bennett",)
USUAL = ("bennett", "schatz")
"""Of four and six hinges; those of five are in other fast tests."""

CASES = [
    *((name, "relative") for name in USUAL),
    *(pytest.param(name, "relative", marks=pytest.mark.slow) for name in LOOPS if name not in USUAL),
    *((name, "cartesian") for name in QUICK),
    *(pytest.param(name, "cartesian", marks=pytest.mark.slow) for name in LOOPS if name not in QUICK),
]
POSES = frozenset[str]()


def error(run, name):
    return np.abs(run.position[:, 1:] - centers(name)).max()


@pytest.mark.parametrize("name", LOOPS)
def test_every_choice_of_rows_degenerates_within_a_revolution(name):
    """And all rows together do not: what the other tests are about."""
    scene = linkage(name)
    run = newton_euler.simulate(replace(scene, outputs=POSES, output_period=0.005), "relative")
    decided = mobility(scene)
    system, rank = Relative(scene, 0.0), len(decided.independent)
    values = []
    still = np.zeros((len(scene.mechanism.bodies), 3))
    for position, quaternion in zip(run.position, run.quaternion, strict=True):
        state = State(position, quaternion, still, still)
        jacobian = dimensionless_jacobian(system, system.coordinates(state)[0])
        assert np.linalg.svd(jacobian)[1][rank - 1] > 0.1
        values.append(np.linalg.svd(jacobian[decided.independent])[1][-1])
    assert min(values) < 0.1 * max(values)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "formulation"), CASES)
def test_adaptive_methods_keep_their_tolerance(name, formulation):
    """Ten tolerances of 20 to 1200 steps; without projection joints open, which grows over the run."""
    scene = replace(linkage(name), outputs=POSES)
    for options, allowed in (
        ({"rtol": 1e-6, "atol": 1e-8}, 1e-5),
        ({}, 1e-9),
        ({"rtol": 1e-11, "atol": 1e-13}, 1e-10),
        ({"stabilization": "baumgarte"}, 1e-9),
        ({"stabilization": "none"}, 1e-6),
        ({"integrator": "Radau", "rtol": 1e-8, "atol": 1e-10}, 1e-9),
    ):
        assert error(newton_euler.simulate(scene, formulation, **options), name) < allowed, options


@pytest.mark.parametrize("rtol", [1e-6, 1e-7])
@pytest.mark.parametrize("name", ["bennett", "goldberg"])
def test_a_step_that_projection_changes_by_more_than_the_tolerance_is_rejected(name, rtol):
    """Error estimates alone let a step pass whose end was 3 to 15 tolerances off the constraints."""
    scene = replace(linkage(name), outputs=POSES)
    run = newton_euler.simulate(scene, "relative", rtol=rtol, atol=0.1 * rtol)
    assert error(run, name) < 1.2 * rtol


@pytest.mark.parametrize("integrator", ["DOP853", "Radau"])
@pytest.mark.parametrize("speed", [0.0, 1000.0])
@pytest.mark.parametrize("rtol", [1e-6, 1e-7])
def test_a_rotor_beside_a_linkage_does_not_change_its_error(rtol, speed, integrator):
    """The norm of all velocities is a hundred times that of the linkage's."""
    scene = linkage("goldberg")
    rotor = Body("rotor", 1.0, [0.0, 3.0, 0.0], 0.01 * np.eye(3))
    axle = Revolute("axle", "ground", "rotor", [0.0, 3.0, 0.0], axis=np.array([1.0, 0.0, 0.0]))
    mechanism = Mechanism([*scene.mechanism.bodies, rotor], [*scene.mechanism.joints, axle])
    scene = start(
        replace(scene, mechanism=mechanism, initial_state=None, outputs=POSES),
        h0=(0.0, SPEED),
        axle=(0.0, speed),
    )
    wanted = centers("goldberg")
    run = newton_euler.simulate(scene, "relative", integrator, rtol=rtol, atol=0.1 * rtol)
    allowed = {"DOP853": 1.2, "Radau": 10.0}[integrator]  # of more steps, each one tolerance
    assert np.abs(run.position[:, 1:-1] - wanted).max() < allowed * rtol


@pytest.mark.parametrize("formulation", [Relative, Cartesian])
def test_groups_are_those_of_the_loops(formulation):
    """Two linkages share no coordinate; a pendulum of two bars is held by its joints alone."""
    system = formulation(side_by_side(["bennett", "goldberg"]), 0.0)
    groups, count = constraint_groups(system), 3 + 4
    of_v, each = groups[system.nq :], system.nv // count
    if formulation is Relative:  # hinges: those of the cuts have no coordinates
        assert sorted(of_v) == [1.0] * 3 + [2.0] * 4
    else:
        assert [*of_v] == [1.0] * 3 * each + [2.0] * 4 * each
    assert sorted(groups[: system.nq]) == sorted(of_v)
    chain = constraint_groups(formulation(hanging_chain([1.0, 1.0], 0.5, 1.0, 1.0), 0.0))
    assert {*chain} == ({0.0} if formulation is Relative else {1.0})


@pytest.mark.parametrize("engine", list(ENGINES.values()), ids=lambda engine: engine.name)
@pytest.mark.parametrize("name", ["bennett", pytest.param("goldberg", marks=pytest.mark.slow)])
def test_equations_that_python_evaluates_keep_their_tolerance(name, engine):
    """Ten tolerances, by dense forms that know the rank of the constraints."""
    scene = replace(linkage(name), outputs=POSES)
    for system in engine.systems(scene):
        assert error(run_system(system, engine.name, Options.of("DOP853", {}), {}), name) < 1e-9


@pytest.mark.parametrize(("name", "formulation"), CASES)
def test_rk4_keeps_its_order(name, formulation):
    scene = replace(linkage(name), outputs=POSES)
    coarse, fine = (
        error(newton_euler.simulate(scene, formulation, "RK4", step=step), name) for step in (4e-3, 2e-3)
    )
    assert coarse / fine == pytest.approx(16.0, rel=0.5)


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_steps_do_not_depend_on_the_output_period(formulation):
    scene = replace(linkage("bennett"), outputs=POSES)
    runs = [
        newton_euler.simulate(replace(scene, output_period=period), formulation, rtol=1e-12, atol=1e-14)
        for period in (0.1, 0.05, 0.01, 0.001)
    ]
    assert len({run.settings["steps"] for run in runs}) == 1
    for run in runs[1:]:
        assert np.array_equal(run.position[-1], runs[0].position[-1])


@pytest.mark.parametrize(
    ("integrator", "formulation"),
    [
        *((integrator, "relative") for integrator in ("DOP853", "RK4", "Euler", "Radau")),
        ("DOP853", "cartesian"),
        *(
            pytest.param(integrator, "cartesian", marks=pytest.mark.slow)
            for integrator in ("RK4", "Euler", "Radau")
        ),
    ],
)
def test_runs_side_by_side_exchange_rows_each_by_itself(integrator, formulation):
    """Results are those of single runs to the last bit, though rows are exchanged at other times in each."""
    scene = replace(linkage("bennett"), outputs=POSES)
    masses = [0.3, 0.4, 0.5, 0.6, 0.9, 1.2, 2.0, 3.0, 5.0]
    options = {"formulation": formulation, "integrator": integrator}
    options |= {"step": 2e-3} if integrator in ("RK4", "Euler") else {"rtol": 1e-8}
    batch = newton_euler.simulate_batch(scene, parameters={"b1.mass": masses}, **options)
    assert not batch.errors
    for mass, run in zip(masses, batch, strict=True):
        (alone,) = newton_euler.simulate_batch(scene, parameters={"b1.mass": [mass]}, **options)
        assert np.array_equal(run.position, alone.position)


@pytest.mark.parametrize(
    ("name", "formulation"),
    [
        ("bennett", "relative"),
        ("bennett", "cartesian"),
        ("schatz", "relative"),
        pytest.param("schatz", "cartesian", marks=pytest.mark.slow),
    ],
)
def test_sensitivities_are_those_of_difference_quotients(name, formulation):
    scene = replace(linkage(name), outputs=POSES)
    found = newton_euler.sensitivities(scene, ["b1.mass"], formulation=formulation)
    h, own = 1e-3, scene.mechanism.bodies[2].mass
    values = own + h * np.array([-2.0, -1.0, 1.0, 2.0])
    options = {"rtol": 1e-12, "atol": 1e-14, "formulation": formulation}
    a, b, c, d = newton_euler.simulate_batch(scene, parameters={"b1.mass": values}, **options).stacked(
        "position"
    )
    wanted = (8.0 * (c - b) - (d - a)) / (12.0 * h)
    # of runs to 1e-12, and h^4 of their fifth derivative
    assert found.position[..., 0] == pytest.approx(wanted, abs=1e-7 * np.abs(wanted).max())


@pytest.mark.parametrize("formulation", ["relative", pytest.param("cartesian", marks=pytest.mark.slow)])
def test_several_linkages_move_as_each_alone(formulation):
    """Of 15 exchangeable rows shares are looked at in sums."""
    names = ["bennett", "goldberg", "bennett"]
    scene = replace(side_by_side(names), outputs=POSES)
    run = newton_euler.simulate(scene, formulation)
    wanted = np.concatenate([centers(name) for name in names], axis=1)
    assert np.abs(run.position[:, 1:] - wanted).max() < 1e-9


def test_knots_do_not_forget_the_rows_in_use():
    """A law without gain, whose target jumps, divides the run, and moves nothing."""
    law = newton_euler.PD("h0", 0.0, 0.0, newton_euler.Steps((0.0, 0.31, 0.62, 0.93), (0.0, 0.1, 0.2, 0.3)))
    scene = replace(linkage("goldberg"), control=[law], outputs=POSES)
    assert error(newton_euler.simulate(scene), "goldberg") < 1e-9


@pytest.mark.parametrize(("name", "formulation"), CASES)
def test_control_laws_that_know_the_mechanism_exchange_rows_too(name, formulation):
    """Where gravity is compensated, kinetic energy stays: to ten tolerances."""
    law = newton_euler.PD("h0", 0.0, 0.0, 0.0, gravity_compensation=True)
    scene = replace(linkage(name), control=[law], outputs=frozenset({"velocities", "energy"}))
    run = newton_euler.simulate(scene, formulation, rtol=1e-12, atol=1e-14)
    assert run.kinetic_energy == pytest.approx(run.kinetic_energy[0], rel=1e-11)


def test_states_where_the_first_rows_are_dependent_are_like_their_neighbors():
    """Of inverse dynamics and linear models: what they find there is what four states beside it say."""
    scene = linkage("bennett")
    system, used = Relative(scene, 0.0), mobility(scene).independent

    def states(times):
        end = replace(scene, duration=max(times), output_period=max(times))
        for time in times:
            run = newton_euler.simulate(
                replace(end, duration=time, output_period=time), rtol=1e-13, atol=1e-15
            )
            arrays = run.position, run.quaternion, run.linear_velocity, run.angular_velocity
            yield State(*(array[-1] for array in arrays))

    def smallest(state):
        jacobian = dimensionless_jacobian(system, system.coordinates(state)[0])
        return np.linalg.svd(jacobian[used])[1][-1]

    whole = newton_euler.simulate(replace(scene, duration=1.1, output_period=0.02), rtol=1e-13, atol=1e-15)
    coarse = whole.time[min(range(5, len(whole.time)), key=lambda k: smallest(whole.state(k)))]
    found = minimize_scalar(
        lambda time: smallest(*states([time])),
        bounds=(coarse - 0.02, coarse + 0.02),
        method="bounded",
        options={"xatol": 1e-9},
    )
    assert found.fun < 1e-6
    near = list(states(found.x + 1e-3 * np.array([0.0, -2.0, -1.0, 1.0, 2.0])))
    for evaluate in (
        lambda state: newton_euler.inverse_dynamics(scene, state, {"h0": 0.0}).actuator_force[0],
        lambda state: newton_euler.linearize(scene, state).A[1, 0],
    ):
        own, *others = map(evaluate, near)
        # h^4 of the fourth derivative at 7 rad/s
        assert own == pytest.approx(np.dot([-1.0, 4.0, 4.0, -1.0], others) / 6.0, rel=1e-6)


def test_reactions_at_all_outputs_come_from_one_set_of_equations(monkeypatch):
    """Equations with other parameter values are expensive to set up."""
    compiled, made = newton_euler.compile_scene(linkage("bennett"), parameters=["gravity"]), []
    make = type(compiled).float_system
    monkeypatch.setattr(type(compiled), "float_system", lambda *given: made.append(make(*given)) or made[-1])
    run = compiled.simulate()
    assert len(made) < 3 < len(run.time)


def test_where_shares_are_constant_no_rows_are_exchangeable():
    """Plane loops in space, redundant in the same way everywhere: their equations have no flags."""
    for name in ("four_bar", "andrews", "stewart", "tracker"):
        scene = load(name)
        for system in (Relative(scene, 0.0), Cartesian(scene, 0.0)):
            assert exchangeable_rows(system).numbers == []


@pytest.mark.parametrize("name", LOOPS)
def test_both_forms_exchange_the_same_rows(name):
    scene = linkage(name)
    relative, cartesian = (exchangeable_rows(system(scene, 0.0)) for system in (Relative, Cartesian))
    first = cartesian.numbers[0] - relative.numbers[0]
    assert cartesian.numbers == [row + first for row in relative.numbers]
    assert cartesian[1:] == relative[1:]
    assert 0.0 < sum(relative.left_out) < len(relative.numbers)


def test_exchanged_rows_have_the_largest_volume_near_by():
    """No single exchange makes the volume 1.1 times as large; rows that always count keep doing so."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        jacobian = rng.normal(size=(9, 4)) @ rng.normal(size=(4, 6))
        units, rows = rng.uniform(0.5, 2.0, 7), [0, 2, 3, 4, 6, 7, 8]
        flags = exchanged(jacobian, rows, units, np.array([0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0]))
        assert flags.sum() == 5.0

        def volume(flags, jacobian=jacobian, units=units, rows=rows):
            used = np.flatnonzero(flags == 0.0)
            chosen = np.vstack([jacobian[[rows[k] for k in used]] / units[used, None], jacobian[[1, 5]]])
            return np.sqrt(np.linalg.det(chosen @ chosen.T))

        own = volume(flags)
        for used in np.flatnonzero(flags == 0.0):
            for out in np.flatnonzero(flags == 1.0):
                other = flags.copy()
                other[used], other[out] = 1.0, 0.0
                assert volume(other) <= 1.1 * own
