"""Shared parts of all commands: options, loading, result files, progress, output and exit statuses.

Most commands follow the same steps: parse options, load a scene (`load_with_warnings`), and check that the
result files can be written (`result_paths`). Then they compute while a message shows the stage
(`progress_shown`), write the files, and print a report (`show`).
"""

from __future__ import annotations

import math
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from shlex import join
from threading import Timer
from typing import TYPE_CHECKING, Self

import click

from crosscheck.cli.help import Commands
from crosscheck.compare.outcome import ExitStatus
from crosscheck.report.render import printable, terminal, wrapped
from crosscheck.support.errors import CrosscheckError

if TYPE_CHECKING:
    from crosscheck.report.table import Part, Report
    from newton_euler.model.scene import Scene
    from newton_euler.reading.import_report import ImportReport

VERDICT_COLORS = {"": None, "holds": "green", "improved": "green", "doubtful": "yellow", "fails": "red"}
"""Terminal color of each verdict of `crosscheck.report.table.Cell`. In a regression test, a cost (such as a
number of steps) or an error below its stored baseline is improved."""

PROGRESS_DELAY_S = 10.0
"""Time without a message, s, before a command whose standard error is no terminal prints its stage."""

AGREE, DISAGREE, BAD_INPUT, UNFINISHED, REDUCED, INACCURATE = ExitStatus
"""Exit statuses. REDUCED: the engines agree on a model without some elements of the file that act.
INACCURATE: the run with the settings of the file has a larger error than the user allows."""


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="crosscheck-dynamics", prog_name="crosscheck")
def cli() -> None:
    """Find errors in mechanism models by simulating them in three independent dynamics engines."""


def fraction(text: str | float) -> float:
    """Read the value of an option: a number from 0 on and below 1, such as 1e-3 or 0.1%."""
    value = str(text)
    try:
        number = float(value.removesuffix("%")) * (0.01 if value.endswith("%") else 1.0)
    except ValueError:
        number = math.nan
    if not 0.0 <= number < 1.0:
        raise click.BadParameter(f"{value!r}; needed: a number from 0 on and below 1, such as 1e-3 or 0.1%")
    return number


def setting_options(command: Callable[..., int]) -> Callable[..., int]:
    """Add the option `--set` to a command, whose argument `settings` gets the values.

    Settings that are limits of a command's work, such as time=600 (processor time of a run, s), apply until
    the command ends and are not passed on.
    """
    option = click.option(
        "--set",
        "settings",
        multiple=True,
        metavar="OPTION=VALUE",
        callback=_apply_limits,
        help="Option of the scene or file, or limit of its computation; see `crosscheck list`. Repeatable.",
    )
    return option(command)


def _apply_limits(context: click.Context, _: click.Parameter, settings: tuple[str, ...]) -> tuple[str, ...]:
    """Apply the limits among the settings while the command runs, and return the other settings."""
    from newton_euler.limits import LIMITS, changed

    named = [(setting, setting.partition("=")[0]) for setting in settings]
    chosen = tuple(setting for setting, name in named if name in LIMITS)
    context.with_resource(changed(scene_options(chosen)))
    return tuple(setting for setting, name in named if name not in LIMITS)


def scene_options(
    settings: tuple[str, ...], given_as: str = "--set", form: str = "OPTION=VALUE"
) -> dict[str, str]:
    """Parse settings of the form OPTION=VALUE into the options of a scene by name.

    The option `ignore` lists elements of a model file that are left out; if it is repeated, its values are
    joined by commas.

    Args:
        settings: values of the command-line option.
        given_as: command-line option that the settings belong to, for messages.
        form: names of both parts of a setting, for messages.

    Raises:
        CrosscheckError: if a setting has another form, or another option is given twice.
    """
    options: dict[str, str] = {}
    for setting in settings:
        key, equals, value = setting.partition("=")
        if not (key and equals and value):
            raise CrosscheckError(f"{given_as} {setting!r} is not of the form {form}")
        if key in options and key != "ignore":
            raise CrosscheckError(f"{given_as} {key} is given twice")
        options[key] = f"{options[key]},{value}" if key in options else value
    return options


def folder_option(default: str) -> Callable[[Callable[..., int]], Callable[..., int]]:
    """Add the option `--output`, the folder for results, to a command.

    Args:
        default: default folder, for the help. If its last name is in capitals, as in "output/SCENE", it
            stands for the name of the model, and the option is None by default.
    """
    fixed = None if Path(default).name.isupper() else Path(default)
    folder = click.Path(path_type=Path)
    return click.option(
        "--output", type=folder, default=fixed, help=f"Folder for results.  [default: {default}]"
    )


def allow_reduced_option(command: Callable[..., int]) -> Callable[..., int]:
    """Add the option `--allow-reduced` to a command, whose argument `allow_reduced` gets its value."""
    text = "Exit with 0, not 4, if elements of the file act that are not simulated, such as contacts."
    return click.option("--allow-reduced", is_flag=True, help=text)(command)


DEFAULT_ENGINES = "newton_euler,mujoco,pinocchio"
"""Engines that run by default; written here so that the help starts fast."""

REFERENCE_ENGINE = DEFAULT_ENGINES.partition(",")[0]
"""Engine whose runs are the reference for those of other engines."""


ENGINES_HELP = f"Engines, separated by commas, or `all` installed ones.  [default: {DEFAULT_ENGINES}]"
"""Help of the option `--engines`."""


def engines_option(command: Callable[..., int], text: str = ENGINES_HELP) -> Callable[..., int]:
    """Add the option `--engines` to a command; its default is None and means those of the registry."""

    def names(context: click.Context, _: click.Parameter, given: str | None) -> list[str] | None:
        from crosscheck.engines import registry

        if given is None:
            return None
        wanted = [name.strip() for name in given.split(",") if name.strip()]
        chosen = {engine.name for engine in registry.choose(wanted)}
        missing = [name for name in registry.names() if name not in chosen]
        if registry.ALL in wanted and missing:
            hint = "`crosscheck list` prints how to install them"
            click.echo(f"engines that are not installed: {', '.join(missing)}; {hint}", err=True)
        return wanted

    return click.option("--engines", metavar="NAMES", callback=names, help=text)(command)


def refuse_excitation(options: dict[str, str], why: str) -> dict[str, str]:
    """Return the options of a command that does not excite the scene; raise if they switch excitation on.

    Excitation adds start velocities and sines for actuators to a model file, because a model at rest tests
    little.

    Args:
        options: options of the scene.
        why: reason, for the error message.
    """
    if options.get("excitation") == "on":
        raise CrosscheckError(f"--set excitation=on has no effect here: {why}")
    return options


def say(*lines: str, bold: bool = False) -> None:
    """Write sentences to standard output, wrapped to a terminal's width."""
    for line in lines:
        click.echo(click.style(wrapped(line), bold=bold))


VERBOSE_KEY = "crosscheck.verbose"
"""Key of Click's context that holds the value of `--verbose`."""


def verbose_option(command: Callable[..., int]) -> Callable[..., int]:
    """Add the option `--verbose` to a command; `is_verbose` returns its value."""

    def keep(context: click.Context, _: click.Parameter, wanted: bool) -> None:
        context.meta[VERBOSE_KEY] = wanted

    text = "Print everything: all checks, notes, elements of model files, limits."
    option = click.option("-v", "--verbose", is_flag=True, expose_value=False, callback=keep, help=text)
    return option(command)


def is_verbose() -> bool:
    """Return True if `--verbose` is given."""
    return bool(click.get_current_context().meta.get(VERBOSE_KEY))


def verbose_parts(report: Report) -> list[Part]:
    """Return all parts of a report, also folded ones, if `--verbose` is given; otherwise an empty list."""
    return [replace(part, folded=False) for part in report.parts] if is_verbose() else []


def show(report: Report, *after: str) -> None:
    """Print a report: all parts if `--verbose` is given, then its title, verdict and summary.

    Args:
        report: report of a command.
        after: sentences to print below the summary.
    """
    click.echo(terminal(verbose_parts(report)), nl=False)
    say(report.title, bold=True)
    if report.verdict:
        # `judged` is the cell with the verdict in one word
        click.echo(click.style(wrapped(report.verdict), fg=VERDICT_COLORS[report.judged.verdict], bold=True))
    click.echo()
    click.echo(terminal(report.summary), nl=False)
    say(*after)


def load_with_warnings(scene: str, options: dict[str, str]) -> Scene:
    """Load a scene, and warn on standard error about elements that are not imported exactly."""
    from crosscheck.loading.load import load_scene

    loaded, mapping = load_scene(scene, options)
    warn_about_import(scene, mapping, loaded)
    return loaded


def result_paths(
    output: Path | None, parent: str, kind: str, names: Sequence[str], sources: Sequence[str | Path]
) -> list[Path]:
    """Choose the paths of result files, and check that they can be written and are no input files.

    Args:
        output: folder for the files; None for a folder below `parent`, by the name of the model.
        parent: parent of the default folder.
        kind: kind of the results, such as "sweep", by which earlier results in the folder are recognized; a
            key of `crosscheck.report.output.MODEL_RECORDS`.
        names: names of the files.
        sources: the model, by name or file, and further input files.

    Raises:
        CrosscheckError: if the default folder has results of another model, if a file cannot be written, or
            if a file is also an input file.
    """
    from crosscheck.report.output import usual_folder
    from crosscheck.support.files import check_no_source, check_writable

    folder = output or usual_folder(Path(parent), str(sources[0]), kind)
    paths = [folder / name for name in names]
    check_no_source(paths, sources)
    check_writable(*paths)
    return paths


def warn_about_import(source: str, mapping: ImportReport | None, scene: Scene) -> None:
    """Warn on standard error about differences between a scene and the file that it is read from.

    There is a line for each likely mistake in the file, for a changed initial state, and for each of the
    first elements that are not imported exactly. The last line counts the other elements.

    Args:
        source: name or file of the scene, with which each line begins.
        mapping: import report; None if the scene is not read from a model file.
        scene: the scene.
    """
    if mapping is None:
        return
    from crosscheck.report.run import moved_start_lines

    entries = mapping.entries
    # elements that move nothing, such as an idle motor, are not worth a line
    lines = [str(entry) for entry in entries if entry.fate != "exactly" and not entry.moves_nothing]
    shown = 4
    if len(lines) > shown + 1:
        more = len(lines) - shown
        lines[shown:] = [f"{more} more elements are not as in the file; crosscheck run -v names all"]
    for line in (*map(str, mapping.findings), *moved_start_lines(mapping, scene), *lines):
        click.echo(wrapped(f"{source}: {line}", sys.stderr), err=True)


def next_step(*words: object) -> str:
    """Return a command line that the user can copy, such as "crosscheck view output/arm/arm.rrd".

    The name of the program has its path if the shell would not find the program by its name.

    Args:
        words: command and arguments.
    """
    called, command = Path(sys.argv[0]), "crosscheck"
    if called.name == command and shutil.which(command) != str(called.absolute()):
        command = os.path.relpath(called)
    return join([command, *map(str, words)])


def explanation_steps(*names: str) -> list[str]:
    """Return a line with the commands that explain some names of the output; no line without names."""
    commands = [next_step("explain", *name.split()) for name in names]
    return [f"why   {'; '.join(commands)}"] if commands else []


@contextmanager
def progress_shown() -> Iterator[Callable[[str], None]]:
    """Yield a function that shows the current stage of a long computation on standard error.

    On a terminal, the stage is a status line. In a file or a pipe, a line is printed now and then.
    """
    if sys.stderr is None or not sys.stderr.isatty():  # a pipe has no cursor, even with FORCE_COLOR
        with _LongStages() as stages:
            yield stages.begin
        return
    from rich.console import Console
    from rich.text import Text

    with Console(stderr=True).status("") as status:
        yield lambda message: status.update(Text(printable(message)))


class _LongStages:
    """Prints the current stage on standard error: first after `PROGRESS_DELAY_S`, then less often."""

    def __init__(self) -> None:
        self._timer: Timer | None = None
        self._stage, self._start = "", time.perf_counter()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._timer:
            self._timer.cancel()

    def begin(self, stage: str) -> None:
        """Set the current stage, and schedule the next message unless one is scheduled."""
        self._stage = stage
        if not self._timer:
            # in a run of hours, the next message waits for a tenth of the time so far
            wait = max(PROGRESS_DELAY_S, 0.1 * (time.perf_counter() - self._start))
            self._timer = Timer(wait, self._print_stage)
            self._timer.daemon = True
            self._timer.start()

    def _print_stage(self) -> None:
        """Print the current stage; a timer calls this method."""
        self._timer = None
        click.echo(f"{printable(self._stage)} ...", err=True)
