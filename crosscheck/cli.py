"""The command line: `crosscheck run`, `convert`, `list`, `explain`, `view`, `figures`, `bench`, `stress`.

Click parses it. Exit status: 0 agree, 1 disagree, 2 bad input or usage, with one line saying what.
Heavy packages are imported by the commands, so that what goes wrong in an import is one line too.
"""

from __future__ import annotations

import io
import os
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import click

from crosscheck.errors import CrosscheckError

if TYPE_CHECKING:
    from rich.table import Table
    from rich.text import Text

    from newton_euler.mapping import Mapping
    from newton_euler.scene import Scene

TABLE_WIDTH = 130
"""Columns that the tables of a run need; a narrower terminal wraps them itself."""

AGREE, DISAGREE, BAD_INPUT = 0, 1, 2


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="crosscheck", prog_name="crosscheck")
def cli() -> None:
    """Compare closed-loop mechanism dynamics between engines."""


def _options(settings: tuple[str, ...]) -> dict[str, str]:
    options = {}
    for setting in settings:
        key, equals, value = setting.partition("=")
        if not (key and equals and value):
            raise CrosscheckError(f"--set {setting!r} is not of the form OPTION=VALUE")
        if key in options:
            raise CrosscheckError(f"--set {key} is given twice")
        options[key] = value
    return options


@cli.command("run")
@click.argument("scene", required=False)
@click.option("--all", "library", is_flag=True, help="Run all scenes of the library, a line each.")
@click.option(
    "--engines", default="newton_euler,mujoco,pinocchio", show_default=True, help="Comma-separated."
)
@click.option(
    "--set", "settings", multiple=True, metavar="OPTION=VALUE", help="Option of the scene; repeatable."
)
@click.option(
    "--output",
    type=click.Path(path_type=Path),
    default=None,
    help="Folder.  [default: output/SCENE, or output with --all]",
)
@click.option(
    "--save", type=click.Path(path_type=Path), default=None, help="Recording.  [default: OUTPUT/SCENE.rrd]"
)
@click.option("--loops", metavar="FILE", default=None, help="Loop file (YAML) of a URDF.")
def run_command(
    scene: str | None,
    library: bool,
    engines: str,
    settings: tuple[str, ...],
    output: Path | None,
    save: Path | None,
    loops: str | None,
) -> int:
    """Run SCENE through the engines and compare them.

    SCENE is a name, a scene file, an MJCF or a URDF; the tracker if not given.
    """
    wanted = [name.strip() for name in engines.split(",") if name.strip()]
    if library:
        if scene or settings or save or loops:
            raise CrosscheckError("--all runs all scenes at their defaults, without SCENE and its options")
        return _run_all(wanted, output or Path("output"))
    return _run(scene or "tracker", wanted, settings, output, save, loops)


def _run_all(engines: list[str], folder: Path) -> int:
    from crosscheck.run_all import outcome_lines, outcomes_table, run_all

    with _progress() as progress:
        outcomes = run_all(engines, folder, progress)
    click.echo(_rendered([outcomes_table(outcomes)]), nl=False)
    for line in outcome_lines(outcomes):
        click.echo(line)
    return AGREE if all(outcome.agrees for outcome in outcomes) else DISAGREE


def _run(
    scene: str,
    engines: list[str],
    settings: tuple[str, ...],
    output: Path | None,
    save: Path | None,
    loops: str | None,
) -> int:
    from crosscheck.engines import choose
    from crosscheck.models import report_lines
    from crosscheck.report import markdown, settings_lines, terminal_tables
    from crosscheck.run import check_writable, crosscheck, write

    chosen = choose(engines)
    options = _options(settings)
    loaded, mapping = _load(scene, options, loops)
    for line in report_lines(mapping) if mapping else ():
        click.echo(line)
    folder = output or Path("output") / loaded.name
    recording = save or folder / f"{loaded.name}.rrd"
    if recording.suffix != ".rrd":
        raise CrosscheckError(f"--save {recording}: a recording's name ends in .rrd")
    runs = [folder / f"{engine.name}.npz" for engine in chosen]
    check_writable(*runs, folder / "summary.json", recording)
    with _progress() as progress:
        result = crosscheck(loaded, chosen, progress, scene, options, mapping)
        progress("writing")
        written = write(result, folder, recording, markdown(result))
    click.echo(_rendered(terminal_tables(result)), nl=False)
    for line in settings_lines(result):
        click.echo(line)
    click.echo("wrote " + ", ".join(str(path) for path in written))
    click.echo(click.style(result.verdict, bold=True))
    return AGREE if result.agrees else DISAGREE


def _load(scene: str, options: dict[str, str], loops: str | None) -> tuple[Scene, Mapping | None]:
    """A scene, and what became of the elements of its file if that is a model of another tool."""
    from crosscheck.models import is_model, read_model
    from crosscheck.scenes import load

    if is_model(scene):
        return read_model(scene, options, loops)
    if loops is not None:
        raise CrosscheckError(f"--loops {loops}: only a URDF has a loop file")
    return load(scene, **options), None


@contextmanager
def _progress() -> Iterator[Callable[[str], None]]:
    """A function that shows what is going on, on a terminal's standard error."""
    from rich.console import Console
    from rich.text import Text

    with Console(stderr=True).status("") as status:
        yield lambda message: status.update(Text(message))


def _rendered(parts: Iterable[Table | Text]) -> str:
    from rich.console import Console

    console = Console(width=max(TABLE_WIDTH, Console().width))
    with console.capture() as capture:
        for part in parts:
            console.print(part)
    return capture.get()


@cli.command("list")
def list_command() -> int:
    """List the scenes and engines."""
    from crosscheck.engines import ENGINES
    from crosscheck.scenes import SCENES
    from crosscheck.scenes.options import options_of

    for name, scene in SCENES.items():
        click.echo(f"{name}: {scene().description}")
        for key, option in options_of(scene).items():
            click.echo(f"    --set {key}={option.values}  [default: {option.default}]")
    click.echo(f"engines: {', '.join(ENGINES)}")
    return AGREE


@cli.command("convert")
@click.argument("source", metavar="IN")
@click.argument("target", metavar="OUT", type=click.Path(path_type=Path))
@click.option(
    "--set", "settings", multiple=True, metavar="OPTION=VALUE", help="Option of the scene; repeatable."
)
@click.option("--loops", metavar="FILE", default=None, help="Loop file (YAML) of a URDF.")
def convert_command(source: str, target: Path, settings: tuple[str, ...], loops: str | None) -> int:
    """Write IN (a scene, MJCF or URDF) as OUT, in the format that its name ends in."""
    from crosscheck.convert import check_target, scene_report, write_as
    from crosscheck.models import report_lines
    from crosscheck.run import check_writable

    check_target(target)
    check_writable(target)
    scene, report = _load(source, _options(settings), loops)
    report = report or scene_report(scene)
    written = write_as(scene, target, report)
    for line in report_lines(report):
        click.echo(line)
    click.echo("wrote " + ", ".join(str(path) for path in written))
    return AGREE


@cli.command("explain")
@click.argument("scene", default="tracker")
@click.option(
    "--set", "settings", multiple=True, metavar="OPTION=VALUE", help="Option of the scene; repeatable."
)
def explain_command(scene: str, settings: tuple[str, ...]) -> int:
    """Say what the compiler keeps of SCENE, what it leaves out, and what each feature costs."""
    from crosscheck.explain import explain
    from crosscheck.scenes import load

    loaded = load(scene, **_options(settings))
    with _progress() as progress:
        parts = list(explain(loaded, progress))
    click.echo(_rendered(parts), nl=False)
    return AGREE


@cli.command("view")
@click.argument("file", type=click.Path(path_type=Path))
def view_command(file: Path) -> int:
    """Open a recording in the Rerun viewer."""
    if file.exists() and not file.is_file():
        raise CrosscheckError(f"{file} is not a file")
    try:
        with file.open("rb") as stream:
            if stream.read(4) != b"RRF2":
                raise CrosscheckError(f"{file} is not a Rerun recording")
    except OSError as error:
        raise CrosscheckError(f"cannot read {file}: {error.strerror}") from error
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise CrosscheckError(
            f"no display to open a viewer on; in a browser: rerun --bind 127.0.0.1 --serve-web {file}"
        )
    status = subprocess.run([sys.executable, "-m", "rerun", str(file)], check=False).returncode
    if status != 0:
        raise CrosscheckError(f"the viewer ended with status {status}")
    return AGREE


@cli.command("figures")
@click.option("--output", type=click.Path(path_type=Path), default=Path("output/figures"), show_default=True)
def figures_command(output: Path) -> int:
    """Redraw the paper's Figures 5 to 9 from the three engines."""
    from crosscheck.figures import draw

    with _progress() as progress:
        written = draw(output, progress)
    for path in written:
        click.echo(f"wrote {path}")
    return AGREE


@cli.command("bench")
@click.argument("scene", default="tracker")
@click.option(
    "--set", "settings", multiple=True, metavar="OPTION=VALUE", help="Option of the scene; repeatable."
)
@click.option(
    "--error", type=float, default=1e-6, show_default=True, help="Error to name the cheapest settings for."
)
@click.option("--repeats", type=click.IntRange(3, 1000), default=15, show_default=True)
@click.option("--rhs", is_flag=True, help="Time one right-hand side of each engine instead of whole runs.")
@click.option("--scaling", is_flag=True, help="The same over the scene's option N, from 1 to 1000.")
@click.option(
    "--batch",
    type=click.IntRange(2, 10_000_000),
    metavar="RUNS",
    help="Runs per second from random states instead.",
)
@click.option(
    "--output", type=click.Path(path_type=Path), default=None, help="Folder.  [default: output/bench/SCENE]"
)
def bench_command(
    scene: str,
    settings: tuple[str, ...],
    error: float,
    repeats: int,
    rhs: bool,
    scaling: bool,
    batch: int | None,
    output: Path | None,
) -> int:
    """Measure run time against error on SCENE, for every engine and setting."""
    from crosscheck import benchmark_run as run

    options = _options(settings)
    if rhs + scaling + (batch is not None) > 1:
        raise CrosscheckError("--rhs, --scaling and --batch are different benchmarks; choose one")
    with _progress() as progress:
        if rhs:
            lines, written = run.bench_rhs(scene, options, output, progress)
        elif scaling:
            lines, written = run.bench_scaling(scene, options, output, progress)
        elif batch is not None:
            lines, written = run.bench_batch(scene, options, batch, error, output, progress)
        else:
            lines, written = run.bench(scene, options, error, repeats, output, progress)
    for line in lines:
        click.echo(line)
    click.echo("wrote " + ", ".join(str(path) for path in written))
    return AGREE


@cli.command("stress")
@click.option(
    "--full/--ci", "full", default=True, show_default=True, help="A quarter of an hour, or two minutes of it."
)
@click.option(
    "--output",
    type=click.Path(path_type=Path),
    default=Path("output/stress"),
    show_default=True,
    help="Folder.",
)
@click.option("--only", "letters", default="", metavar="LETTERS", help="Topics, such as bd.  [default: all]")
def stress_command(full: bool, output: Path, letters: str) -> int:
    """Push every engine until something breaks, and report where."""
    import time

    from crosscheck.stress import stress
    from crosscheck.stress_report import check_folder, tables, write

    check_folder(output)
    start = time.perf_counter()
    with _progress() as progress:
        rows = stress(letters, full, progress)
        wall_time = time.perf_counter() - start
        progress("writing")
        written = write(rows, full, wall_time, output)
    click.echo(_rendered(tables(rows)), nl=False)
    click.echo("wrote " + ", ".join(str(path) for path in written))
    click.echo(f"{sum(row.passes for row in rows)} of {len(rows)} cases pass, in {wall_time:.0f} s")
    return AGREE


def main(arguments: list[str] | None = None) -> NoReturn:
    """Run the command line and exit; every failure is one line on stderr and status 2."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # names of files may hold what is no text
    try:
        # results are checked where they are used; NumPy's warnings would be a second voice
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            status = _invoke(arguments)
    except KeyboardInterrupt:
        status = _complain("interrupted")
    except Exception as error:
        status = _complain(_reason(error))
    sys.exit(status)


def _invoke(arguments: list[str] | None) -> int:
    """Click's own `main` would add a line of its own to an interrupt."""
    try:
        with cli.make_context("crosscheck", sys.argv[1:] if arguments is None else arguments) as context:
            return int(cli.invoke(context))
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message())
        return BAD_INPUT
    except click.exceptions.Exit as finished:
        return finished.exit_code


def _reason(error: Exception) -> str:
    """What to say of an error; one that nobody foresaw has its type named."""
    from newton_euler.errors import NewtonEulerError

    if isinstance(error, CrosscheckError | NewtonEulerError):
        return str(error)
    if isinstance(error, click.ClickException):
        return error.format_message()
    if isinstance(error, OSError) and error.filename is None:  # files are named where they are written
        _discard_output()
        return f"cannot write standard output: {error.strerror}"
    return f"internal error: {type(error).__name__}: {error}"


def _discard_output() -> None:
    """Send what standard output still holds nowhere; the interpreter would fail on it once more."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _complain(message: str) -> int:
    """Say one line on standard error; what cannot be shown in it is escaped."""
    line = "".join(c if c.isprintable() else repr(c)[1:-1] for c in " ".join(message.split()))
    with suppress(OSError):
        click.echo(f"crosscheck: error: {line}", err=True)
    return BAD_INPUT
