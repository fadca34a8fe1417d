"""Integration: long runs, the largest steps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache, partial

import numpy as np

from crosscheck.library import load
from crosscheck.studies.bisection import smallest
from crosscheck.studies.stress.cases import ENERGY, Bound, Case, Measured
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

# (a) Long runs: what is left of the energy and of closed joints, and what of it is round-off

OUTPUTS = 200

LAST_DIGIT = 4.0 * np.finfo(float).eps
"""Share by which a run's start is off to be rounded differently from then on."""

DRIFT = Bound("drift", "m or rad", 1e-6, 1e-4, "a thousandth of a millimeter on a machine of 0.1 m")

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
"""How many times shorter runs of a scene are if not in full (errors of the tracker, which comes to rest, do
not grow), and settings by duration, s."""

TIGHT_RUNS = {"pendulum": 1e4, "four_bar": 1e3}
"""s."""


def long_runs(full: bool) -> Iterator[Case]:
    """Yield the cases of (a)."""
    for scene, (shorter, runs) in LONG_RUNS.items():
        for duration, settings in runs.items():
            for setting in settings:
                # the work of control costs MuJoCo a call of Python a step
                works = scene != "tracker" or setting.engine != "mujoco"
                yield _long_run(
                    scene, setting, duration, 1.0 if full else shorter, ENERGY if works else DRIFT
                )
    for scene, duration in TIGHT_RUNS.items():
        each = duration / 1000.0
        reason = "1e-11 a thousand seconds, what is left of tolerances of 1e-13"
        bound = replace(ENERGY, survives=1e-11 * each, degrades=1e-9 * each, reason=reason)
        yield _long_run(scene, TIGHT, duration, 1.0 if full else LONG_RUNS[scene][0], bound)


def _long_run(scene: str, setting: Setting, duration: float, shorter: float, bound: Bound) -> Case:
    measure = measure_drift if bound is DRIFT else measure_energy
    limit = 10.0 if shorter > 1.0 else 150.0 if duration >= 1e3 else 40.0
    time = duration / shorter
    return Case(f"{scene}, {time:g} s", setting, bound, partial(measure, scene, time), limit=limit)


def measure_energy(name: str, duration: float, setting: Setting) -> Measured:
    """Measure the largest energy error; note its round-off, how it grows, and how far joints open.

    What rounding has added up to is seen by the same run from a start that is off in its last digits: steps
    have the same errors of their own, but for those that rounding decides to reject, and other roundings. An
    error of more than `ENERGY` allows is none of those.
    """
    scene = lasting(load(name), duration, OUTPUTS, "violation", "energy", "velocities")
    run = setting.simulate(scene)
    found = balance(scene, run)
    unit = max(found.exchanged, _exchanged(name))
    errors = np.abs(found.residual) / unit
    grows = growth(scene.times, np.maximum.accumulate(errors))
    note = f"drift {largest_drift(run):.1e} m or rad; {grows}"
    if np.max(errors) < ENERGY.survives:
        other = off_in_the_last_digit(scene)
        residual = balance(other, setting.simulate(other)).residual
        rounding = float(np.max(np.abs(residual - found.residual))) / unit
        note = f"accumulated round-off {rounding:.1e}; {note}"
    return Measured(float(np.max(errors)), note)


def off_in_the_last_digit(scene: Scene) -> Scene:
    """Return the scene with gravity and its start larger by `LAST_DIGIT`."""
    more, state = 1.0 + LAST_DIGIT, initial_state(scene)
    names = ("position", "linear_velocity", "angular_velocity")
    state = replace(state, **{name: more * getattr(state, name) for name in names})
    return replace(scene, gravity=more * scene.gravity, initial_state=state)


@lru_cache
def _exchanged(name: str) -> float:
    """Return the energy, J, that a scene's first seconds exchange; outputs minutes apart do not show it."""
    scene = load(name)
    return balance(scene, newton_euler().simulate(scene)).exchanged


def measure_drift(name: str, duration: float, setting: Setting) -> Measured:
    """Measure how far joints open; note how that grows."""
    scene = lasting(load(name), duration, OUTPUTS, "violation")
    run = setting.simulate(scene)
    assert run.constraint_violation is not None
    drift = np.max(run.constraint_violation, axis=1)
    return Measured(float(np.max(drift)), growth(scene.times, np.maximum.accumulate(drift)))


def growth(times: Array, envelope: Array) -> str:
    """Name the power of time that errors (n,) grow with, fitted to all but the first tenth of a run."""
    late = (times > 0.1 * times[-1]) & (envelope > 0.0)
    if np.count_nonzero(late) < 3 or envelope[late][-1] < 1.2 * envelope[late][0]:
        return "does not grow"
    power = np.polyfit(np.log(times[late]), np.log(envelope[late]), 1)[0]
    return f"grows like t^{power:.2f}"


# (b) The largest step and the loosest tolerance that still give the answer

SHARE = 0.1
"""Of the mechanism's size: bodies further from where they should be are not there."""

MOST_STEPS = 20_000
"""Between two outputs; nobody takes shorter steps for a motion of seconds."""

STEP = Bound(
    "largest step", "s", 1e-3, 1e-4, "MuJoCo's usual step is 2 ms; a tenth of that costs too much", True
)
TOLERANCE = Bound(
    "loosest rtol", "", 1e-4, 1e-7, "scipy's default is 1e-3; nobody expects more of a looser one", True
)

ADAPTIVE = ("DOP853", "Radau")

DURATIONS = {"tracker": 5.0, "pendulum": 10.0}
"""s."""


def largest_steps(full: bool) -> Iterator[Case]:
    """Yield the cases of (b); the tracker's only if not in full."""
    stepped = [setting for integrator in ("RK4", "Euler") for setting in formulations(integrator=integrator)]
    stepped += [Setting("mujoco", {"integrator": i}) for i in ("RK4", "Euler", "implicit", "implicitfast")]
    stepped += [pinocchio(integrator=i) for i in ("RK4", "Euler")]
    adaptive = [setting for integrator in ADAPTIVE for setting in formulations(integrator=integrator)]
    if not full:
        adaptive.pop()  # half a minute to compile
    adaptive += [pinocchio(integrator=i) for i in ADAPTIVE]
    for scene, duration in DURATIONS.items() if full else [("tracker", DURATIONS["tracker"])]:
        for bound, settings in ((STEP, stepped), (TOLERANCE, adaptive)):
            for setting in settings:
                name = f"{scene}, {duration:g} s within {SHARE:.0%}"
                yield Case(name, setting, bound, partial(measure_largest, scene), limit=100.0)


@lru_cache
def _sought(name: str) -> tuple[Scene, Trajectory]:
    scene = lasting(load(name), DURATIONS[name], 10)
    return scene, TIGHT.simulate(scene)


def measure_largest(name: str, setting: Setting) -> Measured:
    """Measure, by bisection, the step (s) of methods with fixed steps or the relative tolerance of others."""
    scene, reference = _sought(name)
    adaptive = setting.options["integrator"] in ADAPTIVE

    def size(n: int) -> float:
        """Return the n-th to try: ten tolerances per decade, or n steps from one output to the next."""
        return float(10.0 ** (-n / 10.0)) if adaptive else scene.output_period / n

    def succeeds(n: int) -> bool:
        tried = {"timestep" if setting.engine == "mujoco" else "step": size(n)}
        if adaptive:
            tried = {"rtol": size(n), "atol": 1e-2 * size(n)}
        try:
            run = replace(setting, options={**setting.options, **tried}).simulate(scene)
        except (NewtonEulerError, np.linalg.LinAlgError):
            return False
        return distance(run, reference) < SHARE * scene.mechanism.size

    n = smallest(succeeds, 120 if adaptive else MOST_STEPS)
    if n is None:
        return Measured(float("nan"), "none is small enough")
    return Measured(size(n), "the largest there is to try" if n == 1 else "")
