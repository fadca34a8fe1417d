"""(a) Long runs: what is left of the energy and of closed joints, and what of it is round-off."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache, partial

import numpy as np

from crosscheck.comparison.energy import energy_balance
from crosscheck.scenes import load
from crosscheck.studies.stress.cases import Bound, Case, Curve, Measured
from crosscheck.studies.stress.runs import (
    COMBINATIONS,
    TIGHT,
    Setting,
    largest_drift,
    lasting,
    mujoco,
    newton_euler,
    pinocchio,
)
from newton_euler.assemble import initial_state
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array

OUTPUTS = 200

LAST_DIGIT = 4.0 * np.finfo(float).eps
"""Share by which a run's start is off to be rounded differently from then on."""

PLAIN = Bound(1e-6, 1e-2, "no plot would show less; more than a hundredth is another motion")

DRIFT = Bound(1e-6, 1e-4, "a thousandth of a millimetre on a machine of 0.1 m")

PENDULUM: tuple[tuple[Setting, float], ...] = (
    *((setting, 1e4) for setting in COMBINATIONS),
    (newton_euler("relative", integrator="Radau", rtol=1e-6, atol=1e-8), 1e4),
    (newton_euler("relative", integrator="RK4", step=1e-2), 1e4),
    (newton_euler("relative", integrator="Euler", step=1e-3), 1e4),
    (mujoco("RK4", 1e-2), 1e4),
    (mujoco("Euler", 1e-2), 1e4),
    (mujoco("implicitfast", 1e-2), 1e4),
    (mujoco("RK4", 1e-3), 1e3),
    (pinocchio(), 100.0),
)

FOUR_BAR: tuple[tuple[Setting, float], ...] = (
    (newton_euler("relative", "projection"), 1e3),
    (newton_euler("cartesian", "projection"), 200.0),
    (newton_euler("relative", "baumgarte"), 10.0),
    (newton_euler("cartesian", "baumgarte"), 10.0),
    (newton_euler("relative", "none"), 10.0),
    (newton_euler("cartesian", "none"), 10.0),
    (mujoco("RK4", 2e-3), 200.0),
    (mujoco("implicitfast", 2e-3), 1e3),
    (pinocchio(), 10.0),
    (pinocchio(stabilization="projection"), 10.0),
)

TRACKER: tuple[tuple[Setting, float], ...] = (
    *((setting, 3600.0) for setting in COMBINATIONS),
    (newton_euler("relative", integrator="Radau", rtol=1e-8, atol=1e-10), 3600.0),
    (newton_euler("relative", integrator="RK4", step=1e-2), 3600.0),
    (mujoco("RK4", 1e-2), 3600.0),
    (mujoco("implicitfast", 1e-2), 3600.0),
    (pinocchio(), 60.0),
)


SHORTER = {"pendulum": 20.0, "four_bar": 20.0, "tracker": 40.0}
"""How many times shorter runs are if not in full; errors of the tracker, which comes to rest, do not grow."""


def cases(full: bool) -> list[Case]:
    """All of (a); `SHORTER` if not in full."""
    found = [
        _case(scene, setting, duration, PLAIN, full)
        for scene, runs in (("pendulum", PENDULUM), ("four_bar", FOUR_BAR), ("tracker", TRACKER))
        for setting, duration in runs
    ]
    for scene, duration in (("pendulum", 1e4), ("four_bar", 1e3)):
        each = duration / 1000.0
        reason = "1e-11 a thousand seconds, what is left of tolerances of 1e-13"
        found.append(_case(scene, TIGHT, duration, Bound(1e-11 * each, 1e-9 * each, reason), full))
    return found


def _case(scene: str, setting: Setting, duration: float, bound: Bound, full: bool) -> Case:
    time = duration if full else duration / SHORTER[scene]
    # the work of control costs MuJoCo a call of Python a step
    works = scene != "tracker" or setting.engine != "mujoco"
    return Case(
        "a",
        f"{scene}, {time:g} s",
        setting.engine,
        str(setting),
        "energy error" if works else "drift",
        "rel" if works else "m or rad",
        bound if works else DRIFT,
        partial(measure_energy if works else measure_drift, scene, setting, time),
        limit=(150.0 if duration >= 1e3 else 40.0) if full else 10.0,
    )


def measure_energy(name: str, setting: Setting, duration: float) -> Measured:
    """The largest energy error; in words its round-off, how it grows, and how far joints open.

    What rounding has added up to is seen by the same run from a start that is off in its last digits: steps
    have the same errors of their own, but for those that rounding decides to reject, and other roundings. An
    error of more than `PLAIN` allows is none of those.
    """
    scene = lasting(load(name), duration, OUTPUTS, "violation", "energy", "velocities")
    run = setting.simulate(scene)
    balance = energy_balance(scene, run)
    assert balance is not None
    unit = max(balance.exchanged, _exchanged(name))
    errors = np.abs(balance.residual) / unit
    curve, grows = _over_time(f"energy error, {name}", "rel", setting, scene.times, errors)
    note = f"drift {largest_drift(run):.1e} m or rad; {grows}"
    if np.max(errors) < PLAIN.survives:
        other = off_in_the_last_digit(scene)
        found = energy_balance(other, setting.simulate(other))
        assert found is not None
        rounding = float(np.max(np.abs(found.residual - balance.residual))) / unit
        note = f"accumulated round-off {rounding:.1e}; {note}"
    return Measured(float(np.max(errors)), note, curve)


def off_in_the_last_digit(scene: Scene) -> Scene:
    """The scene with gravity and its start larger by `LAST_DIGIT`."""
    more, state = 1.0 + LAST_DIGIT, initial_state(scene)
    state = replace(
        state,
        position=more * state.position,
        linear_velocity=more * state.linear_velocity,
        angular_velocity=more * state.angular_velocity,
    )
    return replace(scene, gravity=more * scene.gravity, initial_state=state)


@lru_cache
def _exchanged(name: str) -> float:
    """The energy, J, that a scene's first seconds exchange, which outputs minutes apart do not show."""
    scene = load(name)
    balance = energy_balance(scene, newton_euler().simulate(scene))
    assert balance is not None
    return balance.exchanged


def measure_drift(name: str, setting: Setting, duration: float) -> Measured:
    """How far joints open; in words how that grows."""
    scene = lasting(load(name), duration, OUTPUTS, "violation")
    run = setting.simulate(scene)
    assert run.constraint_violation is not None
    drift = np.max(run.constraint_violation, axis=1)
    curve, grows = _over_time(f"drift, {name}", "m or rad", setting, scene.times, drift)
    return Measured(float(np.max(drift)), grows, curve)


def _over_time(
    title: str, unit: str, setting: Setting, times: Array, errors: Array
) -> tuple[tuple[Curve, ...], str]:
    """The largest error so far, as a curve and in words."""
    envelope = np.maximum.accumulate(errors)
    seen = (times > 0.0) & (envelope > 0.0)
    x, y = (tuple(map(float, values[seen])) for values in (times, envelope))
    label = f"{setting.engine}, {setting}"
    curve = Curve(f"long runs: {title}", "time, s", f"largest so far, {unit}", label, x, y)
    return ((curve,) if x else ()), growth(times, envelope)


def growth(times: Array, envelope: Array) -> str:
    """The power of time that errors (n,) grow with, fitted to all but the first tenth of a run."""
    late = (times > 0.1 * times[-1]) & (envelope > 0.0)
    if np.count_nonzero(late) < 3 or envelope[late][-1] < 1.2 * envelope[late][0]:
        return "does not grow"
    power = np.polyfit(np.log(times[late]), np.log(envelope[late]), 1)[0]
    return f"grows like t^{power:.2f}"
