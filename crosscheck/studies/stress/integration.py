"""Integration: long runs, the largest steps, Baumgarte's gain against step size.

An error e of a constraint under Baumgarte's gain obeys e'' + 2 alpha e' + alpha^2 e = 0, whose eigenvalue
-alpha is double. RK4 with steps h is stable to h alpha = 2.785 along the negative real axis (Hairer, Wanner,
Solving Ordinary Differential Equations II, section IV.2).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np

from crosscheck.scenes import load
from crosscheck.studies.bisection import smallest
from crosscheck.studies.stress.cases import SMALLEST, Bound, Case, Curve, Measured
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
from newton_euler.assemble import initial_state
from newton_euler.errors import NewtonEulerError
from newton_euler.integrators.compiled import FORMULATIONS
from newton_euler.integrators.fixed_step import RK4_LIMIT
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array
from newton_euler.simulate import CompiledScene

# (a) Long runs: what is left of the energy and of closed joints, and what of it is round-off

OUTPUTS = 200

LAST_DIGIT = 4.0 * np.finfo(float).eps
"""Share by which a run's start is off to be rounded differently from then on."""

ENERGY = Bound(
    "energy error", "rel", 1e-6, 1e-2, "no plot would show less; more than a hundredth is another motion"
)
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
    curve, grows = _over_time(f"energy error, {name}", "rel", setting, scene.times, errors)
    note = f"drift {largest_drift(run):.1e} m or rad; {grows}"
    if np.max(errors) < ENERGY.survives:
        other = off_in_the_last_digit(scene)
        residual = balance(other, setting.simulate(other)).residual
        rounding = float(np.max(np.abs(residual - found.residual))) / unit
        note = f"accumulated round-off {rounding:.1e}; {note}"
    return Measured(float(np.max(errors)), note, curve)


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
    curve, grows = _over_time(f"drift, {name}", "m or rad", setting, scene.times, drift)
    return Measured(float(np.max(drift)), grows, curve)


def _over_time(
    title: str, unit: str, setting: Setting, times: Array, errors: Array
) -> tuple[tuple[Curve, ...], str]:
    """Return the largest error so far, as a curve and in words."""
    envelope = np.maximum.accumulate(errors)
    seen = (times > 0.0) & (envelope > 0.0)
    x, y = (tuple(map(float, values[seen])) for values in (times, envelope))
    curve = Curve(f"long runs: {title}", "time, s", f"largest so far, {unit}", setting.label, x, y)
    return ((curve,) if x else ()), growth(times, envelope)


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
    integrator, adaptive = setting.options["integrator"], setting.options["integrator"] in ADAPTIVE
    simulate: Callable[..., Trajectory] = lambda **more: Setting(  # noqa: E731
        setting.engine, {"integrator": integrator, **more}
    ).simulate(scene)
    if setting.engine == "newton_euler":
        simulate = partial(CompiledScene(scene, setting.options["formulation"]).simulate, integrator)

    def size(n: int) -> float:
        """Return the n-th to try: ten tolerances per decade, or n steps from one output to the next."""
        return float(10.0 ** (-n / 10.0)) if adaptive else scene.output_period / n

    def succeeds(n: int) -> bool:
        if adaptive:
            options = {"rtol": size(n), "atol": 1e-2 * size(n)}
        else:
            options = {"timestep" if setting.engine == "mujoco" else "step": size(n)}
        try:
            run = simulate(**options)
        except (NewtonEulerError, np.linalg.LinAlgError):
            return False
        return distance(run, reference) < SHARE * scene.mechanism.size

    n = smallest(succeeds, 120 if adaptive else MOST_STEPS)
    if n is None:
        return Measured(float("nan"), "none is small enough")
    return Measured(size(n), "the largest there is to try" if n == 1 else "")


# (c) Baumgarte's gain against step size: where it is stable, and what it leaves open

MOTION_LIMIT = 2e-2
"""s, the largest step of `STEPS` that the motion itself allows, whatever keeps it on its constraints."""

STEPS = (1e-1, 5e-2, 2e-2, 1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4)
"""s."""

PROJECTED = Bound("drift", "m or rad", 1e-13, 1e-9, "projection leaves round-off open")


def baumgarte(full: bool) -> Iterator[Case]:
    """Yield the cases of (c)."""
    duration, per_decade = (5.0, 2) if full else (2.0, 1)
    alphas = [float(f"{10.0 ** (k / per_decade):.2g}") for k in range(-per_decade, 4 * per_decade + 1)]
    for formulation in FORMULATIONS:
        options = {"formulation": formulation, "integrator": "RK4"}
        setting = Setting("newton_euler", {**options, "stabilization": "baumgarte"})
        for alpha in alphas if full else alphas[1::2]:
            name = f"tracker, {duration:g} s, alpha {alpha:g} 1/s"
            yield Case(name, setting, border(alpha), partial(measure_gain, alpha, duration))
        setting = Setting("newton_euler", {**options, "stabilization": "projection"})
        name = f"tracker, {duration:g} s, smallest step {STEPS[-1]:g} s"
        yield Case(name, setting, PROJECTED, partial(measure_projection, duration))


def border(alpha: float) -> Bound:
    """Return the bound of the largest stable step at a gain, 1/s."""
    theory = min(RK4_LIMIT / alpha, MOTION_LIMIT)
    reason = "0.4 of 2.785/alpha or of what the motion allows: steps of 1, 2, 5 are tried"
    return Bound("largest stable step", "s", 0.4 * theory, 0.1 * theory, reason, at_least=True)


class Stable(NamedTuple):
    """The steps, s, that are stable, with the errors of positions, m, and the drifts, m or rad."""

    steps: tuple[float, ...]
    errors: tuple[float, ...]
    drifts: tuple[float, ...]

    def curves(self, formulation: str, label: str) -> tuple[Curve, ...]:
        plot = f"Baumgarte against projection, {formulation}"
        return (
            Curve(f"{plot}: drift", "step, s", "drift, m or rad", label, self.steps, self.drifts),
            Curve(f"{plot}: position error", "step, s", "position error, m", label, self.steps, self.errors),
        )


@lru_cache
def _tracker(duration: float) -> tuple[Scene, Trajectory]:
    scene = lasting(load("tracker"), duration, round(duration / 0.1), "violation")
    return scene, TIGHT.simulate(scene)


def _sweep(setting: Setting, alpha: float, duration: float) -> Stable:
    """Try all `STEPS`."""
    scene, reference = _tracker(duration)
    compiled = CompiledScene(scene, setting.options["formulation"], setting.options["stabilization"], alpha)
    stable = []
    for step in STEPS:
        try:
            run = compiled.simulate("RK4", step=step)
        except NewtonEulerError:
            continue
        error = distance(run, reference)
        if error < SHARE * scene.mechanism.size:
            stable.append((step, error, max(largest_drift(run), SMALLEST)))
    return Stable(*zip(*stable, strict=True)) if stable else Stable((), (), ())


def measure_gain(alpha: float, duration: float, setting: Setting) -> Measured:
    """Measure the largest step that is stable; note where drift is least."""
    found = _sweep(setting, alpha, duration)
    if not found.steps:
        return Measured(float("nan"), f"no step down to {STEPS[-1]:g} s is stable")
    largest, best = found.steps[0], int(np.argmin(found.drifts))
    note = (
        f"alpha h there {alpha * largest:.2g}; least drift {found.drifts[best]:.1e} m or rad "
        f"and position error {found.errors[best]:.1e} m at step {found.steps[best]:g} s"
    )
    region = ("Baumgarte's stable region", "alpha, 1/s", "largest stable step, s")
    formulation = setting.options["formulation"]
    curves = (
        *found.curves(formulation, f"alpha {alpha:g}"),
        Curve(*region, formulation, (alpha,), (largest,)),
        Curve(*region, f"{RK4_LIMIT} / alpha", (alpha,), (RK4_LIMIT / alpha,)),
    )
    return Measured(largest, note, curves)


def measure_projection(duration: float, setting: Setting) -> Measured:
    """Measure the drift at the smallest step."""
    found = _sweep(setting, 0.0, duration)
    note = f"largest stable step {found.steps[0]:g} s; position error {found.errors[-1]:.1e} m"
    return Measured(found.drifts[-1], note, found.curves(setting.options["formulation"], "projection"))
