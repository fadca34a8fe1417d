"""Explanations of runs that could not go on: time, reason, fastest joint, largest force."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from newton_euler.compiled.equations import CompiledEquations
from newton_euler.equations.applied_forces import blamed
from newton_euler.equations.dense import largest_share, singular_values
from newton_euler.equations.system import dimensionless_jacobian, fastest_joint
from newton_euler.integrators.fixed_step import RK4_LIMIT
from newton_euler.integrators.options import Options, most_steps
from newton_euler.integrators.projection import worst_joint
from newton_euler.integrators.singular import FAR_PIVOT_RATIO, NEAR_PIVOT_RATIO
from newton_euler.integrators.status import Status
from newton_euler.integrators.stepper import Count
from newton_euler.model.trajectory import IntegrationError, UndeterminedStartError
from newton_euler.scalars import Array

STABILITY_LIMITS = {"RK4": RK4_LIMIT, "Euler": 2.0}
"""Largest product of a rate of the motion and a step that is stable; that of Euler's method is of an
oscillation without damping (E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, second edition,
Springer 2006, section I.1)."""

DIFFERENCE_STEP = 1e-7
"""Relative difference of coordinates and velocities, absolute for those below 1, for difference quotients."""

UNSTABLE_STATUSES = (Status.NOT_FINITE, Status.OPEN, Status.STRAYING)
"""Statuses of runs that end so if their fixed step is too long."""

LEFT_MOTION_FACTOR = 30.0
"""Factor by which rates exceed the limit of stability, from one step to the next, in a run that has left its
motion. Chosen between the 1.5 and the 100 or more of runs of light links in loops."""

EXAMINED_FROM_END = (1, 2, 4, 16, 64)
"""Numbers, from the end, of the states of a run that are examined for rates that make a step too long."""

POWER_ITERATIONS = 40
"""Steps of the power iteration for the fastest rate; the second half of them is used."""


@np.errstate(all="ignore")  # of what is not finite the message tells
def failure(
    code: CompiledEquations,
    options: Options,
    status: int,
    states: Sequence[Array],
    counts: Array,
    error: Exception | None,
) -> IntegrationError:
    """Explain a run that could not go on: time, reason, fastest joint, largest force.

    Args:
        options: the method, and the steps that it might take.
        status: how the run ended.
        states: (inputs,) states of the run with time and parameters, the last one where it ended. Of a run by
            fixed steps there are some before.
        counts: of the run, see `newton_euler.integrators.stepper`.
        error: of the equations in Python, if one ended the run.
    """
    x = states[-1]
    system, reached = code.float_system(x), float(counts[Count.TIME_REACHED])
    q, v = x[: system.nq], x[system.nq : code.size]
    state = system.state(q, v)
    if error is not None:
        reason = str(error)
    elif status in UNSTABLE_STATUSES and (found := _instability(code, options, states[:-1])):
        reason = found
    elif status == Status.OPEN:
        joint, residual = worst_joint(system, state)
        reason = Status.OPEN.message.format(joint=joint, residual=residual)
        reason += "; a shorter step, or DOP853, may pass" if options.step is not None else ""
    else:
        reason = _reason(code, options, Status(status), x)
    stopped = UndeterminedStartError if status == Status.UNDETERMINED else IntegrationError
    return stopped(reached, blamed(system.scene, state, reason, system.seen(q, v)))


def _instability(code: CompiledEquations, options: Options, states: Sequence[Array]) -> str:
    """Say that a fixed step is too long for the rates of the motion; empty if no state shows that.

    The state where rates first exceed the limit counts: later ones may be those of a run that has left the
    motion. So may be that one, if its rates are far beyond the limit and it is not the start: they are not
    quoted. States near a singular configuration do not count: rates have no bound there.
    """
    if options.step is None:
        return ""

    def rate_at(number: int) -> float:
        x = states[number]
        return fastest_rate(code, x) if code.pivot_ratio(x) > FAR_PIVOT_RATIO else 0.0

    limit = STABILITY_LIMITS[options.integrator]
    too_long = f"step={options.step:g} s is too long for {options.integrator}"
    number, rate = first_above(rate_at, len(states), limit / options.step)
    if number > 0 and rate * options.step > LEFT_MOTION_FACTOR * limit:
        return f"{too_long}: the run leaves its motion; use a shorter step, or DOP853, which chooses its own"
    if rate * options.step > limit:
        return (
            f"{too_long}, which is unstable above {limit / rate:.2g} s at rates of {rate:.2g} 1/s; "
            f"use step={0.5 * limit / rate:.1g}, or Radau or DOP853, which choose their steps"
        )
    return ""


def first_above(rate_at: Callable[[int], float], count: int, limit: float) -> tuple[int, float]:
    """Find a state with a rate above the limit, next to one whose rate is not; its number and its rate.

    The start is examined, then some of the last states, then states between, by bisection: a rate costs as
    many evaluations as ten steps of RK4. If no rate is above the limit, the rate is 0.

    Args:
        rate_at: rate of a state by number.
        count: of states.
    """
    first, last, rate = 0, 0, 0.0
    for number in dict.fromkeys([0, *(count - back for back in EXAMINED_FROM_END)]):
        if 0 <= number < count and rate <= limit:
            last, rate = number, rate_at(number)
    if rate <= limit:
        return 0, 0.0
    while last - first > 1:
        middle = (first + last) // 2
        found = rate_at(middle)
        if found > limit:
            last, rate = middle, found
        else:
            first = middle
    return last, rate


def fastest_rate(code: CompiledEquations, x: Array) -> float:
    """Estimate the largest magnitude, 1/s, of an eigenvalue of the motion linearized at x (inputs,).

    By power iteration with one-sided differences of the compiled rates. The mean growth over many steps is
    the magnitude also where the eigenvalues are complex. 0 if numbers are not finite.
    """
    derivative, n = code.function("derivative"), code.size
    at, units = derivative(x)[:n], DIFFERENCE_STEP * np.maximum(1.0, np.abs(x[:n]))
    direction, growth = np.random.default_rng(0).standard_normal(n), np.zeros(POWER_ITERATIONS)
    for k in range(POWER_ITERATIONS):
        moved = x.copy()
        moved[:n] += units * direction
        direction = (derivative(moved)[:n] - at) / units
        size = float(np.linalg.norm(direction))
        if not 0.0 < size < np.inf:
            return 0.0
        direction, growth[k] = direction / size, np.log(size)
    return float(np.exp(np.mean(growth[POWER_ITERATIONS // 2 :])))


def _reason(code: CompiledEquations, options: Options, status: Status, x: Array) -> str:
    """Complete the message of a status: with the singular configuration near x (inputs,), or with advice."""
    is_singular = status in (Status.STRAYING, Status.UNDETERMINED, Status.UNPROJECTED)
    near = is_singular or code.pivot_ratio(x) < NEAR_PIVOT_RATIO
    joint, value = nearly_dependent(code, x) if near else ("", 0.0)
    place = f"a singular configuration, where joint {joint!r} loses rank"
    reason = status.message.format(max_steps=most_steps(options), place=place)
    if status not in (Status.TOO_MANY_STEPS, Status.STEP_TOO_SMALL):
        return reason
    if near:
        remedy = "a larger one, up to 1e-8, may pass, unless dimensions miss that configuration by more"
        noise = f"round-off near {place} (singular value {value:.1e}), is larger than rtol allows"
        return f"{reason}; {noise}; {remedy}"
    return f"{reason}; for stiff equations use Radau" if options.integrator == "DOP853" else reason


def singular_joint(code: CompiledEquations, x: Array) -> str:
    """Find the joint or gear that weighs most in the constraint rows that are nearest to dependent."""
    return nearly_dependent(code, x)[0]


def nearly_dependent(code: CompiledEquations, x: Array) -> tuple[str, float]:
    """Return `singular_joint` and the smallest singular value, dimensionless, of the constraint rows in use.

    Without constraints, the joint that moves fastest, and 1.
    """
    system, rows = code.float_system(x), code.rows_at(x).in_use
    if not rows:
        return fastest_joint(system.mechanism, system.state(x[: system.nq], x[system.nq : code.size])), 1.0
    jacobian = dimensionless_jacobian(system, x[: system.nq])
    combinations, values, _ = singular_values(jacobian[rows])
    return largest_share([system.row_owners[row] for row in rows], combinations[:, -1]), float(values[-1])
