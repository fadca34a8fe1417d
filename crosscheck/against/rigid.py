"""A scene whose bodies are what moves as one: those that `fixed` joints hold together are put together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TypeVar

import numpy as np

from newton_euler.equations.system import MassProperties
from newton_euler.model.forces import BallSpring, Force, JointSpring, PointSpring, Wrench
from newton_euler.model.joints import Fixed, Joint
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import OUTPUTS, Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array, cross

Named = TypeVar("Named", Joint, PointSpring)


def rigid(scene: Scene) -> tuple[Scene, dict[str, tuple[str, ...]]]:
    """The same mechanism without `fixed` joints, all outputs asked for.

    Bodies that are fixed to the ground become the ground; others take the name and the frame of the first
    of them.

    Returns:
        The scene, and for each of its bodies the names of those that it is made of.
    """
    groups = _groups(scene.mechanism)
    owner = {name: group[0] for group in groups for name in group}
    members = {group[0]: group for group in groups}
    indices = [[scene.mechanism.body_index(name) for name in group] for group in groups]
    bodies = [scene.mechanism.bodies[0], *(_together(scene.mechanism, group) for group in indices[1:])]
    joints = [with_bodies(joint, owner) for joint in scene.mechanism.joints]
    mechanism = Mechanism(
        bodies, [joint for joint in joints if joint.first != joint.second], scene.mechanism.couplings
    )
    state = _state(scene, bodies, [group[0] for group in indices])
    forces = forces_with_bodies(scene.forces, owner, bodies[0].name)
    return replace(
        scene, mechanism=mechanism, initial_state=state, forces=forces, outputs=frozenset(OUTPUTS)
    ), members


def _groups(mechanism: Mechanism) -> list[tuple[str, ...]]:
    """Names of the bodies that move as one, in the mechanism's order; the ground's are the first."""
    owner = {name: name for name in mechanism.body_names}
    for joint in mechanism.joints:
        if isinstance(joint, Fixed):
            kept, other = sorted((owner[joint.first], owner[joint.second]), key=mechanism.body_names.index)
            owner = {name: kept if of == other else of for name, of in owner.items()}
    return [
        tuple(name for name in mechanism.body_names if owner[name] == group)
        for group in dict.fromkeys(owner.values())
    ]


def _together(mechanism: Mechanism, indices: list[int]) -> Body:
    """One body of several, in the frame of the first."""
    first = mechanism.bodies[indices[0]]
    if len(indices) == 1:
        return first
    found, parts = MassProperties.of(mechanism), [mechanism.bodies[k] for k in indices]
    masses, centers = found.mass[indices], found.center_of_mass[indices]
    center = masses @ centers / masses.sum()
    inertia = found.inertia[indices].sum(axis=0)
    for mass, arm in zip(masses, centers - center, strict=True):
        inertia = inertia + mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    into = first.pose.rotation.T
    local = into @ inertia @ into.T
    return replace(
        first,
        mass=float(masses.sum()),
        center_of_mass=center,
        inertia=0.5 * (local + local.T),
        shapes=tuple(shape for part in parts for shape in part.shapes),
        meshes=tuple(mesh for part in parts for mesh in part.meshes),
        allow_unrealisable_inertia=any(part.allow_unrealisable_inertia for part in parts),
    )


def _state(scene: Scene, bodies: list[Body], indices: list[int]) -> State:
    """The initial state of bodies that have the frames of those of these numbers."""
    start = scene.initial_state
    position, velocity = start.position[indices], start.linear_velocity[indices]
    for n, (body, index) in enumerate(zip(bodies, indices, strict=True)):
        before = scene.mechanism.bodies[index].pose
        arm = start.frames()[index].rotation @ before.point_to_body(body.center_of_mass)
        position[n] += arm
        velocity[n] += cross(start.angular_velocity[index], arm)
    return State(position, start.quaternion[indices], velocity, start.angular_velocity[indices])


def with_bodies(thing: Named, names: Mapping[str, str]) -> Named:
    """A joint or a spring between bodies of other names."""
    return replace(thing, first=names[thing.first], second=names[thing.second])


def forces_with_bodies(forces: tuple[Force, ...], names: Mapping[str, str], ground: str) -> tuple[Force, ...]:
    """Forces on bodies of other names, without those that act within a body or on the ground alone."""
    found: list[Force] = []
    for force in forces:
        match force:
            case JointSpring() | BallSpring():
                found.append(force)
            case PointSpring():
                renamed = with_bodies(force, names)
                if renamed.first != renamed.second:
                    found.append(renamed)
            case Wrench() if names[force.body] != ground:
                found.append(replace(force, body=names[force.body]))
    return tuple(found)


def turned(body: Body, turn: Array, quaternion: Array) -> Body:
    """A body in another frame: `turn` (3, 3) takes vectors of the other frame to its present one."""
    inertia = turn.T @ body.inertia @ turn
    return replace(body, inertia=0.5 * (inertia + inertia.T), quaternion=quaternion)
