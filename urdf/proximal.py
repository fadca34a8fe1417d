"""How Pinocchio's `constraintDynamics` is to regularise closures that are redundant.

With J M^-1 J^T regularised by mu, each proximal iteration leaves mu / (mu + lambda) of its effect along
an eigenvector of eigenvalue lambda (Carpentier, Budhiraja and Mansard, "Proximal and Sparse Resolution of
Constrained Dynamic Equations", RSS 2021, section III).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from newton_euler.scalars import Array

MU = 1e-6
"""Regularisation of redundant closures against the mean of the diagonal of J M^-1 J^T, in units of the
mechanism's size and mass, or against 1 if that is larger. Iterations take its effect out again; a
smaller one lets forces that no acceleration sees grow with drift."""

SHARE = 0.1
"""What it is at most of the smallest eigenvalue that is not zero: a few iterations then leave nothing."""

LEAST = 1e-12
"""What it is at least against that mean: zero eigenvalues come out as 1e-15 of it."""

ACCURACY = 1e-13
"""Relative change between iterations at which they end."""

ITERATIONS = 30

CONVERGED = 1e-6
"""Relative change in the last iteration above which something keeps them from an end: a configuration that is
near a singular one, or redundant closures that contradict each other because they have drifted open."""


def plain() -> Any:
    """Elimination without regularisation, for independent closures."""
    return pin.ProximalSettings(0.0, ACCURACY, 0.0, 1)


def regularised(jacobian: Array, mass: Array, redundant: int) -> Any:
    """Choose iterations for a dimensionless Jacobian (k, nv) and a mass matrix (nv, nv).

    `redundant` is the number of rows that follow from the others.
    """
    response = jacobian @ np.linalg.solve(mass, jacobian.T)
    mean = float(np.mean(np.diag(response)))
    nonzero = np.linalg.eigvalsh(response)[redundant:]
    weakest = float(nonzero[0]) if len(nonzero) else np.inf
    mu = min(MU * max(mean, 1.0), max(SHARE * weakest, LEAST * mean))
    return pin.ProximalSettings(0.0, ACCURACY, mu, ITERATIONS)


def converged(settings: Any) -> bool:
    """Whether the iterations of the last call with these settings came to an end."""
    return settings.mu == 0.0 or settings.relative_residual <= CONVERGED
