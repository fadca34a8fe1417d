"""Differences of an engine's run from a reference: a closed form, or newton_euler's most accurate run."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache

import numpy as np

from crosscheck.compare.samples import Samples, States
from crosscheck.engines.registry import SOLVER
from crosscheck.studies.conformance.closed_forms import Arrays
from crosscheck.studies.conformance.element_scenes import SCENES
from newton_euler.equations.relative import Relative
from newton_euler.model.euler_parameters import angle_between
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.reading.excitation import random_states
from newton_euler.runs.assemble import initial_state
from newton_euler.runs.simulate import simulate
from newton_euler.scalars import Array

TOLERANCE = 1e-3
"""Largest difference from a reference, relative to the largest value, or in rad.

The runs last half a second. The least accurate engine, of order 2 at a step of 0.8 ms, differs by 3e-5 in
poses, velocities and energies, and an engine of soft constraints by 7e-5 in reactions. A wrong convention, or
a set-point that jumps one millisecond too late, changes a value by more than a percent."""

EXACT = 1e-9
"""Largest relative difference of values that no integration changes, such as the start."""

POSES = ("position", "quaternion")
"""Names of the arrays of poses."""

MOTION = (*POSES, "linear_velocity", "angular_velocity")
"""Names of the arrays of poses and velocities."""

REACTION = ("reaction_force", "reaction_torque")
"""Names of the arrays of reactions."""

RANDOM_STATES = 2
"""Number of random states, in addition to the initial one, at which equations are compared."""


@lru_cache(maxsize=2 * len(SCENES))
def reference(scene: Scene) -> Trajectory:
    """Simulate a scene as accurately as newton_euler can; scenes of the contract are constants, and so are
    these runs."""
    return simulate(scene, **(SOLVER.exact or {}))


@lru_cache(maxsize=len(SCENES))
def reference_equations(scene: Scene) -> Samples:
    """Return newton_euler's equations of a scene at its initial state and at random states, which move."""
    states = (initial_state(scene), *random_states(scene, RANDOM_STATES))
    return Samples(Relative(scene), States(scene, states))


def violations(scene: Scene, run: Trajectory) -> Array:
    """Compute the largest residual (n, j) of the constraints of each joint from the poses of a run, m or rad.

    Couplings are left out.
    """
    frames = [run.state(row).frames() for row in range(len(run.time))]
    residuals = [
        [joint.phi(each[joint.first], each[joint.second]) for joint in scene.mechanism.equations]
        for each in frames
    ]
    return np.array([[np.max(np.abs(phi), initial=0.0) for phi in row] for row in residuals])


def arrays_of(run: Trajectory, names: Iterable[str]) -> Arrays:
    """Return the arrays of a run with some names, those that it has."""
    found = {name: getattr(run, name) for name in names}
    return {name: values for name, values in found.items() if values is not None}


def whole_run(scene: Scene) -> Arrays:
    """Return the poses, velocities, reactions, energies and work of the reference run of a scene."""
    return arrays_of(reference(scene), (*MOTION, *REACTION, "kinetic_energy", "potential_energy", "work"))


def relative(found: Array | None, exact: Array) -> float:
    """Return the largest difference of an array from an exact one, relative to the largest exact value.

    If all exact values are zero, the result is the difference itself. It is infinite if there is no array, or
    one of another shape.
    """
    if found is None or np.shape(found) != np.shape(exact):
        return float("inf")
    scale = float(np.max(np.abs(exact), initial=0.0))
    return float(np.max(np.abs(found - exact), initial=0.0)) / (scale or 1.0)


def first_difference(run: Trajectory, exact: Arrays, tolerance: float = TOLERANCE) -> str:
    """Describe the first array of a run that differs from a reference; return "" if none does.

    Args:
        run: the engine's run.
        exact: arrays by name, which are compared in this order.
        tolerance: largest difference, relative to the largest value, or in rad.
    """
    for name, values in exact.items():
        if (found := getattr(run, name)) is None:
            return f"{name} is missing"
        if np.shape(found) != np.shape(values):
            return f"{name} has the shape {np.shape(found)}; needed: {np.shape(values)}"
        if name == "quaternion":
            if not (turned := float(np.max(angle_between(found, values)))) <= tolerance:
                return f"orientations differ by {turned:.2g} rad"
        elif not (apart := relative(found, values)) <= tolerance:
            return f"{name} differs by {apart:.2g} of its largest value"
    return ""
