"""Comparison of an engine's runs with reference values: published or exact results of scenes of the library.

In: a scene of the library, an engine and its run. Out: one `ReferenceCheck` for each reference value. A
reference value is the value of one quantity (such as an angle) at one time, with an uncertainty; the values
are in `crosscheck/library/references`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from crosscheck.compare.check import ERROR_PER_CHANGE, REFERENCE, Check
from crosscheck.engines.engine import MAX_RELATIVE_ERROR, Engine
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
    """Check of an engine's result against a reference value. The inherited `value` is the difference.

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
            own_error: integration error of the engine. The tolerance is the sum of this error and the
                uncertainty of the reference value.
        """
        return cls(
            level=REFERENCE,
            quantity=known.quantity,
            between=(engine,),
            value=abs(result - known.value),
            tolerance=known.uncertainty + own_error,
            where=f"{engine} at {known.time:g} s",
            known=known,
            result=result,
        )

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
    known_options = options_of(SCENES[source])
    # values as the scene reads them, since a number has several texts, such as "2" and "2.0"
    chosen = {name: each.read(options.get(name, each.default)) for name, each in known_options.items()}
    return [
        known
        for known in reference_values(source)
        if all(chosen[name] == known_options[name].read(value) for name, value in known.options.items())
    ]


def measure(
    source: str, scene: Scene, engine: Engine, run: Trajectory, known: list[ReferenceValue]
) -> Iterator[ReferenceCheck]:
    """Compare an engine with all reference values of a scene.

    The integration error of the engine is estimated from two runs, the second with ten or a hundred times
    looser tolerances or with twice the step. The error is `ERROR_PER_CHANGE` times the largest difference of
    the two runs up to the time of the reference value. It is at most `MAX_RELATIVE_ERROR` times the largest
    value of the quantity; round-off is added.

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
        quantity = REFERENCE_QUANTITIES[source][entry.quantity]  # function of a run
        values = _values(quantity, fine)[: n + 1]
        change = float(np.max(np.abs(values - _values(quantity, coarse)[: n + 1])))
        scale = float(np.max(np.abs(values)))
        own_error = min(ERROR_PER_CHANGE * change, MAX_RELATIVE_ERROR * scale) + STEPS_ROUND_OFF * scale
        yield ReferenceCheck.of(engine.name, entry, float(values[n]), own_error)


def _values(quantity: Quantity, run: Trajectory) -> Array:
    """Compute a quantity at all output times of a run, (n,)."""
    values = quantity(run)
    assert values.shape == run.time.shape
    return values


def _two_runs(scene: Scene, engine: Engine, run: Trajectory) -> tuple[Trajectory, Trajectory]:
    """Return the engine's two most accurate runs, the more accurate one first.

    From the most to the least accurate, the runs are `Engine.exact` (which not every engine has),
    `Engine.refined` and `run`, the run with default settings. Near a singular configuration the runs with
    tight tolerances may stop because of round-off; then the next less accurate ones are used.

    Raises:
        NewtonEulerError: the error of the refined run, if `run` is the only run that completes.
    """
    if engine.exact is not None:
        with suppress(NewtonEulerError):
            exact = engine.simulate(scene, engine.exact)
            try:
                return exact, engine.refined(scene)
            except NewtonEulerError:
                return exact, run
    return engine.refined(scene), run
