"""Differences between two runs (simulations): poses, constraint violations, energies and joint reactions.

In: two runs of one scene. Out: absolute differences of one quantity at the output times. Runs are compared up
to the end of the shorter one. `crosscheck.compare.runs` makes checks of these differences.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import NamedTuple

import numpy as np

from crosscheck.engines.energy import energy_balance
from crosscheck.support.errors import CrosscheckError
from newton_euler.equations.undetermined import determined, redundant_constraints, undetermined
from newton_euler.model.euler_parameters import angle_between
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

Difference = Callable[[Trajectory, Trajectory], Array]
"""Function that returns the differences of one quantity in two runs: (n,) at n times, or (n, b or j) for b
bodies or j joints."""


def _until_shorter_ends(difference: Difference) -> Difference:
    """Decorate a `Difference` so that it compares two runs up to the end of the shorter one."""

    @wraps(difference)
    def shortened(x: Trajectory, y: Trajectory) -> Array:
        end = min(len(x.time), len(y.time))
        return difference(x.first(end), y.first(end))

    return shortened


@_until_shorter_ends
def positions_apart(x: Trajectory, y: Trajectory) -> Array:
    """Return distances (n, b) between the positions of the bodies in two runs, m."""
    return np.asarray(np.linalg.norm(x.position - y.position, axis=2))


@_until_shorter_ends
def orientations_apart(x: Trajectory, y: Trajectory) -> Array:
    """Return angles (n, b) between the orientations of the bodies in two runs, rad."""
    return angle_between(x.quaternion, y.quaternion)


@_until_shorter_ends
def violations_apart(x: Trajectory, y: Trajectory) -> Array:
    """Return differences (n, j) of the constraint violations of the joints in two runs, m or rad."""
    assert x.constraint_violation is not None
    assert y.constraint_violation is not None
    return np.abs(x.constraint_violation - y.constraint_violation)


@_until_shorter_ends
def kinetic_energies_apart(x: Trajectory, y: Trajectory) -> Array:
    """Return differences (n,) of the kinetic energies of two runs, J."""
    assert x.kinetic_energy is not None
    assert y.kinetic_energy is not None
    return np.abs(x.kinetic_energy - y.kinetic_energy)


def balances_apart(scene: Scene) -> Difference:
    """Return a function that computes differences (n,) of the energy balance errors of two runs, J."""

    @_until_shorter_ends
    def difference(x: Trajectory, y: Trajectory) -> Array:
        first, second = energy_balance(scene, x), energy_balance(scene, y)
        assert first is not None
        assert second is not None
        return np.abs(first.residual - second.residual)

    return difference


class ReactionDifferences(NamedTuple):
    """Functions that compute the differences (n, j) of reactions of joints in two runs.

    Attributes:
        force: differences of the forces, N.
        torque: differences of the torques about the joint points, N m.
    """

    force: Difference
    torque: Difference


def reactions_apart(scene: Scene, run: Trajectory) -> ReactionDifferences:
    """Return functions that compute differences of reactions without the part that is not determined.

    Redundant constraints leave some combinations of reactions undetermined; these are removed.

    Args:
        scene: the scene.
        run: run whose poses determine these combinations.
    """
    bases = (
        [undetermined(scene, run.state(n)) for n in range(len(run.time))]
        if redundant_constraints(scene)
        else []
    )

    def differences(x: Trajectory, y: Trajectory) -> tuple[Array, Array]:
        """Return the differences (n, j, 3) of forces and torques."""
        for run in (x, y):
            if run.reaction_force is None or run.reaction_torque is None:
                needed = "reactions in finer runs, see `refined_in_full` of its Engine"
                raise CrosscheckError(f"{run.engine}: a run has no reactions; needed: {needed}")
        force, torque = (
            np.asarray(getattr(x, name)) - np.asarray(getattr(y, name))
            for name in ("reaction_force", "reaction_torque")
        )
        return determined(force, torque, bases[: len(force)], scene.mechanism.size)

    @_until_shorter_ends
    def force(x: Trajectory, y: Trajectory) -> Array:
        return np.asarray(np.linalg.norm(differences(x, y)[0], axis=2))

    @_until_shorter_ends
    def torque(x: Trajectory, y: Trajectory) -> Array:
        return np.asarray(np.linalg.norm(differences(x, y)[1], axis=2))

    return ReactionDifferences(force, torque)


def largest_reaction(run: Trajectory, size: float) -> float:
    """Return the largest reaction force in a run, or torque divided by the mechanism's size if larger, N."""
    assert run.reaction_force is not None
    assert run.reaction_torque is not None
    forces = np.linalg.norm([run.reaction_force, run.reaction_torque / size], axis=-1)
    return float(np.max(forces, initial=0.0))
