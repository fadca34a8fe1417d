"""Refusals of the public constructors: errors of the package's own for any value at all, and no warning."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from mechanisms import pendulum

import newton_euler
from newton_euler import (
    PD,
    Body,
    ElasticGear,
    Gear,
    JointFriction,
    JointSpring,
    JointStop,
    Mechanism,
    PointSpring,
    Polynomial,
    PolynomialCoupling,
    PrescribedMotion,
    Sampled,
    Scene,
    Sine,
    State,
    Sum,
    WindLoad,
    Wrench,
    wind_gust,
    wind_turbulence,
)
from newton_euler.errors import MechanismError, NewtonEulerError
from newton_euler.model.armatures import Armature
from newton_euler.model.geometry import Box, Capsule, Cylinder, Mesh, Sphere
from newton_euler.model.joint_kinds import JOINT_KINDS

ORIGIN, Y, Z = [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]
MECHANISM = pendulum().mechanism

AXES: dict[str, dict[str, Any]] = {
    **{
        kind: {"axis": Z}
        for kind in ("revolute", "prismatic", "translational", "cylindrical", "planar", "point_on_line")
    },
    "screw": {"axis": Z, "pitch": 0.1},
    "parallel_hinges": {"axis": Z, "offset": Y, "opposed": False},
    "universal": {"axis_on_first": Z, "axis_on_second": Y},
    "compound": {"slides": [Y], "hinges": [Z], "ball": False},
    "rod": {"point_on_second": Z},
}

ELEMENTS: tuple[Any, ...] = (
    Body("a", 1.0, ORIGIN, np.eye(3)),
    Box([1.0, 1.0, 1.0], ORIGIN),
    Capsule(ORIGIN, Z, 0.1),
    Cylinder(ORIGIN, Z, 0.1),
    Sphere(ORIGIN, 0.1),
    Gear("g", "a", "b", 2.0),
    PolynomialCoupling("p", "a", "b", (2.0, 0.0, 1.0)),
    Polynomial((1.0,)),
    Sine(1.0, 2.0, 0.1, 0.2),
    Sum((Polynomial((1.0,)),)),
    PrescribedMotion("pivot", Polynomial((0.0,))),
    PD("a", 1.0, 1.0, 0.0),
    Sampled("a", lambda t, x, v: 0.0, 0.1),
    JointSpring("a", 1.0),
    JointFriction("a", 1.0),
    JointStop("a", "low", 0.0, 1.0),
    ElasticGear("screw", "a", "b", 0.1, 1.0),
    PointSpring("s", "ground", "rod", ORIGIN, Z, stiffness=1.0, rest_length=1.0),
    Wrench("w", "rod", ORIGIN, Z),
    WindLoad("v", "rod", ORIGIN, first_side=Y, second_side=Z, direction=Z, speed=1.0),
    Armature("a", 1.0),
    Scene("s", MECHANISM, 1.0, 0.1, initial_state=State.initial(MECHANISM)),
    *(make("j", "ground", "rod", ORIGIN, **AXES.get(kind, {})) for kind, make in JOINT_KINDS.items()),
)


@pytest.mark.parametrize("element", ELEMENTS, ids=lambda each: type(each).__name__)
def test_elements_are_shown_in_one_line(element):
    assert "\n" not in repr(element)
    assert len(repr(element)) < 300


def test_long_arrays_and_defaults_are_not_shown():
    mesh = Mesh(np.zeros((100, 3)), [[0, 1, 2]])
    assert repr(mesh) == "Mesh(vertices=<100 by 3 numbers>, triangles=[[0, 1, 2]])"
    assert repr(Sphere(ORIGIN, 1.0)) == "Sphere(center=[0.0, 0.0, 0.0], radius=1.0)"
    assert repr(Wrench("w", "rod", ORIGIN)) == "Wrench(name='w', body='rod', point=[0.0, 0.0, 0.0])"


UNCHECKED = {("Body", "shapes"), ("Body", "meshes"), ("Sampled", "held")}
"""Attributes that readers and runs of the package fill alone."""

GOOD: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
    **{
        type(each).__name__: (type(each), {field.name: getattr(each, field.name) for field in fields(each)})
        for each in ELEMENTS
    },
    "Mechanism": (Mechanism, {"bodies": MECHANISM.bodies, "joints": MECHANISM.joints, "couplings": ()}),
    "wind_gust": (wind_gust, {"mean": 1.0, "gust": 1.0, "period": 1.0}),
    "wind_turbulence": (
        wind_turbulence,
        {"mean": 1.0, "deviation": 1.0, "length": 1.0, "seed": 1, "lowest": 0.1, "highest": 1.0, "count": 2},
    ),
    "simulate": (
        lambda **options: newton_euler.simulate(options.pop("scene", pendulum()), **options),
        {
            "formulation": "relative",
            "integrator": "DOP853",
            "rtol": 1e-3,
            "atol": 1e-3,
            "step": None,
            "stabilization": "baumgarte",
            "alpha": 1.0,
            "most_steps": 100,
        },
    ),
    "compile_scene": (
        lambda **options: newton_euler.compile_scene(pendulum(), **options),
        {"formulation": "relative", "stabilization": "baumgarte", "alpha": 1.0, "parameters": ()},
    ),
}

OVERFLOWING: dict[str, Callable[[], object]] = {
    "a joint far from its body": lambda: Mechanism(
        [Body.ground(), Body("a", 1.0, [1e308] * 3, np.eye(3))],
        [JOINT_KINDS["revolute"]("j", "ground", "a", [-1e308] * 3, axis=Z)],
    ),
    "a quaternion": lambda: Mechanism(
        [Body.ground(), Body("a", 1.0, ORIGIN, np.eye(3), [1e200] * 4)],
        [JOINT_KINDS["free"]("j", "ground", "a", ORIGIN)],
    ),
    "an inertia": lambda: Mechanism(
        [Body.ground(), Body("a", 1.0, ORIGIN, 1e308 * np.array([[1.0, -1.0, 0], [1.0, 1.0, 0], Z]))],
        [JOINT_KINDS["free"]("j", "ground", "a", ORIGIN)],
    ),
    "an initial quaternion": lambda: Scene(
        "s", MECHANISM, 1.0, 0.1, initial_state=starting(quaternion=np.full((2, 4), 1e200))
    ),
}


def starting(**changes: Any) -> State:
    return replace(State.initial(MECHANISM), **changes)


@pytest.mark.parametrize("what", OVERFLOWING)
def test_what_overflows_is_refused_without_a_warning(what):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(NewtonEulerError):
            OVERFLOWING[what]()


@pytest.mark.parametrize("value", [1, 0, "no", None, 1.0, np.eye(2)])
def test_an_unrealisable_inertia_is_allowed_by_a_truth_value_alone(value):
    with pytest.raises(NewtonEulerError, match=r"body 'a': allow_unrealisable_inertia is .*; needed: True"):
        Body("a", 1.0, ORIGIN, np.eye(3), allow_unrealisable_inertia=value)


def test_numpys_numbers_are_options():
    options = {"rtol": np.float32(1e-6), "atol": np.float64(1e-8), "most_steps": np.int64(1000)}
    run = newton_euler.simulate(pendulum(), **options)
    assert run.settings["rtol"] == float(np.float32(1e-6))
    assert type(run.settings["rtol"]) is float
    fixed = newton_euler.simulate(pendulum(), integrator="RK4", step=np.float32(0.125))
    assert type(fixed.settings["step"]) is float
    batch = newton_euler.simulate_batch(pendulum(), [State.initial(MECHANISM)], threads=np.int32(1))
    assert batch.settings["threads"] == 1


@pytest.mark.parametrize(
    "arguments",
    [
        {"states": State.initial(MECHANISM)},
        {"states": 3},
        {"parameters": 3},
        {"parameters": [1.0]},
        {"parameters": {"gravity": 9.81}},
        {"states": [State.initial(MECHANISM)], "threads": True},
    ],
    ids=str,
)
def test_a_batch_of_no_sequence_is_refused(arguments):
    with pytest.raises(NewtonEulerError, match=r"(states|parameters|gravity'\]|threads) is .*; needed: "):
        newton_euler.simulate_batch(pendulum(), **arguments)


WRONG: dict[str, Any] = {
    "None": None,
    "text": "x y",
    "list": [1.0],
    "empty list": [],
    "nested list": [[1.0, [2.0]], "a"],
    "dictionary": {"a": 1},
    "NaN": float("nan"),
    "infinity": -np.inf,
    "huge": 1e308,
    "enormous": 10**400,
    "tiny": 5e-324,
    "true": True,
    "object": object(),
    "complex": 1j,
    "huge vector": [1e308, 1e308, -1e308],
    "NaN vector": [0.0, np.nan, 0.0],
    "matrix": np.full((3, 3), 1e200),
    "texts": ["1", "2", "3"],
    "masked": np.ma.array([0.0, 1.0, 0.0], mask=[True, False, False]),
    "time span": np.timedelta64(1, "s"),
    "type": dict,
}

CASES = sorted({(name, field) for name, (_, given) in GOOD.items() for field in given} - UNCHECKED)


@pytest.mark.parametrize(("name", "field"), CASES, ids=lambda part: part)
def test_what_is_wrong_is_refused_in_the_packages_own_words(name, field):
    """A value is taken or refused; it is never another error, and nothing overflows on the way."""
    make, given = GOOD[name]
    for what, value in WRONG.items():
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                made = make(**(given | {field: value}))
            except NewtonEulerError as error:
                refused = str(error)
            except Exception as error:
                pytest.fail(f"{what}: {type(error).__name__}: {error}")
            else:
                assert_finite(made)
                continue
        assert "\n" not in refused, what


def assert_finite(made: object) -> None:
    for value in vars(made).values():
        if isinstance(value, float | np.ndarray) and np.asarray(value).dtype.kind == "f":
            assert np.isfinite(value).all(), value


def test_a_joint_with_the_name_of_a_coordinate_is_refused():
    bodies = [Body.ground(), *(Body(name, 1.0, ORIGIN, np.eye(3)) for name in ("one", "two"))]
    ball = JOINT_KINDS["universal"]("a", "ground", "one", ORIGIN, **AXES["universal"])
    hinge = JOINT_KINDS["revolute"]("a.1", "one", "two", ORIGIN, axis=Z)
    with pytest.raises(MechanismError) as caught:
        Mechanism(bodies, [ball, hinge])
    assert caught.value.element == "joint 'a.1'"


def test_angles_of_a_state_are_a_copy():
    angles = {("pivot", 0): 20.0}
    state = replace(State.initial(MECHANISM), angles=angles)
    angles["pivot", 0] = 9.0
    assert state.angles == {("pivot", 0): 20.0}
