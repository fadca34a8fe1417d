"""Comparison of an engine's runs with reference values: published or exact results of scenes of the library.

In: a scene of the library, an engine and its run. Out: one `ReferenceCheck` for each reference value. The
reference values are in `crosscheck/library/references`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from crosscheck.compare.check import OWN_ERROR, REFERENCE, Check
from crosscheck.engines.engine import UNRESOLVED, Engine
from crosscheck.library import REFERENCE_QUANTITIES, SCENES
from crosscheck.library.measure import Quantity
from crosscheck.library.options import options_of
from crosscheck.library.references import ReferenceValue, reference_values
from crosscheck.support.errors import CrosscheckError
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

STEPS_ROUND_OFF = 1e-14
"""Round-off of some thousand integration steps, relative to the largest value."""


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
        """Make the check of one result.

        Args:
            engine: name of the engine.
            known: the reference value.
            result: value in the engine's most accurate run.
            own_error: error of the engine; the tolerance is this plus the uncertainty of the reference.
        """
        tolerance, where = known.uncertainty + own_error, f"{engine} at {known.time:g} s"
        error = abs(result - known.value)
        return cls(REFERENCE, known.quantity, (engine,), error, tolerance, where, known=known, result=result)

    @property
    def engine(self) -> str:
        """Name of the engine."""
        return self.between[0]

    def summary(self) -> dict[str, Any]:
        """Reference value, result and difference, for JSON."""
        measured = {"value": self.result, "difference": self.value, "allowed": self.tolerance}
        known = {"reference" if key == "value" else key: x for key, x in asdict(self.known).items()}
        return {"engine": self.engine} | known | measured | {"agrees": self.agrees}


def known_of(source: str, options: Mapping[str, str | float]) -> list[ReferenceValue]:
    """Return the reference values of a scene for given options; empty if the scene is not of the library.

    Args:
        source: name of the scene in the library, or the path of a file.
        options: options that the user set.
    """
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
    """Compare an engine with all reference values of a scene.

    The engine's own error is measured by two runs, the second with ten or a hundred times looser tolerances
    or with twice the step. It is `OWN_ERROR` times the largest difference up to the time of the reference
    value, at most `UNRESOLVED` times the largest value, plus round-off.

    Args:
        source: name of the scene in the library.
        scene: the scene.
        engine: the engine.
        run: the engine's run with default settings.
        known: reference values, see `known_of`.

    Raises:
        CrosscheckError: for a reference value at a time that is no output time.
        NewtonEulerError: if the engine's refined run fails.
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
        own_error = min(OWN_ERROR * change, UNRESOLVED * scale) + STEPS_ROUND_OFF * scale
        yield ReferenceCheck.of(engine.name, entry, float(values[n]), own_error)


def _values(figure: Quantity, run: Trajectory) -> Array:
    values = figure(run)
    assert values.shape == run.time.shape
    return values


def _two_runs(scene: Scene, engine: Engine, run: Trajectory) -> tuple[Trajectory, Trajectory]:
    """Return the engine's two most accurate runs, the more accurate one first.

    Near a singular configuration runs with tight tolerances may stop because of round-off; then the less
    accurate ones are used. `run` is the run with default settings. If no other run completes, the error
    cannot be measured, and the error of the refined run is raised.
    """
    if engine.exact is not None:
        with suppress(NewtonEulerError):
            exact = engine.exact(scene)
            try:
                return exact, engine.refined(scene)
            except NewtonEulerError:
                return exact, run
    return engine.refined(scene), run
