"""The motion that errors of benchmarks are taken against, with its own uncertainty.

It is Pinocchio's, by scipy's DOP853 at a tolerance near the limit of double precision, or at the next looser
one that two equations of motion can be run at: an engine, equations and an integrator that share nothing with
`newton_euler`, which is what the benchmark judges. Where Pinocchio cannot run a scene it is newton_euler's
Cartesian formulation. The uncertainty is the largest difference to the same at twice the tolerance and to
other equations of motion at tight tolerances, so an error that was Pinocchio's own would show in it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

import newton_euler
import urdf
from crosscheck.studies.benchmark.ladders import Poses
from crosscheck.studies.benchmark.timing import Progress
from crosscheck.support.errors import CrosscheckError, reason_of
from crosscheck.support.time_limits import time_limit
from newton_euler.errors import NewtonEulerError
from newton_euler.model.euler_parameters import angle_between
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory

RTOLS = (5e-14, 1e-11)
"""Tried in turn, with atol = 0.01 rtol. DOP853 takes no rtol below 2.2e-14."""

BATCH_RTOL = 1e-12
"""Of references of many runs."""

LIMIT = 10.0
"""s after which a run is given up."""


def pose_errors(poses: Poses, exact: Poses) -> tuple[float, float]:
    """Return the largest distance, m, of positions (n, b, 3) and angle, rad, of quaternions (n, b, 4)."""
    distance = np.linalg.norm(poses[0] - exact[0], axis=-1)
    return float(np.max(distance)), float(np.max(angle_between(poses[1], exact[1])))


@dataclass(frozen=True, eq=False)
class Reference:
    """A motion and how well it is known.

    Attributes:
        name: how it was made.
        poses: of all bodies at all outputs.
        differences: to other runs, m and rad, by name.
        missing: what could not be run, and why.
    """

    name: str
    poses: Poses
    differences: dict[str, tuple[float, float]]
    missing: dict[str, str]

    @property
    def uncertainty(self) -> float:
        """m or rad: the larger of both."""
        return max(max(difference) for difference in self.differences.values())


def reference(scene: Scene, progress: Progress, rtols: Sequence[float] = RTOLS) -> Reference:
    """Make the reference of a scene, at the first of these tolerances that it can be made at.

    Raises:
        CrosscheckError: where fewer than two independent equations of motion can run it.
    """
    missing: dict[str, str] = {}
    for rtol in rtols:
        runs = _runs(scene, rtol, missing, progress)
        if len({name.split(",")[0] for name in runs}) > 1:
            break
    else:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in missing.items())
        raise CrosscheckError(f"scene {scene.name!r} has no reference to take errors against: {reasons}")
    (name, exact), *others = runs.items()
    return Reference(name, exact, {other: pose_errors(poses, exact) for other, poses in others}, missing)


def _runs(scene: Scene, rtol: float, missing: dict[str, str], progress: Progress) -> dict[str, Poses]:
    """Run what can be run at a tolerance; reasons for the rest are added to `missing`."""
    runs: dict[str, Poses] = {}
    for name, run in _ways(scene, rtol).items():
        progress(f"reference: {name}")
        try:
            with time_limit(LIMIT):
                found = run()
        except (NewtonEulerError, CrosscheckError, ArithmeticError, MemoryError) as error:
            missing[name] = reason_of(error)
            continue
        if np.all(np.isfinite(found.position)) and np.all(np.isfinite(found.quaternion)):
            runs[name] = found.position, found.quaternion
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


def batch_references(
    scene: Scene, states: Sequence[State], error: float, progress: Progress
) -> tuple[dict[int, Poses], float]:
    """Make references of runs from several states; return them by number of the state, and their uncertainty.

    A state has none from which engines cannot go that tightly, or do not agree to `error`, m or rad: its run
    passes a singular configuration.

    Raises:
        CrosscheckError: if none has any.
    """
    found: dict[int, Reference] = {}
    for k, state in enumerate(states):
        progress(f"reference of run {k + 1} of {len(states)}")
        try:
            made = reference(replace(scene, initial_state=state), lambda _: None, (BATCH_RTOL,))
        except CrosscheckError as failure:
            reason = str(failure)
            continue
        if made.uncertainty <= error:
            found[k] = made
        else:
            reason = f"is known to {made.uncertainty:.1e} only"
    if not found:
        none = f"none of {len(states)} random runs has a reference to judge errors of {error:g} by"
        raise CrosscheckError(f"{none}; the last: {reason}")
    return {k: each.poses for k, each in found.items()}, max(each.uncertainty for each in found.values())
