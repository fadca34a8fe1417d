"""Runs of compiled scenes from sample to sample: controllers in Python, what lies between in native code."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

import numpy as np

from newton_euler.compiled import Code
from newton_euler.control import is_finite_number
from newton_euler.errors import IntegrationError
from newton_euler.integrate import Options
from newton_euler.parameters import place_of
from newton_euler.scalars import Array
from newton_euler.steppers.run import march, outputs


def march_sampled(code: Code, x: Array, options: Options) -> tuple[dict[str, Array], dict[str, int]]:
    """The arrays that the scene asks for at its output times, and the counts of all marches.

    At a sampling instant the new force holds already. `x` (inputs,) is the start; it ends up at the end.
    """
    times = code.scene.times
    if not code.scene.sampled:
        table, counts = march(code, x, times, options)
        return outputs(code, x, times, table), counts
    parts: list[dict[str, Array]] = []
    total: Counter[str] = Counter()
    for begin, end in pairwise(instants(code, float(times[-1]))):
        sample(code, x, begin)
        last = end == times[-1]
        due = times[(times >= begin) & ((times < end) | last)]
        stops = np.union1d(due, [begin, end])
        table, counts = march(code, x, stops, options)
        parts.append(outputs(code, x, due, table[np.isin(stops, due)]))
        total.update(counts)
    arrays = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return arrays, dict(total)


def instants(code: Code, end: float) -> list[float]:
    """When some controller is due, from 0 on, and the end."""
    laws = code.scene.sampled
    due = {0.0, *(k * law.period for law in laws for k in range(int(np.ceil(end / law.period))))}
    return [*sorted(t for t in due if t < end * (1.0 - 1e-12)), end]


def sample(code: Code, x: Array, time: float) -> None:
    """Call the controllers that are due at a time, and write their forces into x (inputs,).

    Raises:
        IntegrationError: for a controller that fails, or returns something else than a finite number.
    """
    seen = code.function("measured")(x)
    coordinates, rates = np.split(seen, 2)
    for law in code.scene.sampled:
        if abs(time / law.period - round(time / law.period)) > 1e-9:
            continue
        try:
            force = law.controller(time, coordinates.copy(), rates.copy())
        except Exception as error:
            reason = f"controller of joint {law.joint!r} failed: {type(error).__name__}: {error}"
            raise IntegrationError(time, reason) from error
        if not is_finite_number(force):
            raise IntegrationError(time, f"controller of joint {law.joint!r} returned {force!r}")
        x[code.place(f"{place_of(law)}.held")] = force
