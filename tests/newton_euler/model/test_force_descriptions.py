"""Descriptions of forces: what is accepted, parameters of batches, and overflow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mechanisms import line_spring, mass_on_rail

import newton_euler
from newton_euler import PD, JointSpring, PointSpring, Wrench
from newton_euler.compiled.formulations import FORMULATIONS
from newton_euler.equations.parameters import parameter_values
from newton_euler.errors import MechanismError, UnknownNameError
from newton_euler.model.trajectory import IntegrationError
from newton_euler.runs.assemble import initial_state
from newton_euler.runs.simulate import compile_scene

both = pytest.mark.parametrize("formulation", FORMULATIONS)


def test_a_name_that_stands_for_two_parameters():
    scene = mass_on_rail(replace(line_spring(rest_length=1.0), name="rail"), control=(PD("rail", 1, 1, 0),))
    with pytest.raises(
        MechanismError, match=r"stands for two values; needed: control\[0\]\.stiff.* or forces\[0\]"
    ):
        compile_scene(scene, parameters=["rail.stiffness"])
    assert compile_scene(scene, parameters=["rail.rest_length", "rail.target"])
    names = parameter_values(scene).keys()
    assert {"control[0].stiffness", "forces[0].stiffness"} <= names
    assert "rail.stiffness" not in names
    with pytest.raises(
        UnknownNameError, match=r"unknown parameter 'rail\.rest'; did you mean 'rail\.rest_length'"
    ):
        compile_scene(scene, parameters=["rail.rest"])


ENDS = ("ground", "mass", [0.0, 0.0, 2.0], [0.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: JointSpring("rail", -1.0), "spring of joint 'rail': stiffness is -1.0; needed: a finite"),
        (lambda: JointSpring("rail", 1.0, "2"), "damping is '2'"),
        (lambda: JointSpring("rail", 1.0, -2.0), "damping is -2.0; needed: a finite number, 0 or more"),
        (lambda: JointSpring("rail", rest=np.nan), "rest is nan; needed: a finite number"),
        (lambda: JointSpring("rail", coordinate=0.0), "coordinate is 0.0"),
        (
            lambda: PointSpring("a b", *ENDS, stiffness=1, rest_length=1),
            "point spring 'a b': has an unusable",
        ),
        (
            lambda: PointSpring("s", *ENDS, stiffness=None, rest_length=1),
            "point spring 's': stiffness is None",
        ),
        (lambda: PointSpring("s", *ENDS, stiffness=1, rest_length=-1), "rest_length is -1"),
        (
            lambda: PointSpring("s", *ENDS[:3], [1.0], stiffness=1, rest_length=1),
            "point spring 's': point_on_second is [1.0]; needed: three finite numbers",
        ),
        (lambda: Wrench(3, "mass", [0.0] * 3), "wrench 3: has an unusable name"),
        (lambda: Wrench("w", "mass", [0.0] * 3, [np.inf] * 3), "wrench 'w': force is [inf, inf, inf]"),
        (
            lambda: Wrench("w", "mass", [0.0] * 3, frame="joint"),
            "frame is 'joint'; needed: 'world' or 'body'",
        ),
    ],
)
def test_forces_that_cannot_be(make, message):
    with pytest.raises(MechanismError) as caught:
        make()
    assert message in str(caught.value)


STRETCHED = PointSpring("s", *ENDS, stiffness=1.0, rest_length=1.0)


@pytest.mark.parametrize(
    ("forces", "message"),
    [
        (
            3,
            "'mass': forces is 3; needed: a tuple of JointSpring or BallSpring or PointSpring or Wrench",
        ),
        ([PD("rail", 1.0, 1.0, 0.0)], "forces holds PD("),
        (
            [JointSpring("axle")],
            "spring of joint 'axle': is on an unknown joint 'axle'; needed: one of rail",
        ),
        ([JointSpring("rail", coordinate=1)], "coordinate is 1; needed: an index below 1"),
        ([JointSpring("rail", coordinate=-1)], "coordinate is -1"),
        (
            [JointSpring("rail"), JointSpring("rail")],
            "spring of coordinate 0 of joint 'rail': 2 of that name",
        ),
        (
            [replace(STRETCHED, first="moon")],
            "point spring 's': acts on an unknown body 'moon'; needed: one of ground, mass",
        ),
        ([replace(STRETCHED, first="mass")], "point spring 's': connects 'mass' to itself"),
        (
            [replace(STRETCHED, point_on_first=[0.0] * 3)],
            "point spring 's': its points coincide in the initial",
        ),
        ([STRETCHED, Wrench("s", "mass", [0.0] * 3)], "force 's': 2 of that name"),
        ([Wrench("w", "ground", [0.0] * 3)], "wrench 'w': acts on the ground 'ground'"),
    ],
)
def test_forces_that_a_scene_refuses(forces, message):
    with pytest.raises(MechanismError) as caught:
        initial_state(replace(mass_on_rail(), forces=forces))
    assert message in str(caught.value)


@both
@pytest.mark.parametrize(("integrator", "step"), [("DOP853", None), ("Radau", None), ("RK4", 1e-2)])
@pytest.mark.parametrize(
    "force",
    [
        Wrench("push", "mass", [0.0, 0.0, 0.0], [0.0, 0.0, 1e308]),
        JointSpring("rail", 1e300, rest=1e10),
        line_spring(stiffness=1e308, rest_length=100.0),
    ],
    ids=["push", "rail", "line"],
)
def test_forces_that_overflow_end_in_an_error(formulation, integrator, step, force):
    with pytest.raises(IntegrationError, match=rf"stopped at t = 0 s: .* largest force: {force.element}$"):
        newton_euler.simulate(mass_on_rail(force, duration=1.0), formulation, integrator, step=step)


@pytest.mark.parametrize(
    ("stiffness", "damping", "name"),
    [(1e14, 0.0, "spring"), (0.0, 1e9, "damper"), (1e14, 1e3, "spring and damper")],
)
def test_the_force_that_ends_a_run_is_a_spring_or_a_damper(stiffness, damping, name):
    scene = newton_euler.start(
        mass_on_rail(JointSpring("rail", stiffness, damping), duration=1.0), rail=(0.1, 1.0)
    )
    with pytest.raises(IntegrationError, match=f"largest force: {name} of joint 'rail'$"):
        newton_euler.simulate(scene, integrator="RK4", step=1e-2)
