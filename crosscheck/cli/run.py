"""`crosscheck run`: simulate a model in all engines and compare the results."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.abc import MetaPathFinder
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from crosscheck.cli.help import SCENE
from crosscheck.cli.shared import (
    AGREE,
    DISAGREE,
    allow_reduced_option,
    cli,
    engines_option,
    explanation_steps,
    next_step,
    progress_shown,
    say,
    scene_options,
    setting_options,
    show,
    verbose_option,
)
from crosscheck.report.render import terminal
from crosscheck.support.errors import CrosscheckError

if TYPE_CHECKING:
    from types import ModuleType

    from crosscheck.logs.judge import Log, LogJudgement

OUTPUT = Path("output")
"""Default parent of the folders of results."""


@cli.command(
    "run",
    arguments={"SCENE": f"{SCENE}  [default: tracker]"},
    groups={
        "Model": ["--set", "--all"],
        "Engines": ["--engines", "--advice"],
        "Conditions for the exit status": ["--max-error", "--allow-reduced"],
        "Logs of another simulator": ["--log", "--log-set", "--log-map"],
        "Results": ["--output", "--save"],
    },
    examples={
        "compare the engines on a model file": "crosscheck run robot.xml",
        "fail if the run of the file has a larger error": "crosscheck run robot.xml --max-error position=5mm",
        "compare all installed engines on a library scene": "crosscheck run pendulum --engines all",
    },
)
@click.argument("scene", required=False)
@click.option("--all", "library", is_flag=True, help="Run all library scenes, with one line for each.")
@engines_option
@setting_options
@click.option(
    "--output",
    type=click.Path(path_type=Path),
    default=None,
    help="Folder for results.  [default: output/SCENE; output with --all]",
)
@click.option(
    "--advice",
    is_flag=True,
    help="Name the joints that make the reactions of redundant constraints unique.",
)
@click.option(
    "--log",
    "logs",
    multiple=True,
    type=click.Path(path_type=Path, dir_okay=False),
    help="CSV or Parquet file with the run of another simulator, to be judged. Repeatable.",
)
@click.option(
    "--log-set",
    "log_settings",
    multiple=True,
    metavar="OPTION=VALUE",
    help="Convention of the logs: quaternion=xyzw, angle=deg, length=mm, time=ms, offset=S, position=center, "
    "zero=start or inputs=scene. Repeatable.",
)
@click.option(
    "--log-map",
    "log_columns",
    multiple=True,
    metavar="COLUMN=QUANTITY",
    help="Quantity in a column of the logs, such as q1=coordinate.crank. Repeatable.",
)
@allow_reduced_option
@click.option(
    "--max-error",
    "max_errors",
    multiple=True,
    metavar="[ERROR=]VALUE",
    help="Exit with 5 if the run with the settings of the file, or with --log a log, has a larger error. The "
    "error is relative to the motion (1e-3, 0.1%), or one of position=1mm, rotation=0.1deg, opening=0.1mm, "
    "energy=1%. Repeatable.",
)
@verbose_option
@click.option(
    "--save",
    type=click.Path(path_type=Path),
    help="File of the recording.  [default: OUTPUT/SCENE.rrd]",
)
def run_command(**options: Any) -> int:
    """Simulate a model in all engines, and compare the results.

    About 100 checks compare masses, kinematics, accelerations and whole runs. A model file gets a small
    excitation, because a model at rest tests little; `--set excitation=off` runs the file without it. The
    lines `your settings` judge the run with the time step and the solver of the file. `crosscheck explain`
    describes each check, verdict and cause.

    The exit status is 0 if all checks pass, 1 if the engines differ, and 3 if the comparison is incomplete.
    It is 4 if elements of the file act that are not simulated, and 5 if an error exceeds --max-error.
    """
    asked = _Options(**options)
    asked.check()
    if asked.library:
        return _run_library(asked.engines, asked.output)
    return _run(asked)


@dataclass(frozen=True)
class _Options:
    """Options of the command line, as Click parses them; the help of each option explains it."""

    scene: str | None
    library: bool
    engines: list[str] | None
    settings: tuple[str, ...]
    advice: bool
    logs: tuple[Path, ...]
    log_settings: tuple[str, ...]
    log_columns: tuple[str, ...]
    allow_reduced: bool
    max_errors: tuple[str, ...]
    output: Path | None
    save: Path | None

    @property
    def model(self) -> str:
        """Name or file of the model."""
        return self.scene or "tracker"

    def check(self) -> None:
        """Check that the options can be combined.

        Raises:
            CrosscheckError: for an option that does not apply together with another one.
        """
        alone = {
            "SCENE": self.scene,
            "--set": self.settings,
            "--advice": self.advice,
            "--log": self.logs,
            "--allow-reduced": self.allow_reduced,
            "--max-error": self.max_errors,
            "--save": self.save,
        }
        if self.library:
            for name, value in alone.items():
                if value:
                    raise CrosscheckError(f"--all runs all scenes at their defaults, without {name}")
        if (self.log_settings or self.log_columns) and not self.logs:
            raise CrosscheckError("--log-set and --log-map are statements on the columns of --log")
        if self.save is not None and self.save.suffix != ".rrd":
            raise CrosscheckError(f"--save {self.save}: a recording's name ends in .rrd")


def _run_library(engines: list[str] | None, output: Path | None) -> int:
    """Crosscheck all scenes of the library, print a table with a row per scene, and return the exit status.

    Args:
        engines: names of the engines; None for the default ones.
        output: parent of the scenes' result folders; `OUTPUT` if None.
    """
    from crosscheck.cli.run_all import outcome_lines, outcomes_table, run_all
    from crosscheck.engines.registry import ENGINES
    from crosscheck.library import SCENES
    from crosscheck.report.output import check_no_other_results

    folder = output or OUTPUT
    for name in SCENES if output is None else ():
        check_no_other_results(folder / name, [name])
    with progress_shown() as progress:
        outcomes = run_all(engines or list(ENGINES), folder, progress)
    click.echo(terminal([outcomes_table(outcomes)]), nl=False)
    for line in outcome_lines(outcomes):
        say(line)
    # a scene is left out if an optional package that it needs is not installed
    return AGREE if all(outcome.agrees or outcome.left_out for outcome in outcomes) else DISAGREE


def _run(asked: _Options) -> int:
    """Compare a model in several engines, write and print the results, and return the exit status."""
    from crosscheck.compare.crosscheck import crosscheck
    from crosscheck.engines.registry import ENGINES, choose
    from crosscheck.loading.load import load_scene, non_default_options, with_excitation
    from crosscheck.own_run.allowed import AllowedError
    from crosscheck.recording.mesh_budget import meshes_left_out
    from crosscheck.report.explain import names_to_explain
    from crosscheck.report.output import SUMMARY, TEST_CASES, results_name, usual_folder, write
    from crosscheck.report.run import report
    from crosscheck.support.files import check_no_source, check_writable

    # load the model
    engines = choose(asked.engines or list(ENGINES))
    allowed = [AllowedError.parse(text) for text in asked.max_errors]
    folder = asked.output or usual_folder(OUTPUT, asked.model, "crosscheck")
    logs = _logs(asked.logs, asked.log_settings, asked.log_columns)
    options = with_excitation(asked.model, scene_options(asked.settings))
    # not verified here: the comparison has checks of the import, and reports all that fail
    scene, import_report = load_scene(asked.model, options, verified=False)
    # only a scene of a file has an import report, with the simulation of the file in its own engine
    if allowed and not logs and (import_report is None or import_report.simulation is None):
        raise CrosscheckError(
            f"--max-error: {asked.model} has no run of its own; needed: an MJCF or URDF file, or --log"
        )

    # check the output files before the long computation
    name = results_name(asked.model)
    recording = asked.save or folder / f"{name}.rrd"
    texts = [folder / SUMMARY, folder / TEST_CASES]
    check_no_source(texts, [asked.model, *(str(log.table) for log in logs.values())])
    check_writable(*(folder / f"{engine.name}.npz" for engine in engines), *texts, recording)

    # compute, write
    with progress_shown() as progress:
        judged: dict[str, LogJudgement] = {}
        if logs:
            from crosscheck.compare.logs import judge_logs

            judged = judge_logs(asked.model, scene_options(asked.settings), logs, progress)
        compared = crosscheck(scene, engines, progress, asked.model, options, import_report, asked.advice)
        result = replace(compared, logs=judged).with_allowed_errors(allowed)
        progress("writing")
        found = report(result)
        with _pandas_hidden():
            write(result, found, folder, recording, name, asked.allow_reduced)

    # print, with commands for further steps
    look = f"look  {next_step('view', recording)}"
    if without_meshes := meshes_left_out(result.scene.mechanism, list(result.trajectories)):
        look = f"{without_meshes}\n{look}"
    changed = non_default_options(result.options)
    settings = [word for key, value in changed.items() for word in ("--set", f"{key}={value}")]
    next_command = "tune" if result.own_run and result.own_run.analyzed.remedies else "bench"
    more = ["-v", next_step("report", folder), next_step(next_command, result.source, *settings)]
    show(found, *explanation_steps(*names_to_explain(result)), look, f"more  {'; '.join(more)}")
    return result.outcome.exit_status(asked.allow_reduced)


def _logs(files: Sequence[Path], settings: Sequence[str], columns: Sequence[str]) -> dict[str, Log]:
    """Return the logs of the command line by the names of their files.

    Args:
        files: paths of the logs.
        settings: statements on all logs, OPTION=VALUE.
        columns: quantities of columns, COLUMN=QUANTITY.
    """
    if not files:
        return {}
    from crosscheck.logs.judge import Log
    from crosscheck.logs.options import LogOptions

    options = LogOptions.parsed(
        scene_options(tuple(settings), "--log-set"),
        scene_options(tuple(columns), "--log-map", "COLUMN=QUANTITY"),
    )
    names = [path.stem if [p.stem for p in files].count(path.stem) == 1 else str(path) for path in files]
    return {name: Log(str(path), options) for name, path in zip(names, files, strict=True)}


@contextmanager
def _pandas_hidden() -> Iterator[None]:
    """Within a block, prevent the import of pandas if it is installed and not imported yet.

    Arrow imports pandas at the first array of a recording, to distinguish arrays from a pandas Series. The
    import takes 8 % of the time of `run tracker`, and no recording has a Series.
    """
    finder = _NoPandas()
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)


class _NoPandas(MetaPathFinder):
    """Module finder that reports pandas as not installed."""

    def find_spec(self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None) -> None:
        """Raise `ModuleNotFoundError` for pandas; return None for other modules, so that Python looks on."""
        if fullname == "pandas":
            raise ModuleNotFoundError("hidden", name=fullname)
