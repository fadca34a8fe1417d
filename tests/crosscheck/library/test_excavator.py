"""The excavator: poses, forces and modes beside plane trigonometry and virtual work."""

from __future__ import annotations

import numpy as np
import planar_excavator as plane
import pytest
from finite_difference import jacobian
from scipy.integrate import simpson
from scipy.linalg import eigvals

from crosscheck.library import load
from crosscheck.library.excavator import CYLINDERS
from newton_euler import equilibrium, inverse_dynamics, linearize, simulate, solve_poses, statics
from newton_euler.equations.redundancy import mobility
from newton_euler.model.euler_parameters import rotations

POSES = np.array(
    [
        [0.0, 0.0, 0.0],
        [0.12, 0.35, 0.22],
        [0.25, 0.70, 0.45],
        [-0.60, -0.30, -0.45],
        [0.50, 1.00, 0.50],
        [-0.30, 0.80, 0.10],
    ]
)
"""Displacements of the cylinders, m, over most of their strokes."""

LOADS = ({"soil": 0.0, "digging_force": 0.0}, {"soil": 1500.0, "digging_force": 80e3})


def poses_of(scene):
    found = solve_poses(scene, dict(zip(plane.SLIDES, POSES.T, strict=True)))
    assert found.reached.all()
    return found


def test_three_degrees_of_freedom_without_redundant_constraints():
    found = mobility(load("excavator"))
    assert found.degrees_of_freedom == 3
    assert not len(found.redundant)


def test_strokes_contain_the_motion():
    for name, cylinder in CYLINDERS.items():
        for length in (plane.LENGTHS[name], plane.LENGTHS[name] + cylinder.extension):
            assert cylinder.closed_length < length < cylinder.closed_length + cylinder.stroke


def test_poses_are_those_of_plane_trigonometry():
    scene = load("excavator")
    poses = poses_of(scene)
    index = scene.mechanism.body_index("bucket")
    bucket = scene.mechanism.body("bucket")
    point = next(force for force in scene.forces if force.name == "digging_force").point
    arm = rotations(poses.quaternion[:, index]) @ (point - bucket.center_of_mass)
    found = poses.position[:, index] + arm
    expected = np.array([plane.tip(each) for each in POSES])
    np.testing.assert_allclose(found[:, [0, 2]], expected, rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(found[:, 1], 0.0, atol=1e-12)


@pytest.mark.parametrize("loads", LOADS, ids=["weight", "loaded"])
def test_controllers_hold_the_arm_at_the_start(loads):
    given = [law.feedforward for law in load("excavator", **loads).control]
    np.testing.assert_allclose(given, plane.cylinder_forces(POSES[0], **loads), rtol=0.0, atol=100.0)  # N


@pytest.mark.parametrize("loads", LOADS, ids=["weight", "loaded"])
def test_static_forces_of_the_cylinders_by_virtual_work(loads):
    scene = load("excavator", **loads)
    found = statics(scene, poses_of(scene))
    assert found.actuators == plane.SLIDES
    expected = np.array([plane.cylinder_forces(each, **loads) for each in POSES])
    scale = np.max(np.abs(expected), axis=1, keepdims=True)
    assert np.max(np.abs(found.actuator_force - expected) / scale) < 1e-9


def test_forces_of_moving_cylinders_by_virtual_power():
    loads = LOADS[1]
    scene, rng = load("excavator", **loads), np.random.default_rng(0)
    rates, accelerations = rng.uniform(-0.5, 0.5, POSES.shape), rng.uniform(-1.0, 1.0, POSES.shape)
    found = inverse_dynamics(
        scene,
        poses_of(scene),
        dict(zip(plane.SLIDES, accelerations.T, strict=True)),
        rates=dict(zip(plane.SLIDES, rates.T, strict=True)),
    )
    expected = np.array(
        [plane.cylinder_forces(*each, **loads) for each in zip(POSES, rates, accelerations, strict=True)]
    )
    scale = np.max(np.abs(expected), axis=1, keepdims=True)
    assert np.max(np.abs(found.actuator_force - expected) / scale) < 1e-9


def test_the_work_of_a_run_is_its_change_of_energy():
    scene = load("excavator")
    run = simulate(scene, rtol=1e-12, atol=1e-14)
    # displacements and rates of the cylinders, from the centers of mass of rods relative to barrels
    pairs = [[run.body_names.index(f"{name}_{part}") for part in ("barrel", "rod")] for name in CYLINDERS]
    span = np.stack([run.position[:, rod] - run.position[:, barrel] for barrel, rod in pairs], axis=1)
    velocity = [run.linear_velocity[:, rod] - run.linear_velocity[:, barrel] for barrel, rod in pairs]
    length = np.linalg.norm(span, axis=2)
    rate = np.sum(np.stack(velocity, axis=1) * span, axis=2) / length
    x = length - length[0]
    targets = [each.extension for each in CYLINDERS.values()]
    np.testing.assert_allclose(x[-1], targets, rtol=0.0, atol=0.04)
    # cylinders that hold the arm against gravity and the ground do this work at all speeds
    slow = np.array([plane.cylinder_forces(each, digging_force=50e3) for each in x])
    power = np.sum((run.actuator_force - slow) * rate, axis=1)
    half = len(run.time) // 2 + 1  # until the arm is fastest
    work, energy = simpson(power[:half], x=run.time[:half]), plane.kinetic_energy(x[half - 1], rate[half - 1])
    assert energy > 1e3
    assert work == pytest.approx(energy, rel=1e-5)
    assert run.kinetic_energy[half - 1] == pytest.approx(energy, rel=1e-9)


@pytest.mark.slow
def test_modes_of_the_arm_by_lagrange():
    """Eigenvalues of the arm under its controllers, at rest without the resistance of the ground."""
    scene = load("excavator", digging_force=0.0)
    state = equilibrium(scene)
    found = linearize(scene, state, plane.SLIDES).modes().eigenvalues
    stiffness = np.diag([each.stiffness for each in CYLINDERS.values()])
    damping = np.diag([each.damping for each in CYLINDERS.values()])
    feedforward = np.array([law.feedforward for law in scene.control])

    # equilibrium by fixed-point iteration, then the Hessian of the potential energy by finite differences
    d = np.zeros(3)
    for _ in range(30):
        d = np.linalg.solve(stiffness, feedforward - plane.cylinder_forces(d))
    hessian = jacobian(lambda e: plane.cylinder_forces(d + e), 3)
    mass = np.array(
        [plane.cylinder_forces(d, accelerations=e) - plane.cylinder_forces(d) for e in np.eye(3)]
    ).T
    inverse = np.linalg.inv(mass)
    top = np.hstack([np.zeros((3, 3)), np.eye(3)])
    expected = eigvals(np.vstack([top, np.hstack([-inverse @ (stiffness + hessian), -inverse @ damping])]))
    expected = expected[expected.imag >= 0.0]
    order = np.argsort(np.abs(expected))
    found = found[np.argsort(np.abs(found))]
    np.testing.assert_allclose(found, expected[order], rtol=1e-6)
