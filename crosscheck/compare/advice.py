"""Advice on a scene: which joints to replace so that no constraint is redundant.

In: a scene (a mechanism with its forces and initial state). Out: sentences of advice.

Redundant constraints leave joint reactions undetermined. A planar four-bar linkage with four parallel hinges,
for example, has three redundant constraints in space. With a ball joint in place of one hinge and a
cylindrical joint in place of another, no constraint is redundant and the motion is the same.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

from newton_euler.equations.couplings import couplings
from newton_euler.equations.undetermined import undetermined
from newton_euler.errors import NewtonEulerError
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import Cylindrical, Spherical
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.reading.excitation import random_states
from newton_euler.runs.assemble import initial_state


@dataclass(frozen=True)
class Advice:
    """One piece of advice.

    Attributes:
        topic: what the advice is about, such as "redundancy" (of constraints).
        text: one sentence.
    """

    topic: str
    text: str

    def __str__(self) -> str:
        return f"{self.topic}: {self.text}"


SOFTER: dict[str, tuple[type[Joint], ...]] = {
    "revolute": (Cylindrical, Spherical),
    "prismatic": (Cylindrical,),
    "universal": (Spherical,),
    "fixed": (Spherical,),
}
"""Kinds of joints with more freedom that can replace a joint of each kind, with the same point and axis."""

MAX_CHANGED_JOINTS = 20
"""Largest number of joints that are tried, beginning with joints to which no other element refers."""

REDUNDANCY_TEST_STATES = 1
"""Number of random states, in addition to the initial state, at which redundant constraints are counted."""


class Change(NamedTuple):
    """Replacement or removal of one joint that keeps the motions of the mechanism.

    Attributes:
        redundant: number of redundant constraint equations of the changed mechanism.
        text: description of the change.
        mechanism: the changed mechanism.
    """

    redundant: int
    text: str
    mechanism: Mechanism


def redundancy_advice(scene: Scene) -> Iterator[Advice]:
    """Advise which joints to replace by joints with more freedom, so that no constraint is redundant.

    Joints are replaced one after the other; each time the change that leaves the fewest redundant constraints
    is taken.
    """
    states = [initial_state(scene), *random_states(scene, REDUNDANCY_TEST_STATES)]
    redundant = _count_redundant(scene.mechanism, states)
    if redundant == 0:
        return
    # Joints that may be changed, unreferenced ones first: those with constraints, of which no gear, screw or
    # prescribed motion (a coupling) uses a coordinate
    referenced = _referenced_joints(scene)
    coupled = {joint for coupling in couplings(scene) for joint, _ in coupling.factors}
    joints = zip(scene.mechanism.joints, scene.mechanism.equations, strict=True)
    candidates = [joint for joint, equations in joints if equations.count and joint.name not in coupled]
    candidates.sort(key=lambda joint: (joint.name in referenced, joint.actuated))
    names = [joint.name for joint in candidates[:MAX_CHANGED_JOINTS]]
    # The best change, repeatedly, until no change reduces the number of redundant constraints
    mechanism, texts, remaining = scene.mechanism, list[str](), redundant
    while remaining:
        changes = _changes(mechanism, remaining, names, referenced, states)
        no_change = Change(remaining, "", mechanism)
        best = min(changes, key=lambda change: change.redundant, default=no_change)
        if best.redundant >= remaining:
            break
        remaining = best.redundant
        texts.append(best.text)
        mechanism = best.mechanism
    if not texts:
        return
    noun = "constraint" if redundant == 1 else "constraints"
    result = f"then {remaining} of them {'is' if remaining == 1 else 'are'} left"
    if remaining == 0:
        result = "then all reactions are determined"
    yield Advice(
        "redundancy",
        f"{redundant} redundant {noun}; the motion is the same with {', '.join(texts)}: {result}",
    )


def _count_redundant(mechanism: Mechanism, states: list[State]) -> int:
    """Count the constraint equations that are redundant in all of the states."""
    scene = Scene("tried", mechanism, duration=1.0, output_period=1.0)
    # one undetermined combination of reactions (a column) for each redundant equation
    return min(undetermined(scene, state).shape[1] for state in states)


def _count_constraints(mechanism: Mechanism) -> int:
    """Count the constraint equations of all joints."""
    return sum(equations.count for equations in mechanism.equations)


def _referenced_joints(scene: Scene) -> set[str]:
    """Return names of joints that are actuated, or that a force, controller, motion or armature refers to."""
    named = {law.joint for law in scene.control} | {motion.joint for motion in scene.motions}
    named |= {armature.joint for armature in scene.armatures}
    named |= {str(getattr(force, "joint", "")) for force in scene.forces}
    return named | {joint.name for joint in scene.mechanism.joints if joint.actuated}


def _changes(
    mechanism: Mechanism, redundant: int, names: list[str], referenced: set[str], states: list[State]
) -> Iterator[Change]:
    """Yield all changes of one joint that keep the motions of a mechanism.

    Args:
        mechanism: the mechanism.
        redundant: number of its redundant constraint equations.
        names: names of the joints that may be changed.
        referenced: names of joints whose coordinates must be kept, since other elements refer to them.
        states: states at which redundant constraints are counted.
    """
    # Changes only remove constraints: if as many independent ones remain, the motions are the same
    rank = _count_constraints(mechanism) - redundant
    joints = {joint.name: joint for joint in mechanism.joints}
    for name in names:
        if name not in joints:
            continue
        joint = joints[name]
        for text, replacement in _replacements(joint, name in referenced):
            replaced = [replacement if each is joint else each for each in mechanism.joints]
            remaining_joints = [each for each in replaced if each is not None]
            try:
                tried = Mechanism(mechanism.bodies, remaining_joints, mechanism.couplings)
                still_redundant = _count_redundant(tried, states)
                if _count_constraints(tried) - still_redundant == rank:
                    yield Change(still_redundant, text, tried)
            except NewtonEulerError:  # a body is not connected any more
                continue


def _replacements(joint: Joint, referenced: bool) -> Iterator[tuple[str, Joint | None]]:
    """Yield joints that may replace a joint, with a description; None to leave the joint out.

    Args:
        joint: the joint.
        referenced: True if the coordinates of the joint must be kept.
    """
    if not referenced:
        yield f"joint {joint.name!r} left out", None
    for kind in SOFTER.get(joint.kind, ()):
        softer = _of_kind(joint, kind)
        if not referenced or set(joint.coordinate_kinds) <= set(softer.coordinate_kinds):
            yield f"a {kind.kind} joint for the {joint.kind} {joint.name!r}", softer


def _of_kind(joint: Any, kind: type[Joint]) -> Joint:
    """Return a joint of another kind with the same name, bodies, points and, if that kind has one, axis."""
    axis = {"axis": joint.axis} if "axis" in kind.axis_names else {}
    return kind(
        joint.name, joint.first, joint.second, joint.point, point_on_second=joint.point_on_second, **axis
    )
