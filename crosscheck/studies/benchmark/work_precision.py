"""Run time against error, for every engine and setting: what is measured and how.

The time of a setting is what it takes to have the motion of all bodies at all output times; loading,
compiling and the first run are told apart from it. The error is the largest over all bodies and output times
against `crosscheck.studies.benchmark.reference`.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from crosscheck.limit import time_limit
from crosscheck.scenes.options import titled
from crosscheck.studies.benchmark.ladders import ENGINES, Ladder, Models, Setting, poses_only
from crosscheck.studies.benchmark.reference import Reference, pose_errors, reference
from crosscheck.studies.benchmark.timing import Progress, Timed, in_turns, machine, steady
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array

LONGEST = 1.5
"""s: a ladder is climbed no further once one of its runs has taken longer."""

LIMIT = 3.0
"""s after which a run is given up."""

BUDGET = 20.0
"""s of processor time after which a model begins no further ladder: others' load leaves no setting out."""

SHARE = 0.15
"""s that the repeats of one setting should take together, if `LEAST_REPEATS` of them do not take longer."""

LEAST_REPEATS = 3

SAMPLE = 0.02
"""s that runs follow one another for one repeat at least; its time is their mean. A single run of less
than a millisecond would be timed with the processor's caches full of another engine."""


@dataclass(frozen=True)
class Loading:
    """Load time of one model, s."""

    engine: str
    model: str
    seconds: float
    remark: str


@dataclass(frozen=True)
class Failure:
    """A model, or a setting of a method, that cannot run the scene."""

    engine: str
    method: str
    setting: str
    reason: str


@dataclass(frozen=True)
class Measurement(Timed):
    """One setting.

    Attributes:
        engine, method, setting: names.
        error_position, error_angle: largest over bodies and output times, m and rad.
        evaluations: of the equations of motion, in one run.
        first: s, of the first run, which is not among the repeats.
        times: s, of the repeats, each a mean over `SAMPLE`.
    """

    engine: str
    method: str
    setting: str
    error_position: float
    error_angle: float
    evaluations: int
    first: float
    times: tuple[float, ...] = ()

    @property
    def name(self) -> str:
        return f"{self.method}, {self.setting}"

    @property
    def error(self) -> float:
        """The larger of both errors, m or rad."""
        return max(self.error_position, self.error_angle)


@dataclass
class Measured:
    """All settings of all engines.

    Attributes:
        ended: why a ladder ends where it does, by engine and method.
    """

    measurements: list[Measurement] = field(default_factory=list)
    loadings: list[Loading] = field(default_factory=list)
    failures: list[Failure] = field(default_factory=list)
    ended: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Benchmark:
    """Result of a benchmark.

    Attributes:
        source: the name or the file that the scene was loaded from.
        options: of the scene, as they were set.
        scene: what was run.
        machine: what it ran on, see `crosscheck.studies.benchmark.timing.machine`.
        reference: what errors are taken against.
        measured: all settings.
    """

    source: str
    options: Mapping[str, str]
    scene: Scene
    machine: dict[str, Any]
    reference: Reference
    measured: Measured

    @property
    def title(self) -> str:
        return titled(self.scene.name, self.options)


def benchmark(scene: Scene, source: str, options: Mapping[str, str], progress: Progress) -> Benchmark:
    """Run every engine and setting over a scene; `progress` is told each stage.

    Raises:
        CrosscheckError: for a scene that cannot be benchmarked.
    """
    scene = poses_only(scene)
    where = machine()
    motion = reference(scene, progress)
    models = {name: engine(scene) for name, engine in ENGINES.items()}
    return Benchmark(source, options, scene, where, motion, measure(models, motion.poses, progress))


def measure(engines: Mapping[str, Models], exact: tuple[Array, Array], progress: Progress) -> Measured:
    """Run every setting of every engine once for its error, then in turns for its time.

    Args:
        engines: how each loads the scene.
        exact: positions (n, b, 3) and quaternions (n, b, 4) that errors are taken against.
        progress: is told each stage.
    """
    found = Measured()
    settings: list[Setting] = []
    for engine, models in engines.items():
        for name, load in models.items():
            progress(f"{engine}: {name}")
            begun = time.perf_counter()
            try:
                model = load()
            except Exception as error:  # whatever an engine has against a scene belongs in the table
                found.failures.append(Failure(engine, name, "", _reason(error)))
                continue
            found.loadings.append(Loading(engine, name, time.perf_counter() - begun, model.remark))
            climbing = time.process_time()
            for ladder in model.ladders:
                progress(f"{engine}: {ladder.method}")
                end = f"not begun: others of its model have taken {BUDGET:g} s"
                if time.process_time() - climbing < BUDGET:
                    end = _climb(engine, ladder, exact, found, settings)
                found.ended[f"{engine}: {ladder.method}"] = end
    counts = [repeats_of(m.first) for m in found.measurements]
    times = in_turns([partial(_sample, setting) for setting in settings], counts, progress)
    found.measurements = [replace(m, times=row) for m, row in zip(found.measurements, times, strict=True)]
    return found


def _climb(
    engine: str, ladder: Ladder, exact: tuple[Array, Array], found: Measured, settings: list[Setting]
) -> str:
    """Run the settings of a ladder once each, add those that ran to both lists; return why it ended."""
    for setting in ladder.settings:
        start = time.process_time()
        try:
            with steady(), time_limit(LIMIT):
                run = setting.run()
            errors = pose_errors(run.poses(), exact)
        except Exception as error:
            found.failures.append(Failure(engine, ladder.method, setting.name, _reason(error)))
            seconds = time.process_time() - start
            if seconds > LONGEST:
                return f"{setting.name} failed after {seconds:.1f} s, more than {LONGEST:g} s"
            continue
        if not np.all(np.isfinite(errors)):
            reason = "its motion is not finite"
            found.failures.append(Failure(engine, ladder.method, setting.name, reason))
            continue
        found.measurements.append(
            Measurement(engine, ladder.method, setting.name, *errors, run.evaluations, run.seconds)
        )
        settings.append(setting)
        if run.seconds > LONGEST and setting is not ladder.settings[-1]:
            return f"{setting.name} took {run.seconds:.1f} s, more than {LONGEST:g} s"
    return "its last setting"


def _sample(setting: Setting) -> float:
    """Return the mean time of runs one after the other, s."""
    seconds = [setting.run().seconds]
    while sum(seconds) < SAMPLE:
        seconds.append(setting.run().seconds)
    return sum(seconds) / len(seconds)


def repeats_of(first: float) -> int:
    """Return how often a setting is repeated whose first run took `first` seconds."""
    return max(LEAST_REPEATS, int(SHARE / max(first, SAMPLE)))


def _reason(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
