"""Sensitivities against finite differences, of every kind of element, and beside runs without them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from armed_scenes import COMPOUNDS, armed
from ball_scenes import with_balls
from elements import driven_loop, forced, geared_loop, planar_loop, rod_loop, windy
from finite_difference import derivative
from mechanisms import ball_loop, carts, line_spring, mass_on_rail, pendulum

from crosscheck.library import load
from newton_euler import compile_scene, equilibrium, sensitivities, simulate_batch, start, with_parameters
from newton_euler.analysis.sensitivity.tangent_code import tangent_code
from newton_euler.analysis.sensitivity.tangent_run import TangentRun
from newton_euler.analysis.sensitivity.tangent_starts import Starts, own_numbers
from newton_euler.equations.parameter_names import places
from newton_euler.equations.parameters import parameter_values
from newton_euler.integrators.options import Options
from newton_euler.model.control import PD, ComputedTorque, StateFeedback
from newton_euler.model.couplings import LinearCoupling
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.motions import Polynomial, Sine, Spline, Steps, Sum
from newton_euler.runs.initial_coordinates import initial_numbers, own_initial

TIGHT = {"rtol": 1e-13, "atol": 1e-15}

STEPS = (1e-2, 1e-3, 2e-4)
"""Of finite differences, as shares of the values; the best of them counts."""

ROUND_OFF = 1e-11
"""SI, of the longest differences of runs to 1e-13, of numbers of order 1."""

CENTRAL = {-3: -1 / 60, -2: 9 / 60, -1: -45 / 60, 1: 45 / 60, 2: -9 / 60, 3: 1 / 60}
"""Weights of the central difference of order 6."""

ARRAYS = (
    "position",
    "quaternion",
    "linear_velocity",
    "angular_velocity",
    "reaction_force",
    "reaction_torque",
    "actuator_force",
    "kinetic_energy",
    "potential_energy",
    "work",
)


def short(scene, duration=0.3):
    return replace(scene, duration=duration, output_period=duration / 3)


def carts_along_functions():
    """Targets that jump, splines and feedback, on rails that nothing else connects."""
    rng = np.random.default_rng(2)
    jumps = Steps(times=(0.0, 0.07, 0.13), values=(0.1, 0.4, -0.2))
    spline = Spline(times=tuple(np.linspace(0.0, 0.3, 9)), values=tuple(rng.normal(size=9)))
    moving = Sum((Sine(0.3, 9.0, offset=0.1), Polynomial((0.2, 1.0))))
    feedback = StateFeedback(
        "rail_0", {"rail_0": (30.0, 4.0), "rail_1": (5.0, 2.0)}, target=jumps, feedforward=moving
    )
    return carts(feedback, PD("rail_1", 40.0, 3.0, spline, feedforward=jumps), duration=0.3)


def coupled_carts():
    """A sum of the coordinates of two carts that stays 0, pulled at by both."""
    scene = carts(PD("rail_0", 40.0, 3.0, 0.2), PD("rail_1", 30.0, 1.0, Sine(0.3, 9.0)), duration=0.3)
    coupling = LinearCoupling("sum", (("rail_0", 0, 1.0), ("rail_1", 0, 0.5)))
    return replace(scene, mechanism=Mechanism(scene.mechanism.bodies, scene.mechanism.joints, (coupling,)))


def hung(law, *forces):
    """A mass on a vertical rail that a law moves, under gravity."""
    return mass_on_rail(*forces, gravity=(0.0, 0.0, -9.81), control=(law,))


def light_crank():
    """A crank of a gram that passes a dead center, at 2.447 rad."""
    scene = short(start(load("slider_crank"), pivot=(2.15, 6.0)), 0.1)
    return with_parameters(scene, {"crank.mass": 1e-3, "crank.inertia": np.diag([1e-6, 1e-6, 1e-7])})


TRACKER = (
    "ball_57.point",
    "hinge_14.axis",
    "panel_7.center_of_mass",
    "panel_7.mass",
    "panel_7.inertia",
    "start.slide_12",
    "start.slide_13.rate",
)

LOOP = ("crank.center_of_mass", "ball.point", "pivot.axis", "wrist.point_on_first", "start.pivot", "rod.mass")

SCENES = {
    "tracker": (short(load("tracker_gravity"), 0.5), TRACKER),
    "slider crank": (short(load("slider_crank")), LOOP),
    # so light that the Cartesian form, solved without its second step, is off by 1e-5
    "light body": (short(with_parameters(load("slider_crank"), {"crank.mass": 3e-10})), LOOP),
    # pivots with masses nearly vanish
    "light crank": (light_crank(), ("ball.point.x", "pivot.axis", "rod.mass")),
    "rate of the start": (short(load("slider_crank")), ("start.pivot.rate", "pivot.point.z")),
    "gear": (short(geared_loop()), ("chain.ratio", "gravity")),
    "coupling": (coupled_carts(), ("sum.terms", "rail_0.target", "rail_1.target", "start.rail_0.rate")),
    "rods": (short(rod_loop()), ("coupler.length", "stay.length", "bob.quaternion")),
    "springs and wrenches": (short(forced(planar_loop())), ()),
    "rotors": (short(armed(ball_loop())), ()),
    "balls": (short(with_balls(ball_loop())), ()),
    "compound joints": (short(armed(COMPOUNDS["compound, cut"])), ()),
    "computed torque": (
        short(hung(ComputedTorque("rail", 30.0, 4.0, Sine(0.3, 9.0), model={"mass.mass": 3.0}))),
        ("mass.mass", "gravity.z", "start.rail"),
    ),
    "gravity compensation": (
        short(hung(PD("rail", 40.0, 3.0, 0.2, gravity_compensation=True), line_spring(rest_length=1.8))),
        ("mass.mass", "gravity.z", "line.stiffness", "start.rail"),
    ),
    "wind": (short(windy(pendulum())), ("wind.speed", "wind.air_density", "wind.direction")),
    "functions of time": (short(carts_along_functions()), ()),
    "screw and prescribed motion": (
        short(driven_loop()),
        ("at_c.pitch", "at_c.1.motion.function", "at_a.axis", "coupler.mass"),
    ),
}


def numbers_of(value):
    """Flatten a value, a symmetric matrix to its upper triangle."""
    return value[np.triu_indices(3)] if value.shape == (3, 3) else value.ravel()


def is_geometry(scene, name):
    return any(place.field.moves_loops for place in places(scene, [name]).values())


def single_directions(values):
    """Yield directions, values by name, each of one number alone, by as much as the largest of its parameter.

    Inertias grow as a whole: thin rods allow no other change.
    """
    still = {name: np.zeros(value.shape) for name, value in values.items()}
    for name, value in values.items():
        if name.endswith("inertia"):
            yield still | {name: value}
            continue
        for index in np.ndindex(*value.shape):
            along = np.zeros(value.shape)
            along[index] = np.abs(value).max() or 0.1
            yield still | {name: along}


def by_differences(batch, array):
    """Differentiate an array of runs that are `moved`, by each of k steps along each of d directions."""
    stacked = batch.stacked(array)
    runs = stacked.reshape(len(STEPS), -1, len(CENTRAL), *stacked.shape[1:])
    weights = np.array(list(CENTRAL.values())) / np.array(STEPS)[:, None]
    return np.einsum("km,kdm...->kd...", weights, runs)


def moved(values, directions):
    """Return values (runs, ...) by name, moved along each direction alone, by all steps."""
    ways = [(s * k, direction) for s in STEPS for direction in directions for k in CENTRAL]
    return {name: np.array([value + s * way[name] for s, way in ways]) for name, value in values.items()}


QUICK = ("coupling",)
"""Scenes whose Cartesian form is tested with the fast tests; others take 2 to 10 s to compile."""

CASES = [
    *((name, "relative") for name in SCENES),
    *((name, "cartesian") for name in QUICK),
    *(pytest.param(name, "cartesian", marks=pytest.mark.slow) for name in SCENES if name not in QUICK),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "formulation"), CASES)
def test_derivatives_are_those_of_finite_differences(name, formulation):
    """By each number alone, to 1e-7 of an array's largest derivative by it.

    Runs to 1e-13 leave 1e-9 of the array in differences by the shortest step.
    """
    scene, chosen = SCENES[name]
    initial = initial_numbers(scene, chosen)
    values = parameter_values(scene, [each for each in chosen if each not in initial] or None)
    if not chosen:
        values = {each: value for each, value in values.items() if not is_geometry(scene, each)}
    values |= {each: np.array(own_initial(scene, number)) for each, number in initial.items()}
    directions = list(single_directions(values))
    found = sensitivities(scene, list(values), formulation, **TIGHT)
    batch = simulate_batch(scene, parameters=moved(values, directions), formulation=formulation, **TIGHT)
    weights = [np.concatenate([numbers_of(value) for value in way.values()]) for way in directions]
    wrong = []
    for array in ARRAYS:
        derived, of_run = getattr(found, array), getattr(found.run, array)
        if derived is None or not derived.size:
            continue
        least = max(1e-9 * np.abs(of_run).max(), ROUND_OFF) / 1e-7
        for number, by_step in enumerate(np.moveaxis(by_differences(batch, array), 1, 0)):
            found_here = derived @ weights[number]
            error = min(np.abs(found_here - each).max() / max(np.abs(each).max(), least) for each in by_step)
            moving = {name: along for name, along in directions[number].items() if along.any()}
            wrong += [(array, moving, error)] * (not error < 1e-7)
    assert wrong == []


@pytest.mark.slow
def test_values_beside_those_of_the_scene():
    """The run is that of a batch, and derivatives are those of one: starts go on from the scene's own."""
    scene = short(load("slider_crank"), 1.0)
    found = sensitivities(scene, {"rod.mass": 0.5, "ball.point": [0.0, 0.11, 0.19]}, **TIGHT)
    assert found.parameters == ("rod.mass", "ball.point.x", "ball.point.y", "ball.point.z")

    def motion(mass, height):
        values = {"rod.mass": [mass], "ball.point": [[0.0, 0.11, height]]}
        return simulate_batch(scene, parameters=values, **TIGHT)[0].position

    assert np.array_equal(found.run.position, motion(0.5, 0.19))
    by_mass = derivative(lambda s: motion(0.5 + s, 0.19), 1e-3)
    by_height = derivative(lambda s: motion(0.5, 0.19 + s), 1e-4)
    # round-off of runs to 1e-13 over these steps, see finite_difference.derivative
    assert np.abs(found.position[..., 0] - by_mass).max() < 1e-10
    assert np.abs(found.position[..., 3] - by_height).max() < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("formulation", ["relative", "cartesian"])
def test_tangents_stay_on_the_linearized_constraints(formulation):
    """Every few steps and at outputs: Phi_q S + Phi_p = 0 and its rate, to round-off."""
    scene = short(load("slider_crank"), 1.0)
    names = ("rod.mass", "ball.point.x", "start.pivot", "gravity.z")
    code = tangent_code(scene, names, formulation)
    start, directions = Starts(code, names)(own_numbers(scene, names))
    found = TangentRun(code, Options(rtol=1e-6, atol=1e-8), ("surface",))(start, directions)
    rows = 2 * len(code.system.phi_units)
    open_by = np.abs(found.derivatives["surface"][:, :rows])
    # round-off of tangents of order 1 times entries of the Jacobian and its rate, up to 10
    assert np.abs(directions[: code.size]).max() > 0.01
    assert open_by.max() < 1e-13


def test_the_run_is_a_plain_one():
    """To the last bit, and rooms of steps that are too small change nothing."""
    scene = short(load("slider_crank"), 1.0)
    found = sensitivities(scene, ["crank.mass"])
    plain = compile_scene(scene, parameters=["crank.mass"]).simulate()
    assert found.run.arrays().keys() == plain.arrays().keys()
    assert all(np.array_equal(array, plain.arrays()[name]) for name, array in found.run.arrays().items())


def test_long_runs_are_followed_twice(monkeypatch):
    """Steps beyond the room at first are taken once more."""
    scene = short(load("slider_crank"), 1.0)
    found = sensitivities(scene, ["crank.mass"])
    monkeypatch.setattr("newton_euler.analysis.sensitivity.tangent_run.RECORDED_STEPS", 3)
    assert found.run.settings["steps"] > 3
    assert np.array_equal(found.position, sensitivities(scene, ["crank.mass"]).position)


@pytest.mark.slow
def test_rolled_code_and_single_directions_give_the_same(monkeypatch):
    """Of scenes that are large, and by one parameter at a time."""
    scene, names = short(load("slider_crank")), ["crank.mass", "ball.point.z"]
    found = sensitivities(scene, names).linear_velocity
    one_by_one = np.concatenate([sensitivities(scene, [name]).linear_velocity for name in names], axis=-1)
    monkeypatch.setattr("newton_euler.codegen.compile.MIN_ROLLED_SIZE", 200)
    monkeypatch.setattr("newton_euler.analysis.sensitivity.tangent_code.MIN_ROLLED_SIZE_IN_LANES", 0)
    rolled = sensitivities(replace(scene), names).linear_velocity  # another object, compiled anew
    largest = np.abs(found).max()
    # round-off of steps that the same accelerations with other round-off make
    assert np.abs(one_by_one - found).max() < 1e-9 * largest
    assert np.abs(rolled - found).max() < 1e-9 * largest


def test_joint_coordinates_have_derivatives():
    """Those of coordinates and rates of the joint that the pendulum hangs on."""
    scene = short(pendulum())
    found = sensitivities(scene, ["gravity.z"], **TIGHT)

    def motion(s):
        moved = [-9.81 + s]
        return simulate_batch(scene, parameters={"gravity.z": moved}, **TIGHT)[0].joint("pivot")

    coordinates = derivative(lambda s: motion(s).coordinates, 1e-2)
    rates = derivative(lambda s: motion(s).rates, 1e-2)
    # see finite_difference.derivative; runs are to 1e-13
    assert np.abs(found.joint("pivot").coordinates[..., 0] - coordinates).max() < 1e-10
    assert np.abs(found.joint("pivot").rates[..., 0] - rates).max() < 1e-10


@pytest.mark.slow
def test_a_mechanism_in_equilibrium_has_derivatives():
    """The tracker, by the force of an actuator, against a central difference."""
    scene, name, step = load("tracker"), "slide_12.feedforward", 1e-2
    scene = replace(scene, initial_state=equilibrium(scene), duration=5.0, output_period=0.5)
    force = own_numbers(scene, [name])[0]
    low, high = simulate_batch(scene, parameters={name: [force - step, force + step]})
    difference = (high.joint("slide_12").coordinates - low.joint("slide_12").coordinates) / (2.0 * step)
    error = sensitivities(scene, [name]).joint("slide_12").coordinates[..., 0] - difference
    # the difference has 1e-10 of runs to 1e-12 over the step, of 0.02
    assert np.abs(error).max() < 1e-6 * np.abs(difference).max()
