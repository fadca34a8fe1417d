"""Springs, dampers and wrenches against closed forms, in both formulations and both paths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mechanisms import (
    DAMPING,
    GRAVITY,
    MASS,
    STIFFNESS,
    inertia,
    line_spring,
    mass_on_rail,
    pendulum,
)

import newton_euler
from newton_euler import PD, Body, JointSpring, Mechanism, PointSpring, Scene, State, Wrench
from newton_euler.compiled.formulations import FORMULATIONS, formulate
from newton_euler.model.euler_parameters import from_rotation_vector
from newton_euler.model.joint_kinds import Free, Revolute
from newton_euler.runs.assemble import initial_state

TIGHT = 1e-10
"""Of values near 1 after about ten oscillations in some hundred steps at a tolerance of 1e-12."""


def simulate(scene, formulation):
    return newton_euler.simulate(scene, formulation, rtol=1e-12, atol=1e-14)


both = pytest.mark.parametrize("formulation", FORMULATIONS)


@both
@pytest.mark.parametrize(
    "spring", [line_spring(rest_length=2.0), JointSpring("rail", STIFFNESS)], ids=["points", "joint"]
)
def test_a_mass_on_a_spring_oscillates_about_where_it_would_hang(formulation, spring):
    run = simulate(mass_on_rail(spring, gravity=GRAVITY), formulation)
    sag = MASS * 9.81 / STIFFNESS
    z = -sag * (1.0 - np.cos(np.sqrt(STIFFNESS / MASS) * run.time))
    assert np.abs(run.position[:, 1, 2] - z).max() < TIGHT
    assert np.abs(run.kinetic_energy + run.potential_energy).max() < STIFFNESS * TIGHT
    assert not run.work.any()


@both
@pytest.mark.parametrize(
    "spring",
    [
        line_spring(rest_length=1.0, damping=DAMPING),
        JointSpring("rail", STIFFNESS, DAMPING, rest=1.0),
        JointSpring("rail", STIFFNESS, DAMPING, rest=1.0, coordinate=np.int64(0)),
    ],
    ids=["points", "joint", "any integer"],
)
def test_a_damped_oscillator_loses_the_work_of_its_damper(formulation, spring):
    run = simulate(mass_on_rail(spring), formulation)
    decay = 0.5 * DAMPING / MASS
    omega = np.sqrt(STIFFNESS / MASS - decay**2)
    t = run.time
    envelope = np.exp(-decay * t)
    x = 1.0 - envelope * (np.cos(omega * t) + decay / omega * np.sin(omega * t))
    rate = envelope * (omega + decay**2 / omega) * np.sin(omega * t)
    assert np.abs(run.position[:, 1, 2] - x).max() < TIGHT
    energy = 0.5 * MASS * rate**2 + 0.5 * STIFFNESS * (x - 1.0) ** 2
    assert np.abs(run.kinetic_energy + run.potential_energy - energy).max() < STIFFNESS * TIGHT
    lost = energy - 0.5 * STIFFNESS
    assert np.abs(run.work - lost).max() < STIFFNESS * TIGHT
    balance = run.kinetic_energy + run.potential_energy - 0.5 * STIFFNESS - run.work
    assert np.abs(balance).max() < 1e-10 * 0.5 * STIFFNESS  # both integrated at that tolerance


@both
@pytest.mark.parametrize("joint", ["pivot", "second_pivot"])
def test_a_torsion_spring_turns_a_rod_more_than_once(formulation, joint):
    """On the joint that the tree keeps and on the one it cuts, whose angle is carried along."""
    scene = pendulum()
    (pivot,) = scene.mechanism.joints
    second = Revolute("second_pivot", "rod", "ground", [0.0, 0.5, 0.0], axis=[0.0, 1.0, 0.0])
    mechanism = Mechanism(scene.mechanism.bodies, [pivot, second])
    sign = 1.0 if joint == "pivot" else -1.0
    spring = JointSpring(joint, 4.0, rest=sign * 3.0 * np.pi)
    scene = Scene("torsion", mechanism, 5.0, 0.1, forces=(spring,))
    run = newton_euler.simulate(scene, formulation)  # round-off of the redundant joint bars 1e-12
    about_pivot = 1.01 / 12.0 + 0.25  # of `bar`, 1 m and 1 kg
    angle = 3.0 * np.pi * (1.0 - np.cos(np.sqrt(4.0 / about_pivot) * run.time))
    assert angle.max() > 5.0 * np.pi
    wanted = 0.5 * np.array([np.cos(angle), 0.0 * angle, -np.sin(angle)]).T
    assert np.abs(run.position[:, 1] - wanted).max() < 1e-7  # 50 rad traveled, each turn to 1e-9
    assert np.ptp(run.kinetic_energy + run.potential_energy) < 1e-8 * run.potential_energy[0]


def two_bodies(*forces, spin=0.0, **fields):
    """Two floating bodies 1 m apart."""
    bodies = [
        Body.ground(),
        Body("a", 2.0, [0.0, 0.0, 0.0], inertia(0.1, 0.2, 0.25, turn=(0.3, 0.1, 0.2))),
        Body("b", 3.0, [1.0, 0.0, 0.0], inertia(0.3, 0.2, 0.25)),
    ]
    joints = [Free(f"{name}_floats", "ground", name, [0.0, 0.0, 0.0]) for name in "ab"]
    mechanism = Mechanism(bodies, joints)
    start = State.initial(mechanism)
    state = replace(
        start,
        linear_velocity=spin * np.array([[0.0, 0.0, 0.0], [0.1, 0.3, -0.2], [0.4, 0.0, 0.2]]),
        angular_velocity=spin * np.array([[0.0, 0.0, 0.0], [1.0, 2.0, -0.5], [0.3, -1.0, 2.0]]),
    )
    return Scene("two", mechanism, 5.0, 0.1, forces=forces, initial_state=state, **fields)


@both
@pytest.mark.parametrize("rest", [0.8, 0.0])
def test_two_bodies_on_a_spring_swing_as_their_reduced_mass(formulation, rest):
    """Without a rest length their points meet and pass each other."""
    ends = ("a", "b", [0.0, 0.0, 0.0], [1.0, 0.0, 0.0])
    spring = PointSpring("s", *ends, stiffness=STIFFNESS, rest_length=rest)
    run = simulate(two_bodies(spring), formulation)
    omega = np.sqrt(STIFFNESS * (1.0 / 2.0 + 1.0 / 3.0))
    distance = rest + (1.0 - rest) * np.cos(omega * run.time)
    assert np.abs(run.position[:, 2, 0] - run.position[:, 1, 0] - distance).max() < TIGHT
    assert np.abs(2.0 * run.position[:, 1] + 3.0 * run.position[:, 2] - [3.0, 0.0, 0.0]).max() < TIGHT


@both
def test_forces_inside_change_no_momentum(formulation):
    ends = ("a", "b", [0.1, 0.2, 0.0], [0.7, 0.0, 0.3])
    spring = PointSpring("s", *ends, stiffness=STIFFNESS, rest_length=0.3, damping=1.0)
    scene = two_bodies(spring, spin=1.0)
    run = simulate(scene, formulation)
    masses = np.array([2.0, 3.0])[:, None]
    momenta = []
    for n in range(len(run.time)):
        state = State(
            *(a[n] for a in (run.position, run.quaternion, run.linear_velocity, run.angular_velocity))
        )
        p = masses * state.linear_velocity[1:]
        spins = [
            frame.rotation @ body.inertia @ frame.rotation.T @ frame.angular_velocity
            for body, frame in zip(scene.mechanism.bodies, state.frames(), strict=True)
        ][1:]
        momenta.append([*p.sum(axis=0), *(np.cross(state.position[1:], p) + spins).sum(axis=0)])
    assert np.ptp(momenta, axis=0).max() < TIGHT
    energy = run.kinetic_energy + run.potential_energy
    assert energy[-1] < energy[0] - 0.1
    assert np.abs(energy - energy[0] - run.work).max() < TIGHT


def one_body(*forces, omega=(0.0, 0.0, 0.0), quaternion=(1.0, 0.0, 0.0, 0.0)):
    """A floating body that is round about its z axis, which its frame may be turned against."""
    body = Body("stone", 2.0, [0.5, 0.0, 0.0], inertia(0.3, 0.3, 0.2), quaternion)
    mechanism = Mechanism([Body.ground(), body], [Free("floats", "ground", "stone", [0.0, 0.0, 0.0])])
    state = replace(State.initial(mechanism), angular_velocity=np.array([np.zeros(3), omega]))
    return Scene("stone", mechanism, 4.0, 0.1, forces=forces, initial_state=state)


@both
def test_a_force_turns_with_its_body(formulation):
    """A jet of 3 N across a body that spins at 2 rad/s: its velocity goes round a circle."""
    about_z = from_rotation_vector(np.array([0.0, 0.0, 0.7]))  # of the body's frame: no matter
    jet = Wrench("jet", "stone", [0.5, 0.0, 0.0], force=[3.0, 0.0, 0.0], frame="body")
    run = simulate(one_body(jet, omega=(0.0, 0.0, 2.0), quaternion=about_z), formulation)
    t, v = run.time, 3.0 / (2.0 * 2.0)
    velocity = v * np.array([np.sin(2.0 * t), 1.0 - np.cos(2.0 * t), 0.0 * t]).T
    assert np.abs(run.linear_velocity[:, 1] - velocity).max() < TIGHT
    assert np.abs(run.work - np.sum(velocity**2, axis=1)).max() < TIGHT  # m v^2 / 2


@both
@pytest.mark.parametrize("frame", ["world", "body"])
def test_a_torque_along_a_fixed_axis(formulation, frame):
    wrench = Wrench("motor", "stone", [0.5, 0.0, 0.0], torque=[0.0, 0.0, 0.1], frame=frame)
    run = simulate(one_body(wrench, omega=(0.0, 0.0, 1.0)), formulation)
    assert np.abs(run.angular_velocity[:, 1, 2] - (1.0 + 0.5 * run.time)).max() < TIGHT
    turned = run.time + 0.25 * run.time**2
    assert np.abs(run.work - 0.1 * turned).max() < TIGHT


@both
def test_a_force_off_the_center_of_mass_turns_its_body(formulation):
    force, point = np.array([1.0, -2.0, 0.5]), np.array([0.9, 0.3, -0.2])
    turn = from_rotation_vector(np.array([0.4, -0.7, 1.1]))
    scene = one_body(Wrench("push", "stone", point, force, [0.1, 0.2, 0.3]), quaternion=turn)
    (frame,) = initial_state(scene).frames()[1:]
    tensor = frame.rotation @ scene.mechanism.bodies[1].inertia @ frame.rotation.T
    system = formulate(scene, formulation)
    found = system.evaluate(*system.coordinates(initial_state(scene)))
    assert found.linear_acceleration[1] == pytest.approx(force / 2.0, rel=1e-14)
    torque = np.cross(point - np.array([0.5, 0.0, 0.0]), force) + np.array([0.1, 0.2, 0.3])
    assert found.angular_acceleration[1] == pytest.approx(np.linalg.solve(tensor, torque), rel=1e-13)


def test_work_is_there_only_if_it_is_asked_for():
    spring = JointSpring("rail", 1.0, 1.0)
    law = PD("rail", 1.0, 1.0, 0.0)
    for scene, works in (
        (mass_on_rail(), False),
        (mass_on_rail(spring), True),
        (mass_on_rail(control=(law,)), True),
        (mass_on_rail(spring, control=(law,), outputs=frozenset({"velocities"})), False),
    ):
        assert scene.tracks_work == works
        for formulation in FORMULATIONS:
            run = newton_euler.simulate(replace(scene, duration=0.1), formulation)
            assert (run.work is not None) == works
            assert formulate(scene, formulation).nq == (1 if formulation == "relative" else 7) + works
