"""Divide engines into those that can be used for a purpose and the others, whose reasons are kept."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from crosscheck.engines.engine import Engine
from crosscheck.engines.limits import require_expressed
from crosscheck.engines.registry import ENGINES, EngineError
from crosscheck.support.errors import CrosscheckError, reason_of
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene

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
    errors = {engine.name: failure(engine, use) for engine in engines}
    reasons = {name: error for name, error in errors.items() if error}
    if len(reasons) == len(engines):
        raise reasons[engines[0].name]
    return [engine for engine in engines if engine.name not in reasons], reasons


def failure(engine: Engine, use: Callable[[Engine], object]) -> CrosscheckError | NewtonEulerError | None:
    """Try one engine as `divide` does, and return the error; None if the engine can be used."""
    try:
        use(engine)
    except (CrosscheckError, NewtonEulerError) as error:
        return error
    except Exception as error:
        if engine.name in ENGINES:
            raise
        # a fault of another package leaves the other engines untouched
        return EngineError(f"{engine.name}: {reason_of(error)}")
    return None


def require_scene(engine: Engine, scene: Scene) -> None:
    """Raise a `CannotExpressError` if an engine cannot express a scene."""
    require_expressed(engine.name, engine.limits(scene))
