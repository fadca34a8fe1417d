"""`crosscheck sweep`: Monte Carlo and design-of-experiments studies of a scene."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import click

from crosscheck.cli.help import SCENE
from crosscheck.cli.shared import (
    AGREE,
    DEFAULT_ENGINES,
    allow_reduced_option,
    cli,
    engines_option,
    folder_option,
    next_step,
    progress_shown,
    say,
    scene_options,
    setting_options,
    show,
    verbose_option,
    warn_about_import,
)


@cli.command(
    "sweep",
    arguments={"SCENE": SCENE},
    groups={
        "Study": ["--vary", "--runs", "--sampling", "--seed", "--keep"],
        "Simulation": ["--set", "--rtol"],
        "Cross-check": ["--check", "--engines", "--allow-reduced"],
        "Execution and results": ["--cluster", "--output"],
    },
    examples={
        "vary a mass, and store the largest reactions": "crosscheck sweep four_bar "
        "--vary 'bar_0.mass=normal(1,0.02)' --runs 20 --keep peak:reaction_force",
    },
)
@click.argument("scene")
@setting_options
@click.option(
    "--vary",
    "varied",
    multiple=True,
    required=True,
    metavar="NAME=DISTRIBUTION",
    help="Parameter and its distribution: normal(MEAN, DEVIATION), uniform(LOW, HIGH), "
    "truncated_normal(MEAN, DEVIATION, LOW, HIGH), values(A, B, ...) or grid(LOW, HIGH, COUNT). Repeatable.",
)
@click.option("--runs", type=int, default=None, help="Number of runs.  [default: all points of the grid]")
@click.option(
    "--keep",
    multiple=True,
    required=True,
    metavar="KIND:OUTPUT,...",
    help="Outputs to store for each run, such as peak:reaction_force,final:panel_7.quaternion. Kinds: final, "
    "peak, rms, mean, minimum, maximum, range, at(TIME; ...), when. Repeatable.",
)
@click.option(
    "--sampling",
    metavar="PLAN",
    default="random",
    show_default=True,
    help="Sampling plan: random, latin_hypercube, sobol, saltelli or grid.",
)
@click.option("--seed", type=int, default=0, show_default=True, help="Seed of the random numbers.")
@click.option(
    "--rtol", type=float, default=1e-10, show_default=True, help="Relative tolerance of the integrator."
)
@click.option(
    "--check",
    type=click.IntRange(0, 100),
    metavar="RUNS",
    default=None,
    help="Number of runs that all engines repeat: half with extreme outputs, half at random.  "
    "[default: 1 of 1,000, at least 2, at most 6]",
)
@allow_reduced_option
@click.option(
    "--cluster", metavar="ADDRESS", help="Address of a Dask scheduler, such as tcp://10.0.0.1:8786."
)
@partial(engines_option, text=f"Engines that repeat runs.  [default: {DEFAULT_ENGINES}]")
@folder_option("output/sweep/SCENE")
@verbose_option
def sweep_command(
    scene: str,
    settings: tuple[str, ...],
    varied: tuple[str, ...],
    keep: tuple[str, ...],
    check: int | None,
    allow_reduced: bool,
    engines: list[str] | None,
    output: Path | None,
    **options: Any,
) -> int:
    """Run a Monte Carlo study or a design of experiments.

    The command reports the distribution of each output, and which parameters drive it (Sobol indices, rank
    correlation). The other engines repeat some of the runs. `crosscheck list SCENE` prints the names of
    parameters. To resume an interrupted sweep, repeat the command.

    The exit status is 0 if the engines agree on the repeated runs and 1 if they differ. It is 3 if runs
    stopped, and 4 if elements of the file act that are not simulated.
    """
    from crosscheck.engines.registry import ENGINES
    from crosscheck.loading.load import load_scene, with_excitation
    from crosscheck.sweeps.distributions import parse_vary
    from crosscheck.sweeps.store import STORE_NAME, interruptible
    from crosscheck.sweeps.sweep import named_after_file, sweep

    vary = parse_vary(varied)
    # by default, inputs and start velocities excite a model file, which is usually at rest at its start
    scene_settings = with_excitation(scene, scene_options(settings))
    read, import_report = load_scene(scene, scene_settings)
    warn_about_import(scene, import_report, read)
    loaded = named_after_file(scene, read)
    folder = output or Path("output/sweep") / loaded.name
    with interruptible(folder / STORE_NAME), progress_shown() as progress:
        swept = sweep(loaded, vary, keep=keep, output=folder, progress=progress, **options)
        swept = replace(swept, options=scene_settings, mapping=import_report)
        if check != 0:
            swept = swept.check(check, engines or list(ENGINES), progress=progress)
        progress("analysis")
        made, judged = swept.report, swept.findings.outcome
    show(made)  # before the files are written, which may fail, for example because the disk is full
    with progress_shown() as progress:
        progress("pictures and recording")
        written = swept.save(folder)
    look = [f"look  {next_step('view', path)}" for path in written if path.suffix == ".rrd"]
    pictures = ", ".join(path.name for path in written if path.suffix == ".png") or "no pictures"
    more = f"more  -v; {next_step('report', folder)}; there {pictures} and numbers, {STORE_NAME}"
    say(*look, more)
    return judged.exit_status(allow_reduced) if judged else AGREE
