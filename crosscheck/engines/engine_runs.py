"""The run of every engine, all of them tried whatever becomes of one, and what does not come to its end."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from crosscheck.compare.check import Check
from crosscheck.engines.engine import Engine
from crosscheck.support.errors import CrosscheckError, reason_of
from crosscheck.support.time_limits import SHORTER, limited
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import (
    IntegrationError,
    StoppedError,
    Trajectory,
    UndeterminedStartError,
    check_finite,
)

LEAST_OUTPUTS = 2
"""Of a run that stopped: with its start alone there is nothing to compare."""


@dataclass(frozen=True)
class Stop:
    """Part of a crosscheck that did not come to its end.

    Attributes:
        what: an engine, or a part of the comparison.
        reason: why, in one line.
        time: s, up to which there is a run; None without one.
        undetermined: whether the scene does not determine the motion, so that no runs of it can be compared.
    """

    what: str
    reason: str
    time: float | None = None
    undetermined: bool = False

    def __str__(self) -> str:
        return f"{self.what}: {self.reason}"


def stops_text(stops: Iterable[Stop]) -> str:
    """Word what did not come to its end; a reason that several parts share stands there once."""
    parts = dict[str, list[str]]()
    for stop in stops:
        parts.setdefault(stop.reason, []).append(stop.what)
    return "; ".join(f"{', '.join(whats)}: {reason}" for reason, whats in parts.items())


def each_run(
    scene: Scene, engines: Sequence[Engine], progress: Callable[[str], None]
) -> tuple[dict[str, Trajectory], list[Stop]]:
    """The runs of a scene by engine, as far as they came, and those that did not come to their end."""
    runs, stops = dict[str, Trajectory](), list[Stop]()
    for engine in engines:
        try:
            with limited(f"{engine.name}: {scene.duration:g} s of {scene.name}", SHORTER, progress):
                run = engine.simulate(scene)
            _check_finite(scene, run)
            runs[engine.name] = run
        except Exception as error:  # one that nobody foresaw stops no other engine either
            partial = error.partial if isinstance(error, StoppedError) else None
            if partial is not None and len(partial.time) >= LEAST_OUTPUTS:
                runs[engine.name] = partial
            time = float(partial.time[-1]) if engine.name in runs and partial is not None else None
            reason = reason_of(error).removeprefix(f"{engine.name}: ")
            stops.append(Stop(engine.name, reason, time, isinstance(error, UndeterminedStartError)))
    return runs, stops


@contextmanager
def as_far_as_it_goes(what: str, stops: list[Stop]) -> Iterator[None]:
    """A block whose error becomes one of the `stops`."""
    try:
        yield
    except Exception as error:  # what was found before is kept whatever goes wrong
        stops.append(Stop(what, reason_of(error).removeprefix(f"{what}: ")))


def finite(rows: Iterable[Check]) -> Iterator[Check]:
    """The rows that are finite; then raises `CrosscheckError` for the first that is not."""
    wrong = []
    for row in rows:
        if np.isfinite(row.value):
            yield row
        else:
            wrong.append(row)
    for row in wrong:
        raise CrosscheckError(
            f"no check of {row.quantity} at level {row.level!r} between "
            f"{' and '.join(row.between)}: {row.value:g} at {row.where}"
        )


def _check_finite(scene: Scene, run: Trajectory) -> None:
    """Raise `IntegrationError` for a run that is not finite, with the rows before."""
    arrays = {name: values for name, values in run.arrays().items() if values.dtype.kind == "f"}
    try:
        check_finite(scene.times, arrays)
    except IntegrationError as error:
        rows = int(np.searchsorted(scene.times, error.time))
        error.partial = run.first(rows) if rows else None
        raise
