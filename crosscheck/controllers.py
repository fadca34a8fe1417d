"""Controllers of a scene side by side: tracking error, effort and energy in each engine."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from crosscheck.engines import ENGINES
from crosscheck.errors import CrosscheckError
from crosscheck.report.table import Column, Rows, Table
from crosscheck.scenes import SCENES, load
from crosscheck.scenes.options import options_of
from newton_euler.model.control import DeclaredLaw, reference
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
    """Figures of one run, over all coordinates with a declared law; m, N, J or rad, N m, J.

    Attributes:
        error_rms, error_peak: of x - r, the root of the mean square over time of all coordinates, and the
            largest.
        force_rms, force_peak: of the actuators, likewise.
        energy: J, the integral of |force * rate|: nothing is recovered where a load drives an actuator.
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


def performance(scene: Scene, run: Trajectory) -> Performance:
    """Compute the figures of a run with velocities and actuation."""
    assert run.actuator_force is not None
    errors, powers, targets = [], [], _targets(scene)
    for k, law in enumerate(scene.control):
        motion = run.joint(law.joint)
        assert motion.rates is not None
        powers.append(np.abs(run.actuator_force[:, k] * motion.rates[:, law.coordinate]))
        if k in targets:
            wanted = [float(reference(targets[k], float(t)).value) for t in run.time]
            errors.append(motion.coordinates[:, law.coordinate] - wanted)

    def magnitudes(figures: Array) -> tuple[float, float]:
        """Root of the mean square, and the largest, of figures (a, n)."""
        mean = float(np.trapezoid(figures**2, run.time).mean() / run.time[-1])
        return mean**0.5, float(np.max(np.abs(figures)))

    energy = float(np.trapezoid(np.sum(powers, axis=0), run.time))
    return Performance(*magnitudes(np.array(errors)), *magnitudes(run.actuator_force.T), energy)


def _targets(scene: Scene) -> dict[int, float | TimeFunction]:
    """Return what control laws follow, by their numbers."""
    declared = [law.law if isinstance(law, Digital) else law for law in scene.control]
    return {k: law.target for k, law in enumerate(declared) if isinstance(law, DeclaredLaw)}


def compared(
    scene: str, given: Mapping[str, str | float], engines: Sequence[str], progress: Callable[[str], None]
) -> Table:
    """Run a scene with each of its controllers in each of these engines."""
    rows: Rows = []
    for name, loaded in controllers(scene, given):
        wanted = replace(
            loaded,
            output_period=min(loaded.output_period, loaded.duration / OUTPUTS),
            outputs=frozenset({"velocities", "actuation"}),
        )
        rows.append(name)
        for engine in engines:
            progress(f"running {name} in {engine}")
            found = performance(loaded, ENGINES[engine].simulate(wanted))
            rows.append([f"  {engine}", *(f"{figure:.3g}" for figure in found)])
    return Table("", columns(), rows)


def columns() -> list[Column]:
    """Return the columns of the table."""
    figures = (
        ("error\nRMS", "m"),
        ("error\npeak", "m"),
        ("force\nRMS", "N"),
        ("force\npeak", "N"),
        ("energy", "J"),
    )
    return [Column("controller"), *(Column(name, unit, numeric=True) for name, unit in figures)]
