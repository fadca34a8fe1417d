"""The errors of the harness."""

from __future__ import annotations

import errno

NO_MEMORY = ("failed to map segment", "llocate", "start new thread", "spawn background thread", "bad_alloc")
"""Parts of messages by which libraries report a lack of memory."""


class CrosscheckError(Exception):
    """Base of every error that `crosscheck` raises on purpose; reads as one line.

    Examples:
        >>> try:
        ...     sweep("pendulum", {"dumbbell.mass": "normal(1, 0.1)"}, 0, "peak:reaction_force")
        ... except CrosscheckError as error:
        ...     print(error)
        runs is 0; needed: a whole number, 1 to 4294967296
    """

    def __init__(self, message: str) -> None:
        from newton_euler.errors import one_line  # which the command line starts without

        super().__init__(one_line(message))


def short_of_memory(error: BaseException | None) -> bool:
    """True if an error, or one that it comes from, is that memory or threads are not to be had."""
    while error is not None:
        if isinstance(error, MemoryError) or getattr(error, "errno", None) in (errno.ENOMEM, errno.EAGAIN):
            return True
        if any(words in str(error) for words in NO_MEMORY):
            return True
        error = error.__cause__ or error.__context__
    return False


def reason_of(error: Exception) -> str:
    """Word an error in one line; one that nobody foresaw has its type named."""
    from newton_euler.errors import NewtonEulerError  # which the command line starts without

    if isinstance(error, CrosscheckError | NewtonEulerError):
        text = str(error)
    elif short_of_memory(error):
        text = f"not enough memory: {error}" if str(error) else "not enough memory"
    elif isinstance(error, OSError) and error.filename is not None:
        text = f"cannot use {error.filename}: {error.strerror}"
    else:
        text = f"internal error: {type(error).__name__}: {error}"
    return " ".join(text.split())
