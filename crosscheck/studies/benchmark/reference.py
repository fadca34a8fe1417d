"""Reference motion of a benchmark, from which errors of engines are measured, and its uncertainty.

The reference is the motion of an engine with rigid constraints and error control, Pinocchio, at a tolerance
near the limit of double precision. There are three different equations of motion: Pinocchio's, and
newton_euler's in Cartesian (body) and in relative (joint) coordinates. If fewer than two of them can run at
the tight tolerance, a looser one is used. Pinocchio's equations share nothing with newton_euler, whose speed
the benchmark assesses. If Pinocchio cannot run a scene, the reference is newton_euler's motion in Cartesian
coordinates.

The uncertainty is the largest difference of the reference from other runs: the same run at twice the
tolerance, and newton_euler's runs. An error of Pinocchio would therefore show in the uncertainty.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from crosscheck.engines.benchmarks import Poses
from crosscheck.engines.registry import ENGINES, SOLVER
from crosscheck.studies.benchmark.timing import Progress
from crosscheck.support.errors import CrosscheckError, reason_of
from crosscheck.support.time_limits import time_limit
from newton_euler.compiled.formulations import FORMULATIONS
from newton_euler.errors import NewtonEulerError
from newton_euler.model.euler_parameters import angle_between
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory
from newton_euler.runs.simulate import simulate

REFERENCE_RTOLS = (5e-14, 1e-11)
"""Relative tolerances of the reference, tried in this order with atol = 0.01 rtol.

At tolerances finer than about 2e-14, 100 times the round-off of a double, round-off dominates."""

BATCH_REFERENCE_RTOL = 1e-12
"""Relative tolerance of the references of a batch: runs of one scene from many initial states."""

RUN_TIME_LIMIT = 10.0
"""Largest processor time of a reference run, s."""


def pose_errors(poses: Poses, exact: Poses) -> tuple[float, float]:
    """Compute the largest errors of the poses of b bodies at n output times.

    Args:
        poses: positions (n, b, 3), m, and quaternions (n, b, 4) in the order (w, x, y, z).
        exact: reference poses in the same form.

    Returns:
        The largest distance between positions, m, and the largest angle between orientations, rad.
    """
    distance = np.linalg.norm(poses[0] - exact[0], axis=-1)
    return float(np.max(distance)), float(np.max(angle_between(poses[1], exact[1])))


@dataclass(frozen=True, eq=False)
class Reference:
    """Reference motion and its uncertainty.

    Attributes:
        name: engine, integrator and tolerance of the reference.
        poses: poses of all bodies at all outputs.
        differences: largest difference of each other run from the reference in position, m, and in
            orientation, rad, by name of the run.
        missing: reason of each run that failed, by name of the run.
    """

    name: str
    poses: Poses
    differences: dict[str, tuple[float, float]]
    missing: dict[str, str]

    @property
    def uncertainty(self) -> float:
        """Largest of all differences, m or rad."""
        return max(max(difference) for difference in self.differences.values())


def reference(scene: Scene, progress: Progress, rtols: Sequence[float] = REFERENCE_RTOLS) -> Reference:
    """Compute the reference of a scene at the first tolerance at which two different equations can run.

    Args:
        scene: the scene.
        progress: called with the name of each run.
        rtols: relative tolerances, tried in this order.

    Raises:
        CrosscheckError: if fewer than two independent equations of motion run the scene.
    """
    missing: dict[str, str] = {}
    for rtol in rtols:
        runs = _runs(scene, rtol, missing, progress)
        # names begin with the equations of motion, as in "Pinocchio, DOP853 rtol 5e-14"
        if len({name.split(",")[0] for name in runs}) > 1:
            break
    else:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in missing.items())
        raise CrosscheckError(f"scene {scene.name!r} has no reference to take errors against: {reasons}")
    (name, exact), *others = runs.items()
    differences = {other: pose_errors(poses, exact) for other, poses in others}
    return Reference(name, exact, differences, missing)


def _runs(scene: Scene, rtol: float, missing: dict[str, str], progress: Progress) -> dict[str, Poses]:
    """Return the poses of all runs that succeed at a tolerance, by name of the run.

    The reasons of runs that fail are added to `missing`.
    """
    runs: dict[str, Poses] = {}
    for name, run in _candidates(scene, rtol).items():
        progress(f"reference: {name}")
        try:
            with time_limit(RUN_TIME_LIMIT):
                found = run()
        except (NewtonEulerError, CrosscheckError, ArithmeticError, MemoryError) as error:
            missing[name] = reason_of(error)
            continue
        if np.all(np.isfinite(found.position)) and np.all(np.isfinite(found.quaternion)):
            runs[name] = found.position, found.quaternion
        else:
            missing[name] = "its motion is not finite"
    return runs


def _candidates(scene: Scene, tightest: float) -> dict[str, Callable[[], Trajectory]]:
    """Return functions that simulate the scene, by name of the run; the first that succeeds is the reference.

    `tightest` is the relative tolerance of all runs but one, whose tolerance is twice as large.
    """
    runs: dict[str, Callable[[], Trajectory]] = {}
    for rtol in (tightest, 2.0 * tightest):
        for engine in ENGINES.values():
            if engine.at_tolerance is not None:
                runs[f"{engine.label}, DOP853 rtol {rtol:.0e}"] = partial(
                    engine.simulate, scene, engine.at_tolerance(rtol)
                )
    for formulation in reversed(FORMULATIONS):
        runs[f"{SOLVER.name} {formulation}, DOP853 rtol {tightest:.0e}"] = partial(
            simulate, scene, formulation=formulation, rtol=tightest, atol=0.01 * tightest
        )
    return runs


def batch_references(
    scene: Scene, states: Sequence[State], error: float, progress: Progress
) -> tuple[dict[int, Poses], float]:
    """Compute reference poses of runs from several states.

    A state has no reference if its run passes a singular configuration, at which the mechanism has further
    degrees of freedom: runs at tight tolerances then fail or differ by more than `error`.

    Args:
        scene: the scene.
        states: initial states of the runs.
        error: largest uncertainty of a reference, m or rad.
        progress: called with the name of each stage.

    Returns:
        Poses by index of the state, and their largest uncertainty, m or rad.

    Raises:
        CrosscheckError: if no state has a reference.
    """
    found: dict[int, Reference] = {}
    for k, state in enumerate(states):
        progress(f"reference of run {k + 1} of {len(states)}")
        try:
            made = reference(
                replace(scene, initial_state=state),
                progress=lambda _: None,
                rtols=(BATCH_REFERENCE_RTOL,),
            )
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
