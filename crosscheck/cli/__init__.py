"""The command line. Click parses it.

Exit status: 0 agree, 1 disagree, 2 bad input or usage, with one line saying what, 3 not all was compared.
Heavy packages are imported by the commands, so that what goes wrong in an import is one line too.
"""

from __future__ import annotations

import gc
import io
import os
import sys
import warnings
from contextlib import suppress
from difflib import get_close_matches
from typing import NoReturn, TextIO

import click

from crosscheck.cli import identify, measure, regress, run, sun, sweep
from crosscheck.cli.shared import BAD_INPUT, cli
from crosscheck.errors import CrosscheckError, reason_of, short_of_memory
from crosscheck.report.render import wrapped

NOT_READ = 128 + 13
"""Exit status, as shells have it, of what ends by SIGPIPE."""

NEAR = 0.8
"""Similarity, at most 1, from which another option may be meant; Click's 0.6 takes `--city` for `--pitch`."""

LEAST_MEMORY = 2_000_000_000
"""Bytes of addresses; most of them are of libraries, and never used."""

COLLECT_AFTER = 20_000
"""New objects after which Python looks for cycles. Packages make many as they are loaded, and no garbage: by
Python's own 700 it took 6 % of the time of `run tracker`."""

__all__ = ["identify", "main", "measure", "regress", "run", "sun", "sweep"]


def main(arguments: list[str] | None = None) -> NoReturn:
    """Run the command line and exit; every failure is one line on stderr and status 2.

    Matrices are too small for threads of BLAS: where something else wants the processors, an SVD of 60 rows
    takes 40 times as long with two of them, and they sum in another order. OpenBLAS reads their number as
    NumPy is imported. MuJoCo draws nothing here: it would load GLFW, whose process complains if interrupted.
    """
    gc.set_threshold(COLLECT_AFTER)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ["MUJOCO_GL"] = "disable"
    heard = _open_streams()
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # names of files may hold what is no text
    hook = sys.unraisablehook
    sys.unraisablehook = lambda _: None  # what objects say that go away half made would be a second voice
    try:
        # results are checked where they are used; NumPy's warnings would be another
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            status = _invoke(arguments)
    except KeyboardInterrupt as interrupt:
        status = _complain(": ".join(["interrupted", *map(str, interrupt.args)]), heard)
    except Exception as error:
        # files are named where they are written
        nameless = isinstance(error, OSError) and error.filename is None and not short_of_memory(error)
        if isinstance(error, OSError) and nameless:
            status = _complain_of_stream(error)
        else:
            status = _complain(_reason(error), heard)
    finally:
        sys.unraisablehook = hook
    sys.exit(status)


def _open_streams() -> list[TextIO]:
    """Open standard streams that the caller has closed (`2>&-`) on nothing; files would take their numbers.

    Returns:
        Standard error and standard output, as far as they were open.
    """
    heard = [stream for stream in (sys.stderr, sys.stdout) if stream is not None]
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            try:
                os.fstat(number)  # a file may have its number already
            except OSError:
                os.open(os.devnull, os.O_RDWR)  # takes the first number that is free
            setattr(sys, name, open(os.devnull, "w" if number else "r"))  # noqa: SIM115, as long as it runs
    return heard


def _invoke(arguments: list[str] | None) -> int:
    """Click's own `main` would add a line of its own to an interrupt."""
    given = sys.argv[1:] if arguments is None else arguments
    _check_no_empty(given)
    _check_memory()
    _check_cache()
    try:
        with cli.make_context("crosscheck", given) as context:
            return int(cli.invoke(context))
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message())
        return BAD_INPUT
    except click.exceptions.Exit as finished:
        return finished.exit_code


def _check_no_empty(arguments: list[str]) -> None:
    """Raise `CrosscheckError` for an empty argument, often a variable of a script that is not set."""
    for before, argument in zip(["crosscheck", *arguments], arguments, strict=False):
        option, equals, value = argument.partition("=")
        if not argument:
            raise CrosscheckError(
                f"the argument after {before!r:.200} is empty; give a value or leave it out"
            )
        if option.startswith("--") and equals and not value:
            raise CrosscheckError(f"{option:.200} is empty; give a value or leave it out")


def _check_memory() -> None:
    """Raise `CrosscheckError` where so little memory is allowed that packages hang when they are loaded."""
    with suppress(ImportError):  # not everywhere
        import resource

        allowed = resource.getrlimit(resource.RLIMIT_AS)[0]
        if 0 <= allowed < LEAST_MEMORY:
            problem = f"the limit of memory is {allowed // 1_000_000} MB (ulimit -v)"
            raise CrosscheckError(f"{problem}; needed: {LEAST_MEMORY // 1_000_000} MB")


def _check_cache() -> None:
    """Raise `NewtonEulerError` before all work where the environment names a cache that cannot be."""
    if "NEWTON_EULER_CACHE" in os.environ:
        from newton_euler.codegen.cache import cache_directory

        cache_directory()


def _reason(error: Exception) -> str:
    """Word an error, click's own among them."""
    if isinstance(error, click.NoSuchOption):
        near = get_close_matches(error.option_name, error.possibilities or (), 1, NEAR)
        error = click.NoSuchOption(error.option_name, error.message, near, error.ctx)
    if isinstance(error, click.ClickException):
        return error.format_message()
    return reason_of(error)


def _discard_output() -> None:
    """Send what standard output still holds nowhere; the interpreter would fail on it once more."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _complain(message: str, streams: list[TextIO]) -> int:
    """Say one line on the first of the streams that can be written.

    What cannot be shown in it is escaped.
    """
    line = "".join(c if c.isprintable() else repr(c)[1:-1] for c in " ".join(message.split()))
    for stream in streams:
        with suppress(OSError):
            click.echo(wrapped(f"crosscheck: error: {line}", stream), file=stream)
            break
    return BAD_INPUT


def _complain_of_stream(error: OSError) -> int:
    """Say on the other one that standard output or standard error cannot be written.

    Nothing if a reader has read enough, as `head` does.
    """
    if isinstance(error, BrokenPipeError):
        _discard_output()
        return NOT_READ
    for to_error, failed in ((True, "output"), (False, "error")):
        with suppress(OSError):
            text = f"crosscheck: error: cannot write standard {failed}: {error.strerror}"
            click.echo(text, err=to_error)
            break
    if failed == "output":
        _discard_output()
    return BAD_INPUT
