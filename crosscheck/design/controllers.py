"""Controllers of a scene side by side: tracking error, effort and energy in each engine."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from crosscheck.engines.engine import ENGINES
from crosscheck.library import SCENES, load
from crosscheck.library.options import options_of
from crosscheck.report.table import Column, Rows, Table, figures, texts
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.time_limits import paced
from newton_euler.analysis.loads.envelope import work_and_energy
from newton_euler.model.control import ComputedTorque, DeclaredLaw, reference
from newton_euler.model.digital_control import Digital
from newton_euler.model.motions import TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

OPTION = "controller"
"""Of a scene that has several."""

OUTPUTS = 1000
"""In a run, at least, by which means and integrals over time are taken."""


class Performance(NamedTuple):
    """Figures of one run, over coordinates of one kind whose laws follow targets; m, N, J or rad, N m, J.

    Attributes:
        error_rms, error_peak: of x - r, the root of the mean square over time of all coordinates, and the
            largest.
        force_rms, force_peak: of the actuators, likewise.
        energy: J, of all actuators, see `work_and_energy`.
    """

    error_rms: float
    error_peak: float
    force_rms: float
    force_peak: float
    energy: float


def controllers(scene: str, given: Mapping[str, str | float]) -> Iterator[tuple[str, Scene]]:
    """Yield the scene with each of its controllers, or as it is if it has no option for that.

    Raises:
        CrosscheckError: for a scene without laws that follow targets.
    """
    known = options_of(SCENES[scene]) if scene in SCENES else {}
    values: object = known[OPTION].values if OPTION in known and OPTION not in given else ()
    names = [str(value) for value in values] if isinstance(values, tuple) else []
    for name in names or [""]:
        loaded = load(scene, **given, **({OPTION: name} if name else {}))
        if not _targets(loaded):
            raise CrosscheckError(f"scene {loaded.name!r} has no control law that follows a target")
        yield name or str(given.get(OPTION, "as declared")), loaded


def performance(scene: Scene, run: Trajectory) -> dict[str, Performance]:
    """Compute the figures of a run with velocities and actuation, of slides and of hinges."""
    found: dict[str, dict[int, float | TimeFunction]] = {}
    for k, target in _targets(scene).items():
        law = scene.control[k]
        kind = "slides" if scene.mechanism.is_slide(law.joint, law.coordinate) else "hinges"
        found.setdefault(kind, {})[k] = target
    return {kind: _performance(scene, run, targets) for kind, targets in found.items()}


def _performance(scene: Scene, run: Trajectory, targets: Mapping[int, float | TimeFunction]) -> Performance:
    """Compute the figures of the laws of these numbers, by what they follow."""
    assert run.actuator_force is not None
    errors, energy = [], 0.0
    forces = run.actuator_force[:, list(targets)]
    for force, (k, target) in zip(forces.T, targets.items(), strict=True):
        law = scene.control[k]
        x = run.joint(law.joint).coordinates[:, law.coordinate]
        energy += float(work_and_energy(force, x)[1][-1])
        errors.append(x - [float(reference(target, float(t)).value) for t in run.time])

    def magnitudes(figures: Array) -> tuple[float, float]:
        """Root of the mean square, and the largest, of figures (a, n)."""
        mean = float(np.trapezoid(figures**2, run.time).mean() / run.time[-1])
        return mean**0.5, float(np.max(np.abs(figures)))

    return Performance(*magnitudes(np.array(errors)), *magnitudes(forces.T), energy)


def _targets(scene: Scene) -> dict[int, float | TimeFunction]:
    """Return what control laws follow, by their numbers."""
    declared = [law.law if isinstance(law, Digital) else law for law in scene.control]
    laws = {k: law for k, law in enumerate(declared) if isinstance(law, DeclaredLaw)}
    return {k: law.target for k, law in laws.items() if _follows(law)}


def _follows(law: DeclaredLaw) -> bool:
    """Return True unless no gain acts on a target, as of motors of a file, and of dampers."""
    driven = isinstance(law.target, TimeFunction)
    gains = law.feedback.values()
    return isinstance(law, ComputedTorque) or any(k_p or (k_d and driven) for k_p, k_d in gains)


def compared(
    scene: str, given: Mapping[str, str | float], engines: Sequence[str], progress: Callable[[str], None]
) -> list[Table]:
    """Run a scene with each of its controllers in each engine: a table for slides, one for hinges."""
    kinds: dict[str, Rows] = {}
    pairs = list(product(controllers(scene, given), engines))
    for (name, loaded), engine in paced(pairs, progress, "run"):
        wanted = replace(
            loaded,
            output_period=min(loaded.output_period, loaded.duration / OUTPUTS),
            outputs=frozenset({"actuation"}),
        )
        for kind, found in performance(loaded, ENGINES[engine].simulate(wanted)).items():
            rows = kinds.setdefault(kind, [])
            if name not in rows:
                rows.append(name)
            rows.append([f"  {engine}", *(f"{value:.3g}" for value in found)])
    return [Table(kind if len(kinds) > 1 else "", columns(kind), rows) for kind, rows in kinds.items()]


def columns(kind: str) -> list[Column]:
    """Return the columns of the table of slides or hinges."""
    length, force = ("m", "N") if kind == "slides" else ("rad", "N m")
    return [
        *texts("controller"),
        *figures(f"error, {length}", "its peak", f"force, {force}", "its peak", "energy, J"),
    ]
