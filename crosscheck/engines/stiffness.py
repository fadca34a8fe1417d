"""Stiffness of a scene: eigenvalues of its linearized motions, and the steps that they require.

An explicit method is stable while step x fastest decay rate stays below a number. For DOP853 that number is
6.3, measured on models with damped joints of little inertia. If stability requires many steps, the implicit
method Radau is faster, although each of its steps needs a Jacobian. `engine.py` compares the number of steps
(`explicit_steps`) with a limit, and tests whether the fixed step of MuJoCo's RK4 is stable along the whole
run (`is_stable_in_rk4`).

E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 1996, section IV.2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np

from newton_euler.integrators.singular import NEAR_PIVOT_RATIO
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory
from newton_euler.runs.assemble import initial_state
from newton_euler.runs.simulate import compile_scene
from newton_euler.scalars import Array

DOP853_STABILITY = 6.3
"""Largest stable product of DOP853's step, s, and a decay rate, 1/s."""

RELATIVE_STEP = 1e-7
"""Step of numerical differentiation: relative to a coordinate or velocity above 1, else absolute."""

EXTREME_EIGENVALUES = 12
"""Number of eigenvalues that are computed for large scenes: those of largest magnitude limit stable steps."""

MAX_RESTARTS = 30
"""Largest number of restarts of Arnoldi's iteration; eigenvalues that have not converged are ignored."""

EXAMINED_STATES = 8
"""Number of states of a run, evenly distributed, at which eigenvalues are computed."""

MAX_DENSE_SIZE = 150
"""Largest number of coordinates and velocities for which all eigenvalues are computed, within a second."""

MAX_GROWTH_EXPONENT = 100.0
"""Upper limit of the exponent of physical growth in one step, so that the exponential does not overflow."""

GROWTH_ROUND_OFF = 1e-6
"""Relative growth in one step that is round-off: numerical derivatives have half of the digits of doubles."""


def modes(scene: Scene, states: Sequence[tuple[float, State]]) -> Array:
    """Compute eigenvalues, 1/s, of the motions of a scene, linearized at some states.

    The matrix is the derivative of (qdot, vdot) with respect to (q, v), by central differences of the
    compiled equations. If the matrix has more than `MAX_DENSE_SIZE` rows, only the `EXTREME_EIGENVALUES`
    largest eigenvalues are computed. States near a singular configuration (where the constraints lose rank)
    are skipped, because differences are inaccurate there.

    Args:
        scene: the scene.
        states: times, s, and states.

    Returns:
        The eigenvalues at all states in one complex array; empty if all states are skipped.
    """
    compiled = compile_scene(scene)
    # The function maps x = (q, v, time, parameters) to (qdot, vdot, pivot ratio). The pivot ratio is the
    # smallest pivot of the elimination of constraints, divided by its usual size
    derivative, n = compiled.function("derivative"), compiled.size
    eigenvalues: list[Array] = []
    for time, state in states:
        x = compiled.packed(*compiled.system.coordinates(state), time)
        pivot_ratio = derivative(x)[-1]
        if not pivot_ratio > NEAR_PIVOT_RATIO:
            continue
        units = np.maximum(1.0, np.abs(x[:n]))

        def product(direction: Array, x: Array = x, units: Array = units) -> Array:
            """Multiply the matrix by a direction (n,); scaling by `units` does not change eigenvalues."""
            step = np.zeros(len(x))
            step[:n] = RELATIVE_STEP * units * direction.ravel()
            return (derivative(x + step)[:n] - derivative(x - step)[:n]) / (2.0 * RELATIVE_STEP * units)

        eigenvalues.append(
            _all_eigenvalues(product, n) if n <= MAX_DENSE_SIZE else _extreme_eigenvalues(product, n)
        )
    return np.concatenate([np.zeros(0), *eigenvalues])


def _all_eigenvalues(product: Callable[[Array], Array], n: int) -> Array:
    """Compute the eigenvalues of a matrix (n, n), given as its product with a vector; none if not finite."""
    # the first block without columns is for n = 0
    matrix = np.column_stack([np.zeros((n, 0)), *(product(direction) for direction in np.eye(n))])
    return np.asarray(np.linalg.eigvals(matrix)) if np.all(np.isfinite(matrix)) else np.zeros(0)


def _extreme_eigenvalues(product: Callable[[Array], Array], n: int) -> Array:
    """Compute eigenvalues of the largest magnitude of a matrix (n, n), given as its product with a vector.

    Arnoldi's iteration (ARPACK) needs such products only. Eigenvalues that have not converged are left out.
    """
    from scipy.sparse.linalg import ArpackError, ArpackNoConvergence, LinearOperator, eigs

    matrix = LinearOperator((n, n), matvec=product, dtype=float)
    start = np.random.default_rng(0).standard_normal(n)
    try:
        values = eigs(matrix, EXTREME_EIGENVALUES, v0=start, maxiter=MAX_RESTARTS, return_eigenvectors=False)
    except ArpackNoConvergence as error:
        values = error.eigenvalues
    except ArpackError:  # the matrix is not finite
        return np.zeros(0)
    return values[np.isfinite(values)]


@lru_cache(maxsize=1)
def fastest_decay(scene: Scene) -> float:
    """Return the fastest decay rate, 1/s, of the motions at the start of a scene; 0 if it is not known."""
    return max(0.0, -float(np.min(modes(scene, [(0.0, initial_state(scene))]).real, initial=0.0)))


def explicit_steps(scene: Scene) -> float:
    """Return the number of steps that DOP853 needs for stability over the duration of a scene."""
    return fastest_decay(scene) * scene.duration / DOP853_STABILITY


def modes_of_run(scene: Scene, run: Trajectory | None) -> Array:
    """Compute eigenvalues, 1/s, of the motions at the start and along a run, see `modes`.

    Args:
        scene: the scene.
        run: run of the scene, with velocities; None for the start only.
    """
    states = [(0.0, initial_state(scene))]
    if run is not None and run.linear_velocity is not None:
        rows = np.unique(np.linspace(0, len(run.time) - 1, EXAMINED_STATES).round().astype(int))
        states += [(float(run.time[row]), run.state(row)) for row in rows]
    return modes(scene, states)


def is_stable_in_rk4(modes: Array, step: float) -> bool:
    """Return True if RK4 is stable at a step, s: no motion grows faster numerically than physically.

    Args:
        modes: eigenvalues, 1/s, see `modes`.
        step: step, s.
    """
    z = step * modes
    # The stability function of RK4: numerical growth per step
    growth = 1.0 + z * (1.0 + z / 2.0 * (1.0 + z / 3.0 * (1.0 + z / 4.0)))
    # Physical growth per step, at least 1: the real part of an undamped motion may be round-off below 0
    physical_growth = np.exp(np.clip(z.real, 0.0, MAX_GROWTH_EXPONENT))
    return bool(np.all(np.abs(growth) <= (1.0 + GROWTH_ROUND_OFF) * physical_growth))
