"""Euler parameters keep norm 1 whatever a run does about constraints; fast rotation in fixed steps."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

import newton_euler
import urdf
from newton_euler import Body, Mechanism, Scene
from newton_euler.model.euler_parameters import angle_between, from_rotation_vector
from newton_euler.model.joint_kinds import Free, Spherical
from newton_euler.model.state import State

SPIN = 100.0 * np.array([0.3, -0.7, 1.1]) / np.linalg.norm([0.3, -0.7, 1.1])
"""rad/s: a tenth of a radian in a step of 1 ms."""

FORMULATIONS = ("relative", "cartesian")
STABILIZATIONS = ("projection", "baumgarte", "none")


def free_body(moments, duration=0.5) -> Scene:
    """1 kg with these principal moments of inertia, kg m^2, spinning freely."""
    body = Body("top", 1.0, np.zeros(3), np.diag(moments))
    mechanism = Mechanism([Body.ground(), body], [Free("floating", "ground", "top", np.zeros(3))])
    state = State.initial(mechanism)
    state.angular_velocity[1] = SPIN
    outputs = frozenset({"velocities", "energy"})
    return Scene("top", mechanism, duration, 0.1 * duration, initial_state=state, outputs=outputs)


@pytest.mark.parametrize("stabilization", STABILIZATIONS)
@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_a_sphere_spins_on_under_semi_implicit_euler(formulation, stabilization):
    """Without gyroscopic torque its rates are constant, and each step turns it by 2 atan(h omega / 2)."""
    scene = free_body([1.0, 1.0, 1.0])
    run = newton_euler.simulate(scene, formulation, "Euler", step=1e-3, stabilization=stabilization)
    # half an epsilon a step and component, of one sign at worst
    assert run.kinetic_energy == pytest.approx(0.5 * SPIN @ SPIN, rel=500 * 4e-16)
    assert run.angular_velocity[-1, 1] == pytest.approx(SPIN, rel=1e-12)
    turned = 2.0 * np.arctan(0.05) * 500
    wanted = from_rotation_vector(turned * SPIN / 100.0)
    assert angle_between(run.quaternion[-1, 1], wanted) < 500 * 4e-16 * 10


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_a_step_of_semi_implicit_euler_adds_energy(formulation):
    """h^2 / 2 t^T I^-1 t of the gyroscopic torque t, which does no work itself."""
    moments = np.array([1.0, 2.0, 2.5])
    scene = free_body(moments, duration=1e-3)
    run = newton_euler.simulate(scene, formulation, "Euler", step=1e-4)
    torque = np.cross(SPIN, moments * SPIN)
    added = 0.5e-8 * torque @ (torque / moments)
    # energies of 1e4 J that differ by 0.2 J have 11 common digits to lose
    assert run.kinetic_energy[1] - run.kinetic_energy[0] == pytest.approx(added, rel=1e-9)


def arm(duration=0.5) -> Scene:
    """1 kg on a ball joint, its center of mass 1 m away, at 23 rad/s."""
    body = Body("arm", 1.0, np.array([1.0, 0.0, 0.0]), np.diag([0.2, 0.1, 0.15]))
    mechanism = Mechanism([Body.ground(), body], [Spherical("ball", "ground", "arm", np.zeros(3))])
    state, spin = State.initial(mechanism), np.array([3.0, -20.0, 11.0])
    state.angular_velocity[1], state.linear_velocity[1] = spin, np.cross(spin, [1.0, 0.0, 0.0])
    gravity = np.array([0.0, 0.0, -9.81])
    outputs = frozenset({"violation"})
    return Scene("arm", mechanism, duration, 0.1, gravity, initial_state=state, outputs=outputs)


COARSE = {
    "DOP853": {"rtol": 1e-3, "atol": 1e-5},
    "Radau": {"rtol": 1e-3, "atol": 1e-5},
    "RK4": {"step": 4e-2},
    "Euler": {"step": 1e-3},
}
"""Steps that lose a hundredth of a norm in some seconds without correction."""

ENGINES = {
    **{
        f"newton_euler, {formulation}": partial(newton_euler.simulate, formulation=formulation)
        for formulation in FORMULATIONS
    },
    "pinocchio": urdf.simulate,
}


@pytest.mark.parametrize("stabilization", STABILIZATIONS)
@pytest.mark.parametrize("integrator", COARSE)
@pytest.mark.parametrize("engine", ENGINES)
def test_norms_are_kept(engine, integrator, stabilization):
    options = COARSE[integrator] | {"integrator": integrator, "stabilization": stabilization}
    if engine == "newton_euler, cartesian":  # which would open its ball, or could not be projected
        options |= {"RK4": {"step": 1e-2}, "Euler": {"step": 2e-5}}.get(integrator, {})
        options |= {"rtol": 1e-5, "atol": 1e-7} if "rtol" in options else {}
    run = ENGINES[engine](arm(), **options)
    # the paper's gains hold norms as they hold joints, to what these tolerances lose in 1 / alpha
    own = engine == "newton_euler, cartesian" and stabilization == "baumgarte" and integrator != "Euler"
    assert np.linalg.norm(run.quaternion[:, 1], axis=1) == pytest.approx(1.0, rel=1e-4 if own else 1e-15)
    if engine != "newton_euler, cartesian":  # whose ball is a constraint, and may drift
        # a rotation scaled by the square of a norm would draw the body off
        assert np.linalg.norm(run.position[:, 1], axis=1) == pytest.approx(1.0, rel=1e-14)
