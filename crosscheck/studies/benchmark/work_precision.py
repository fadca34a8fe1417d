"""Work-precision benchmark: run time and error of every engine at each of its settings.

A setting is a method (equations of motion and integrator) with its step or tolerance. A ladder is a list of
settings of one method, from coarse to fine. The time of a setting is the wall time until the poses of all
bodies at all outputs are known in the engine's own form. Loading, compilation and the first run do not count.
The error is the largest difference from the reference motion (`crosscheck.studies.benchmark.reference`) over
all bodies and outputs. Time limits are CPU time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from crosscheck.engines.benchmarks import Ladder, Models, Options, Poses, Run
from crosscheck.studies.benchmark.reference import pose_errors
from crosscheck.studies.benchmark.timing import Progress, Timed, time_alternately
from crosscheck.support.errors import CrosscheckError, reason_of
from crosscheck.support.time_limits import time_limit
from newton_euler.codegen.compile import garbage_collection_off

LADDER_TIME_LIMIT = 4.0
"""CPU time of a run, s, above which finer settings of the same method are not tried."""

RUN_TIME_LIMIT = 8.0
"""CPU time of a run, s, after which the run is aborted."""

ENGINE_TIME_LIMIT = 100.0
"""CPU time of an engine, s, after which no further method of the engine is tried."""

SETTING_TIME = 0.15
"""Wall time of all repeats of one setting together, s, unless `MIN_REPEATS` take longer."""

MIN_REPEATS = 3
"""Smallest number of repeats of a setting."""

REPEAT_TIME = 0.02
"""Shortest wall time of one repeat, s; a repeat consists of as many consecutive runs as necessary.

A single run of less than a millisecond would be timed with the processor's caches full of another engine's
data.
"""


@dataclass(frozen=True)
class Failure:
    """A setting, or all settings of one variant of an engine's equations, that cannot run the scene.

    Attributes:
        engine: name of the engine.
        name: name of the setting, or of the variant.
        reason: the error in one line.
    """

    engine: str
    name: str
    reason: str


@dataclass(frozen=True)
class Measurement(Timed):
    """Time and error of one setting; `Timed` has the median and spread of its `times`.

    Attributes:
        engine: name of the engine.
        method: name of the method, for example its equations and integrator.
        name: name of the setting: the method with its step or tolerance.
        error_position: largest position error over bodies and outputs, m.
        error_angle: largest orientation error over bodies and outputs, rad.
        evaluations: number of evaluations of the equations of motion in one run.
        first: wall time of the first run, s, which is not a repeat.
        times: mean wall time of a run in each repeat, s.
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
        """Larger of both errors, m or rad."""
        return max(self.error_position, self.error_angle)

    @property
    def repeats(self) -> int:
        """Number of repeats that take `SETTING_TIME` together, estimated from the first run."""
        return max(MIN_REPEATS, int(SETTING_TIME / max(self.first, REPEAT_TIME)))


@dataclass
class WorkPrecision:
    """Measurements of all settings of all engines.

    Attributes:
        measurements: time and error of each setting that can run.
        failures: settings that cannot run.
        ended: reason why no finer setting was tried, by engine and method.
    """

    measurements: list[Measurement] = field(default_factory=list)
    failures: list[Failure] = field(default_factory=list)
    ended: dict[str, str] = field(default_factory=dict)


def measure(engines: Mapping[str, Models], exact: Poses, progress: Progress) -> WorkPrecision:
    """Run every setting of every engine once for its error, then alternately for its time.

    Args:
        engines: functions that load the scene, by engine and variant of its equations.
        exact: reference poses: positions and quaternions of all bodies at all outputs.
        progress: called with the name of each stage.
    """
    # Run each setting once, from coarse to fine
    found = WorkPrecision()
    calls: list[Callable[[], float]] = []
    for engine, models in engines.items():
        engine_time = 0.0
        for name, load in models.items():
            progress(f"{engine}: {name}")
            try:
                model = load()
            except Exception as error:  # the table reports any error of an engine
                found.failures.append(Failure(engine, name, reason_of(error)))
                continue
            for ladder in model.ladders:
                end = f"not tried: other methods of the engine took {ENGINE_TIME_LIMIT:g} s"
                if engine_time < ENGINE_TIME_LIMIT:
                    start = time.process_time()
                    end = _run_ladder(engine, ladder, model.run, exact, found, calls)
                    engine_time += time.process_time() - start
                found.ended[f"{engine}: {ladder.method}"] = end
    # Repeat all settings that can run, alternately
    times = time_alternately(calls, [m.repeats for m in found.measurements], progress)
    found.measurements = [replace(m, times=row) for m, row in zip(found.measurements, times, strict=True)]
    return found


def _run_ladder(
    engine: str,
    ladder: Ladder,
    run: Callable[[Options], Run],
    exact: Poses,
    found: WorkPrecision,
    calls: list[Callable[[], float]],
) -> str:
    """Run each setting of one method once, from the coarsest to the finest.

    Args:
        engine: name of the engine.
        ladder: settings of the method.
        run: simulates the scene at a setting.
        exact: reference poses.
        found: measurements and failures, to which those of this method are added.
        calls: functions that repeat a run and return its wall time, to which those of this method are added.

    Returns:
        The reason why no finer setting was run.
    """
    for number in ladder.numbers:  # the larger the number, the finer the setting
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
            found.measurements.append(
                Measurement(engine, ladder.method, name, *errors, done.evaluations, first=done.seconds)
            )
            calls.append(partial(_time_runs, run, options))
        seconds = time.process_time() - start
        if seconds > LADDER_TIME_LIMIT and number != ladder.numbers[-1]:
            return f"{name} took {seconds:.1f} s, more than {LADDER_TIME_LIMIT:g} s"
    return "its last setting"


def _time_runs(run: Callable[[Options], Run], options: Options) -> float:
    """Return the mean wall time, s, of consecutive runs that together take `REPEAT_TIME` or more."""
    seconds = [run(options).seconds]
    while sum(seconds) < REPEAT_TIME:
        seconds.append(run(options).seconds)
    return sum(seconds) / len(seconds)
