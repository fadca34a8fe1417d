"""Measure the round-off error of the rates, so that DOP853 does not shorten its steps because of round-off.

Rates are the time derivatives of the state. Their round-off adds to the error estimate of a step in
proportion to the step size. Over a run the sum of these errors is the same for steps of any length, so
shorter steps gain nothing. In joint coordinates the round-off grows with the length of a chain: U. M.
Ascher, D. K. Pai, B. P. Cloutier, Forward dynamics, elimination methods and formulation stiffness in robot
simulation, Int. Journal of Robotics Research 16(6), 1997. `newton_euler.integrators.dop853` measures if an
error estimate looks like noise.

Functions marked `native` are compiled to machine code by `newton_euler.codegen`; they also run as plain
Python. A `Vector` belongs to one run, a `Shared` vector to all runs that are integrated side by side.
"""

from __future__ import annotations

from newton_euler.codegen.native import Shared, Vector, native
from newton_euler.integrators.singular import evaluate
from newton_euler.integrators.status import Status
from newton_euler.integrators.stepper import EPS, Equations

ROUGH_ERROR_RATIO = 300.0
"""Ratio of the squared error estimates of orders 3 and 5 of DOP853, below which both may be round-off.

Round-off alone gives 12, within a factor of 10. 12 is the squared ratio of the lengths of the two vectors of
weights, `ERROR_3` and `ERROR_5` of `newton_euler.integrators.dop853_tableau`. The true error of the method
gives a larger ratio, which grows as the step gets shorter."""

ROUND_OFF_MARGIN = 3.0
"""Round-off of the rates that a step is assumed to have, in units of the measured round-off."""

STEPS_TO_NEXT_MEASUREMENT = 24.0
"""Number of steps with an error ratio below `ROUGH_ERROR_RATIO` that are not measured after a measurement
without round-off. Steps at the limit of stability have such ratios, too. The three evaluations of a
measurement in 24 steps are 1 % of all evaluations."""

SAMPLE_DECAY = 0.97
"""Factor for earlier samples of the round-off at each new sample. The largest of them counts, because a
single sample may be small by chance."""


@native
def measure_round_off(
    system: Equations,
    h: float,
    now: Vector,
    units: Shared,
    at: Vector,
    rates: Vector,
    scratch: Vector,
    round_off: Vector,
) -> Status:
    """Measure the round-off of the rates at the start of a step; return a status.

    The rates are evaluated at two states that differ from the start by one unit of round-off, in opposite
    directions. The mean of both changes of the rates cancels linear effects of these differences, such as the
    force of a stiff spring. A third evaluation shows what the round-off of the accelerations adds to the
    rates of coordinates within the step. The state at the end of the step is not used: if the step is much
    too long, this state is meaningless.

    Args:
        system: equations of motion.
        h: size of the step, s.
        now: state with time and parameters at the start of the step: one vector (inputs,), see
            `newton_euler.integrators.stepper`.
        units: (n,) natural magnitudes of the state, SI. An element that is smaller than its natural magnitude
            is assumed to have the round-off of this magnitude.
        at: as `now`, with the parameters of the run; state and time are overwritten.
        rates: (n,) rates at `now`.
        scratch: 3 (n + 1) numbers: `evaluate` returns n rates and a pivot ratio for each of three states.
        round_off: (n,) round-off of the rates, SI; updated by the new sample.
    """
    n = system.n
    lower = scratch[n + 1 :]
    moved = scratch[2 * (n + 1) :]
    # rates at two states, above and below the start by one unit of round-off
    at[n] = now[n]
    for i in range(n):
        change = EPS * max(abs(now[i]), units[i])
        at[i] = now[i] + change if i % 2 == 0 else now[i] - change
    status = evaluate(system, at, scratch)
    if status != Status.DONE:
        return status
    for i in range(n):
        at[i] = now[i] - (at[i] - now[i])
    status = evaluate(system, at, lower)
    if status != Status.DONE:
        return status
    # sample: mean change of the rates; then the rates at the state that this change leads to over the step
    for i in range(n):
        scratch[i] = 0.5 * ((scratch[i] - rates[i]) + (lower[i] - rates[i]))
        at[i] = now[i] + h * scratch[i]
    status = evaluate(system, at, moved)
    if status != Status.DONE:
        return status
    # keep the larger of the sample and the decayed earlier samples
    for i in range(n):
        sample = abs(scratch[i])
        if i < system.nq:
            sample = max(sample, abs(moved[i] - rates[i]))
        round_off[i] = max(SAMPLE_DECAY * round_off[i], sample)
    return Status.DONE
