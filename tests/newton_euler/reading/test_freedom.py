"""Motions that constraints leave free, with slides and hinges in a model whose size is not 1."""

from __future__ import annotations

import numpy as np

from newton_euler.reading.quantities import freedom

SIZE = 3.0
UNITS = np.array([SIZE, 1.0, SIZE, 1.0, SIZE, 1.0])
"""Three slides and three hinges in turn."""


def test_motions_that_are_certainly_free_violate_no_constraint():
    """Two held motions, one in doubt (singular value 1e-5), three free."""
    draw = np.random.default_rng(1).standard_normal
    u, v = (np.linalg.qr(draw((n, n)))[0] for n in (3, 6))
    jacobian = u @ np.diag([1.0, 0.5, 1e-5]) @ v[:3]  # of dimensionless velocities
    found = freedom(jacobian, UNITS)
    assert found.certain_basis.shape == (4, 3)
    rates = jacobian / UNITS @ found.basis  # of the constraints, by the independent velocities
    # free motions leave round-off; the motion in doubt leaves its singular value
    np.testing.assert_allclose(rates @ found.certain_basis, 0.0, atol=1e-14)
    assert np.linalg.norm(rates, ord=2) > 1e-6
    np.testing.assert_allclose(found.basis[found.independent], np.eye(4), atol=1e-14)
