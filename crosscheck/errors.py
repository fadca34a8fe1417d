"""The errors of the harness."""

from __future__ import annotations


class CrosscheckError(Exception):
    """Base of every error that `crosscheck` raises on purpose; reads as one line."""


def reason_of(error: Exception) -> str:
    """What to say of an error, in one line; one that nobody foresaw has its type named."""
    from newton_euler.errors import NewtonEulerError  # which the command line starts without

    foreseen = isinstance(error, CrosscheckError | NewtonEulerError)
    text = str(error) if foreseen else f"internal error: {type(error).__name__}: {error}"
    return " ".join(text.split())
