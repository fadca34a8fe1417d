"""Result of a comparison of engines: runs, checks, diagnosis, coverage and advice, and the outcome.

A comparison simulates one scene (a mechanism with its forces, inputs and initial state) in several engines.
Checks are grouped in levels: the import of the model file, the equations of motion at single states, then
whole runs. `crosscheck.compare.crosscheck` makes results. `crosscheck.compare.wording` has the verdict in
words, and `crosscheck.report` makes tables and pages of results.

The "own run" is the run of a model file in the file's engine, such as MuJoCo for an MJCF. It has the time
step and the solver settings of the file, and is judged separately, by its error.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

from crosscheck.compare.advice import Advice
from crosscheck.compare.check import READING, Check
from crosscheck.compare.coverage import Coverage
from crosscheck.compare.diagnosis import Diagnosis
from crosscheck.compare.outcome import Outcome
from crosscheck.compare.outlier import diagnose
from crosscheck.compare.participation import Participation, by_runs_only, participation
from crosscheck.compare.reference_values import ReferenceCheck
from crosscheck.compare.runs import nothing_moves_in_rigid_runs
from crosscheck.compare.singularity import SingularConfigurations
from crosscheck.engines.engine import Engine
from crosscheck.engines.engine_runs import Stop
from crosscheck.engines.versions import versions
from crosscheck.library.options import titled
from crosscheck.loading.load import non_default_options
from crosscheck.own_run.allowed import OWN_RUN, AllowedError, ErrorKind, without_loops
from crosscheck.own_run.judge import Judgement
from newton_euler.equations.redundancy import mobility
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.reading.import_report import ImportedElement, ImportReport

if TYPE_CHECKING:  # most comparisons have no logs
    from crosscheck.logs.judge import LogJudgement

JUDGING = "judging the file's own run"
"""Stage that judges the run with the settings of the file; notes on its failure begin with this text."""


@dataclass(frozen=True, eq=False, kw_only=True)
class EngineComparison(ABC):
    """Result of a comparison of engines; `crosscheck.compare.crosscheck.Crosscheck` adds the verdict.

    Attributes:
        source: name or file that the scene was loaded from; empty if it was made in Python.
        options: options of the scene or file that the user set.
        scene: scene that was simulated.
        engines: engines that were compared, in the requested order.
        trajectories: run of each engine; partial if the engine stopped, missing if it has no run at all.
        checks: all checks, except those against reference values.
        wall_time: total wall time, s.
        unfinished: engines that stopped, and parts of the comparison that did not complete.
        notes: one line for each additional analysis that did not complete.
        left_out: engines that cannot represent the scene, with the reason.
        reference_checks: checks against reference values (published or exact results), for scenes of the
            library that have some.
        mapping: import report of the model file: how each element was imported. None for other scenes.
        advice: advice on redundant constraints, if it was requested.
        coverage: elements of the scene that the runs test; None if trajectories were not compared, or if the
            analysis did not complete (then `notes` has the reason).
        run_errors: error of each engine's run, m or rad, see `measure_run_errors`.
        singular: singular configurations of the first engine's run; None if there are none.
        own_run: judgement of the own run of the model file; None for scenes of this package and for files
            without an engine of their own.
        allowed_errors: largest errors that the user allows for the `limited_runs`; empty if they cannot fail.
        logs: judgements of logs (recorded motions of other simulators), by name.
    """

    source: str
    options: Mapping[str, str]
    scene: Scene
    engines: tuple[Engine, ...]
    trajectories: dict[str, Trajectory]
    checks: tuple[Check, ...]
    wall_time: float
    left_out: dict[str, str]
    unfinished: tuple[Stop, ...] = ()
    notes: tuple[str, ...] = ()
    reference_checks: tuple[ReferenceCheck, ...] = ()
    mapping: ImportReport | None = None
    advice: tuple[Advice, ...] = ()
    coverage: Coverage | None = None
    run_errors: Mapping[str, float] = field(default_factory=dict)
    singular: SingularConfigurations | None = None
    own_run: Judgement | None = None
    allowed_errors: tuple[AllowedError, ...] = ()
    logs: Mapping[str, LogJudgement] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """Name of the scene, with the options that the user set."""
        return titled(self.scene.name, non_default_options(self.options))

    @property
    @abstractmethod
    def verdict(self) -> str:
        """Verdict in one line."""

    @property
    def agrees(self) -> bool:
        """True if the comparison was completed, found no difference, and covers all elements that act."""
        return self.outcome is Outcome.AGREE

    @property
    def differs(self) -> bool:
        """True if any check exceeds its tolerance, those against reference values included."""
        return not all(check.agrees for check in (*self.checks, *self.reference_checks))

    @property
    def judged(self) -> tuple[Check, ...]:
        """Checks that decide the outcome; the verdict states their number."""
        return tuple(check for check in self.checks if check.judged)

    @cached_property
    def participation(self) -> dict[str, Participation]:
        """Numbers of checks that each engine takes part in, and the levels without it, by engine."""
        return participation([engine.name for engine in self.engines], self.checks)

    @property
    def uncompared(self) -> tuple[str, ...]:
        """Engines that are compared with others, but by no check that is judged."""
        parts = self.participation.items()
        return tuple(name for name, part in parts if part.not_judged and not part.with_engines)

    @property
    def by_runs_only(self) -> tuple[str, ...]:
        """Engines whose equations of motion were not compared."""
        return by_runs_only([engine.name for engine in self.engines], self.checks)

    @property
    def nothing_moves(self) -> bool:
        """True if nothing moves in the runs, so that checks of runs test nothing."""
        return nothing_moves_in_rigid_runs(self.scene, self.engines, self.trajectories)

    @property
    def outcome(self) -> Outcome:
        """Outcome of the comparison; if several apply, the most severe one."""
        if self.unfinished:
            return Outcome.UNFINISHED
        if self.differs:
            return Outcome.DISAGREE
        if self.exceeded:
            return Outcome.INACCURATE
        if self.left_out or self.uncompared:
            compared = len(self.engines) - len(self.uncompared)
            return Outcome.AGREE_OF_SOME_ENGINES if compared > 1 else Outcome.NOT_COMPARED
        if self.single_engine:
            return Outcome.ONE_ENGINE_ALONE
        if self.is_reduced:
            return Outcome.AGREE_ON_A_REDUCED_MODEL
        if self.untested:
            return Outcome.AGREE_AT_RANDOM_STATES_ONLY
        return Outcome.AGREE

    @property
    def limited_runs(self) -> Mapping[str, Judgement]:
        """Judged runs whose errors the user can limit, by name: the logs; without logs, the own run."""
        return self.logs or ({OWN_RUN: self.own_run} if self.own_run else {})

    def limits_of(self, name: str) -> Sequence[AllowedError]:
        """Return the allowed errors of `OWN_RUN` or of a log, without kinds that the run leaves open."""
        if name not in self.limited_runs:
            return () if self.logs else self.allowed_errors
        undetermined = self._undetermined(name)
        return [each for each in self.allowed_errors if each.kind not in undetermined]

    def _undetermined(self, name: str) -> Mapping[ErrorKind, str]:
        """Return the errors that one of the `limited_runs` does not determine, with the reason."""
        return (
            self.logs[name].undetermined
            if name in self.logs
            else without_loops(self.limited_runs[name].loop_error)
        )

    @property
    def exceeded(self) -> dict[str, list[AllowedError]]:
        """Allowed errors that runs exceed, by name of the run."""
        found = {
            name: [allowed for allowed in self.limits_of(name) if allowed.is_exceeded_by(run)]
            for name, run in self.limited_runs.items()
        }
        return {name: exceeded for name, exceeded in found.items() if exceeded}

    def with_allowed_errors(self, allowed: Sequence[AllowedError]) -> Self:
        """Return this result with largest errors that the `limited_runs` may have.

        The result is unfinished if the own run, or its end, is not judged although the engines agree. It is
        also unfinished if a run has no loops or a log no columns for an error, if the reference stops before
        the log ends, or if no output of a run is compared.
        """
        stops = self.unfinished
        for name, run in self.limited_runs.items():
            undetermined = self._undetermined(name)
            reasons = [undetermined[each.kind] for each in allowed if each.kind in undetermined]
            if allowed and not (run.judged or run.stopped):
                reasons.append(f"not judged: {run.why_not_judged}")
            stops = (*stops, *(Stop(name, reason) for reason in dict.fromkeys(reasons)))
        if self.logs:
            for name, log in self.logs.items():
                if allowed and log.unjudged_from is not None:
                    end = f"not judged from {log.unjudged_from:.3g} s on"
                    stops = (*stops, Stop(name, f"{end}, as the reference stops: {log.reference_stop}"))
            return replace(self, allowed_errors=tuple(allowed), unfinished=stops)
        if allowed and self.own_run is None and not self.differs:
            needed = "not judged, as the scene has no run of its own; needed: an MJCF or URDF model"
            reason = next((note for note in self.notes if note.startswith(JUDGING)), needed)
            stops = (*stops, Stop(OWN_RUN, reason.removeprefix(f"{JUDGING}: ")))
        if allowed and self.own_run and self.own_run.unjudged_from is not None:
            end = f"not judged from {self.own_run.unjudged_from:.3g} s on, as the run has too many time steps"
            stops = (*stops, Stop(OWN_RUN, f"{end}; needed: a shorter --set duration"))
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

        The elements act in the compared motion, or in a run whose errors the user limits.
        """
        limited = self.limited_runs.values() if self.allowed_errors else ()
        return bool(self.acting or any(run.events for run in limited))

    @property
    def until(self) -> float | None:
        """Time, s, at which the first element of `acting` would have acted; None if there is none."""
        return self.acting[0].since if self.acting else None

    @property
    def misread(self) -> bool:
        """True if the equations of all engines differ from the model file, so the import is wrong."""
        return misread(self.checks)

    @cached_property
    def diagnosis(self) -> tuple[Diagnosis, ...]:
        """Outliers, at the first level with a difference and then among the remaining engines."""
        return diagnosed(self.scene, self.engines, self.checks, self.reference_checks, self.unfinished)

    @property
    def single_engine(self) -> bool:
        """True if there is only one engine, and nothing that it was compared with differs.

        The engine may have been compared with the model file, its formulations with each other, and its run
        with reference values.
        """
        # `between`: the compared names, such as two engines; one name for a check such as energy balance
        pairs_agree = all(check.agrees for check in self.checks if len(check.between) > 1)
        references_agree = all(check.agrees for check in self.reference_checks)
        return len(self.engines) == 1 and pairs_agree and references_agree

    def summary(self) -> dict[str, Any]:
        """All checks, versions, settings, wall times and judgements, for JSON.

        Of the import report: `findings` are likely mistakes in the file, `start` has lines of text about the
        initial state, `moved_start` and `changed_velocities` are its changes that satisfy the constraints.
        """
        return {
            "scene": self.scene.name,
            "source": self.source,
            "options": dict(self.options),
            "agrees": self.agrees,
            "outcome": self.outcome.value,
            "verdict": self.verdict,
            "wall_time": self.wall_time,
            "versions": versions(self.engines, ("numpy", "scipy", "rerun-sdk")),
            "unfinished": [asdict(stop) for stop in self.unfinished],
            "engines": {engine.name: self._engine_summary(engine.name) for engine in self.engines},
            "checks": [asdict(check) | {"agrees": check.agrees} for check in self.checks],
            "notes": list(self.notes),
            "not_simulated": [asdict(entry) for entry in self.acting],
            "as_in_the_file_until": self.until,
            "diagnosis": [diagnosis.summary() for diagnosis in self.diagnosis],
            "left_out": self.left_out,
            "mapping": [asdict(entry) for entry in self.mapping.entries] if self.mapping else None,
            "findings": [asdict(each) for each in self.mapping.findings] if self.mapping else None,
            "start": self.mapping.start if self.mapping else None,
            "moved_start": asdict(moved) if self.mapping and (moved := self.mapping.moved) else None,
            "changed_velocities": asdict(changed)
            if self.mapping and (changed := self.mapping.changed_velocities)
            else None,
            "known_values": [check.summary() for check in self.reference_checks],
            "advice": [asdict(advice) for advice in self.advice],
            "coverage": self.coverage.summary() if self.coverage else None,
            "singular": asdict(self.singular) if self.singular else None,
            "own_run": self.own_run.summary() if self.own_run else None,
            "logs": {name: judgement.summary() for name, judgement in self.logs.items()},
            "allowed_errors": [
                {
                    "kind": each.kind.value,
                    "largest": each.largest,
                    "exceeded": any(each in exceeded for exceeded in self.exceeded.values()),
                }
                for each in self.allowed_errors
            ],
        }

    def _engine_summary(self, name: str) -> dict[str, Any]:
        """Return settings, wall time and error of an engine's run, and its checks by number, for JSON."""
        run = self.trajectories.get(name)
        return {
            "settings": run.settings if run else {},
            "wall_time": run.wall_time if run else None,
            "error": self.run_errors.get(name),
            "checks": self.participation[name]._asdict(),
        }


def diagnosed(
    scene: Scene,
    engines: Sequence[Engine],
    checks: Sequence[Check],
    reference_checks: Sequence[ReferenceCheck],
    stops: Sequence[Stop],
) -> tuple[Diagnosis, ...]:
    """Make the diagnosis, see `EngineComparison.diagnosis`; the other arguments are attributes of the result.

    Soft constraints do not explain differences of an engine that stopped.
    """
    names = [each.name for each in engines]
    ends = {stop.what: stop.time or 0.0 for stop in stops if stop.what in names}
    return diagnose(
        names,
        checks,
        reference_checks,
        soft_engines={
            each.name: each.soft_constraints.smallest_resisted
            for each in engines
            if each.soft_constraints and each.name not in ends
        },
        nearly_redundant=mobility(scene).nearly,
        without_equations=by_runs_only(names, checks),
        ends=ends,
    )


def misread(checks: Sequence[Check]) -> bool:
    """Return True if the equations of every engine that has some differ from those of the model file."""
    # `between` is an engine and the file at this level
    of_file = [check for check in checks if check.level == READING]
    differing = {check.between[0] for check in of_file if not check.agrees}
    return bool(of_file) and differing == {check.between[0] for check in of_file}
