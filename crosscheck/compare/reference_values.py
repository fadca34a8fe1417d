"""Figures of a scene's runs against those that are known, see `crosscheck.library.references`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from crosscheck.compare.check import OWN_ERROR, REFERENCE, UNRESOLVED, Check
from crosscheck.engines.engine import Engine
from crosscheck.library import REFERENCE_QUANTITIES, SCENES
from crosscheck.library.measure import Quantity
from crosscheck.library.options import options_of
from crosscheck.library.references import ReferenceValue, reference_values
from crosscheck.support.errors import CrosscheckError
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

ROUND_OFF = 1e-14
"""Round-off of some thousand steps, relative to the largest value."""

Run = Callable[[Scene], Trajectory]


@dataclass(frozen=True)
class ReferenceCheck(Check):
    """Check of an engine's result against a reference value.

    Attributes:
        known: the reference value.
        result: value in the engine's most accurate run.
    """

    known: ReferenceValue = field(kw_only=True)
    result: float = field(kw_only=True)

    @classmethod
    def of(cls, engine: str, known: ReferenceValue, result: float, own_error: float) -> ReferenceCheck:
        """Make the check of a result whose engine has an error of `own_error`."""
        allowed, where = known.uncertainty + own_error, f"{engine} at {known.time:g} s"
        off = abs(result - known.value)
        return cls(REFERENCE, known.quantity, (engine,), off, allowed, where, known=known, result=result)

    @property
    def engine(self) -> str:
        return self.between[0]

    def summary(self) -> dict[str, Any]:
        """Reference value, result and difference, for JSON."""
        measured = {"value": self.result, "difference": self.value, "allowed": self.tolerance}
        known = {"reference" if key == "value" else key: x for key, x in asdict(self.known).items()}
        return {"engine": self.engine} | known | measured | {"agrees": self.agrees}


def known_of(source: str, options: Mapping[str, str | float]) -> list[ReferenceValue]:
    """The reference values of a scene of the library under the options set; none for a scene file."""
    if source not in REFERENCE_QUANTITIES:
        return []
    chosen = {name: str(option.default) for name, option in options_of(SCENES[source]).items()}
    chosen |= {name: str(value) for name, value in options.items()}
    return [
        known
        for known in reference_values(source)
        if all(chosen[name] == str(value) for name, value in known.options.items())
    ]


def measure(
    source: str, scene: Scene, engine: Engine, run: Trajectory, known: list[ReferenceValue]
) -> Iterator[ReferenceCheck]:
    """All reference values of a scene as an engine gives them.

    A check's own error is `OWN_ERROR` times what it changes until its time, at most, if tolerances are ten
    or a hundred times or steps twice as coarse, and round-off; but no more than `UNRESOLVED` of its largest
    value is excused.

    Args:
        source: the scene's name in the library.
        run: the engine's run at its defaults.
        known: as `known_of` gives them.

    Raises:
        CrosscheckError: for a check between the output times.
        NewtonEulerError: of the engine's finer run, where it can make none.
    """
    fine, coarse = _two_runs(scene, engine, run)
    for entry in known:
        n = int(np.argmin(np.abs(fine.time - entry.time)))
        if abs(fine.time[n] - entry.time) > 1e-9 * scene.output_period:
            raise CrosscheckError(f"scene {scene.name!r} has no output at {entry.time:g} s")
        figure = REFERENCE_QUANTITIES[source][entry.quantity]
        values = _values(figure, fine)[: n + 1]
        change = float(np.max(np.abs(values - _values(figure, coarse)[: n + 1])))
        scale = float(np.max(np.abs(values)))
        own_error = min(OWN_ERROR * change, UNRESOLVED * scale) + ROUND_OFF * scale
        yield ReferenceCheck.of(engine.name, entry, float(values[n]), own_error)


def _values(figure: Quantity, run: Trajectory) -> Array:
    values = figure(run)
    assert values.shape == run.time.shape
    return values


def _two_runs(scene: Scene, engine: Engine, run: Trajectory) -> tuple[Trajectory, Trajectory]:
    """The engine's most exact run and the next, out of those that it can make.

    Next to a singular configuration tolerances can be too tight for round-off. An engine that can make
    none but its usual run has nothing to tell its own error by.
    """
    if engine.exact is not None:
        with suppress(NewtonEulerError):
            exact = engine.exact(scene)
            try:
                return exact, engine.refined(scene)
            except NewtonEulerError:
                return exact, run
    return engine.refined(scene), run
