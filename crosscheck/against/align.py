"""Two scenes made comparable: the same bodies in the same order, names and frames."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from crosscheck.against.pairs import Other, pair_bodies, pair_coordinates, pair_joints
from crosscheck.against.placing import Placed, carried, features, place
from crosscheck.against.rigid import forces_with_bodies, rigid, turned, with_bodies
from newton_euler.model.euler_parameters import from_rotation, rotation
from newton_euler.model.joints import Key
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State


@dataclass(frozen=True, eq=False)
class Aligned:
    """Two models of one mechanism, bodies that are fixed to each other put together.

    Attributes:
        first: the first model.
        second: the second, its bodies as of the first: their order, names and frames, so that a state of one
            is a state of the other as far as centres of mass agree. Joints are its own. None if a body has
            no partner.
        alone: names of bodies that only the first or only the second model has.
        bodies: the first's name of each body that both have, by the second's.
        joints: the second's name of each joint of the first that both have.
        coordinates: the second's of each joint coordinate of the first that both have.
        placed: for each body where it lies in the first's.
        notes: what is not the same by name, in words.
    """

    first: Scene
    second: Scene | None
    alone: tuple[tuple[str, ...], tuple[str, ...]]
    bodies: Mapping[str, str]
    joints: Mapping[str, str]
    coordinates: Mapping[Key, Other]
    placed: tuple[Placed, ...]
    notes: tuple[str, ...]


def align(first: Scene, second: Scene) -> Aligned:
    """Pair what two scenes hold; the second gets the first's duration and output times."""
    first, first_of = rigid(first)
    second, second_of = rigid(second)
    bodies = pair_bodies(first.mechanism, first_of, second.mechanism, second_of)
    notes = [
        f"body {name} is {' and '.join(second_of[other])} there"
        for other, name in bodies.names.items()
        if second_of[other] != first_of[name] and other != second.mechanism.body_names[0]
    ]
    if any(bodies.alone):
        notes.append("bodies are paired by their names, and what is left by the names of its joints")
        return Aligned(first, None, bodies.alone, bodies.names, {}, {}, (), tuple(notes))
    second = _renamed(second, bodies.names, first)
    joints = pair_joints(first.mechanism, second.mechanism)
    names = [carried(first.mechanism, joints, body) for body in first.mechanism.body_names]
    size = first.mechanism.size
    placed = tuple(
        place(
            features(first, k, [mine for mine, _ in names[k]]),
            features(second, k, [other for _, other in names[k]]),
            size,
        )
        if k
        else Placed(np.eye(3), np.zeros(3))
        for k in range(len(first.mechanism.bodies))
    )
    second = _reframed(second, placed)
    coordinates = pair_coordinates(first.mechanism, second.mechanism, joints)
    notes += _joint_notes(first.mechanism, second.mechanism, joints, coordinates)
    return Aligned(first, second, bodies.alone, bodies.names, joints, coordinates, placed, tuple(notes))


def _renamed(scene: Scene, names: Mapping[str, str], like: Scene) -> Scene:
    """The scene with other names of bodies, in the order and with the output times of another scene.

    The ground is the other's: it is the world, whatever frame it is given.
    """
    mechanism, start = scene.mechanism, scene.initial_state
    old = {new: name for name, new in names.items()}
    order = [mechanism.body_index(old[name]) for name in like.mechanism.body_names]
    bodies = [replace(mechanism.bodies[k], name=names[mechanism.body_names[k]]) for k in order]
    ground = like.mechanism.bodies[0]
    bodies[0] = ground
    position, quaternion = start.position[order], start.quaternion[order]
    position[0], quaternion[0] = ground.center_of_mass, ground.quaternion
    joints = [with_bodies(joint, names) for joint in mechanism.joints]
    return replace(
        scene,
        mechanism=Mechanism(bodies, joints, mechanism.couplings),
        initial_state=State(
            position, quaternion, start.linear_velocity[order], start.angular_velocity[order]
        ),
        forces=forces_with_bodies(scene.forces, names, ground.name),
        duration=like.duration,
        output_period=like.output_period,
    )


def _reframed(scene: Scene, placed: tuple[Placed, ...]) -> Scene:
    """The scene with other body frames; centres of mass stay where they are."""
    mechanism, start = scene.mechanism, scene.initial_state
    bodies = [
        turned(body, way.turn, from_rotation(body.pose.rotation @ way.turn))
        for body, way in zip(mechanism.bodies, placed, strict=True)
    ]
    quaternion = np.array(
        [from_rotation(rotation(p) @ way.turn) for p, way in zip(start.quaternion, placed, strict=True)]
    )
    return replace(
        scene,
        mechanism=Mechanism(bodies, mechanism.joints, mechanism.couplings),
        initial_state=replace(start, quaternion=quaternion),
    )


def _joint_notes(
    first: Mechanism, second: Mechanism, joints: Mapping[str, str], coordinates: Mapping[Key, Other]
) -> Iterator[str]:
    """Joints of another name or kind, those that count the other way, and those that one model has alone."""
    for name, other in joints.items():
        a, b = first.joints[first.joint_index(name)], second.joints[second.joint_index(other)]
        if name != other:
            yield f"joint {name} is {other} there, the only one left between {a.first} and {a.second}"
        if a.kind != b.kind:
            yield f"joint {name} is {a.kind} here and {b.kind} there"
    back = dict.fromkeys(key[0] for key, other in coordinates.items() if other.sense < 0.0)
    if back:
        yield f"counted the other way there: {', '.join(back)}"
    here = [name for name in first.joint_names if name not in joints]
    there = [name for name in second.joint_names if name not in joints.values()]
    if here:
        yield f"joints only here: {', '.join(here)}"
    if there:
        yield f"joints only there: {', '.join(there)}"
