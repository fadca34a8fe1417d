"""The command line. Click parses it.

Exit status: 0 agree, 1 disagree, 2 bad input or usage, with one line saying what.
Heavy packages are imported by the commands, so that what goes wrong in an import is one line too.
"""

from __future__ import annotations

import io
import os
import sys
import warnings
from contextlib import suppress
from typing import NoReturn

import click

from crosscheck.cli import faults, measure, regress, report, run
from crosscheck.cli.shared import BAD_INPUT, cli
from crosscheck.errors import reason_of

__all__ = ["faults", "main", "measure", "regress", "report", "run"]


def main(arguments: list[str] | None = None) -> NoReturn:
    """Run the command line and exit; every failure is one line on stderr and status 2.

    Matrices are too small for threads of BLAS: where something else wants the processors, an SVD of 60 rows
    takes 40 times as long with two of them, and they sum in another order. OpenBLAS reads their number as
    NumPy is imported.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
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
    """What to say of an error, click's own and standard output's among them."""
    if isinstance(error, click.ClickException):
        return error.format_message()
    if isinstance(error, OSError) and error.filename is None:  # files are named where they are written
        _discard_output()
        return f"cannot write standard output: {error.strerror}"
    return reason_of(error)


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
