"""Switches of forces within a step of DOP853: dense output, samples of the step, and the first switch.

A step ends where a branch of a force is left (`newton_euler.integrators.switches`). Functions marked `native`
are compiled to machine code by `newton_euler.codegen`; they also run as plain Python.
"""

from __future__ import annotations

from newton_euler.codegen.native import native
from newton_euler.integrators.dop853_stages import (
    Control,
    Dop853,
    evaluate_stage,
    interpolate,
    prepare_dense,
)
from newton_euler.integrators.dop853_tableau import (
    STAGES,
)
from newton_euler.integrators.status import Status
from newton_euler.integrators.stepper import (
    Equations,
)
from newton_euler.integrators.switches import (
    SAMPLES,
    Switches,
    begin_search,
    excess,
    located_switch,
    narrow_search,
    next_fraction,
    take_sample,
)


@native
def evaluate_dense(system: Equations, method: Dop853) -> Status:
    """Evaluate the three additional stages of the dense output of a step and its terms; return a status."""
    n = system.n
    h = method.control[Control.STEP]
    for s in range(STAGES + 1, 16):
        status = evaluate_stage(system, method, s, h, method.at)
        if status != Status.DONE:
            return status
    prepare_dense(h, n, n + 1, n, method.now, method.end, method.k, method.terms)
    return Status.DONE


@native
def interpolate_step(system: Equations, method: Dop853, fraction: float) -> None:
    """Interpolate the state and the time `method.at` at a fraction of the step, by dense output."""
    n = system.n
    interpolate(n, n, fraction, method, method.at)
    method.at[n] = method.now[n] + fraction * method.control[Control.STEP]


@native
def sample_step(system: Equations, switches: Switches, method: Dop853) -> int:
    """Sample the signed switching functions over a step; return 1 if some branch may be left, else 0.

    Between its ends the step is interpolated by the cubic Hermite polynomial, which needs no other rates than
    those at the ends.
    """
    n = system.n
    now = method.now
    end = method.end
    at = method.at
    rates_at_end = method.k[(n + 1) * STAGES :]
    h = method.control[Control.STEP]
    if switches.count == 0:
        return 0
    take_sample(switches, 0, now, now)
    for number in range(1, SAMPLES):
        x = float(number) / SAMPLES
        for i in range(n):
            # change minus the linear one, at the start and at the end
            bend = h * method.k[i] - (end[i] - now[i])
            other = h * rates_at_end[i] - (end[i] - now[i])
            at[i] = now[i] + x * (end[i] - now[i]) + x * (1.0 - x) * ((1.0 - x) * bend - x * other)
        at[n] = now[n] + x * h
        take_sample(switches, number, at, now)
    take_sample(switches, SAMPLES, end, now)
    begin_search(switches)
    return 1 if next_fraction(switches) <= 1.0 else 0


@native
def locate_switch(system: Equations, switches: Switches, method: Dop853) -> float:
    """Return the fraction of an accepted step at which a branch of a force is first left, or `NO_SWITCH`.

    The additional stages of the dense output and the samples at both ends must have been evaluated.
    """
    for number in range(1, SAMPLES):
        interpolate_step(system, method, float(number) / SAMPLES)
        take_sample(switches, number, method.at, method.now)
    begin_search(switches)
    fraction = next_fraction(switches)
    while fraction <= 1.0:
        interpolate_step(system, method, fraction)
        narrow_search(switches, fraction, excess(switches, method.at, method.now))
        fraction = next_fraction(switches)
    return located_switch(switches)
