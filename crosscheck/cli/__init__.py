"""The command line. Click parses it.

Exit status: 0 agree, 1 disagree, 2 bad input or usage, with one line saying what, 3 not all was compared,
4 agree on a reduced model, 130 interrupted.
Heavy packages are imported by the commands, so that what goes wrong in an import is one line too.
"""

from __future__ import annotations

import atexit
import gc
import io
import os
import signal
import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress

INTERRUPTED = "crosscheck: error: interrupted\n"

INTERRUPTED_STATUS = 128 + signal.SIGINT
"""Exit status, as shells have it, of what an interrupt ends."""


def _end(*_: object) -> None:
    """End the process at an interrupt while packages are loaded, before there is anything to tidy up."""
    os.write(2, INTERRUPTED.encode())
    os._exit(INTERRUPTED_STATUS)


@contextmanager
def _interrupt_calls(handler: signal.Handlers | object) -> Iterator[None]:
    """Call a handler at interrupts in the block, where Python would raise `KeyboardInterrupt`."""
    if (
        threading.current_thread() is not threading.main_thread()
        or signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    ):
        yield
        return
    signal.signal(signal.SIGINT, handler)  # type: ignore[arg-type]
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


with _interrupt_calls(_end):
    from difflib import get_close_matches
    from typing import NoReturn, TextIO

    import click

    from crosscheck.cli import identify, measure, regress, run, sun, sweep
    from crosscheck.cli.shared import BAD_INPUT, cli
    from crosscheck.report.render import shortened_values, wrapped
    from crosscheck.support.errors import CrosscheckError, reason_of, short_of_memory

MIN_ADDRESS_BYTES, MIN_ADDRESS_BYTES_PER_PROCESSOR = 3_000_000_000, 250_000_000
"""Bytes of addresses that packages take, and that threads for each processor take; most are never used.
With 2,500 MB and two processors some runs end in an abort of LLVM or a panic of Rerun."""

MIN_OPEN_FILES = 128
"""Files that a process may have open. With 12 or fewer Rerun panics, with 16 pictures have no fonts."""

COLLECT_AFTER = 1_000_000
"""New objects after which Python looks for cycles. `run tracker` ends with 220,000 objects, of which a search
finds 28,000 to be garbage. To search after every 20,000 objects takes 9 % of its time and saves 8 MB."""

__all__ = ["identify", "main", "measure", "regress", "run", "sun", "sweep"]


def main(arguments: list[str] | None = None) -> NoReturn:
    """Run the command line and exit; every failure is one line on stderr and status 2, or 130 if interrupted.

    Matrices are too small for threads of BLAS: where something else wants the processors, an SVD of 60 rows
    takes 40 times as long with two of them, and they sum in another order. OpenBLAS reads their number as
    NumPy is imported. MuJoCo draws nothing here: it would load GLFW, whose process complains if interrupted.
    At the end Python searches all objects for cycles, which takes 8 % of the time of `run tracker`. It leaves
    out objects that are frozen.
    """
    gc.set_threshold(COLLECT_AFTER, 1, 1)  # a search is rare enough to go to older objects soon
    atexit.register(gc.freeze)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ["MUJOCO_GL"] = "disable"
    heard = _open_streams()
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # names of files may hold what is no text
    hook = sys.unraisablehook
    sys.unraisablehook = lambda _: None  # what objects say that go away half made would be a second voice
    interrupts = list[int]()

    def raise_interrupt(number: int, _: object) -> None:
        interrupts.append(number)
        raise KeyboardInterrupt

    try:
        # results are checked where they are used; NumPy's warnings would be another
        with warnings.catch_warnings(), _interrupt_calls(raise_interrupt):
            warnings.simplefilter("ignore")
            status = _invoke(arguments)
    except KeyboardInterrupt as interrupt:
        _complain(": ".join(["interrupted", *map(str, interrupt.args)]), heard)
        status = INTERRUPTED_STATUS
    except Exception as error:
        # files are named where they are written
        nameless = isinstance(error, OSError) and error.filename is None and not short_of_memory(error)
        if isinstance(error, OSError) and nameless:
            status = _complain_of_stream(error)
        else:
            reason = _reason(error)
            # native modules that are interrupted while they are loaded raise errors of their own
            lost = bool(interrupts) and reason.startswith("internal error")
            status = _complain("interrupted" if lost else reason, heard)
            status = INTERRUPTED_STATUS if lost else status
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
    _check_resources()
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


def _check_resources() -> None:
    """Raise `CrosscheckError` where few files or little memory are allowed: native code would abort."""
    with suppress(ImportError):  # not everywhere
        import resource

        memory = resource.getrlimit(resource.RLIMIT_AS)[0]
        needed = MIN_ADDRESS_BYTES + MIN_ADDRESS_BYTES_PER_PROCESSOR * (os.cpu_count() or 1)
        if 0 <= memory < needed:
            problem = f"the limit of memory is {memory // 1_000_000} MB (ulimit -v)"
            raise CrosscheckError(f"{problem}; needed: {needed // 1_000_000} MB")
        files = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
        if 0 <= files < MIN_OPEN_FILES:
            problem = f"the limit of open files is {files} (ulimit -n)"
            raise CrosscheckError(f"{problem}; needed: {MIN_OPEN_FILES}")


def _check_cache() -> None:
    """Raise `NewtonEulerError` before all work where the environment names a cache that cannot be."""
    if "NEWTON_EULER_CACHE" in os.environ:
        from newton_euler.codegen.cache import cache_directory

        cache_directory()


def _reason(error: Exception) -> str:
    """Word an error, click's own among them."""
    if isinstance(error, click.NoSuchOption):
        # with Click's own cutoff, 0.6, `--city` would suggest `--pitch`
        near = get_close_matches(error.option_name, error.possibilities or (), n=1, cutoff=0.8)
        error = click.NoSuchOption(error.option_name, error.message, near, error.ctx)
    if isinstance(error, click.ClickException):
        return error.format_message()
    return reason_of(error)


def _discard_output() -> None:
    """Send what standard output still holds nowhere; the interpreter would fail on it once more."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _complain(message: str, streams: list[TextIO]) -> int:
    """Print one line on the first of the streams that can be written."""
    line = shortened_values(" ".join(["crosscheck: error:", *message.split()]))
    for stream in streams:
        with suppress(OSError):
            click.echo(wrapped(line, stream), file=stream)
            break
    return BAD_INPUT


def _complain_of_stream(error: OSError) -> int:
    """Say on the other one that standard output or standard error cannot be written.

    Nothing if a reader has read enough, as `head` does.
    """
    if isinstance(error, BrokenPipeError):
        _discard_output()
        return 128 + 13  # the exit status of shells for a process that ends by SIGPIPE
    for to_error, failed in ((True, "output"), (False, "error")):
        with suppress(OSError):
            text = f"crosscheck: error: cannot write standard {failed}: {error.strerror}"
            click.echo(text, err=to_error)
            break
    if failed == "output":
        _discard_output()
    return BAD_INPUT
