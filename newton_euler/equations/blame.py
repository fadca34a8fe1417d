"""Where a run that went wrong went wrong most: the joint that moves fastest, the force that is largest."""

from __future__ import annotations

import numpy as np

from newton_euler.equations.force_terms import Surroundings, pulls
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State


def blamed(reason: str, joint: str, force: str | None) -> str:
    """A reason with the joint that moves fastest and the largest force, if there is one."""
    reason = f"{reason}; fastest at joint {joint!r}"
    return reason if force is None else f"{reason}, largest force: {force}"


def fastest_joint(mechanism: Mechanism, state: State) -> str:
    """Name of the joint between whose bodies speeds differ most, in sizes of the mechanism and rad, per s."""
    with np.errstate(all="ignore"):
        motion = np.hstack([state.linear_velocity / mechanism.size, state.angular_velocity])
        gaps = [np.max(np.abs(motion[e.second] - motion[e.first])) for e in mechanism.equations]
    return mechanism.joint_names[int(np.argmax(np.nan_to_num(gaps, nan=np.inf)))]


def strongest_force(scene: Scene, state: State, time: float) -> str | None:
    """What errors call the largest of a scene's forces at a state and a time in s; None if it has none.

    Angles count within half a turn.
    """
    frames, equations = state.frames(), scene.mechanism.equations
    measured: dict[tuple[str, int], tuple[float, float]] = {}
    for law in scene.joint_forces:
        joint = equations[scene.mechanism.joint_index(law.joint)]
        first, second = frames[joint.first], frames[joint.second]
        coordinate = joint.coordinates[law.coordinate]
        rate = coordinate.jacobian(first, second).rate(first, second)[0]
        measured[law.joint, law.coordinate] = coordinate.phi(first, second)[0], rate
    return strongest(scene, ([body.pose for body in scene.mechanism.bodies], frames, measured, time))


def strongest(scene: Scene, seen: Surroundings) -> str | None:
    """The same where a formulation has seen everything that forces depend on."""
    with np.errstate(all="ignore"):
        found = pulls(scene, *seen)
    if not found:
        return None
    return max(found, key=lambda element: np.nan_to_num(found[element], nan=np.inf))
