"""Which body, joint and part of a file of one model is which of another."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np

from newton_euler.model.joints import Joint, Key
from newton_euler.model.mechanism import Mechanism
from newton_euler.scalars import Array

Members = Mapping[str, tuple[str, ...]]
"""For each body the names of those that it is made of, see `rigid.rigid`."""

Held = TypeVar("Held")
"""What a file says of something."""


class Other(NamedTuple):
    """A joint coordinate of the other model."""

    key: Key
    sense: float
    """-1 where it counts the other way, else 1."""


@dataclass(frozen=True)
class BodyPairs:
    """Bodies of two models.

    Attributes:
        names: the first model's name of each body that both have, by the second model's name.
        alone: names of bodies that only the first or only the second model has.
    """

    names: dict[str, str]
    alone: tuple[tuple[str, ...], tuple[str, ...]]


def pair_bodies(first: Mechanism, first_of: Members, second: Mechanism, second_of: Members) -> BodyPairs:
    """Bodies by the names of what they are made of; of the rest those that have the same joints, by name.

    The ground is the ground, whatever it is called.
    """
    names = {second.body_names[0]: first.body_names[0]}

    def pair(one: Mapping[str, frozenset[str]], two: Mapping[str, frozenset[str]]) -> None:
        """Those that have more in common with each other than with anything else."""
        left = [name for name in one if name not in names.values()]
        right = [name for name in two if name not in names]
        for a in left:
            b = _nearest(one[a], {name: two[name] for name in right})
            if b is not None and _nearest(two[b], {name: one[name] for name in left}) == a:
                names[b] = a

    pair({a: frozenset(first_of[a]) for a in first_of}, {b: frozenset(second_of[b]) for b in second_of})
    pair(_joints_of(first), _joints_of(second))
    alone = (
        tuple(name for name in first.body_names if name not in names.values()),
        tuple(name for name in second.body_names if name not in names),
    )
    return BodyPairs(names, alone)


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
    """The second model's name of each joint of the first that both have; bodies have the same names.

    Joints of one name are paired if they connect the same bodies; of the rest those that are the only ones
    left in both models between their bodies.
    """
    found: dict[str, str] = {}
    others = {joint.name: joint for joint in second.joints}
    for joint in first.joints:
        other = others.get(joint.name)
        if other is not None and _ends(joint) == _ends(other):
            found[joint.name] = joint.name
    left = [joint for joint in first.joints if joint.name not in found]
    right = [joint for joint in second.joints if joint.name not in found.values()]
    for joint in left:
        beside = [a for a in left if _ends(a) == _ends(joint)]
        between = [b for b in right if _ends(b) == _ends(joint)]
        if len(beside) == len(between) == 1:
            found[joint.name] = between[0].name
    return found


def _ends(joint: Joint) -> frozenset[str]:
    return frozenset((joint.first, joint.second))


def pair_coordinates(first: Mechanism, second: Mechanism, joints: Mapping[str, str]) -> dict[Key, Other]:
    """The second model's coordinate for each of the first that both have; frames of bodies are the same.

    Hinges and slides are taken for each other by their axes.
    """
    found: dict[Key, Other] = {}
    for name, other in joints.items():
        a = first.joints[first.joint_index(name)]
        b = second.joints[second.joint_index(other)]
        swapped = -1.0 if a.first == b.second else 1.0
        free = dict(enumerate(_local(second, b, a)))
        for k, (kind, axes) in enumerate(_local(first, a, a)):
            cosines = {n: _cosine(axes, of) for n, (its, of) in free.items() if its == kind}
            if cosines:
                n = max(cosines, key=lambda n: abs(cosines[n]))
                found[name, k] = Other((other, n), swapped * float(np.copysign(1.0, cosines[n])))
                del free[n]
    return found


def _local(mechanism: Mechanism, joint: Joint, like: Joint) -> Iterator[tuple[str, tuple[Array, Array]]]:
    """Kind of each coordinate of a joint, and its axis in the two bodies of another, in their order."""
    poses = [mechanism.bodies[mechanism.body_index(name)].pose for name in (like.first, like.second)]
    for motion in joint.motions:
        if motion.kind != "ball":
            first, second = (pose.vector_to_body(motion.axis) for pose in poses)
            yield motion.kind, (first, second)


def _cosine(one: tuple[Array, Array], two: tuple[Array, Array]) -> float:
    """Of the angle between axes, in the body in which they are nearer to one line."""
    return max((float(a @ b) for a, b in zip(one, two, strict=True)), key=abs)


def pair_parts(
    here: list[Held],
    there: list[Held],
    same: Callable[[Held, Held], bool],
    name: Callable[[Held], str],
    place: Callable[[Held], Sequence[object]],
) -> Iterator[tuple[Held, Held]]:
    """Take pairs out of both lists, each with the first that is left for it.

    What is the same goes before what has one name, for numbers stand for names that files leave out; last
    comes what is in one place.
    """

    def same_name(one: Held, two: Held) -> bool:
        return name(one) == name(two)

    def same_place(one: Held, two: Held) -> bool:
        return any(place(one)) and place(one) == place(two)

    for alike in (lambda one, two: same_name(one, two) and same(one, two), same, same_name, same_place):
        for one in list(here):
            two = next((two for two in there if alike(one, two)), None)
            if two is not None:
                here.remove(one)
                there.remove(two)
                yield one, two
