"""Divide engines into those that can be used for a purpose and the others, whose reasons are kept."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from crosscheck.engines.engine import Engine
from crosscheck.engines.registry import ENGINES, EngineError
from crosscheck.support.errors import CrosscheckError, reason_of
from newton_euler.errors import NewtonEulerError

Reasons = dict[str, CrosscheckError | NewtonEulerError]
"""Errors of the engines that cannot be used, by name."""


def divide(engines: Sequence[Engine], use: Callable[[Engine], object]) -> tuple[list[Engine], Reasons]:
    """Try each engine, and return those that can be used, with the errors of the others.

    Args:
        engines: the engines.
        use: function that needs the engine, and raises an error if the engine cannot be used.

    Raises:
        CrosscheckError, NewtonEulerError: the error of the first engine, if no engine can be used.
        Exception: any other error of a default engine, which is a fault of this project.
    """
    usable, reasons = list[Engine](), Reasons()
    for engine in engines:
        try:
            use(engine)
        except (CrosscheckError, NewtonEulerError) as error:
            reasons[engine.name] = error
        except Exception as error:
            if engine.name in ENGINES:
                raise
            # a fault of another package leaves the other engines untouched
            reasons[engine.name] = EngineError(f"{engine.name}: {reason_of(error)}")
        else:
            usable.append(engine)
    if not usable:
        raise reasons[engines[0].name]
    return usable, reasons
