"""One check of whole runs: a difference, whose tolerance is extended by the measured errors of the runs.

In: the runs (simulations) of one scene in several engines. `RunChecks.check` compares a value of one or two
runs with the expected integration error of their engines. If the value is larger, the engines are run again
with a smaller step or tighter tolerances (refined runs). The levels are in `crosscheck.compare.runs`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from crosscheck.compare.check import ERROR_PER_CHANGE, ROUND_OFF, Check, reach
from crosscheck.compare.run_differences import Difference
from crosscheck.engines.engine import MAX_RELATIVE_ERROR, Engine
from crosscheck.support.errors import CrosscheckError
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import StoppedError, Trajectory
from newton_euler.scalars import Array

Runs = Mapping[str, Trajectory]
"""Runs by the name of the engine."""

MAX_REMAINING_ERROR = 1.0 - 1.0 / ERROR_PER_CHANGE
"""Largest fraction of an error that may remain in a refined run. If more remains, the error exceeds
`ERROR_PER_CHANGE` times the change of the run."""


class RunChecks:
    """Makes checks of runs, and keeps the refined runs, which are computed when a check first needs them."""

    def __init__(self, scene: Scene, runs: Runs, in_full: bool) -> None:
        """Prepare checks of the runs of a scene.

        Args:
            scene: scene that was simulated.
            runs: runs by engine. Partial runs are compared up to their ends.
            in_full: True if refined runs need reactions and actuator forces.
        """
        self._scene, self._runs, self._in_full = scene, runs, in_full
        self._refined: dict[str, Trajectory] = {}
        self._not_refinable: set[str] = set()

    def shortest(self, between: Sequence[Engine]) -> int:
        """Return the number of outputs of the shortest run of some engines."""
        return min(len(self._runs[engine.name].time) for engine in between)

    def length_unit(self, between: Sequence[Engine]) -> float:
        """Return the unit of lengths, m: the mechanism's reach until the shortest run of `between` ends.

        The run with the smallest reach counts: a diverging run must not extend the tolerances.
        """
        end = self.shortest(between)
        runs = (run for run in self._runs.values() if len(run.time) >= end)
        return max(1.0, min(reach(self._scene, run.first(end).position) for run in runs))

    def change_if_refined(self, engine: Engine, difference: Difference) -> float:
        """Measure the largest difference between an engine's run and its refined run."""
        if engine.name not in self._refined:
            self._refine(engine)
        return float(np.max(difference(self._runs[engine.name], self._refined[engine.name])))

    def check(
        self,
        level: str,
        quantity: str,
        between: Sequence[Engine],
        compared_value: Callable[[Runs], Array],
        difference: Difference,
        fixed: float,
        unit: float,
        names: Sequence[str],
        shown_unit: float = 1.0,
    ) -> Check:
        """Make one check: the largest value, with a tolerance that is extended by measured errors if needed.

        Args:
            level, quantity: attributes of the check.
            between: one or two engines.
            compared_value: computes the compared value from a set of runs: (n,) at n times, or (n, b or j).
            difference: measures the change of the value between a run of an engine and its refined run.
            fixed: fixed tolerance, relative to `unit`.
            unit: unit of the tolerance, m, rad, J, N or N m.
            names: names of the b bodies or j joints.
            shown_unit: unit in which value and tolerance are shown.
        """
        values = compared_value(self._runs)
        value, tolerance = float(np.max(values)), fixed * unit
        # Extend the tolerance by measured errors, beginning with the fastest engine
        coarse: list[str] = []
        for engine in sorted(between, key=lambda engine: self._runs[engine.name].wall_time):
            if value <= tolerance:
                break
            change = self.change_if_refined(engine, difference)
            tolerance += min(ERROR_PER_CHANGE * change, MAX_RELATIVE_ERROR * unit)
            if ERROR_PER_CHANGE * change > MAX_RELATIVE_ERROR * unit:
                coarse.append(f"{engine.name}'s own run changes by {change / shown_unit:.2g} when refined")
        # A check that passes by the extension only is judged only if refining reduces the difference
        extended = fixed * unit < value <= tolerance
        floor = max(fixed, ROUND_OFF) * unit
        unconverged = self._unconverged_engine(between, compared_value, difference, floor) if extended else ""
        return Check(
            level,
            quantity,
            between=tuple(engine.name for engine in between),
            value=value / shown_unit,
            tolerance=tolerance / shown_unit,
            where=self._place_of_largest(values, names),
            judged=not unconverged,
            unconverged=unconverged,
            detail="; ".join(coarse) if value > tolerance else "",
        )

    def _refine(self, engine: Engine) -> None:
        """Compute the refined run of an engine; it may be partial only if the run itself is."""
        simulate = (engine.refined_in_full if self._in_full else None) or engine.refined
        try:
            self._refined[engine.name] = simulate(self._scene)
        except StoppedError as error:
            if error.partial is None or len(self._runs[engine.name].time) == len(self._scene.times):
                raise
            self._refined[engine.name] = error.partial

    def _unconverged_engine(
        self,
        between: Sequence[Engine],
        compared_value: Callable[[Runs], Array],
        difference: Difference,
        floor: float,
    ) -> str:
        """Return the engine whose refined run does not reduce the value of a check; empty if none.

        Of the engines of the check, the one whose run changes most when refined is tested. The value is
        computed with the given run of the other engine first, which costs nothing, and then with its refined
        run, which has a smaller error. Each check is tested separately, since a run may converge in one
        quantity or towards one engine only.

        Args:
            between, compared_value, difference: see `check`.
            floor: value that is small enough in any case.
        """
        refined = [engine for engine in between if engine.name in self._refined]
        name = max(refined, key=lambda engine: self.change_if_refined(engine, difference)).name

        def decreases(others: Runs) -> bool:
            """Return True if the refined run of the engine `name` reduces the value, given other runs."""
            before = float(np.max(compared_value({**others, name: self._runs[name]})))
            after = float(np.max(compared_value({**others, name: self._refined[name]})))
            return after <= max(MAX_REMAINING_ERROR * before, floor)

        if decreases(self._runs):
            return ""
        for engine in between:
            if engine.name not in self._refined and engine.name not in self._not_refinable:
                try:
                    self._refine(engine)
                except (NewtonEulerError, CrosscheckError):
                    self._not_refinable.add(engine.name)
        return "" if decreases({**self._runs, **self._refined}) else name

    def _place_of_largest(self, values: Array, names: Sequence[str]) -> str:
        """Return the time of the largest value, after the name of its body or joint if there is one."""
        times = self._scene.times
        if values.ndim == 1:
            return f"{times[int(np.argmax(values))]:.3g} s"
        n, k = divmod(int(np.argmax(values)), values.shape[1])
        return f"{names[k]} at {times[n]:.3g} s"
