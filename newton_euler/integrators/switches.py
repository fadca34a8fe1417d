"""Switching of dry friction, stops and other forces whose formulas change at certain states.

Such a force depends on the positive parts of switching functions g (`newton_euler.model.switched_forces`).
During a step the integrator holds a flag for each g, and the force has flag * g in place of the positive
part, so that the rates are smooth also where g changes its sign within the step. After the step the
integrator looks for the first time at which some g has another sign than its flag: there a *branch* of the
force is left. It ends the step at this time, changes the flag and restarts. So no step extends over a jump
of a derivative, and the order of the method is kept (E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary
Differential Equations I, second edition, Springer 1993, section II.6; M. B. Carver, Mathematics and Computers
in Simulation 20, 1978, pp. 190-196).

A branch that is left and entered again within one step shows by a maximum of the signed g. `locate_maximum`
finds it from the parabola through three of the samples of the step.

The *excess* of a state is the largest signed g, positive where a branch is left. A *state with time and
parameters* is one vector (inputs,), see `newton_euler.integrators.stepper`; flags of branches are among its
flags. Functions marked `native` are compiled to machine code by `newton_euler.codegen`; they also run as
plain Python.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from newton_euler.codegen.native import Callback, Record, Vector, native

SAMPLES = 4
"""Number of parts of equal length into which a step is divided to look for the end of a branch."""

NO_SWITCH, REFUSED_SWITCH = 2.0, 3.0
"""Fractions of a step that stand for a step without a switch, and for one that makes no progress, see
`MAX_IDLE_SWITCHES`."""

MAX_ROOT_STEPS = 100
"""Largest number of evaluations to locate a switch. Each one at least halves the interval, or is a secant
step."""

ROOT_TOLERANCE = 4e-16
"""Length of the interval, as a fraction of the step, at which a switch is located."""

MIN_SWITCH_FRACTION = 1e-12
"""Fraction of a step below which a switch counts as one at its start, where the step makes no progress."""

SHORTEST_STEP_ULPS = 20.0
"""Shortest step from or to a switch, in units of the spacing of double-precision numbers near the time."""

MAX_IDLE_SWITCHES = 20
"""Number of consecutive switches without progress after which a step is accepted beyond the switch. Its end
then decides the branches. A branch can be left and entered at one place only if round-off decides its
sign."""


class Search(IntEnum):
    """Indices into `Switches.search`, the state of the search for a root of the excess in a step.

    Attributes:
        LOW, HIGH: ends of the interval, as fractions of the step; the excess is positive at `HIGH` only.
            `HIGH` is `NO_SWITCH` while no such place is known.
        LOW_VALUE, HIGH_VALUE: excess at both ends, 0 at a low end where it is not known; halved by the
            Illinois rule.
        KEPT: 1 if the last steps kept the low end, -1 if they kept the high end, else 0.
        MAXIMA: number of places that have been examined for a maximum.
        ROOT_STEPS: number of evaluations to locate the root.
        IDLE: number of consecutive switches at the start of a step.
    """

    LOW = 0
    HIGH = 1
    LOW_VALUE = 2
    HIGH_VALUE = 3
    KEPT = 4
    MAXIMA = 5
    ROOT_STEPS = 6
    IDLE = 7


@dataclass(frozen=True, eq=False)
class Switches(Record):
    """The switching functions of a scene, and the working memory of the search for switches.

    Attributes:
        count: number of switching functions, 0 for most scenes.
        first: index in x of the first flag.
        evaluate: writes the switching functions (count,) of a state with time and parameters.
        values: (count,) values of the switching functions.
        samples: (SAMPLES + 1, count) signed values at equal distances over a step.
        search: see `Search`.
    """

    count: int
    first: int
    evaluate: Callback
    values: Vector
    samples: Vector
    search: Vector


def no_switches() -> Switches:
    """Return the record of a scene without switched forces."""
    return Switches(0, 0, None, np.zeros(1), np.zeros(1), np.zeros(len(Search)))


@native
def choose_branches(switches: Switches, x: Vector) -> None:
    """Set the flags in x (inputs,) by the signs of the switching functions at x, as at the start of a run."""
    if switches.count > 0:
        switches.search[Search.IDLE] = 0.0
        switches.evaluate(x, switches.values)
        for i in range(switches.count):
            x[switches.first + i] = 1.0 if switches.values[i] > 0.0 else 0.0


@native
def signed_value(switches: Switches, i: int, flags: Vector) -> float:
    """Return switching function i of `Switches.values`, positive if its branch is left by flags (inputs,)."""
    return switches.values[i] if flags[switches.first + i] == 0.0 else -switches.values[i]


@native
def excess(switches: Switches, x: Vector, flags: Vector) -> float:
    """Return the largest signed switching function at x, with flags of another vector; both are (inputs,)."""
    switches.evaluate(x, switches.values)
    largest = -1.0
    for i in range(switches.count):
        value = signed_value(switches, i, flags)
        if i == 0 or value > largest:
            largest = value
    return largest


@native
def take_sample(switches: Switches, number: int, x: Vector, flags: Vector) -> None:
    """Store the signed switching functions at x as sample `number` of a step; both vectors are (inputs,)."""
    switches.evaluate(x, switches.values)
    for i in range(switches.count):
        switches.samples[switches.count * number + i] = signed_value(switches, i, flags)


@native
def locate_maximum(switches: Switches, i: int, number: int) -> float:
    """Locate a positive maximum of a signed switching function between samples, as a fraction of the step.

    The result is `NO_SWITCH` if the parabola through the samples `number` - 1 to `number` + 1 has no positive
    maximum between them.

    Args:
        i: index of the switching function.
        number: number of the middle sample.
    """
    before = switches.samples[switches.count * (number - 1) + i]
    middle = switches.samples[switches.count * number + i]
    after = switches.samples[switches.count * (number + 1) + i]
    bend = before - 2.0 * middle + after
    found = NO_SWITCH
    if bend < 0.0:
        offset = 0.5 * (before - after) / bend  # from the middle sample, in parts of the step
        if abs(offset) < 1.0 and middle - 0.25 * (before - after) * offset > 0.0:
            found = (float(number) + offset) / SAMPLES
    return found


@native
def begin_search(switches: Switches) -> None:
    """Begin the search for the first switch of a step whose samples are taken.

    The search ends with the first sample at which a branch is left, if there is one.
    """
    search = switches.search
    search[Search.LOW] = 0.0
    search[Search.HIGH] = NO_SWITCH
    search[Search.LOW_VALUE] = 0.0
    search[Search.HIGH_VALUE] = 0.0
    search[Search.KEPT] = 0.0
    search[Search.MAXIMA] = 0.0
    search[Search.ROOT_STEPS] = 0.0
    for number in range(1, SAMPLES + 1):
        largest = 0.0
        for i in range(switches.count):
            largest = max(largest, switches.samples[switches.count * number + i])
        if largest > 0.0 and search[Search.HIGH] > 1.0:
            search[Search.LOW] = (float(number) - 1.0) / SAMPLES
            search[Search.HIGH] = float(number) / SAMPLES
            search[Search.HIGH_VALUE] = largest


@native
def next_fraction(switches: Switches) -> float:
    """Return the next fraction of the step at which to evaluate the excess, or `NO_SWITCH` if there is none.

    At first these are maxima before the end of the search, where a branch may be left and entered again; then
    they are steps to the root: secant steps, or the middle of the interval.
    """
    search = switches.search
    for i in range(switches.count):
        for number in range(1, SAMPLES):
            if float((SAMPLES - 1) * i + number) > search[Search.MAXIMA]:
                search[Search.MAXIMA] = search[Search.MAXIMA] + 1.0
                fraction = locate_maximum(switches, i, number)
                if fraction < search[Search.HIGH]:
                    return fraction
    low = search[Search.LOW]
    high = search[Search.HIGH]
    if high > 1.0 or high - low <= ROOT_TOLERANCE or search[Search.ROOT_STEPS] >= MAX_ROOT_STEPS:
        return NO_SWITCH
    search[Search.ROOT_STEPS] = search[Search.ROOT_STEPS] + 1.0
    rise = search[Search.HIGH_VALUE] - search[Search.LOW_VALUE]
    if search[Search.LOW_VALUE] < 0.0 and rise > 0.0:
        secant = low - search[Search.LOW_VALUE] * (high - low) / rise
        if secant > low and secant < high:
            return secant
    return 0.5 * (low + high)


@native
def narrow_search(switches: Switches, fraction: float, value: float) -> None:
    """Narrow the interval of the search by the excess at the fraction of the step from `next_fraction`.

    The value of an end that stays twice is halved (Illinois rule; M. Dowell, P. Jarratt, BIT 11, 1971, pp.
    168-174), so that both ends approach the root.
    """
    search = switches.search
    if search[Search.ROOT_STEPS] == 0.0:
        if value > 0.0:  # the maximum is beyond a switch
            search[Search.LOW] = 0.0
            search[Search.HIGH] = fraction
            search[Search.HIGH_VALUE] = value
    elif value > 0.0:
        search[Search.HIGH] = fraction
        search[Search.HIGH_VALUE] = value
        if search[Search.KEPT] > 0.0:
            search[Search.LOW_VALUE] = 0.5 * search[Search.LOW_VALUE]
        search[Search.KEPT] = 1.0
    else:
        search[Search.LOW] = fraction
        search[Search.LOW_VALUE] = value
        if search[Search.KEPT] < 0.0:
            search[Search.HIGH_VALUE] = 0.5 * search[Search.HIGH_VALUE]
        search[Search.KEPT] = -1.0


@native
def located_switch(switches: Switches) -> float:
    """Return the fraction of the step at which the search has located a switch, or `NO_SWITCH`.

    The result is `REFUSED_SWITCH` after many switches in a row that make no progress.
    """
    search = switches.search
    if search[Search.HIGH] > MIN_SWITCH_FRACTION:
        search[Search.IDLE] = 0.0
        return search[Search.HIGH]
    search[Search.IDLE] = search[Search.IDLE] + 1.0
    return search[Search.HIGH] if search[Search.IDLE] < MAX_IDLE_SWITCHES else REFUSED_SWITCH


@native
def change_branch(switches: Switches, x: Vector) -> None:
    """Change the flags of the branches that are left at x (inputs,), and of the one that is nearest to it.

    The nearest one is changed also if round-off, or a projection onto the constraints, has moved the state
    back over the switch.
    """
    switches.evaluate(x, switches.values)
    nearest = 0
    largest = 0.0
    for i in range(switches.count):
        value = signed_value(switches, i, x)
        if i == 0 or value > largest:
            nearest = i
            largest = value
    for i in range(switches.count):
        if signed_value(switches, i, x) > 0.0 or i == nearest:
            x[switches.first + i] = 1.0 - x[switches.first + i]


@native
def end_step(switches: Switches, fraction: float, x: Vector) -> int:
    """Change the branches at the end x (inputs,) of an accepted step; return 1 if flags may have changed.

    Args:
        fraction: end of the step, at a switch; or `NO_SWITCH` or `REFUSED_SWITCH`.
    """
    if switches.count == 0:
        return 0
    if fraction == REFUSED_SWITCH:
        choose_branches(switches, x)
        return 1
    if fraction == NO_SWITCH:
        switches.search[Search.IDLE] = 0.0
        return 0
    change_branch(switches, x)
    return 1
