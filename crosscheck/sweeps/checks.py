"""Crosschecks of some runs of a sweep, at random and extreme ones, by all engines."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from crosscheck.engines import Engine
from crosscheck.errors import CrosscheckError
from crosscheck.run import Crosscheck, crosscheck
from crosscheck.sweeps.analysis import Scalar
from crosscheck.sweeps.expressions import Outputs
from crosscheck.sweeps.plan import Plan
from crosscheck.sweeps.results import Results
from newton_euler.errors import NewtonEulerError
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

MOST_EXTREMES = 4
"""Runs that are checked beside those at random."""


@dataclass(frozen=True, eq=False)
class Checked:
    """A run of a sweep that all engines made.

    Attributes:
        run: its number.
        why: it was chosen.
        differs: whether engines differ.
        complete: whether all engines came to the end.
        verdict: of its crosscheck, in a line.
        apart: largest difference of a kept number between an engine and the sweep, as a share of the spread
            of that number over the sweep.
        where: the number and the engine with that difference.
    """

    run: int
    why: str
    differs: bool
    complete: bool
    verdict: str
    apart: float
    where: str


def chosen(swept: Results, telling: Sequence[Scalar], random: int) -> dict[int, str]:
    """Choose runs to check by number, each with the reason: some at random, and extreme ones."""
    found: dict[int, str] = {}
    known = telling[0].runs[np.isfinite(telling[0].values)] if telling else np.zeros(0, dtype=int)
    generator = np.random.default_rng([swept.plan.samples.seed, swept.plan.samples.runs])
    for run in generator.choice(known, min(random, len(known)), replace=False):
        found[int(run)] = "at random"
    extremes = [(scalar, largest) for largest in (True, False) for scalar in telling]
    for scalar, largest in extremes[:MOST_EXTREMES]:
        found.setdefault(scalar.extreme(largest), f"{'most' if largest else 'least'} {scalar.label}")
    return found


def check_runs(
    swept: Results,
    found: Sequence[Scalar],
    runs: Mapping[int, str],
    engines: Sequence[Engine],
    progress: Callable[[str], None],
) -> list[Checked]:
    """Crosscheck runs, and compare what is kept of them; `found` are all numbers that are kept."""
    checked = []
    for count, (run, why) in enumerate(runs.items(), start=1):
        progress(f"cross-checking run {run}, {count} of {len(runs)}")
        try:
            result = crosscheck(swept.plan.scene_of(run), engines, lambda stage: None, "", {})
        except (CrosscheckError, NewtonEulerError) as error:
            checked.append(Checked(run, why, False, False, str(error), np.nan, ""))
            continue
        complete = not (result.left_out or result.unfinished)
        apart = _apart(swept, found, run, result)
        checked.append(Checked(run, why, result.differs, complete, result.verdict, *apart))
    return checked


def _apart(swept: Results, found: Sequence[Scalar], run: int, result: Crosscheck) -> tuple[float, str]:
    """Return the largest difference of a kept number from the sweep's, by its spread, and where it is."""
    worst, where = 0.0, ""
    for engine, trajectory in result.trajectories.items():
        if len(trajectory.time) < len(swept.scene.times):
            continue
        kept = kept_of(swept.plan, trajectory)
        for scalar in found:
            if scalar.varies and scalar.spread > 0.0:
                own = swept.dataset[scalar.variable][(run, *scalar.place)].item()
                apart = abs(kept[scalar.variable][scalar.place] - own) / scalar.spread
                if apart > worst:
                    worst, where = float(apart), f"{scalar.label} of {engine}"
    return worst, where


def kept_of(plan: Plan, trajectory: Trajectory) -> dict[str, Array]:
    """Return what is kept of a run by any engine, by name."""

    def stacked(name: str) -> Array:
        return np.asarray(getattr(trajectory, name))[None]

    outputs = Outputs(plan.scene, trajectory.time, stacked)
    return {each.name: each.of(outputs)[0] for each in plan.kept}
