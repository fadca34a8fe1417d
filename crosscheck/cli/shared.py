"""Parts that all commands share: the group, options, scenes and models, tables, exit statuses."""

from __future__ import annotations

import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from shlex import join
from threading import Timer
from typing import TYPE_CHECKING, Self

import click

from crosscheck.report.outcome import ExitStatus
from crosscheck.report.render import printable, terminal, wrapped
from crosscheck.support.errors import CrosscheckError

if TYPE_CHECKING:
    from crosscheck.report.table import Part, Report
    from newton_euler.model.scene import Scene
    from newton_euler.reading.import_report import ImportReport

LISTS = frozenset({"ignore"})
"""Options of scenes that have several values."""

COLORS = {"": None, "holds": "green", "improved": "green", "doubtful": "yellow", "fails": "red"}
"""Of verdicts."""

LONG = 10.0
"""s, after which it is told what goes on where standard error is no terminal, and then again."""

SELDOM = 0.1
"""Of the time so far, before it is told again: what takes hours leaves a log of some lines."""

SENTENCE = 200
"""Characters of what a command does."""

MOST_LINES = 4
"""Elements of a file that are not simulated as they are, a line each."""

AGREE, DISAGREE, BAD_INPUT, UNFINISHED, REDUCED = ExitStatus


class Commands(click.Group):
    """Commands whose first sentences are shown in full, where Click cuts them to one line."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands, a sentence each."""
        rows = [(name, self.commands[name].get_short_help_str(SENTENCE)) for name in self.list_commands(ctx)]
        with formatter.section("Commands"):
            formatter.write_dl(rows)


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="crosscheck-dynamics", prog_name="crosscheck")
def cli() -> None:
    """Find errors in mechanism models by simulating them in three independent dynamics engines."""


def setting_options(command: Callable[..., int]) -> Callable[..., int]:
    """Parse what `scene_options` takes; limits that are set hold until the command ends."""
    option = click.option(
        "--set",
        "settings",
        multiple=True,
        metavar="OPTION=VALUE",
        callback=_heed_limits,
        help="Option of the scene or model file, or a limit; crosscheck list prints all. Repeatable.",
    )
    return option(command)


def _heed_limits(context: click.Context, _: click.Parameter, settings: tuple[str, ...]) -> tuple[str, ...]:
    """Change the limits among some settings while a command runs; the other settings."""
    from newton_euler.limits import LIMITS, changed

    named = [(setting, setting.partition("=")[0]) for setting in settings]
    chosen = tuple(setting for setting, name in named if name in LIMITS)
    context.with_resource(changed(scene_options(chosen)))
    return tuple(setting for setting, name in named if name not in LIMITS)


def scene_options(settings: tuple[str, ...], given_as: str = "--set") -> dict[str, str]:
    """Parse values of `--set`, or of what they are given as, into options of a scene by name.

    An option of `LISTS` that is given several times has all its values, between commas.
    """
    options: dict[str, str] = {}
    for setting in settings:
        key, equals, value = setting.partition("=")
        if not (key and equals and value):
            raise CrosscheckError(f"{given_as} {setting!r} is not of the form OPTION=VALUE")
        if key in options and key not in LISTS:
            raise CrosscheckError(f"{given_as} {key} is given twice")
        options[key] = f"{options[key]},{value}" if key in options else value
    return options


def folder_option(default: str) -> Callable[[Callable[..., int]], Callable[..., int]]:
    """Parse the folder of results; it is None by default where that depends on the scene."""
    fixed = None if "SCENE" in default else Path(default)
    folder = click.Path(path_type=Path)
    return click.option(
        "--output", type=folder, default=fixed, help=f"Folder for results.  [default: {default}]"
    )


def engines_option(command: Callable[..., int]) -> Callable[..., int]:
    """Parse names of engines; it is None by default, for all."""

    def names(context: click.Context, _: click.Parameter, given: str | None) -> list[str] | None:
        from crosscheck.engines.engine import choose

        if given is None:
            return None
        return [engine.name for engine in choose([name.strip() for name in given.split(",") if name.strip()])]

    text = "Engines to run, separated by commas.  [default: all]"
    return click.option("--engines", metavar="NAMES", callback=names, help=text)(command)


def without_excitation(options: dict[str, str], why: str) -> dict[str, str]:
    """Return the options of a command without excitation; refuse, with the reason, if they ask."""
    if options.get("excitation") == "on":
        raise CrosscheckError(f"--set excitation=on has no effect here: {why}")
    return options


def say(*lines: str, bold: bool = False) -> None:
    """Write sentences to standard output, wrapped to a terminal's width."""
    for line in lines:
        click.echo(click.style(wrapped(line), bold=bold))


VERBOSE = "crosscheck.verbose"
"""Key of the context under which `verbose_option` is kept."""


def verbose_option(command: Callable[..., int]) -> Callable[..., int]:
    """Parse whether everything is to be printed, see `is_verbose`."""

    def keep(context: click.Context, _: click.Parameter, wanted: bool) -> None:
        context.meta[VERBOSE] = wanted

    text = "Print everything: figures, notes, elements of model files, limits."
    option = click.option("-v", "--verbose", is_flag=True, expose_value=False, callback=keep, help=text)
    return option(command)


def is_verbose() -> bool:
    """Return whether `verbose_option` is set."""
    return bool(click.get_current_context().meta.get(VERBOSE))


def everything(report: Report) -> list[Part]:
    """All parts of a report, unfolded, if `verbose_option` is set; otherwise none."""
    return [replace(part, folded=False) for part in report.parts] if is_verbose() else []


def show(report: Report, *after: str) -> None:
    """Write the summary of a report to standard output, below `everything`.

    Args:
        after: sentences that follow it.
    """
    click.echo(terminal(everything(report)), nl=False)
    say(report.title, bold=True)
    if report.verdict:
        click.echo(click.style(wrapped(report.verdict), fg=COLORS[report.judged.verdict], bold=True))
    click.echo()
    click.echo(terminal(report.summary), nl=False)
    say(*after)


def load_and_tell(scene: str, options: dict[str, str]) -> Scene:
    """A scene, with a line on standard error for each element of its file that is not in it as it was."""
    from crosscheck.loading.load import load_scene

    loaded, mapping = load_scene(scene, options)
    tell(scene, mapping, loaded)
    return loaded


def tell(source: str, mapping: ImportReport | None, scene: Scene) -> None:
    """Write what a scene has otherwise than its file to standard error.

    A line for each finding, for a start that is not the file's, and for each element that is not in the scene
    as it was; of many elements the first ones, and how many more there are.
    """
    if mapping is None:
        return
    from crosscheck.report.run import moved_start_lines

    entries = mapping.entries
    lines = [str(entry) for entry in entries if entry.fate != "exactly" and not entry.inert]
    if len(lines) > MOST_LINES + 1:
        more = len(lines) - MOST_LINES
        lines[MOST_LINES:] = [f"{more} more elements are not as in the file; crosscheck run -v names all"]
    for line in (*map(str, mapping.findings), *moved_start_lines(mapping, scene), *lines):
        click.echo(wrapped(f"{source}: {line}", sys.stderr), err=True)


def next_step(*words: object) -> str:
    """Word a command to go on with, called as this one was where the shell does not find it by its name."""
    called, command = Path(sys.argv[0]), "crosscheck"
    if called.name == command and shutil.which(command) != str(called.absolute()):
        command = os.path.relpath(called)
    return join([command, *map(str, words)])


@contextmanager
def progress_shown() -> Iterator[Callable[[str], None]]:
    """A function that shows what is going on, on standard error; now and then if that is a pipe."""
    if sys.stderr is None or not sys.stderr.isatty():  # whatever FORCE_COLOR says, a pipe has no cursor
        with _LongStages() as stages:
            yield stages.begin
        return
    from rich.console import Console
    from rich.text import Text

    with Console(stderr=True).status("") as status:
        yield lambda message: status.update(Text(printable(message)))


class _LongStages:
    """Says on standard error what goes on, after `LONG` and now and then."""

    def __init__(self) -> None:
        self._timer: Timer | None = None
        self._stage, self._start = "", time.perf_counter()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._timer:
            self._timer.cancel()

    def begin(self, stage: str) -> None:
        """Begin a stage, which ends the one before."""
        self._stage = stage
        if not self._timer:
            wait = max(LONG, SELDOM * (time.perf_counter() - self._start))
            self._timer = Timer(wait, self._tell)
            self._timer.daemon = True
            self._timer.start()

    def _tell(self) -> None:
        self._timer = None
        click.echo(f"{printable(self._stage)} ...", err=True)
