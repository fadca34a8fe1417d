"""Runs with sampled controllers, from one sampling instant to the next, whatever integrates in between."""

from __future__ import annotations

import copy
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from newton_euler.equations.parameters import with_values
from newton_euler.errors import is_finite_number
from newton_euler.integrators.compiled import Code
from newton_euler.integrators.options import Options
from newton_euler.integrators.run import Integrator
from newton_euler.model.digital_control import HeldLaw
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import IntegrationError
from newton_euler.scalars import Array

SAME = 1e-9
"""Times that differ by less than this share of a controller's period are one: multiples of different
periods meet only up to round-off."""


class Interval(NamedTuple):
    """A part of a run in which forces of sampled controllers are constant.

    Attributes:
        due: laws whose controllers are called where it begins. times: (n,) s, n >= 2: where it begins, the
            output times in it, where it ends. wanted: (n,) True for those of `times` that are outputs of this
            interval. One where the next interval begins
            belongs to that: at a sampling instant the new force holds already.
    """

    due: tuple[HeldLaw, ...]
    times: Array
    wanted: Array


def intervals(scene: Scene) -> Iterator[Interval]:
    """Divide a run of the scene at sampling instants; a single interval if nothing is sampled.

    Controllers are called at multiples of their periods from 0 on, but not at the end of the run.
    """
    outputs, laws = scene.times, scene.sampled
    end = float(outputs[-1])
    begin, due, calls = 0.0, list(range(len(laws))), [0] * len(laws)
    while begin < end:
        for k in due:
            calls[k] += 1
        upcoming = [_instant(law, number, outputs) for law, number in zip(laws, calls, strict=True)]
        stop = min([*upcoming, end])
        first, last = np.searchsorted(outputs, [begin, stop])
        inside = outputs[first:] if stop == end else outputs[first:last]
        times = np.union1d(inside, [begin, stop])
        yield Interval(tuple(laws[k] for k in due), times, np.isin(times, inside))
        begin, due = stop, [k for k, law in enumerate(laws) if upcoming[k] - stop < SAME * law.period]


def _instant(law: HeldLaw, number: int, outputs: Array) -> float:
    """Return the time of the call of a controller with that number, from 0; an output time is met exactly."""
    time, slack = number * law.period, SAME * law.period
    k = int(np.searchsorted(outputs, time - slack))
    return float(outputs[k]) if k < len(outputs) and outputs[k] < time + slack else time


class Controllers:
    """The controllers of a scene in one run."""

    def __init__(self, scene: Scene) -> None:
        self._controllers = {law.key: law.controller_of(scene.control) for law in scene.sampled}

    def sample(self, due: tuple[HeldLaw, ...], time: float, readings: Array) -> dict[str, float]:
        """Call controllers, and return their forces (N or N m) by the names of `equations.parameters`.

        Args:
            due: laws of the controllers.
            time: s.
            readings: (s, 2) coordinates of `Scene.sensed` (m or rad) and their rates.

        Raises:
            IntegrationError: for a controller that fails, or returns something else than a finite number.
        """
        forces = {}
        for law in due:
            try:
                force = self._controllers[law.key](time, *readings.T.copy())
            except Exception as error:
                reason = f"controller of joint {law.joint!r} failed: {type(error).__name__}: {error}"
                raise IntegrationError(time, _one_line(reason)) from error
            if not is_finite_number(force):
                reason = f"controller of joint {law.joint!r} returned {force!r:.200}"
                raise IntegrationError(time, _one_line(reason))
            forces[f"{law.prefix}.held"] = float(force)
        return forces


def _one_line(text: str) -> str:
    return " ".join(text.split())


class OfScene(Protocol):
    """Equations of a scene, which take control laws from it whenever they are evaluated."""

    scene: Scene


S = TypeVar("S", bound=OfScene)


def holding(system: S, forces: Mapping[str, float]) -> S:
    """Return the same equations with these constant forces, as `sample` returns them; models are shared."""
    changed = copy.copy(system)
    changed.scene = with_values(system.scene, forces)
    return changed


class NativeRun(NamedTuple):
    """A run in native code.

    Attributes:
        arrays: what the scene asks for at the output times that were reached; none if none was.
        counts: of steps and evaluations, by name.
        stopped: the error that ended the run before the last output; None if none did.
        wall_time: s, of the run itself, without making its integrator.
    """

    arrays: dict[str, Array]
    counts: dict[str, int]
    stopped: IntegrationError | None
    wall_time: float


def integrate_sampled(code: Code, x: Array, options: Options) -> NativeRun:
    """Run a scene from x (inputs,), which is changed."""
    if not code.scene.sampled:
        integrator = Integrator(code, code.scene.times, options)
        start = time.perf_counter()
        arrays, stopped = integrator.attempt(x)
        return NativeRun(arrays, integrator.counted, stopped, time.perf_counter() - start)
    start = time.perf_counter()
    parts: list[dict[str, Array]] = []
    total: Counter[str] = Counter()
    controllers = Controllers(code.scene)
    for interval in intervals(code.scene):
        readings = code.function("measured")(x).reshape(2, -1).T
        try:
            forces = controllers.sample(interval.due, float(interval.times[0]), readings)
        except IntegrationError as error:
            stopped = error
            break
        for name, force in forces.items():
            x[code.place(name)] = force
        integrator = Integrator(code, interval.times, options)
        arrays, stopped = integrator.attempt(x)
        total.update(integrator.counted)
        if arrays:
            parts.append({name: array[interval.wanted[: len(array)]] for name, array in arrays.items()})
        if stopped:
            break
        x[:] = integrator.x
    names = parts[0] if parts else {}
    arrays = {name: np.concatenate([part[name] for part in parts]) for name in names}
    return NativeRun(arrays, dict(total), stopped, time.perf_counter() - start)
