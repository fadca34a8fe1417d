"""Numbers that vary from run to run: their names, checks of many runs at once, and the scene of one run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from armed_scenes import COMPOUNDS
from elements import COUPLED, ELEMENTS, JOINTS, MOTIONS
from mechanisms import line_spring, mass_on_rail

import crosscheck
from crosscheck.scenes import load
from newton_euler import simulate, simulate_batch, start, with_parameters
from newton_euler.equations.parameters import (
    parameter_values,
    places,
    refusal,
    unambiguous,
    with_values,
)
from newton_euler.equations.redundancy import inherit_mobility, mobility
from newton_euler.errors import PROPOSED, MechanismError, OptionError, UnknownNameError
from newton_euler.integrators.formulations import formulate
from newton_euler.model.compound_joint import Compound
from newton_euler.model.control import PD
from newton_euler.model.digital_control import Digital
from newton_euler.model.forces import Armature, JointSpring
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.motions import PrescribedMotion, Sum
from newton_euler.model.smooth_functions import Polynomial, Sine
from newton_euler.model.splines import Spline, Steps
from newton_euler.model.state import State
from newton_euler.model.wind import WindLoad
from newton_euler.variation import run_values, units_of


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
        (["forces[1].coordinate"], MechanismError, "is which coordinate it is"),
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
    assert 1 <= len(caught.value.valid) <= PROPOSED < len(parameter_values(scene))


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


def test_complex_numbers_are_no_values(scene):
    assert list(run_values(scene, {"mass.mass": np.array([1.0 + 2.0j, 2.0])}).errors) == [0, 1]


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
        ("mass", "values by names"),
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
    """Batches refuse them; scenes have them all the same."""
    law = Digital(PD("rail", 5.0, 0.1, 0.0), 0.01, 1, 0.1, 3.0, 4.0, (-1.0, 1.0))
    values = {"rail.period": 0.02, "rail.stroke.0": -0.5, "rail.slew_limit": 2.0, "rail.stiffness": 6.0}
    digital = replace(scene, control=(law,))
    found = with_parameters(digital, values).control
    stiff = replace(law.law, stiffness=6.0)
    assert found == (replace(law, law=stiff, period=0.02, stroke=(-0.5, 1.0), slew_limit=2.0),)
    for name, value in {"period": -1.0, "stroke": [1.0, -1.0], "force_limit": 0.0, "held": 1.0}.items():
        with pytest.raises(MechanismError, match=name):
            with_parameters(digital, {f"rail.{name}": value})


# Geometry: the equations with varied numbers are those of a scene that is made with these numbers

OF_FUNCTIONS = ("angular_frequency", "phase")

GEOMETRY = {
    "center_of_mass",
    *("point", "point_on_first", "point_on_second"),
    *("axis", "axis_on_first", "axis_on_second"),
    *("pitch", "ratio", "terms", "function", *OF_FUNCTIONS, "quaternion", "offsets"),
}


def remade(scene, element, attribute, value):
    """Make a scene with another number by hand."""
    mechanism, forces, motions = scene.mechanism, list(scene.forces), list(scene.motions)
    parts = {name: list(getattr(mechanism, name)) for name in ("bodies", "joints", "couplings")}
    for each in parts.values():
        for k, part in enumerate(each):
            if isinstance(part, Compound) and attribute == "axis" and element.startswith(part.name):
                axes = [*part.slides, *part.hinges]
                axes[int(element.removeprefix(part.name).removeprefix(".") or 0)] = np.array(value)
                slides, hinges = axes[: len(part.slides)], axes[len(part.slides) :]
                each[k] = replace(part, slides=slides, hinges=hinges)
            elif part.name == element and attribute == "point":
                points = {name: getattr(part, name) + value for name in ("point", "point_on_second")}
                each[k] = replace(part, **points)
            elif part.name == element and attribute == "offsets":
                beyond = part.point_on_second + (value - part.offsets).sum(axis=0)
                each[k] = replace(part, offsets=value, point_on_second=beyond)
            elif part.name == element and attribute == "quaternion":
                each[k] = replace(part, quaternion=np.array(value) / np.linalg.norm(value))
            elif part.name == element and attribute == "terms":
                terms = zip(part.terms, value, strict=True)
                each[k] = replace(part, terms=tuple((joint, n, x) for (joint, n, _), x in terms))
            elif part.name == element:
                fields = {attribute: value}
                if attribute == "axis" and np.any(part.point != part.point_on_second):  # along the axis
                    apart = np.linalg.norm(part.point_on_second - part.point)
                    fields["point_on_second"] = part.point + apart * np.array(value) / np.linalg.norm(value)
                each[k] = replace(part, **fields)
    for k, force in enumerate(forces):
        if force.prefix == element:
            forces[k] = replace(force, **{attribute: getattr(force, attribute) + value})
    for k, motion in enumerate(motions):
        if motion.prefix == element:
            sine, polynomial = Sine(value[0], 7.0, offset=value[1]), Polynomial(tuple(value[2:] or [0.0]))
            if isinstance(motion.function, Polynomial):
                sine, polynomial = Sine(0.0, 1.0), Polynomial(tuple(value))
            elif isinstance(motion.function, Sine):
                sine = replace(motion.function, amplitude=value[0], offset=value[1])
            motions[k] = replace(motion, function=Sum((sine, polynomial)))
        if f"{motion.prefix}.function" == element:
            motions[k] = replace(motion, function=with_sine(motion.function, **{attribute: value}))
    return replace(scene, mechanism=Mechanism(**parts), forces=tuple(forces), motions=tuple(motions))


def with_sine(function, **fields):
    """Return a sine, or a sum that has one, with other values of its fields."""
    if isinstance(function, Sum):
        return Sum(tuple(with_sine(term, **fields) for term in function.terms))
    return replace(function, **fields) if isinstance(function, Sine) else function


def another(scene, name, own):
    """Choose another value of a parameter, one with which universal joints stay perpendicular."""
    element, _, attribute = name.rpartition(".")
    step = 0.03 * np.random.default_rng(len(name)).uniform(-1.0, 1.0, own.shape)
    if attribute.startswith("axis_on"):
        joint = scene.mechanism.joint(element)
        step = 0.03 * np.cross(joint.axis_on_first, joint.axis_on_second)
    return own + step


def varied_numbers(scene):
    """Yield the names of geometric parameters with other values, but for those that open the initial pose."""
    for name, own in parameter_values(scene).items():
        element, _, attribute = name.rpartition(".")
        ends = ("point_on_first", "point_on_second") if element in scene.mechanism.joint_names else ()
        moves = attribute in GEOMETRY and (".function." in name or attribute not in OF_FUNCTIONS)
        if moves and attribute not in ends:
            yield name, another(scene, name, own)


def moving_state(system):
    """Find a closed configuration next to the initial pose, and velocities, by plain Newton steps."""
    rng = np.random.default_rng(1)
    q, _ = system.coordinates(State.initial(system.mechanism))
    q = system.retract(q, 0.1 * rng.uniform(-1.0, 1.0, system.nv))
    for _ in range(20):
        q = system.retract(q, -np.linalg.lstsq(system.phi_jacobian(q), system.phi(q), rcond=1e-9)[0])
    jacobian, v = system.phi_jacobian(q), rng.uniform(-1.0, 1.0, system.nv)
    return q, v - np.linalg.lstsq(jacobian, jacobian @ v + system.phi_t(), rcond=1e-9)[0]


REDUNDANT = {"motion of a loop, redundant"}
"""Scenes that axes askew would lock, and whose reactions are not unique."""


@pytest.mark.parametrize("formulation", ["relative", "cartesian"])
@pytest.mark.parametrize(
    "title", [*JOINTS, *MOTIONS, *COUPLED, *COMPOUNDS, *("forces, rods", "wind, cut at a ball")]
)
def test_equations_of_varied_geometry_are_those_of_a_scene_made_with_it(title, formulation):
    scene = (ELEMENTS | COUPLED | COMPOUNDS)[title]
    for name, value in varied_numbers(scene):
        element, _, attribute = name.rpartition(".")
        if title in REDUNDANT and attribute == "axis":
            continue
        other = remade(scene, element, attribute, value.tolist())
        mobility(scene)
        inherit_mobility(other, scene)
        varied = formulate(with_values(scene, {name: value}), formulation)
        expected = formulate(other, formulation)
        q, v = moving_state(expected)
        # round-off of a closed configuration
        assert np.abs(varied.phi(q) - expected.phi(q)).max(initial=0.0) < 1e-13, name
        one, two = varied.evaluate(q, v), expected.evaluate(q, v)
        unique = ("reaction_force",) if title not in REDUNDANT else ()
        for quantity in ("linear_acceleration", "angular_acceleration", *unique):
            found, needed = getattr(one, quantity), getattr(two, quantity)
            # dense linear algebra of matrices of condition 1e4
            assert np.abs(found - needed).max() < 1e-11 * max(1.0, np.abs(needed).max()), (name, quantity)


# Runs whose geometry and start vary


@pytest.fixture(scope="module", params=["relative", "cartesian"])
def formulation(request):
    return request.param


@pytest.fixture(scope="module")
def crank():
    """A spatial loop of one freedom, on the move."""
    return replace(start(load("slider_crank"), pivot=(0.4, 2.0)), duration=0.3, output_period=0.1)


def test_runs_of_varied_geometry_are_those_of_scenes_made_with_it(crank, formulation):
    """The scene that is made by hand starts from its only freedom, which both know."""
    center, moved = crank.mechanism.body("rod").center_of_mass, np.array([0.01, 0.02, -0.03])
    other = remade(replace(crank, initial_state=None), "ball", "point", np.array([0.01, -0.02, 0.005]))
    other = start(remade(other, "rod", "center_of_mass", center + moved), pivot=(0.5, 2.5))
    parameters = {
        "ball.point.x": [0.0, 0.01],
        "ball.point.y": [0.1, -0.02],
        "ball.point.z": [0.0, 0.005],
        "rod.center_of_mass": [center, center + moved],
        "start.pivot": [0.1, 0.5],
        "start.pivot.rate": [1.0, 2.5],
    }
    batch = simulate_batch(crank, parameters=parameters, formulation=formulation, threads=1)
    assert not batch.errors
    alone = with_parameters(crank, {name: given[0] for name, given in parameters.items()})
    for run, scene in zip(batch, (alone, other), strict=True):
        expected = simulate(scene, formulation)
        # both are integrated to 1e-10 from starts that differ by round-off
        assert np.abs(run.position - expected.position).max() < 1e-10
        assert np.abs(run.reaction_force - expected.reaction_force).max() < 1e-8
        for joint in ("pivot", "wrist", "guide"):  # as the joints of the run measure them
            found, needed = run.joint(joint), expected.joint(joint)
            assert np.abs(found.coordinates - needed.coordinates).max() < 1e-10


def test_samples_of_a_motion(crank, formulation):
    """They move the start, and what is between knots."""
    times = np.linspace(0.0, 0.4, 9)

    def along(values):
        motions = (PrescribedMotion("pivot", Sum((Spline(times, values), Polynomial((0.1,))))),)
        return replace(crank, motions=motions, initial_state=None)

    own, other = 0.1 * np.sin(3.0 * times), 0.2 * np.cos(5.0 * times) - 0.1
    given = [[*values, 0.1] for values in (own, other)]
    batch = simulate_batch(along(own), None, {"pivot.motion.function": given}, formulation=formulation)
    for run, values in zip(batch, (own, other), strict=True):
        # both are integrated to 1e-10 from starts that differ by round-off
        assert np.abs(run.position - simulate(along(values)).position).max() < 1e-9


OF_GEOMETRY = ("point_on_first", "point_on_second", "length", "axis", "1.axis", "offsets", "quaternion")


@pytest.mark.parametrize(
    ("title", "attributes"),
    [
        *((title, OF_GEOMETRY) for title in ("forces, rods", "gear, cut", "screw, cut", "compound, skew")),
        ("compound, skew", ("offsets.0.2",)),
    ],
)
def test_numbers_that_open_the_initial_pose_and_others(title, attributes):
    """The scene is described at another initial pose, from where coordinates are counted."""
    scene, rng = (ELEMENTS | COMPOUNDS)[title], np.random.default_rng(1)
    scene = replace(scene, duration=0.2, output_period=0.05)
    own = parameter_values(scene)
    elements = (*scene.mechanism.joint_names, *scene.mechanism.body_names)
    names = [f"{element}.{name}" for element in elements for name in attributes]
    whole = {name: name.removesuffix(".0.2") for name in names if name.endswith(".0.2")}
    own |= {name: own[base][0, 2] for name, base in whole.items() if base in own}
    values = {n: own[n] + 5e-3 * rng.uniform(-1.0, 1.0, np.shape(own[n])) for n in names if n in own}
    batch = simulate_batch(scene, parameters={name: [value] for name, value in values.items()})
    expected = simulate(with_parameters(scene, values))
    # both are integrated to 1e-10 from starts that differ by round-off
    assert np.abs(batch[0].position - expected.position).max() < 1e-10
    assert np.abs(np.abs(batch[0].quaternion) - np.abs(expected.quaternion)).max() < 1e-10
    force = np.abs(expected.reaction_force).max()
    assert np.abs(batch[0].reaction_force - expected.reaction_force).max() < 1e-9 * force


@pytest.mark.slow  # compiles and runs three engines on two scenes, 8 s
@pytest.mark.parametrize(
    ("name", "values"),
    [
        (
            "tracker",
            {
                "ball_57.point_on_first.z": 1e-3,
                "hinge_14.axis.z": 0.01,
                "panel_7.center_of_mass.x": 0.01,
                "start.slide_12": 0.05,
            },
        ),
        ("four_bar", {"pivot_1.point_on_second.x": 1e-3, "start.pivot_0": 0.3}),
    ],
)
def test_engines_agree_on_scenes_with_other_geometry(name, values):
    scene = replace(load(name), duration=0.3, output_period=0.1)
    assert crosscheck.check(with_parameters(scene, values)).agrees


def test_starts_do_not_depend_on_grouping(tracker):
    rng = np.random.default_rng(0)
    short = replace(tracker, duration=0.02, output_period=0.01)
    values = {
        "ball_57.point_on_first": 1e-3 * rng.uniform(-1.0, 1.0, (6, 3)),
        "start.slide_12": 0.1 * rng.random(6),
    }
    together = simulate_batch(short, parameters=values, threads=2)
    for k in (0, 5):
        alone = simulate_batch(short, parameters={name: given[k : k + 1] for name, given in values.items()})
        assert np.array_equal(together.stacked("position")[k], alone.stacked("position")[0])
        assert together[k].joint("slide_12").coordinates[0] == pytest.approx(
            values["start.slide_12"][k], abs=1e-15
        )


def test_a_given_state_begins_at_its_own_coordinates(tracker, tracker_states):
    """Coordinates that are not given stay those of the state, not of the scene."""
    short = replace(tracker, duration=0.02, output_period=0.01)
    values = {"start.slide_12.rate": [0.3, 0.3], "panel_7.center_of_mass.z": [2.0, 2.1]}
    batch = simulate_batch(short, tracker_states[:2], parameters=values)
    for run, state in zip(batch, tracker_states, strict=False):
        own = simulate(replace(short, initial_state=state)).joint("slide_12")
        found = run.joint("slide_12")
        assert found.coordinates[0] == pytest.approx(own.coordinates[0], abs=1e-14)
        assert found.rates[0] == pytest.approx(0.3, abs=1e-14)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"ball.point_on_first.y": [0.0, 5.0]}, "stays open by .* with ball.point_on_first.y = 5.0"),
        ({"start.pivot": [0.4, np.inf]}, "run 1: parameter 'start.pivot': is inf"),
        ({"start.pivot": [0.4, 0.4], "start.guide": [0.0, 3.0]}, "joint '.*' stays open by"),
        (
            {"start.pivot.rate": [1.0, 1.0], "start.guide.rate": [0.0, 5.0]},
            "loops do not let joints move with start.pivot.rate = 1.0, start.guide.rate = 5.0",
        ),
        (
            {"start.pivot": [0.4, 0.5], "start.guide.rate": [0.0, 0.0]},
            "stays open by .* with start.pivot = 0.5, .*, where start.guide is the own one of the scene",
        ),
    ],
)
def test_a_start_that_cannot_be_is_an_error_of_its_run_alone(crank, values, message):
    if "start.guide" in values:
        values["start.guide"][0] = simulate(crank).joint("guide").coordinates[0, 0]
    if "start.pivot.rate" in values:
        (alone,) = simulate_batch(crank, parameters={"start.pivot.rate": [1.0]})
        values["start.guide.rate"][0] = alone.joint("guide").rates[0, 0]
    if "start.guide.rate" in values and "start.pivot" in values:
        values["start.pivot"][0] = simulate(crank).joint("pivot").coordinates[0, 0]
        values["start.guide.rate"][0] = simulate(crank).joint("guide").rates[0, 0]
    batch = simulate_batch(crank, parameters=values)
    assert list(batch.errors) == [1]
    with pytest.raises(MechanismError, match=message):
        batch[1]


@pytest.mark.parametrize(
    ("name", "error", "message"),
    [
        ("start.pivott", UnknownNameError, "did you mean 'pivot'?"),
        ("start.ball", MechanismError, "joint 'ball'"),
        ("start.wrist.2", MechanismError, "joint 'wrist'"),
    ],
)
def test_initial_coordinates_are_checked(crank, name, error, message):
    with pytest.raises(error) as caught:
        simulate_batch(crank, parameters={name: [0.0]})
    assert message in str(caught.value)


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
