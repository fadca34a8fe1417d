"""Random mechanisms through all engines: their equations of motion at a random consistent state.

Each engine's rigid equations are compared with newton_euler's joint coordinates as `crosscheck run` compares
engines: levels 1 to 4, at tolerances of round-off times the condition of each mechanism. Now and then native
code is compared with its float form.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from crosscheck.comparison.figure import Figure
from crosscheck.comparison.levels import compare_pair
from crosscheck.comparison.samples import Samples, States
from crosscheck.errors import CrosscheckError
from crosscheck.studies.random_scenes import GRAVITY, random_scene
from crosscheck.studies.stress.cases import PROCESSES, Progress, Row
from crosscheck.workers import LostError, in_processes
from newton_euler.assemble import initial_state
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.relative import Relative
from newton_euler.equations.system import System
from newton_euler.errors import NewtonEulerError
from newton_euler.integrators.compiled import FORMULATIONS, Code
from newton_euler.model.scene import Scene

NATIVE_TOLERANCE = 1e-8
"""Of native code against its float form, relative to the largest acceleration: the same equations in another
order, at condition numbers up to 1e7."""

COMPILED_EVERY = 50
"""Native code of every so manieth mechanism is compared; compiling takes ten times as long as the rest."""

CHUNK = 20
"""Mechanisms that a process does at a time."""

SETTINGS = {
    "cartesian": ("newton_euler", "cartesian, floats"),
    "compiled relative": ("newton_euler", "relative, native"),
    "compiled cartesian": ("newton_euler", "cartesian, native"),
    "pinocchio": ("pinocchio", "constraintDynamics"),
    "mujoco_rigid": ("mujoco", "rigid constraints"),
}
"""Engine and setting of the systems that are compared with newton_euler's joint coordinates."""


@dataclass(frozen=True)
class Comparison:
    """One system on one random mechanism.

    Attributes:
        name: of the mechanism, as `random_scene` is called.
        system: a key of `SETTINGS`.
        worst: the figure that is the most of its tolerance; None where there is no answer.
        reason: why there is no answer; "" where there is one.
    """

    name: str
    system: str
    worst: Figure | None
    reason: str = ""

    @property
    def share(self) -> float:
        """The worst figure, of its tolerance; infinite without an answer."""
        return np.inf if self.worst is None else self.worst.value / self.worst.tolerance

    @property
    def agrees(self) -> bool:
        return self.worst is not None and self.worst.agrees


def compare_random(seed: int, number: int, compiled: bool = False) -> list[Comparison]:
    """Compare all engines on a random mechanism; `compiled`: native code with its float form, too."""
    scene, name = random_scene(seed, number), f"random_scene({seed}, {number})"
    states = States(scene, (initial_state(scene),))
    own, found = Samples(Relative(scene), states), list[Comparison]()
    for system, build in _systems().items():
        try:
            rows = [*compare_pair(("relative", system), [own], [Samples(build(scene), states)])]
        except (NewtonEulerError, CrosscheckError, np.linalg.LinAlgError) as error:
            found.append(Comparison(name, system, None, str(error)))
            continue
        worst = max((row for row in rows if not row.informs), key=lambda row: (not row.agrees, _share(row)))
        found.append(Comparison(name, system, worst))
    for formulation in FORMULATIONS if compiled else ():
        gap = native_gap(scene, formulation)
        if gap is not None:
            pair = (formulation, f"compiled {formulation}")
            figure = Figure("accelerations", "acceleration, rel", pair, gap, NATIVE_TOLERANCE, "")
            found.append(Comparison(name, pair[1], figure))
    return found


def _share(row: Figure) -> float:
    share = row.value / row.tolerance
    return np.inf if np.isnan(share) else share


def _systems() -> dict[str, Callable[[Scene], System]]:
    from mjcf.rigid import RigidMuJoCo
    from urdf.dynamics import PinocchioSystem

    kinds: tuple[type[Cartesian | PinocchioSystem | RigidMuJoCo], ...] = (
        Cartesian,
        PinocchioSystem,
        RigidMuJoCo,
    )
    return {kind.name: kind for kind in kinds}


def native_gap(scene: Scene, formulation: str) -> float | None:
    """Compare native accelerations with their float form; None where native code leaves them to that."""
    code = Code(scene, formulation)
    system = code.system
    x = code.packed(*system.coordinates(initial_state(scene)))
    found = code.function("derivative")(x)
    if not found[-1] > 0.0:
        return None
    units, size = system.velocity_units, scene.mechanism.size
    wanted = system.acceleration(x[: system.nq], x[system.nq : code.size]) / units
    scale = max(float(np.max(np.abs(wanted))), GRAVITY / size)
    return float(np.max(np.abs(found[system.nq : -1] / units - wanted))) / scale


def compare_some(seed: int, numbers: range) -> list[Comparison]:
    """Compare some random mechanisms of a seed, native code of every `COMPILED_EVERY`th."""
    return [each for k in numbers for each in compare_random(seed, k, k % COMPILED_EVERY == 0)]


def stress_random(count: int, seed: int, progress: Progress) -> list[Row]:
    """Compare engines on random mechanisms 0 to count - 1 of a seed; see `rows_of`."""
    chunks = [range(start, min(start + CHUNK, count)) for start in range(0, count, CHUNK)]
    start = time.perf_counter()
    results = in_processes(
        partial(compare_some, seed),
        chunks,
        PROCESSES,
        lambda done, _: progress(f"{min(done * CHUNK, count)} of {count} random mechanisms"),
    )
    found = list[Comparison]()
    for chunk, result in zip(chunks, results, strict=True):
        if isinstance(result, LostError):  # native code took the process along
            name = f"random_scene({seed}, {chunk.start} to {chunk.stop - 1})"
            found += [Comparison(name, system, None, str(result)) for system in _systems()]
        else:
            found += result
    return rows_of(found, time.perf_counter() - start)


def rows_of(comparisons: Sequence[Comparison], wall_time: float) -> list[Row]:
    """Return rows of a stress report: one per system, and one per mechanism that it does not agree on."""
    rows = list[Row]()
    for system, (engine, setting) in SETTINGS.items():
        found = [each for each in comparisons if each.system == system]
        if not found:
            continue
        wrong = [each for each in found if not each.agrees]
        worst = max(found, key=lambda each: each.share)
        rows.append(_row(worst, engine, setting))
        rows[-1] = replace(
            rows[-1],
            name="random mechanisms",
            reason=f"{len(found) - len(wrong)} of {len(found)} agree; worst: {worst.name}, {rows[-1].reason}",
            wall_time=wall_time,
        )
        rows += [_row(each, engine, setting) for each in wrong]
    return rows


def _row(found: Comparison, engine: str, setting: str) -> Row:
    worst = found.worst
    return Row(
        topic="j",
        name=found.name,
        engine=engine,
        setting=setting,
        quantity="figure by its tolerance",
        unit="",
        figure=found.share if np.isfinite(found.share) else None,
        bound="<= 1e+00",
        bound_reason="tolerances of `crosscheck run`: round-off times the condition of the mechanism",
        verdict="refuses" if worst is None else "survives" if found.agrees else "fails",
        reason=found.reason if worst is None else f"{worst.level}: {worst.quantity} {worst.value:.1e}",
        passes=found.agrees,
        wall_time=0.0,
    )
