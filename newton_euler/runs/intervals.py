"""Divide a run into intervals between sampling instants and knots, and integrate them one after another.

A sampled (digital) controller changes its force at sampling instants, and holds the force until the next one.
A function of time such as a spline consists of polynomial pieces, which meet at knots. The integrator
restarts at sampling instants and knots, so that the motion is smooth within each interval. A scene with
neither has a single interval: the whole run.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np

from newton_euler.compiled.equations import CompiledEquations
from newton_euler.compiled.failures import singular_joint
from newton_euler.compiled.run import Integrator, check_rest
from newton_euler.equations.parameters import pieces, with_values
from newton_euler.integrators.options import Options
from newton_euler.integrators.singular import UNSAFE_PIVOT_RATIO
from newton_euler.integrators.stepper import COUNTS, Count
from newton_euler.model.digital_control import HeldLaw
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import IntegrationError
from newton_euler.runs.controllers import Controllers
from newton_euler.scalars import Array

SAME_TIME = 1e-9
"""Fraction of a controller's period, or of the time between knots, below which two times count as equal."""


class Interval(NamedTuple):
    """A part of a run in which forces of sampled controllers are constant and functions of time are smooth.

    Attributes:
        due: control laws whose controllers are called at the beginning.
        times: (n,) s, n >= 2: the beginning, the output times inside, the end.
        is_output: (n,) True for those `times` that are outputs of this interval. An output at the end
            belongs to the next interval, because the new force already acts at a sampling instant.
    """

    due: tuple[HeldLaw, ...]
    times: Array
    is_output: Array

    @property
    def middle(self) -> float:
        """Middle of the interval, s, which is far from all knots."""
        return float(0.5 * (self.times[0] + self.times[-1]))


def intervals(scene: Scene, knots: Sequence[float], times: Array | None = None) -> Iterator[Interval]:
    """Divide a run of the scene at sampling instants and knots; a single interval if there are none.

    Controllers are called at the multiples 0, 1, ... of their periods, but not at the end of the run.

    Args:
        scene: the scene that is run.
        knots: s, times of the knots, ascending.
        times: output times, s, ascending, none negative; those of the scene if not given.
    """
    outputs, laws = scene.times if times is None else times, scene.sampled
    end = float(outputs[-1])
    slack = SAME_TIME * float(np.min(np.diff(knots), initial=scene.output_period))
    # remaining knots in descending order, so that the next one is the last element
    knots_ahead = [_snapped(knot, slack, outputs) for knot in reversed(knots) if slack < knot < end - slack]
    # indices of the laws that are called at `begin`, and the number of calls of each law so far
    begin, due, calls = 0.0, list(range(len(laws))), [0] * len(laws)
    while begin < end:
        # the interval ends at the next call of a controller, the next knot, or the end of the run
        for k in due:
            calls[k] += 1
        next_calls = [_call_time(law, number, outputs) for law, number in zip(laws, calls, strict=True)]
        while knots_ahead and knots_ahead[-1] <= begin + slack:
            knots_ahead.pop()
        stop = min([*next_calls, *knots_ahead[-1:], end])
        # an output at `stop` belongs to this interval only at the end of the run
        first, last = np.searchsorted(outputs, [begin, stop])
        inside = outputs[first:] if stop == end else outputs[first:last]
        interval_times = np.union1d(inside, [begin, stop])
        yield Interval(tuple(laws[k] for k in due), interval_times, np.isin(interval_times, inside))
        begin = stop
        due = [k for k, law in enumerate(laws) if next_calls[k] - stop < SAME_TIME * law.period]


def _call_time(law: HeldLaw, number: int, outputs: Array) -> float:
    """Return the time of call number 0, 1, ... of a controller, s, rounded to an equal output time."""
    return _snapped(number * law.period, SAME_TIME * law.period, outputs)


def _snapped(time: float, slack: float, outputs: Array) -> float:
    """Return the output time that differs from a time by less than the slack, s; else the time itself."""
    k = int(np.searchsorted(outputs, time - slack))
    return float(outputs[k]) if k < len(outputs) and outputs[k] < time + slack else time


class SceneEquations(Protocol):
    """Interface of equations that read control laws and functions of their scene at each evaluation."""

    scene: Scene


S = TypeVar("S", bound=SceneEquations)


def with_held_values(system: S, values: Mapping[str, Any]) -> S:
    """Return a copy of equations whose scene has other held forces and polynomial pieces.

    The copy shares the model of a dynamics engine, if there is one, with the original.

    Args:
        system: equations of a scene.
        values: by parameter name, from `Controllers.sample` and `newton_euler.equations.parameters.pieces`.
    """
    changed = copy.copy(system)
    changed.scene = with_values(system.scene, values)
    return changed


AfterInterval = Callable[[Integrator, Array, Interval], None]
"""Function called after each interval with the integrator, x (inputs,) at the beginning, and the interval."""


class NativeRun(NamedTuple):
    """Results of a run in native code.

    Attributes:
        results: (n, outputs) outputs of the scene at the n output times reached, see
            `newton_euler.compiled.outputs.named`.
        counts: (COUNTS,) numbers of steps and evaluations, see
            `newton_euler.integrators.stepper.reported_counts`.
        stopped: the error that ended the run before the last output; None for a complete run.
        wall_time: s. For a run of a single interval, the construction of its integrator is not included.
    """

    results: Array
    counts: Array
    stopped: IntegrationError | None
    wall_time: float


def integrate_intervals(
    code: CompiledEquations,
    x: Array,
    options: Options,
    stopped: Sequence[bool] = (),
    times: Array | None = None,
    after_interval: AfterInterval | None = None,
    room: int = 0,
) -> NativeRun:
    """Run a compiled scene interval by interval.

    Args:
        code: compiled equations of the scene.
        x: (inputs,) state, time, flags of constraint equations (1 if left out as redundant, else 0) and
            parameters at the start; overwritten during the run.
        options: integrator and step control.
        stopped: a list that other threads may append to; the run stops if the list is not empty.
        times: output times, s; those of the scene if not given.
        after_interval: called after each interval that reached its end.
        room: number of integrator steps to keep in each interval, see
            `newton_euler.compiled.run.Integrator.steps`.
    """
    start = time.perf_counter()
    is_divided = code.piecewise or code.scene.sampled
    scene = code.parametrized(x) if is_divided else code.scene
    controllers = Controllers(scene) if scene.sampled else None
    end = (code.scene.times if times is None else times)[-1]
    # by number of output times, and whether the mechanism may come to rest until the end of the interval
    integrators: dict[tuple[int, bool], Integrator] = {}
    check_rest(code, options)
    functions = [f for of_element in scene.functions.values() for f in of_element] if options.rest else []
    moving = replace(options, rest=0.0)
    parts: list[Array] = []
    total = np.zeros(COUNTS)
    error: IntegrationError | None = None
    for interval in intervals(scene, scene.knots, times):
        # 1. numbers that are constant in the interval: pieces of functions of time, forces of controllers
        values: dict[str, Any] = pieces(scene, interval.middle) if is_divided else {}
        if controllers and interval.due:
            # (s, 2) the s joint coordinates that controllers read, and their rates
            readings = code.function("measured")(x).reshape(2, -1).T
            try:
                values |= controllers.sample(interval.due, float(interval.times[0]), readings)
            except IntegrationError as failed:
                error = failed
                break
        for name, value in values.items():
            place = code.place(name)
            x[place : place + np.size(value)] = value
        # 2. integrate to the end of the interval
        may_rest = all(f.is_constant_at(interval.middle) for f in functions)
        kind = len(interval.times), may_rest
        if kind not in integrators:
            own_options = options if may_rest else moving
            integrators[kind] = Integrator(code, interval.times, own_options, stopped, room)
        integrator = integrators[kind]
        integrator.times[:] = interval.times
        if not values:  # the only interval: start the clock after the construction of its integrator
            start = time.perf_counter()
        results, error = integrator.attempt(x)
        # 3. collect outputs and counts. The counts add up, except for the largest error estimate that was
        # accepted because round-off explains it
        excess = max(total[Count.ROUND_OFF_EXCESS], integrator.counts[Count.ROUND_OFF_EXCESS])
        total += integrator.counts
        total[Count.ROUND_OFF_EXCESS] = excess
        is_output = interval.is_output[: len(results)]
        parts.append(results if is_output.all() else results[is_output])
        if error:
            break
        if after_interval:
            after_interval(integrator, x, interval)
        # 4. the next interval begins here, unless the configuration is singular: a restart could continue on
        # another branch of motion. `code.projects`: states are projected onto constraints
        x[:] = integrator.x
        reached = float(x[code.size])  # s; the time follows the state
        if code.projects and reached < end and code.pivot_ratio(x) < UNSAFE_PIVOT_RATIO:
            where = f"a singular configuration, where joint {singular_joint(code, x)!r} loses rank"
            error = IntegrationError(reached, f"a knot or a controller sample falls on {where}")
            break
    none = np.zeros((0, code.function("output").outputs))
    results = parts[0] if len(parts) == 1 else np.concatenate([none, *parts])
    return NativeRun(results, total, error, time.perf_counter() - start)
