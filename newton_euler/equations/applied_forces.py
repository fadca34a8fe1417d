"""Applied forces of a scene: sums of wrenches on the bodies, energies and power.

Both forms of the equations of motion, in joint coordinates and in Cartesian coordinates, use these sums. The
functions accept floats, and symbolic scalars when the equations are traced for compilation. Each kind of
force is a class of `newton_euler.model.forces`. Forces on joint coordinates (springs and control laws at
joints) are not part of the wrenches; the forms of the equations add these forces.
"""

from __future__ import annotations

from typing import assert_never

import numpy as np

from newton_euler.equations.system import fastest_joint
from newton_euler.model.constraints import Frame
from newton_euler.model.elements import Element, Surroundings
from newton_euler.model.forces import Spring
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.switched_forces import ElasticGear, JointFriction, JointStop
from newton_euler.scalars import Array, Scalar

STICKING = 10.0
"""Largest rate of a joint that counts as sticking, in units of the transition speed of its friction."""


def surroundings(scene: Scene, state: State, time: float = 0.0) -> Surroundings:
    """Compute the quantities that forces and armatures (rotor inertias) depend on.

    Args:
        scene: the scene with the forces.
        state: poses and velocities of the bodies. Hinge angles include the full revolutions of
            `State.angles`; an angle without an entry there is between -pi and pi.
        time: s.
    """
    mechanism, frames = scene.mechanism, state.frames()
    # joint coordinates (joint name, index) that forces act on, and those that control laws read (`sensed`);
    # the rotation of a ball joint has no coordinate
    acting = {*scene.loaded_coordinates, *(each.key for each in scene.armatures if not each.on_ball)}
    measured = {}
    for key in acting.union(scene.sensed):
        x, rate = mechanism.measure(key, frames)
        measured[key] = x + state.revolutions(key, x), rate
    initial_poses = [body.pose for body in mechanism.bodies]
    return Surroundings(mechanism, initial_poses, frames, measured, time)


def applied_wrenches(scene: Scene, at: Surroundings) -> list[Array]:
    """Sum the wrenches of all forces on each body, without forces on joint coordinates.

    Returns:
        (6,) for each body, ground first: force in N, and torque about the center of mass in N m, world frame.
    """
    total: list[Array] = [np.zeros(6) for _ in at.frames]
    for force in scene.body_forces:
        for body, wrench in force.wrenches(at):
            total[body] = total[body] + wrench
    return total


def energies(scene: Scene, frames: list[Frame], inertias: list[Array]) -> tuple[Scalar, Scalar]:
    """Compute the kinetic energy of the bodies and their potential energy of gravity, J.

    Args:
        scene: gives masses and gravity.
        frames: pose and velocity of each body, ground first.
        inertias: (3, 3) of each body about its center of mass, in the body frame, kg m^2, ground first.

    Returns:
        Kinetic energy; potential energy, zero at the world origin.
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
    forces = (*scene.control, *scene.forces)
    return sum((term for force in forces for term in force.powers(at)), start=0.0)


def with_likely_causes(scene: Scene, state: State, reason: str, at: Surroundings) -> str:
    """Append the fastest joint and the largest force at a state to the reason of a failure.

    To find the largest force, torques are divided by the mechanism's size.

    Args:
        scene: the scene.
        state: where the failure occurred.
        reason: text of the error message.
        at: quantities that the forces depend on at this state.
    """
    reason = f"{reason}; fastest at joint {fastest_joint(scene.mechanism, state)!r}"
    with np.errstate(all="ignore"):
        magnitudes = {_force_name(f): f.magnitude(at) for f in (*scene.control, *scene.forces)}
    if not magnitudes:
        return reason
    largest = max(magnitudes, key=lambda name: np.nan_to_num(magnitudes[name], nan=np.inf))
    return f"{reason}, largest force: {largest}"


def too_many_or_small_steps(reason: str, scene: Scene, at: Surroundings, integrator: str) -> str:
    """Append the switched force that makes steps short, and remedies, to the reason of a failure.

    Args:
        reason: text of the error message.
        scene: the scene.
        at: quantities that the forces depend on at the last state of the run.
        integrator: name of the integrator.
    """
    remedy = "for stiff equations use Radau" if integrator == "DOP853" else ""
    return "; ".join(part for part in (reason, stiffest_switch(scene, at), remedy) if part)


def stiffest_switch(scene: Scene, at: Surroundings) -> str:
    """Name the dry friction or the stop that makes steps of a run short, and what to change; "" for none.

    It is the friction with the smallest transition speed that sticks, or else the stiffest stop or gear that
    acts.

    Args:
        scene: the scene.
        at: quantities that the forces depend on at the last state of the run.
    """
    sticking, acting = dict[str, tuple[float, str]](), dict[str, tuple[float, str]]()
    for force in scene.switched_forces:
        is_slide = at.mechanism.is_slide(*force.unit_key)
        if isinstance(force, JointStop | ElasticGear) and force.energy(at) > 0.0:
            acting[force.element] = float(force.stiffness), "N/m" if is_slide else "N m/rad"
        if isinstance(force, JointStop):
            continue
        if isinstance(force, JointFriction):
            ratio = force.measure(at)[1] / force.transition_speed
            is_dry = bool(force.coulomb or force.stribeck or force.is_loaded)
        elif isinstance(force, ElasticGear):
            ratio = force.speed_ratio(at)
            is_dry = not force.forward_efficiency == force.backward_efficiency == 1.0
        else:
            assert_never(force)
        if is_dry and abs(ratio) <= STICKING:
            sticking[force.element] = float(force.transition_speed), "m/s" if is_slide else "rad/s"
    if sticking:
        element, (speed, unit) = min(sticking.items(), key=lambda item: item[1][0])
        return f"{element} is stiff below its transition_speed of {speed:g} {unit}: use a larger one"
    if acting:
        element, (stiffness, unit) = max(acting.items(), key=lambda item: item[1][0])
        return f"{element} acts with a stiffness of {stiffness:g} {unit}: use a smaller one"
    return ""


def _force_name(force: Element) -> str:
    """Name a force for a message; of a spring with a damper, name the parts of nonzero strength.

    `force.element` is the kind and the place or name of the force, such as "spring of joint 'hinge'".
    """
    if not isinstance(force, Spring):
        return force.element
    return force.element.replace("spring", " and ".join(force.active_parts) or "spring", 1)
