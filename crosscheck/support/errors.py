"""The base class of crosscheck's errors, and the one line that the user reads about any error."""

from __future__ import annotations

import errno

NO_MEMORY = ("failed to map segment", "llocate", "start new thread", "spawn background thread", "bad_alloc")
"""Parts of messages by which NumPy, LLVM, Rerun and other libraries report a lack of memory or of threads;
"llocate" is part of both "allocate" and "Allocate"."""


class CrosscheckError(Exception):
    """Base class of all errors that crosscheck raises on purpose; the message is a single line.

    Examples:
        >>> try:
        ...     sweep("pendulum", {"dumbbell.mass": "normal(1, 0.1)"}, runs=0, keep="peak:reaction_force")
        ... except CrosscheckError as error:
        ...     print(error)
        runs is 0; needed: a whole number, 1 to 4294967296
    """

    def __init__(self, message: str) -> None:
        from newton_euler.errors import one_line  # imported here so that the command line starts faster

        super().__init__(one_line(message))


def short_of_memory(error: BaseException | None) -> bool:
    """Return True if an error, or an error that caused it, reports a lack of memory or of threads."""
    seen = set[int]()  # causes may form a circle
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        if isinstance(error, MemoryError) or getattr(error, "errno", None) in (errno.ENOMEM, errno.EAGAIN):
            return True
        if any(words in str(error) for words in NO_MEMORY):
            return True
        error = error.__cause__ or error.__context__
    return False


def reason_of(error: Exception) -> str:
    """Describe an error in one line; an unexpected one as "internal error" with the name of its class."""
    from newton_euler.errors import NewtonEulerError  # imported here so that the command line starts faster

    if isinstance(error, CrosscheckError | NewtonEulerError):
        text = str(error)
    elif short_of_memory(error):
        text = f"not enough memory: {error}" if str(error) else "not enough memory"
    elif isinstance(error, OSError) and error.filename is not None:
        text = f"cannot use {error.filename}: {error.strerror}"
    else:
        text = f"internal error: {type(error).__name__}: {error}"
    return " ".join(text.split())
