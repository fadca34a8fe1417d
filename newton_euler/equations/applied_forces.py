"""Applied forces of a scene: sums of wrenches on the bodies, energies, and power.

Both formulations use these sums, over generic scalars. Each kind of force is a class of
`newton_euler.model.forces`. Forces on joint coordinates act through the coordinates
(`newton_euler.equations.couplings`).
"""

from __future__ import annotations

import numpy as np

from newton_euler.equations.system import fastest_joint
from newton_euler.model.constraints import Frame
from newton_euler.model.elements import Element, Surroundings
from newton_euler.model.forces import Spring
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array, Scalar


def surroundings(scene: Scene, state: State, time: float = 0.0) -> Surroundings:
    """Compute the quantities that forces and armatures depend on, at a state and a time in s.

    Angles include the revolutions of `State.angles`. Angles without an entry there are within half a
    revolution.
    """
    mechanism, frames = scene.mechanism, state.frames()
    acting = {each.key for each in (*scene.joint_forces, *scene.armatures) if not each.on_ball}
    measured = {}
    for key in acting.union(scene.sensed):
        x, rate = mechanism.measure(key, frames)
        measured[key] = x + state.revolutions(key, x), rate
    return Surroundings(mechanism, [body.pose for body in mechanism.bodies], frames, measured, time)


def applied_wrenches(scene: Scene, at: Surroundings) -> list[Array]:
    """Sum the wrenches (6,) of forces on each body, without forces on joint coordinates.

    A wrench is a force and a torque about the center of mass, N and N m, world frame. The ground is first.
    """
    total: list[Array] = [np.zeros(6) for _ in at.frames]
    for force in scene.body_forces:
        for body, wrench in force.wrenches(at):
            total[body] = total[body] + wrench
    return total


def energies(scene: Scene, frames: list[Frame], inertias: list[Array]) -> tuple[Scalar, Scalar]:
    """Compute the kinetic energy and the potential energy of gravity (zero at the world origin), J.

    `inertias` (3, 3) are in the body frames; `frames` have the rotations of the body frames.
    """
    kinetic: Scalar = 0.0
    potential: Scalar = 0.0
    for body, frame, inertia in zip(scene.mechanism.bodies[1:], frames[1:], inertias[1:], strict=True):
        spin = frame.rotation.T @ frame.angular_velocity
        kinetic = (
            kinetic + 0.5 * body.mass * (frame.velocity @ frame.velocity) + 0.5 * (spin @ inertia @ spin)
        )
        potential = potential - body.mass * (scene.gravity @ frame.position)
    return kinetic, potential


def power(scene: Scene, at: Surroundings) -> Scalar:
    """Sum the power, W, of forces without potential energy: control laws, dampers, wrenches and wind."""
    forces = (*scene.joint_forces, *scene.body_forces)
    return sum((term for force in forces for term in force.powers(at)), start=0.0)


def blamed(scene: Scene, state: State, reason: str, at: Surroundings) -> str:
    """Complete the reason of a failure with the fastest joint and the largest force, if there is one."""
    reason = f"{reason}; fastest at joint {fastest_joint(scene.mechanism, state)!r}"
    with np.errstate(all="ignore"):
        found = {_called(f): f.magnitude(at) for f in (*scene.joint_forces, *scene.body_forces)}
    if not found:
        return reason
    largest = max(found, key=lambda element: np.nan_to_num(found[element], nan=np.inf))
    return f"{reason}, largest force: {largest}"


def _called(force: Element) -> str:
    """Name a force for a message; a spring with a damper by the parts of nonzero strength."""
    if not isinstance(force, Spring):
        return force.element
    return force.element.replace("spring", " and ".join(force.active_parts) or "spring", 1)
