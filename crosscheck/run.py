"""One crosscheck: a scene through several engines, compared, written to a folder."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from importlib.metadata import version
from typing import Any

from crosscheck.advice import Advice, Found, advise
from crosscheck.comparison.known_figures import Measured, known_of, measure
from crosscheck.comparison.levels import Row, compare, without_runs
from crosscheck.comparison.rows import not_judged
from crosscheck.comparison.runs import rests
from crosscheck.each_run import check_figures, each_run
from crosscheck.engines import Engine
from crosscheck.errors import CrosscheckError, reason_of
from crosscheck.limit import SHORTER, TooLongError, limited
from crosscheck.partial import UnfinishedError
from crosscheck.scenes.options import titled
from newton_euler.activity import Course
from newton_euler.errors import NewtonEulerError
from newton_euler.mapping import Mapping as Report
from newton_euler.scene import Scene
from newton_euler.trajectory import Trajectory

RANDOM_STATES = 20
"""Random consistent states at which the engines' equations are compared in a run."""

Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Crosscheck:
    """What a crosscheck found.

    Attributes:
        source: the name or the file that the scene was loaded from.
        options: of the scene, as they were set.
        scene: what was run.
        engines: those that ran, in the order asked for.
        left_out: engines that cannot express the scene, and why.
        runs: by engine.
        rows: the compared figures.
        measured: figures that are known from elsewhere, as the engines give them.
        wall_time: s, of everything.
        mapping: what became of the elements of a model file; None for a scene of this package's own.
        advice: what to do about what was measured.
    """

    source: str
    options: Mapping[str, str]
    scene: Scene
    engines: tuple[Engine, ...]
    left_out: dict[str, str]
    runs: dict[str, Trajectory]
    rows: tuple[Row, ...]
    measured: tuple[Measured, ...]
    wall_time: float
    mapping: Report | None = None
    advice: tuple[Advice, ...] = ()

    @property
    def title(self) -> str:
        """The scene's name, with the options that were set."""
        return titled(self.scene.name, self.options)

    @property
    def rests(self) -> bool:
        """Whether nothing moves in the runs, so that trajectories and energies test nothing."""
        return rests(self.scene, self.engines, self.runs)

    @property
    def deserted(self) -> bool:
        """Whether several engines were asked for and only one can express the scene."""
        return len(self.engines) == 1 and bool(self.left_out)

    @property
    def agrees(self) -> bool:
        """Whether every figure is within its tolerance; never of a deserted engine."""
        return (
            not self.deserted
            and all(row.agrees for row in self.rows)
            and all(known.agrees for known in self.measured)
        )

    @property
    def verdict(self) -> str:
        """One line: whether the engines agree, or the first level that does not, and where."""
        names = ", ".join(engine.name for engine in self.engines)
        judged = [row for row in self.rows if not row.informs]
        failed = [row for row in judged if not row.agrees]
        wrong = [measured for measured in self.measured if not measured.agrees]
        alone = len(self.engines) == 1
        subject = f"ran {names} alone on {self.title}: nothing to compare it with; its own figures"
        if self.deserted:
            subject = (
                f"NOT COMPARED: nothing could be compared on {self.title}, ran {names} alone: "
                f"{' and '.join(self.left_out)} cannot express it; its own figures"
            )
        if failed:
            row = failed[0]
            if not alone:
                parting = "part" if len(row.between) > 1 else "fails"
                subject = f"DISAGREE: {' and '.join(row.between)} {parting} on {self.title}"
            return (
                f"{subject}{' fail' if alone else ''} at level '{row.level}': {row.quantity}: "
                f"{row.value:.3g} > {row.tolerance:.3g}, worst at {row.where} "
                f"({len(failed)} of {len(judged)} figures fail)"
            )
        if wrong:
            first = wrong[0]
            return (
                f"DISAGREE: {first.engine} and the reference part on {self.title}: {first.known.quantity} "
                f"at {first.known.time:g} s: {first.difference:.3g} > {first.allowed:.3g} "
                f"({len(wrong)} of {len(self.measured)} known figures fail)"
            )
        known = f", and the reference in all {len(self.measured)}" if self.measured else ""
        known += not_judged(self.rows)
        known += "; nothing moves" if self.rests else ""
        if self.mapping and (counts := self.mapping.counts()):
            known += f"; of the file {counts}"
        if alone:
            return f"{subject} hold, all {len(judged)}{known}"
        return f"AGREE: {names} agree on {self.title} in all {len(judged)} figures{known}"

    def summary(self) -> dict[str, Any]:
        """All figures, versions, settings and wall times, for JSON."""
        packages = sorted({"numpy", "scipy", "rerun-sdk", *(engine.package for engine in self.engines)})
        return {
            "scene": self.scene.name,
            "source": self.source,
            "options": dict(self.options),
            "agrees": self.agrees,
            "verdict": self.verdict,
            "wall_time": self.wall_time,
            "versions": {"python": platform.python_version()} | {p: version(p) for p in packages},
            "engines": {
                name: {"settings": run.settings, "wall_time": run.wall_time}
                for name, run in self.runs.items()
            },
            "left_out": self.left_out,
            "mapping": [asdict(entry) for entry in self.mapping.entries] if self.mapping else None,
            "start": self.mapping.start if self.mapping else None,
            "figures": [asdict(row) | {"agrees": row.agrees} for row in self.rows],
            "known_figures": [measured.summary() for measured in self.measured],
            "advice": [asdict(advice) for advice in self.advice],
        }


def crosscheck(
    scene: Scene,
    engines: Sequence[Engine],
    progress: Progress,
    source: str,
    options: Mapping[str, str],
    mapping: Report | None = None,
) -> Crosscheck:
    """Run a scene through the engines and compare them; `progress` is told each stage.

    Raises:
        CrosscheckError: for a scene without the outputs that are compared. `UnfinishedError`, with all
            runs, where an engine's fails, does not end or is not finite, after all others ran; and where
            they cannot be compared.
        NewtonEulerError: for a scene that no engine can express.
    """
    for output in ("velocities", "reactions", "violation"):
        if output not in scene.outputs:
            raise CrosscheckError(f"scene {scene.name!r} does not ask for the output {output!r}, needed here")
    start = time.perf_counter()
    able, left_out = _able(scene, engines)
    runs = each_run(scene, able, progress, lambda: without_runs(scene, able, RANDOM_STATES))
    try:
        with limited("comparing equations and runs", SHORTER, progress):
            rows = compare(scene, able, runs, RANDOM_STATES)
        check_figures(rows)
        measured: list[Measured] = []
        known = known_of(source, options)
        for engine in able if known else ():
            progress(f"{engine.name}: known figures")
            measured.extend(measure(source, scene, engine, runs[engine.name], known))
        if mapping:
            mapping = mapping.after(Course(scene, runs[able[0].name]))
        advice: tuple[Advice, ...] = ()
        with suppress(TooLongError), limited("working out advice", "there is none", progress):
            advice = advise(Found(scene, source, able, runs, rows, options, mapping))
    except Exception as error:  # runs are kept whatever goes wrong with their comparison
        raise UnfinishedError(reason_of(error), runs) from error
    wall_time = time.perf_counter() - start
    return Crosscheck(
        source,
        options,
        scene,
        tuple(able),
        left_out,
        runs,
        tuple(rows),
        tuple(measured),
        wall_time,
        mapping,
        advice,
    )


def _able(scene: Scene, engines: Sequence[Engine]) -> tuple[list[Engine], dict[str, str]]:
    """The engines that can express a scene, and why the others cannot.

    Those that can make their finer run at most once, for all that it is compared with; where it stops, they
    say whose it was.

    Raises:
        NewtonEulerError: the first engine's own where none can.
    """
    able, errors = [], {}
    for engine in engines:
        try:
            engine.systems(scene)
        except NewtonEulerError as error:
            errors[engine.name] = error
        else:
            able.append(replace(engine, refined=lru_cache(_named(engine))))
    if not able:
        raise errors[engines[0].name]
    return able, {name: str(error) for name, error in errors.items()}


def _named(engine: Engine) -> Callable[[Scene], Trajectory]:
    """The engine's finer run, with errors that name it."""

    def refined(scene: Scene) -> Trajectory:
        try:
            return engine.refined(scene)
        except Exception as error:
            kind = NewtonEulerError if isinstance(error, NewtonEulerError) else CrosscheckError
            raise kind(f"{engine.name}, in a finer run for comparison: {reason_of(error)}") from error

    return refined
