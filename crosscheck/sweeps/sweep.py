"""Sweeps from Python: `crosscheck.sweep(scene, vary, runs, keep)` and what it found."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack, cast

import numpy as np

from crosscheck.engines.engine import ENGINES, choose
from crosscheck.loading.load import excited, load_scene
from crosscheck.report.output import own_name
from crosscheck.report.page import rendered
from crosscheck.report.render import terminal
from crosscheck.report.run import moved_start_lines
from crosscheck.report.table import Report
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.files import path_of
from crosscheck.sweeps.analysis import scalars, telling
from crosscheck.sweeps.checks import Checked, check_runs, chosen, default_count
from crosscheck.sweeps.distributions import Vary
from crosscheck.sweeps.execute import workers
from crosscheck.sweeps.plan import Plan
from crosscheck.sweeps.reductions import Keep, reductions
from crosscheck.sweeps.report import Findings, findings, report, to_record, write
from crosscheck.sweeps.results import Results, check_names, results_of
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
    """Options of `sweep`: a method and its steps, as of `newton_euler.simulate`, and where it runs."""

    integrator: IntegratorName
    threads: int | None
    executor: Executor | None
    cluster: Client | str | None
    progress: Callable[[str], None]


ATOL = 0.01
"""Absolute tolerance of steps by the relative one unless told otherwise, SI, as `newton_euler` has it."""


def _control(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return all that is chosen of a method and its steps, whoever left what to defaults."""
    method = given.get("integrator", Options.integrator)
    steps = cast(StepControl, {name: value for name, value in given.items() if name != "integrator"})
    options = Options.of(method, steps)
    chosen = {"integrator": method, "step": options.step, "most_steps": options.most_steps}
    if options.step is None:
        chosen |= {"rtol": options.rtol, "atol": given.get("atol", ATOL * options.rtol), "rest": options.rest}
    # numbers of Python, which the record of a sweep is made of
    return {name: np.asarray(value).item() for name, value in chosen.items() if value}


def _quiet(stage: str) -> None:
    """Tell nobody."""


@dataclass(frozen=True, eq=False)
class Sweep:
    """The results of a sweep.

    Attributes:
        results: its plan, its runs, and where they are.
        checks: runs of it that all engines made.
        options: of the scene or the file, as they were set or taken.
        mapping: what became of the elements of a model file; None for a scene of this package's own.

    Examples:
        >>> swept = sweep("pendulum", {"dumbbell.mass": "normal(1, 0.1)"}, 100, "peak:reaction_force")
        >>> float(swept.dataset["peak:reaction_force"].sel(joint="pivot").mean()) > 9.0
        True
        >>> def agreed(of: Sweep) -> bool:
        ...     return all(not each.differs for each in of.check(1).checks)
        >>> agreed(swept)
        True
    """

    results: Results
    checks: tuple[Checked, ...] = ()
    options: Mapping[str, str] = field(default_factory=dict)
    mapping: ImportReport | None = None

    def __repr__(self) -> str:
        plan = self.results.plan
        varied = f"{len(plan.samples.names)} varied by {plan.samples.sampling}"
        kept = ", ".join(each.name for each in plan.kept)
        return f"<Sweep of {plan.scene.name!r}: {plan.samples.runs} runs, {varied}; kept: {kept}>"

    def __str__(self) -> str:
        return f"{self.report.title}\n{self.report.verdict}\n\n{terminal(self.report.summary)}"

    def _repr_html_(self) -> str:
        return rendered("summary.html", report=self.report)

    @property
    def dataset(self) -> Any:
        """An xarray Dataset of what varied and what was kept, by runs; read from disk if it is there."""
        return self.results.dataset

    @cached_property
    def errors(self) -> Mapping[int, str]:
        """Why runs could not go on, by their number."""
        return dict(self.results.reasons())

    @cached_property
    def findings(self) -> Findings:
        """Quantiles of what was kept, and shares of what varied in its variance."""
        start = start_lines(self.mapping, self.results.plan.scene)
        return findings(self.results, self.checks, self.options, start)

    @cached_property
    def report(self) -> Report:
        """Tables of the findings."""
        return report(self.findings)

    @checked
    def check(
        self,
        runs: int | None = None,
        engines: Sequence[str] = tuple(ENGINES),
        progress: Callable[[str], None] = _quiet,
    ) -> Sweep:
        """Crosscheck some runs, extreme ones and others at random; returns the sweep with these checks.

        Args:
            runs: how many; one of 1,000 if not given, but 2 at least and 6 at most.
            engines: names of those that make them.
            progress: is told how far it is.

        Raises:
            CrosscheckError: for an unknown engine.
            OptionError: for an impossible number of runs.
        """
        count = default_count(self.results.plan.samples.runs) if runs is None else runs
        if not is_count(count):
            raise OptionError("runs", runs, "a whole number, 1 or more")
        found = scalars(self.results)
        picked = chosen(self.results, found, telling(found), count)
        checked = check_runs(self.results, found, picked, choose(list(engines)), progress, self.mapping)
        return replace(self, checks=tuple(checked))

    @checked
    def save(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Write figures, pictures and the recording, as `crosscheck sweep --output FOLDER`.

        Returns:
            The files.

        Raises:
            CrosscheckError: naming a path that cannot be written.
        """
        return write(self.findings, self.report, path_of(folder))

    def show(self) -> None:
        """Open the envelope and the extreme runs in the Rerun viewer, in a notebook below the cell.

        Raises:
            CrosscheckError: if none of these runs comes to its end.
        """
        from crosscheck.recording.show import show
        from crosscheck.recording.sweep import log_sweep

        to_show = to_record(self.findings, self.report)
        if not to_show[1]:
            raise CrosscheckError("no run to show came to its end")
        show(log_sweep, *to_show)


def own_scene(model: Model, scene: Scene) -> Scene:
    """Return a scene by the name of the file that it was loaded from, which may have another one inside."""
    if isinstance(model, Scene) or not isinstance(model, str | os.PathLike):
        return scene
    return replace(scene, name=own_name(os.fspath(model)))


def start_lines(mapping: ImportReport | None, scene: Scene) -> tuple[str, ...]:
    """Return the lines about how a file is excited, and how far the start is from the file's."""
    if mapping is None:
        return ()
    excited = (line for line in mapping.start if line.startswith("excited"))
    return (*excited, *moved_start_lines(mapping, scene))


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
    """Run a scene many times with parameters from distributions, and keep chosen numbers of each run.

    Args:
        scene: as of `check`; files are excited like there.
        vary: distributions by the names of parameters, see `newton_euler.equations.parameters`: texts such as
            "normal(14, 0.5)", or numbers, one as likely as the other.
        runs: their number; None for all combinations of a grid.
        keep: reductions, as "peak:reaction_force, final:panel_7.quaternion".
        sampling: "random", "latin_hypercube", "sobol", "saltelli" (for Sobol indices) or "grid".
        seed: of all random numbers.
        output: folder on disk; a sweep that was interrupted goes on there. In memory if None.
        options: `threads`, `executor` (of concurrent.futures) or `cluster` (a Dask client or an address), on
            which it runs; `progress`, which is told how far it is; `integrator`, `rtol`, `atol` (a hundredth
            of rtol unless given), `step` as of `newton_euler.simulate`.

    Raises:
        CrosscheckError, NewtonEulerError: for an unknown name, an impossible plan, a folder with another one,
            a cluster that does not answer and a disk that is full.

    Examples:
        >>> swept = sweep("pendulum", {"dumbbell.mass": "normal(1, 0.1)"}, 8, "peak:reaction_force")
        >>> swept
        <Sweep of 'pendulum': 8 runs, 1 varied by random; kept: peak:reaction_force>
        >>> swept.dataset["peak:reaction_force"].dims
        ('run', 'joint')
    """
    check_choices("option", options, Execution.__annotations__)
    given = excited(scene, {})
    read, mapping = load_scene(scene, given)
    loaded = replace(own_scene(scene, read), outputs=frozenset(OUTPUTS))
    threads, executor = options.pop("threads", None), options.pop("executor", None)
    cluster, progress = options.pop("cluster", None), options.pop("progress", _quiet)
    kept = reductions(keep, loaded)
    texts = tuple(each.text if each.name == each.text else f"{each.name}={each.text}" for each in kept)
    plan = Plan(loaded, samples_of(vary, sampling, runs, seed), texts, _control(options), 1)
    check_names(plan)
    libraries()
    warn_of(plan.scene, mobility(plan.lean).nearly)
    with workers(threads, executor, cluster) as at:
        results = results_of(plan, None if output is None else path_of(output), at, progress)
    return Sweep(results, (), given, mapping)
