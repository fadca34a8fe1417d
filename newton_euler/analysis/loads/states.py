"""Input states of inverse dynamics and statics: a state, a trajectory or poses from kinematics, as arrays.

Poses show angles only up to full revolutions. Some forces depend on the revolutions, so that states have
these angles in addition, by joint coordinate (joint, number).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from newton_euler.analysis.kinematics.poses import Poses
from newton_euler.equations.couplings import counted_angles
from newton_euler.equations.kinematics import TreeKinematics
from newton_euler.equations.system import at_time
from newton_euler.errors import MechanismError, finite_array, quoted
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.state import State, whole_revolutions
from newton_euler.model.trajectory import Trajectory
from newton_euler.runs.assemble import check_revolutions
from newton_euler.scalars import Array


class States:
    """States of a scene, checked; n states of b bodies.

    Attributes:
        position, quaternion: (n, b, 3) and (n, b, 4).
        velocities: linear and angular velocities (n, b, 3); None at rest.
        angles: angles (n,) with full revolutions, rad, by joint coordinate, for the angles that were given.
        is_single: True if one state was given alone, not a sequence.
    """

    def __init__(self, scene: Scene, given: Any) -> None:
        """Check states and convert them to arrays.

        Args:
            scene: gives the bodies.
            given: a `State`, a `Trajectory`, `Poses`, or any object with arrays of these names.

        Raises:
            MechanismError: naming the scene, for anything else.
        """
        where = f"states of scene {quoted(scene.name)}"
        arrays: list[Any] = [getattr(given, name, None) for name in ("position", "quaternion")]
        if not all(isinstance(array, np.ndarray) and array.ndim in (2, 3) for array in arrays):
            raise MechanismError(
                where, f"is {quoted(given)}", "a State, a Trajectory or other poses of bodies"
            )
        velocities = [getattr(given, name, None) for name in ("linear_velocity", "angular_velocity")]
        arrays += [each for each in velocities if each is not None]
        # a single state gets a first axis of length 1
        self.is_single = arrays[0].ndim == 2
        self.position, self.quaternion, *rest = (a[None] for a in arrays) if self.is_single else arrays
        self.velocities = rest if len(rest) == len(velocities) else None
        self._solved_poses = given if isinstance(given, Poses) else None
        self.angles: Mapping[Key, Array] = {}
        if self._solved_poses is None:
            for row in range(len(self)):
                scene.check_numbers(self.state(row), where)
        if isinstance(given, State):
            scene.check_angles(given.angles, where)
            check_revolutions(scene, given)
        self.angles = _angles(scene, given)

    def __len__(self) -> int:
        return len(self.position)

    def state(self, row: int) -> State:
        """Return one of the n states as a `State`."""
        zero = np.zeros_like(self.position[row])
        velocities = (zero, zero) if self.velocities is None else (each[row] for each in self.velocities)
        angles = {key: float(angle[row]) for key, angle in self.angles.items()}
        return State(self.position[row], self.quaternion[row], *velocities, angles=angles)

    def coordinates(self, system: TreeKinematics, times: Array) -> tuple[Array, Array]:
        """Compute the coordinates q (n, nq) and velocities v (n, nv) of the states.

        Args:
            system: equations of motion of the scene, which define q and v.
            times: (n,) s, for prescribed motions.
        """
        # `Poses` come from kinematics: at rest, with tree coordinates apart from full revolutions. q has more
        # elements if forces depend on angles outside the tree, or if the scene tracks work.
        if self._solved_poses is not None and system.nq == system.tree.nq:
            q = self._solved_poses.tree_coordinates.copy()
            for key, place in system.angles.items():
                q[:, place] += whole_revolutions(self.angles.get(key, 0.0) - q[:, place])
            return q, np.zeros((len(self), system.nv))
        systems = (at_time(system, float(t)) for t in times)
        pairs = [each.coordinates(self.state(row)) for row, each in enumerate(systems)]
        return np.array([q for q, _ in pairs]), np.array([v for _, v in pairs])

    def column(self, name: str, value: Any) -> Array:
        """Convert values of a quantity to one number for each state, (n,).

        Args:
            name: name of the quantity, for messages.
            value: one number for all states, or (n,).

        Raises:
            MechanismError: for another number of values, or values that are not finite.
        """
        shape = (len(self),) if isinstance(value, Sequence) or bool(getattr(value, "ndim", False)) else ()
        return np.broadcast_to(finite_array("inverse dynamics", name, value, shape), len(self))


def _angles(scene: Scene, given: Any) -> Mapping[Key, Array]:
    """Return the given angles (n,) with full revolutions, rad, by joint coordinate.

    A trajectory stores angles only if a force of its scene depends on them. Otherwise the trajectory counts
    revolutions by integrating the rates of the angles.
    """
    if isinstance(given, State):
        return {key: np.array([angle]) for key, angle in given.angles.items()}
    if isinstance(given, Poses):
        return given.angles
    if not isinstance(given, Trajectory):
        return {}
    run = replace(given, mechanism=scene.mechanism)
    return {(joint, k): run.joint(joint).coordinates[:, k] for joint, k in counted_angles(scene)}
