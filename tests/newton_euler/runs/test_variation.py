"""Numbers that vary from run to run: their names, checks of many runs at once, and the scene of one run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from armed_scenes import COMPOUNDS
from elements import ELEMENTS, JOINTS
from mechanisms import line_spring, mass_on_rail

from crosscheck.library import load
from newton_euler import simulate, simulate_batch, with_parameters
from newton_euler.equations.parameter_names import parameter_names, places, unambiguous
from newton_euler.equations.parameters import parameter_values, refusal
from newton_euler.errors import MAX_PROPOSED_NAMES, MechanismError, OptionError, UnknownNameError
from newton_euler.model.armatures import Armature
from newton_euler.model.compound_joint import Compound
from newton_euler.model.control import PD
from newton_euler.model.digital_control import Digital
from newton_euler.model.forces import JointSpring
from newton_euler.model.motions import Sum
from newton_euler.model.smooth_functions import Polynomial, Sine
from newton_euler.model.splines import Steps
from newton_euler.model.wind import WindLoad
from newton_euler.runs.variation import run_values, units_of


@pytest.fixture(scope="module")
def scene():
    """A mass on a rail with a bit of everything."""
    push = Sum((Sine(1.0, 7.0, offset=0.5), Polynomial((0.2, -1.0)), Steps((0.0, 0.1), (0.1, 0.2))))
    sides = {"first_side": [1.0, 0.0, 0.0], "second_side": [0.0, 0.5, 0.0]}
    wind = WindLoad("wind", "mass", [0.0, 0.0, 0.0], **sides, direction=[1.0, 0.0, 1.0], speed=9.0)
    return mass_on_rail(
        line_spring(rest_length=2.0),
        JointSpring("rail", 3.0, 0.2),
        wind,
        duration=0.3,
        gravity=(0.0, 0.0, -9.0),
        control=(PD("rail", 5.0, 0.1, 0.0, feedforward=push),),
        armatures=(Armature("rail", 0.3),),
    )


COMPONENTS = {
    "gravity.z": ("gravity", [0.0, 0.0, 0.04]),
    "mass.inertia.yx": ("mass.inertia", [[0.1, 0.04, 0.0], [0.04, 0.2, 0.0], [0.0, 0.0, 0.3]]),
    "rail.feedforward.1": ("rail.feedforward", [1.0, 0.04, 0.2, -1.0, 0.1, 0.2]),
    "wind.direction.x": ("wind.direction", [0.04, 0.0, 1.0]),
}
"""Names of components, and the whole value where such a component is 0.04."""


@pytest.mark.parametrize("name", COMPONENTS)
def test_a_component_is_a_number_of_the_whole_value(scene, name):
    base, whole = COMPONENTS[name]
    assert parameter_values(scene, [name])[name].shape == ()
    one, other = with_parameters(scene, {name: 0.04}), with_parameters(scene, {base: whole})
    for key, value in parameter_values(one).items():
        assert np.array_equal(value, parameter_values(other)[key])


@pytest.mark.parametrize(
    ("names", "error", "message"),
    [
        (["gravity.w"], UnknownNameError, "did you mean 'gravity'"),
        ([3], UnknownNameError, "unknown parameter 3"),
        (["mass.inertai.xx"], UnknownNameError, "did you mean 'mass.inertia'"),
        (["rail.feedforward.6"], UnknownNameError, "rail.feedforward"),
        (["rail.feedforward.offset"], UnknownNameError, "did you mean 'rail.feedforward.1'?"),
        (
            ["rail.feedforward.coefficients"],
            UnknownNameError,
            "did you mean 'rail.feedforward.2', 'rail.feedforward.3'?",
        ),
        (["duration"], MechanismError, "'duration': is the same in all runs"),
        (["mass.shapes"], MechanismError, "'mass.shapes': is what bodies look like"),
        (["forces[1].coordinate"], MechanismError, "is the index that selects a joint coordinate"),
        (["rail.feedforward.times"], MechanismError, "'rail.feedforward.times': is where runs are divided"),
        (["gravity", "gravity.z"], MechanismError, "another value by another name"),
        (["mass.inertia.xy", "mass.inertia.yx"], MechanismError, "another value by another name"),
        (["mass.mass", "bodies[1].mass"], MechanismError, "another value by another name"),
    ],
)
def test_names_are_checked(scene, names, error, message):
    with pytest.raises(error) as caught:
        parameter_values(scene, names)
    assert message in str(caught.value)


@pytest.mark.parametrize("name", ["nix", "mass.color", "bodies[1].mas"])
def test_of_an_unknown_name_few_near_ones_are_proposed(scene, name):
    with pytest.raises(UnknownNameError) as caught:
        parameter_values(scene, [name])
    assert 1 <= len(caught.value.valid) <= MAX_PROPOSED_NAMES < len(parameter_values(scene))


def test_a_component_stays_its_own_behind_further_elements(scene):
    assert unambiguous(scene, "mass.inertia.xy") == "bodies[1].inertia.xy"
    assert unambiguous(scene, "gravity.z") == "gravity.z"


BAD = {
    "mass.mass": (-1.0, "parameter 'mass.mass': is -1.0; needed: a positive mass"),
    "mass.inertia": (np.diag([1.0, 1.0, 3.0]), "principal moments are 1, 1, 3"),
    "mass.inertia.xx": (0.6, "parameter 'mass.inertia.xx': is 0.6: principal moments"),
    "rail.rotor.inertia": (0.0, "parameter 'rail.rotor.inertia': is 0.0; needed: "),
    "rail.spring.stiffness": (-1e-9, "parameter 'rail.spring.stiffness': is -1e-09; needed: "),
    "line.rest_length": (-1.0, "parameter 'line.rest_length': is -1.0; needed: "),
    "wind.direction": ([0.0, 0.0, 0.0], "a vector not of length 0"),
    "rail.feedforward.0": (1e308, "an acceleration that a double holds"),
    "rail.feedforward.angular_frequency": (1e16, "an acceleration that a double holds"),
    "wind.first_side": ([0.0, 0.0, 0.0], "a vector not of length 0"),
    "wind.second_side.x": (0.1, "perpendicular sides"),
    "mass.quaternion": (np.zeros(4), "quaternion is zero"),
    "gravity.z": (np.nan, "parameter 'gravity.z': is nan; needed: finite numbers"),
    "gravity": ([0.0, np.inf, 0.0], "parameter 'gravity': is [0.0, inf, 0.0]; needed: finite numbers"),
    "rail.target": ("left", "parameter 'rail.target': is 'left'; needed: finite numbers"),
}
"""Values that no scene has, and what is said about them."""


@pytest.mark.parametrize("name", BAD)
def test_a_bad_value_is_an_error_of_its_run_alone(scene, name):
    """The largest and the smallest of many, too, as runs are not judged one by one."""
    value, message = BAD[name]
    own = parameter_values(scene, [name])[name].tolist()
    found = run_values(scene, {name: [own, own, value, own], "line.damping": [0.1, 0.2, 0.3, 0.4]})
    assert list(found.errors) == [2]
    assert str(found.errors[2]).startswith("run 2: ")
    assert message in str(found.errors[2])
    assert np.array_equal(found.arrays[name][3], own)
    assert found.arrays["line.damping"].tolist() == [0.1, 0.2, 0.0, 0.4]


GEOMETRY_BAD = {
    "spindle.pitch": (0.0, "parameter 'spindle.pitch': is 0.0; needed: a finite number of meters per radian"),
    "pin.axis": ([0.0, 0.0, 0.0], "a non-zero axis"),
    "elbow.axis_on_first": ([1.0, 0.1, 0.0], "perpendicular axes"),
    "mesh.ratio": (0.0, "parameter 'mesh.ratio': is 0.0; needed: a finite number, not 0"),
    "table.axis": ([1.0, -0.3, 0.2], "slides of the plane jump"),
    "coupler.length": (-0.5, "parameter 'coupler.length': is -0.5; needed: "),
}
"""The same of geometry."""


@pytest.mark.parametrize("name", GEOMETRY_BAD)
def test_bad_geometry_is_an_error_of_its_run_alone(name):
    value, message = GEOMETRY_BAD[name]
    scene = next(each for each in JOINTS.values() if name in parameter_values(each))
    own = parameter_values(scene, [name])[name]
    found = run_values(scene, {name: [own, value, own + 0.0]})
    assert list(found.errors) == [1]
    assert message in str(found.errors[1])


def test_hinges_keep_their_side():
    """Where the axes of three hinges change hands the angle of the second one would jump."""
    scene = COMPOUNDS["compound, cut"]
    name, axis = next(
        (f"{joint.name}.{len(joint.slides) + 2}.axis", joint.hinges[2])
        for joint in scene.mechanism.joints
        if isinstance(joint, Compound) and len(joint.hinges) == 3
    )
    found = run_values(scene, {name: [axis, -axis]})
    assert list(found.errors) == [1]
    assert "where the angle of the second one jumps" in str(found.errors[1])


NO_NUMBERS = {
    "masked": np.ma.array([2.0, 3.0], mask=[False, True]),
    "'3.0'": [2.0, "3.0"],
    "b'3.0'": np.array([2.0, b"3.0"], dtype=object),
    "np.timedelta64(3,'s')": [2.0, np.timedelta64(3, "s")],
    "np.datetime64('2003')": [2.0, np.datetime64("2003")],
    "3j": [2.0, 3j],
    "int with too many digits": [2.0, 10**5000],
}
"""Values of which the second is no number, by how it is shown."""


@pytest.mark.parametrize("shown", NO_NUMBERS)
def test_what_is_no_number_is_no_value_of_its_run(scene, shown):
    found = run_values(scene, {"mass.mass": NO_NUMBERS[shown]})
    assert {run: error.problem for run, error in found.errors.items()} == {1: f"is {shown}"}


def test_the_rows_of_a_table_are_runs_by_their_order(scene):
    """Those that are left of a longer one have labels of their own."""
    column = pytest.importorskip("pandas").Series([2.0, np.nan, 3.0], index=[5, 6, 7])
    found = run_values(scene, {"mass.mass": column})
    assert (list(found.errors), found.arrays["mass.mass"][[0, 2]].tolist()) == ([1], [2.0, 3.0])


def test_bad_values_are_found_among_many(scene):
    values = np.random.default_rng(0).normal(0.5, 1.0, 2000)
    found = run_values(scene, {"mass.mass": values, "rail.target": values})
    assert sorted(found.errors) == np.flatnonzero(values < 0.0).tolist()


@pytest.mark.parametrize(
    "title", ["screw, cut", "forces, rods", "gear, cut", "wind, cut at a ball", "compound, skew"]
)
def test_values_are_refused_where_constructors_refuse_them(title):
    """Those of an element together, and one by one: zeros, others of the opposite sign, and far away."""
    scene, rng, runs = (ELEMENTS | COMPOUNDS)[title], np.random.default_rng(0), 20
    own, elements = parameter_values(scene), {}
    for name, place in places(scene, own).items():
        elements.setdefault(place.owner[:2], {})[name] = place.owner
    for owners in elements.values():
        values = {}
        for name in owners:
            each = (runs,) + (1,) * own[name].ndim
            factors, far = rng.choice([1.0, 0.0, -1.0, 1.001], each), rng.choice([0.0, 0.0, 0.1, 3.0], each)
            values[name] = factors * own[name] + far * rng.normal(size=(runs, *own[name].shape))
        for names in ([*owners], *([name] for name in owners)):
            rows = [{owners[name]: values[name][run] for name in names} for run in range(runs)]
            refused = [run for run, row in enumerate(rows) if refusal(scene, row)]
            assert sorted(run_values(scene, {name: values[name] for name in names}).errors) == refused, names


def test_a_batch_goes_on_without_its_bad_runs(scene):
    values = {"mass.mass": [2.0, -1.0, 3.0], "gravity.z": [-9.0, -9.0, -1.0]}
    batch = simulate_batch(scene, parameters=values)
    assert list(batch.errors) == [1]
    with pytest.raises(MechanismError, match=r"run 1: parameter 'mass.mass': is -1.0"):
        batch[1]
    assert np.all(np.isnan(batch.stacked("position")[1]))
    for run, mass, gravity in ((0, 2.0, -9.0), (2, 3.0, -1.0)):
        expected = simulate(with_parameters(scene, {"mass.mass": mass, "gravity.z": gravity}))
        # both are integrated to 1e-10, their code is not the same
        assert np.abs(batch[run].position - expected.position).max() < 1e-9


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"mass.mass": -1.0}, "positive mass"),
        ({"gravity": [0.0]}, "finite numbers of shape"),
        ("mass", "values is 'mass'; needed: a dictionary"),
    ],
)
def test_values_of_one_scene_are_checked(scene, values, message):
    with pytest.raises((MechanismError, OptionError), match=message):
        with_parameters(scene, values)


@pytest.fixture(scope="module")
def varied_one_by_one(scene):
    """Runs in each of which another number has a value of its own, compiled once."""
    own = parameter_values(scene, ALONE)
    values = {name: [own[name]] * len(ALONE) for name in ALONE}
    for k, (name, (value, _)) in enumerate(ALONE.items()):
        values[name][k] = value
    return simulate_batch(scene, parameters=values)


def with_force(scene, number, **fields):
    forces = list(scene.forces)
    forces[number] = replace(forces[number], **fields)
    return replace(scene, forces=tuple(forces))


def with_push(scene, number, **fields):
    (law,), terms = scene.control, list(scene.control[0].feedforward.terms)
    terms[number] = replace(terms[number], **fields)
    return replace(scene, control=(replace(law, feedforward=Sum(tuple(terms))),))


ALONE = {
    "rail.feedforward.angular_frequency": (9.0, lambda s: with_push(s, 0, angular_frequency=9.0)),
    "rail.feedforward.phase": (0.4, lambda s: with_push(s, 0, phase=0.4)),
    "rail.feedforward.5": (0.9, lambda s: with_push(s, 2, values=(0.1, 0.9))),
    "wind.first_side": ([1.5, 0.0, 0.0], lambda s: with_force(s, 2, first_side=[1.5, 0.0, 0.0])),
    "wind.second_side.y": (2.5, lambda s: with_force(s, 2, second_side=[0.0, 2.5, 0.0])),
    "wind.speed": (12.0, lambda s: with_force(s, 2, speed=12.0)),
    "line.rest_length": (1.5, lambda s: with_force(s, 0, rest_length=1.5)),
}
"""Numbers, another value, and the scene made anew with it."""


@pytest.mark.parametrize("name", ALONE)
def test_a_number_that_varies_alone(scene, varied_one_by_one, name):
    expected = simulate(ALONE[name][1](scene))
    found, plain = varied_one_by_one[list(ALONE).index(name)], simulate(scene)
    assert np.abs(expected.position - plain.position).max() > 1e-6
    # both are integrated to 1e-10, their code is not the same
    assert np.abs(found.position - expected.position).max() < 1e-9


def test_numbers_of_digital_laws(scene):
    """All but the force that is held, which a run sets and the list of names does not have."""
    law = Digital(PD("rail", 5.0, 0.1, 0.0), 0.01, 1, 0.1, 3.0, 4.0, (-1.0, 1.0))
    values = {"rail.period": 0.02, "rail.stroke.0": -0.5, "rail.slew_limit": 2.0, "rail.stiffness": 6.0}
    digital = replace(scene, control=(law,))
    assert {*values} - {"rail.stroke.0"} <= {*parameter_names(digital)}
    assert "rail.held" not in parameter_names(digital)
    found = with_parameters(digital, values).control
    stiff = replace(law.law, stiffness=6.0)
    assert found == (replace(law, law=stiff, period=0.02, stroke=(-0.5, 1.0), slew_limit=2.0),)
    for name, value in {"period": -1.0, "stroke": [1.0, -1.0], "force_limit": 0.0, "held": 1.0}.items():
        with pytest.raises(MechanismError, match=name):
            with_parameters(digital, {f"rail.{name}": value})


@pytest.mark.parametrize(
    ("scene", "name", "unit"),
    [
        ("tracker", "slide_12.stiffness", "N/m"),
        ("tracker", "slide_12.feedforward", "N"),
        ("tracker", "ball_57.point.z", "m"),
        ("tracker", "panel_7.inertia.xy", "kg m^2"),
        ("tracker", "hinge_14.axis", ""),
        ("tracker", "start.slide_12", "m"),
        ("tracker", "start.hinge_14.rate", "rad/s"),
        ("pendulum", "gravity.z", "m/s^2"),
    ],
)
def test_parameters_have_units(scene, name, unit):
    assert units_of(load(scene), [name]) == {name: unit}


def test_units_along_slides_are_those_of_lengths(scene):
    names = ("rail.spring.damping", "rail.rotor.inertia", "line.stiffness", "wind.speed")
    assert list(units_of(scene, names).values()) == ["N s/m", "kg", "N/m", "m/s"]
    assert units_of(scene, ["rail.feedforward.phase"]) == {"rail.feedforward.phase": "rad"}
    gusty = with_force(scene, 2, speed=Polynomial((9.0, 1.0)))
    assert units_of(gusty, ["wind.speed.1"]) == {
        "wind.speed.1": ""
    }  # m/s^2, and others of other coefficients
