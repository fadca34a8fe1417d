"""Passage of runs through singular configurations, where the constraints of a closed loop become dependent.

This module has the functions that the integrators call for this purpose, and the list of all measures. In a
singular configuration the sparse elimination divides by pivots that vanish. The *pivot ratio* is the smallest
ratio of a pivot to its reference magnitude, the value that the pivot has in usual configurations. The ratio
falls with the square of the distance to the singular configuration. Round-off in accelerations grows with the
cube of the inverse distance. A *branch* is one of the motions that meet in a singular configuration. Without
the measures below, error control would shorten steps without end, and the run could continue on another
branch of the mechanism's motion.

Masses that differ by large factors make pivots small, too. A singular configuration is a property of the
constraint Jacobian, so `evaluate` compares small pivots with the pivots of the constraints alone
(`newton_euler.integrators.constraint_ratio`). An open chain without couplings has no singular configuration.

The measures are:

1. `evaluate`: if the pivot ratio is not positive, accelerations come from the dense form of the equations,
   which determines the rank by singular values.
2. A run may begin in a singular configuration if its velocities determine the branch, or if the mechanism
   stays at rest (`check_singular_start`).
3. If a stage of a step of DOP853 or Radau has unsafe accelerations, the step is shortened by the factor
   `UNSAFE_STEP_FACTOR`, which moves the stages.
4. A step of DOP853 near a singular configuration is placed so that the configuration lies in the widest gap
   between two stages. `locate_crossing` finds the crossing from the pivot ratios of three stages, and
   `crossing_factor` shortens the step.
5. No step can end in a singular configuration. If the run ends there, the last step goes beyond the end of
   the run, and the end is interpolated.
6. The error of a step near a singular configuration is the error of its projections
   (`newton_euler.integrators.dop853.error_on_constraints`). Errors of the constraint forces move the state
   normal to the constraints, and projection in the metric of the mass matrix removes this part
   (`newton_euler.integrators.dense_projection`).
7. Steps of RK4 cannot be placed. If the stages of a step contradict each other (`stage_contradiction`), the
   run ends.

Equations that Python evaluates have no sparse form, so measure 1 changes nothing. Their pivot ratio is
defined in `newton_euler.compiled.evaluated`. A *state with time and parameters* is one vector (inputs,) with
the n coordinates and velocities, the time, flags of constraint rows, and parameters of the scene
(`newton_euler.integrators.stepper`); *rates* are the time derivatives of coordinates and velocities.

Functions marked `native` are compiled to machine code by `newton_euler.codegen`; they also run as plain
Python.
"""

from __future__ import annotations

from math import sqrt

from newton_euler.codegen.native import Vector, native
from newton_euler.integrators.constraint_ratio import constraint_ratio
from newton_euler.integrators.status import Status
from newton_euler.integrators.stepper import HUGE, Count, Equations

NEAR_PIVOT_RATIO = 1e-3
"""Pivot ratio below which a configuration is near a singular one."""

FAR_PIVOT_RATIO = 100.0 * NEAR_PIVOT_RATIO
"""Pivot ratio above which a configuration is far from any singular one."""

UNSAFE_PIVOT_RATIO = 1e-8
"""Pivot ratio below which accelerations may be so wrong that a run would leave on another branch. Only a run
that starts below this ratio takes such steps, until the run has left the singular configuration."""

DENSE_PIVOT_RATIO = 1e-12
"""Pivot ratio reported for accelerations of the dense form, which stands for a singular configuration. If
large mass ratios alone cause small pivots, the reported pivot ratio is larger."""

UNSAFE_STEP_FACTOR = 0.8
"""Factor by which a step is shortened if the accelerations at one of its stages are unsafe."""

MAX_PLACEMENT_TRIES = 12
"""Largest number of times that a step is shortened to place a singular configuration between two stages.
After that, only the error of the step decides."""

MIDDLE_STAGE = 0.6
"""Time of stage 9 of DOP853 as a fraction of the step: the stage that `locate_crossing` uses in addition to
those at both ends."""

CROSSING_TARGET, CROSSING_MIN, CROSSING_MAX = 0.4667, 0.38, 0.55
"""Times, as fractions of a step, at which the step should pass a singular configuration. The target is half
way between the two stages of DOP853 that are farthest apart, at 1/3 and 3/5. The others are the earliest and
the latest time that need no change of the step."""

CROSSING_IGNORED_BEFORE = 0.04
"""Fraction of a step. If a singular configuration is passed before this time, the step is not shortened. A
shorter step would bring a stage closer to it than the second stage, at 0.053, is now."""

NO_CROSSING = 1e9
"""Result of `locate_crossing` if the step comes near no singular configuration, in units of the step."""

ENDS_SINGULAR_RATIO = 0.05
"""Ratio of the distances from a singular configuration at the end and at the start of a step, below which
the step ends in this configuration."""

MIN_START_DISPLACEMENT = 1e-4
"""Distance d from a singular configuration, rad or m, within which accelerations a are unsafe. If a mechanism
starts there at a speed v with v^2 < d a, accelerations move it more than its speed, and it counts as at
rest."""

REST_DISPLACEMENT = 1e-9
"""Largest displacement from its start, rad or m, of a mechanism that counts as staying at rest."""

MAX_CONTRADICTION = 1e-3
"""Largest contradiction between the accelerations within a step of RK4, as a fraction of the velocities.
Chosen from runs of a parallelogram of bars without projection: runs that changed to another branch had 8e-3
or more in some step, good ones mostly less than 1e-3, so that some good runs are refused. Steps that pass a
singular configuration without a stage close to it are not examined: without projection such steps open
joints, and `newton_euler.integrators.projection.check_still_closed` refuses the run at its next output."""


@native
def ratio_for_steps(with_masses: float, alone: float) -> float:
    """Choose the pivot ratio by which steps are placed, shortened or refused.

    Far from a singular configuration, small pivots come from the masses alone. The pivot ratio of the
    constraints counts then. Near a singular configuration, accelerations lose as many digits as the pivots of
    the equations of motion show.

    Args:
        with_masses: pivot ratio of the equations of motion, below `NEAR_PIVOT_RATIO`.
        alone: pivot ratio of the constraints alone.
    """
    return alone if alone >= NEAR_PIVOT_RATIO else with_masses


@native
def evaluate(system: Equations, x: Vector, y: Vector) -> Status:
    """Evaluate the rates and the pivot ratio of a state; return a status.

    If the pivot ratio of the sparse form is not positive, the dense form is evaluated. If constraints cannot
    lose rank, a small pivot ratio comes from the masses alone. The result is 1 then, so that no step is
    placed, shortened or refused. Otherwise `ratio_for_steps` chooses the result.

    Args:
        x: state with time and parameters (inputs,).
        y: (n + 1,) rates and pivot ratio, written.
    """
    system.derivative(x, y)
    system.counts[Count.EVALUATIONS] += 1.0
    if not y[system.n] > 0.0:
        system.dense(x, y)
        system.counts[Count.DENSE_CALLS] += 1.0
        if not y[system.n] > 0.0:
            return Status.SINGULAR
        y[system.n] = DENSE_PIVOT_RATIO
    if system.loses_rank == 0:
        y[system.n] = 1.0
    elif y[system.n] < NEAR_PIVOT_RATIO:
        alone = constraint_ratio(system.ratio, x)
        if alone < 0.0:
            return Status.SINGULAR
        y[system.n] = ratio_for_steps(y[system.n], alone)
    size = 0.0
    for i in range(system.n):
        size += abs(y[i])
    if not size < HUGE:
        return Status.NOT_FINITE
    return Status.DONE


@native
def check_singular_start(
    system: Equations, span: float, projecting: int, now: Vector, rates: Vector
) -> Status:
    """Check that a run may begin in a singular configuration.

    Velocities determine the branch, and projection keeps the run on it. From rest the branch is not
    determined, unless nothing accelerates the mechanism and it stays.

    Args:
        span: duration of the run, s.
        projecting: 1 if states are projected onto the constraints, else 0.
        now: state at the start.
        rates: (n + 1,) rates and pivot ratio at the start.
    """
    # sums over all velocities
    speed = 0.0
    acceleration = 0.0
    for i in range(system.nq, system.n):
        speed += abs(now[i])
        acceleration += abs(rates[i])
    if acceleration * span * span < REST_DISPLACEMENT and speed * span < REST_DISPLACEMENT:
        return Status.DONE
    if speed * speed < MIN_START_DISPLACEMENT * acceleration:
        return Status.UNDETERMINED
    return Status.DONE if projecting == 1 else Status.UNPROJECTED


@native
def locate_crossing(first: float, middle: float, last: float) -> float:
    """Locate the singular configuration that a step passes or will pass, in units of the step.

    The root of the pivot ratio is proportional to the distance from the singular configuration. The distances
    at both ends of the step give two candidates: a crossing within the step and one after its end. The
    distance at the stage `MIDDLE_STAGE` decides between them. The result is `NO_CROSSING` if neither fits the
    three distances within 20 %, unless the step ends in the singular configuration.

    Args:
        first, middle, last: pivot ratios at the beginning, at `MIDDLE_STAGE` and at the end of the step.
    """
    # from here on: distances, up to a common factor, which change linearly with time
    first = sqrt(max(first, 0.0))
    last = sqrt(max(last, 0.0))
    middle = sqrt(max(middle, 0.0))
    within = first / (first + last)
    residual_within = abs(abs(within - MIDDLE_STAGE) * (first + last) - middle)
    if first <= last:
        return within if residual_within < 0.2 * (first + last) else NO_CROSSING
    beyond = first / (first - last)
    residual_beyond = abs((beyond - MIDDLE_STAGE) * (first - last) - middle)
    if min(residual_within, residual_beyond) > 0.2 * (first + last):
        return within if last < ENDS_SINGULAR_RATIO * first else NO_CROSSING
    return within if residual_within < residual_beyond else beyond


@native
def crossing_factor(first: float, middle: float, last: float, error_factor: float) -> float:
    """Compute the factor for a step so that it passes a singular configuration between two stages.

    The factor is 1 if the step does so already, or if the step comes near no singular configuration once its
    error has shortened it.

    Args:
        first, middle, last: pivot ratios, see `locate_crossing`.
        error_factor: factor that the error of the step requires, at most 1.
    """
    crossing = locate_crossing(first, middle, last)
    if crossing < CROSSING_IGNORED_BEFORE:
        return 1.0
    # shorten the step so that the crossing is at the target
    if crossing < CROSSING_MIN or (
        crossing <= CROSSING_MAX and error_factor < 1.0 and crossing <= CROSSING_TARGET * error_factor
    ):
        return crossing / CROSSING_TARGET
    # end the step early, so that the crossing is at the target of a next step of the allowed size
    if crossing > CROSSING_MAX * error_factor and crossing < 1.0 + CROSSING_TARGET:
        return crossing - CROSSING_TARGET * error_factor
    return 1.0


@native
def stage_contradiction(system: Equations, h: float, now: Vector, k: Vector) -> float:
    """Measure how far the stages of a step of RK4 contradict each other, as a fraction of the speeds.

    Two combinations of the stages' accelerations are examined: k2 - k1 and k0 - k1 - k2 + k3. If the motion
    is smooth, they change velocities by terms of order h^2 and h^3. Near a singular configuration, where
    multipliers lose their digits, the combinations are noise. If a motion changes to another branch, they
    change velocities by as much as the velocities themselves.

    Args:
        h: step, s.
        now: state at the beginning.
        k: (4, n + 1) rates of the stages.
    """
    row = system.n + 1
    residual = 0.0
    speed = 0.0
    for i in range(system.nq, system.n):
        residual += abs(k[2 * row + i] - k[row + i])
        residual += abs(k[i] - k[row + i] - k[2 * row + i] + k[3 * row + i])
        speed += abs(now[i]) + h * abs(k[i])
    return h * residual / speed if speed > 0.0 else 0.0
