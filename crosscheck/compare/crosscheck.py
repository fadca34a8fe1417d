"""A crosscheck: one scene is simulated in several engines, and the engines are compared.

`crosscheck` executes all stages: runs, checks, diagnosis, coverage and advice. Its result is a `Crosscheck`,
which also has the verdict in words and a summary for JSON. The command `crosscheck run` and the Python
function `crosscheck.check` call this module; `crosscheck/report` makes tables and pages of the result.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

from crosscheck.compare.activity import reduction, watched, what_acted
from crosscheck.compare.advice import Advice, advise
from crosscheck.compare.check import READING, Check, finite, not_judged
from crosscheck.compare.coverage import Coverage, coverage
from crosscheck.compare.diagnosis import Diagnosis, diagnose
from crosscheck.compare.levels import in_order, reading_rows, stages
from crosscheck.compare.outcome import Outcome
from crosscheck.compare.reference_values import ReferenceCheck, known_of, measure
from crosscheck.compare.runs import measure_run_errors, nothing_moves_in_rigid_runs
from crosscheck.compare.singularity import SingularConfigurations, find_singular_configurations
from crosscheck.engines.engine import Engine
from crosscheck.engines.engine_runs import Stop, collecting_errors, run_engines, stops_text
from crosscheck.library.options import titled
from crosscheck.loading.load import non_default_options
from crosscheck.own_run.allowed import AllowedError, exceeded_text
from crosscheck.own_run.judge import Judgement, judge
from crosscheck.support.errors import CrosscheckError, reason_of
from crosscheck.support.time_limits import SHORTER_RUN_ADVICE, limited
from crosscheck.support.versions import versions
from newton_euler.equations.redundancy import mobility
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.model.trajectory import Trajectory
from newton_euler.reading.file_run import Event
from newton_euler.reading.import_report import ImportedElement, ImportReport

MIN_SAMPLED_VELOCITIES = 200
"""Smallest total number of velocities of the random states at which equations are compared."""

MIN_RANDOM_STATES, MAX_RANDOM_STATES = 4, 20
"""Range of the number of random states. Small mechanisms use more states: each state tests few joints."""

COVERAGE_OMITTED = "it is left out, the verdict does not depend on it"
"""Note on a coverage analysis that exceeds its time limit."""

JUDGING = "judging the file's own run"
"""Stage that judges the run with the settings of the file; notes on its failure begin with this text."""

MISREAD = "the scene does not match the file: no engine was run, and nothing else was compared"
"""Note on a crosscheck that ends because the imported scene differs from its model file."""

Progress = Callable[[str], None]
"""Function that shows a message to the user before each stage."""


@dataclass(frozen=True, eq=False)
class Crosscheck:
    """Result of a crosscheck.

    Attributes:
        source: name or file that the scene was loaded from; empty if it was made in Python.
        options: options of the scene or file that the user set.
        scene: scene that was simulated.
        engines: engines that can represent the scene, in the requested order.
        left_out: engines that cannot represent the scene, with the reason.
        trajectories: run of each engine; partial if the engine stopped, missing if it has no run at all.
        checks: all checks, except those against reference values.
        measured: checks against reference values, for scenes of the library that have some.
        wall_time: total wall time, s.
        mapping: import report of the model file: how each element was imported. None for other scenes.
        advice: advice on engine settings and redundant constraints, if it was requested.
        unfinished: engines that stopped, and parts of the comparison that did not complete.
        coverage: elements of the scene that the runs test; None if trajectories were not compared, or if the
            analysis did not complete (then `notes` has the reason).
        notes: one line for each additional analysis that did not complete.
        run_errors: error of each engine's run, m or rad, see `measure_run_errors`.
        singular: singular configurations of the first engine's run; None if there are none.
        own_run: judgement of the run that the file's own engine makes with the settings of the file; None for
            scenes of this package and for files without an engine of their own.
        allowed_errors: largest errors that the user allows for that run; empty if the run is not to fail.
    """

    source: str
    options: Mapping[str, str]
    scene: Scene
    engines: tuple[Engine, ...]
    left_out: dict[str, str]
    trajectories: dict[str, Trajectory]
    checks: tuple[Check, ...]
    measured: tuple[ReferenceCheck, ...]
    wall_time: float
    mapping: ImportReport | None = None
    advice: tuple[Advice, ...] = ()
    unfinished: tuple[Stop, ...] = ()
    coverage: Coverage | None = None
    notes: tuple[str, ...] = ()
    run_errors: Mapping[str, float] = field(default_factory=dict)
    singular: SingularConfigurations | None = None
    own_run: Judgement | None = None
    allowed_errors: tuple[AllowedError, ...] = ()

    @property
    def title(self) -> str:
        """Name of the scene, with the options that the user set."""
        return titled(self.scene.name, non_default_options(self.options))

    @property
    def nothing_moves(self) -> bool:
        """True if nothing moves in the runs, so that checks of runs test nothing."""
        return nothing_moves_in_rigid_runs(self.scene, self.engines, self.trajectories)

    @property
    def differs(self) -> bool:
        """True if any check exceeds its tolerance."""
        return not all(row.agrees for row in self.checks) or not all(known.agrees for known in self.measured)

    @property
    def outcome(self) -> Outcome:
        """Outcome of the comparison; if several apply, the most severe one."""
        if self.unfinished:
            return Outcome.UNFINISHED
        if self.differs:
            return Outcome.DISAGREE
        if self.exceeded:
            return Outcome.INACCURATE
        if self.left_out:
            return Outcome.NOT_COMPARED if self._single_engine else Outcome.AGREE_OF_SOME_ENGINES
        if self._single_engine:
            return Outcome.ONE_ENGINE_ALONE
        if self.is_reduced:
            return Outcome.AGREE_ON_A_REDUCED_MODEL
        if self.untested:
            return Outcome.AGREE_AT_RANDOM_STATES_ONLY
        return Outcome.AGREE

    @property
    def agrees(self) -> bool:
        """True for the outcome AGREE only: all checks passed, and all elements that act were simulated."""
        return self.outcome is Outcome.AGREE

    @property
    def exceeded(self) -> list[AllowedError]:
        """Allowed errors that the run with the settings of the file exceeds."""
        found = self.own_run
        return [each for each in self.allowed_errors if each.is_exceeded_by(found)] if found else []

    def with_allowed_errors(self, allowed: Sequence[AllowedError]) -> Crosscheck:
        """Return this result with largest errors that the run with the settings of the file may have.

        The result is unfinished if there is no judgement of that run although the engines agree.
        """
        stops = self.unfinished
        if allowed and self.own_run is None and not self.differs:
            reason = next((note for note in self.notes if note.startswith(JUDGING)), "not judged")
            stops = (*stops, Stop("your settings", reason.removeprefix(f"{JUDGING}: ")))
        return replace(self, allowed_errors=tuple(allowed), unfinished=stops)

    @property
    def untested(self) -> bool:
        """True if the coverage analysis found that the motion tests no element of the scene."""
        covered = self.coverage
        return covered is not None and len(covered.untested) == len(covered.elements)

    @property
    def acting(self) -> list[ImportedElement]:
        """Elements of the file that are not simulated but would have acted, in order of time."""
        return self.mapping.acting if self.mapping else []

    @property
    def is_reduced(self) -> bool:
        """True if elements of the file act that are not simulated, so that results are on a reduced model.

        The elements act in the compared motion, or in the run with the settings of the file if the user
        allows that run only a certain error.
        """
        return bool(self.acting or (self.allowed_errors and self.own_run and self.own_run.events))

    @property
    def until(self) -> float | None:
        """Time, s, at which the first such element would have acted; None if there is none."""
        return self.acting[0].since if self.acting else None

    @property
    def misread(self) -> bool:
        """True if the equations of all engines differ from the model file, so the import is wrong."""
        return _misread(self.engines, self.checks)

    @cached_property
    def diagnosis(self) -> tuple[Diagnosis, ...]:
        """Outliers, at the first level with a difference and then among the remaining engines."""
        return _diagnosed(self.scene, self.engines, self.checks, self.measured, self.unfinished)

    @property
    def _of_engines(self) -> str:
        """Number of compared engines as text, if some engines are left out."""
        count = len(self.engines)
        return f" ({count} of {count + len(self.left_out)} engines)" if self.left_out else ""

    @property
    def verdict(self) -> str:
        """Verdict in one line: agreement, or the outlier with the first failing check; and failures."""
        if self.outcome is Outcome.INACCURATE and self.own_run:
            others = replace(self, allowed_errors=()).verdict
            return f"{Outcome.INACCURATE}: {exceeded_text(self.own_run, self.exceeded)}; {others}"
        word, result = self._judgment()
        for name, reason in self.left_out.items():
            result += f"; {name} left out: {reason}"
        if self.left_out:
            names = ",".join(engine.name for engine in self.engines)
            result += f"; to do without, name the others (--engines {names})"
        if self.unfinished:
            stopped = {stop.what for stop in self.unfinished}
            completed = [name for name in self.trajectories if name not in stopped]
            others = ""
            if 0 < len(completed) < len(self.engines) and not self.diagnosis:
                others = f"; {' and '.join(completed)} ran to the end"
            return f"{self.outcome}: {stops_text(self.unfinished)}{others}; as far as compared {result}"
        return f"{word}: {result}"

    def _judgment(self) -> tuple[str, str]:
        """Outcome and text of the verdict, without left-out engines and stopped parts."""
        names = ", ".join(engine.name for engine in self.engines)
        # A single engine
        if self.left_out and self._single_engine:
            text = f"nothing could be compared on {self.title}, ran {names} alone; its own checks"
            return self.outcome, f"{text} {self._own_checks}"
        if self._single_engine:
            text = f"ran {names} on {self.title}: nothing to compare it with; its own checks"
            text += f" {self._own_checks}"
            return self.outcome, "; ".join(filter(None, [text, self._reduced]))
        # Engines that differ
        if self.diagnosis:
            first, *others = self.diagnosis
            parts = [f"{first.who}; {first.place}", first.fault_text]
            parts += [f"then {other.who}, {other.place}" for other in others]
            if self._reduced and not self.misread:
                parts.append(self._reduced)
            text = "; ".join(filter(None, parts))
            return f"{Outcome.DISAGREE}{self._of_engines}", f"{text} ({self._failed})"
        # Engines that agree
        agree = f"{names} agree on {self.title} in all {len(self.judged)} checks{self._qualifications}"
        if self._reduced:
            agree = f"{self._reduced}; {agree}"
        some = self.outcome in (Outcome.AGREE_OF_SOME_ENGINES, Outcome.UNFINISHED)
        return f"AGREE{self._of_engines}" if some else self.outcome, agree

    @property
    def _reduced(self) -> str:
        """Text on the elements that act and are not simulated, with the time of the first; may be empty."""
        if self.acting:
            return reduction(self.acting)
        if self.is_reduced and self.own_run:
            first = self.own_run.events[0]
            return f"your settings are judged without {first.element}, which acts from {first.time:.4g} s on"
        return ""

    @property
    def _single_engine(self) -> bool:
        """True if there is only one engine, and nothing that it was compared with differs."""
        compared = any(len(row.between) > 1 for row in self.checks if not row.agrees)
        return len(self.engines) == 1 and not compared and all(known.agrees for known in self.measured)

    @property
    def _own_checks(self) -> str:
        """Text on the checks of a single engine."""
        failed = next((row for row in self.checks if not row.agrees), None)
        if failed is None:
            return f"hold, all {len(self.judged)}{self._qualifications}"
        return (
            f"fail at level '{failed.level}': {failed.quantity}: {failed.value:.3g} > "
            f"{failed.tolerance:.3g}, worst at {failed.where} ({self._failed})"
        )

    @property
    def judged(self) -> tuple[Check, ...]:
        """Checks that decide the outcome; the verdict states their number."""
        return tuple(row for row in self.checks if row.judged)

    @property
    def _failed(self) -> str:
        """Number of failing checks, or else of failing reference values, as text."""
        failed = sum(not row.agrees for row in self.checks)
        if failed:
            return f"{failed} of {len(self.judged)} checks fail"
        failed_references = sum(not measured.agrees for measured in self.measured)
        return f"{failed_references} of {len(self.measured)} reference values fail"

    @property
    def _qualifications(self) -> str:
        """Qualifications of an agreement: reference values, checks that are not judged, coverage."""
        text = f", and the reference in all {len(self.measured)}" if self.measured else ""
        text += not_judged(self.checks)
        text += "; nothing moves" if self.nothing_moves else ""
        if self.coverage:
            text += f"; {self.coverage}"
        elif len(self.engines) > 1:
            text += "; what the motion covers is not known"
        references = self.mapping.references if self.mapping else []
        if references and not any(reference.tells for reference, _ in references):
            text += "; motions are not verified against the file: no state tells them"
        if self.mapping and (counts := self.mapping.counts()):
            text += f"; of what can act in the file {counts}"
        return text

    def summary(self) -> dict[str, Any]:
        """All checks, versions, settings and wall times, for JSON."""
        packages = sorted({"numpy", "scipy", "rerun-sdk", *(engine.package for engine in self.engines)})
        return {
            "scene": self.scene.name,
            "source": self.source,
            "options": dict(self.options),
            "agrees": self.agrees,
            "outcome": self.outcome.value,
            "not_simulated": [asdict(entry) for entry in self.acting],
            "as_in_the_file_until": self.until,
            "verdict": self.verdict,
            "wall_time": self.wall_time,
            "versions": versions(packages),
            "diagnosis": [diagnosis.summary() for diagnosis in self.diagnosis],
            "unfinished": [asdict(stop) for stop in self.unfinished],
            "engines": {engine.name: self._run_summary(engine.name) for engine in self.engines},
            "left_out": self.left_out,
            "mapping": [asdict(entry) for entry in self.mapping.entries] if self.mapping else None,
            "findings": [asdict(each) for each in self.mapping.findings] if self.mapping else None,
            "start": self.mapping.start if self.mapping else None,
            "moved_start": asdict(moved) if self.mapping and (moved := self.mapping.moved) else None,
            "changed_velocities": asdict(changed)
            if self.mapping and (changed := self.mapping.changed_velocities)
            else None,
            "checks": [asdict(row) | {"agrees": row.agrees} for row in self.checks],
            "known_values": [measured.summary() for measured in self.measured],
            "advice": [asdict(advice) for advice in self.advice],
            "coverage": self.coverage.summary() if self.coverage else None,
            "notes": list(self.notes),
            "singular": asdict(self.singular) if self.singular else None,
            "own_run": self.own_run.summary() if self.own_run else None,
            "allowed_errors": [
                {"kind": each.kind.value, "largest": each.largest, "exceeded": each in self.exceeded}
                for each in self.allowed_errors
            ],
        }

    def _run_summary(self, name: str) -> dict[str, Any]:
        """Return settings, wall time and error of an engine's run, for JSON."""
        if name not in self.trajectories:
            return {"settings": {}, "wall_time": None, "error": None}
        run = self.trajectories[name]
        return {"settings": run.settings, "wall_time": run.wall_time, "error": self.run_errors.get(name)}


def crosscheck(
    scene: Scene,
    engines: Sequence[Engine],
    progress: Progress,
    source: str,
    options: Mapping[str, str],
    mapping: ImportReport | None = None,
    advised: bool = False,
) -> Crosscheck:
    """Simulate a scene in the engines and compare them.

    If an engine stops or a part of the comparison fails, everything else is still compared.

    Args:
        scene: scene to simulate, with the outputs velocities, reactions and violation.
        engines: engines to compare.
        progress: shows a message to the user before each stage.
        source: name or file that the scene was loaded from; empty if it was made in Python.
        options: options of the scene or file that the user set.
        mapping: import report of a model file; None for other scenes.
        advised: True to compute advice, which needs more runs, if all engines completed.

    Raises:
        CrosscheckError: for a scene without the required outputs, or if no engine runs and no check could be
            made.
        NewtonEulerError: for a scene that no engine can represent.
    """
    for output in ("velocities", "reactions", "violation"):
        if output not in scene.outputs:
            raise CrosscheckError(f"scene {scene.name!r} does not ask for the output {output!r}, needed here")
    start = time.perf_counter()
    usable, left_out = _usable_engines(scene, engines)
    # Compare the equations with the model file; end here if the import is wrong
    rows: list[Check] = []
    file_stops: list[Stop] = []
    what = "comparing with the file"
    with collecting_errors(what, file_stops), limited(what, SHORTER_RUN_ADVICE, progress):
        for row in finite(reading_rows(usable, mapping)):
            rows.append(row)  # one by one, to keep the checks before an error
    if _misread(usable, rows):
        return Crosscheck(
            source=source,
            options=options,
            scene=scene,
            engines=tuple(usable),
            left_out=left_out,
            trajectories={},
            checks=tuple(rows),
            measured=(),
            wall_time=time.perf_counter() - start,
            mapping=mapping,
            notes=(MISREAD,),
        )
    # Simulate the scene in all engines
    runs, stops = run_engines(scene, usable, progress)
    stopped = {stop.what for stop in stops}
    stops += file_stops
    # Find elements of the file that are not simulated but would act in the run
    note_stops: list[Stop] = []  # failures that do not affect the verdict
    if mapping and runs:
        what = "watching what was left out"
        imported, mapping = mapping, mapping.unwatched()  # kept if the search fails
        with collecting_errors(what, note_stops), limited(what, SHORTER_RUN_ADVICE, progress):
            mapping = watched(scene, imported, next(iter(runs.values())))
    # Judge the run that the file's own engine makes with the settings of the file
    own_run: Judgement | None = None
    if mapping and mapping.simulation and runs:
        acting = [Event(entry.since or 0.0, what_acted(entry)) for entry in mapping.acting]
        with collecting_errors(JUDGING, note_stops), limited(JUDGING, SHORTER_RUN_ADVICE, progress):
            own_run = judge(mapping.simulation, acting)
    until = mapping.acting[0].since if mapping and mapping.acting else None
    # Compare equations and runs; runs are not comparable if the scene does not determine its motion
    comparable = {} if any(stop.undetermined for stop in stops) else runs
    for what, stage in stages(scene, usable, comparable, _random_states(scene), until).items():
        with collecting_errors(what, stops), limited(what, SHORTER_RUN_ADVICE, progress):
            for row in finite(stage(tuple(rows))):
                rows.append(row)
    if not (rows or runs):
        raise CrosscheckError(stops_text(stops))
    rows = in_order(rows)
    # Compare with reference values
    measured: list[ReferenceCheck] = []
    known = known_of(source, options)
    for engine in usable if known else ():
        if engine.name not in stopped:
            what = f"{engine.name}: reference values"
            with collecting_errors(what, stops), limited(what, SHORTER_RUN_ADVICE, progress):
                measured.extend(measure(source, scene, engine, runs[engine.name], known))
    # Additional analyses: coverage, singular configurations, advice, and errors of runs
    covered: Coverage | None = None
    what = "working out what the motion covers"
    with collecting_errors(what, note_stops), limited(what, COVERAGE_OMITTED, progress, "coverage_time"):
        covered = coverage(scene, comparable, rows)
    singular: SingularConfigurations | None = None
    what = "searching singular configurations"
    with collecting_errors(what, note_stops), limited(what, SHORTER_RUN_ADVICE, progress):
        singular = find_singular_configurations(scene, next(iter(runs.values()))) if runs else None
    advice: tuple[Advice, ...] = ()
    if advised and not stops:
        what = "working out advice"
        with collecting_errors(what, note_stops), limited(what, "there is none", progress):
            advice = advise(scene, usable, runs, rows)
    run_errors: dict[str, float] = {}
    outliers = {diagnosis.outlier for diagnosis in _diagnosed(scene, usable, rows, measured, stops)}
    what = "measuring each engine's error"
    with collecting_errors(what, note_stops), limited(what, SHORTER_RUN_ADVICE, progress):
        trusted = [engine for engine in usable if engine.name not in outliers]
        run_errors = measure_run_errors(scene, trusted, comparable)
    return Crosscheck(
        source=source,
        options=options,
        scene=scene,
        engines=tuple(usable),
        left_out=left_out,
        trajectories=runs,
        checks=tuple(rows),
        measured=tuple(measured),
        wall_time=time.perf_counter() - start,
        mapping=mapping,
        advice=advice,
        unfinished=tuple(stops),
        coverage=covered,
        notes=tuple(map(str, note_stops)),
        run_errors=run_errors,
        singular=singular,
        own_run=own_run,
    )


def _diagnosed(
    scene: Scene,
    engines: Sequence[Engine],
    checks: Sequence[Check],
    measured: Sequence[ReferenceCheck],
    stops: Sequence[Stop],
) -> tuple[Diagnosis, ...]:
    """Make the diagnosis, see `Crosscheck.diagnosis`; stopped engines do not count as soft."""
    stopped = {stop.what for stop in stops}
    soft = [each.name for each in engines if each.evaluate_soft_constraints and each.name not in stopped]
    names = [each.name for each in engines]
    return diagnose(names, checks, measured, soft, mobility(scene).nearly)


def _misread(engines: Sequence[Engine], rows: Sequence[Check]) -> bool:
    """Return True if the equations of every engine differ from those of the model file."""
    differing = {row.between[0] for row in rows if row.level == READING and not row.agrees}
    return bool(engines) and differing >= {engine.name for engine in engines}


def _random_states(scene: Scene) -> int:
    """Return the number of random states at which equations are compared."""
    velocities = max(1, SpanningTree(scene.mechanism).nv)
    states = -(-MIN_SAMPLED_VELOCITIES // velocities)  # rounded up
    return max(MIN_RANDOM_STATES, min(MAX_RANDOM_STATES, states))


def _usable_engines(scene: Scene, engines: Sequence[Engine]) -> tuple[list[Engine], dict[str, str]]:
    """Find the engines that can represent a scene.

    Returns:
        These engines, and the reason for each other engine. The refined run and the equations of each engine
        are cached, since several checks use them.

    Raises:
        NewtonEulerError: the error of the first engine, if no engine can represent the scene.
    """
    usable, errors = [], {}
    for engine in engines:
        refined = lru_cache(_naming_refined_run(engine))
        cached = replace(engine, refined=refined, systems=lru_cache(engine.systems))
        try:
            cached.systems(scene)
        except NewtonEulerError as error:
            errors[engine.name] = error
        else:
            usable.append(cached)
    if not usable:
        raise errors[engines[0].name]
    return usable, {name: str(error) for name, error in errors.items()}


def _naming_refined_run(engine: Engine) -> Callable[[Scene], Trajectory]:
    """Return the engine's function for refined runs, with errors that name the engine and the purpose."""

    def refined(scene: Scene) -> Trajectory:
        name = f"{engine.name}, in a finer run for comparison"
        try:
            return engine.refined(scene)
        except NewtonEulerError as error:
            error.args = (f"{name}: {error}",)
            raise
        except Exception as error:
            raise CrosscheckError(f"{name}: {reason_of(error)}") from error

    return refined
