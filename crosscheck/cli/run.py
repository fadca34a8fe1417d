"""`crosscheck run`, `convert`, `list` and `view`."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from contextlib import contextmanager, suppress
from importlib.abc import MetaPathFinder
from pathlib import Path
from textwrap import TextWrapper
from typing import TYPE_CHECKING
from urllib.parse import quote_plus

import click

from crosscheck.cli.shared import (
    AGREE,
    DISAGREE,
    cli,
    engines_option,
    is_verbose,
    load_with_warnings,
    next_step,
    progress_shown,
    say,
    scene_options,
    setting_options,
    show,
    verbose_option,
    without_excitation,
)
from crosscheck.report.render import printable, terminal
from crosscheck.support.errors import CrosscheckError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from types import ModuleType

    from crosscheck.compare.crosscheck import Crosscheck, Progress
    from crosscheck.compare.two_models.unsimulated import Model
    from newton_euler.model.scene import Scene
    from newton_euler.scalars import Array

HERE = "127.0.0.1"
"""Address of this machine for itself alone."""

OUTPUT = Path("output")
"""Default parent of the folders of results."""

MOST_NUMBERS = 9
"""Largest number of listed components of a parameter, as many as an inertia has."""

DIGITS = 12
"""Significant digits of listed values relative to the largest of their array; further digits are
round-off."""

WIDTH = 80
"""Characters of a line of the list of parameters, unless names are long."""


@cli.command("run")
@click.argument("scene", required=False)
@click.option("--all", "library", is_flag=True, help="Run all library scenes and print one line per scene.")
@engines_option
@setting_options
@click.option(
    "--against",
    metavar="MODEL",
    help="Compare SCENE with another model instead, both simulated by newton_euler.",
)
@click.option(
    "--against-set",
    "against_settings",
    multiple=True,
    metavar="OPTION=VALUE",
    help="Option of the model of --against. Repeatable.",
)
@click.option(
    "--output",
    type=click.Path(path_type=Path),
    default=None,
    help="Folder for results.  [default: output/NAME, NAME being that of SCENE; output with --all]",
)
@click.option(
    "--advice",
    is_flag=True,
    help="Make further runs and print advice, such as the time step and solref that MuJoCo needs.",
)
@click.option(
    "--allow-reduced",
    is_flag=True,
    help="Exit with 0 if the engines agree but elements of the file that act are not simulated.",
)
@verbose_option
@click.option(
    "--save", type=click.Path(path_type=Path), help="File of the Rerun recording.  [default: OUTPUT/NAME.rrd]"
)
def run_command(
    scene: str | None,
    library: bool,
    engines: list[str] | None,
    settings: tuple[str, ...],
    against: str | None,
    against_settings: tuple[str, ...],
    advice: bool,
    allow_reduced: bool,
    **files: Path | None,
) -> int:
    """Simulate a model in all engines and compare the results.

    With --against, compare two models instead.

    SCENE is the name of a library scene (default: tracker), a scene file (YAML, JSON), an MJCF file or a
    URDF file. `crosscheck list` prints the scenes and their options.
    """
    from crosscheck.engines.engine import ENGINES

    output, save = files["output"], files["save"]
    if library:
        alone = scene is None and against is None and not (settings or advice or save or allow_reduced)
        if not alone:
            raise CrosscheckError("--all runs all scenes at their defaults, without SCENE and its options")
        return _run_all(engines or list(ENGINES), output)
    if against is None and against_settings:
        raise CrosscheckError("--against-set is for the model of --against")
    if against is not None and engines is not None:
        raise CrosscheckError("--against compares two models by newton_euler alone, without --engines")
    if against is not None and allow_reduced:
        raise CrosscheckError("--allow-reduced is on the runs of engines, without --against")
    if against is not None and advice:
        raise CrosscheckError("--advice is on the runs of engines, without --against")
    if save is not None and save.suffix != ".rrd":
        raise CrosscheckError(f"--save {save}: a recording's name ends in .rrd")
    chosen = "tracker" if scene is None else scene
    if against is None:
        return _run(chosen, engines or list(ENGINES), settings, output, save, advice, allow_reduced)
    return _run_against(_models((chosen, settings), (against, against_settings)), output, save)


def _run_all(engines: list[str], output: Path | None) -> int:
    from crosscheck.cli.run_all import outcome_lines, outcomes_table, run_all
    from crosscheck.library import SCENES
    from crosscheck.report.output import check_own

    folder = output or OUTPUT
    for name in SCENES if output is None else ():
        check_own(folder / name, [name])
    with progress_shown() as progress:
        outcomes = run_all(engines, folder, progress)
    click.echo(terminal([outcomes_table(outcomes)]), nl=False)
    for line in outcome_lines(outcomes):
        say(line)
    return AGREE if all(outcome.agrees or outcome.left_out for outcome in outcomes) else DISAGREE


def _run(
    scene: str,
    engines: list[str],
    settings: tuple[str, ...],
    output: Path | None,
    save: Path | None,
    advised: bool,
    allow_reduced: bool,
) -> int:
    from crosscheck.compare.crosscheck import crosscheck
    from crosscheck.engines.engine import choose
    from crosscheck.loading.load import load_scene, with_excitation
    from crosscheck.report.output import own_name, usual_folder
    from crosscheck.support.files import check_no_source

    chosen = choose(engines)
    folder = output or usual_folder(OUTPUT, scene, "crosscheck")
    check_no_source([folder / "summary.json"], [scene])
    options = scene_options(settings)
    taken = with_excitation(scene, options)
    loaded, mapping = load_scene(scene, taken, verified=False)  # the run says all that is not right

    def work(progress: Progress) -> Crosscheck:
        return crosscheck(loaded, chosen, progress, scene, taken, mapping, advised)

    return _carry_out(work, own_name(scene), [engine.name for engine in chosen], folder, save, allow_reduced)


def _models(*named: tuple[str, tuple[str, ...]]) -> tuple[Model, Model]:
    """Load two models by name or file and settings, with names of their own."""
    from crosscheck.compare.two_models.unsimulated import Model
    from crosscheck.loading.load import load_scene
    from newton_euler.reading.import_report import unique_name

    paths = [Path(source) for source, *_ in named]
    found: list[Model] = []
    for path, other, given_as, (source, settings) in zip(
        paths, paths[::-1], ("--set", "--against-set"), named, strict=True
    ):
        options = scene_options(settings, given_as)
        for option in ("duration", "output_period"):
            if found and option in options:
                raise CrosscheckError(f"{given_as} {option}: both models have the first's, see --set")
        name = unique_name(_short_name(path, other), "model", [model.name for model in found])
        found.append(Model(name, source, options, *load_scene(source, options)))
    first, second = found
    return first, second


def _short_name(path: Path, other: Path) -> str:
    """Return the part of a path that tells it from another: its stem, its name, or its folder, too."""
    if path.name == other.name and path.parent.name:
        return f"{path.parent.name}_{path.name}"
    return path.name if path.stem == other.stem else path.stem


def _run_against(models: tuple[Model, Model], output: Path | None, save: Path | None) -> int:
    from crosscheck.compare.two_models.compare import compare_models, together
    from crosscheck.report.output import check_own

    def work(progress: Progress) -> Crosscheck:
        return compare_models(*models, progress)

    name = together(models)
    folder = output or OUTPUT / name
    if output is None:
        check_own(folder, [model.source for model in models])
    return _carry_out(work, name, [model.name for model in models], folder, save)


def _carry_out(
    work: Callable[[Progress], Crosscheck],
    name: str,
    runs: Sequence[str],
    folder: Path,
    save: Path | None,
    allow_reduced: bool = False,
) -> int:
    """Do what was asked for of the models, with `runs` of these names, write it and tell of it."""
    from crosscheck.compare.two_models.compare import TwoModelComparison
    from crosscheck.loading.load import non_default_options
    from crosscheck.recording.mesh_budget import meshes_left_out
    from crosscheck.report.output import write
    from crosscheck.report.run import report
    from crosscheck.support.files import check_writable

    recording = save or folder / f"{name}.rrd"
    arrays = [folder / f"{run}.npz" for run in runs]
    check_writable(*arrays, folder / "summary.json", recording)
    with progress_shown() as progress:
        result = work(progress)
        progress("writing")
        found = report(result)
        with _pandas_hidden():
            write(result, found, folder, recording, name)
    more = ["-v", next_step("report", folder)]
    look = f"look  {next_step('view', recording)}"
    if not isinstance(result, TwoModelComparison):
        if unseen := meshes_left_out(result.scene.mechanism, list(result.trajectories)):
            look = f"{unseen}\n{look}"
        told = non_default_options(result.options)
        settings = [word for key, value in told.items() for word in ("--set", f"{key}={value}")]
        more.append(next_step("bench", result.source, *settings))
    show(found, look, f"more  {'; '.join(more)}")
    return result.outcome.exit_status(allow_reduced)


@contextmanager
def _pandas_hidden() -> Iterator[None]:
    """Keep pandas, if it is installed and not loaded yet, from being loaded in the block.

    Arrow loads pandas at the first array of a recording, to tell arrays from a Series. The load takes 8 % of
    the time of `run tracker`, and no recording has a Series.
    """
    finder = _NoPandas()
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)


class _NoPandas(MetaPathFinder):
    """Finder of modules for which there is no pandas."""

    def find_spec(self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None) -> None:
        """Return None for other modules, which the next finder looks for."""
        if fullname == "pandas":
            raise ModuleNotFoundError("hidden", name=fullname)


@cli.command("list")
@click.argument("scene", required=False)
@setting_options
@verbose_option
def list_command(scene: str | None, settings: tuple[str, ...]) -> int:
    """List scenes, engines and options, or the parameters of SCENE.

    SCENE is the name of a library scene or a model file (see run). sweep varies its parameters and identify
    fits them.
    """
    if scene is not None:
        for line in _parameters(load_with_warnings(scene, scene_options(settings))):
            click.echo(printable(line))
        return AGREE
    if settings:
        raise CrosscheckError("--set has no effect here: it is of a scene")
    from crosscheck.engines.engine import ENGINES
    from crosscheck.library import SCENES
    from crosscheck.library.options import options_of
    from crosscheck.loading.model_files import MJCF_OPTIONS, URDF_OPTIONS
    from newton_euler.errors import MissingPackageError
    from newton_euler.limits import LIMITS

    for name, make in SCENES.items():
        try:
            say(f"{name}: {make().description}")
        except MissingPackageError as error:
            say(f"{name}: not available: {error}")
        for key, option in options_of(make).items():
            default = f"{option.default:g}" if isinstance(option.default, float) else str(option.default)
            say(f"    --set {key}={option}  [default: {default or 'none'}]")
    for kind, options in (("MJCF, a .xml or .mjcf file", MJCF_OPTIONS), ("URDF, a .urdf file", URDF_OPTIONS)):
        say(f"{kind}:")
        for name, choice in options.items():
            say(f"    --set {name}={choice.values}  [default: {choice.default}]")
    say(f"limits of whatever is read and run{':' if is_verbose() else ', such as time=600: list -v'}")
    for name, limit in LIMITS.items() if is_verbose() else ():
        say(f"    --set {name}={limit.unit.upper()}, {limit.meaning}  [default: {limit}]")
    say(f"engines: {', '.join(ENGINES)}")
    return AGREE


def _parameters(scene: Scene) -> Iterator[str]:
    """Yield lines for each parameter and initial coordinate: name, unit and own value, a matrix by rows.

    Displacements are followed by the points that they start from.
    """
    from newton_euler.equations.parameters import origins, parameter_values
    from newton_euler.runs.initial_coordinates import initial_names
    from newton_euler.runs.variation import own_values, units_of

    starts = own_values(scene, initial_names(scene))
    values = parameter_values(scene)
    starting = origins(scene, values)
    own = values | {name: value.round(DIGITS) for name, value in starts.items()}
    units = units_of(scene, own)
    columns = max(map(len, own)), max(map(len, units.values()))
    for name, value in own.items():
        before = f"{name:{columns[0]}}  {units[name]:{columns[1]}}  "
        lines = TextWrapper(WIDTH, before, " " * len(before), break_long_words=False, break_on_hyphens=False)
        for row in value if value.shape == (3, 3) else [value]:
            text = _numbers(row, abs(value).max(initial=0.0))
            if name in starting:
                text += f"  offset from {_numbers(starting[name], abs(starting[name]).max())}"
            yield from lines.wrap(text)
            lines.initial_indent = lines.subsequent_indent


def _numbers(row: Array, largest: float) -> str:
    """Write numbers beside the largest of their array, of many the first ones and how many there are."""
    known = [number if abs(number) > 10.0**-DIGITS * largest else 0.0 for number in row.flat[:MOST_NUMBERS]]
    shown = " ".join(f"{number:.6g}" for number in known)
    return shown if row.size <= MOST_NUMBERS else f"{shown} ... ({row.size} numbers)"


@cli.command("convert")
@click.argument("source", metavar="IN")
@click.argument("target", metavar="OUT", type=click.Path(path_type=Path))
@setting_options
@verbose_option
def convert_command(source: str, target: Path, settings: tuple[str, ...]) -> int:
    """Convert a model to another format.

    IN is a library scene, a scene file, an MJCF file or a URDF file. The suffix of OUT selects the format.
    """
    from crosscheck.loading.convert import check_target, files_written, scene_report, write_as
    from crosscheck.loading.load import load_scene
    from crosscheck.loading.model_files import report_lines
    from crosscheck.support.files import check_no_source, check_writable

    check_target(target)
    options = scene_options(settings)
    if target.suffix == ".urdf":
        without_excitation(options, "a URDF holds no control and no start")
    check_no_source(files_written(target), [source, *([options["loops"]] if "loops" in options else [])])
    check_writable(target)
    scene, report = load_scene(source, options)
    report = report or scene_report(scene)
    written = write_as(scene, target, report)
    for line in (*map(str, report.findings), *report_lines(report, exact=is_verbose())):
        say(line)
    say("wrote " + ", ".join(str(path) for path in written))
    return AGREE


@cli.command("view")
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--web", is_flag=True, help="Show the recordings in a browser instead of a window.")
def view_command(files: tuple[Path, ...], web: bool) -> int:
    """Open recordings in the Rerun viewer, side by side."""
    for file in files:
        if file.exists() and not file.is_file():
            raise CrosscheckError(f"{file} is not a file")
        try:
            with file.open("rb") as stream:
                if stream.read(4) != b"RRF2":
                    raise CrosscheckError(f"{file} is not a Rerun recording")
        except OSError as error:
            raise CrosscheckError(f"cannot read {file}: {error.strerror}") from error
    from crosscheck.recording.show import has_display

    if not (web or has_display()):
        raise CrosscheckError("no display to open a viewer on; --web shows the recordings in a browser")
    serve = []
    if web:
        pages, data = _free_port(9090), _free_port(9876)  # Rerun's own defaults, if they are free
        serve = ["--serve-web", "--web-viewer-port", str(pages), "--port", str(data)]
        source = quote_plus(f"rerun+http://localhost:{data}/proxy")
        say(f"Ctrl+C ends it; open http://{HERE}:{pages}?url={source}")
        sys.stdout.flush()
    # by itself it would listen to all of the network
    viewer = [sys.executable, "-P", "-m", "rerun", "--bind", HERE, *serve, *map(str, files)]
    status = _run_to_its_end(viewer)
    if status != 0:
        raise CrosscheckError(f"the viewer ended with status {status}")
    return AGREE


def _run_to_its_end(viewer: Sequence[str]) -> int:
    """Run a viewer until it ends or this process is interrupted or asked to end; return its exit status.

    The viewer has a process group of its own, because Rerun's program starts the viewer as a child.
    """
    from crosscheck.support.time_limits import signals_as_interrupts

    with signals_as_interrupts():
        process = subprocess.Popen(viewer, start_new_session=True, env=os.environ | {"RUST_LOG": "error"})
        try:
            return process.wait()
        except KeyboardInterrupt:  # the usual way to end a viewer
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGTERM)
            process.wait()
            return 0


def _free_port(usual: int) -> int:
    """Return a port of this machine that nothing listens at: the usual one if it is free."""
    with socket.socket() as tried:
        try:
            tried.bind((HERE, usual))
        except OSError:
            tried.bind((HERE, 0))
        return int(tried.getsockname()[1])
