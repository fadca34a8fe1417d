"""Passing singular configurations, where constraints of a loop become dependent, without losing digits.

There the sparse elimination divides by pivots that vanish. Their ratio to what they usually are, the *pivot
ratio*, falls with the square of the distance to the singular configuration, and round-off in accelerations
grows with the cube of the inverse of that distance. Without more, error control would shorten steps without
end, and what passes may have gone over to another branch of the mechanism's motion. The algorithm:

Masses that differ by large factors make pivots small too. A singular configuration is a property of the
constraint Jacobian, so `evaluate` compares small pivots with those of the constraints alone
(`newton_euler.integrators.constraint_ratio`). An open chain without couplings has no singular configuration.

1. `evaluate`: where the pivot ratio is not positive, accelerations come from the dense, rank-revealing form.
2. A run may begin in a singular configuration if its velocities say which branch it takes, or if it stays at
   rest (`leaving`).
3. A step of DOP853 with a stage where accelerations are unsafe is shortened by the factor `HOP`: its stages
   are elsewhere then. So is one of Radau.
4. A step of DOP853 near a singular configuration is placed so that it passes in the widest gap between two of
   its stages: `crossing` finds where from the pivot ratios of three stages, `crossing_factor` shortens the
   step.
5. No step can end in a singular configuration. Where the run does, the last one goes beyond its end, and is
   interpolated.
6. The error of a step near one is that of its projections
   (`newton_euler.integrators.dop853.error_on_constraints`): what wrong multipliers add is normal to the
   constraints, and projection in the metric of the mass matrix takes it off again
   (`newton_euler.integrators.dense_projection`), as far as constraints are strong enough.
7. Steps of RK4 cannot be placed: a step whose stages contradict each other (`contradiction`) ends the run.

Equations that Python evaluates have no sparse form, so 1 changes nothing; their pivot ratio is that of
`newton_euler.compiled.evaluated`.

Written for native code, see `newton_euler.codegen.native`; it runs as plain Python as well.
"""

from __future__ import annotations

from math import sqrt

from newton_euler.codegen.native import Vector, native
from newton_euler.integrators.constraint_ratio import constraint_ratio
from newton_euler.integrators.stepper import (
    DENSE_CALLS,
    DONE,
    EVALUATIONS,
    HUGE,
    NOT_FINITE,
    SINGULAR,
    UNDETERMINED,
    UNPROJECTED,
    Equations,
)

NEAR = 1e-3
"""Pivot ratio below which a configuration is near a singular one."""

FAR = 100.0 * NEAR
"""Pivot ratio at both ends of a step above which Python does not look at its stages."""

UNSAFE = 1e-8
"""Pivot ratio below which accelerations may be so wrong that a run would leave on another branch. Only a run
that starts there takes steps through it, until it has left."""

DENSE_PIVOT_RATIO = 1e-12
"""Stands for the pivot ratio of what the dense form evaluated; a singular configuration has no more. Great
mass ratios alone leave more."""

HOP = 0.8
"""Factor for a step with a stage where accelerations are unsafe."""

HOPS = 12
"""Tries to place a step; after them its error alone decides."""

MIDDLE = 0.6
"""Place in a step of the stage of DOP853 whose pivot ratio `crossing` looks at between the ends, its stage
9."""

GAP, LEAST, MOST = 0.4667, 0.38, 0.55
"""Place in a step where a singular configuration is to be passed: half way between the two stages of DOP853
that are farthest apart, at 1/3 and 3/5; and the earliest and the latest that will do."""

EARLY = 0.04
"""Place before which a step passes a singular configuration farther from its second stage, at 0.053, than a
step that is shortened for it would pass: with a start that is next to one, nothing is gained."""

NOWHERE = 1e9
"""Place of a singular configuration that a step does not come near to, in units of the step."""

AT_END = 0.05
"""Ratio of the distances after and before a step below which it ends in the singular configuration."""

LEAVING = 1e-4
"""rad or m, within which accelerations are unsafe; what leaves slower than they would make it is at rest."""

STAYS = 1e-9
"""rad or m, by which a run may move from where it begins and still be said to stay there."""

CONTRADICTION = 1e-3
"""Share of the velocities by which accelerations within a step of RK4 may contradict each other. Chosen from
runs of a parallelogram of bars without projection: those that went over to another branch had k3 - k2 of 8e-3
or more somewhere, good ones mostly less than 1e-3: some good ones are refused. Steps that pass with no stage
near by
are not looked at: without projection they open joints, and
`newton_euler.integrators.projection.check_still_closed` refuses the run at its next output."""


@native
def ratio_for_steps(with_masses: float, alone: float) -> float:
    """Choose the pivot ratio that steps are placed, shortened and refused by.

    Far from a singular configuration, the masses alone make pivots small: the constraints decide. Near a
    singular configuration, accelerations lose as many digits as the pivots with masses show.

    Args:
        with_masses: pivot ratio of the equations of motion, below `NEAR`.
        alone: pivot ratio of the constraints alone.
    """
    return alone if alone >= NEAR else with_masses


@native
def evaluate(system: Equations, x: Vector, y: Vector) -> int:
    """Evaluate y = derivative(x); return a status.

    The dense form evaluates where the pivot ratio of the sparse form is not positive. If constraints cannot
    lose rank, a small pivot ratio comes from the masses alone. The pivot ratio is 1 then: no step has to be
    placed, shortened or refused for it. Otherwise `ratio_for_steps` chooses.
    """
    system.derivative(x, y)
    system.counts[EVALUATIONS] += 1.0
    if not y[system.n] > 0.0:
        system.dense(x, y)
        system.counts[DENSE_CALLS] += 1.0
        if not y[system.n] > 0.0:
            return SINGULAR
        y[system.n] = DENSE_PIVOT_RATIO
    if system.loses_rank == 0:
        y[system.n] = 1.0
    elif y[system.n] < NEAR:
        alone = constraint_ratio(system.ratio, x)
        if alone < 0.0:
            return SINGULAR
        y[system.n] = ratio_for_steps(y[system.n], alone)
    size = 0.0
    for i in range(system.n):
        size += abs(y[i])
    if not size < HUGE:
        return NOT_FINITE
    return DONE


@native
def leaving(system: Equations, span: float, projecting: int, now: Vector, rates: Vector) -> int:
    """Check that a run of a span (s) may begin where it is singular, with its rates (n + 1) there; a status.

    Velocities say on which branch it goes on, and projection keeps it there. From rest the branch is not
    determined, unless nothing pulls and it stays.
    """
    speed = 0.0
    push = 0.0
    for i in range(system.nq, system.n):
        speed += abs(now[i])
        push += abs(rates[i])
    if push * span * span < STAYS and speed * span < STAYS:
        return DONE
    if speed * speed < LEAVING * push:
        return UNDETERMINED
    return DONE if projecting == 1 else UNPROJECTED


@native
def crossing(first: float, middle: float, last: float) -> float:
    """Find where a step passes or will pass a singular configuration, in units of its length.

    The root of the pivot ratio is a distance: what it is at both ends, 0 and 1, tells where it vanishes,
    within the step or beyond it, and the stage at `MIDDLE` which of the two. `NOWHERE` if neither fits: far
    away the pivot ratio is 1 at any distance. Of a step that ends there it does not matter.

    Args:
        first, middle, last: pivot ratios.
    """
    first = sqrt(max(first, 0.0))
    last = sqrt(max(last, 0.0))
    middle = sqrt(max(middle, 0.0))
    within = first / (first + last)
    residual_within = abs(abs(within - MIDDLE) * (first + last) - middle)
    if first <= last:
        return within if residual_within < 0.2 * (first + last) else NOWHERE
    beyond = first / (first - last)
    residual_beyond = abs((beyond - MIDDLE) * (first - last) - middle)
    if min(residual_within, residual_beyond) > 0.2 * (first + last):
        return within if last < AT_END * first else NOWHERE
    return within if residual_within < residual_beyond else beyond


@native
def crossing_factor(first: float, middle: float, last: float, shorter: float) -> float:
    """Find the factor for a step that has it pass a singular configuration in the widest gap between stages.

    1 if it does, or if that configuration is no concern of a step that its error makes shorter anyway.

    Args:
        first, middle, last: pivot ratios.
        shorter: factor that the error of the step asks for, at most 1.
    """
    where = crossing(first, middle, last)
    if where < EARLY:
        return 1.0
    if where < LEAST or (where <= MOST and shorter < 1.0 and where <= GAP * shorter):
        return where / GAP
    if where > MOST * shorter and where < 1.0 + GAP:
        return where - GAP * shorter
    return 1.0


@native
def contradiction(system: Equations, h: float, now: Vector, k: Vector) -> float:
    """Measure how far the stages k (4, n + 1) of a step of RK4 contradict each other, as a share of speeds.

    Two combinations of accelerations are looked at that are of order h^2, h^3 in velocities, of a smooth
    motion. Near a singular configuration, where multipliers lose their digits, they are noise, and where a
    motion goes over to another branch they are as large as the velocities.
    """
    row = system.n + 1
    residual = 0.0
    speed = 0.0
    for i in range(system.nq, system.n):
        residual += abs(k[2 * row + i] - k[row + i])
        residual += abs(k[i] - k[row + i] - k[2 * row + i] + k[3 * row + i])
        speed += abs(now[i]) + h * abs(k[i])
    return h * residual / speed if speed > 0.0 else 0.0
