"""(c) Baumgarte's gain against step size: where it is stable, and what it leaves open.

An error e of a constraint obeys e'' + 2 alpha e' + alpha^2 e = 0, whose eigenvalue -alpha is double. RK4
with steps h is stable to h alpha = 2.785 along the negative real axis (Hairer, Wanner, Solving Ordinary
Differential Equations II, section IV.2).
"""

from __future__ import annotations

from functools import lru_cache, partial

import numpy as np

from crosscheck.scenes import load
from crosscheck.studies.stress.cases import Bound, Case, Curve, Measured
from crosscheck.studies.stress.runs import FORMULATIONS, TIGHT, distance, largest_drift, lasting
from newton_euler.errors import NewtonEulerError
from newton_euler.integrators.fixed_step import RK4_LIMIT
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.simulate import CompiledScene

MOTION_LIMIT = 2e-2
"""s, the largest step of `STEPS` that the motion itself allows, whatever keeps it on its constraints."""

STEPS = (1e-1, 5e-2, 2e-2, 1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4)
"""s."""

DURATION = 5.0
OUTPUT_PERIOD = 0.1

SHORTER = 2.0
"""s, if not in full."""


def cases(full: bool) -> list[Case]:
    """All of (c)."""
    per_decade = 2 if full else 1
    duration = DURATION if full else SHORTER
    alphas = [float(f"{10.0 ** (k / per_decade):.2g}") for k in range(-per_decade, 4 * per_decade + 1)]
    made = []
    for formulation in FORMULATIONS:
        for alpha in alphas if full else alphas[1::2]:
            made.append(
                Case(
                    "c",
                    f"tracker, {duration:g} s, alpha {alpha:g} 1/s",
                    "newton_euler",
                    f"{formulation}, RK4, baumgarte",
                    "largest stable step",
                    "s",
                    border(alpha),
                    partial(measure, formulation, alpha, duration),
                )
            )
        made.append(
            Case(
                "c",
                f"tracker, {duration:g} s, smallest step {STEPS[-1]:g} s",
                "newton_euler",
                f"{formulation}, RK4, projection",
                "drift",
                "m or rad",
                Bound(1e-13, 1e-9, "projection leaves round-off open"),
                partial(measure_projection, formulation, duration),
            )
        )
    return made


def border(alpha: float) -> Bound:
    """What the largest stable step has to be."""
    theory = min(RK4_LIMIT / alpha, MOTION_LIMIT)
    reason = "0.4 of 2.785/alpha or of what the motion allows: steps of 1, 2, 5 are tried"
    return Bound(0.4 * theory, 0.1 * theory, reason, at_least=True)


@lru_cache
def _reference(duration: float) -> Trajectory:
    return TIGHT.simulate(_scene(duration))


def _scene(duration: float) -> Scene:
    return lasting(load("tracker"), duration, round(duration / OUTPUT_PERIOD), "violation")


def _sweep(
    formulation: str, stabilization: str, alpha: float, duration: float
) -> tuple[list[float], list[float], list[float]]:
    """The steps that are stable, with the errors of positions, m, and the drifts, m or rad."""
    scene, reference = _scene(duration), _reference(duration)
    compiled = CompiledScene(scene, formulation, stabilization, alpha)
    stable, errors, drifts = [], [], []
    for step in STEPS:
        try:
            run = compiled.simulate("RK4", step=step)
        except NewtonEulerError:
            continue
        error = distance(run, reference)
        if error < 0.1 * scene.mechanism.size:
            stable.append(step)
            errors.append(error)
            drifts.append(max(largest_drift(run), 1e-18))
    return stable, errors, drifts


def _curves(formulation: str, label: str, sweep: tuple[list[float], ...]) -> tuple[Curve, ...]:
    steps, errors, drifts = map(tuple, sweep)
    titles = (("drift", "m or rad", drifts), ("position error", "m", errors))
    return tuple(
        Curve(
            f"Baumgarte against projection, {formulation}: {what}",
            "step, s",
            f"{what}, {unit}",
            label,
            steps,
            y,
        )
        for what, unit, y in titles
        if steps
    )


def measure(formulation: str, alpha: float, duration: float) -> Measured:
    """The largest step that is stable; in words where drift is least."""
    sweep = _sweep(formulation, "baumgarte", alpha, duration)
    if not sweep[0]:
        return Measured(float("nan"), f"no step down to {STEPS[-1]:g} s is stable")
    best = int(np.argmin(sweep[2]))
    note = (
        f"alpha h there {alpha * sweep[0][0]:.2g}; least drift {sweep[2][best]:.1e} m or rad "
        f"and position error {sweep[1][best]:.1e} m at step {sweep[0][best]:g} s"
    )
    region = ("Baumgarte's stable region", "alpha, 1/s", "largest stable step, s")
    curves = (
        *_curves(formulation, f"alpha {alpha:g}", sweep),
        Curve(*region, formulation, (alpha,), (sweep[0][0],)),
        Curve(*region, f"{RK4_LIMIT} / alpha", (alpha,), (RK4_LIMIT / alpha,)),
    )
    return Measured(sweep[0][0], note, curves)


def measure_projection(formulation: str, duration: float) -> Measured:
    """Drift at the smallest step."""
    sweep = _sweep(formulation, "projection", 0.0, duration)
    note = f"largest stable step {sweep[0][0]:g} s; position error {sweep[1][-1]:.1e} m"
    return Measured(sweep[2][-1], note, _curves(formulation, "projection", sweep))
