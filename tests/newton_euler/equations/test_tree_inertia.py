"""Mass matrices and their factors, from composite and from articulated bodies, against dense algebra."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from armed_scenes import COMPOUNDS, armed
from ball_scenes import SCENES as BALLS

from crosscheck.scenes import load
from newton_euler.assemble import initial_state
from newton_euler.equations.redundancy import rows_in_use
from newton_euler.equations.relative import Relative
from newton_euler.equations.sparse import factorise, sparse_vector, to_array
from newton_euler.equations.tree_inertia import TreeFactor, is_deep
from newton_euler.model.joint_kinds import Spherical
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.spanning_tree import SpanningTree

SCENES = {"chain": load("chain", N=12), "stewart": load("stewart")} | COMPOUNDS | BALLS


def away(scene):
    """The system without rotors, and a state far from the initial pose."""
    system = Relative(replace(scene, armatures=()))
    rng = np.random.default_rng(3)
    q, v = system.coordinates(initial_state(scene))
    for _ in range(3):
        q = system.retract(q, 0.3 * rng.standard_normal(system.nv))
    return system, q, v


@pytest.mark.parametrize("name", SCENES)
def test_mass_matrix_is_that_of_the_bodies_kinetic_energy(name):
    system, q, v = away(SCENES[name])
    expected = np.zeros((system.nv, system.nv))
    bodies = system.mechanism.bodies
    motions = system.velocity_transformation(q).reshape(len(bodies), 6, system.nv)
    for body, frame, inertia, t in zip(bodies, system.frames(q, v), system.inertias, motions, strict=True):
        turned = frame.rotation @ inertia @ frame.rotation.T
        expected += body.mass * t[:3].T @ t[:3] + t[3:].T @ turned @ t[3:]
    found = to_array(system.mass_rows(q), system.nv)
    # 1e-14: sums of a few dozen products
    assert found == pytest.approx(expected, abs=1e-14 * np.max(np.abs(expected)))


@pytest.mark.parametrize("name", SCENES)
def test_articulated_bodies_give_the_factors_of_the_mass_matrix(name):
    system, q, v = away(SCENES[name])
    rows, n = system.mass_rows(q), system.nv
    rotors = {0: 0.5, n - 1: 0.25}
    for k, inertia in rotors.items():
        rows[k][k] += inertia
    usual = [1.0 + k for k in range(n)]
    found = TreeFactor(system.tree, system.links(q, v), system.rigid_bodies(q, v), rotors, usual)
    expected = factorise(rows, range(n - 1, -1, -1), usual)
    # 1e-10: both round at 1e-16 of M, whose condition is below 1e5
    assert found.pivots == pytest.approx(expected.pivots, rel=1e-10)
    assert found.pivot_ratio == pytest.approx(expected.pivot_ratio, rel=1e-10)
    several = np.random.default_rng(4).standard_normal(n)
    several[n // 2] = 0.0
    for right in (sparse_vector(several), {0: 1.0}, {n - 1: 1.0}):
        lower = expected.lower(right)
        for mine, other in (
            (found.lower(right), lower),
            (found.scaled(lower), expected.scaled(lower)),
            (found.upper(lower), expected.upper(lower)),
        ):
            values, others = (np.array([x.get(k, 0.0) for k in range(n)]) for x in (mine, other))
            assert values == pytest.approx(others, abs=1e-10 * np.max(np.abs(others)))


def test_articulated_bodies_serve_where_many_velocities_move_each_body():
    found = {N: is_deep(SpanningTree(load("chain", N=N).mechanism)) for N in (5, 20)}
    assert found == {5: False, 20: True}
    assert not is_deep(SpanningTree(load("tracker").mechanism))


def test_a_deep_tree_with_a_loop_and_rotors_is_solved_as_by_dense_algebra():
    chain = load("chain", N=16)
    mechanism = chain.mechanism
    end = Spherical("end", mechanism.body_names[-1], "ground", [16.0, 0.0, 0.0])
    scene = armed(replace(chain, mechanism=Mechanism(mechanism.bodies, [*mechanism.joints, end])))
    system = Relative(scene)
    assert is_deep(system.tree)
    assert system.constrained
    q, v = system.coordinates(initial_state(scene))
    rng = np.random.default_rng(5)
    q, v = q + 0.2 * rng.standard_normal(system.nq), rng.standard_normal(system.nv)
    found, _ = system.sparse_evaluation(q, v, rows_in_use(system))
    expected = system.evaluate(q, v)
    for name in ("linear_acceleration", "angular_acceleration", "reaction_force", "reaction_torque"):
        mine, other = getattr(found, name).astype(float), getattr(expected, name)
        # 1e-9: M and the Schur complement have conditions of 1e4 and 1e2
        assert mine == pytest.approx(other, abs=1e-9 * np.max(np.abs(other))), name
