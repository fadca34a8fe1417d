"""Redundant constraints: which joint to leave out or to replace so that all reactions are determined.

A planar loop of four hinges, built in space, has three rows too many: what they hold is held already. With
a ball in place of one hinge and a cylindrical joint in place of another, nothing is held twice and the
motion is the same.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from crosscheck.advice.measured import Advice, Found
from crosscheck.comparison.reactions import undetermined
from newton_euler.assemble import initial_state
from newton_euler.equations.couplings import couplings
from newton_euler.errors import NewtonEulerError
from newton_euler.exercise import random_states
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import Cylindrical, Spherical
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State

SOFTER: dict[str, tuple[type[Joint], ...]] = {
    "revolute": (Cylindrical, Spherical),
    "prismatic": (Cylindrical,),
    "universal": (Spherical,),
    "fixed": (Spherical,),
}
"""Kinds that hold less, and need no direction that the joint does not have."""

MOST_JOINTS = 20
"""That changes are tried at, those that nothing refers to first."""

STATES = 1
"""Random states beside the initial one that a change is tried at."""


def redundancy_advice(found: Found) -> Iterator[Advice]:
    """For mechanisms with rows that say nothing new, found by trying what is without them."""
    scene = found.scene
    states = [initial_state(scene), *random_states(scene, STATES)]
    redundant = _redundant(scene.mechanism, states)
    if redundant == 0:
        return
    driven = _driven(scene)
    coupled = {joint for coupling in couplings(scene) for joint, _ in coupling.factors}
    joints = zip(scene.mechanism.joints, scene.mechanism.equations, strict=True)
    holding = [joint for joint, equations in joints if equations.count and joint.name not in coupled]
    holding.sort(key=lambda joint: (joint.name in driven, joint.actuated))
    names = [joint.name for joint in holding[:MOST_JOINTS]]
    mechanism, steps, left = scene.mechanism, list[str](), redundant
    while left:
        changes = _changes(mechanism, left, names, driven, states)
        best = min(changes, key=lambda change: change[0], default=(left, "", mechanism))
        if best[0] >= left:
            break
        left = best[0]
        steps.append(best[1])
        mechanism = best[2]
    if not steps:
        return
    rows = "row says" if redundant == 1 else "rows say"
    rest = f"then {left} of them {'is' if left == 1 else 'are'} left"
    if left == 0:
        rest = "then all reactions are determined"
    yield Advice(
        "redundancy",
        f"{redundant} constraint {rows} nothing new; the motion is the same with {', '.join(steps)}: {rest}",
    )


def _redundant(mechanism: Mechanism, states: list[State]) -> int:
    """Count the constraint rows that are redundant in all of the states."""
    scene = Scene("tried", mechanism, 1.0, 1.0)
    return min(undetermined(scene, state).shape[1] for state in states)


def _rows(mechanism: Mechanism) -> int:
    return sum(equations.count for equations in mechanism.equations)


def _driven(scene: Scene) -> set[str]:
    """Joints with a coordinate that a force, law, motion or armature refers to."""
    named = {law.joint for law in scene.control} | {motion.joint for motion in scene.motions}
    named |= {armature.joint for armature in scene.armatures}
    named |= {str(getattr(force, "joint", "")) for force in scene.forces}
    return named | {joint.name for joint in scene.mechanism.joints if joint.actuated}


def _changes(
    mechanism: Mechanism, redundant: int, names: list[str], driven: set[str], states: list[State]
) -> Iterator[tuple[int, str, Mechanism]]:
    """Yield mechanisms with the same motions and one joint less or of another kind.

    Each with the number of its redundant rows and what was done; the given one has `redundant` rows.
    """
    rank = _rows(mechanism) - redundant
    joints = {joint.name: joint for joint in mechanism.joints}
    for name in names:
        if name not in joints:
            continue
        joint = joints[name]
        for what, other in _options(joint, name in driven):
            changed = [other if j is joint else j for j in mechanism.joints]
            kept = [j for j in changed if j is not None]
            try:
                tried = Mechanism(mechanism.bodies, kept, mechanism.couplings)
                left = _redundant(tried, states)
                if _rows(tried) - left == rank:
                    yield left, what, tried
            except NewtonEulerError:  # a body that nothing holds any more
                continue


def _options(joint: Joint, driven: bool) -> Iterator[tuple[str, Joint | None]]:
    """List the joints that may replace a joint; one that is driven keeps its hinge or slide."""
    if not driven:
        yield f"joint {joint.name!r} left out", None
    for kind in SOFTER.get(joint.kind, ()):
        softer = _as(joint, kind)
        if not driven or set(joint.coordinate_kinds) <= set(softer.coordinate_kinds):
            yield f"a {kind.kind} joint for the {joint.kind} {joint.name!r}", softer


def _as(joint: Any, kind: type[Joint]) -> Joint:
    axis = {"axis": joint.axis} if "axis" in kind.axis_names else {}
    return kind(
        joint.name, joint.first, joint.second, joint.point, point_on_second=joint.point_on_second, **axis
    )
