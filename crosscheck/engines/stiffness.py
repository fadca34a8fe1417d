"""Method and step for a scene, by how fast its motions die out or swing.

An explicit method is stable as long as its step times the fastest rate of decay stays below a number of its
own, 6.3 for DOP853 (measured on models with damped joints of little inertia, whose runs take just as many
steps as that says). Above some number of such steps the implicit Radau is quicker, though each of its steps
needs a Jacobian. A fixed step cannot adapt: RK4's has to be stable everywhere on the way, by its stability
function. E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 1996, section IV.2.
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
"""Largest stable product of DOP853's step and a rate of decay."""

DIFFERENCE_STEP = 1e-7
"""Relative step of numerical differentiation, and in m, rad and their rates."""

EXTREME_EIGENVALUES = 12
"""Number of eigenvalues of largest magnitude that are computed for large scenes; they decide on stability."""

MAX_RESTARTS = 30
"""Largest number of restarts of their iteration; eigenvalues that have not converged are ignored."""

EXAMINED_STATES = 8
"""Number of states of a run, evenly spread, whose motions are examined."""

MAX_DENSE_SIZE = 150
"""Largest number of coordinates and velocities of scenes whose eigenvalues are all computed, within a
second."""

MAX_GROWTH = 100.0
"""Largest exponent of the growth of a motion in one step; a larger one is not a question of stability."""

GROWTH_ROUND_OFF = 1e-6
"""Growth in one step that is round-off, since numerical derivatives have half of the digits."""


def modes(scene: Scene, states: Sequence[tuple[float, State]]) -> Array:
    """Eigenvalues, 1/s, of the motions of a scene linearized at times, s, and states; of all together.

    Of the derivative of (qdot, vdot) by (q, v), taken by central differences of the compiled equations, which
    costs next to nothing: all eigenvalues of `MAX_DENSE_SIZE` coordinates and velocities, of more the
        `EXTREME_EIGENVALUES` ones.
    None where it cannot be told: differences say nothing near a singularity.
    """
    compiled = compile_scene(scene)
    derivative, n = compiled.function("derivative"), compiled.size
    found: list[Array] = []
    for time, state in states:
        x = compiled.packed(*compiled.system.coordinates(state), time)
        if not derivative(x)[-1] > NEAR_PIVOT_RATIO:
            continue
        units = np.maximum(1.0, np.abs(x[:n]))

        def product(direction: Array, x: Array = x, units: Array = units) -> Array:
            """Multiply the dimensionless derivative by a direction (n,)."""
            step = np.zeros(len(x))
            step[:n] = DIFFERENCE_STEP * units * direction.ravel()
            return (derivative(x + step)[:n] - derivative(x - step)[:n]) / (2.0 * DIFFERENCE_STEP * units)

        found.append(
            _all_eigenvalues(product, n) if n <= MAX_DENSE_SIZE else _extreme_eigenvalues(product, n)
        )
    return np.concatenate([np.zeros(0), *found])


def _all_eigenvalues(product: Callable[[Array], Array], n: int) -> Array:
    """Compute the eigenvalues of a matrix (n, n); none if it is not finite."""
    matrix = np.column_stack([np.zeros((n, 0)), *(product(direction) for direction in np.eye(n))])
    return np.asarray(np.linalg.eigvals(matrix)) if np.all(np.isfinite(matrix)) else np.zeros(0)


def _extreme_eigenvalues(product: Callable[[Array], Array], n: int) -> Array:
    """Compute eigenvalues of the largest magnitude of a matrix (n, n) by Arnoldi's iteration."""
    from scipy.sparse.linalg import ArpackError, ArpackNoConvergence, LinearOperator, eigs

    matrix = LinearOperator((n, n), matvec=product, dtype=float)
    start = np.random.default_rng(0).standard_normal(n)
    try:
        values = eigs(matrix, EXTREME_EIGENVALUES, v0=start, maxiter=MAX_RESTARTS, return_eigenvectors=False)
    except ArpackNoConvergence as error:
        values = error.eigenvalues
    except ArpackError:  # of numbers that are not finite
        return np.zeros(0)
    return values[np.isfinite(values)]


@lru_cache(maxsize=1)
def fastest_decay(scene: Scene) -> float:
    """The fastest rate, 1/s, at which motions of a scene die out at its start; 0 where it cannot be told."""
    return max(0.0, -float(np.min(modes(scene, [(0.0, initial_state(scene))]).real, initial=0.0)))


def explicit_steps(scene: Scene) -> float:
    """Count the steps that stability alone would cost DOP853 over a scene's duration."""
    return fastest_decay(scene) * scene.duration / DOP853_STABILITY


def modes_of_run(scene: Scene, run: Trajectory | None) -> Array:
    """Eigenvalues, 1/s, of the motions at the start and along a run, see `modes`."""
    states = [(0.0, initial_state(scene))]
    if run is not None and run.linear_velocity is not None:
        rows = np.unique(np.linspace(0, len(run.time) - 1, EXAMINED_STATES).round().astype(int))
        states += [(float(run.time[row]), run.state(row)) for row in rows]
    return modes(scene, states)


def is_stable_in_rk4(modes: Array, step: float) -> bool:
    """True if no motion grows faster in RK4 at a step, s, than it does."""
    z = step * modes
    growth = 1.0 + z * (1.0 + z / 2.0 * (1.0 + z / 3.0 * (1.0 + z / 4.0)))
    # an undamped motion's real part is round-off of either sign
    return bool(np.all(np.abs(growth) <= (1.0 + GROWTH_ROUND_OFF) * np.exp(np.clip(z.real, 0.0, MAX_GROWTH))))
