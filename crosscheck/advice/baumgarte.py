"""Baumgarte's gains for a step, tried on the scene.

An error e of a constraint obeys e'' + 2 alpha e' + alpha^2 e = 0 with K_D = 2 alpha, K_P = alpha^2. RK4
follows that to alpha step = 2.785 (E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, section
IV.2; docs/stress.md (c) sees runs of the tracker end there), but the less exactly the nearer it comes, and
what it misses goes into the motion. Gains that are too small let loops open, so several are tried.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from crosscheck.advice.measured import Advice, Found, distance
from newton_euler.errors import NewtonEulerError
from newton_euler.integrators.fixed_step import RK4_LIMIT
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.model.trajectory import Trajectory

SHARES = (0.1, 0.03, 0.01)
"""Of 1 / step, the gains that are tried."""

LONGEST = 1e-3
"""s, of the step that gains are given for if no engine had one."""

MOST_STEPS = 1e6


def baumgarte_advice(found: Found) -> Iterator[Advice]:
    """For scenes with loops that newton_euler has run, by runs with those gains."""
    from crosscheck.stiffness import fastest_decay
    from newton_euler import simulate

    scene, name = found.scene, "newton_euler"
    if name not in found.runs or not SpanningTree(scene.mechanism).cuts:
        return
    fixed = [run.settings["timestep"] for run in found.runs.values() if "timestep" in run.settings]
    step = fixed[0] if fixed else scene.output_period / np.ceil(scene.output_period / LONGEST)
    if fastest_decay(scene) * step > RK4_LIMIT or scene.duration / step > MOST_STEPS:
        return  # the motion itself is too stiff for such steps
    runs: dict[float, Trajectory] = {}
    for share in SHARES:
        alpha = float(f"{share / step:.3g}")
        try:
            runs[alpha] = simulate(scene, integrator="RK4", step=step, stabilization="baumgarte", alpha=alpha)
        except NewtonEulerError:
            continue
    if not runs:
        yield Advice("baumgarte", f"with RK4 at {step:.4g} s no gain holds the loops, projection does")
        return
    errors = {alpha: distance(run, found.runs[name]) for alpha, run in runs.items()}
    best = min(errors, key=lambda alpha: errors[alpha])
    violation = runs[best].constraint_violation
    open_by = "" if violation is None else f", loops open by at most {np.max(violation):.1e} (m or rad)"
    tried = ", ".join(f"{error:.1e} with {alpha:g}" for alpha, error in errors.items())
    yield Advice(
        "baumgarte",
        f"where gains have to hold the loops instead of projection, with RK4 at {step:.4g} s take alpha = "
        f"{best:g} 1/s (K_D = {2.0 * best:g}, K_P = {best * best:g}){open_by}: tried here, the motion is off "
        f"by {tried}; from {RK4_LIMIT / step:.4g} 1/s on RK4 is unstable",
    )
