"""Runs of the scenes of the contract in closed form, as references that no engine computes.

Each function returns arrays of a `Trajectory` by name, at the output times of its scene. The moving body is
the body with number 1. Rows of the ground are those of the initial state.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from crosscheck.studies.conformance.element_scenes import (
    GUIDE,
    SLIDE_FRICTION,
    SLIDE_ROTOR,
    SPRING_REST,
)
from crosscheck.studies.conformance.scenes import (
    JUMP_TIME,
    SAMPLING_PERIOD,
    SET_POINTS,
    SLIDE_AXIS,
    SLIDE_DAMPING,
    SLIDE_STIFFNESS,
    sampled_force,
)
from newton_euler.model.euler_parameters import from_rotation_vector, product, rotation
from newton_euler.model.scene import Scene
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array

Arrays = Mapping[str, Array]
"""Arrays of a trajectory by name, with a row for each output time."""


class Motion(NamedTuple):
    """Displacement, m, and speed, m/s, along the axis of a slide."""

    x: float
    rate: float


def flight(scene: Scene) -> Arrays:
    """Return the run of a free body with two equal moments of inertia.

    Its center of mass moves on a parabola. The body turns about its axis of symmetry, and this axis turns
    about the angular momentum, both at constant rates: L. D. Landau, E. M. Lifshitz, Mechanics, section 33.
    """
    start, moving = initial_state(scene), scene.mechanism.bodies[1]
    turn = rotation(start.quaternion[1])
    moments = turn @ moving.inertia @ turn.T
    across, along, axis = _symmetry(moments)
    spin = start.angular_velocity[1]
    precession = moments @ spin / across  # rad/s, about the angular momentum
    about_axis = (1.0 - along / across) * (axis @ spin) * axis  # rad/s, the rest of the spin
    arrays = _at_rest(scene)
    for row, time in enumerate(scene.times):
        drop = start.linear_velocity[1] * time + 0.5 * scene.gravity * time**2
        precessed = from_rotation_vector(precession * time)
        turned = product(from_rotation_vector(about_axis * time), start.quaternion[1])
        arrays["position"][row, 1] = start.position[1] + drop
        arrays["linear_velocity"][row, 1] = start.linear_velocity[1] + scene.gravity * time
        arrays["quaternion"][row, 1] = product(precessed, turned)
        arrays["angular_velocity"][row, 1] = precession + rotation(precessed) @ about_axis
    return arrays


def steady_turn(scene: Scene) -> Arrays:
    """Return the run of a body that turns steadily about the vertical through its ball joint, with the
    reaction force."""
    start, (joint,) = initial_state(scene), scene.mechanism.joints
    spin, weight = start.angular_velocity[1], scene.mechanism.bodies[1].mass * scene.gravity
    arrays = _at_rest(scene)
    arrays["reaction_force"] = np.zeros((len(scene.times), 1, 3))
    for row, time in enumerate(scene.times):
        turned = from_rotation_vector(spin * time)
        arm = rotation(turned) @ (start.position[1] - joint.point)
        velocity = np.cross(spin, arm)
        arrays["position"][row, 1] = joint.point + arm
        arrays["quaternion"][row, 1] = product(turned, start.quaternion[1])
        arrays["linear_velocity"][row, 1], arrays["angular_velocity"][row, 1] = velocity, spin
        arrays["reaction_force"][row, 0] = scene.mechanism.bodies[1].mass * np.cross(spin, velocity) - weight
    return arrays


def slide(scene: Scene) -> Arrays:
    """Return the run of a body that its weight accelerates along a slide, with the reaction.

    The reaction force holds the weight across the slide. Its line passes through the center of mass, because
    the body does not turn. The reaction torque is about the joint's point: of the moving body if this is the
    second body of the slide, of the ground otherwise.
    """
    (joint,), weight = scene.mechanism.joints, scene.mechanism.bodies[1].mass * scene.gravity
    arrays = _along_slide(scene, _accelerated(scene))
    is_backward = joint.second == scene.mechanism.body_names[0]
    force = (weight @ SLIDE_AXIS) * SLIDE_AXIS - weight
    arms = arrays["position"][:, 1] - joint.point
    if not is_backward:
        arms = arms[0] + np.zeros_like(arms)
    forces = np.tile(-force if is_backward else force, (len(arms), 1))
    return arrays | {
        "reaction_force": forces[:, None],
        "reaction_torque": np.cross(arms, forces)[:, None],
    }


def jump_response(scene: Scene) -> Arrays:
    """Return the run of a sliding body whose controller's set-point jumps, with the controller's force."""
    first, second = SET_POINTS
    at_jump = _oscillated(scene, _initial_motion(scene), first, JUMP_TIME)
    motions, forces = [], []
    for time in scene.times.tolist():
        if time < JUMP_TIME:
            target, motion = first, _oscillated(scene, _initial_motion(scene), first, time)
        else:
            target, motion = second, _oscillated(scene, at_jump, second, time - JUMP_TIME)
        motions.append(motion)
        forces.append(SLIDE_STIFFNESS * (target - motion.x) - SLIDE_DAMPING * motion.rate)
    return _along_slide(scene, motions) | {"actuator_force": np.array(forces)[:, None]}


def spring_response(scene: Scene) -> Arrays:
    """Return the run of a sliding body on a spring and damper, with its energies and the damper's work."""
    start, times = _initial_motion(scene), scene.times.tolist()
    motions = [_oscillated(scene, start, SPRING_REST, time) for time in times]
    springs = [0.5 * SLIDE_STIFFNESS * (motion.x - SPRING_REST) ** 2 for motion in motions]
    return _with_energies(scene, motions, potential=np.array(springs))


def guided_motion(scene: Scene) -> Arrays:
    """Return the run of a sliding body whose displacement is prescribed, with the reaction force, which
    includes the force of the motion, and with the work of this force."""
    start = GUIDE.value(0.0)  # of the initial state, from which displacements are counted
    times = scene.times.tolist()
    motions = [Motion(float(GUIDE.value(t) - start), float(GUIDE.rate(t))) for t in times]
    accelerations = [GUIDE.acceleration(t) for t in times]
    force = scene.mechanism.bodies[1].mass * (np.outer(accelerations, SLIDE_AXIS) - scene.gravity)
    return _with_energies(scene, motions) | {"reaction_force": force[:, None]}


def braked_motion(scene: Scene) -> Arrays:
    """Return the run of a body that slides against dry friction, with its energies and its work."""
    return _with_energies(scene, _accelerated(scene, friction=SLIDE_FRICTION))


def rotor_slide(scene: Scene) -> Arrays:
    """Return the run of a body that its weight accelerates along a slide with a rotor, with its energies."""
    arrays = _with_energies(scene, _accelerated(scene, rotor=SLIDE_ROTOR), rotor=SLIDE_ROTOR)
    return {name: values for name, values in arrays.items() if name != "work"}  # nothing does work


def _accelerated(scene: Scene, friction: float = 0.0, rotor: float = 0.0) -> list[Motion]:
    """Return the motion of a sliding body that its weight accelerates against a constant force.

    Args:
        scene: the scene.
        friction: the force, N.
        rotor: rotor inertia of the slide, kg.
    """
    mass, start = scene.mechanism.bodies[1].mass, _initial_motion(scene)
    along = (mass * float(scene.gravity @ SLIDE_AXIS) - friction) / (mass + rotor)
    times = scene.times.tolist()
    return [Motion(start.rate * t + 0.5 * along * t**2, start.rate + along * t) for t in times]


def _with_energies(
    scene: Scene, motions: list[Motion], rotor: float = 0.0, potential: Array | float = 0.0
) -> dict[str, Array]:
    """Return the motion of a sliding body with its energies and the work, the change of their sum.

    Args:
        scene: the scene.
        motions: motion at each output time.
        rotor: rotor inertia of the slide, kg.
        potential: potential energy of springs at the output times, J.
    """
    mass, arrays = scene.mechanism.bodies[1].mass, _along_slide(scene, motions)
    kinetic = 0.5 * (mass + rotor) * np.array([motion.rate**2 for motion in motions])
    potential = potential - mass * arrays["position"][:, 1] @ scene.gravity
    energy = kinetic + potential
    energies = {"kinetic_energy": kinetic, "potential_energy": potential, "work": energy - energy[0]}
    return arrays | energies


def sampled_motion(scene: Scene) -> Arrays:
    """Return the run of a sliding body whose controller holds its force for a period, with this force."""
    mass = scene.mechanism.bodies[1].mass
    along = float(scene.gravity @ SLIDE_AXIS)

    def after(motion: Motion, force: float, time: float) -> Motion:
        """Return the motion after a time, s, with a constant force, N."""
        a = force / mass + along
        return Motion(motion.x + motion.rate * time + 0.5 * a * time**2, motion.rate + a * time)

    def held() -> Iterator[tuple[float, Motion, float]]:
        """Yield the time and motion of each sample, and the force from then on."""
        motion = _initial_motion(scene)
        for number in range(int(scene.duration / SAMPLING_PERIOD) + 1):
            force = sampled_force(number * SAMPLING_PERIOD, *motion)
            yield number * SAMPLING_PERIOD, motion, force
            motion = after(motion, force, SAMPLING_PERIOD)

    samples = list(held())
    motions, forces = [], []
    for time in scene.times.tolist():
        begin, motion, force = max(each for each in samples if each[0] <= time)
        motions.append(after(motion, force, time - begin))
        forces.append(force)
    return _along_slide(scene, motions) | {"actuator_force": np.array(forces)[:, None]}


def _initial_motion(scene: Scene) -> Motion:
    """Return the displacement and the speed of a sliding body at the start."""
    return Motion(0.0, float(initial_state(scene).linear_velocity[1] @ SLIDE_AXIS))


def _oscillated(scene: Scene, start: Motion, target: float, time: float) -> Motion:
    """Return the motion of a sliding body under a PD law and its weight, after a time with one set-point.

    Args:
        scene: the scene.
        start: motion at the begin of the time.
        target: set-point, m.
        time: s.
    """
    mass = scene.mechanism.bodies[1].mass
    decay = 0.5 * SLIDE_DAMPING / mass
    frequency = np.sqrt(SLIDE_STIFFNESS / mass - decay**2)
    rest = target + mass * float(scene.gravity @ SLIDE_AXIS) / SLIDE_STIFFNESS
    cosine, sine = start.x - rest, (start.rate + decay * (start.x - rest)) / frequency
    amplitude, c, s = np.exp(-decay * time), np.cos(frequency * time), np.sin(frequency * time)
    x = amplitude * (cosine * c + sine * s)
    rate = amplitude * frequency * (sine * c - cosine * s) - decay * x
    return Motion(float(rest + x), float(rate))


def _along_slide(scene: Scene, motions: list[Motion]) -> dict[str, Array]:
    """Return the poses and velocities of a sliding body at the output times."""
    arrays = _at_rest(scene)
    arrays["position"][:, 1] += np.outer([each.x for each in motions], SLIDE_AXIS)
    arrays["linear_velocity"][:, 1] = np.outer([each.rate for each in motions], SLIDE_AXIS)
    return arrays


def _at_rest(scene: Scene) -> dict[str, Array]:
    """Return the initial poses at all output times, and velocities of zero."""
    start, count = initial_state(scene), len(scene.times)
    still = np.zeros((count, *start.position.shape))
    return {
        "position": np.tile(start.position, (count, 1, 1)),
        "quaternion": np.tile(start.quaternion, (count, 1, 1)),
        "linear_velocity": still,
        "angular_velocity": still.copy(),
    }


def _symmetry(moments: Array) -> tuple[float, float, Array]:
    """Return the two equal principal moments, the third one, and its axis (3,), of a tensor (3, 3)."""
    values, vectors = np.linalg.eigh(moments)
    third = 2 if values[1] - values[0] < values[2] - values[1] else 0
    return float(values[1]), float(values[third]), vectors[:, third]
