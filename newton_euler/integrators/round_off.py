"""Round-off of the rates, which no step size changes, measured where an error estimate looks like noise.

Round-off of the rates adds to the error estimate of a step in proportion to the step size. Over a run the sum
is the same for steps of any length, so that shorter steps gain nothing. In joint coordinates the round-off
grows with the length of a chain: U. M. Ascher, D. K. Pai, B. P. Cloutier, Forward dynamics, elimination
methods and formulation stiffness in robot simulation, Int. Journal of Robotics Research 16(6), 1997.

Written for native code, see `newton_euler.codegen.native`; it runs as plain Python as well.
"""

from __future__ import annotations

from newton_euler.codegen.native import Shared, Vector, native
from newton_euler.integrators.singular import evaluate
from newton_euler.integrators.status import Status
from newton_euler.integrators.stepper import EPS, Equations

ROUGH_ERROR_RATIO = 300.0
"""Ratio of the squared error estimates of orders 3 and 5 below which both may be round-off. Round-off alone
gives 12, the squared ratio of the lengths of the two rows of coefficients, within a factor of 10. Errors of
the method give more the shorter a step is."""

ROUND_OFF_MARGIN = 3.0
"""Factor between a measured sample of the round-off of the rates and the round-off that a step may have."""

STEPS_TO_NEXT_MEASUREMENT = 24.0
"""Steps that look like round-off, as those at the limit of stability do, until round-off is measured again
after it was none: three evaluations in 24 steps are 1 % of all."""

SAMPLE_DECAY = 0.97
"""Factor by which an earlier sample of the round-off counts at each new one: single samples may be small."""


@native
def measure_round_off(
    system: Equations,
    h: float,
    now: Vector,
    units: Shared,
    at: Vector,
    rates: Vector,
    spare: Vector,
    round_off: Vector,
) -> Status:
    """Measure the round-off of the rates (n,) at the start of a step of size h; returns a status.

    The rates are evaluated again at two states that are changed by their own round-off, one up and one down.
    What is linear in the change cancels, as the force of a stiff spring. The rates of coordinates are
    evaluated once more at a state changed by what round-off of the rates adds within the step. The end of the
    step would not do: if the step is much too long, the state there is anything.

    Args:
        now: state at the start, with time and parameters.
        units: (n,) of the state, SI: numbers below their unit have the absolute round-off of the unit.
        at: a state with time and parameters, scratch.
        rates: (n,) at `now`.
        spare: 3 (n + 1) numbers, scratch.
        round_off: (n,) of the rates, SI; its earlier values count, too.
    """
    n = system.n
    lower = spare[n + 1 :]
    moved = spare[2 * (n + 1) :]
    at[n] = now[n]
    for i in range(n):
        change = EPS * max(abs(now[i]), units[i])
        at[i] = now[i] + change if i % 2 == 0 else now[i] - change
    status = evaluate(system, at, spare)
    if status != Status.DONE:
        return status
    for i in range(n):
        at[i] = now[i] - (at[i] - now[i])
    status = evaluate(system, at, lower)
    if status != Status.DONE:
        return status
    for i in range(n):
        spare[i] = 0.5 * ((spare[i] - rates[i]) + (lower[i] - rates[i]))
        at[i] = now[i] + h * spare[i]
    status = evaluate(system, at, moved)
    if status != Status.DONE:
        return status
    for i in range(n):
        sample = abs(spare[i])
        if i < system.nq:
            sample = max(sample, abs(moved[i] - rates[i]))
        round_off[i] = max(SAMPLE_DECAY * round_off[i], sample)
    return Status.DONE
