"""Armature and compound joints: analytic answers, both formulations, and the other engines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from armed_scenes import COMPOUNDS
from finite_difference import derivative
from mechanisms import MASS, STIFFNESS, mass_on_rail, pendulum, planar_four_bar

import newton_euler
from newton_euler import Armature, JointSpring, Mechanism
from newton_euler.assemble import initial_state
from newton_euler.equations.relative import Relative
from newton_euler.errors import MechanismError
from newton_euler.exercise import random_states
from newton_euler.integrators.compiled import FORMULATIONS, formulate
from newton_euler.model.compound_joint import Compound

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


def test_rotors_of_a_cut_joint_and_of_a_kept_one_do_the_same() -> None:
    """A four-bar linkage whose actuated joint the tree keeps, or cuts."""
    scene = replace(planar_four_bar(), armatures=(Armature("at_c", 0.4),))
    runs = []
    for order in ((0, 1, 2, 3), (3, 2, 0, 1)):
        joints = [scene.mechanism.joints[k] for k in order]
        own = replace(scene, mechanism=Mechanism(scene.mechanism.bodies, joints), initial_state=None)
        runs.append(newton_euler.simulate(own).position)
    assert runs[0] == pytest.approx(runs[1], abs=1e-8)  # two runs of DOP853 at rtol 1e-10


@pytest.mark.parametrize("name", COMPOUNDS)
def test_coordinates_of_a_compound_joint_have_the_rates_and_gammas_they_say(name: str) -> None:
    scene = COMPOUNDS[name]
    system = Relative(scene)
    (state,) = random_states(scene, 1, seed=2)
    q, v = system.coordinates(state)
    acceleration = np.linspace(-1.0, 2.0, system.nv)

    def measured(t: float) -> np.ndarray:
        now = system.retract(q, v * t + 0.5 * acceleration * t * t)
        frames = [link.frame for link in system.links(now, v + acceleration * t)]
        values = []
        for k in range(len(scene.mechanism.joints)):
            e = system.tree.equations(k)
            first, second = frames[e.first], frames[e.second]
            values += [c.jacobian(first, second).rate(first, second) for c in e.coordinates]
        return np.concatenate(values)

    links = system.links(q, v)
    predicted = []
    for k in range(len(scene.mechanism.joints)):
        e = system.tree.equations(k)
        first, second = links[e.first], links[e.second]
        for c in e.coordinates:
            r_i, t_i, r_j, t_j = c.jacobian(first.frame, second.frame)
            total = -c.gamma(first.frame, second.frame)
            for link, r, theta in ((first, r_i, t_i), (second, r_j, t_j)):
                total = total + r @ (link.acceleration + link.linear @ acceleration[link.path])
                total = total + theta @ (link.angular_acceleration + link.angular @ acceleration[link.path])
            predicted.append(total)
    found = derivative(measured)
    # 1e-8: differences of order 6 on rates of order 1 to 10
    assert found == pytest.approx(np.concatenate(predicted), abs=1e-8 * max(1.0, np.max(np.abs(found))))


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
