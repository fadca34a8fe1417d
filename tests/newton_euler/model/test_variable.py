"""Numbers of a description: each one varies, or is said to be no number that does."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import get_args

import numpy as np
import pytest
from armed_scenes import COMPOUNDS
from elements import COUPLED, ELEMENTS
from mechanisms import line_spring

from newton_euler.equations import parameters
from newton_euler.model.armatures import Armature, BallArmature
from newton_euler.model.control import PD, ComputedTorque, StateFeedback
from newton_euler.model.couplings import JointCoupling, LinearCoupling
from newton_euler.model.digital_control import Digital, Law, Sampled
from newton_euler.model.forces import BallSpring, Force, JointSpring, Wrench
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import JOINT_KINDS, Prismatic
from newton_euler.model.motions import PrescribedMotion, Sum, TimeFunction
from newton_euler.model.smooth_functions import Polynomial, Sine
from newton_euler.model.splines import Moves, Spline, Steps
from newton_euler.model.state import State
from newton_euler.model.switched_forces import ElasticGear, JointFriction, JointStop
from newton_euler.model.variable import PART_UNITS, Variable

SCENES = [*ELEMENTS.values(), *COUPLED.values(), *COMPOUNDS.values()]

FUNCTION = Sum(
    (
        Polynomial((0.1, 0.2)),
        Sine(0.3, 2.0, 0.4, 0.5),
        Spline((0.0, 1.0), (0.1, 0.2)),
        Moves((0.0, 1.0), (0.1, 0.2), (0.3,)),
        Sum((Steps((0.0,), (0.3,)), Sine(0.1, 3.0))),
    )
)
SMOOTH = Sum((Sine(0.3, 2.0, 0.4, 0.5), Spline((0.0, 1.0), (0.1, 0.2))))
GAINS = {"rail": (1.0, 2.0), "pole": (3.0, 4.0), "arm": (0.1, 0.2)}
TARGETS = {"pole": Polynomial((0.1, 0.2)), "arm": 0.3}
FEEDBACK = StateFeedback("rail", GAINS, 0.5, feedforward=SMOOTH, targets=TARGETS)
LIMITS = {"resolution": 0.1, "force_limit": 3.0, "slew_limit": 4.0, "stroke": (-1.0, 1.0)}

MADE = [
    PD("rail", 1.0, 2.0, FUNCTION, feedforward=FUNCTION),
    FEEDBACK,
    ComputedTorque("rail", 1.0, 2.0, FUNCTION, model={"mass.mass": 3.0}),
    Digital(FEEDBACK, 0.01, 2, **LIMITS),
    Sampled("rail", lambda time, x, x_rate: 0.0, 0.01),
    PrescribedMotion("rail", SMOOTH),
    JointSpring("rail", 1.0, 2.0, 3.0),
    BallSpring("ball", 1.0, 2.0, [0.1, 0.2, 0.3]),
    JointFriction("rail", 1.0, 2.0, 3.0, 0.1),
    JointStop("rail", "low", 1.0, 2.0, 3.0),
    ElasticGear("screw", "pole", "rail", 0.1, 1.0, play=0.1),
    Wrench("push", "mass", [0.1, 0.2, 0.3], [1.0, 2.0, 3.0], [4.0, 5.0, 6.0]),
    Armature("rail", 0.3),
    BallArmature("ball", 0.3),
    line_spring(rest_length=2.0, damping=0.1),
    Prismatic("rail", "ground", "mass", [0.1, 0.2, 0.3], axis=[1.0, 0.0, 0.0]),
    LinearCoupling("sum", (("rail", 0, 1.0), ("pole", 0, -2.0))),
]


def _examples():
    """Return an element of each kind by the name of its class, preferably one that is made here."""
    found = {"Scene": replace(SCENES[0], initial_state=State.initial(SCENES[0].mechanism))}
    for scene in SCENES:
        mechanism = scene.mechanism
        elements = (*mechanism.bodies[1:], *mechanism.joints, *mechanism.couplings, *scene.forces)
        found |= {type(each).__name__: each for each in elements}
    return found | {type(each).__name__: each for each in MADE}


EXAMPLES = _examples()


def test_there_is_an_example_of_each_kind():
    needed = [*get_args(Law), *get_args(Force), *JOINT_KINDS.values(), *JointCoupling.__subclasses__()]
    needed += [PrescribedMotion, Armature, BallArmature]
    assert {kind.__name__ for kind in needed} <= set(EXAMPLES)
    functions = {type(each) for each in (FUNCTION, *FUNCTION.terms, *FUNCTION.terms[-1].terms)}
    assert set(get_args(TimeFunction)) <= functions


def numbers(value, path=()):
    """Yield all numbers of a description with the names and places that lead to them."""
    if isinstance(value, float | int | np.ndarray) and not isinstance(value, bool):
        yield from ((path + index, x) for index, x in np.ndenumerate(value))
    elif isinstance(value, Mapping):
        for key, each in value.items():
            yield from numbers(each, (*path, str(key)))
    elif isinstance(value, tuple | list):
        names = any(isinstance(each, str) for each in value)  # and coordinates, with a factor
        for k, each in enumerate(value):
            if not (names and isinstance(each, int)):
                yield from numbers(each, (*path, k))
    elif is_dataclass(value) and (not path or not isinstance(value, Variable) or path == ("law",)):
        for each in fields(value):
            yield from numbers(getattr(value, each.name), (*path, each.name))


@pytest.mark.parametrize("kind", EXAMPLES)
def test_every_number_varies_or_is_said_to_be_none_that_does(kind):
    element, rng = EXAMPLES[kind], np.random.default_rng(0)
    own = {name: element.number(name) for name in element.variables}
    values = {name: value + rng.uniform(0.01, 0.02, value.shape) for name, value in own.items()}
    changed = element.varied(values)
    before, after = dict(numbers(element)), dict(numbers(changed))
    constant = {part for name in element.constants for part in name.split(".")[-1:]}
    same = {path for path, value in before.items() if after[path] == value}
    assert [path for path in same if constant.isdisjoint(path)] == []
    # and no reason is given for what does vary
    assert all(any(name in path for path in same) or not _has(element, name) for name in constant)


def _has(element, name):
    """Tell if a field of an element, or of what it is made of, has numbers at all."""
    return any(name in path for path, _ in numbers(element))


MIXED = {"axis", "axis_on_first", "axis_on_second", "direction", "quaternion", "ratio", "terms"}
MIXED |= {"coefficients", "gains", "targets", "function", "stroke"}
MIXED |= {"forward_efficiency", "backward_efficiency", "load_coefficient"}
"""Numbers without a unit, and with several."""


def test_units_are_known():
    fields = [(name, each.field_of(name)) for each in EXAMPLES.values() for name in each.variables]
    assert {name.rpartition(".")[2] for name, field in fields if not field.unit} == MIXED


def test_the_list_of_parameters_is_complete():
    """Names in its documentation are those of the examples."""
    documented = re.findall(
        r"`(?:[A-Z]+\.)?(?:\d\.)?([a-z_.]+)`", parameters.__doc__.partition("\n\nIn batches")[0]
    )
    names = set()
    for element in EXAMPLES.values():
        place = getattr(element, "prefix", "").partition(".")[2]  # behind the name of the joint
        kind = f"{place}." if place else ""
        names |= {kind + re.sub(r"^\d\.", "", name) for name in element.variables}
    of_functions = {name for name in names if name.endswith((*PART_UNITS,))}
    assert {name.rpartition(".")[2] for name in of_functions} == set(PART_UNITS)
    listed = {
        name
        for name in documented
        if not name.startswith("newton_euler") and not name.endswith((*PART_UNITS,))
    }
    assert names - of_functions == listed | {"held"}


@pytest.mark.parametrize("kind", [kind for kind, each in EXAMPLES.items() if not isinstance(each, Joint)])
def test_numbers_that_are_given_are_those_that_are_had(kind):
    """One after the other, as parts of a function and terms of a sum share it."""
    element, rng = EXAMPLES[kind], np.random.default_rng(0)
    for name in [name for name in element.variables if name not in element.points]:
        value = element.number(name) + rng.uniform(0.01, 0.02, element.number(name).shape)
        element = element.varied({name: value})
        scale = np.linalg.norm(value) if name == "quaternion" else 1.0
        assert np.array_equal(element.number(name), value / scale)
