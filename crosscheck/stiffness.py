"""Which adaptive method a scene is run with: DOP853, unless its stability would make it creep.

An explicit method is stable as long as its step times the fastest rate of decay stays below a number of its
own, 6.3 for DOP853 (measured on models with damped joints of little inertia, whose runs take just as many
steps as that says). Above some number of such steps the implicit Radau is quicker, though each of its steps
needs a Jacobian: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 1996, section IV.2.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from newton_euler.scene import Scene
from newton_euler.simulate import compile_scene
from newton_euler.steppers.march import NEAR

STABLE = 6.3
"""Largest product of DOP853's step and a rate of decay."""

NUDGE = 1e-7
"""Of coordinates (m, rad) and velocities, and relative, for differences."""

LARGEST = 500
"""Coordinates and velocities; eigenvalues of more would take longer than they save."""


@lru_cache(maxsize=1)
def fastest_decay(scene: Scene) -> float:
    """The fastest rate, 1/s, at which motions of a scene die out at its start; 0 where it cannot be told.

    From the eigenvalues of the derivative of (qdot, vdot) by (q, v), taken by central differences of the
    compiled equations, which costs next to nothing.
    """
    compiled = compile_scene(scene)
    derivative, n = compiled.function("derivative"), compiled.size
    x = compiled.packed(*compiled.system.coordinates(scene.initial_state))
    health = derivative(x)[-1]
    if n > LARGEST or not health > NEAR:  # near a singular configuration differences say nothing
        return 0.0
    jacobian = np.empty((n, n))
    for k in range(n):
        step = np.zeros(len(x))
        step[k] = NUDGE * max(1.0, abs(x[k]))
        jacobian[:, k] = (derivative(x + step)[:n] - derivative(x - step)[:n]) / (2.0 * step[k])
    if not np.all(np.isfinite(jacobian)):
        return 0.0
    return max(0.0, -float(np.min(np.linalg.eigvals(jacobian).real, initial=0.0)))


def explicit_steps(scene: Scene) -> float:
    """How many steps stability alone would cost DOP853 over a scene's duration."""
    return fastest_decay(scene) * scene.duration / STABLE
