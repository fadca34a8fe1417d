"""The equations of motion of all formulations and engines at the same states, for tests that compare them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from mjcf.rigid import RigidMuJoCo
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.redundancy import rows_in_use
from newton_euler.equations.relative import Relative
from newton_euler.equations.system import Evaluation
from newton_euler.exercise import random_states
from newton_euler.model.scene import Scene
from urdf.dynamics import PinocchioSystem

ACCELERATIONS = ("linear_acceleration", "angular_acceleration")
REACTIONS = ("reaction_force", "reaction_torque")


def evaluations(scene: Scene) -> Iterator[tuple[str, Evaluation, Evaluation]]:
    """At two random states: the others' names, what they say, and what `Relative` says."""
    for state in random_states(scene, 2):
        found = {}
        for system in (Relative(scene), Cartesian(scene), RigidMuJoCo(scene), PinocchioSystem(scene)):
            q, v = system.coordinates(state)
            found[system.name] = system.evaluate(q, v)
            if isinstance(system, Relative | Cartesian):
                rows = rows_in_use(system)
                found[f"sparse {system.name}"] = system.sparse_evaluation(q, v, rows)[0]
        wanted = found.pop("relative")
        for other, evaluation in found.items():
            yield other, evaluation, wanted


def check_arrays(
    other: str, found: Evaluation, wanted: Evaluation, arrays: Sequence[str], tolerance: float
) -> None:
    """Accelerations and reactions, relative to the largest of an array."""
    for array in arrays:
        x, y = getattr(found, array), getattr(wanted, array)
        # joints that transmit nothing are held to the weight of 1 kg at 0.1 m
        assert np.max(np.abs(x - y)) < tolerance * max(np.max(np.abs(y)), 1.0), (other, array)
