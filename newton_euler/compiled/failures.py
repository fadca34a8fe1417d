"""Error messages for runs that stop early: time, reason, fastest joint, largest force and a remedy.

An integrator reports only a status number. The functions here examine the last states of the run to find the
likely cause: a fixed step that is too long, a singular configuration, or stiff equations.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from newton_euler.compiled.equations import CompiledEquations
from newton_euler.equations.applied_forces import too_many_or_small_steps, with_likely_causes
from newton_euler.equations.dense import largest_share, singular_values
from newton_euler.equations.formulation import Formulation
from newton_euler.equations.load_friction import jam
from newton_euler.equations.system import dimensionless_jacobian, fastest_joint
from newton_euler.integrators.fixed_step import RK4_LIMIT
from newton_euler.integrators.options import Options, max_adaptive_steps
from newton_euler.integrators.projection import worst_joint
from newton_euler.integrators.singular import FAR_PIVOT_RATIO, NEAR_PIVOT_RATIO
from newton_euler.integrators.status import Status
from newton_euler.integrators.stepper import Count
from newton_euler.model.trajectory import IntegrationError, UndeterminedStartError
from newton_euler.scalars import Array

STABILITY_LIMITS = {"RK4": RK4_LIMIT, "Euler": 2.0}
"""Largest stable product of step and eigenvalue magnitude (1/s) of the linearized motion, by integrator.

The limit of semi-implicit Euler applies to an oscillation without damping (E. Hairer, C. Lubich, G. Wanner,
Geometric Numerical Integration, second edition, Springer 2006, section I.1)."""

DIFFERENCE_STEP = 1e-7
"""Step of difference quotients, relative to each coordinate or velocity; absolute for magnitudes below 1."""

UNSTABLE_STATUSES = (Status.NOT_FINITE, Status.OPEN, Status.STRAYING)
"""Statuses with which a run may end because its fixed step is too long.

`OPEN`: projection cannot close a joint. `STRAYING`: accelerations at the stages of one step contradict each
other."""

LEFT_MOTION_FACTOR = 30.0
"""Factor beyond the stability limit at which a rate is no property of the motion but of a diverged run.

A rate is an eigenvalue magnitude, 1/s, of the linearized motion. In tests with light links in loops, rates
are 1.5 times the limit before the run diverges, and 100 times the limit or more one step later."""

EXAMINED_FROM_END = (1, 2, 4, 16, 64)
"""States of a run, counted from its end, at which rates are computed first to find one above the limit."""

PASSING_RTOL = 1e-8
"""Relative tolerance with which runs of exact dimensions pass singular configurations: in tests with random
four-bars all runs pass, while at 1e-10 some runs in Cartesian coordinates stop."""

POWER_ITERATIONS = 40
"""Number of power iterations for the fastest rate; the result is averaged over the second half."""


@np.errstate(all="ignore")  # a run may have ended because its numbers are not finite
def failure(
    code: CompiledEquations,
    options: Options,
    status: int,
    states: Sequence[Array],
    counts: Array,
    error: Exception | None,
) -> IntegrationError:
    """Build the error of a run that stopped early: time, reason, fastest joint, largest force.

    Args:
        code: compiled equations of the scene.
        options: integrator and step control.
        status: how the run ended, a `Status`.
        states: vectors x (inputs,) of the run: state, time, flags of constraint rows (1 for a redundant row
            that is left out), parameters. The last one is where the run ended. Runs with a fixed step also
            have earlier ones.
        counts: (COUNTS,) counters of the run, see `newton_euler.integrators.stepper.Count`.
        error: exception of the equations in Python that ended the run, or None.
    """
    x = states[-1]
    system, reached = code.float_system(x), float(counts[Count.TIME_REACHED])
    q, v = x[: system.nq], x[system.nq : code.size]
    state = system.state(q, v)
    if error is not None:
        reason = str(error)
    elif (found := _jam(code, states)) or (
        status in UNSTABLE_STATUSES and (found := _instability(code, options, states[:-1]))
    ):
        reason = found
    elif status == Status.OPEN:
        joint, residual = worst_joint(system, state)
        reason = Status.OPEN.message.format(joint=joint, residual=residual)
        reason += "; a shorter step, or DOP853, may pass" if options.step is not None else ""
    else:
        reason = _reason(code, options, Status(status), x)
    error_class = UndeterminedStartError if status == Status.UNDETERMINED else IntegrationError
    surroundings = system.surroundings(q, v)  # the quantities that forces depend on
    return error_class(reached, with_likely_causes(system.scene, state, reason, surroundings))


def _jam(code: CompiledEquations, states: Sequence[Array]) -> str:
    """Describe the frictions that jam at the last state whose numbers are finite; "" for none.

    Args:
        code: compiled equations of the scene.
        states: vectors x (inputs,) of the run, in the order of time.
    """
    finite = (x for x in reversed(states) if np.all(np.isfinite(x[: code.size])))
    if not code.scene.switched_forces or (x := next(finite, None)) is None:
        return ""
    system = code.float_system(x)
    q, v = x[: system.nq], x[system.nq : code.size]
    return jam(system.scene, partial(system.loaded_friction, q, v), [q, v])


def _instability(code: CompiledEquations, options: Options, states: Sequence[Array]) -> str:
    """Report that a fixed step is too long for the fastest rate of the motion; empty if no state shows this.

    A rate is an eigenvalue magnitude, 1/s, of the linearized motion. The message has the first rate above the
    stability limit, because later states may belong to a diverged run. If this rate is far above the limit
    and its state is not the start, the run has probably diverged before, and the message has no rate. States
    near a singular configuration are ignored, because rates have no bound there.

    Args:
        code: compiled equations of the scene.
        options: integrator and step control.
        states: vectors x (inputs,) of the run, in the order of time.
    """
    if options.step is None:
        return ""

    def rate_at(number: int) -> float:
        """Estimate the fastest rate, 1/s, at a state; 0 near a singular configuration."""
        x = states[number]
        # smallest ratio of a pivot of the elimination to its usual value; 0 at a singular configuration
        is_regular = code.pivot_ratio(x) > FAR_PIVOT_RATIO
        return fastest_rate(code, x) if is_regular else 0.0

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
    """Find a state whose rate is above a limit while the rate of the state before is not.

    The start and some of the last states are examined first, then states between them by bisection. Few
    states are examined, because a rate costs as many evaluations as ten steps of RK4.

    Args:
        rate_at: computes the rate, 1/s, of a state by number.
        count: number of states.
        limit: 1/s.

    Returns:
        Number of the state and its rate, 1/s; (0, 0.0) if no examined rate is above the limit.
    """
    # the start, then states from the end backwards, until the rate of one is above the limit
    above, rate = 0, 0.0
    for number in dict.fromkeys([0, *(count - back for back in EXAMINED_FROM_END)]):
        if 0 <= number < count and rate <= limit:
            above, rate = number, rate_at(number)
    if rate <= limit:
        return 0, 0.0
    # bisection between the start, which is not above the limit, and the state `above`
    not_above = 0
    while above - not_above > 1:
        middle = (not_above + above) // 2
        middle_rate = rate_at(middle)
        if middle_rate > limit:
            above, rate = middle, middle_rate
        else:
            not_above = middle
    return above, rate


def fastest_rate(code: CompiledEquations, x: Array) -> float:
    """Estimate the largest eigenvalue magnitude, 1/s, of the motion linearized at x (inputs,).

    The estimate comes from a power iteration with one-sided differences of the time derivatives of the state.
    The mean growth over many iterations is the magnitude even if the eigenvalues are complex. The result is 0
    if the time derivatives are not finite.
    """
    derivative, n = code.function("derivative"), code.size
    unmoved, steps = derivative(x)[:n], DIFFERENCE_STEP * np.maximum(1.0, np.abs(x[:n]))
    direction, log_growth = np.random.default_rng(0).standard_normal(n), np.zeros(POWER_ITERATIONS)
    for k in range(POWER_ITERATIONS):
        moved = x.copy()
        moved[:n] += steps * direction
        direction = (derivative(moved)[:n] - unmoved) / steps
        size = float(np.linalg.norm(direction))
        if not 0.0 < size < np.inf:
            return 0.0
        direction, log_growth[k] = direction / size, np.log(size)
    return float(np.exp(np.mean(log_growth[POWER_ITERATIONS // 2 :])))


def _reason(code: CompiledEquations, options: Options, status: Status, x: Array) -> str:
    """Complete the message of a status with the singular configuration near x (inputs,), or with advice."""
    # messages of these statuses name the singular configuration; the run starts there with `UNDETERMINED` (at
    # rest) and `UNPROJECTED` (moving, without projection)
    is_singular = status in (Status.STRAYING, Status.UNDETERMINED, Status.UNPROJECTED)
    near = is_singular or code.pivot_ratio(x) < NEAR_PIVOT_RATIO
    joint, singular_value = nearly_dependent(code, x) if near else ("", 0.0)
    place = f"a singular configuration, where joint {joint!r} loses rank"
    reason = status.message.format(max_steps=max_adaptive_steps(options), place=place)
    if status not in (Status.TOO_MANY_STEPS, Status.STEP_TOO_SMALL):
        return reason
    if near:
        projecting = code.stabilization == "projection"
        return near_singular(reason, joint, singular_value, replace(options, projection=projecting))
    system = code.float_system(x)
    at = system.surroundings(x[: system.nq], x[system.nq : code.size])
    return too_many_or_small_steps(reason, system.scene, at, options.integrator)


def near_singular(reason: str, joint: str, singular_value: float, options: Options) -> str:
    """Complete the reason of a run that stopped near a singular configuration, with what to change.

    Only DOP853 with projection places its steps around singular configurations. Such a run stops if lengths
    miss the configuration by 1e-13 to 1e-8 of their size, or if rtol is tighter than the accelerations.

    Args:
        reason: why the run stopped.
        joint: joint or gear that loses rank.
        singular_value: smallest dimensionless singular value of the constraint Jacobian.
        options: integrator, tolerances and projection of the run.
    """
    place = f"near a singular configuration, where joint {joint!r} loses rank"
    noise = f"{place} (singular value {singular_value:.1e}), round-off is larger than rtol={options.rtol:g}"
    if options.integrator != "DOP853" or not options.projection:
        return f"{reason}; {noise}; use DOP853 with projection, the default"
    looser = f" and use rtol={PASSING_RTOL:g} in Python" if options.rtol < PASSING_RTOL else ""
    to_pass = f"to pass it, write the dimensions with all digits{looser}"
    return f"{reason}; {noise}; {to_pass}; to turn before it, change a length by 1e-7 of its value"


def singular_joint(code: CompiledEquations, x: Array) -> str:
    """Find the joint or gear whose constraints are closest to dependent at x (inputs,)."""
    return nearly_dependent(code, x)[0]


def nearly_dependent(code: CompiledEquations, x: Array) -> tuple[str, float]:
    """Find the joint or gear with the largest share in the combination of constraints closest to zero.

    Args:
        code: compiled equations of the scene.
        x: (inputs,) state, time, flags of constraint rows and parameters.

    Returns:
        Name of the joint or gear, and the smallest dimensionless singular value of the Jacobian of the
        constraints in use (redundant ones are left out). Without constraints: the joint that moves fastest,
        and 1.
    """
    system, rows = code.float_system(x), code.rows_at(x).in_use
    if not rows:
        return fastest_joint(system.mechanism, system.state(x[: system.nq], x[system.nq : code.size])), 1.0
    return least_independent(system, x[: system.nq], rows, len(rows))


def least_independent(system: Formulation, q: Array, rows: Sequence[int], rank: int) -> tuple[str, float]:
    """Find the owner of the constraints closest to dependent, and their smallest singular value.

    Args:
        system: equations of motion.
        q: (nq,) coordinates.
        rows: numbers of the constraint rows in use, at least one.
        rank: number of independent rows among them in usual configurations.
    """
    combinations, values, _ = singular_values(dimensionless_jacobian(system, q)[rows])
    owners = [system.row_owners[row] for row in rows]
    return largest_share(owners, combinations[:, rank - 1]), float(values[rank - 1])
