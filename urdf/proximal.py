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
from newton_euler.solve import rank

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


def redundant_rows(jacobian: Array) -> int:
    """How many rows of a dimensionless Jacobian follow from the others."""
    return len(jacobian) - rank(jacobian)


def plain() -> Any:
    """Elimination without regularisation, for independent closures."""
    return pin.ProximalSettings(0.0, ACCURACY, 0.0, 1)


def regularised(jacobian: Array, mass: Array) -> Any:
    """Iterations, for a dimensionless Jacobian (k, nv) with redundant rows and a mass matrix (nv, nv)."""
    response = jacobian @ np.linalg.solve(mass, jacobian.T)
    mean = float(np.mean(np.diag(response)))
    nonzero = np.linalg.eigvalsh(response)[redundant_rows(jacobian) :]
    weakest = float(nonzero[0]) if len(nonzero) else np.inf
    mu = min(MU * max(mean, 1.0), max(SHARE * weakest, LEAST * mean))
    return pin.ProximalSettings(0.0, ACCURACY, mu, ITERATIONS)
