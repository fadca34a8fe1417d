"""Calls of Exudyn: without its messages, and with unchanged exceptions of Python functions that it calls."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import exudyn as exu


@contextmanager
def exudyn_calls() -> Iterator[None]:
    """Silence Exudyn within a block, and raise exceptions of Python functions that Exudyn calls unchanged.

    Exudyn wraps such an exception in an error of its own, even the interrupt of the user or of a time limit.
    Exudyn's settings of messages hold for the whole process. They are restored after the block for models
    that the user builds in Exudyn.
    """
    config, origin = exu.config, None
    before = config.printToConsole, config.suppressWarnings
    config.printToConsole, config.suppressWarnings = False, True
    try:
        yield
    except exu.ExudynError as error:
        origin = error.__cause__
        if origin is None:
            raise
        error.__cause__ = None  # this error, which names the function, becomes the context of its cause
    finally:
        config.printToConsole, config.suppressWarnings = before
    if origin is not None:
        raise origin
