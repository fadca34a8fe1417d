"""Armature: analytic answers in both formulations, and refusals of compound joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mechanisms import MASS, STIFFNESS, mass_on_rail, pendulum

import newton_euler
from newton_euler import Armature, JointSpring
from newton_euler.compiled.formulations import FORMULATIONS, formulate
from newton_euler.errors import MechanismError
from newton_euler.model.compound_joint import Compound
from newton_euler.runs.assemble import initial_state

both = pytest.mark.parametrize("formulation", FORMULATIONS)


@both
def test_a_rotor_slows_a_pendulum_as_its_inertia_says(formulation: str) -> None:
    scene = pendulum()
    body, rotor = scene.mechanism.bodies[1], 0.7
    system = formulate(replace(scene, armatures=(Armature("pivot", rotor),)), formulation)
    evaluation = system.evaluate(*system.coordinates(initial_state(scene)))
    arm = np.linalg.norm(body.center_of_mass)
    axes = body.pose.rotation
    about_pivot = (axes @ body.inertia @ axes.T)[1, 1] + body.mass * arm**2
    wanted = body.mass * 9.81 * arm / (about_pivot + rotor)
    assert evaluation.angular_acceleration[1] == pytest.approx([0.0, wanted, 0.0], abs=1e-12)


@both
def test_a_mass_on_a_spring_swings_slower_and_keeps_its_energy(formulation: str) -> None:
    rotor = 3.0
    scene = mass_on_rail(
        JointSpring("rail", STIFFNESS, rest=0.1), armatures=(Armature("rail", rotor),), duration=1.0
    )
    run = newton_euler.simulate(scene, formulation)
    rate = np.sqrt(STIFFNESS / (MASS + rotor))
    wanted = 0.1 * (1.0 - np.cos(rate * run.time))
    assert run.position[:, 1, 2] == pytest.approx(wanted, abs=1e-9)  # DOP853 at rtol 1e-10
    energy = run.kinetic_energy + run.potential_energy
    assert energy == pytest.approx(energy[0], abs=1e-9)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Armature("pivot", 0.0), "armature of joint 'pivot': inertia is 0.0; needed: a positive"),
        (lambda: Armature("pivot", np.nan), "inertia is nan"),
        (lambda: Armature("pivot", 1.0, 0.5), "coordinate is 0.5"),
        (lambda: replace(pendulum(), armatures=(Armature("knee", 1.0),)), "is on an unknown joint 'knee'"),
        (
            lambda: replace(pendulum(), armatures=(Armature("pivot", 1.0, 1),)),
            "coordinate is 1; needed: an index",
        ),
        (
            lambda: replace(pendulum(), armatures=(Armature("pivot", 1.0),) * 2),
            "armature of coordinate 0 .* 2 of that name",
        ),
        (lambda: replace(pendulum(), armatures=("pivot",)), "armatures holds"),
        (
            lambda: Compound("j", "a", "b", [0, 0, 0], hinges=[[1, 0, 0], [1, 0, 0]]),
            "joint 'j': its hinges .* depend on each other",
        ),
        (lambda: Compound("j", "a", "b", [0, 0, 0], hinges=[[1, 0, 0]], ball=True), "has a ball and hinges"),
        (lambda: Compound("j", "a", "b", [0, 0, 0], slides=5), "slides is 5"),
    ],
)
def test_what_cannot_be(make, message: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(MechanismError, match=message):
        make()
