"""Both formulations: against the paper's symbols, against each other, and against physics."""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from finite_difference import derivative, jacobian
from mechanisms import spinning_top

from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.formulation import MAX_REMEMBERED_STATES
from newton_euler.equations.relative import Relative
from newton_euler.equations.sparse import to_array
from newton_euler.model.euler_parameters import matrix_l, rotation
from newton_euler.runs.assemble import initial_state


def test_tracker_counts_as_the_paper_with_a_fixed_ground(tracker):
    system = Cartesian(tracker)
    matrix, right = system.equation_21(*system.coordinates(initial_state(tracker)))
    assert (system.nv, system.rows, len(system.bodies)) == (42, 34, 6)
    assert matrix.shape == (76, 76)
    assert right.shape == (76,)
    assert np.linalg.matrix_rank(system.phi_jacobian(system.coordinates(initial_state(tracker))[0])) == 40


def test_tree_of_the_tracker_cuts_its_balls(tracker):
    system = Relative(tracker)
    assert [tracker.mechanism.joint_names[k] for k in system.tree.cuts] == ["ball_67", "ball_57"]
    assert (system.tree.nq, system.nv) == (8, 8)


def test_blocks_of_equation_21_are_the_papers(tracker, tracker_states):
    """B = [Phi_r, 1/2 Phi_p L^T], Phi_q by differences on the unit spheres, b = omega' x J' omega'."""
    system = Cartesian(replace(tracker, outputs=frozenset()))  # no work beside the coordinates
    q, qdot = system.coordinates(tracker_states[0])
    n = len(system.bodies)
    phi_q, b = (
        to_array(rows, columns)
        for rows, columns in zip(system.Phi_q_and_B(q, qdot), (7 * n, 6 * n), strict=True)
    )
    tangents = np.zeros((system.nq, 6 * len(system.bodies)))
    for k, (_, p) in enumerate(system.split(q)):
        columns = slice(7 * k + 3, 7 * k + 7)
        half = 0.5 * phi_q[:, columns] @ matrix_l(p).T
        assert np.allclose(b[:, 6 * k : 6 * k + 3], phi_q[:, 7 * k : 7 * k + 3])
        assert np.allclose(b[:, 6 * k + 3 : 6 * k + 6], half, atol=1e-15)  # products of numbers below 1
        tangents[7 * k : 7 * k + 3, 6 * k : 6 * k + 3] = np.eye(3)
        tangents[columns, 6 * k + 3 : 6 * k + 6] = 0.5 * matrix_l(p).T

    def phi_along(x):
        return system.joint_phi(q + tangents @ x)

    # second-order terms off the unit sphere are odd-free and cancel in the central difference
    assert np.allclose(jacobian(phi_along, tangents.shape[1]), phi_q @ tangents, atol=1e-10)
    velocity_terms = system.b(q, qdot)
    for k, ((_, p), (_, pdot), body) in enumerate(
        zip(system.split(q), system.split(qdot), system.bodies, strict=True)
    ):
        omega = 2.0 * matrix_l(p) @ pdot
        expected = np.cross(omega, body.inertia @ omega)
        assert np.allclose(velocity_terms[6 * k + 3 : 6 * k + 6], expected, rtol=0, atol=1e-15)
    mass = system.M(q)
    assert np.allclose(mass[3:6, 3:7], 2.0 * system.bodies[0].inertia @ matrix_l(q[3:7]))
    norm, c = system.norms(q), system.c(qdot)
    assert np.allclose(to_array(system.P(q), 7 * n) @ qdot, 0.0, atol=1e-15)
    assert np.allclose(norm, 0.0, atol=1e-15)
    assert c[-1] == pytest.approx(qdot[-4:] @ qdot[-4:])


def test_multipliers_are_the_papers_reaction_signs(tracker):
    """Equations (17) and (18): m rddot = f + Phi_r^T lambda, on the panel, which no actuator drives."""
    system = Cartesian(tracker)
    q, qdot = system.coordinates(initial_state(tracker))
    qddot, multipliers = system.solve(q, qdot)
    b = to_array(system.Phi_q_and_B(q, qdot)[1], 36)
    panel = tracker.mechanism.bodies[6]
    force = b[:, 30:33].T @ multipliers
    moment = b[:, 33:36].T @ multipliers
    assert np.allclose(panel.mass * qddot[35:38], force, atol=1e-13)
    assert np.allclose(panel.inertia @ (2.0 * matrix_l(q[38:42]) @ qddot[38:42]), moment, atol=1e-13)


@pytest.mark.parametrize("alpha", [0.0, 10.0])
def test_baumgarte_terms(tracker, tracker_states, alpha):
    """Off the constraints, Phi'' = -2 alpha Phi' - alpha^2 Phi, Euler-parameter rows included."""
    rng = np.random.default_rng(2)
    tracker = replace(tracker, outputs=frozenset())  # no work beside the coordinates
    cartesian = Cartesian(tracker, alpha)
    q, v = cartesian.coordinates(tracker_states[1])
    q, v = q + 1e-3 * rng.standard_normal(q.size), v + 1e-3 * rng.standard_normal(v.size)
    a = cartesian.acceleration(q, v)
    norm, c = cartesian.norms(q), cartesian.c(v)
    p_matrix = to_array(cartesian.P(q), q.size)
    second_rate = p_matrix @ a + c
    assert np.allclose(second_rate, -2 * alpha * (p_matrix @ v) - alpha**2 * norm, atol=1e-11)
    phi, gamma = cartesian.Phi(q, v), cartesian.gamma(q, v)
    phi_q = to_array(cartesian.Phi_q_and_B(q, v)[0], q.size)
    expected = -2 * alpha * (phi_q @ v) - alpha**2 * phi
    # accelerations are of order 1e2 and the matrix has condition 1e4
    assert np.allclose(phi_q @ a - gamma, expected, atol=1e-9)
    relative = Relative(tracker, alpha)
    q, v = relative.coordinates(tracker_states[1])
    q, v = q + 1e-3 * rng.standard_normal(8), v + 1e-3 * rng.standard_normal(8)
    a = relative.acceleration(q, v)
    rate = derivative(lambda s: relative.phi_jacobian(q + s * v + 0.5 * s**2 * a) @ (v + s * a))
    expected = -2 * alpha * (relative.phi_jacobian(q) @ v) - alpha**2 * relative.phi(q)
    assert np.allclose(rate, expected, atol=1e-9)


def test_top_follows_euler_equations_about_its_fixed_point():
    scene = spinning_top()
    top = scene.mechanism.bodies[1]
    for formulation in (Relative, Cartesian):
        system = formulation(scene)
        at = system.evaluate(*system.coordinates(initial_state(scene)))
        r, omega = at.state.position[1], at.state.angular_velocity[1]
        a = rotation(at.state.quaternion[1])
        about_tip = a @ top.inertia @ a.T + top.mass * (r @ r * np.eye(3) - np.outer(r, r))
        torque = np.cross(r, top.mass * scene.gravity)
        expected = np.linalg.solve(about_tip, torque - np.cross(omega, about_tip @ omega))
        assert np.allclose(at.angular_acceleration[1], expected, rtol=1e-12)  # 3 x 3, condition below 100
        acceleration = np.cross(expected, r) + np.cross(omega, np.cross(omega, r))
        support = top.mass * (acceleration - scene.gravity)
        assert np.allclose(at.reaction_force[0], support, rtol=1e-12)
        assert np.allclose(at.reaction_torque[0], 0.0, atol=1e-12)


def test_threads_may_share_equations(tracker):
    """Each finds what it has worked out itself, whatever others forget in between."""
    system, before = Relative(tracker), sys.getswitchinterval()
    rest = np.zeros(system.nv)

    def remember(thread: int) -> bool:
        states = (np.full(system.nq, float(2 * n + thread)) for n in range(100 * MAX_REMEMBERED_STATES))
        return all(system.remembered(q, rest, lambda q, _: q[0]) == q[0] for q in states)

    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(2) as pool:
            assert all(pool.map(remember, range(2)))
    finally:
        sys.setswitchinterval(before)
