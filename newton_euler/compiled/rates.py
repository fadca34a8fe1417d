"""Integration of first-order differential equations dy/dt = f(y) that Python evaluates.

In: a function for the rates, and a start. Out: the state at the end of each step of DOP853. Mechanisms with
loops, projection and singular configurations need `newton_euler.compiled.evaluated` instead.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from newton_euler.compiled.callbacks import Callbacks, raise_fatal, vector_at
from newton_euler.compiled.records import dop853_of
from newton_euler.compiled.run import native_method
from newton_euler.integrators.constraint_ratio import no_ratio
from newton_euler.integrators.dense_projection import closing_of
from newton_euler.integrators.dop853 import integrate_dop853
from newton_euler.integrators.options import Options
from newton_euler.integrators.row_exchange import no_exchange
from newton_euler.integrators.stepper import COUNTS, Count, Equations, Table
from newton_euler.integrators.switches import no_switches
from newton_euler.scalars import Array


def integrate_rates(
    rates: Callable[[Array], Array], start: Array, duration: float, options: Options, max_steps: int
) -> tuple[Array, Array]:
    """Integrate dy/dt = f(y) by DOP853, as far as a number of steps reaches.

    Args:
        rates: the function f, of a state (n,).
        start: (n,) state at time 0.
        duration: s, of the run.
        options: tolerances.
        max_steps: largest number of steps, rejected ones included.

    Returns:
        (steps + 1,) times, s, and (steps + 1, n) states at the start and at the end of each step. The last
        time is before the duration if the steps do not suffice, or if the rates become infinite.

    Examples:
        >>> times, states = integrate_rates(lambda y: -y, np.ones(1), 1.0, Options(), max_steps=100)
        >>> bool(abs(states[-1, 0] - np.exp(-times[-1])) < 1e-9)
        True
    """
    n = len(start)
    callbacks = Callbacks(np.zeros(COUNTS))

    # `on` is native code's bit mask of active runs, not needed for a single run
    def evaluate(x: int, y: int, on: int) -> None:
        """Write the rates of the state at address x to address y, followed by the pivot ratio 1."""
        vector_at(y, n + 1)[:] = np.append(rates(vector_at(x, n).copy()), 1.0)

    def failed(y: int, on: int) -> None:
        """Mark the rates at address y as missing."""
        vector_at(y, n + 1)[:] = np.nan

    derivative = callbacks.guarded(evaluate, failed)
    no_rows: tuple[list[int], list[int]] = [], []
    system = Equations(
        n=n,
        nq=n,
        inputs=n + 1,
        flags=0,
        derivative=derivative,
        dense=derivative,
        loses_rank=0,
        ratio=no_ratio(),
        projecting=0,
        tolerance=0.0,
        open_tolerance=0.0,
        lanes=1,
        position=None,
        velocity=None,
        closing=closing_of(n, np.zeros(0), n + 1, no_rows, 0, (None, None)),
        exchange=no_exchange(n + 1),
        switches=no_switches(),
        projection_work=np.zeros(2 * n + 4),
        pause=callbacks.pause,
        marks=np.zeros(n),
        groups=0,
        members=np.zeros(0),
        counts=callbacks.counts,
    )
    end = np.append(start, 0.0)
    table = Table(
        count=2,
        output_state_size=n,
        runs=1,
        stride=1,
        first=np.zeros(1),
        times=np.array([0.0, duration]),
        ends=end[None],
        states=np.zeros((2, n)),
        tallies=np.zeros((1, COUNTS)),
    )
    tolerances = options.rtol, options.atol
    steps = np.zeros((max_steps, n + 2))  # state, time and size of each step
    method = dop853_of(n, n + 1, options, tolerances, max_steps, np.zeros(n), steps)
    with callbacks.interruptible(), np.errstate(all="ignore"):  # the integrator rejects infinite numbers
        native_method(integrate_dop853)(integrate_dop853, system, table, method)
    raise_fatal(callbacks)
    found = np.vstack([steps[: int(callbacks.counts[Count.STEPS]), : n + 1], end])
    return found[:, n], found[:, :n]
