"""Projection near a singular configuration, where constraints and multipliers have few digits."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from newton_euler.compiled import Code, Formulation
from newton_euler.equations.dense import largest, singular_values
from newton_euler.equations.system import System
from newton_euler.errors import AssemblyError
from newton_euler.integrators.stabilize import is_closed, worst_joint
from newton_euler.model.mechanism import CLOSURE_TOLERANCE
from newton_euler.scalars import Array

NEWTON_STEPS = 20

WEAK = 3e-5
"""Dimensionless singular value below which a constraint says too little to correct a state by it: the
correction of a velocity would have the round-off of its residual divided by the square."""


class Surface(NamedTuple):
    """The constraints and the mass matrix at a state, all dense."""

    phi: Array
    """(k,) residuals."""
    opening: Array
    """(k,) dPhi/dt."""
    jacobian: Array
    """(k, nv) Phi_q."""
    mass: Array
    """(nv, nv) of the kinetic energy 1/2 v^T M v."""


def surface(code: Code, x: Array) -> Surface:
    """The surface at x (inputs,), from native code."""
    function = code.function("surface")
    values = function(x)
    k, n = len(code.system.phi_units), code.system.nv
    jacobian, mass = np.zeros((k, n)), np.zeros((n, n))
    on_jacobian, on_mass = (np.array(places, dtype=int).reshape(-1, 2) for places in function.layout)
    end = 2 * k + len(on_jacobian)
    jacobian[tuple(on_jacobian.T)] = values[2 * k : end]
    mass[tuple(on_mass.T)] = values[end:]
    for omitted in (values[:k], values[k : 2 * k], jacobian):
        omitted[code.omitted] = 0.0
    return Surface(values[:k], values[k : 2 * k], jacobian, mass)


def close(code: Code, system: Formulation, x: Array) -> Array:
    """(q, v) (size,) on the constraints near x (inputs,); errors as of `close_by`."""
    return close_by(lambda x: surface(code, x), system, x)[: code.size]


def close_by(surface: Callable[[Array], Surface], system: System, x: Array) -> Array:
    """x, which begins with (q, v), on the constraints near it, as far as they are strong enough to say where.

    Corrections are M^-1 J^T times multipliers, the direction in which wrong multipliers lead a run
    astray: what they did is undone, whatever it was.

    Args:
        surface: of the system, at an x.

    Raises:
        AssemblyError: if the constraints stay open by more than `CLOSURE_TOLERANCE`.
    """
    x = x.copy()
    on_q, on_v = slice(system.nq), slice(system.nq, system.nq + system.nv)
    x[on_q] = system.retract(x[on_q], np.zeros(system.nv))
    found, best = surface(x), x.copy()
    for _ in range(NEWTON_STEPS):
        x[on_q] = system.retract(x[on_q], -_correction(system, found)(found.phi))
        here = surface(x)
        if not largest(here.phi) < 0.5 * largest(found.phi):
            break
        found, best = here, x.copy()
    if not is_closed(system, found.phi):
        joint, gap = worst_joint(system, system.state(best[on_q], np.zeros(system.nv)))
        raise AssemblyError(joint, gap, CLOSURE_TOLERANCE)
    correct = _correction(system, found)
    best[on_v] -= correct(found.opening)
    best[on_v] -= correct(surface(best).opening)  # once more for the digits
    return best


def _correction(system: System, found: Surface) -> Callable[[Array], Array]:
    """The step (nv,) that undoes residuals (k,) in the metric of the mass matrix."""
    units = system.velocity_units
    jacobian = found.jacobian * units / system.phi_units[:, None]
    mass = found.mass * np.outer(units, units)
    # what the constraints measure costs nothing on them, and makes Euler parameters definite
    lower = np.linalg.cholesky(mass / np.max(np.diag(mass)) + jacobian.T @ jacobian)
    u, s, vt = singular_values(np.linalg.solve(lower, jacobian.T).T)
    strong = s > WEAK * np.max(s, initial=0.0)
    back = np.linalg.solve(lower.T, vt[strong].T) / s[strong]

    def correct(residual: Array) -> Array:
        return np.asarray(units * (back @ (u[:, strong].T @ (residual / system.phi_units))))

    return correct
