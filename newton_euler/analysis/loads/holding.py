"""Control laws that hold a mechanism at rest in a chosen pose."""

from __future__ import annotations

from dataclasses import replace

from newton_euler.analysis.linear.linearization import held_forces
from newton_euler.analysis.loads.equilibrium import at_rest
from newton_euler.analysis.loads.statics import statics
from newton_euler.errors import MechanismError
from newton_euler.model.control import DeclaredLaw
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.runs.assemble import measured_coordinate


def hold(scene: Scene, state: State) -> Scene:
    """Return the scene with control laws that hold the mechanism in a pose.

    The set-points become the coordinates of the pose. The feedforwards become the forces that statics leaves
    to the actuators, so that gains act as in the scene. Functions of time hold their values at time 0.

    Args:
        scene: the mechanism with its forces and control laws.
        state: the pose, with closed loops; its velocities are ignored.

    Raises:
        MechanismError: naming a body that the actuators do not hold in the pose, and for a law that is no
            declared law in continuous time.

    Examples:
        >>> scene = load("tracker_gravity")
        >>> linearize(hold(scene, initial_state(scene))).is_equilibrium
        True
    """
    scene = replace(at_rest(scene), initial_state=state)
    laws = []
    for law in scene.control:
        if not isinstance(law, DeclaredLaw):
            raise MechanismError(law.element, "does not take a set-point", "a law as PD")
        x, _ = measured_coordinate(scene, state, law.key)
        laws.append(replace(law, target=x))
    scene = replace(scene, control=tuple(laws))
    # the forces that the laws lack, which the first law on a coordinate adds
    names = dict.fromkeys(scene.mechanism.coordinate_name(law.key) for law in laws)
    held = statics(scene, state, tuple(names))
    keys = map(scene.mechanism.coordinate, held.actuators)
    missing = dict(zip(keys, held.actuator_force.tolist(), strict=True))
    for key, force in held_forces(scene, state, time=0.0).items():
        missing[key] -= force
    holding = [replace(law, feedforward=law.feedforward + missing.pop(law.key, 0.0)) for law in laws]
    return replace(scene, control=tuple(holding))
