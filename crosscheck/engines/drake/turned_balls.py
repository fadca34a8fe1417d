"""States of a plant whose balls are kept away from the singular pitch of their angles.

`BallRpyJoint` has the angles (roll, pitch, yaw) as coordinates, whose rates are singular at a pitch of 90
degrees. Before a ball comes near, its frame on the parent is turned to its frame on the child, so that all
three angles are zero. The velocity of the ball is its angular velocity in the frame on the parent.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix

from crosscheck.engines.drake.plant import Plant
from newton_euler.model.euler_parameters import from_rotation
from newton_euler.scalars import Array

MAX_PITCH = 0.8
"""Pitch of a ball, rad, above which its frame is turned."""


class TurnedBalls:
    """Rotations of the frames of balls on their parents, and the map from the plant's state to the tree's.

    States x of the plant are its positions, then its velocities.
    """

    def __init__(self, built: Plant) -> None:
        """Begin with frames that are parallel to the world at the initial pose."""
        self._tree, self._nq = built.welded.tree, built.plant.num_positions()
        self._motions = list(zip(built.motions, self._tree.motions, strict=True))
        self._turns = {
            place.start: (joint, np.eye(3))
            for joint, (motion, place, _) in self._motions
            if motion.kind == "ball"
        }

    def _places(self, joint: Any) -> tuple[slice, slice]:
        """Return the places of the angles and of the angular velocity of a ball in x."""
        q, v = joint.position_start(), self._nq + joint.velocity_start()
        return slice(q, q + 3), slice(v, v + 3)

    def tree_state(self, x: Array) -> tuple[Array, Array, Array]:
        """Return tree coordinates (tree.nq,) and velocities v (nv,), and the matrix (nv, nv) from v to
        Drake's.

        The signs of quaternions are not continuous in time.
        """
        q, v = np.zeros(self._tree.nq), np.zeros(self._tree.nv)
        to_drake = np.zeros((self._tree.nv, self._tree.nv))
        for joint, (_, on_q, on_v) in self._motions:
            in_q, in_v = joint.position_start(), joint.velocity_start()
            if on_q.start in self._turns:
                angles, spin = self._places(joint)
                relative = RotationMatrix(RollPitchYaw(x[angles])).matrix()
                _, turn = self._turns[on_q.start]
                q[on_q], v[on_v] = from_rotation(turn @ relative), relative.T @ x[spin]
                to_drake[in_v : in_v + 3, on_v] = relative
            else:
                q[on_q], v[on_v] = x[in_q], x[self._nq + in_v]
                to_drake[in_v, on_v.start] = 1.0
        return q, v, to_drake

    def fastest(self, x: Array) -> float:
        """Return the largest angular velocity of a ball, rad/s; 0 without balls."""
        spins = (np.linalg.norm(x[self._places(joint)[1]]) for joint, _ in self._turns.values())
        return float(max(spins, default=0.0))

    def turn_frames(self, plant: Any, context: Any) -> bool:
        """Turn the frames of all balls in a context of the plant if one has a large pitch.

        Returns:
            True if frames were turned, so that the state has changed.
        """
        x = plant.GetPositionsAndVelocities(context)
        if not any(abs(x[self._places(joint)[0]][1]) > MAX_PITCH for joint, _ in self._turns.values()):
            return False
        for start, (joint, turn) in self._turns.items():
            angles, spin = self._places(joint)
            relative = RotationMatrix(RollPitchYaw(x[angles]))
            frame = joint.frame_on_parent()
            point = frame.GetPoseInParentFrame(context).translation()
            turned = RotationMatrix.ProjectToRotationMatrix(turn @ relative.matrix())
            frame.SetPoseInParentFrame(context, RigidTransform(turned, point))
            joint.set_angles(context, np.zeros(3))
            joint.set_angular_velocity(context, relative.matrix().T @ x[spin])
            self._turns[start] = joint, turned.matrix()
        return True
