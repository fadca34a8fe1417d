"""Stress cases, topic (h): equations of motion of all engines for random mechanisms at random states.

The states are consistent: they satisfy all constraints. At each state the equations of an engine are compared
with newton_euler's equations in joint coordinates, as `crosscheck run` does: masses, kinematics,
accelerations and reactions. Tolerances are round-off times the condition number of the equations that
determine the accelerations. For some mechanisms, newton_euler's compiled (native) code is compared with the
same equations evaluated in Python. `crosscheck.studies.stress.topics` lists the topics.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np

from crosscheck.compare.check import Check
from crosscheck.compare.levels import compare_pair
from crosscheck.compare.samples import Samples, States
from crosscheck.engines.engine import Engine
from crosscheck.engines.limits import CannotExpressError, Limit, require_expressed
from crosscheck.engines.registry import SOLVER, choose
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
"""Tolerance of accelerations from native code, relative to the largest acceleration.

Native code evaluates the equations in another order than Python, at condition numbers up to 1e7.
"""

COMPILED_EVERY = 50
"""Every 50th mechanism is compiled to native code; compilation takes ten times as long as the comparison."""

MECHANISMS_PER_CASE = 20
"""Number of mechanisms in one case."""

RANDOM_SEED = 0
"""Seed of the random mechanisms, see `random_scene`."""

TOLERANCE_RATIO = Bound(
    quantity="value divided by its tolerance",
    unit="",
    survives=1.0,
    degrades=1.0,
    reason="tolerances of `crosscheck run`: round-off times the condition of the mechanism",
)
"""Bound on the compared value of a mechanism that is largest in units of its tolerance.

Values above the tolerance are failures, not merely inaccurate (`degrades`)."""

NATIVE_SETTINGS = tuple(
    Setting(SOLVER.name, {"formulation": name, "code": "native"}) for name in FORMULATIONS
)
"""Native code of both formulations of newton_euler, compared with the equations evaluated in Python."""


def compared_systems(engines: Sequence[Engine]) -> tuple[Setting, ...]:
    """Return the equations of engines that are compared with newton_euler's in joint coordinates.

    The options are for the report; `_system` chooses the equations by the engine's name.
    """
    cartesian, rigid = {"formulation": "cartesian"}, {"equations": "rigid constraints"}
    return tuple(Setting(each.name, cartesian if each is SOLVER else rigid) for each in engines)


def cases(full: bool, engines: Sequence[Engine]) -> Iterator[Case]:
    """Yield the cases of topic (h): 1000 mechanisms, or (unless `full`) 40 mechanisms."""
    count = 1000 if full else 40
    for start in range(0, count, MECHANISMS_PER_CASE):
        numbers = range(start, start + MECHANISMS_PER_CASE)
        for setting in compared_systems(engines):
            name = f"random mechanisms {start} to {start + MECHANISMS_PER_CASE - 1}"
            yield Case(
                name, setting, TOLERANCE_RATIO, partial(measure, RANDOM_SEED, numbers), time_limit=60.0
            )
    numbers = range(0, count, COMPILED_EVERY)
    for setting in NATIVE_SETTINGS if SOLVER in engines else ():
        name = f"random mechanisms 0 to {numbers[-1]}, every {COMPILED_EVERY}th"
        yield Case(name, setting, TOLERANCE_RATIO, partial(measure, RANDOM_SEED, numbers), time_limit=100.0)


class WorstCheck(NamedTuple):
    """Worst of all checks of one mechanism.

    Attributes:
        ratio: value of the check divided by its tolerance; infinite if the engine raised an error.
        reason: description of the check, or the error message.
    """

    ratio: float
    reason: str


def measure(seed: int, numbers: Sequence[int], setting: Setting) -> Measurement:
    """Compare the equations of an engine with newton_euler's for several random mechanisms.

    The measured value is the largest ratio of a value to its tolerance.

    Args:
        seed: seed of the mechanisms.
        numbers: numbers of the mechanisms, see `random_scene`.
        setting: one of `compared_systems` or `NATIVE_SETTINGS`.

    Raises:
        CannotExpressError: if the engine can express none of the mechanisms.
    """
    found, refusals = {}, list[CannotExpressError]()
    for number in numbers:
        try:
            worst = compare_on_mechanism(_scene(seed, number), setting)
        except CannotExpressError as error:
            refusals.append(error)
            continue
        if worst is not None:
            found[f"random_scene({seed}, {number})"] = worst
    if refusals and not found:
        raise refusals[0]
    agree = sum(worst.ratio <= 1.0 for worst in found.values())
    name, worst = max(found.items(), key=lambda item: item[1].ratio)
    note = f"{agree} of {len(found)} agree; worst: {name}, {worst.reason}"
    return Measurement(worst.ratio, f"{note}; {len(refusals)} not expressed" if refusals else note)


@lru_cache(maxsize=2 * MECHANISMS_PER_CASE)
def _scene(seed: int, number: int) -> Scene:
    """Return a random scene; the cache keeps it for the next engine."""
    return random_scene(seed, number)


def compare_on_mechanism(scene: Scene, setting: Setting) -> WorstCheck | None:
    """Compare the equations of an engine with newton_euler's for one mechanism; return the worst check.

    None if native code cannot evaluate the state and leaves it to Python.

    Raises:
        CannotExpressError: if the engine cannot express the mechanism, or has no equations.
    """
    if "code" in setting.options:
        error = native_code_difference(scene, setting.options["formulation"])
        if error is None:
            return None
        return WorstCheck(error / NATIVE_TOLERANCE, f"acceleration, rel {error:.1e}")
    states = States(scene, (initial_state(scene),))
    try:
        pair = [Samples(Relative(scene), states)], [Samples(_system(setting.engine, scene), states)]
        checks = [check for check in compare_pair(("relative", setting.engine), *pair) if check.judged]
    except CannotExpressError:
        raise
    except (NewtonEulerError, CrosscheckError, np.linalg.LinAlgError) as error:
        return WorstCheck(np.inf, str(error))
    worst = max(checks, key=_tolerance_ratio)
    return WorstCheck(_tolerance_ratio(worst), f"{worst.level}: {worst.quantity} {worst.value:.1e}")


def _tolerance_ratio(check: Check) -> float:
    """Return the value of a check divided by its tolerance; infinity for NaN."""
    ratio = check.value / check.tolerance
    return np.inf if np.isnan(ratio) else ratio


def _system(engine: str, scene: Scene) -> System:
    """Return the equations of motion of a scene by an engine; newton_euler's in Cartesian coordinates."""
    if engine == SOLVER.name:
        return Cartesian(scene)
    (chosen,) = choose([engine])
    require_expressed(engine, chosen.limits(scene))
    systems = chosen.systems(scene)
    require_expressed(engine, [] if systems else [Limit("equations of motion", "only its runs are compared")])
    return systems[0]


def native_code_difference(scene: Scene, formulation: str) -> float | None:
    """Return the relative difference of accelerations between native code and Python at the initial state.

    None if the elimination without pivoting fails in native code at this state. Runs then use Python there.

    Args:
        scene: the scene.
        formulation: "relative" or "cartesian".
    """
    code = CompiledEquations(scene, formulation)
    system = code.system
    # inputs: q (nq,), v (nv,), and from index `code.size` = nq + nv on, the time, flags and parameters
    x = code.packed(*system.coordinates(initial_state(scene)))
    # Native code returns dq/dt, dv/dt, and a pivot ratio of the elimination that solves for dv/dt: its
    # smallest pivot relative to the typical one. Without a positive ratio the elimination failed
    *derivatives, pivot_ratio = code.function("derivative")(x)
    if not pivot_ratio > 0.0:
        return None
    # The largest difference of accelerations in units of angles and of mechanism sizes
    units, size = system.velocity_units, scene.mechanism.size
    exact = system.acceleration(x[: system.nq], x[system.nq : code.size]) / units
    scale = max(float(np.max(np.abs(exact))), STANDARD_GRAVITY / size)
    return float(np.max(np.abs(derivatives[system.nq :] / units - exact))) / scale
