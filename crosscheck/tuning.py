"""Python interface of `crosscheck tune`: `crosscheck.tune(model, error)` returns a `Tuning`.

The settings are time step, integrator, solver and softness of loop constraints. The engine of an MJCF is
MuJoCo; that of a URDF is a loop of time steps that calls Pinocchio. `crosscheck.own_run.tune` has the search.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from crosscheck.compare.tuning import target_of, tune_model, with_engine
from crosscheck.loading.load import OptionValue, load_scene, option_texts, with_excitation
from crosscheck.own_run.tune import SettingsSearch, Tried
from crosscheck.report.shown import Shown
from crosscheck.report.table import Report
from crosscheck.report.tuning import report
from newton_euler.arguments import checked

if TYPE_CHECKING:
    from crosscheck.loading.load import Model


@dataclass(frozen=True, eq=False, repr=False)
class Tuning(Shown):
    """The cheapest settings with which the engine of a model reaches an error.

    Attributes:
        model: name of the model.
        search: the complete result of the search.

    Examples:
        >>> tuning: Tuning = tune("examples/linkage.xml", 0.01, key="go", excitation="off")
        >>> repr(tuning).startswith('<REACHED: timestep="0.016" integrator="RK4"')
        True
    """

    model: str
    search: SettingsSearch

    @property
    def found(self) -> Tried | None:
        """The cheapest settings that reach the error; None if no tried settings do.

        `fragment` is text to paste into the model file, `changes` has the changed settings by name,
        `error.relative` is the error, and `run_time` the run time relative to that of the model's settings.
        """
        return self.search.found

    @property
    def own(self) -> Tried:
        """Error and cost of the run with the settings of the model."""
        return self.search.own

    @property
    def tradeoff(self) -> tuple[Tried, ...]:
        """Settings with smaller errors than all cheaper ones, from cheap to accurate; `found` is the last."""
        return self.search.tradeoff

    @cached_property
    def report(self) -> Report:
        """Table of settings with error and cost, notes, and the text to paste."""
        return report(self.model, self.search)


@checked
def tune(
    model: Model,
    error: float | str = 1e-3,
    *,
    progress: Callable[[str], None] = lambda stage: None,
    **options: OptionValue,
) -> Tuning:
    """Find the cheapest settings with which the engine of a model reaches an error.

    A number is the largest error of a position or an orientation, as a part of the motion; `check` judges
    runs by the same error. The motion is that of `check`: models are excited unless `excitation` is "off".

    Args:
        model: path of an MJCF or URDF, an `MjSpec` or `MjModel` of MuJoCo, or a `Model` of Pinocchio. A
            `Model` may be paired with its constraints, see `urdf.read`.
        error: error to reach, a fraction of the motion, or a text such as "position=1mm" as in
            `crosscheck run --max-error`.
        progress: function that is called with a message before each run.
        options: options of the model, as `crosscheck list` shows them. For a URDF and a `Model`, `own_run`
            has the settings of your loop.

    Returns:
        The found settings, and those of the model, with errors and costs.

    Raises:
        CrosscheckError, NewtonEulerError: for a model or option that cannot be used, or a model without an
            engine of its own.

    Examples:
        >>> tuning = tune("examples/linkage.xml", 1e-3, key="go", excitation="off")
        >>> if tuning.found:
        ...     print(tuning.found.fragment)
        <option timestep="0.008" integrator="RK4"/>
        <default><equality solref="0.016 1" solimp="0.9999 0.9999 0.001"/></default>
    """
    target = target_of(error, "error")
    scene, import_report = load_scene(model, with_excitation(model, option_texts(options)))
    source = os.fspath(model) if isinstance(model, str | os.PathLike) else scene.name
    return Tuning(scene.name, tune_model(scene, with_engine(source, import_report), target, progress))
