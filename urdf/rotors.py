"""The armatures of a scene, for Pinocchio."""

from __future__ import annotations

import numpy as np

from newton_euler.equations.balls import ends, spin_rate
from newton_euler.model.constraints import Frame
from newton_euler.model.forces import BallArmature
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.scalars import Array
from urdf.reactions import Actuator, actuator


class Rotors:
    """Rotor inertias on velocities of a tree, which has all joints that bear some.

    Attributes:
        inertias: (nv,) kg m^2 or kg.
    """

    def __init__(self, scene: Scene, tree: SpanningTree) -> None:
        self._single: list[tuple[Actuator, float]] = []
        self._balls: list[tuple[int, tuple[int, int], float]] = []
        self.inertias = np.zeros(tree.nv)
        for armature in scene.armatures:
            if isinstance(armature, BallArmature):
                joint, place = scene.mechanism.joint_index(armature.joint), tree.ball_place(armature.joint)
                assert place is not None
                self._balls.append((joint, ends(scene.mechanism, armature.joint), armature.inertia))
                self.inertias[place] = armature.inertia
            else:
                on = actuator(scene.mechanism, tree, *armature.key)
                self._single.append((on, armature.inertia))
                self.inertias[on.on_v] = armature.inertia

    def energy(self, v: Array) -> float:
        """Kinetic energy, J, at velocities (nv,)."""
        return float(0.5 * v @ (self.inertias * v))

    def forces(self, vdot: Array) -> list[tuple[Actuator, float]]:
        """What those of hinges and slides drive, and the force, N or N m, at accelerations (nv,)."""
        return [(on, -inertia * vdot[on.on_v]) for on, inertia in self._single]

    def torques(self, frames: list[Frame], angular: Array) -> list[tuple[int, Array]]:
        """By joint (3,) N m of those of balls on its second body, at angular accelerations (b, 3)."""
        return [(joint, -a * spin_rate(frames, angular, bodies)) for joint, bodies, a in self._balls]
