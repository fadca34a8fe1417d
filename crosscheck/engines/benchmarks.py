"""Benchmarks of an engine: settings from coarse to fine, right-hand sides, and batches.

A setting is a method (equations of motion and integrator) with its step or tolerance. A ladder is a list of
settings of one method, from coarse to fine. The time of a run includes everything until the poses of all
bodies at all outputs are known in the engine's own form. A right-hand side evaluates accelerations from
coordinates and velocities, once. A batch is many runs of one scene.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, Protocol

import numpy as np

from crosscheck.support.errors import CrosscheckError
from newton_euler.equations.system import System, at_time
from newton_euler.integrators.options import Options as IntegratorOptions
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.runs.simulate import IntegratedStates, integrate_scene
from newton_euler.scalars import Array

Options = dict[str, Any]
"""Options of a run by name, such as the integrator, the step or the tolerance."""

Poses = tuple[Array, Array]
"""Positions (n, b, 3), m, and quaternions (n, b, 4) of the bodies, ground first, at the output times."""


class Run(NamedTuple):
    """One timed run.

    Attributes:
        seconds: duration of the run, s.
        evaluations: number of evaluations of the equations of motion.
        poses: converts the results to `Poses`, which is not part of the timed run.
    """

    seconds: float
    evaluations: int
    poses: Callable[[], Poses]


class Ladder(NamedTuple):
    """Settings of one method, from the coarsest to the finest.

    Attributes:
        method: name of the method.
        make_setting: returns the name and the options of setting n. The larger n, the smaller the step or
            tolerance.
        numbers: the values of n that are run, ascending.
        common: options that all settings share.
    """

    method: str
    make_setting: Callable[[int], tuple[str, Options]]
    numbers: Sequence[int]
    common: Options

    def setting(self, number: int) -> tuple[str, Options]:
        """Return the full name and all options of setting n."""
        name, options = self.make_setting(number)
        return f"{self.method}, {name}", self.common | options


class Model(NamedTuple):
    """A scene, loaded into an engine with one variant of its equations.

    Attributes:
        ladders: settings of each method.
        run: simulates the scene with given options; raises an exception if the engine fails.
    """

    ladders: Sequence[Ladder]
    run: Callable[[Options], Run]


Models = Mapping[str, Callable[[], Model]]
"""Functions that load a scene into an engine, one for each variant of its equations, by name."""


class RightHandSide(NamedTuple):
    """Right-hand side of an engine for one scene, ready to be called.

    Attributes:
        repeat: makes a number of calls and returns their duration, s.
        operations: number of floating-point operations in one call; None if it is unknown.
    """

    repeat: Callable[[int], float]
    operations: int | None = None


class CompletedBatch(NamedTuple):
    """A batch that was simulated.

    Attributes:
        seconds: duration of the simulation, s.
        setup: duration before the simulation of loading the scene and converting states for the engine, s.
        poses: computes the poses of each run, positions and quaternions of all bodies at all output times;
            raises the error of a run that failed.
        failed: number of runs that failed.
    """

    seconds: float
    setup: float
    poses: Callable[[], list[Poses]]
    failed: int = 0


class BatchEngine(Protocol):
    """An engine that simulates batches of one scene.

    Attributes:
        name: name of the engine.
        delivers: description of the results whose computation is included in the time.
    """

    name: str
    delivers: str

    def ladders(self) -> Iterator[Ladder]:
        """Yield a ladder for each method: its settings, numbered from coarse to fine."""

    def run(self, options: Options, states: Sequence[State], threads: int) -> CompletedBatch:
        """Simulate one run from each state, with the options of a setting, on a number of threads."""


class Benchmarks(NamedTuple):
    """The benchmarks of an engine.

    Attributes:
        models: returns functions that load a scene, one for each variant of the equations.
        right_hand_sides: functions that make a right-hand side of a scene, by the name of the interface.
        batch: makes the engine of batches of a scene, for an output period of single runs, s, whose shortest
            step is also the shortest one of batches; None if the engine has no batches.
        one_by_one: the same for batches whose runs are simulated one after another, with the settings that
            are the fastest in `batch`.
    """

    models: Callable[[Scene], Models] = lambda scene: {}
    right_hand_sides: Mapping[str, Callable[[Scene], RightHandSide]] = {}
    batch: Callable[[Scene, float], BatchEngine] | None = None
    one_by_one: Callable[[Scene], BatchEngine] | None = None


ATOL_PER_RTOL = (1.0, 1e-2)
"""Ratios of absolute tolerance (SI units) and relative tolerance (rtol) that are run."""

FINEST_DECADE = 13.5
"""Negative decimal logarithm of the finest rtol, 3e-14. At finer tolerances round-off dominates."""

PYTHON_DECADES = range(3, 14, 2)
"""Negative decimal logarithms of the tolerances of equations that Python evaluates. At finer ones, steps of
DOP853 fail on the round-off of equations with loops."""


def tolerance_ladder(
    method: str, coarsest: float, finest: float, atol_per_rtol: float, per_decade: int = 2, **options: Any
) -> Ladder:
    """Make a ladder of relative tolerances (rtol).

    Args:
        method: name of the method.
        coarsest: the largest rtol is 10^-coarsest.
        finest: the smallest rtol is 10^-finest.
        atol_per_rtol: ratio of absolute and relative tolerance.
        per_decade: number of tolerances per factor of ten.
        **options: options that all settings share.
    """

    def make_setting(number: int) -> tuple[str, Options]:
        rtol = 10.0 ** (-number / per_decade)
        return f"rtol {rtol:.2g}", {"rtol": rtol, "atol": atol_per_rtol * rtol}

    numbers = range(round(coarsest * per_decade), round(finest * per_decade) + 1)
    return Ladder(f"{method}, atol = {atol_per_rtol:g} rtol", make_setting, numbers, options)


def projected(make_system: Callable[[], System]) -> Model:
    """Make the model of equations that Python evaluates: DOP853 with projection, at `PYTHON_DECADES`."""

    def make_setting(number: int) -> tuple[str, Options]:
        return f"rtol 1e-{number}", {"rtol": 10.0**-number, "atol": 10.0 ** -(number + 2)}

    ladder = Ladder("DOP853", make_setting, PYTHON_DECADES, {})

    def run(options: Options) -> Run:
        return integrated(integrate_scene(make_system(), IntegratorOptions(**options)))

    return Model([ladder], run)


def integrated(found: IntegratedStates) -> Run:
    """Return the timed run of integrated states; raises the error of a run that stopped.

    Forward kinematics at the outputs are not part of its time. They take some 10 us each.
    """
    if found.stopped:
        raise found.stopped

    def poses() -> Poses:
        """Evaluate the poses of the states."""
        states = [at_time(each.system, each.time).state(each.q, each.v) for each in found.outputs]
        return np.array([each.position for each in states]), np.array([each.quaternion for each in states])

    return Run(found.wall_time, found.evaluations, poses)


def step_ladder(method: str, option: str, interval: float, numbers: Sequence[int], **options: Any) -> Ladder:
    """Make a ladder of fixed steps.

    Args:
        method: name of the method.
        option: name of the option that sets the step. The option "number" takes the number of steps per
            output interval, any other option takes the step in s.
        interval: time between outputs, s.
        numbers: numbers of steps from one output to the next.
        **options: options that all settings share.
    """

    def make_setting(number: int) -> tuple[str, Options]:
        step = interval / number
        return f"step {step:.3g} s", {option: number if option == "number" else step}

    return Ladder(method, make_setting, numbers, options)


def output_interval(scene: Scene) -> float:
    """Return the time between the first two outputs, s."""
    return float(scene.times[1] - scene.times[0])


def poses_only(scene: Scene) -> Scene:
    """Return the scene with the poses of its bodies as its only outputs.

    Raises:
        CrosscheckError: for a scene with a sampled controller, whose Python code would take most of the time.
    """
    if scene.sampled:
        raise CrosscheckError(
            f"scene {scene.name!r} has a sampled controller; bench needs native control laws"
        )
    return replace(scene, outputs=frozenset())
