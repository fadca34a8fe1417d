"""The motion that errors of benchmarks are taken against, with its own uncertainty.

It is Pinocchio's, by scipy's DOP853 at a tolerance near the limit of double precision, or at the next looser
one that two equations of motion can be run at: an engine, equations
and an integrator that share nothing with `newton_euler`, which is what the benchmark judges. Where Pinocchio
cannot run a scene it is newton_euler's Cartesian formulation. The uncertainty is the largest difference to
the same at twice the tolerance and to other equations of motion at tight tolerances, so an error that was
Pinocchio's own would show in it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

import newton_euler
import urdf
from crosscheck.errors import CrosscheckError
from crosscheck.limit import time_limit
from crosscheck.studies.benchmark.timing import Progress
from newton_euler.errors import NewtonEulerError
from newton_euler.model.euler_parameters import angle_between
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

RTOLS = (5e-14, 1e-11)
"""Tried in turn, with atol = 0.01 rtol. DOP853 takes no rtol below 2.2e-14."""

LIMIT = 10.0
"""s after which a run is given up."""


def pose_errors(poses: tuple[Array, Array], exact: tuple[Array, Array]) -> tuple[float, float]:
    """Return the largest distance, m, of positions (n, b, 3) and angle, rad, of quaternions (n, b, 4)."""
    distance = np.linalg.norm(poses[0] - exact[0], axis=-1)
    return float(np.max(distance)), float(np.max(angle_between(poses[1], exact[1])))


class Difference(NamedTuple):
    """Between the reference and another run: m and rad."""

    position: float
    angle: float


@dataclass(frozen=True, eq=False)
class Reference:
    """A motion and how well it is known.

    Attributes:
        name: how it was made.
        position, quaternion: (n, b, 3) m and (n, b, 4), ground first.
        differences: to other runs, by name.
        missing: what could not be run, and why.
    """

    name: str
    position: Array
    quaternion: Array
    differences: dict[str, Difference]
    missing: dict[str, str]

    @property
    def poses(self) -> tuple[Array, Array]:
        return self.position, self.quaternion

    @property
    def uncertainty(self) -> float:
        """m or rad: the larger of both."""
        return max(max(difference) for difference in self.differences.values())


def reference(scene: Scene, progress: Progress) -> Reference:
    """Make the reference of a scene.

    Raises:
        CrosscheckError: where fewer than two independent equations of motion can run it.
    """
    missing: dict[str, str] = {}
    for rtol in RTOLS:
        runs = _runs(scene, rtol, missing, progress)
        names = list(runs)
        if len({name.split(",")[0] for name in names}) > 1:
            break
    else:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in missing.items())
        raise CrosscheckError(f"scene {scene.name!r} has no reference to take errors against: {reasons}")
    chosen = runs[names[0]]
    poses = chosen.position, chosen.quaternion
    differences = {
        name: Difference(*pose_errors((runs[name].position, runs[name].quaternion), poses))
        for name in names[1:]
    }
    return Reference(names[0], *poses, differences, missing)


def _runs(scene: Scene, rtol: float, missing: dict[str, str], progress: Progress) -> dict[str, Trajectory]:
    """Run what can be run at a tolerance; reasons for the rest are added to `missing`."""
    runs: dict[str, Trajectory] = {}
    for name, run in _ways(scene, rtol).items():
        progress(f"reference: {name}")
        try:
            with time_limit(LIMIT):
                trajectory = run()
        except (NewtonEulerError, CrosscheckError, ArithmeticError, MemoryError) as error:
            missing[name] = " ".join(str(error).split())
            continue
        if np.all(np.isfinite(trajectory.position)) and np.all(np.isfinite(trajectory.quaternion)):
            runs[name] = trajectory
        else:
            missing[name] = "its motion is not finite"
    return runs


def _ways(scene: Scene, tightest: float) -> dict[str, Callable[[], Trajectory]]:
    """The runs that are compared, the most wanted reference first."""
    ways: dict[str, Callable[[], Trajectory]] = {}
    for rtol in (tightest, 2.0 * tightest):
        ways[f"Pinocchio, DOP853 rtol {rtol:.0e}"] = partial(
            urdf.simulate, scene, rtol=rtol, atol=0.01 * rtol
        )
    for formulation in ("cartesian", "relative"):
        ways[f"newton_euler {formulation}, DOP853 rtol {tightest:.0e}"] = partial(
            newton_euler.simulate, scene, formulation=formulation, rtol=tightest, atol=0.01 * tightest
        )
    return ways
