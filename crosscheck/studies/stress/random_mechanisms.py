"""Stress cases (j): equations of motion of all engines for random mechanisms at random consistent states.

Each engine's rigid equations are compared with newton_euler's joint coordinates in the same way as by
`crosscheck run`: by the levels of equations, with tolerances of round-off times the condition number. For
some mechanisms native code is compared with its float form.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np

from crosscheck.compare.check import Check
from crosscheck.compare.levels import compare_pair
from crosscheck.compare.samples import Samples, States
from crosscheck.studies.random_scenes import STANDARD_GRAVITY, random_scene
from crosscheck.studies.stress.cases import Bound, Case, Measurement
from crosscheck.studies.stress.runs import Setting
from crosscheck.support.errors import CrosscheckError
from newton_euler.compiled.equations import CompiledEquations
from newton_euler.compiled.formulations import FORMULATIONS
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.relative import Relative
from newton_euler.equations.system import System
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.runs.assemble import initial_state

NATIVE_TOLERANCE = 1e-8
"""Tolerance of native code relative to the largest acceleration.

Native code and float form evaluate the same equations in another order, at condition numbers up to 1e7.
"""

COMPILED_EVERY = 50
"""One of so many mechanisms is compiled; compilation takes ten times as long as the rest."""

MECHANISMS_PER_CASE = 20

MECHANISM_SEED = 0

TOLERANCE_RATIO = Bound(
    "value divided by its tolerance",
    "",
    1.0,
    1.0,
    "tolerances of `crosscheck run`: round-off times the condition of the mechanism",
)

COMPARED_SYSTEMS = (
    Setting("newton_euler", {"formulation": "cartesian"}),
    Setting("pinocchio", {"equations": "constraintDynamics"}),
    Setting("mujoco", {"equations": "rigid constraints"}),
)
"""Systems that are compared with newton_euler's joint coordinates."""

NATIVE_SETTINGS = tuple(
    Setting("newton_euler", {"formulation": name, "code": "native"}) for name in FORMULATIONS
)


def cases(full: bool) -> Iterator[Case]:
    """Yield the cases of (j)."""
    count = 1000 if full else 40
    for start in range(0, count, MECHANISMS_PER_CASE):
        numbers = range(start, start + MECHANISMS_PER_CASE)
        for setting in COMPARED_SYSTEMS:
            name = f"random mechanisms {start} to {start + MECHANISMS_PER_CASE - 1}"
            yield Case(name, setting, TOLERANCE_RATIO, partial(measure, MECHANISM_SEED, numbers), limit=60.0)
    numbers = range(0, count, COMPILED_EVERY)
    for setting in NATIVE_SETTINGS:
        name = f"random mechanisms 0 to {numbers[-1]}, every {COMPILED_EVERY}th"
        yield Case(name, setting, TOLERANCE_RATIO, partial(measure, MECHANISM_SEED, numbers), limit=100.0)


class Worst(NamedTuple):
    """Worst check of a mechanism.

    Attributes:
        share: value divided by its tolerance; infinite if the system failed.
        reason: description of the check, or the error.
    """

    share: float
    reason: str


def measure(seed: int, numbers: Sequence[int], setting: Setting) -> Measurement:
    """Compare a system with newton_euler on random mechanisms; measure the worst value by tolerance."""
    found = {}
    for number in numbers:
        worst = compare(_scene(seed, number), setting)
        if worst is not None:
            found[f"random_scene({seed}, {number})"] = worst
    agree = sum(worst.share <= 1.0 for worst in found.values())
    name, worst = max(found.items(), key=lambda item: item[1].share)
    return Measurement(worst.share, f"{agree} of {len(found)} agree; worst: {name}, {worst.reason}")


@lru_cache(maxsize=2 * MECHANISMS_PER_CASE)
def _scene(seed: int, number: int) -> Scene:
    return random_scene(seed, number)


def compare(scene: Scene, setting: Setting) -> Worst | None:
    """Compare one system on one mechanism; None if native code falls back to its float form."""
    if "code" in setting.options:
        off = native_difference(scene, setting.options["formulation"])
        return None if off is None else Worst(off / NATIVE_TOLERANCE, f"acceleration, rel {off:.1e}")
    states = States(scene, (initial_state(scene),))
    try:
        pair = [Samples(Relative(scene), states)], [Samples(_system(setting.engine, scene), states)]
        rows = [row for row in compare_pair(("relative", setting.engine), *pair) if row.judged]
    except (NewtonEulerError, CrosscheckError, np.linalg.LinAlgError) as error:
        return Worst(np.inf, str(error))
    worst = max(rows, key=_share)
    return Worst(_share(worst), f"{worst.level}: {worst.quantity} {worst.value:.1e}")


def _share(row: Check) -> float:
    share = row.value / row.tolerance
    return np.inf if np.isnan(share) else share


def _system(engine: str, scene: Scene) -> System:
    from mjcf.rigid import RigidMuJoCo
    from urdf.dynamics import PinocchioSystem

    systems = {"newton_euler": Cartesian, "pinocchio": PinocchioSystem, "mujoco": RigidMuJoCo}
    system: System = systems[engine](scene)
    return system


def native_difference(scene: Scene, formulation: str) -> float | None:
    """Return the relative difference of native and float accelerations; None if native code falls back to
    those."""
    code = CompiledEquations(scene, formulation)
    system = code.system
    x = code.packed(*system.coordinates(initial_state(scene)))
    found = code.function("derivative")(x)
    if not found[-1] > 0.0:
        return None
    units, size = system.velocity_units, scene.mechanism.size
    wanted = system.acceleration(x[: system.nq], x[system.nq : code.size]) / units
    scale = max(float(np.max(np.abs(wanted))), STANDARD_GRAVITY / size)
    return float(np.max(np.abs(found[system.nq : -1] / units - wanted))) / scale
