"""Springs, dampers and rotors on balls: analytic answers, finite differences, and all engines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from ball_scenes import AXIS, SCENES, sphere, two_ball_loop
from finite_difference import derivative, jacobian
from mechanisms import ball_loop, pendulum

import newton_euler
from newton_euler import Armature, BallArmature, BallSpring, JointSpring
from newton_euler.codegen.expression import Graph, differentiate
from newton_euler.compiled.formulations import FORMULATIONS
from newton_euler.equations.relative import Relative
from newton_euler.errors import MechanismError
from newton_euler.model.balls import rotation_by, rotation_vector, spin, spin_rate
from newton_euler.model.euler_parameters import from_rotation_vector, rotation
from newton_euler.model.spanning_tree import weld_loops
from newton_euler.reading.excitation import random_states

both = pytest.mark.parametrize("formulation", FORMULATIONS)

TIGHT = 1e-9
"""Of values near 1 after about ten oscillations at a tolerance of 1e-12 a step, some hundred steps."""


# Rotation vectors


@pytest.mark.parametrize("angle", [0.0, 1e-160, 1e-12, 1e-6, 0.3, 2.0, 3.1])
def test_rotation_vectors(angle: float) -> None:
    """Round-off of the matrix is 1e-16, over what is missing to half a turn."""
    vector = angle * AXIS
    matrix = rotation(from_rotation_vector(vector))
    assert rotation_vector(matrix) == pytest.approx(vector, abs=2e-15 / (np.pi - angle))
    assert rotation_by(vector) == pytest.approx(matrix, abs=1e-15)


@pytest.mark.parametrize("angle", [0.0, 1e-8, 0.5, 3.0])
def test_rotation_vectors_differentiate(angle: float) -> None:
    """Forward mode, as the implicit method needs it, against differences; at no turn too."""

    def turned(x: np.ndarray) -> np.ndarray:
        return rotation_vector(rotation_by(x) @ rotation_by(angle * AXIS))

    graph = Graph()
    variables = graph.variables(3)
    table = differentiate(graph, list(turned(variables)), list(variables))
    found = graph.prune(table.ravel()).run([0.0, 0.0, 0.0]).reshape(3, 3)
    # differences of order 6 of what varies over the 0.14 rad that 3 rad are short of half a turn
    assert found == pytest.approx(jacobian(turned, 3), abs=1e-9)


# Closed forms


def angles(run: newton_euler.Trajectory) -> np.ndarray:
    """(n, 3) rotation vectors of the body since the start."""
    start = rotation(run.quaternion[0, 1])
    return np.array([rotation_vector(rotation(p) @ start.T) for p in run.quaternion[:, 1]])


@both
@pytest.mark.parametrize("rotor", [0.0, 0.3])
@pytest.mark.parametrize("amplitude", [0.3, 3.0])
def test_a_globe_on_a_torsion_spring(formulation: str, rotor: float, amplitude: float) -> None:
    """It swings about one axis at sqrt(k / (I + a)), however far."""
    spring = BallSpring("ball", 4.0, rest=amplitude * AXIS)
    run = newton_euler.simulate(sphere(spring, rotor=rotor), formulation, rtol=1e-12, atol=1e-14)
    rate = np.sqrt(4.0 / (0.5 + rotor))
    turned = amplitude * (1.0 - np.cos(rate * run.time))
    wanted = amplitude * rate * np.sin(rate * run.time)
    assert np.abs(run.angular_velocity[:, 1] - wanted[:, None] * AXIS).max() < 10.0 * amplitude * TIGHT
    below = turned < 3.1  # what two poses tell
    assert below.sum() > 20
    assert np.abs(angles(run)[below] - turned[below, None] * AXIS).max() < 100.0 * TIGHT
    energy = run.kinetic_energy + run.potential_energy
    assert np.abs(energy - energy[0]).max() < TIGHT * 2.0 * amplitude**2
    assert energy[0] - 2.0 * 9.81 * 0.3 == pytest.approx(0.5 * 4.0 * amplitude**2, rel=1e-14)


@both
@pytest.mark.parametrize("integrator", ["DOP853", "Radau"])
def test_a_globe_in_oil(formulation: str, integrator: str) -> None:
    """omega decays as exp(-d t / (I + a)); the spring's theta begins at zero, Radau's Jacobian with it."""
    scene = sphere(BallSpring("ball", damping=0.4), rotor=0.3, spin=2.0)
    run = newton_euler.simulate(scene, formulation, integrator, rtol=1e-10, atol=1e-12)
    decay = np.exp(-0.4 / 0.8 * run.time)
    assert np.abs(run.angular_velocity[:, 1] - 2.0 * decay[:, None] * AXIS).max() < 1e-7
    lost = 0.5 * 0.8 * 4.0 * (decay**2 - 1.0)
    assert run.work == pytest.approx(lost, abs=1e-7)  # both to 1e-10 a step over some hundreds
    assert run.kinetic_energy - run.kinetic_energy[0] == pytest.approx(lost, abs=1e-7)


@pytest.mark.parametrize("name", ["ball in a loop", "compound, reversed"])
def test_powers_and_rates_are_derivatives(name: str) -> None:
    """Of energy along a motion, forces at work and no gravity's; of omega as the first body sees it."""
    scene = SCENES[name]
    system = Relative(scene)
    (state,) = random_states(scene, 1, seed=4)
    q, v = system.coordinates(state)
    vdot = system.acceleration(q, v)

    def moved(t: float) -> tuple[np.ndarray, np.ndarray]:
        return system.retract(q, v * t + 0.5 * vdot * t * t), v + vdot * t

    def energy(t: float) -> float:
        found = system.evaluate(*moved(t))
        return found.kinetic_energy + found.potential_energy

    power = system.rate(q, v)[system.work][0]
    # 1e-8: `retract` follows the motion to second order, differences of order 6 on energies of some 100 J
    assert derivative(energy) == pytest.approx(power, abs=1e-8 * abs(energy(0.0)))
    joint = next(iter(scene.loaded_balls))
    equations = scene.mechanism.joint_equations(joint)
    bodies = equations.first, equations.second

    def seen(t: float) -> np.ndarray:
        frames = [link.frame for link in system.links(*moved(t))]
        first, second = (frames[k] for k in bodies)
        return first.rotation.T @ spin(first, second)

    frames = [link.frame for link in system.links(q, v)]
    angular = system.evaluate(q, v).angular_acceleration
    rate = frames[bodies[0]].rotation.T @ spin_rate(frames, angular, bodies)
    assert derivative(seen) == pytest.approx(rate, abs=1e-8 * np.max(np.abs(rate)))


def test_a_loaded_ball_stays_in_the_tree() -> None:
    """Another ball of the loop is cut in its place, or a body is."""
    scene = ball_loop()
    mechanism = scene.mechanism
    assert [mechanism.joint_names[k] for k in weld_loops(mechanism).tree.cuts] == ["at_c"]
    welded = weld_loops(mechanism, loaded=["at_c"])
    assert [welded.mechanism.joint_names[k] for k in welded.tree.cuts] == ["at_c_weld"]
    assert welded.closing_joints == {"at_c": welded.mechanism.joint("at_c_weld")}
    for loaded, cut in (("at_b", "at_c"), ("at_c", "at_b")):
        two = two_ball_loop(loaded)
        welded = weld_loops(two.mechanism, loaded=two.loaded_balls)
        assert welded.closing_joints == {cut: two.mechanism.joint(cut)}


# What cannot be


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: BallSpring("b", -1.0), "spring of the ball of joint 'b': stiffness is -1.0; needed"),
        (lambda: BallSpring("b", 1.0, np.nan), "damping is nan"),
        (lambda: BallSpring("b", rest=[1.0, 2.0]), r"rest is \[1.0, 2.0\]; needed: three finite"),
        (lambda: BallSpring(3), "joint is 3; needed: a name"),
        (lambda: BallArmature("b", 0.0), "armature of the ball of joint 'b': inertia is 0.0; needed: a posi"),
        (lambda: replace(pendulum(), forces=(BallSpring("knee"),)), "is on an unknown joint 'knee'; needed"),
        (
            lambda: replace(pendulum(), forces=(BallSpring("pivot"),)),
            "spring of the ball of joint 'pivot': is on a revolute joint; needed: a joint with a ball",
        ),
        (
            lambda: replace(pendulum(), armatures=(BallArmature("pivot", 1.0),)),
            "armature of the ball of joint 'pivot': is on a revolute joint",
        ),
        (lambda: sphere(BallSpring("ball"), BallSpring("ball")), "spring of the ball .* 2 of that name"),
        (
            lambda: replace(sphere(), armatures=(BallArmature("ball", 1.0),) * 2),
            "armature of the ball of joint 'ball': 2 of that name; needed: unique names, and one of",
        ),
        (lambda: replace(sphere(), forces=(JointSpring("ball"),)), "coordinate is 0; needed: a joint with a"),
        (lambda: replace(sphere(), armatures=(Armature("ball", 1.0),)), "coordinate is 0; needed: a joint"),
    ],
)
def test_what_cannot_be(make, message: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(MechanismError, match=message):
        make()
