"""One crosscheck: a scene through several engines, compared, written to a folder."""

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
from crosscheck.compare.reference_values import ReferenceCheck, known_of, measure
from crosscheck.compare.runs import measure_run_errors, nothing_moves_in_rigid_runs
from crosscheck.compare.singularity import SingularConfigurations, find_singular_configurations
from crosscheck.engines.engine import Engine
from crosscheck.engines.engine_runs import Stop, collecting_errors, run_engines, stops_text
from crosscheck.library.options import titled
from crosscheck.loading.load import non_default_options
from crosscheck.own_run.judge import Judgement, judge
from crosscheck.report.outcome import Outcome
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
"""Range of the number of random states; small mechanisms need more states, since each samples few joints."""

COVERAGE_OMITTED = "it is left out, the verdict does not depend on it"
"""Note on a coverage analysis that takes too long."""

MISREAD = "the scene does not match the file: no engine was run, and nothing else was compared"
"""Note on a crosscheck that ends after the verification of the imported scene."""

Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Crosscheck:
    """Result of a crosscheck.

    Attributes:
        source: the name or the file that the scene was loaded from; empty if it was made in Python.
        options: of the scene, as they were set.
        scene: what was run.
        engines: those that can express the scene, in the order asked for.
        left_out: engines that cannot express the scene, and why.
        trajectories: by engine, as far as they came; none of an engine that came nowhere.
        checks: all checks.
        measured: checks that are known from elsewhere, as the engines give them.
        wall_time: s, of everything.
        mapping: what became of the elements of a model file; None for a scene of this package's own.
        advice: what to do about what was measured, where that was asked for.
        unfinished: engines that stopped, and parts of the comparison that did not come to their end.
        coverage: elements that the compared runs test; None where no trajectories were compared, and where
            `notes` say why it is not known.
        notes: what else there is to say, a line each: what beside the comparison did not come to its end.
        run_errors: by engine its run's distance from the finest, see `measure_run_errors`.
        singular: singular configurations of the first engine's run; None if there are none.
        own_run: judgement of the run that the file's own engine makes with the settings of the file; None for
            scenes of this package and for files without an engine of their own.
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

    @property
    def title(self) -> str:
        """The scene's name, with the options that were set."""
        return titled(self.scene.name, non_default_options(self.options))

    @property
    def nothing_moves(self) -> bool:
        """True if nothing moves in the runs, so that trajectories and energies test nothing."""
        return nothing_moves_in_rigid_runs(self.scene, self.engines, self.trajectories)

    @property
    def differs(self) -> bool:
        """True if any check exceeds its tolerance."""
        return not all(row.agrees for row in self.checks) or not all(known.agrees for known in self.measured)

    @property
    def outcome(self) -> Outcome:
        """The outcome; one that says more against agreement comes before one that says less."""
        if self.unfinished:
            return Outcome.UNFINISHED
        if self.differs:
            return Outcome.DISAGREE
        if self.left_out:
            return Outcome.NOT_COMPARED if self._alone else Outcome.AGREE_OF_SOME_ENGINES
        if self._alone:
            return Outcome.ONE_ENGINE_ALONE
        if self.acting:
            return Outcome.AGREE_ON_A_REDUCED_MODEL
        if self.untested:
            return Outcome.AGREE_AT_RANDOM_STATES_ONLY
        return Outcome.AGREE

    @property
    def agrees(self) -> bool:
        """True for AGREE alone: all checks passed, and all that acted in the file was simulated."""
        return self.outcome is Outcome.AGREE

    @property
    def untested(self) -> bool:
        """True if the motion is known to test none of the elements."""
        covered = self.coverage
        return covered is not None and len(covered.untested) == len(covered.elements)

    @property
    def acting(self) -> list[ImportedElement]:
        """Elements of the file that acted and were not simulated as the file has them, in order of time."""
        return self.mapping.acting if self.mapping else []

    @property
    def until(self) -> float | None:
        """s, the first time at which the model that was run is not the file's; None if it always is."""
        return self.acting[0].since if self.acting else None

    @property
    def misread(self) -> bool:
        """True if the scene is not what the file says, whichever engine evaluates it."""
        return _misread(self.engines, self.checks)

    @cached_property
    def diagnosis(self) -> tuple[Diagnosis, ...]:
        """Who differs, at the first level at which any engine does, and then without it."""
        return _diagnosed(self.scene, self.engines, self.checks, self.measured, self.unfinished)

    @property
    def _of_engines(self) -> str:
        """Number of compared engines as text, if some engines are left out."""
        count = len(self.engines)
        return f" ({count} of {count + len(self.left_out)} engines)" if self.left_out else ""

    @property
    def verdict(self) -> str:
        """Verdict in one line: agreement, or the outlier and the first failing check, and what did not
        complete."""
        word, found = self._judgment()
        for name, reason in self.left_out.items():
            found += f"; {name} left out: {reason}"
        if self.left_out:
            names = ",".join(engine.name for engine in self.engines)
            found += f"; to do without, name the others (--engines {names})"
        if self.unfinished:
            stopped = {stop.what for stop in self.unfinished}
            ended = [name for name in self.trajectories if name not in stopped]
            others = ""
            if 0 < len(ended) < len(self.engines) and not self.diagnosis:
                others = f"; {' and '.join(ended)} ran to the end"
            return f"{self.outcome}: {stops_text(self.unfinished)}{others}; as far as compared {found}"
        return f"{word}: {found}"

    def _judgment(self) -> tuple[str, str]:
        """Outcome and text of the verdict, without left-out engines and stopped parts."""
        names = ", ".join(engine.name for engine in self.engines)
        if self.left_out and self._alone:
            found = f"nothing could be compared on {self.title}, ran {names} alone; its own checks"
            return self.outcome, f"{found} {self._own_checks}"
        if self._alone:
            found = f"ran {names} on {self.title}: nothing to compare it with; its own checks"
            found += f" {self._own_checks}"
            return self.outcome, "; ".join(filter(None, [found, self._reduced]))
        if self.diagnosis:
            first, *others = self.diagnosis
            said = [f"{first.who}; {first.place}", first.fault_text]
            said += [f"then {other.who}, {other.place}" for other in others]
            if self._reduced and not self.misread:
                said.append(self._reduced)
            differ = "; ".join(filter(None, said))
            return f"{Outcome.DISAGREE}{self._of_engines}", f"{differ} ({self._failed})"
        agree = f"{names} agree on {self.title} in all {len(self.judged)} checks{self._qualifications}"
        if self._reduced:
            agree = f"{self._reduced}; {agree}"
        some = self.outcome in (Outcome.AGREE_OF_SOME_ENGINES, Outcome.UNFINISHED)
        return f"AGREE{self._of_engines}" if some else self.outcome, agree

    @property
    def _reduced(self) -> str:
        """Text on elements that would have acted and were not simulated, and on the time until the first
        acts."""
        return reduction(self.acting) if self.acting else ""

    @property
    def _alone(self) -> bool:
        """True if a single engine ran, so that it has only its own checks."""
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
        """Checks that decide the outcome; the verdict counts these."""
        return tuple(row for row in self.checks if row.judged)

    @property
    def _failed(self) -> str:
        """Number of failing checks as text."""
        failed = sum(not row.agrees for row in self.checks)
        if failed:
            return f"{failed} of {len(self.judged)} checks fail"
        wrong = sum(not measured.agrees for measured in self.measured)
        return f"{wrong} of {len(self.measured)} reference values fail"

    @property
    def _qualifications(self) -> str:
        """Qualifications of an agreement: reference values, checks that are not judged, coverage."""
        said = f", and the reference in all {len(self.measured)}" if self.measured else ""
        said += not_judged(self.checks)
        said += "; nothing moves" if self.nothing_moves else ""
        if self.coverage:
            said += f"; {self.coverage}"
        elif len(self.engines) > 1:
            said += "; what the motion covers is not known"
        references = self.mapping.references if self.mapping else []
        if references and not any(reference.tells for reference, _ in references):
            said += "; motions are not verified against the file: no state tells them"
        if self.mapping and (counts := self.mapping.counts()):
            said += f"; of what can act in the file {counts}"
        return said

    def summary(self) -> dict[str, Any]:
        """All figures, versions, settings and wall times, for JSON."""
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
            "engines": {engine.name: self._ran(engine.name) for engine in self.engines},
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
        }

    def _ran(self, name: str) -> dict[str, Any]:
        """Return settings and counts of an engine's run, for JSON."""
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
    """Run a scene through the engines and compare them; `progress` is told each stage.

    What can be compared is compared, whatever stops or fails. Advice takes runs of its own, and is worked out
    if `advised` is set and all came to an end.

    Raises:
        CrosscheckError: for a scene without the outputs that are compared, and where nothing can be: no
            engine runs and no check is had.
        NewtonEulerError: for a scene that no engine can express.
    """
    for output in ("velocities", "reactions", "violation"):
        if output not in scene.outputs:
            raise CrosscheckError(f"scene {scene.name!r} does not ask for the output {output!r}, needed here")
    start = time.perf_counter()
    able, left_out = _able(scene, engines)
    rows: list[Check] = []
    unread: list[Stop] = []
    what = "comparing with the file"
    with collecting_errors(what, unread), limited(what, SHORTER_RUN_ADVICE, progress):
        for row in finite(reading_rows(able, mapping)):
            rows.append(row)  # not all at once: those before an error are kept
    if _misread(able, rows):
        took = time.perf_counter() - start
        noted = (MISREAD,)
        return Crosscheck(
            source, options, scene, tuple(able), left_out, {}, tuple(rows), (), took, mapping, notes=noted
        )
    runs, stops = run_engines(scene, able, progress)
    stopped = {stop.what for stop in stops}
    stops += unread
    beside: list[Stop] = []
    if mapping and runs:
        what = "watching what was left out"
        unseen, mapping = mapping, mapping.unwatched()  # which counts if watching stops
        with collecting_errors(what, beside), limited(what, SHORTER_RUN_ADVICE, progress):
            mapping = watched(scene, unseen, next(iter(runs.values())))
    own_run: Judgement | None = None
    if mapping and mapping.simulation and runs:
        what = "judging the file's own run"
        acting = [Event(entry.since or 0.0, what_acted(entry)) for entry in mapping.acting]
        with collecting_errors(what, beside), limited(what, SHORTER_RUN_ADVICE, progress):
            own_run = judge(mapping.simulation, acting)
    until = mapping.acting[0].since if mapping and mapping.acting else None
    # runs of a motion that the scene does not determine say nothing about each other
    comparable = {} if any(stop.undetermined for stop in stops) else runs
    for what, stage in stages(scene, able, comparable, _random_states(scene), until).items():
        with collecting_errors(what, stops), limited(what, SHORTER_RUN_ADVICE, progress):
            for row in finite(stage(tuple(rows))):
                rows.append(row)
    if not (rows or runs):
        raise CrosscheckError(stops_text(stops))
    rows = in_order(rows)
    measured: list[ReferenceCheck] = []
    known = known_of(source, options)
    for engine in able if known else ():
        if engine.name not in stopped:
            what = f"{engine.name}: reference values"
            with collecting_errors(what, stops), limited(what, SHORTER_RUN_ADVICE, progress):
                measured.extend(measure(source, scene, engine, runs[engine.name], known))
    found: Coverage | None = None
    what = "working out what the motion covers"
    with collecting_errors(what, beside), limited(what, COVERAGE_OMITTED, progress, "coverage_time"):
        found = coverage(scene, comparable, rows)
    singular: SingularConfigurations | None = None
    what = "searching singular configurations"
    with collecting_errors(what, beside), limited(what, SHORTER_RUN_ADVICE, progress):
        singular = find_singular_configurations(scene, next(iter(runs.values()))) if runs else None
    advice: tuple[Advice, ...] = ()
    if advised and not stops:
        what = "working out advice"
        with collecting_errors(what, beside), limited(what, "there is none", progress):
            advice = advise(scene, able, runs, rows)
    run_errors: dict[str, float] = {}
    outlier = {diagnosis.outlier for diagnosis in _diagnosed(scene, able, rows, measured, stops)}
    what = "measuring each engine's error"
    with collecting_errors(what, beside), limited(what, SHORTER_RUN_ADVICE, progress):
        run_errors = measure_run_errors(
            scene, [engine for engine in able if engine.name not in outlier], comparable
        )
    return Crosscheck(
        source,
        options,
        scene,
        tuple(able),
        left_out,
        runs,
        tuple(rows),
        tuple(measured),
        time.perf_counter() - start,
        mapping,
        advice,
        tuple(stops),
        found,
        tuple(map(str, beside)),
        run_errors,
        singular,
        own_run,
    )


def _diagnosed(
    scene: Scene,
    engines: Sequence[Engine],
    checks: Sequence[Check],
    measured: Sequence[ReferenceCheck],
    stops: Sequence[Stop],
) -> tuple[Diagnosis, ...]:
    """Return who differs, see `Crosscheck.diagnosis`; engines that stopped explain nothing by softness."""
    stopped = {stop.what for stop in stops}
    soft = [each.name for each in engines if each.evaluate_soft_constraints and each.name not in stopped]
    names = [each.name for each in engines]
    return diagnose(names, checks, measured, soft, mobility(scene).nearly)


def _misread(engines: Sequence[Engine], rows: Sequence[Check]) -> bool:
    """Return True if every engine's equations of a scene differ from those of the file it was read from."""
    wrong = {row.between[0] for row in rows if row.level == READING and not row.agrees}
    return bool(engines) and wrong >= {engine.name for engine in engines}


def _random_states(scene: Scene) -> int:
    """Number of random consistent states at which the engines' equations are compared."""
    return max(
        MIN_RANDOM_STATES,
        min(MAX_RANDOM_STATES, -(-MIN_SAMPLED_VELOCITIES // max(1, SpanningTree(scene.mechanism).nv))),
    )


def _able(scene: Scene, engines: Sequence[Engine]) -> tuple[list[Engine], dict[str, str]]:
    """The engines that can express a scene, and why the others cannot.

    Those that can make their finer run at most once, for all that it is compared with; where it stops, they
    say whose it was. Their equations of a scene are made once, too.

    Raises:
        NewtonEulerError: the first engine's own where none can.
    """
    able, errors = [], {}
    for engine in engines:
        one = replace(engine, refined=lru_cache(_named(engine)), systems=lru_cache(engine.systems))
        try:
            one.systems(scene)
        except NewtonEulerError as error:
            errors[engine.name] = error
        else:
            able.append(one)
    if not able:
        raise errors[engines[0].name]
    return able, {name: str(error) for name, error in errors.items()}


def _named(engine: Engine) -> Callable[[Scene], Trajectory]:
    """The engine's finer run, with errors that name it."""

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
