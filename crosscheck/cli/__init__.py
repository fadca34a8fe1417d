"""The command line of crosscheck: `main` runs a command and turns every failure into one line and a status.

Click parses the arguments; the modules of this package define the commands. Commands import large packages
themselves, so that an error in an import is reported in one line, too.

Exit status: 0 the engines agree, 1 they disagree, 2 bad input or usage, 3 not all was compared, 4 the engines
agree on a reduced model, 130 interrupted.
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
from importlib.machinery import ExtensionFileLoader
from types import FrameType

INTERRUPTED = "crosscheck: error: interrupted\n"
"""Message at an interrupt (Ctrl-C) while packages are imported."""

INTERRUPTED_STATUS = 128 + signal.SIGINT
"""Exit status of an interrupted command, by the convention of shells."""


def _end(*_: object) -> None:
    """End the process at an interrupt while packages are imported, when nothing needs cleanup."""
    os.write(2, INTERRUPTED.encode())
    os._exit(INTERRUPTED_STATUS)


@contextmanager
def _interrupt_calls(handler: signal.Handlers | object) -> Iterator[None]:
    """Within a block, call a handler at interrupts instead of raising `KeyboardInterrupt`.

    Without effect outside of the main thread, or if the process has another handler already.
    """
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

    from crosscheck.cli import (
        design,
        diff,
        drives,
        engine_check,
        explain,
        identify,
        importers,
        measure,
        models,
        regress,
        run,
        sun,
        sweep,
        tune,
        view,
        year,
    )
    from crosscheck.cli.shared import BAD_INPUT, cli
    from crosscheck.report.render import shorten_words, wrapped
    from crosscheck.support.errors import CrosscheckError, reason_of, short_of_memory

MIN_ADDRESS_BYTES, MIN_ADDRESS_BYTES_PER_PROCESSOR = 3_000_000_000, 250_000_000
"""Smallest permitted limit of address space, bytes: a constant, and a part for the threads of each
processor. Most of it is reserved and never used. With a limit of 2,500 MB and two processors, some runs end
in an abort of LLVM or a panic of Rerun."""

MIN_OPEN_FILES = 128
"""Smallest permitted limit of open files. With 12 or fewer Rerun panics, with 16 pictures have no fonts."""

NATIVE_IMPORTS = (ExtensionFileLoader.create_module.__code__, ExtensionFileLoader.exec_module.__code__)
"""Code of Python that imports native modules."""

RETRY_S = 0.02
"""Time after which an interrupt is repeated, s."""

GC_THRESHOLD = 1_000_000
"""Number of new objects after which Python's garbage collector searches for cycles. `run tracker` ends with
220,000 objects, of which 28,000 are garbage in cycles. A search after every 20,000 objects takes 9 % of the
time and saves 8 MB."""

__all__ = [
    "design",
    "diff",
    "drives",
    "engine_check",
    "explain",
    "identify",
    "importers",
    "main",
    "measure",
    "models",
    "regress",
    "run",
    "sun",
    "sweep",
    "tune",
    "view",
    "year",
]


def main(arguments: list[str] | None = None) -> NoReturn:
    """Run a command and exit; a failure is one line on standard error and status 2, or 130 if interrupted.

    Args:
        arguments: arguments of the command line; those of the process if None.
    """
    # Garbage collection: searches are rare, so that each may include older objects (the thresholds of 1).
    # Python searches all objects that are not frozen at exit: 8 % of the time of `run tracker`.
    gc.set_threshold(GC_THRESHOLD, 1, 1)
    atexit.register(gc.freeze)
    # The matrices are too small for threads of BLAS: on a busy machine, an SVD of 60 rows takes 40 times as
    # long with two threads, and they sum in another order. OpenBLAS reads this when NumPy is imported.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from crosscheck.engines.environment import ENVIRONMENT

    os.environ.update(ENVIRONMENT)
    # streams: a file name may have bytes that are no text; errors in destructors would print a second message
    open_streams = _open_streams()
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    hook = sys.unraisablehook
    sys.unraisablehook = lambda _: None
    interrupts = list[int]()

    def raise_interrupt(number: int, frame: FrameType | None) -> None:
        interrupts.append(number)
        _raise_interrupt(number, frame)

    try:
        # results are checked for finiteness where they are used; NumPy's warnings would repeat that
        with warnings.catch_warnings(), _interrupt_calls(raise_interrupt):
            warnings.simplefilter("ignore")
            try:
                status = _invoke(arguments)
            finally:
                if interrupts:  # one that waits for an import comes too late
                    signal.setitimer(signal.ITIMER_REAL, 0.0)
    except KeyboardInterrupt as interrupt:
        _print_error(": ".join(["interrupted", *map(str, interrupt.args)]), open_streams)
        status = INTERRUPTED_STATUS
    except Exception as error:
        # errors of files have a file name; an error without one is of standard output or standard error
        of_stream = isinstance(error, OSError) and error.filename is None and not short_of_memory(error)
        if isinstance(error, OSError) and of_stream:
            status = _print_stream_error(error)
        else:
            reason = _reason(error)
            # Python raises a RuntimeError if it is interrupted while it makes a class
            is_interrupt = bool(interrupts) and reason.startswith("internal error")
            _print_error("interrupted" if is_interrupt else reason, open_streams)
            status = INTERRUPTED_STATUS if is_interrupt else BAD_INPUT
    finally:
        sys.unraisablehook = hook
    sys.exit(status)


def _raise_interrupt(number: int, frame: FrameType | None) -> None:
    """Raise `KeyboardInterrupt`, but not within the import of a native module: try again a little later.

    A native module that is interrupted during its import raises an error of another kind, such as
    "ImportError: initialization failed", which would be reported as an error of an engine.
    """
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    while frame is not None:
        if frame.f_code in NATIVE_IMPORTS:
            signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(number))
            signal.setitimer(signal.ITIMER_REAL, RETRY_S)
            return
        frame = frame.f_back
    raise KeyboardInterrupt


def _open_streams() -> list[TextIO]:
    """Open standard streams that the caller has closed (`2>&-`) on the null device.

    Otherwise the next file that is opened would get the number of the closed stream, and its output.

    Returns:
        Those of standard error and standard output that the caller has left open.
    """
    left_open = [stream for stream in (sys.stderr, sys.stdout) if stream is not None]
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            try:
                os.fstat(number)  # a file may have its number already
            except OSError:
                os.open(os.devnull, os.O_RDWR)  # takes the first number that is free
            setattr(sys, name, open(os.devnull, "w" if number else "r"))  # noqa: SIM115, as long as it runs
    return left_open


def _invoke(arguments: list[str] | None) -> int:
    """Check the environment, run the command, and return its exit status.

    This replaces Click's `main`, which prints a second line at an interrupt.
    """
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
    """Raise `CrosscheckError` for an empty argument, which is often an unset variable of a script."""
    for before, argument in zip(["crosscheck", *arguments], arguments, strict=False):
        option, equals, value = argument.partition("=")
        if not argument:
            raise CrosscheckError(
                f"the argument after {before!r:.200} is empty; give a value or leave it out"
            )
        if option.startswith("--") and equals and not value:
            raise CrosscheckError(f"{option:.200} is empty; give a value or leave it out")


def _check_resources() -> None:
    """Raise `CrosscheckError` if the limit of memory or of open files is too low for native code."""
    with suppress(ImportError):  # Windows has no `resource`
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
    """Raise `NewtonEulerError` if the environment names a cache folder that cannot be used."""
    if "NEWTON_EULER_CACHE" in os.environ:
        from newton_euler.codegen.cache import cache_directory

        cache_directory()


def _reason(error: Exception) -> str:
    """Describe an error in one line; errors of Click keep their message."""
    if isinstance(error, click.NoSuchOption):
        # with Click's similarity threshold, 0.6, `--city` would suggest `--pitch`
        near = get_close_matches(error.option_name, error.possibilities or (), n=1, cutoff=0.8)
        error = click.NoSuchOption(error.option_name, error.message, near, error.ctx)
    if isinstance(error, click.ClickException):
        return error.format_message()
    return reason_of(error)


def _discard_output() -> None:
    """Redirect standard output to the null device, so that the flush at exit does not fail again."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _print_error(message: str, streams: list[TextIO]) -> None:
    """Print an error message in one line on the first of some streams that can be written."""
    line = shorten_words(" ".join(["crosscheck: error:", *message.split()]))
    for stream in streams:
        with suppress(OSError):
            click.echo(wrapped(line, stream), file=stream)
            break


def _print_stream_error(error: OSError) -> int:
    """Report that standard output (or error) cannot be written, on the other stream; return the exit status.

    A closed pipe is not reported: its reader, such as `head`, has read enough.
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
