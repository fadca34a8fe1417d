"""Elements of a scene that an engine cannot express, found before its model is built."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene


@dataclass(frozen=True)
class Limit:
    """Element of a scene that an engine cannot express.

    Attributes:
        element: the element, such as "joint 'lead'".
        reason: why the engine cannot express it, such as "screw joints are not in Exudyn".
    """

    element: str
    reason: str

    def __str__(self) -> str:
        return f"{self.element}: {self.reason}"


class CannotExpressError(NewtonEulerError):
    """A scene with elements that an engine cannot express; the message has the first one.

    Attributes:
        engine: name of the engine.
        limits: the elements, one or more.
    """

    def __init__(self, engine: str, limits: Sequence[Limit]) -> None:
        self.engine, self.limits = engine, tuple(limits)
        more = f" (and {len(limits) - 1} more)" if len(limits) > 1 else ""
        super().__init__(f"{engine} cannot express {limits[0]}{more}")

    def __reduce__(self) -> tuple[type[CannotExpressError], tuple[str, tuple[Limit, ...]]]:
        """Return how to construct the error again when it is unpickled in another process."""
        return type(self), (self.engine, self.limits)


def no_limits(scene: Scene) -> Sequence[Limit]:
    """Return no limits: the engine can express every scene, or finds out when it builds its model."""
    return ()


def require_expressed(engine: str, limits: Sequence[Limit]) -> None:
    """Raise a `CannotExpressError` if there are limits."""
    if limits:
        raise CannotExpressError(engine, limits)
