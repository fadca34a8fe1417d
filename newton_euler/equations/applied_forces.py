"""Applied forces of a scene: their wrenches on the bodies, their energies and their power.

The same for all formulations, over generic scalars. Forces on joint coordinates act through these coordinates
(`newton_euler.equations.joint_coordinates`); only their energies and power are here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from newton_euler.equations import balls
from newton_euler.model.constraints import Frame
from newton_euler.model.forces import (
    BallArmature,
    BallSpring,
    JointSpring,
    PointSpring,
    Wrench,
    line_of,
    pull_along,
    wrench_at,
)
from newton_euler.model.joint import Key, Pose
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array, Scalar, cross, sqrt

Measurements = Mapping[Key, tuple[Scalar, ...]]
"""Joint coordinates (m or rad), their rates, and further values that are not used here."""

Surroundings = tuple[list[Pose], list[Frame], Measurements, Scalar]
"""Arguments of forces: reference poses and frames of all bodies, joint coordinates, and the time, s."""


def ball_motion(
    scene: Scene, spring: BallSpring, poses: Sequence[Pose], frames: Sequence[Frame]
) -> tuple[tuple[int, int], Array, Array]:
    """Find the bodies of a spring of a ball; compute theta and omega, (3,) rad and rad/s, world frame."""
    i, j = balls.ends(scene.mechanism, spring.joint)
    between = frames[i], frames[j]
    return (i, j), balls.rotation_between(poses[i], poses[j], spring.rest, between), balls.spin(*between)


def body_wrenches(scene: Scene, poses: Sequence[Pose], frames: Sequence[Frame]) -> list[Array]:
    """Compute the wrenches (6,) of springs of balls, springs between points and wrenches on each body.

    Force and torque about the center of mass, N and N m, world frame, ground first. `poses` are the reference
    poses of the frames at the initial pose.
    """
    total: list[Array] = [np.zeros(6) for _ in frames]
    for force in scene.forces:
        if isinstance(force, PointSpring):
            line = line_of(force, scene.mechanism, poses, frames)
            pull = pull_along(force, line)
            total[line.first] = total[line.first] + np.concatenate([pull, cross(line.s_i, pull)])
            total[line.second] = total[line.second] - np.concatenate([pull, cross(line.s_j, pull)])
        elif isinstance(force, Wrench):
            k = scene.mechanism.body_index(force.body)
            push, torque, arm = wrench_at(force, k, poses, frames)
            total[k] = total[k] + np.concatenate([push, torque + cross(arm, push)])
        elif isinstance(force, BallSpring):
            (i, j), theta, omega = ball_motion(scene, force, poses, frames)
            couple = np.concatenate([np.zeros(3), force.torque(theta, omega)])
            total[i], total[j] = total[i] - couple, total[j] + couple
    return total


def energies(scene: Scene, frames: list[Frame], inertias: list[Array]) -> tuple[Scalar, Scalar]:
    """Compute the kinetic energy and the potential energy of gravity (zero at the world origin), J.

    `inertias` are in the body frames that `frames` give the rotations of.
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


def springs_energy(
    scene: Scene, poses: Sequence[Pose], frames: Sequence[Frame], measured: Measurements
) -> Scalar:
    """Compute the energy of all springs, J."""
    energy: Scalar = 0.0
    for spring in scene.forces:
        if isinstance(spring, JointSpring):
            energy = energy + spring.energy(measured[spring.joint, spring.coordinate][0])
        elif isinstance(spring, PointSpring):
            d = line_of(spring, scene.mechanism, poses, frames).d
            length = sqrt(d @ d)
            stretch = length - spring.rest_length
            energy = energy + 0.5 * spring.stiffness * (stretch * stretch)
        elif isinstance(spring, BallSpring):
            energy = energy + spring.energy(ball_motion(scene, spring, poses, frames)[1])
    return energy


def rotors_energy(scene: Scene, frames: Sequence[Frame], measured: Measurements) -> Scalar:
    """Compute the kinetic energy of the armatures, J."""
    energy: Scalar = 0.0
    for armature in scene.armatures:
        if isinstance(armature, BallArmature):
            i, j = balls.ends(scene.mechanism, armature.joint)
            omega = balls.spin(frames[i], frames[j])
            square = omega @ omega
        else:
            rate = measured[armature.key][1]
            square = rate * rate
        energy = energy + 0.5 * armature.inertia * square
    return energy


def power(
    scene: Scene,
    poses: Sequence[Pose],
    frames: Sequence[Frame],
    measured: Measurements,
    time: Scalar,
) -> Scalar:
    """Compute the power, W, of control laws, dampers and wrenches, which have no potential energy."""
    power: Scalar = 0.0
    for law in scene.joint_forces:
        x, rate = measured[law.joint, law.coordinate][:2]
        power = power + law.power(x, rate, time)
    for force in scene.forces:
        if isinstance(force, PointSpring):
            line = line_of(force, scene.mechanism, poses, frames)
            if force.has_direction:
                along = line.d @ line.rate
                power = power - force.damping * (along * along) / (line.d @ line.d)
        elif isinstance(force, Wrench):
            k = scene.mechanism.body_index(force.body)
            push, torque, arm = wrench_at(force, k, poses, frames)
            omega = frames[k].angular_velocity
            power = power + push @ (frames[k].velocity + cross(omega, arm)) + torque @ omega
        elif isinstance(force, BallSpring):
            i, j = balls.ends(scene.mechanism, force.joint)
            power = power + force.power(balls.spin(frames[i], frames[j]))
    return power


def magnitudes(
    scene: Scene,
    poses: Sequence[Pose],
    frames: Sequence[Frame],
    measured: Measurements,
    time: Scalar,
) -> dict[str, float]:
    """Compute the magnitude, N, of each force, by the name that errors use; torques over the size."""
    size = scene.mechanism.size
    found: dict[str, float] = {}
    for law in scene.joint_forces:
        joint = scene.mechanism.joint(law.joint)
        turns = joint.coordinate_kinds[law.coordinate] == "hinge"
        x, rate = measured[law.joint, law.coordinate][:2]
        found[law.element] = abs(law.force(x, rate, time)) / (size if turns else 1.0)
    for force in scene.forces:
        if isinstance(force, PointSpring):
            pull = pull_along(force, line_of(force, scene.mechanism, poses, frames))
            found[force.element] = float(np.max(np.abs(pull)))
        elif isinstance(force, Wrench):
            found[force.element] = float(np.max(np.abs([force.force, force.torque / size])))
        elif isinstance(force, BallSpring):
            torque = force.torque(*ball_motion(scene, force, poses, frames)[1:])
            found[force.element] = float(np.max(np.abs(torque))) / size
    return found


def strongest_force(scene: Scene, state: State, time: float) -> str | None:
    """Find the largest of a scene's forces at a state and a time in s, by the name that errors use.

    Angles are those within half a revolution. None for a scene without forces.
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
    """Find the largest of a scene's forces in known surroundings; None for a scene without forces."""
    with np.errstate(all="ignore"):
        found = magnitudes(scene, *seen)
    if not found:
        return None
    return max(found, key=lambda element: np.nan_to_num(found[element], nan=np.inf))
