"""Alignment of two scenes: the same bodies in the same order, names and frames, joints paired by name."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from crosscheck.against.bodies import (
    Members,
    Placed,
    features,
    forces_with_bodies,
    merge_fixed,
    place,
    with_bodies,
)
from newton_euler.assemble import initial_state
from newton_euler.model.euler_parameters import from_rotation, rotation
from newton_euler.model.joint import Joint, Key
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array


class Partner(NamedTuple):
    """A joint coordinate of the second model."""

    key: Key
    sense: float
    """-1 where it counts the other way, else 1."""


@dataclass(frozen=True, eq=False)
class Aligned:
    """Two models of one mechanism, bodies that are fixed to each other merged.

    Attributes:
        first: the first model.
        second: the second, its bodies as of the first: their order, names and frames, so that a state of one
            is a state of the other as far as centers of mass agree. Joints are its own. None if a body has
            no partner.
        alone: names of bodies that only the first or only the second model has.
        names: the first's name of each body that both have, by the second's.
        joints: the second's name of each joint of the first that both have.
        coordinates: the second's of each joint coordinate of the first that both have.
        centers: (b, 3) the second's center of mass from the first's, in the first's body frame, m.
        notes: what is not the same by name, in words.
    """

    first: Scene
    second: Scene | None
    alone: tuple[tuple[str, ...], tuple[str, ...]]
    names: Mapping[str, str]
    joints: Mapping[str, str]
    coordinates: Mapping[Key, Partner]
    centers: Array
    notes: tuple[str, ...]

    @property
    def both(self) -> tuple[Scene, Scene]:
        """Both models, of which all bodies have partners."""
        assert self.second is not None
        return self.first, self.second

    @property
    def joint_names(self) -> dict[str, str]:
        """The first's name of each joint that both have, by the second's."""
        return {other: name for name, other in self.joints.items()}

    def joint_pair(self, name: str) -> tuple[Joint, Joint]:
        """A joint of the first model and its partner."""
        a, b = (scene.mechanism for scene in self.both)
        return a.joint(name), b.joint(self.joints[name])


def align(first: Scene, second: Scene) -> Aligned:
    """Pair bodies, joints and coordinates of two scenes; the second gets the first's output times."""
    first, first_of = merge_fixed(first)
    second, second_of = merge_fixed(second)
    names = pair_bodies(first.mechanism, first_of, second.mechanism, second_of)
    notes = [
        f"body {name} is {' and '.join(second_of[other])} there"
        for other, name in names.items()
        if second_of[other] != first_of[name] and other != second.mechanism.body_names[0]
    ]
    alone = (
        tuple(name for name in first.mechanism.body_names if name not in names.values()),
        tuple(name for name in second.mechanism.body_names if name not in names),
    )
    if any(alone):
        notes.append("bodies are paired by their names, and what is left by the names of its joints")
        return Aligned(first, None, alone, names, {}, {}, np.zeros((0, 3)), tuple(notes))
    second = _renamed(second, names, first)
    joints = pair_joints(first.mechanism, second.mechanism)
    placed = [Placed(np.eye(3), np.zeros(3))]
    for k, body in enumerate(first.mechanism.body_names[1:], 1):
        pairs = [(name, other) for name, other in joints.items() if body in _ends(_joint(first, name))]
        here = features(first, k, [name for name, _ in pairs])
        there = features(second, k, [other for _, other in pairs])
        placed.append(place(here, there, first.mechanism.size))
    second = _reframed(second, placed)
    coordinates = _pair_coordinates(first.mechanism, second.mechanism, joints)
    notes += _joint_notes(first.mechanism, second.mechanism, joints, coordinates)
    centers = np.array([way.center for way in placed])
    return Aligned(first, second, alone, names, joints, coordinates, centers, tuple(notes))


def pair_bodies(first: Mechanism, first_of: Members, second: Mechanism, second_of: Members) -> dict[str, str]:
    """Pair bodies by the names of what they are made of, the rest by the names of their joints.

    The ground is the ground, whatever it is called.

    Returns:
        The first model's name of each body that both have, by the second's.
    """
    names = {second.body_names[0]: first.body_names[0]}

    def pair(one: Mapping[str, frozenset[str]], two: Mapping[str, frozenset[str]]) -> None:
        """Those that have more in common with each other than with anything else."""
        left = {name: one[name] for name in one if name not in names.values()}
        right = {name: two[name] for name in two if name not in names}
        for a, has in left.items():
            b = _nearest(has, right)
            if b is not None and _nearest(two[b], left) == a:
                names[b] = a

    pair({a: frozenset(first_of[a]) for a in first_of}, {b: frozenset(second_of[b]) for b in second_of})
    pair(_joints_of(first), _joints_of(second))
    return names


def _nearest(wanted: frozenset[str], among: Mapping[str, frozenset[str]]) -> str | None:
    """The one that has the most in common with what is wanted, if anything and no other has as much."""
    shared = {name: len(wanted & has) for name, has in among.items()}
    most = max(shared.values(), default=0)
    best = [name for name, count in shared.items() if count == most]
    return best[0] if most and len(best) == 1 else None


def _joints_of(mechanism: Mechanism) -> dict[str, frozenset[str]]:
    return {
        name: frozenset(mechanism.joint_names[k] for k in joints)
        for name, joints in zip(mechanism.body_names, mechanism.joints_at, strict=True)
    }


def pair_joints(first: Mechanism, second: Mechanism) -> dict[str, str]:
    """Pair joints of two mechanisms whose bodies have the same names.

    Joints of one name are paired if they connect the same bodies; of the rest those that are the only ones
    left in both models between their bodies.

    Returns:
        The second model's name of each joint of the first that both have.
    """
    others = {joint.name: joint for joint in second.joints}
    found = {
        joint.name: joint.name
        for joint in first.joints
        if joint.name in others and _ends(joint) == _ends(others[joint.name])
    }
    left = [joint for joint in first.joints if joint.name not in found]
    right = [joint for joint in second.joints if joint.name not in found]
    for joint in left:
        beside = [a for a in left if _ends(a) == _ends(joint)]
        between = [b for b in right if _ends(b) == _ends(joint)]
        if len(beside) == len(between) == 1:
            found[joint.name] = between[0].name
    return found


def _joint(scene: Scene, name: str) -> Joint:
    return scene.mechanism.joint(name)


def _ends(joint: Joint) -> frozenset[str]:
    return frozenset((joint.first, joint.second))


def _pair_coordinates(first: Mechanism, second: Mechanism, joints: Mapping[str, str]) -> dict[Key, Partner]:
    """Pair the hinges and slides of joints that both have by their axes."""
    found: dict[Key, Partner] = {}
    for name, other in joints.items():
        a, b = first.joint(name), second.joint(other)
        swapped = -1.0 if a.first == b.second else 1.0
        free = dict(enumerate(_axes(second, b, a)))
        for k, (kind, axes) in enumerate(_axes(first, a, a)):
            # in the body in which two axes are nearer to one line
            cosines = {
                n: max(np.sum(axes * others, axis=1), key=abs)
                for n, (its, others) in free.items()
                if its == kind
            }
            if cosines:
                n = max(cosines, key=lambda n: abs(cosines[n]))
                found[name, k] = Partner((other, n), swapped * float(np.copysign(1.0, cosines[n])))
                del free[n]
    return found


def _axes(mechanism: Mechanism, joint: Joint, like: Joint) -> Iterator[tuple[str, Array]]:
    """Kind of each coordinate of a joint, and its axis (2, 3) in the two bodies of another joint."""
    poses = [mechanism.body(name).pose for name in (like.first, like.second)]
    for motion in joint.motions:
        if motion.kind != "ball":
            yield motion.kind, np.array([pose.vector_to_body(motion.axis) for pose in poses])


def _renamed(scene: Scene, names: Mapping[str, str], like: Scene) -> Scene:
    """The scene with other names of bodies, in the order and with the output times of another scene.

    The ground is the other's: it is the world, whatever frame it is given.
    """
    mechanism, start = scene.mechanism, initial_state(scene)
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


def _reframed(scene: Scene, placed: list[Placed]) -> Scene:
    """The scene with other body frames; centers of mass stay where they are."""
    mechanism, start = scene.mechanism, initial_state(scene)
    bodies = []
    for body, way in zip(mechanism.bodies, placed, strict=True):
        inertia = way.turn.T @ body.inertia @ way.turn
        quaternion = from_rotation(body.pose.rotation @ way.turn)
        bodies.append(replace(body, inertia=0.5 * (inertia + inertia.T), quaternion=quaternion))
    turned = [from_rotation(rotation(p) @ way.turn) for p, way in zip(start.quaternion, placed, strict=True)]
    return replace(
        scene,
        mechanism=Mechanism(bodies, mechanism.joints, mechanism.couplings),
        initial_state=replace(start, quaternion=np.array(turned)),
    )


def _joint_notes(
    first: Mechanism, second: Mechanism, joints: Mapping[str, str], coordinates: Mapping[Key, Partner]
) -> Iterator[str]:
    """Joints of another name or kind, those that count the other way, and those that one model has alone."""
    for name, other in joints.items():
        a, b = first.joint(name), second.joint(other)
        if name != other:
            yield f"joint {name} is {other} there, the only one left between {a.first} and {a.second}"
        if a.kind != b.kind:
            same = sorted(part.kind for part in a.motions) == sorted(part.kind for part in b.motions)
            beside = ", with the same motions" if same else ""
            yield f"joint {name} is {a.kind} here and {b.kind} there{beside}"
    here = [name for name in first.joint_names if name not in joints]
    there = [name for name in second.joint_names if name not in joints.values()]
    back = dict.fromkeys(key[0] for key, partner in coordinates.items() if partner.sense < 0.0)
    for what, names in (
        ("counted the other way there", back),
        ("joints only here", here),
        ("joints only there", there),
    ):
        if names:
            yield f"{what}: {', '.join(names)}"
