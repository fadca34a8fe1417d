"""What springs and rotors do at the balls of two models' joints, side by side."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from crosscheck.against.align import Aligned
from newton_euler.equations.applied_forces import turned
from newton_euler.model.armature import BallArmature
from newton_euler.model.forces import BallSpring
from newton_euler.model.joints import Joint
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array


def ball_rotors(scene: Scene) -> dict[str, Array]:
    """(1,) kg m^2 of the armature of each ball, by joint."""
    return {a.joint: np.array([a.inertia]) for a in scene.armatures if isinstance(a, BallArmature)}


def ball_torques(scene: Scene, states: Iterable[State]) -> dict[str, Array]:
    """(n, 3) N m of the spring of each ball on the joint's second body, world frame, by joint."""
    poses = [body.pose for body in scene.mechanism.bodies]
    frames = [state.frames() for state in states]
    return {
        spring.joint: np.array([spring.torque(*turned(scene, spring, poses, now)[1:]) for now in frames])
        for spring in scene.forces
        if isinstance(spring, BallSpring)
    }


def balls_apart(
    aligned: Aligned, acting: Sequence[Mapping[str, Array]], unit: float, sensed: bool = True
) -> dict[str, float]:
    """By joint the largest difference of what the first and the second model have on its ball.

    Joints of the second model alone go by its name. What does not depend on which body is the second is not
    `sensed`.
    """
    here, there = acting
    found, nothing = dict[str, float](), np.zeros(1)
    for name, other in aligned.joints.items():
        if name in here or other in there:
            swapped = _joint(aligned.first, name).first == _joint(aligned.second, other).second
            sense = -1.0 if sensed and swapped else 1.0
            gap = sense * there.get(other, nothing) - here.get(name, nothing)
            found[name] = float(np.abs(gap).max()) / unit
    alone = [(name, here[name]) for name in here if name not in aligned.joints]
    alone += [(name, there[name]) for name in there if name not in aligned.joints.values()]
    return found | {name: float(np.abs(value).max()) / unit for name, value in alone}


def _joint(scene: Scene | None, name: str) -> Joint:
    assert scene is not None  # forces are compared of models whose bodies all have partners
    return scene.mechanism.joints[scene.mechanism.joint_index(name)]
