"""MuJoCo: the step, solref and solimp for an error, and softness told apart from another model."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from crosscheck.advice.measured import WANTED, Advice, Found, distance
from crosscheck.stiffness import is_stable_in_rk4, modes_of_run
from newton_euler.equations.couplings import couplings
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree

NAME = "mujoco"

FARTHEST = 4.0
"""How many times longer than the longer of two measured steps one may be: orders hold nearby."""

ORDERS = (0.5, 4.5)
"""Between which a measured order is believed."""

MARGIN = 0.9
"""Share of the step that the error asks for, since the order is not measured exactly."""


def soft_advice(found: Found) -> Iterator[Advice]:
    """For runs of one model in which MuJoCo ran beside an engine whose constraints are rigid.

    Softness is told of only where there is something soft.
    """
    if NAME not in found.runs or len(found.runs) < 2 or not found.models_agree:
        return
    run, error = found.runs[NAME], found.errors[NAME]
    other = min((key for key in found.runs if key != NAME), key=lambda key: distance(run, found.runs[key]))
    try:
        finer = distance(found.engine(NAME).refined(found.scene), found.runs[other])
    except NewtonEulerError:
        return
    if min(error, finer) == 0.0:
        return
    apart = any(row.level == "trajectories" and NAME in row.between and not row.agrees for row in found.rows)
    if apart and has_equalities(found.scene):
        yield Advice(
            "softness",
            "MuJoCo's constraints are soft, the model is the same: made rigid they agree in all that was "
            f"compared before the runs, and half the step takes MuJoCo's distance to {other} from "
            f"{error:.2g} to {finer:.2g} (m, rad)",
        )
    yield _step_advice(found, error, finer)


def _step_advice(found: Found, error: float, finer: float) -> Advice:
    """The step for the wanted error, by errors at the step that was taken and at half of it."""
    settings = found.runs[NAME].settings
    step, order = float(settings["timestep"]), float(np.log2(error / finer))
    measured = f"at {step:.4g} s it is {error:.2g}, at half of that {finer:.2g}, an order of {order:.2g}"
    if not ORDERS[0] <= order <= ORDERS[1]:
        return Advice(NAME, f"its error does not follow its step, so that none can be advised: {measured}")
    wanted = MARGIN * step * (WANTED / error) ** (1.0 / order)
    wanted = fitting(found.scene, min(wanted, FARTHEST * step))
    if wanted > step and settings["integrator"] == "RK4":
        modes = modes_of_run(found.scene, found.runs.get("newton_euler"))
        wanted = wanted if is_stable_in_rk4(modes, wanted) else step
    relation = "is enough for" if wanted >= step else "is needed for"
    held = ""
    if has_equalities(found.scene):
        solimp = " ".join(f"{value:g}" for value in settings["solimp"])  # MuJoCo's default gives way far more
        held = f', solref "{2.0 * wanted:.12g} 1" and solimp "{solimp}" of all equalities'
    return Advice(
        NAME,
        f"{settings['integrator']} with timestep {wanted:.12g} s{held} {relation} an error of {WANTED:g} "
        f"(m, rad): {measured}",
    )


def has_equalities(scene: Scene) -> bool:
    """True if MuJoCo has soft constraints in a scene: loops, gears, screws or prescribed motions."""
    return bool(SpanningTree(scene.mechanism).cuts or couplings(scene))


def fitting(scene: Scene, step: float) -> float:
    """The largest step, s, of at most `step` that is a whole part of the time between outputs and samples.

    Divided by twos and fives, so that it can be written down.
    """
    from mjcf.simulate import default_timestep

    period = default_timestep(scene)
    if not scene.sampled and scene.output_period <= scene.duration:
        period = scene.output_period
    number = max(1, int(np.ceil(period / step * (1.0 - 1e-9))))
    while _without(_without(number, 2), 5) != 1:
        number += 1
    return period / number


def _without(number: int, prime: int) -> int:
    while number % prime == 0:
        number //= prime
    return number
