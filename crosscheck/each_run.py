"""The run of every engine, all of them tried whatever becomes of one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from crosscheck.comparison.levels import Row
from crosscheck.engines import Engine
from crosscheck.errors import CrosscheckError, reason_of
from crosscheck.limit import SHORTER, limited
from crosscheck.partial import UnfinishedError
from newton_euler.errors import IntegrationError, StoppedError
from newton_euler.scene import Scene
from newton_euler.trajectory import Trajectory, check_finite


def each_run(
    scene: Scene,
    engines: Sequence[Engine],
    progress: Callable[[str], None],
    equations: Callable[[], Sequence[Row]],
) -> dict[str, Trajectory]:
    """The runs of a scene, by engine.

    Args:
        equations: gives what is known of the engines without a run, if one stops.

    Raises:
        UnfinishedError: if one cannot be had, after all others were tried; it says at which level the
            equations part.
    """
    runs, partial, reasons = dict[str, Trajectory](), dict[str, Trajectory](), list[str]()
    for engine in engines:
        try:
            with limited(f"{engine.name}: {scene.duration:g} s of {scene.name}", SHORTER, progress):
                run = engine.simulate(scene)
            _check_finite(scene, run)
            runs[engine.name] = run
        except CrosscheckError as error:
            reasons.append(str(error))
        except Exception as error:  # one that nobody foresaw stops no other engine either
            reasons.append(f"{engine.name}: {reason_of(error)}")
            if isinstance(error, StoppedError) and error.partial is not None:
                partial[engine.name] = error.partial
    if reasons:
        reasons += _where_equations_part(equations, progress)
        raise UnfinishedError("; ".join(reasons), runs, partial)
    return runs


def _where_equations_part(
    equations: Callable[[], Sequence[Row]], progress: Callable[[str], None]
) -> Iterator[str]:
    """What can be said of engines without their runs, if there are several and it can be had."""
    try:
        with limited("comparing equations", SHORTER, progress):
            pairs = [row for row in equations() if len(row.between) > 1 and not row.informs]
            check_figures(pairs)
    except Exception:  # the runs' own reasons are what is told
        return
    for row in [row for row in pairs if not row.agrees][:1]:
        yield (
            f"without runs {' and '.join(row.between)} part at level {row.level!r}: {row.quantity}: "
            f"{row.value:.3g} > {row.tolerance:.3g}, worst at {row.where}"
        )
    if pairs and all(row.agrees for row in pairs):
        yield f"all {len(pairs)} figures that need no run agree, up to level {pairs[-1].level!r}"


def check_figures(rows: Sequence[Row]) -> None:
    """Raise `CrosscheckError` for a figure that is not finite."""
    for row in rows:
        if not np.isfinite(row.value):
            raise CrosscheckError(
                f"no figure for {row.quantity} at level {row.level!r} between "
                f"{' and '.join(row.between)}: {row.value:g} at {row.where}"
            )


def _check_finite(scene: Scene, run: Trajectory) -> None:
    """Raise `IntegrationError` for a run that is not finite, with the rows before."""
    arrays = {name: values for name, values in run.arrays().items() if values.dtype.kind == "f"}
    try:
        check_finite(scene.times, arrays)
    except IntegrationError as error:
        rows = int(np.searchsorted(scene.times, error.time))
        if rows:
            before: dict[str, Any] = {name: values[:rows] for name, values in arrays.items()}
            error.partial = replace(run, **before)
        raise
