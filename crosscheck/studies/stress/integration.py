"""Stress cases (a) and (b): drift and energy of long runs, and the largest usable steps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache, partial

import numpy as np

from crosscheck.library import load
from crosscheck.studies.bisection import smallest
from crosscheck.studies.stress.cases import ENERGY_BOUND, Bound, Case, Measurement
from crosscheck.studies.stress.runs import (
    COMBINATIONS,
    TIGHT,
    Setting,
    balance,
    distance,
    formulations,
    largest_drift,
    lasting,
    mujoco,
    newton_euler,
    pinocchio,
)
from newton_euler.compiled.formulations import FORMULATIONS
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array

# (a) Long runs: energy error, drift, and the part of the error that is accumulated round-off

LONG_RUN_OUTPUTS = 200

LAST_DIGIT = 4.0 * np.finfo(float).eps
"""Relative change of a start after which all results are rounded differently."""

DRIFT_BOUND = Bound("drift", "m or rad", 1e-6, 1e-4, "a thousandth of a millimeter on a machine of 0.1 m")

LONG_RUNS: dict[str, tuple[float, dict[float, tuple[Setting, ...]]]] = {
    "pendulum": (
        20.0,
        {
            1e4: (
                *COMBINATIONS,
                newton_euler(integrator="Radau", rtol=1e-6, atol=1e-8),
                newton_euler(integrator="RK4", step=1e-2),
                newton_euler(integrator="Euler", step=1e-3),
                *(mujoco(integrator, 1e-2) for integrator in ("RK4", "Euler", "implicitfast")),
            ),
            1e3: (mujoco("RK4", 1e-3),),
            100.0: (pinocchio(),),
        },
    ),
    "four_bar": (
        20.0,
        {
            1e3: (newton_euler("relative"), mujoco("implicitfast", 2e-3)),
            200.0: (newton_euler("cartesian"), mujoco("RK4", 2e-3)),
            10.0: (
                *(newton_euler(form, how) for how in ("baumgarte", "none") for form in FORMULATIONS),
                pinocchio(),
                pinocchio(stabilization="projection"),
            ),
        },
    ),
    "tracker": (
        40.0,
        {
            3600.0: (
                *COMBINATIONS,
                newton_euler(integrator="Radau", rtol=1e-8, atol=1e-10),
                newton_euler(integrator="RK4", step=1e-2),
                mujoco("RK4", 1e-2),
                mujoco("implicitfast", 1e-2),
            ),
            60.0: (pinocchio(),),
        },
    ),
}
"""Ratio of durations of the full and the short form, and settings by full duration (s), of each scene.

Runs of the tracker can be much shorter: it comes to rest, and its errors do not grow.
"""

TIGHT_RUN_DURATIONS = {"pendulum": 1e4, "four_bar": 1e3}
"""s, durations of runs at the tightest tolerance."""


def long_runs(full: bool) -> Iterator[Case]:
    """Yield the cases of (a)."""
    for scene, (shorter, runs) in LONG_RUNS.items():
        for duration, settings in runs.items():
            for setting in settings:
                # MuJoCo would call Python at every step to integrate the work of control
                works = scene != "tracker" or setting.engine != "mujoco"
                bound = ENERGY_BOUND if works else DRIFT_BOUND
                yield _long_run(scene, setting, duration, 1.0 if full else shorter, bound)
    for scene, duration in TIGHT_RUN_DURATIONS.items():
        each = duration / 1000.0
        reason = "1e-11 per thousand seconds, the error expected at tolerances of 1e-13"
        bound = replace(ENERGY_BOUND, survives=1e-11 * each, degrades=1e-9 * each, reason=reason)
        yield _long_run(scene, TIGHT, duration, 1.0 if full else LONG_RUNS[scene][0], bound)


def _long_run(scene: str, setting: Setting, duration: float, shorter: float, bound: Bound) -> Case:
    measure = measure_drift if bound is DRIFT_BOUND else measure_energy
    limit = 10.0 if shorter > 1.0 else 150.0 if duration >= 1e3 else 40.0
    time = duration / shorter
    return Case(f"{scene}, {time:g} s", setting, bound, partial(measure, scene, time), limit=limit)


def measure_energy(name: str, duration: float, setting: Setting) -> Measurement:
    """Measure the largest energy error; note its growth, the accumulated round-off, and the drift.

    The accumulated round-off is the change of the error if the start differs in its last digits. The run then
    has the same truncation errors (except at steps that round-off decides to reject) and other rounding
    errors. If the error exceeds `ENERGY_BOUND`, the error is not round-off.
    """
    scene = lasting(load(name), duration, LONG_RUN_OUTPUTS, "violation", "energy", "velocities")
    run = setting.simulate(scene)
    found = balance(scene, run)
    unit = max(found.exchanged, _exchanged(name))
    errors = np.abs(found.residual) / unit
    grows = growth(scene.times, np.maximum.accumulate(errors))
    note = f"drift {largest_drift(run):.1e} m or rad; {grows}"
    if np.max(errors) < ENERGY_BOUND.survives:
        other = off_in_the_last_digit(scene)
        residual = balance(other, setting.simulate(other)).residual
        rounding = float(np.max(np.abs(residual - found.residual))) / unit
        note = f"accumulated round-off {rounding:.1e}; {note}"
    return Measurement(float(np.max(errors)), note)


def off_in_the_last_digit(scene: Scene) -> Scene:
    """Return the scene with gravity and initial state multiplied by 1 + `LAST_DIGIT`."""
    more, state = 1.0 + LAST_DIGIT, initial_state(scene)
    names = ("position", "linear_velocity", "angular_velocity")
    state = replace(state, **{name: more * getattr(state, name) for name in names})
    return replace(scene, gravity=more * scene.gravity, initial_state=state)


@lru_cache
def _exchanged(name: str) -> float:
    """Return the energy, J, that the scene exchanges in its first seconds; long runs have too few outputs for
    it."""
    scene = load(name)
    return balance(scene, newton_euler().simulate(scene)).exchanged


def measure_drift(name: str, duration: float, setting: Setting) -> Measurement:
    """Measure the largest drift; note its growth."""
    scene = lasting(load(name), duration, LONG_RUN_OUTPUTS, "violation")
    run = setting.simulate(scene)
    assert run.constraint_violation is not None
    drift = np.max(run.constraint_violation, axis=1)
    return Measurement(float(np.max(drift)), growth(scene.times, np.maximum.accumulate(drift)))


def growth(times: Array, envelope: Array) -> str:
    """Report the power of time with which an envelope (n,) of errors grows after the first tenth of a run."""
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
    "largest step", "s", 1e-3, 1e-4, "MuJoCo's usual step is 2 ms; a tenth of that costs too much", True
)
TOLERANCE_BOUND = Bound(
    "loosest rtol", "", 1e-4, 1e-7, "scipy's default is 1e-3; a tenth of that should be enough", True
)

ADAPTIVE = ("DOP853", "Radau")

STEP_DURATIONS = {"tracker": 5.0, "pendulum": 10.0}
"""s, durations of the runs by scene."""


def largest_steps(full: bool) -> Iterator[Case]:
    """Yield the cases of (b). The short form has the tracker only."""
    stepped = [setting for integrator in ("RK4", "Euler") for setting in formulations(integrator=integrator)]
    stepped += [Setting("mujoco", {"integrator": i}) for i in ("RK4", "Euler", "implicit", "implicitfast")]
    stepped += [pinocchio(integrator=i) for i in ("RK4", "Euler")]
    adaptive = [setting for integrator in ADAPTIVE for setting in formulations(integrator=integrator)]
    if not full:
        adaptive.pop()  # Radau in Cartesian coordinates compiles for half a minute
    adaptive += [pinocchio(integrator=i) for i in ADAPTIVE]
    for scene, duration in STEP_DURATIONS.items() if full else [("tracker", STEP_DURATIONS["tracker"])]:
        for bound, settings in ((STEP_BOUND, stepped), (TOLERANCE_BOUND, adaptive)):
            for setting in settings:
                name = f"{scene}, {duration:g} s within {USABLE_ERROR:.0%}"
                yield Case(name, setting, bound, partial(measure_largest, scene), limit=100.0)


@lru_cache
def _reference(name: str) -> tuple[Scene, Trajectory]:
    scene = lasting(load(name), STEP_DURATIONS[name], 10)
    return scene, TIGHT.simulate(scene)


def measure_largest(name: str, setting: Setting) -> Measurement:
    """Find the largest usable step (s), or relative tolerance of an adaptive method, by bisection."""
    scene, reference = _reference(name)
    adaptive = setting.options["integrator"] in ADAPTIVE

    def size(n: int) -> float:
        """Return candidate n: ten tolerances per decade, or n steps from one output to the next."""
        return float(10.0 ** (-n / 10.0)) if adaptive else scene.output_period / n

    def succeeds(n: int) -> bool:
        tried = {"timestep" if setting.engine == "mujoco" else "step": size(n)}
        if adaptive:
            tried = {"rtol": size(n), "atol": 1e-2 * size(n)}
        try:
            run = replace(setting, options={**setting.options, **tried}).simulate(scene)
        except (NewtonEulerError, np.linalg.LinAlgError):
            return False
        return distance(run, reference) < USABLE_ERROR * scene.mechanism.size

    n = smallest(succeeds, 120 if adaptive else MAX_STEPS_PER_OUTPUT)
    if n is None:
        return Measurement(float("nan"), "no candidate is small enough")
    return Measurement(size(n), "the largest candidate" if n == 1 else "")
