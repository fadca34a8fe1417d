"""Python interface of crosschecks: `crosscheck.check(model)` returns a `Verdict`.

A crosscheck simulates one model in several engines and compares them. The `Verdict` has the outcome, all
checks, the trajectories and the report; the command `crosscheck run` prints the same report.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any

from crosscheck.compare.check import Check
from crosscheck.compare.crosscheck import Crosscheck, crosscheck
from crosscheck.compare.diagnosis import Diagnosis
from crosscheck.compare.logs import judge_logs
from crosscheck.compare.outcome import Outcome
from crosscheck.engines.registry import ENGINES, choose
from crosscheck.loading.load import OptionValue, load_scene, option_texts, with_excitation
from crosscheck.logs.judge import LogJudgement
from crosscheck.own_run.allowed import AllowedError, ErrorKind
from crosscheck.own_run.errors import ACCURATE_BELOW
from crosscheck.own_run.judge import Judgement
from crosscheck.report.output import results_name, to_record, write
from crosscheck.report.run import report
from crosscheck.report.shown import Shown
from crosscheck.report.table import Report
from crosscheck.support.files import check_writable, path_of
from newton_euler.arguments import UNCHECKED, checked
from newton_euler.model.trajectory import Trajectory

if TYPE_CHECKING:
    from crosscheck.loading.load import Model


@dataclass(frozen=True, eq=False)
class Verdict(Shown):
    """Result of a crosscheck: outcome, checks, trajectories and report. `print(verdict)` prints the report.

    Attributes:
        crosscheck: the complete result, for programs that need more than the properties below.

    Examples:
        >>> verdict: Verdict = check("pendulum")
        >>> print(verdict.outcome, len(verdict.judged))
        AGREE 105
        >>> angle = verdict.trajectories["mujoco"].joint("pivot").coordinates[-1, 0]
        >>> f"{angle:.3f} rad after 10 s"
        '1.292 rad after 10 s'
    """

    crosscheck: Crosscheck

    @property
    def agrees(self) -> bool:
        """True for the outcome `AGREE` only: all checks passed, and all elements that act were simulated."""
        return self.crosscheck.agrees

    @property
    def outcome(self) -> Outcome:
        """Outcome of the crosscheck, such as `AGREE` or `DISAGREE`."""
        return self.crosscheck.outcome

    @property
    def checks(self) -> tuple[Check, ...]:
        """All checks, also those that are not judged (they can neither pass nor fail)."""
        return self.crosscheck.checks

    @property
    def judged(self) -> tuple[Check, ...]:
        """Checks that decide the outcome; the text of the verdict states their number."""
        return self.crosscheck.judged

    @property
    def trajectories(self) -> Mapping[str, Trajectory]:
        """Run of each engine, by the engine's name; partial if the engine stopped."""
        return self.crosscheck.trajectories

    @property
    def logs(self) -> Mapping[str, LogJudgement]:
        """Judgements of the runs of other simulators, by name; `error.relative` is the relative error."""
        return self.crosscheck.logs

    @property
    def diagnosis(self) -> tuple[Diagnosis, ...]:
        """Outliers: the engines that are likely wrong, with level (group of checks) and place; empty if all
        engines agree."""
        return self.crosscheck.diagnosis

    @property
    def own_run(self) -> Judgement | None:
        """Judgement of the run that the model's own engine makes with the user's settings.

        The judgement has the error, its causes, and settings that reduce it. It is None for scenes that are
        not read from an MJCF or URDF model, and if the judgement did not complete (the report has the reason
        in a note).
        """
        return self.crosscheck.own_run

    @cached_property
    def report(self) -> Report:
        """Tables of all checks, settings and notes."""
        return report(self.crosscheck)

    def __repr__(self) -> str:
        return f"<{self.crosscheck.verdict}>"

    @checked
    def assert_agrees(self, allow_reduced: bool = False) -> None:
        """Raise `AssertionError`, with verdict and worst check of each level, unless all engines agree.

        Args:
            allow_reduced: True to accept a model with elements that act and are not simulated.

        Raises:
            AssertionError: if an engine differs, stops or cannot represent the model.
        """
        if not self.outcome.passes(allow_reduced):
            raise AssertionError(str(self))

    @checked
    def assert_accurate(
        self,
        max_error: float | None = ACCURATE_BELOW,
        *,
        position: float | None = None,
        rotation: float | None = None,
        opening: float | None = None,
        loop_angle: float | None = None,
        energy: float | None = None,
        allow_reduced: bool = False,
    ) -> None:
        """Raise `AssertionError` if the run with the settings of the model has a larger error than allowed.

        Runs of other simulators that `check` was given are limited instead. The message has the errors, the
        causes, and settings with a smaller error. `crosscheck run --max-error` makes the same checks.

        Args:
            max_error: largest relative error, a fraction of the motion; 0.001 (0.1 %) if not given, None for
                no limit.
            position: largest error of a center of mass, m.
            rotation: largest error of an orientation, rad.
            opening: largest distance between the ends of a loop constraint, m.
            loop_angle: largest violation of a loop constraint of angles, rad.
            energy: largest error of the total energy, a fraction of the energy that the motion exchanges.
            allow_reduced: True to accept a model of which some elements (contacts, joint limits, dry
                friction) act but are not simulated by the reference, newton_euler. The limits hold for the
                run until the first of them acts, and for the run without these elements.

        Raises:
            AssertionError: if an error is too large, if the engines disagree, or if the run is not judged.
            CrosscheckError: for a limit that is no positive number.
        """
        limits = {
            ErrorKind.RELATIVE: max_error,
            ErrorKind.POSITION: position,
            ErrorKind.ROTATION: rotation,
            ErrorKind.OPENING: opening,
            ErrorKind.LOOP_ANGLE: loop_angle,
            ErrorKind.ENERGY: energy,
        }
        allowed = [AllowedError(kind, limit) for kind, limit in limits.items() if limit is not None]
        judged = self.crosscheck.with_allowed_errors(allowed)
        reduced = judged.is_reduced and not allow_reduced
        if judged.unfinished or judged.differs or judged.exceeded or reduced:
            raise AssertionError(str(Verdict(judged)))

    @checked
    def save(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Write trajectories, plots and the recording, as `crosscheck run --output FOLDER` does.

        Args:
            folder: folder to write to; it is created if it does not exist.

        Returns:
            Paths of the written files.

        Raises:
            CrosscheckError: naming a path that cannot be written.
        """
        name = results_name(self.crosscheck.source or self.crosscheck.scene.name)
        path = path_of(folder)
        recording = path / f"{name}.rrd"
        check_writable(recording)
        return write(self.crosscheck, self.report, path, recording, name)

    def show(self) -> None:
        """Open a recording of the runs in the Rerun viewer; in a notebook, it appears below the cell."""
        from crosscheck.recording.log import log_run
        from crosscheck.recording.show import show

        show(log_run, *to_record(self.crosscheck, self.report))


@checked
def check(
    model: Model,
    engines: Sequence[str] = tuple(ENGINES),
    *,
    advice: bool = False,
    runs: Annotated[Mapping[str, Any], UNCHECKED] = MappingProxyType({}),
    progress: Callable[[str], None] = lambda stage: None,
    **options: OptionValue,
) -> Verdict:
    """Simulate a model in several engines and compare them.

    Args:
        model: name of a scene of the library, path of a scene file, MJCF or URDF, or an object: a `Scene`, an
            `MjSpec` or `MjModel` of MuJoCo, or a `Model` of Pinocchio. A `Model` may be paired with its
            constraints, see `urdf.read`.
        engines: names of the engines, by default "newton_euler", "mujoco" and "pinocchio". If an engine
            cannot represent the model, the best outcome is `AGREE OF SOME ENGINES`.
        advice: True to compute advice on redundant constraints.
        runs: runs of other simulators by name. Each is compared with a run of newton_euler from the same
            initial state. A run is a CSV or Parquet file, a DataFrame, a mapping of columns, or a `Log` of
            these with options. It may also be a function from a `State` and times (n,), s, to n states.
        progress: function that is called with a message before each stage.
        options: options of the scene or file by name, such as `N=3` of "chain" or `duration=2`; `crosscheck
            list` shows them. For a `Model`, `q` is the configuration from which the run starts.

    Returns:
        The verdict.

    Raises:
        CrosscheckError, NewtonEulerError: for a model, engine or option that does not exist or cannot be run.

    Examples:
        >>> check("chain", engines=["newton_euler", "pinocchio"], N=3).agrees
        True
    """
    chosen = choose(list(engines))
    texts = option_texts(options)
    source = os.fspath(model) if isinstance(model, str | os.PathLike) else ""
    # by default, models from other tools start in motion, with driven actuators: a model at rest tests little
    scene_options = with_excitation(model, texts)
    logs = judge_logs(model, texts, runs, progress)
    # `crosscheck` compares the scene with the file; no need to verify it here
    scene, import_report = load_scene(model, scene_options, verified=False)
    found = crosscheck(scene, chosen, progress, source, scene_options, import_report, advice)
    return Verdict(replace(found, logs=logs))
