"""Work-precision measurement: run time and error of every engine and setting.

The time of a setting includes everything until the motion of all bodies at all outputs is known. Loading,
compilation and the first run are measured separately. The error is the largest over all bodies and outputs,
relative to the motion of `crosscheck.studies.benchmark.reference`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from crosscheck.studies.benchmark.ladders import Ladder, Models, Options, Poses, Run
from crosscheck.studies.benchmark.reference import pose_errors
from crosscheck.studies.benchmark.timing import Progress, Timed, in_turns
from crosscheck.support.errors import CrosscheckError, reason_of
from crosscheck.support.time_limits import time_limit
from newton_euler.codegen.compile import garbage_collection_off

LADDER_TIME_LIMIT = 1.5
"""s, CPU time of a run after which finer settings of its method are not tried."""

RUN_TIME_LIMIT = 3.0
"""s, longest time of a run."""

ENGINE_TIME_LIMIT = 20.0
"""s, CPU time after which an engine begins no further method. It is CPU time so that other load has no
effect."""

SETTING_TIME = 0.15
"""s, time of all repeats of one setting together, unless `MIN_REPEATS` take longer."""

MIN_REPEATS = 3
"""Smallest number of repeats of a setting."""

REPEAT_TIME = 0.02
"""s, shortest duration of one repeat, which is the mean of consecutive runs. A single run of less than a
millisecond would be timed with the caches of the processor full of another engine's data."""


@dataclass(frozen=True)
class Failure:
    """A model, or a setting of one, that cannot run the scene."""

    engine: str
    name: str
    reason: str


@dataclass(frozen=True)
class Measurement(Timed):
    """Time and error of one setting.

    Attributes:
        engine, method, name: names of the engine, of the method and of the setting.
        error_position, error_angle: m and rad, largest errors over bodies and outputs.
        evaluations: number of evaluations of the equations of motion in one run.
        first: s, time of the first run, which is not a repeat.
        times: s, time of a run in each repeat.
    """

    engine: str
    method: str
    name: str
    error_position: float
    error_angle: float
    evaluations: int
    first: float
    times: tuple[float, ...] = ()

    @property
    def error(self) -> float:
        """m or rad, the larger of both errors."""
        return max(self.error_position, self.error_angle)

    @property
    def repeats(self) -> int:
        """Number of repeats that take `SETTING_TIME` together, estimated from the first run."""
        return max(MIN_REPEATS, int(SETTING_TIME / max(self.first, REPEAT_TIME)))


@dataclass
class WorkPrecision:
    """Measurements of all settings of all engines.

    Attributes:
        measurements: settings that run.
        failures: models and settings that do not run.
        ended: by engine and method, the reason why no finer setting was tried.
    """

    measurements: list[Measurement] = field(default_factory=list)
    failures: list[Failure] = field(default_factory=list)
    ended: dict[str, str] = field(default_factory=dict)


def measure(engines: Mapping[str, Models], exact: Poses, progress: Progress) -> WorkPrecision:
    """Run every setting of every engine once for its error, then alternately for its time.

    Args:
        engines: by engine, the functions that load the scene.
        exact: reference poses.
        progress: called with the name of each stage.
    """
    found = WorkPrecision()
    calls: list[Callable[[], float]] = []
    for engine, models in engines.items():
        climbing = 0.0
        for name, load in models.items():
            progress(f"{engine}: {name}")
            try:
                model = load()
            except Exception as error:  # the table reports any error of an engine
                found.failures.append(Failure(engine, name, reason_of(error)))
                continue
            for ladder in model.ladders:
                end = f"not tried: other methods of the engine took {ENGINE_TIME_LIMIT:g} s"
                if climbing < ENGINE_TIME_LIMIT:
                    start = time.process_time()
                    end = _climb(engine, ladder, model.run, exact, found, calls)
                    climbing += time.process_time() - start
                found.ended[f"{engine}: {ladder.method}"] = end
    times = in_turns(calls, [m.repeats for m in found.measurements], progress)
    found.measurements = [replace(m, times=row) for m, row in zip(found.measurements, times, strict=True)]
    return found


def _climb(
    engine: str,
    ladder: Ladder,
    run: Callable[[Options], Run],
    exact: Poses,
    found: WorkPrecision,
    calls: list[Callable[[], float]],
) -> str:
    """Run each setting of a ladder once.

    Measurements and failures are added to `found`, and calls that repeat the successful runs to `calls`.

    Returns:
        The reason why the ladder ended.
    """
    for number in ladder.numbers:
        name, options = ladder.setting(number)
        start = time.process_time()
        try:
            with garbage_collection_off(), time_limit(RUN_TIME_LIMIT):
                done = run(options)
            errors = pose_errors(done.poses(), exact)
            if not np.all(np.isfinite(errors)):
                raise CrosscheckError("its motion is not finite")
        except Exception as error:
            found.failures.append(Failure(engine, name, reason_of(error)))
        else:
            of_run = *errors, done.evaluations, done.seconds
            found.measurements.append(Measurement(engine, ladder.method, name, *of_run))
            calls.append(partial(_sample, run, options))
        seconds = time.process_time() - start
        if seconds > LADDER_TIME_LIMIT and number != ladder.numbers[-1]:
            return f"{name} took {seconds:.1f} s, more than {LADDER_TIME_LIMIT:g} s"
    return "its last setting"


def _sample(run: Callable[[Options], Run], options: Options) -> float:
    """Return the mean time of consecutive runs, s."""
    seconds = [run(options).seconds]
    while sum(seconds) < REPEAT_TIME:
        seconds.append(run(options).seconds)
    return sum(seconds) / len(seconds)
