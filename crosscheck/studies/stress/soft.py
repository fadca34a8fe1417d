"""(d) MuJoCo's soft constraints: what is off because they are soft, and what because of the step.

At one time constant of `solref`, ever smaller steps lead to the motion of the soft mechanism. Its distance
from the rigid one is the softness error; the rest is the error of the step.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache, partial

import numpy as np

from crosscheck.scenes import load
from crosscheck.studies.stress.cases import Bound, Case, Curve, Measured, Row
from crosscheck.studies.stress.runs import TIGHT, Setting, distance, lasting, mujoco
from newton_euler.assemble import initial_state
from newton_euler.errors import NewtonEulerError
from newton_euler.model.trajectory import Trajectory

DURATION = 5.0
OUTPUTS = 50

SOFTNESS = Bound(
    "softness error",
    "m",
    1e-5,
    1e-3,
    "a hundredth of a millimeter on a machine of 0.1 m; a millimeter can be seen",
)
STEP = replace(SOFTNESS, quantity="step error at two steps")
REACTIONS = Bound("reaction error", "rel", 1e-2, 1e-1, "a sensor of forces has one per cent")

TIME_CONSTANTS = (0.1, 0.02, 0.01, 4e-3, 2e-3, 1e-3, 4e-4)
"""s; what MuJoCo takes by itself is 0.02."""

SHARES = (2, 4, 10)
"""Steps in a time constant; MuJoCo allows no fewer than two."""

FINEST = 20
"""Steps in a time constant that come near enough to none at all."""


def cases(full: bool) -> Iterator[Case]:
    """Yield the cases of (d)."""
    integrators = ("RK4", "Euler", "implicitfast") if full else ("RK4",)
    for constant in TIME_CONSTANTS if full else TIME_CONSTANTS[1:-3]:
        name = f"tracker, {DURATION:g} s, time constant {constant:g} s"
        zero = Setting("mujoco", {"timestep": "step to zero"})
        yield Case(name, zero, SOFTNESS, partial(measure_softness, constant), limit=60.0)
        for integrator in integrators:
            setting = Setting("mujoco", {"integrator": integrator})
            yield Case(name, setting, STEP, partial(measure_steps, constant), limit=60.0)
    setting = Setting("mujoco", {"solimp": "solimp 0.9999"})
    yield Case(
        "tracker at t = 0, soft and rigid equations of one model", setting, REACTIONS, measure_reactions
    )


@lru_cache
def _rigid() -> Trajectory:
    return TIGHT.simulate(lasting(load("tracker"), DURATION, OUTPUTS))


def _run(integrator: str, time_constant: float, share: int) -> Trajectory:
    scene = lasting(load("tracker"), DURATION, OUTPUTS)
    return mujoco(integrator, time_constant / share, solref=(time_constant, 1.0)).simulate(scene)


@lru_cache
def _soft(time_constant: float) -> Trajectory:
    """Return the soft mechanism's own motion: RK4 is of order 4 while the time constant stays as it is."""
    return _run("RK4", time_constant, FINEST)


def measure_softness(time_constant: float, setting: Setting) -> Measured:
    """Measure how far the soft mechanism's own motion is from the rigid one."""
    soft = _soft(time_constant)
    left = distance(_run("RK4", time_constant, FINEST // 2), soft)
    return Measured(distance(soft, _rigid()), f"known to {left:.0e} m, what halving the step changes")


def measure_steps(time_constant: float, setting: Setting) -> Measured:
    """Measure how far a run at two steps per time constant is from the soft mechanism's own motion."""
    integrator, soft, rigid = setting.options["integrator"], _soft(time_constant), _rigid()
    found = []
    for share in SHARES:
        with suppress(NewtonEulerError):  # too long a step: what shorter ones make of it is in the curve
            run = _run(integrator, time_constant, share)
            found.append((share, time_constant / share, distance(run, soft), distance(run, rigid)))
    if not found or found[0][0] != SHARES[0]:
        return Measured(float("nan"), f"diverges at a step of {time_constant / SHARES[0]:g} s")
    _, steps, errors, totals = zip(*found, strict=True)
    curve = Curve(
        "MuJoCo's error over step at fixed solref",
        "step, s",
        "position error against the rigid mechanism, m",
        f"{integrator}, time constant {time_constant:g} s",
        steps,
        totals,
    )
    finer = ", ".join(
        f"{error:.1e} at {step:.3g} s" for step, error in zip(steps[1:], errors[1:], strict=True)
    )
    return Measured(errors[0], f"{finer}; with softness {totals[0]:.1e} at {steps[0]:.3g} s", (curve,))


def measure_reactions(setting: Setting) -> Measured:
    """Compare soft reactions with those of the same model under rigid constraints, of the largest."""
    from mjcf.rigid import RigidMuJoCo
    from mjcf.soft import SoftMuJoCo

    scene = load("tracker")
    soft, rigid = (
        system.evaluate(*system.coordinates(initial_state(scene)))
        for system in (SoftMuJoCo(scene), RigidMuJoCo(scene))
    )
    largest = np.max(np.linalg.norm(rigid.reaction_force, axis=1))
    off = np.max(np.linalg.norm(soft.reaction_force - rigid.reaction_force, axis=1)) / largest
    return Measured(float(off), "whatever the step: solimp is capped at 0.9999")


def recommendation(rows: Sequence[Row]) -> str:
    """Say what the figures of this topic speak for; empty without any."""
    softness = {row.name: row.figure for row in rows if row.quantity == SOFTNESS.quantity}
    ratios: dict[str, list[float]] = {}
    for row in rows:
        soft = softness.get(row.name)
        if row.quantity == STEP.quantity and row.figure is not None and np.isfinite(row.figure) and soft:
            ratios.setdefault(row.setting, []).append(row.figure / soft)
    told = []
    for integrator, found in ratios.items():
        ratio = float(np.median(found))
        advice = (
            "softness is most of the error, so take the shortest time constant that MuJoCo allows, "
            "`solref = (2 timestep, 1)`, and shorten both together"
            if ratio < 1.0
            else "the step is most of the error, so a stiffer `solref` gains nothing; "
            "a shorter step does, and another integrator more"
        )
        told.append(f"- {integrator}: at two steps a time constant the error of the step is "
                    f"{ratio:.2g} times that of softness (median); {advice}.")  # fmt: skip
    if not told:
        return ""
    best = min(ratios, key=lambda integrator: float(np.median(ratios[integrator])))
    return "\n".join([f"Recommended: {best} with `solref = (2 timestep, 1)`.", "", *told])
