"""Runs of all engines: every engine simulates the scene even if another engine fails; failures are collected.

In: a scene and engines (simulators such as MuJoCo). Out: the run of each engine, and a `Stop` with the reason
for each failure. A run that fails after its start is kept up to its last output: a partial run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from crosscheck.engines.engine import Engine
from crosscheck.support.errors import reason_of
from crosscheck.support.time_limits import SHORTER_RUN_ADVICE, limited
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import (
    IntegrationError,
    StoppedError,
    Trajectory,
    UndeterminedStartError,
    check_finite,
)

MIN_PARTIAL_OUTPUTS = 2
"""Smallest number of outputs of a partial run that is kept; the start alone cannot be compared."""


@dataclass(frozen=True)
class Stop:
    """Part of a comparison of engines that did not complete.

    Attributes:
        what: name of an engine, or of a part of the comparison.
        reason: reason in one line.
        time: s, end of the partial run; None without a partial run.
        undetermined: True if the scene does not determine its motion, so that no runs can be compared.
    """

    what: str
    reason: str
    time: float | None = None
    undetermined: bool = False

    def __str__(self) -> str:
        return f"{self.what}: {self.reason}"


def stops_text(stops: Iterable[Stop]) -> str:
    """Format the parts that did not complete, with their reasons; parts with the same reason are grouped."""
    parts_by_reason = dict[str, list[str]]()
    for stop in stops:
        parts_by_reason.setdefault(stop.reason, []).append(stop.what)
    return "; ".join(f"{', '.join(parts)}: {reason}" for reason, parts in parts_by_reason.items())


def run_engines(
    scene: Scene, engines: Sequence[Engine], progress: Callable[[str], None]
) -> tuple[dict[str, Trajectory], list[Stop]]:
    """Simulate a scene in all engines.

    Args:
        scene: the scene.
        engines: engines that can represent the scene.
        progress: shows a message to the user before each run.

    Returns:
        The run of each engine (partial if the engine stopped), and a `Stop` for each engine that stopped.
    """
    runs, stops = dict[str, Trajectory](), list[Stop]()
    for engine in engines:
        try:
            what = f"{engine.name}: {scene.duration:g} s of {scene.name}"
            # show the message, and interrupt the run if it needs more processor time than allowed
            with limited(what, SHORTER_RUN_ADVICE, progress):
                run = engine.simulate(scene)
            _check_finite(scene, run)
            runs[engine.name] = run
        except Exception as error:  # even an unexpected error must not prevent the runs of other engines
            partial = error.partial if isinstance(error, StoppedError) else None
            if partial is not None and len(partial.time) >= MIN_PARTIAL_OUTPUTS:
                runs[engine.name] = partial
            time = float(partial.time[-1]) if engine.name in runs and partial is not None else None
            reason = reason_of(error).removeprefix(f"{engine.name}: ")
            undetermined = isinstance(error, UndeterminedStartError)
            stops.append(Stop(engine.name, reason, time, undetermined))
    return runs, stops


@contextmanager
def collecting_errors(what: str, stops: list[Stop]) -> Iterator[None]:
    """Convert an error of the block into a `Stop`, and append it to `stops`.

    Args:
        what: name of the part of the comparison that the block executes.
        stops: list that is appended to.
    """
    try:
        yield
    except Exception as error:  # results of other parts are kept whatever the error is
        stops.append(Stop(what, reason_of(error).removeprefix(f"{what}: ")))


def _check_finite(scene: Scene, run: Trajectory) -> None:
    """Raise `IntegrationError`, a `StoppedError` with the partial run, if a value of a run is not finite."""
    arrays = {name: values for name, values in run.arrays().items() if values.dtype.kind == "f"}
    try:
        check_finite(scene.times, arrays)
    except IntegrationError as error:
        count = int(np.searchsorted(scene.times, error.time))  # outputs before the value
        error.partial = run.first(count) if count else None
        raise
