"""What the public constructors refuse: errors of the package's own for any value at all, and no warning."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from mechanisms import pendulum

import newton_euler
from newton_euler import (
    PD,
    Body,
    Gear,
    JointSpring,
    Mechanism,
    PointSpring,
    Polynomial,
    PrescribedMotion,
    Sampled,
    Scene,
    Sine,
    State,
    Sum,
    Wrench,
)
from newton_euler.armature import Armature
from newton_euler.errors import NewtonEulerError
from newton_euler.joints import JOINT_KINDS
from newton_euler.shapes import Box, Capsule

ORIGIN, Y, Z = [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]
MECHANISM = pendulum().mechanism

GOOD: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
    "Body": (
        Body,
        {
            "name": "a",
            "mass": 1.0,
            "center_of_mass": ORIGIN,
            "inertia": np.eye(3),
            "quaternion": [1.0, 0, 0, 0],
        },
    ),
    "Box": (Box, {"half_sizes": [1.0, 1.0, 1.0], "center": ORIGIN, "quaternion": [1.0, 0, 0, 0]}),
    "Capsule": (Capsule, {"start": ORIGIN, "end": Z, "radius": 0.1}),
    "Gear": (Gear, {"name": "g", "driver": "a", "follower": "b", "ratio": 2.0, "driver_coordinate": 0}),
    "Polynomial": (Polynomial, {"coefficients": [1.0]}),
    "Sine": (Sine, {"amplitude": 1.0, "angular_frequency": 2.0, "phase": 0.1, "offset": 0.2}),
    "Sum": (Sum, {"terms": [Polynomial([1.0])]}),
    "PrescribedMotion": (
        PrescribedMotion,
        {"joint": "pivot", "function": Polynomial([0.0]), "coordinate": 0},
    ),
    "PD": (
        PD,
        {"joint": "a", "stiffness": 1.0, "damping": 1.0, "target": 0.0, "coordinate": 0, "feedforward": 0.0},
    ),
    "Sampled": (Sampled, {"joint": "a", "controller": lambda t, x, v: 0.0, "period": 0.1, "coordinate": 0}),
    "JointSpring": (
        JointSpring,
        {"joint": "a", "stiffness": 1.0, "damping": 0.0, "rest": 0.0, "coordinate": 0},
    ),
    "PointSpring": (
        PointSpring,
        {
            "name": "s",
            "first": "ground",
            "second": "rod",
            "point_on_first": ORIGIN,
            "point_on_second": Z,
            "stiffness": 1.0,
            "rest_length": 1.0,
            "damping": 0.0,
        },
    ),
    "Wrench": (
        Wrench,
        {"name": "w", "body": "rod", "point": ORIGIN, "force": Z, "torque": ORIGIN, "frame": "world"},
    ),
    "Armature": (Armature, {"joint": "a", "inertia": 1.0, "coordinate": 0}),
    "Mechanism": (Mechanism, {"bodies": MECHANISM.bodies, "joints": MECHANISM.joints, "couplings": ()}),
    "Scene": (
        Scene,
        {
            "name": "s",
            "mechanism": MECHANISM,
            "duration": 1.0,
            "output_period": 0.1,
            "gravity": ORIGIN,
            "control": (),
            "initial_state": State.initial(MECHANISM),
            "outputs": ["energy"],
            "forces": (),
            "motions": (),
            "armatures": (),
            "description": "",
        },
    ),
    "simulate": (
        lambda **options: newton_euler.simulate(options.pop("scene", pendulum()), **options),
        {
            "formulation": "relative",
            "integrator": "DOP853",
            "rtol": 1e-3,
            "atol": 1e-3,
            "step": None,
            "stabilization": "none",
            "alpha": 1.0,
            "most_steps": 100,
        },
    ),
    "compile_scene": (
        lambda **options: newton_euler.compile_scene(pendulum(), **options),
        {"formulation": "relative", "stabilization": "projection", "alpha": 1.0, "parameters": ()},
    ),
}

AXES: dict[str, dict[str, Any]] = {
    **{
        kind: {"axis": Z}
        for kind in ("revolute", "prismatic", "translational", "cylindrical", "planar", "point_on_line")
    },
    "screw": {"axis": Z, "pitch": 0.1},
    "universal": {"axis_on_first": Z, "axis_on_second": Y},
    "compound": {"slides": [Y], "hinges": [Z], "ball": False},
    "rod": {"point_on_second": Z},
}
for kind, joint in JOINT_KINDS.items():
    ends = {"name": "j", "first": "ground", "second": "rod", "point": ORIGIN, "actuated": False}
    GOOD[kind] = (joint, ends | AXES.get(kind, {}))

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
    "texts": ["a", "b", "c"],
    "type": dict,
}

CASES = [(name, field) for name, (_, fields) in GOOD.items() for field in fields]


@pytest.mark.parametrize("name", GOOD)
def test_what_is_right_is_taken(name):
    make, fields = GOOD[name]
    assert make(**fields) is not None


@pytest.mark.parametrize(("name", "field"), CASES, ids=lambda part: part)
def test_what_is_wrong_is_refused_in_the_packages_own_words(name, field):
    """A value is taken or refused; it is never another error, and nothing overflows on the way."""
    make, fields = GOOD[name]
    for what, value in WRONG.items():
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                made = make(**(fields | {field: value}))
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
