"""(b) The largest step and the loosest tolerance that still give the answer."""

from __future__ import annotations

from functools import lru_cache, partial
from typing import Any

import numpy as np

from crosscheck.scenes import load
from crosscheck.studies.stress.cases import Bound, Case, Measured
from crosscheck.studies.stress.runs import (
    FORMULATIONS,
    TIGHT,
    Setting,
    distance,
    last_good,
    lasting,
    mujoco,
    newton_euler,
    pinocchio,
)
from newton_euler.errors import NewtonEulerError
from newton_euler.model.trajectory import Trajectory
from newton_euler.simulate import CompiledScene

OUTPUTS = 10

SHARE = 0.1
"""Of the mechanism's size: bodies further from where they should be are not there."""

MOST_STEPS = 20_000
"""Between two outputs; nobody takes shorter steps for a motion of seconds."""

STEP = Bound(1e-3, 1e-4, "MuJoCo's usual step is 2 ms; a tenth of that costs too much", at_least=True)
TOLERANCE = Bound(1e-4, 1e-7, "scipy's default is 1e-3; nobody expects more of a looser one", at_least=True)

DURATIONS = {"tracker": 5.0, "pendulum": 10.0}
"""s."""


def cases(full: bool) -> list[Case]:
    """All of (b); the tracker only if not in full."""
    stepped = [newton_euler(f, integrator=i) for f in FORMULATIONS for i in ("RK4", "Euler")]
    stepped += [mujoco(i) for i in ("RK4", "Euler", "implicit", "implicitfast")]
    stepped += [pinocchio(integrator=i) for i in ("RK4", "Euler")]
    adaptive = [newton_euler(f, integrator=i) for f in FORMULATIONS for i in ("DOP853", "Radau")]
    if not full:
        adaptive.pop()  # half a minute to compile
    adaptive += [pinocchio(integrator=i) for i in ("DOP853", "Radau")]
    scenes = tuple(DURATIONS) if full else ("tracker",)
    return [
        *(_case(scene, setting, "largest step", "s", STEP) for scene in scenes for setting in stepped),
        *(_case(scene, setting, "loosest rtol", "", TOLERANCE) for scene in scenes for setting in adaptive),
    ]


def _case(scene: str, setting: Setting, quantity: str, unit: str, bound: Bound) -> Case:
    options = {name: value for name, value in setting.options.items() if name != "timestep"}
    return Case(
        "b",
        f"{scene}, {DURATIONS[scene]:g} s within {SHARE:.0%}",
        setting.engine,
        str(Setting(setting.engine, options)),
        quantity,
        unit,
        bound,
        partial(measure, scene, setting.engine, options),
        limit=100.0,
    )


@lru_cache
def _reference(name: str) -> Trajectory:
    return TIGHT.simulate(lasting(load(name), DURATIONS[name], OUTPUTS))


def measure(name: str, engine: str, options: dict[str, str]) -> Measured:
    """By bisection, the step (s) of methods with fixed steps or the relative tolerance of others."""
    scene = lasting(load(name), DURATIONS[name], OUTPUTS)
    reference = _reference(name)
    integrator = options["integrator"]
    adaptive = integrator in ("DOP853", "Radau")
    compiled = CompiledScene(scene, options["formulation"]) if engine == "newton_euler" else None

    def control(n: int) -> dict[str, Any]:
        if adaptive:
            return {"rtol": tolerance(n), "atol": 1e-2 * tolerance(n)}
        return {"timestep" if engine == "mujoco" else "step": scene.output_period / n}

    def ok(n: int) -> bool:
        try:
            if compiled:
                run = compiled.simulate(integrator, **control(n))
            else:
                run = Setting(engine, {"integrator": integrator, **control(n)}).simulate(scene)
        except (NewtonEulerError, np.linalg.LinAlgError):
            return False
        return distance(run, reference) < SHARE * scene.mechanism.size

    n = last_good(ok, 1, 120 if adaptive else MOST_STEPS)
    if n is None:
        return Measured(float("nan"), "none is small enough")
    figure = tolerance(n) if adaptive else scene.output_period / n
    return Measured(figure, "the largest there is to try" if n == 1 else "")


def tolerance(n: int) -> float:
    """The n-th of those to try, ten a decade."""
    return float(10.0 ** (-n / 10.0))
