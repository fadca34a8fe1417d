"""Run time against error, for every engine and setting: what is measured and how.

The time of a setting is what it takes to have the motion of all bodies at all output times; loading,
compiling and the first run are told apart from it. Settings take turns, so that a machine that slows
down slows all of them down. The error is the largest over all bodies and output times against
`crosscheck.studies.benchmark.reference`.
"""

from __future__ import annotations

import gc
import os
import platform
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from crosscheck.limit import time_limit
from newton_euler.model.euler_parameters import angle_between
from newton_euler.scalars import Array

LONGEST = 1.5
"""s: a ladder is climbed no further once one of its runs has taken longer."""

LIMIT = 3.0
"""s after which a run is given up."""

BUDGET = 20.0
"""s after which a model begins no further ladder."""

SHARE = 0.15
"""s that the repeats of one setting should take together, if `LEAST_REPEATS` of them do not take longer."""

LEAST_REPEATS = 3

SAMPLE = 0.02
"""s that runs follow one another for one repeat at least; its time is their mean. A single run of less
than a millisecond would be timed with the processor's caches full of another engine."""

PACKAGES = ("crosscheck", "numpy", "scipy", "llvmlite", "mujoco", "pin")
"""Whose versions are recorded."""

Progress = Callable[[str], None]


class Run(NamedTuple):
    """One timed run.

    Attributes:
        seconds: what it took, by its own clock.
        evaluations: of the equations of motion.
        poses: works out positions (n, b, 3), m, and quaternions (n, b, 4) of the bodies, ground
            first, at the output times; not timed.
    """

    seconds: float
    evaluations: int
    poses: Callable[[], tuple[Array, Array]]


class Setting(NamedTuple):
    """One way to run a scene; `run` raises an exception that says why if it cannot.

    `options` say the same to whoever runs many scenes at once.
    """

    name: str
    run: Callable[[], Run]
    options: Mapping[str, Any] = MappingProxyType({})


class Ladder(NamedTuple):
    """Settings of one method, from the coarsest to the finest."""

    method: str
    settings: tuple[Setting, ...]


class Model(NamedTuple):
    """What an engine has loaded of a scene: its methods, and a remark about the loading."""

    ladders: tuple[Ladder, ...]
    remark: str


Models = Mapping[str, Callable[[], Model]]
"""How an engine loads a scene in each of the ways it knows, by name."""


@dataclass(frozen=True)
class Loading:
    """How long one model took to load, s."""

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
class Measurement:
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
    times: tuple[float, ...]

    @property
    def name(self) -> str:
        return f"{self.method}, {self.setting}"

    @property
    def error(self) -> float:
        """The larger of both errors, m or rad."""
        return max(self.error_position, self.error_angle)

    @property
    def median(self) -> float:
        """s"""
        return float(np.median(self.times))

    @property
    def quartiles(self) -> tuple[float, float]:
        """s"""
        low, high = np.quantile(self.times, [0.25, 0.75])
        return float(low), float(high)


@dataclass(frozen=True)
class Measured:
    """All settings of all engines."""

    measurements: tuple[Measurement, ...]
    loadings: tuple[Loading, ...]
    failures: tuple[Failure, ...]
    ended: Mapping[str, str]
    """Why a ladder ends where it does, by engine and method."""


class _Climbed(NamedTuple):
    """A setting that ran."""

    engine: str
    method: str
    setting: Setting
    errors: tuple[float, float]
    evaluations: int
    first: float


def pose_errors(poses: tuple[Array, Array], reference: tuple[Array, Array]) -> tuple[float, float]:
    """Largest distance (m) and rotation angle (rad) of positions (n, b, 3) and quaternions (n, b, 4)."""
    distance = np.linalg.norm(poses[0] - reference[0], axis=-1)
    return float(np.max(distance)), float(np.max(angle_between(poses[1], reference[1])))


def intervals(times: Array) -> list[tuple[int, float]]:
    """How many equal intervals, s, there are between outputs, and then the last if it is shorter."""
    first, last = float(times[1] - times[0]), float(times[-1] - times[-2])
    if abs(first - last) <= 1e-9 * first:
        return [(len(times) - 1, first)]
    return [(len(times) - 2, first), (1, last)]


def measure(
    engines: Mapping[str, Models], reference: tuple[Array, Array], repeats: int, progress: Progress
) -> Measured:
    """Run every setting of every engine once for its error, then in turns for its time.

    Args:
        engines: how each loads the scene.
        reference: positions (n, b, 3) and quaternions (n, b, 4) that errors are taken against.
        repeats: of a fast setting; slow ones have fewer, `LEAST_REPEATS` at least.
        progress: is told each stage.
    """
    loadings: list[Loading] = []
    failures: list[Failure] = []
    climbed: list[_Climbed] = []
    ended: dict[str, str] = {}
    for engine, models in engines.items():
        for name, load in models.items():
            progress(f"{engine}: {name}")
            start = time.perf_counter()
            try:
                model = load()
            except Exception as error:  # whatever an engine has against a scene belongs in the table
                failures.append(Failure(engine, name, "", _reason(error)))
                continue
            loadings.append(Loading(engine, name, time.perf_counter() - start, model.remark))
            begun = time.perf_counter()
            for ladder in model.ladders:
                progress(f"{engine}: {ladder.method}")
                if time.perf_counter() - begun > BUDGET:
                    end = f"not begun: others of its model have taken {BUDGET:g} s"
                else:
                    end = _climb(engine, ladder, reference, climbed, failures)
                ended[f"{engine}: {ladder.method}"] = end
    times = _in_turns(climbed, repeats, progress)
    measurements = tuple(
        Measurement(
            c.engine, c.method, c.setting.name, *c.errors, c.evaluations, c.first, tuple(times[index])
        )
        for index, c in enumerate(climbed)
    )
    return Measured(measurements, tuple(loadings), tuple(failures), ended)


def _climb(
    engine: str,
    ladder: Ladder,
    reference: tuple[Array, Array],
    climbed: list[_Climbed],
    failures: list[Failure],
) -> str:
    """Run the settings of a ladder once each; why it ended."""
    for setting in ladder.settings:
        start = time.perf_counter()
        try:
            with steady(), time_limit(LIMIT):
                run = setting.run()
            errors = pose_errors(run.poses(), reference)
        except Exception as error:
            failures.append(Failure(engine, ladder.method, setting.name, _reason(error)))
            seconds = time.perf_counter() - start
            if seconds > LONGEST:
                return f"{setting.name} failed after {seconds:.1f} s, more than {LONGEST:g} s"
            continue
        if not np.all(np.isfinite(errors)):
            failures.append(Failure(engine, ladder.method, setting.name, "its motion is not finite"))
            continue
        climbed.append(_Climbed(engine, ladder.method, setting, errors, run.evaluations, run.seconds))
        if run.seconds > LONGEST and setting is not ladder.settings[-1]:
            return f"{setting.name} took {run.seconds:.1f} s, more than {LONGEST:g} s"
    return "its last setting"


def _in_turns(climbed: Sequence[_Climbed], repeats: int, progress: Progress) -> list[list[float]]:
    """Times of the repeats of each setting, s; whoever has fewer repeats has them evenly spread."""
    counts = [repeats_of(c.first, repeats) for c in climbed]
    times: list[list[float]] = [[] for _ in climbed]
    rounds = max(counts, default=0)
    for turn in range(rounds):
        progress(f"repeat {turn + 1} of {rounds}")
        for c, count, row in zip(climbed, counts, times, strict=True):
            if turn * count % rounds < count:
                with steady():
                    row.append(_sample(c.setting))
    return times


def _sample(setting: Setting) -> float:
    """Mean time of runs one after the other, s."""
    seconds = [setting.run().seconds]
    while sum(seconds) < SAMPLE:
        seconds.append(setting.run().seconds)
    return sum(seconds) / len(seconds)


def repeats_of(first: float, repeats: int) -> int:
    """How often a setting is repeated whose first run took `first` seconds."""
    return min(repeats, max(LEAST_REPEATS, int(SHARE / max(first, SAMPLE))))


@contextmanager
def steady() -> Iterator[None]:
    """No garbage collection in what is timed."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _reason(error: Exception) -> str:
    text = " ".join(str(error).split())
    return text or type(error).__name__


def machine() -> dict[str, Any]:
    """What it ran on: processor, cores, load by others at the start, system, Python, packages."""
    versions = {}
    for package in PACKAGES:
        with suppress(PackageNotFoundError):
            versions[package] = version(package)
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "versions": versions,
    }


def _processor() -> str:
    """The name of the processor, from where Linux keeps it or as Python knows it."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            name, _, value = line.partition(":")
            if name.strip() == "model name":
                return value.strip()
    return platform.processor() or platform.machine()
