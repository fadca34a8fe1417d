"""Stress cases (a) and (b): constraint drift and energy error of long runs, and the largest usable steps.

A case measures one value of one engine, such as MuJoCo, at one setting, an integrator with
its options. A bound judges the value: within its limit `survives` the value passes, beyond its limit
`degrades` the engine fails. Topic (a) runs scenes for up to 10,000 s. Topic (b) searches for the largest
step, or the loosest tolerance of adaptive integrators, whose motion is still usable. `full` selects all cases
rather than the short form of continuous integration.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from itertools import product

import numpy as np

from crosscheck.engines.engine import Engine
from crosscheck.engines.limits import CannotExpressError
from crosscheck.engines.registry import SOLVER, choose
from crosscheck.library import load
from crosscheck.studies.bisection import smallest
from crosscheck.studies.stress.cases import ENERGY_BOUND, Bound, Case, Measurement
from crosscheck.studies.stress.runs import (
    REFERENCE_SETTING,
    Setting,
    balance_of,
    largest_distance,
    largest_drift,
    solver_setting,
    with_duration,
)
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array

# (a) Long runs: energy error, drift, and the part of the error that is accumulated round-off

LONG_RUN_OUTPUTS = 200
"""Number of output periods of a long run."""

LAST_DIGIT = 4.0 * np.finfo(float).eps
"""Relative change of an initial state in its last digits, which changes the rounding of all results."""

DRIFT_BOUND = Bound(
    "drift",
    "m or rad",
    survives=1e-6,
    degrades=1e-4,
    reason="a thousandth of a millimeter on a machine of 0.1 m",
)
"""Bound on the largest constraint violation in a long run."""


SHORTER = {"pendulum": 20.0, "four_bar": 20.0, "tracker": 40.0}
"""Factors by which long runs of the short form are shorter, by scene. The tracker comes to rest and its
errors do not grow, so that its short form may be 40 times shorter."""

REFERENCE_RUN_DURATIONS = {"pendulum": 1e4, "four_bar": 1e3}
"""Durations, s, of runs with `REFERENCE_SETTING`, by scene."""


def long_run_cases(full: bool, engines: Sequence[Engine]) -> Iterator[Case]:
    """Yield the cases of topic (a), all of them or (unless `full`) the short form."""
    for (scene, shorter), engine in product(SHORTER.items(), engines):
        for duration, settings in engine.stress().long_runs.get(scene, {}).items():
            # The energy error needs the work of controllers; without it, only the drift is measured
            measures_drift = bool(load(scene).control) and not engine.stress().integrates_work
            bound = DRIFT_BOUND if measures_drift else ENERGY_BOUND
            for setting in (Setting(engine.name, options) for options in settings):
                yield _long_run(scene, setting, duration, 1.0 if full else shorter, bound)
    for scene, duration in REFERENCE_RUN_DURATIONS.items() if SOLVER in engines else ():
        thousands = duration / 1000.0
        reason = "1e-11 per thousand seconds, the error expected at tolerances of 1e-13"
        bound = replace(ENERGY_BOUND, survives=1e-11 * thousands, degrades=1e-9 * thousands, reason=reason)
        yield _long_run(scene, REFERENCE_SETTING, duration, 1.0 if full else SHORTER[scene], bound)


def _long_run(scene: str, setting: Setting, duration: float, shorter: float, bound: Bound) -> Case:
    """Return the case of a long run, which measures the drift or the energy error.

    Args:
        scene: name of the scene.
        setting: engine and options.
        duration: duration of the full form, s.
        shorter: factor by which the run is shorter; 1 for the full form.
        bound: bound on the value; it selects what is measured.
    """
    measure = measure_drift if bound is DRIFT_BOUND else measure_energy
    limit = 10.0 if shorter > 1.0 else 150.0 if duration >= 1e3 else 40.0  # s of CPU time
    time = duration / shorter
    return Case(f"{scene}, {time:g} s", setting, bound, partial(measure, scene, time), time_limit=limit)


def measure_energy(name: str, duration: float, setting: Setting) -> Measurement:
    """Measure the largest energy error of a long run, relative to the energy scale of the motion.

    The note has the growth of the error, the accumulated round-off, and the constraint drift.

    The accumulated round-off is measured by a second run whose initial state differs in its last digits. Both
    runs have the same truncation errors (except at steps that round-off decides to reject) and different
    rounding errors, so that the difference of their energy errors is round-off. An error above `ENERGY_BOUND`
    is no round-off, and there is no second run.

    Args:
        name: name of the scene.
        duration: duration of the run, s.
        setting: engine and options.
    """
    scene = with_duration(load(name), duration, LONG_RUN_OUTPUTS, "violation", "energy", "velocities")
    run = setting.simulate(scene)
    balance = balance_of(scene, run)  # its `residual` is the energy error (n,), J
    scale = max(balance.scale, _energy_scale(name))
    errors = np.abs(balance.residual) / scale
    growth_text = growth(scene.times, np.maximum.accumulate(errors))
    note = f"drift {largest_drift(run):.1e} m or rad; {growth_text}"
    if np.max(errors) < ENERGY_BOUND.survives:
        other = with_changed_last_digit(scene)
        residual = balance_of(other, setting.simulate(other)).residual
        rounding = float(np.max(np.abs(residual - balance.residual))) / scale
        note = f"accumulated round-off {rounding:.1e}; {note}"
    return Measurement(float(np.max(errors)), note)


def with_changed_last_digit(scene: Scene) -> Scene:
    """Return the scene with gravity, initial positions and velocities multiplied by 1 + `LAST_DIGIT`."""
    factor, state = 1.0 + LAST_DIGIT, initial_state(scene)
    names = ("position", "linear_velocity", "angular_velocity")
    state = replace(state, **{name: factor * getattr(state, name) for name in names})
    return replace(scene, gravity=factor * scene.gravity, initial_state=state)


@lru_cache
def _energy_scale(name: str) -> float:
    """Return the energy scale, J, of the motion of a library scene, from a run with the scene's own duration
    and outputs.

    The outputs of a long run are too far apart to find this energy: the largest change of the total energy
    plus the largest kinetic energy.
    """
    scene = load(name)
    return balance_of(scene, solver_setting().simulate(scene)).scale


def measure_drift(name: str, duration: float, setting: Setting) -> Measurement:
    """Measure the largest constraint violation of a long run, m or rad; note its growth.

    Arguments are as for `measure_energy`.
    """
    scene = with_duration(load(name), duration, LONG_RUN_OUTPUTS, "violation")
    run = setting.simulate(scene)
    assert run.constraint_violation is not None
    drift = np.max(run.constraint_violation, axis=1)
    return Measurement(float(np.max(drift)), growth(scene.times, np.maximum.accumulate(drift)))


def growth(times: Array, envelope: Array) -> str:
    """Fit the growth of errors with time by a power, and format it: "grows like t^0.50" or "does not grow".

    The first tenth of the run is ignored.

    Args:
        times: output times (n,), s.
        envelope: largest error (n,) from the start until each time.
    """
    late = (times > 0.1 * times[-1]) & (envelope > 0.0)
    if np.count_nonzero(late) < 3 or envelope[late][-1] < 1.2 * envelope[late][0]:
        return "does not grow"
    power = np.polyfit(np.log(times[late]), np.log(envelope[late]), 1)[0]
    return f"grows like t^{power:.2f}"


# (b) Largest step and loosest tolerance with a usable motion

USABLE_ERROR = 0.1
"""Largest position error of a usable motion, in units of the mechanism's size."""

MAX_STEPS_PER_OUTPUT = 20_000
"""Largest number of fixed steps between two outputs; shorter steps are impractical for seconds of motion."""

STEP_BOUND = Bound(
    "largest step",
    "s",
    survives=1e-3,
    degrades=1e-4,
    reason="a usual step of robot simulations is 2 ms; a tenth of that costs too much",
    at_least=True,
)
"""Bound on the largest usable fixed step."""

TOLERANCE_BOUND = Bound(
    "loosest rtol",
    "",
    survives=1e-4,
    degrades=1e-7,
    reason="scipy's default is 1e-3; a tenth of that should be enough",
    at_least=True,
)
"""Bound on the loosest usable tolerance of adaptive integrators."""

STEP_DURATIONS = {"tracker": 5.0, "pendulum": 10.0}
"""Durations of runs, s, by scene."""


def step_size_cases(full: bool, engines: Sequence[Engine]) -> Iterator[Case]:
    """Yield the cases of topic (b), all of them or (unless `full`) those of the tracker."""
    stepped = [Setting(each.name, options) for each in engines for options in each.stress().stepped]
    adaptive = [
        Setting(engine.name, options)
        for engine in engines
        # without the last one of newton_euler, which compiles for half a minute
        for options in engine.stress().adaptive[: None if full or engine is not SOLVER else -1]
    ]
    for scene, duration in STEP_DURATIONS.items() if full else [("tracker", STEP_DURATIONS["tracker"])]:
        for bound, settings in ((STEP_BOUND, stepped), (TOLERANCE_BOUND, adaptive)):
            for setting in settings:
                name, is_adaptive = (
                    f"{scene}, {duration:g} s within {USABLE_ERROR:.0%}",
                    bound is TOLERANCE_BOUND,
                )
                yield Case(
                    name, setting, bound, partial(measure_largest, scene, is_adaptive), time_limit=100.0
                )


@lru_cache
def _reference(name: str) -> tuple[Scene, Trajectory]:
    """Return a scene of `STEP_DURATIONS` with ten outputs, and its reference run."""
    scene = with_duration(load(name), STEP_DURATIONS[name], 10)
    return scene, REFERENCE_SETTING.simulate(scene)


def measure_largest(name: str, adaptive: bool, setting: Setting) -> Measurement:
    """Find the largest usable step, s, or the loosest relative tolerance of an adaptive method, by bisection.

    Args:
        name: name of the scene.
        adaptive: True to search a tolerance, the options `rtol` and `atol`; False to search a step.
        setting: engine, and options with the integrator but without a step or tolerance.
    """
    scene, reference = _reference(name)
    step_option = choose([setting.engine])[0].stress().step_option

    def candidate(n: int) -> float:
        """Return the step, s, for n steps per output period; or the tolerance 10^(-n / 10)."""
        return float(10.0 ** (-n / 10.0)) if adaptive else scene.output_period / n

    def succeeds(n: int) -> bool:
        """Return True if the run with candidate n is usable."""
        tried = {step_option: candidate(n)}
        if adaptive:
            tried = {"rtol": candidate(n), "atol": 1e-2 * candidate(n)}
        try:
            run = replace(setting, options={**setting.options, **tried}).simulate(scene)
        except CannotExpressError:
            raise
        except (NewtonEulerError, np.linalg.LinAlgError):
            return False
        return largest_distance(run, reference) < USABLE_ERROR * scene.mechanism.size

    # n is the smallest number that succeeds, or None; the last one of 120 tolerances is 1e-12
    n = smallest(succeeds, 120 if adaptive else MAX_STEPS_PER_OUTPUT)
    if n is None:
        return Measurement(float("nan"), "no candidate is small enough")
    return Measurement(candidate(n), "the largest candidate" if n == 1 else "")
