"""Run Monte Carlo and design-of-experiments studies from Python: `sweep`, and its result, a `Sweep`.

A sweep simulates one scene many times with varied parameters, and keeps some outputs of each run. Its report
has quantiles of these outputs and the effects of the parameters on them. `Sweep.check` repeats some runs in
all engines, such as MuJoCo, and compares them.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack, cast

import numpy as np

from crosscheck.engines.registry import ENGINES, choose
from crosscheck.loading.load import load_scene, with_excitation
from crosscheck.report.output import results_name
from crosscheck.report.render import terminal
from crosscheck.report.run import moved_start_lines
from crosscheck.report.shown import Shown
from crosscheck.report.table import Report
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.files import path_of
from crosscheck.sweeps.checks import CheckedRun, check_runs, chosen, default_count
from crosscheck.sweeps.distributions import Vary
from crosscheck.sweeps.execute import workers
from crosscheck.sweeps.findings import Findings, findings
from crosscheck.sweeps.kept_numbers import kept_numbers, most_informative
from crosscheck.sweeps.output import to_record, write
from crosscheck.sweeps.plan import SweepPlan
from crosscheck.sweeps.reductions import Keep, reductions
from crosscheck.sweeps.report import report
from crosscheck.sweeps.results import SweepResults, check_names, results_of
from crosscheck.sweeps.sampling import SamplingName, samples_of
from crosscheck.sweeps.store import libraries
from newton_euler.arguments import checked
from newton_euler.equations.redundancy import mobility
from newton_euler.errors import OptionError, check_choices, is_count
from newton_euler.integrators.options import IntegratorName, Options, StepControl
from newton_euler.model.scene import OUTPUTS, Scene
from newton_euler.reading.import_report import ImportReport
from newton_euler.runs.simulate import warn_of

if TYPE_CHECKING:
    from distributed import Client

    from crosscheck.loading.load import Model


class Execution(StepControl, total=False):
    """Options of `sweep`, described there: integrator and steps, where the runs execute, and progress."""

    integrator: IntegratorName
    threads: int | None
    executor: Executor | None
    cluster: Client | str | None
    progress: Callable[[str], None]


ATOL_PER_RTOL = 0.01
"""Default ratio of the absolute (SI) and the relative tolerance, the same as in `newton_euler`."""


def _control(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the complete integrator settings, with default values of settings that are not given.

    Settings are the integrator, its fixed step, s, or its tolerances `rtol` and `atol`, and the largest
    number of steps. `rest` are the rates below which a mechanism counts as at rest. Those that are None or 0
    are left out.
    """
    method = given.get("integrator", Options.integrator)
    steps = cast(StepControl, {name: value for name, value in given.items() if name != "integrator"})
    options = Options.of(method, steps)
    settings = {"integrator": method, "step": options.step, "most_steps": options.most_steps}
    if options.step is None:
        settings |= {
            "rtol": options.rtol,
            "atol": given.get("atol", ATOL_PER_RTOL * options.rtol),
            "rest": options.rest,
        }
    # Python numbers, since the record of a sweep is JSON
    return {name: np.asarray(value).item() for name, value in settings.items() if value}


@dataclass(frozen=True, eq=False)
class Sweep(Shown):
    """Result of a sweep.

    Attributes:
        results: plan of the sweep, its runs, and their store.
        checks: crosschecks of some runs.
        options: options of the scene or model file.
        mapping: import report of a model file, which lists how each of its elements was imported; None for
            other scenes.

    Examples:
        >>> swept = sweep("pendulum", {"dumbbell.mass": "normal(1, 0.1)"}, 100, "peak:reaction_force")
        >>> mean = swept.dataset["peak:reaction_force"].sel(joint="pivot").mean()
        >>> print(float(mean.round(1)), "N")
        16.4 N
        >>> checked: Sweep = swept.check(1)
        >>> print(checked.findings.outcome)
        AGREE
    """

    results: SweepResults
    checks: tuple[CheckedRun, ...] = ()
    options: Mapping[str, str] = field(default_factory=dict)
    mapping: ImportReport | None = None

    def __repr__(self) -> str:
        plan = self.results.plan
        varied = f"{len(plan.samples.names)} varied by {plan.samples.sampling}"
        kept = ", ".join(each.name for each in plan.kept)
        return f"<Sweep of {plan.scene.name!r}: {plan.samples.runs} runs, {varied}; kept: {kept}>"

    def __str__(self) -> str:
        return f"{self.report.title}\n{self.report.verdict}\n\n{terminal(self.report.summary)}"

    @property
    def dataset(self) -> Any:
        """xarray Dataset of varied parameters and kept outputs by run; read from disk on access."""
        return self.results.dataset

    @cached_property
    def errors(self) -> Mapping[int, str]:
        """Reasons of failed runs, by number of the run."""
        return dict(self.results.reasons())

    @cached_property
    def findings(self) -> Findings:
        """Analysis of the sweep: quantiles of kept outputs, and effects of the parameters on them."""
        start = start_lines(self.mapping, self.results.plan.scene)
        return findings(self.results, self.checks, self.options, start)

    @cached_property
    def report(self) -> Report:
        """Report with the tables of the findings."""
        return report(self.findings)

    @checked
    def check(
        self,
        runs: int | None = None,
        engines: Sequence[str] = tuple(ENGINES),
        progress: Callable[[str], None] = lambda stage: None,
    ) -> Sweep:
        """Cross-check some extreme runs and some random runs.

        Args:
            runs: number of runs to cross-check; if None, one per 1,000 runs of the sweep, at least 2 and at
                most 6.
            engines: names of the engines.
            progress: called with the name of each stage.

        Returns:
            The sweep with these crosschecks.

        Raises:
            CrosscheckError: for an unknown engine.
            OptionError: for an invalid number of runs.
        """
        count = default_count(self.results.plan.samples.runs) if runs is None else runs
        if not is_count(count):
            raise OptionError("runs", runs, "a whole number, 1 or more")
        found = kept_numbers(self.results)
        # extreme runs of those kept numbers that vary most, and random runs
        picked = chosen(self.results, found, most_informative(found), count)
        checked = check_runs(self.results, found, picked, choose(list(engines)), progress, self.mapping)
        return replace(self, checks=tuple(checked))

    @checked
    def save(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Write the findings, plots and a Rerun recording, as `crosscheck sweep --output FOLDER` does.

        Args:
            folder: folder of the files.

        Returns:
            Paths of the files.

        Raises:
            CrosscheckError: naming a path that cannot be written.
        """
        return write(self.findings, self.report, path_of(folder))

    def show(self) -> None:
        """Show quantiles over time, and some runs, in the Rerun viewer; in a notebook, below the cell.

        The runs are that with the scene's own values (nominal run) and those with the largest and smallest
        kept outputs (extreme runs).

        Raises:
            CrosscheckError: if all these runs failed.
        """
        from crosscheck.recording.show import show
        from crosscheck.sweeps.recording import log_sweep

        to_log = to_record(self.findings, self.report)
        if not to_log.runs:
            raise CrosscheckError("nothing to show: the nominal run and the extreme runs failed")
        show(log_sweep, *to_log)


def named_after_file(model: Model, scene: Scene) -> Scene:
    """Return a scene under the name of the file that it was loaded from; the name in the file may differ.

    Args:
        model: what the user gave: a scene, a path, or the name of a library scene.
        scene: the loaded scene.
    """
    if isinstance(model, Scene) or not isinstance(model, str | os.PathLike):
        return scene
    return replace(scene, name=results_name(os.fspath(model)))


def start_lines(mapping: ImportReport | None, scene: Scene) -> tuple[str, ...]:
    """Return lines about the excitation of a model file, and about an initial pose that differs from the
    file's."""
    if mapping is None:
        return ()
    return (*filter(None, [mapping.excitation]), *moved_start_lines(mapping, scene))


@checked
def sweep(
    scene: Model,
    vary: Vary,
    runs: int | None = None,
    keep: Keep = (),
    *,
    sampling: SamplingName = "random",
    seed: int = 0,
    output: str | os.PathLike[str] | None = None,
    **options: Unpack[Execution],
) -> Sweep:
    """Run a Monte Carlo or design-of-experiments study: vary parameters, and keep outputs of each run.

    Args:
        scene: scene, name of a library scene, or scene or model file, as of `crosscheck.check`. Model files
            are excited: their joints start with small velocities, and sinusoidal inputs drive their
            actuators.
        vary: distributions by parameter name, see `newton_euler.equations.parameters`: texts such as
            "normal(14, 0.5)", or a list of equally likely numbers.
        runs: number of runs; None for all combinations of a grid, and only for these.
        keep: outputs of each run, for example "peak:reaction_force, final:panel_7.quaternion"; a text, a list
            of texts, or a mapping from names to texts.
        sampling: "random", "latin_hypercube", "sobol", "saltelli" (for Sobol indices; `runs` is a power of 2
            times the number of parameters plus 2) or "grid".
        seed: seed of all random numbers.
        output: folder on disk, where an interrupted sweep resumes; None to keep the results in memory.
        options: `threads`, `executor` (of concurrent.futures) or `cluster` (a Dask client or its address), on
            which the runs execute; `progress`, called with the name of each stage; `integrator`, `rtol`,
            `atol` (0.01 `rtol` by default), `step`, `most_steps` and `rest` as of `newton_euler.simulate`.

    Raises:
        CrosscheckError, NewtonEulerError: for an unknown name, an invalid plan, a folder with another sweep,
            a cluster that does not answer, and a full disk.

    Examples:
        >>> swept = sweep("pendulum", {"dumbbell.mass": "normal(1, 0.1)"}, 8, "peak:reaction_force")
        >>> swept
        <Sweep of 'pendulum': 8 runs, 1 varied by random; kept: peak:reaction_force>
        >>> swept.dataset["peak:reaction_force"].dims
        ('run', 'joint')
    """
    check_choices("option", options, Execution.__annotations__)
    # Load the scene; a crosscheck needs all of its outputs
    model_options = with_excitation(scene, {})
    read, mapping = load_scene(scene, model_options)
    loaded = replace(named_after_file(scene, read), outputs=frozenset(OUTPUTS))
    # Make the plan. The remaining options are those of the integrator
    threads, executor = options.pop("threads", None), options.pop("executor", None)
    cluster, progress = options.pop("cluster", None), options.pop("progress", lambda stage: None)
    kept = reductions(keep, loaded)
    plan = SweepPlan(
        scene=loaded,
        samples=samples_of(vary, sampling, runs, seed),
        keep=tuple(each.text if each.name == each.text else f"{each.name}={each.text}" for each in kept),
        control=_control(options),
        chunk=1,  # runs stored together; `results_of` measures the speed and replaces this number
    )
    check_names(plan)
    libraries()  # raises an error if a package is missing
    # Warn of nearly redundant constraints; the pruned scene computes only the outputs that are kept
    warn_of(plan.scene, mobility(plan.pruned_scene).nearly)
    # Execute the runs
    with workers(threads, executor, cluster) as pool:
        results = results_of(plan, None if output is None else path_of(output), pool, progress)
    return Sweep(results, options=model_options, mapping=mapping)
