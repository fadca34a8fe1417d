"""Numbers that vary from run to run: their names, checks of many runs at once, and the scene of one run."""

from __future__ import annotations

import numpy as np
import pytest
from mechanisms import line_spring, mass_on_rail

from newton_euler import simulate, simulate_batch, with_parameters
from newton_euler.equations.parameters import parameter_values, unambiguous
from newton_euler.errors import MechanismError, OptionError, UnknownNameError
from newton_euler.model.control import PD
from newton_euler.model.forces import Armature, JointSpring
from newton_euler.model.motions import Sum
from newton_euler.model.smooth_functions import Polynomial, Sine
from newton_euler.model.wind import WindLoad
from newton_euler.variation import run_values


@pytest.fixture(scope="module")
def scene():
    """A mass on a rail with a bit of everything."""
    push = Sum((Sine(1.0, 7.0, offset=0.5), Polynomial((0.2, -1.0))))
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
    "rail.feedforward.1": ("rail.feedforward", [1.0, 0.04, 0.2, -1.0]),
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
        (["gravity.w"], UnknownNameError, "did you mean 'gravity'?"),
        (["mass.inertai.xx"], UnknownNameError, "did you mean 'mass.inertia'?"),
        (["rail.feedforward.4"], UnknownNameError, "rail.feedforward"),
        (["gravity", "gravity.z"], MechanismError, "another value by another name"),
        (["mass.inertia.xy", "mass.inertia.yx"], MechanismError, "another value by another name"),
        (["mass.mass", "bodies[1].mass"], MechanismError, "another value by another name"),
    ],
)
def test_names_are_checked(scene, names, error, message):
    with pytest.raises(error) as caught:
        parameter_values(scene, names)
    assert message in str(caught.value)


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


def test_bad_values_are_found_among_many(scene):
    values = np.random.default_rng(0).normal(0.5, 1.0, 2000)
    found = run_values(scene, {"mass.mass": values, "rail.target": values})
    assert sorted(found.errors) == np.flatnonzero(values < 0.0).tolist()


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
