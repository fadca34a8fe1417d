"""Runs whose geometry varies, and the start with it: as those of scenes that are made with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from armed_scenes import COMPOUNDS
from elements import COUPLED, ELEMENTS, JOINTS, MOTIONS

import crosscheck
from crosscheck.library import load
from newton_euler import simulate, simulate_batch, start, with_parameters
from newton_euler.compiled.formulations import formulate
from newton_euler.equations.parameters import parameter_values, with_values
from newton_euler.equations.redundancy import inherit_mobility, mobility
from newton_euler.equations.sparse import to_array
from newton_euler.model.compound_joint import Compound
from newton_euler.model.joint import perpendicular_pair
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.motions import PrescribedMotion, Sum
from newton_euler.model.parallel_hinges import ParallelHinges
from newton_euler.model.smooth_functions import Polynomial, Sine
from newton_euler.model.splines import Spline
from newton_euler.model.state import State

# Geometry: the equations with varied numbers are those of a scene that is made with these numbers

OF_FUNCTIONS = ("angular_frequency", "phase")

GEOMETRY = {
    "center_of_mass",
    *("point", "point_on_first", "point_on_second"),
    *("axis", "axis_on_first", "axis_on_second"),
    *("pitch", "ratio", "terms", "coefficients", "function", *OF_FUNCTIONS),
    *("quaternion", "offset", "offsets"),
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
            elif part.name == element and attribute == "offset":
                each[k] = replace(
                    part, offset=value, point_on_second=part.point_on_second + value - part.offset
                )
            elif isinstance(part, ParallelHinges) and part.name == element and attribute == "axis":
                axis = np.array(value) / np.linalg.norm(value)
                turn = triad(axis, part.axis) @ triad(part.axis, part.axis).T
                offset = turn @ part.offset
                each[k] = replace(part, axis=axis, offset=offset, point_on_second=part.point + offset)
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


def triad(axis, described):
    """Return the axis (3,) with the two vectors across it that a joint chooses, as columns (3, 3)."""
    return np.column_stack([*perpendicular_pair(axis, described), axis])


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
        phi, rows = system.phi_and_jacobian(q)
        step = np.linalg.lstsq(to_array(rows, system.nv), phi, rcond=1e-9)[0]
        q = system.retract(q, -step)
        if np.abs(step).max() < 1e-12:  # what is left is round-off
            break
    jacobian, v = system.phi_jacobian(q), rng.uniform(-1.0, 1.0, system.nv)
    return q, v - np.linalg.lstsq(jacobian, jacobian @ v + system.phi_t(), rcond=1e-9)[0]


REDUNDANT = {"motion of a loop, redundant"}
"""Scenes that axes askew would lock, and whose reactions are not unique."""


VARIED = (*JOINTS, *MOTIONS, *COUPLED, *COMPOUNDS, "forces, rods", "wind, cut at a ball")


@pytest.mark.parametrize(
    ("title", "formulation"),
    [
        *((title, "relative") for title in VARIED),
        # where loops are cut makes no difference to the Cartesian form
        *(
            pytest.param(title, "cartesian", marks=pytest.mark.slow)
            if "cut" in title
            else (title, "cartesian")
            for title in VARIED
        ),
    ],
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


def test_what_follows_from_geometry_is_that_of_the_run():
    """Whatever of the scene's own was worked out before."""
    scene, center = load("slider_crank"), np.array([0.3, -0.2, 0.5])
    own = scene.mechanism.reaction_arms, scene.mechanism.largest_extent
    varied = with_values(scene, {"rod.center_of_mass": center}).mechanism
    expected = remade(replace(scene, initial_state=None), "rod", "center_of_mass", center).mechanism
    for found, needed, before in zip(
        (varied.reaction_arms, varied.largest_extent),
        (expected.reaction_arms, expected.largest_extent),
        own,
        strict=True,
    ):
        np.testing.assert_allclose(found, needed, rtol=1e-14, atol=1e-15)  # round-off
        assert not np.allclose(found, before)


# Runs whose geometry and start vary


@pytest.fixture(scope="module", params=["relative", "cartesian"])
def formulation(request):
    return request.param


@pytest.fixture(scope="module")
def crank():
    """A spatial loop of one freedom, on the move."""
    return replace(start(load("slider_crank"), pivot=(0.4, 2.0)), duration=0.3, output_period=0.1)


@pytest.mark.slow
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


def test_samples_of_a_motion_one_by_one(crank):
    """They move the start as all samples together do."""
    times = np.linspace(0.0, 0.4, 9)
    own, other = 0.1 * np.sin(3.0 * times), 0.1 * np.cos(5.0 * times)
    motions = (PrescribedMotion("pivot", Spline(times, own)),)
    scene = replace(crank, motions=motions, initial_state=None)
    components = {f"pivot.motion.function.{k}": value for k, value in enumerate(other[:3])}
    found = simulate(with_parameters(scene, components))
    expected = simulate(with_parameters(scene, {"pivot.motion.function": [*other[:3], *own[3:]]}))
    assert np.array_equal(found.position, expected.position)


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
