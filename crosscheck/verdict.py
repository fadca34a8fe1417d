"""Crosschecks from Python: `crosscheck.check(model)` and what it found."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from crosscheck.compare.check import Check
from crosscheck.compare.crosscheck import Crosscheck, crosscheck
from crosscheck.compare.diagnosis import Diagnosis
from crosscheck.engines.engine import ENGINES, choose
from crosscheck.loading.load import load_scene, with_excitation
from crosscheck.report.outcome import Outcome
from crosscheck.report.output import own_name, to_record, write
from crosscheck.report.page import rendered
from crosscheck.report.render import terminal, wrapped
from crosscheck.report.run import report
from crosscheck.report.table import Report
from crosscheck.support.files import check_writable, path_of
from newton_euler.arguments import checked
from newton_euler.errors import items_of
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Floats

if TYPE_CHECKING:
    from crosscheck.loading.load import Model


@dataclass(frozen=True, eq=False)
class Verdict:
    """The result of a crosscheck.

    Attributes:
        crosscheck: all of it.

    Examples:
        >>> def worst(of: Verdict) -> float:
        ...     return max(each.value / each.tolerance for each in of.judged)
        >>> verdict = check("pendulum")
        >>> verdict.agrees, worst(verdict) <= 1.0
        (True, True)
        >>> f"in all {len(verdict.judged)} checks" in repr(verdict)
        True
        >>> verdict.trajectories["mujoco"].position.shape
        (1001, 2, 3)
    """

    crosscheck: Crosscheck

    @property
    def agrees(self) -> bool:
        """True for the outcome `AGREE` alone: checks passed, and all that acted was simulated and tested."""
        return self.crosscheck.agrees

    @property
    def outcome(self) -> Outcome:
        """The outcome of the crosscheck, one of a closed set."""
        return self.crosscheck.outcome

    @property
    def checks(self) -> tuple[Check, ...]:
        """All checks: `judged` ones, and checks without a verdict."""
        return self.crosscheck.checks

    @property
    def judged(self) -> tuple[Check, ...]:
        """Checks that decide the outcome; the verdict reports their number."""
        return self.crosscheck.judged

    @property
    def trajectories(self) -> Mapping[str, Trajectory]:
        """The run of each engine, as far as it came."""
        return self.crosscheck.trajectories

    @property
    def diagnosis(self) -> tuple[Diagnosis, ...]:
        """Engines that differ, at which level and where; empty if none does."""
        return self.crosscheck.diagnosis

    @cached_property
    def report(self) -> Report:
        """Tables of all checks, settings and notes."""
        return report(self.crosscheck)

    def __repr__(self) -> str:
        return f"<{self.crosscheck.verdict}>"

    def __str__(self) -> str:
        head = f"{wrapped(self.report.title)}\n{wrapped(self.report.verdict)}"
        return f"{head}\n\n{terminal(self.report.summary)}"

    def _repr_html_(self) -> str:
        return rendered("summary.html", report=self.report)

    @checked
    def assert_agrees(self, allow_reduced: bool = False) -> None:
        """Raise `AssertionError`, with the verdict and the worst figure of each level, unless all agree.

        Args:
            allow_reduced: whether the model may be reduced: elements of its file may act without being
                simulated (contacts, limits of joints, dry friction).
        """
        if not self.outcome.passes(allow_reduced):
            raise AssertionError(str(self))

    @checked
    def save(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Write trajectories, figures and the recording, as `crosscheck run --output FOLDER`.

        Returns:
            The files.

        Raises:
            CrosscheckError: naming a path that cannot be written.
        """
        name = own_name(self.crosscheck.source or self.crosscheck.scene.name)
        path = path_of(folder)
        recording = path / f"{name}.rrd"
        check_writable(recording)
        return write(self.crosscheck, self.report, path, recording, name)

    def show(self) -> None:
        """Open the recording in the Rerun viewer, in a notebook below the cell."""
        from crosscheck.recording.log import log_run
        from crosscheck.recording.show import show

        show(log_run, *to_record(self.crosscheck, self.report))


@checked
def check(
    model: Model,
    engines: Sequence[str] = tuple(ENGINES),
    *,
    advice: bool = False,
    progress: Callable[[str], None] = lambda stage: None,
    **options: str | float | Sequence[float] | Floats,
) -> Verdict:
    """Run a model through the engines and compare them.

    Args:
        model: a scene of the library by name, a scene file, an MJCF, a URDF, a `Scene`, an `MjSpec` or an
            `MjModel` of MuJoCo, or a `Model` of Pinocchio, alone or paired with its constraints, see
            `urdf.read`.
        engines: by name. One that cannot express the model is left out, and then they do not agree.
        advice: whether to work out what to do about what is found, by more runs.
        progress: is told each stage.
        options: of the scene or the file, as `crosscheck list` shows them; `q`, a configuration, of a
            `Model`.

    Raises:
        CrosscheckError, NewtonEulerError: for a model, engine or option that does not exist or cannot be run.

    Examples:
        >>> check("chain", engines=["newton_euler", "pinocchio"], N=3).agrees
        True
    """
    chosen = choose(list(engines))
    texts = {name: _text(value) for name, value in options.items()}
    source = os.fspath(model) if isinstance(model, str | os.PathLike) else ""
    taken = with_excitation(model, texts)
    scene, mapping = load_scene(model, taken, verified=False)
    return Verdict(crosscheck(scene, chosen, progress, source, taken, mapping, advice))


def _text(value: str | float | Sequence[float] | Floats) -> str:
    """Return an option as a command takes it, numbers with all their digits."""
    numbers = items_of(value)
    return str(value) if numbers is None else ",".join(map(str, np.asarray(numbers).tolist()))
