"""Run time against error, for every engine and setting.

The time of a setting is what it takes to have the motion of all bodies at all output times; loading,
compiling and the first run are told apart from it. The error is the largest over all bodies and output times
against `crosscheck.studies.benchmark.reference`.
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
from newton_euler.codegen.compile import uncollected

LONGEST = 1.5
"""s of processor time: a ladder is climbed no further once one of its runs has taken longer."""

LIMIT = 3.0
"""s after which a run is given up."""

BUDGET = 20.0
"""s of processor time after which an engine begins no further ladder. Others' load leaves no setting out."""

SHARE = 0.15
"""s that the repeats of one setting should take together, if `LEAST_REPEATS` of them do not take longer."""

LEAST_REPEATS = 3

SAMPLE = 0.02
"""s that runs follow one another for one repeat at least; its time is their mean. A single run of less
than a millisecond would be timed with the processor's caches full of another engine."""


@dataclass(frozen=True)
class Failure:
    """A model, or a setting of one, that cannot run the scene."""

    engine: str
    name: str
    reason: str


@dataclass(frozen=True)
class Measurement(Timed):
    """One setting.

    Attributes:
        engine, method, name: names; that of the setting begins with its method's.
        error_position, error_angle: largest over bodies and output times, m and rad.
        evaluations: of the equations of motion, in one run.
        first: s, of the first run, which is not among the repeats.
        times: s, of the repeats, each a mean over `SAMPLE`.
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
        """The larger of both errors, m or rad."""
        return max(self.error_position, self.error_angle)

    @property
    def repeats(self) -> int:
        """The number of repeats that take `SHARE` together, by the first run."""
        return max(LEAST_REPEATS, int(SHARE / max(self.first, SAMPLE)))


@dataclass
class Measured:
    """All settings of all engines.

    Attributes:
        ended: why a ladder ends where it does, by engine and method.
    """

    measurements: list[Measurement] = field(default_factory=list)
    failures: list[Failure] = field(default_factory=list)
    ended: dict[str, str] = field(default_factory=dict)


def measure(engines: Mapping[str, Models], exact: Poses, progress: Progress) -> Measured:
    """Run every setting of every engine once for its error, then in turns for its time.

    Args:
        engines: how each loads the scene.
        exact: what errors are taken against.
        progress: is told each stage.
    """
    found = Measured()
    calls: list[Callable[[], float]] = []
    for engine, models in engines.items():
        climbing = 0.0
        for name, load in models.items():
            progress(f"{engine}: {name}")
            try:
                model = load()
            except Exception as error:  # whatever an engine has against a scene belongs in the table
                found.failures.append(Failure(engine, name, reason_of(error)))
                continue
            for ladder in model.ladders:
                end = f"not begun: others of its engine have taken {BUDGET:g} s"
                if climbing < BUDGET:
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
    found: Measured,
    calls: list[Callable[[], float]],
) -> str:
    """Run the settings of a ladder once each, add calls to repeat those that ran; return why it ended."""
    for number in ladder.numbers:
        name, options = ladder.setting(number)
        start = time.process_time()
        try:
            with uncollected(), time_limit(LIMIT):
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
        if seconds > LONGEST and number != ladder.numbers[-1]:
            return f"{name} took {seconds:.1f} s, more than {LONGEST:g} s"
    return "its last setting"


def _sample(run: Callable[[Options], Run], options: Options) -> float:
    """Return the mean time of runs one after the other, s."""
    seconds = [run(options).seconds]
    while sum(seconds) < SAMPLE:
        seconds.append(run(options).seconds)
    return sum(seconds) / len(seconds)
