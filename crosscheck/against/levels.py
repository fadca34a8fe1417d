"""Levels at which two models are compared: their own numbers, where they start, and the levels of engines.

Each takes the two models as engines that have the first's bodies, see `crosscheck.comparison.levels`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from typing import NamedTuple

import numpy as np

from crosscheck.against.align import Aligned
from crosscheck.against.bodies import axes_apart, carried, inertia_apart, points_apart
from crosscheck.comparison.accelerations import acceleration_rows
from crosscheck.comparison.blame import kinematic_cause
from crosscheck.comparison.dynamics import motion_rows
from crosscheck.comparison.figure import ROUND_OFF, START, Figure, reach, round_off, worst_figure
from crosscheck.comparison.kinematics import kinematics_rows
from crosscheck.comparison.levels import Level
from crosscheck.comparison.reactions import undetermined_in_both
from crosscheck.comparison.samples import Samples, States
from newton_euler.assemble import initial_state
from newton_euler.equations.applied_forces import body_wrenches, surroundings
from newton_euler.equations.couplings import Coupling, couplings
from newton_euler.model.control import Law
from newton_euler.model.elements import BALL, OnBall, OnCoordinate
from newton_euler.model.euler_parameters import angle_between, rotation
from newton_euler.model.forces import Armature, BallArmature, BallSpring, JointSpring
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array

Pair = tuple[str, str]

MOST_NAMED = 4
"""Bodies or joints that are named beside the worst."""


ROTORS = "rotor momentum, rel"

Acting = Law | Armature | BallArmature | JointSpring | BallSpring
"""An element at a joint."""

ACTING: Mapping[str, Callable[[Scene], Iterable[Acting]]] = {
    ROTORS: lambda scene: scene.armatures,
    "actuator force, rel": lambda scene: scene.control,
    "spring force, rel": lambda scene: [f for f in scene.forces if isinstance(f, OnCoordinate | OnBall)],
}
"""What acts at joints, by the quantity that it is compared in."""


@dataclass(frozen=True, eq=False)
class SharedStates(States):
    """States of the first model at which reactions are compared as far as both models determine them."""

    aligned: Aligned

    @cached_property
    def undetermined(self) -> list[Array]:
        """(6 j, r) for each state, see `undetermined_in_both`, and all of joints that the first has alone."""
        first, second = self.aligned.both
        alone = [name not in self.aligned.joints for name in first.mechanism.joint_names]
        columns = np.eye(6 * len(alone))[:, np.repeat(alone, 6)]
        joints = self.aligned.joints
        return [np.hstack([undetermined_in_both(first, second, joints, s), columns]) for s in self.all]


def numbers(aligned: Aligned) -> tuple[Level, ...]:
    """The levels of the models' own numbers, which need no states but the start."""
    return partial(_model, aligned), partial(_start, aligned)


def motions(aligned: Aligned) -> tuple[Level, ...]:
    """The levels of what the models do at consistent states."""
    return partial(_kinematics, aligned), partial(_dynamics, aligned), acceleration_rows


def bodies_row(pair: Pair, aligned: Aligned) -> Figure:
    """Count the bodies that have no partner."""
    alone = [name for names in aligned.alone for name in names]
    return Figure("model", "bodies without partner", pair, float(len(alone)), 0.5, ", ".join(alone))


class Difference(NamedTuple):
    """One quantity of the models, for each body, joint or coupling."""

    quantity: str
    gap: Array
    """(n,)."""
    tolerance: float
    names: Sequence[str]

    @property
    def note(self) -> str:
        """Say what differs where several bodies or joints do; empty if at most one does."""
        order = [int(k) for k in np.argsort(-self.gap) if not self.gap[k] <= self.tolerance]
        named = ", ".join(f"{self.names[k]} {self.gap[k]:.1e}" for k in order[:MOST_NAMED])
        more = f" and {len(order) - MOST_NAMED} more" if len(order) > MOST_NAMED else ""
        return f"{self.quantity} differs at {named}{more}" if len(order) > 1 else ""


def differences(aligned: Aligned) -> Iterator[Difference]:
    """Differences of each quantity of the models, in the bodies' frames, wherever the bodies start.

    Points of joints count as far as their kinds tell them, and axes as lines.
    """
    first, second = aligned.both
    a, b = first.mechanism, second.mechanism
    bodies, pairs = a.body_names[1:], list(zip(a.bodies[1:], b.bodies[1:], strict=True))
    length = ROUND_OFF * reach(first, initial_state(first).position)
    masses = [abs(two.mass - one.mass) / one.mass for one, two in pairs]
    yield Difference("mass, rel", np.array(masses), ROUND_OFF, bodies)
    yield Difference("center of mass, m", np.linalg.norm(aligned.centers[1:], axis=1), length, bodies)
    inertias = [inertia_apart(one.inertia, two.inertia) for one, two in pairs]
    yield Difference("inertia, rel", np.array(inertias), ROUND_OFF, bodies)
    if joints := tuple(aligned.joints):
        axes, points = np.array([_joint_apart(aligned, name) for name in joints]).T
        yield Difference("joint axes, rad", axes, ROUND_OFF, joints)
        yield Difference("joint points, m", points, length, joints)
    if coupled := dict(_couplings_apart(aligned)):
        yield Difference("couplings, rel", np.array(list(coupled.values())), ROUND_OFF, tuple(coupled))


def _model(aligned: Aligned, pair: Pair, first: Samples, second: Samples) -> Iterator[Figure]:
    """The largest of each of the `differences`, and how many joints are of other kinds, which the levels
    after this have to judge: a ball closes a plane loop as a hinge does."""
    yield bodies_row(pair, aligned)
    other = [name for name in aligned.joints if not _same_kind(aligned, name)]
    yield Figure(
        "model", "joints of another kind", pair, float(len(other)), 0.5, ", ".join(other), informs=True
    )
    for quantity, gap, tolerance, names in differences(aligned):
        yield worst_figure("model", quantity, pair, gap, tolerance, names)


def _joint_apart(aligned: Aligned, name: str) -> tuple[float, float]:
    """The angle between a joint's axes, rad, and the distance of its points, m; the larger on its bodies."""
    first, second = aligned.both
    one, two = aligned.joint_pair(name)
    angle = distance = 0.0
    for body in (one.first, one.second):
        k = first.mechanism.body_index(body)
        here, there = carried(first.mechanism.bodies[k], one), carried(second.mechanism.bodies[k], two)
        there = there.turned(np.eye(3), aligned.centers[k])
        angle, distance = max(angle, axes_apart(here, there)), max(distance, points_apart(here, there))
    return angle, distance


def _same_kind(aligned: Aligned, name: str) -> bool:
    one, two = aligned.joint_pair(name)
    kinds = [sorted(motion.kind for motion in joint.motions) for joint in (one, two)]
    return kinds[0] == kinds[1] and one.only_closes == two.only_closes


def _couplings_apart(aligned: Aligned) -> Iterator[tuple[str, float]]:
    """Differences of each gear, screw and motion, whatever both are multiplied by; 1 without partner."""
    first, second = aligned.both
    there = list(couplings(second))
    for coupling in couplings(first):
        pairs = [(key, aligned.coordinates[key]) for key in coupling.factors if key in aligned.coordinates]
        keys = {partner.key for _, partner in pairs}
        other = next((other for other in there if keys == set(other.factors)), None)
        if other is None or len(pairs) < len(coupling.factors):
            yield coupling.name, 1.0
            continue
        there.remove(other)
        one = np.array([coupling.factors[key] for key, _ in pairs])
        two = np.array([partner.sense * other.factors[partner.key] for _, partner in pairs])
        scale = float(one @ two / (two @ two))
        apart = float(np.max(np.abs(one - scale * two)) / np.max(np.abs(one)))
        yield coupling.name, max(apart, functions_apart(first, coupling, other, scale))
    for coupling in there:
        yield coupling.name, 1.0


def functions_apart(scene: Scene, one: Coupling, two: Coupling, scale: float) -> float:
    """Difference of functions of time, the second `scale` times, from where they begin, relative to how far
    they go."""
    if one.function is None or two.function is None:
        return float(one.function is not two.function)
    a, b = (np.array([f.value(t) - f.value(0.0) for t in scene.times]) for f in (one.function, two.function))
    return float(np.max(np.abs(scale * b - a)) / max(float(np.max(np.abs(a))), 1e-12))


def _start(aligned: Aligned, pair: Pair, first: Samples, second: Samples) -> Iterator[Figure]:
    """Compare starting poses and velocities of bodies; tolerances are round-off times the condition of
    the constraints, which starts are assembled by."""
    scene, share = aligned.first, round_off(first.condition)
    here, there = (initial_state(each) for each in aligned.both)
    # where the first's center of mass is on the second's body
    turns = [rotation(p) for p in there.quaternion]
    arms = np.array([-turn @ center for turn, center in zip(turns, aligned.centers, strict=True)])
    length = scene.mechanism.size
    speeds = here.linear_velocity, length * here.angular_velocity
    unit = max(length, *(float(np.max(np.abs(speed))) for speed in speeds))
    position = there.position + arms - here.position
    velocity = there.linear_velocity + np.cross(there.angular_velocity, arms) - here.linear_velocity
    spin = there.angular_velocity - here.angular_velocity
    for quantity, gap, tolerance in (
        ("positions, m", np.linalg.norm(position, axis=1), share * reach(scene, here.position)),
        ("orientations, rad", angle_between(here.quaternion, there.quaternion), share),
        ("velocities, rel", np.linalg.norm(velocity, axis=1) / unit, share),
        ("angular velocities, rel", np.linalg.norm(spin, axis=1) * length / unit, share),
    ):
        yield worst_figure(START, quantity, pair, gap, tolerance, scene.mechanism.body_names)


def _kinematics(aligned: Aligned, pair: Pair, first: Samples, second: Samples) -> Iterator[Figure]:
    """As between engines; what fails is blamed on the joint of either model that the other opens, if it can
    be on one of another kind or that one model has alone.

    On two where nothing tells which is meant: where hinges and balls of a loop change places, an axis that is
    off is in neither model the other's.
    """
    here, there = (scene.mechanism.joint_names for scene in aligned.both)
    alone = {*here, *there} - {*aligned.joints, *aligned.joints.values()}
    suspects = alone | {name for name in aligned.joints if not _same_kind(aligned, name)}

    @cache
    def opened_by_first() -> str | None:
        states = States(second.system.scene, first.states.all)
        found = kinematic_cause(*(Samples(samples.system, states) for samples in (second, first)))
        return aligned.joint_names.get(found, found) if found else None

    for row in kinematics_rows(pair, first, second):
        if not row.agrees:
            causes = dict.fromkeys(
                filter(None, [row.where if row.where in here else None, opened_by_first()])
            )
            named = [cause for cause in causes if cause in suspects] or list(causes) or [row.where]
            row = replace(row, where=" or ".join(named))
        yield row


def _dynamics(aligned: Aligned, pair: Pair, first: Samples, second: Samples) -> Iterator[Figure]:
    """Gravity, rotors, what acts at joints and on bodies, each blamed on itself; energies, effective inertia
    and force after them. Tolerances are round-off times the condition of the constraints."""
    share = round_off(max(first.condition, second.condition), first.states.noise)
    scales, states, failed = first.scales, first.states.all, list[str]()

    def noted(quantity: str, gaps: Mapping[str, float]) -> Figure:
        found = worst_figure("dynamics", quantity, pair, np.array(list(gaps.values())), share, tuple(gaps))
        failed.extend([] if found.agrees else [found.where])
        return found

    one, two = (scene.gravity for scene in aligned.both)
    strength = max(float(np.linalg.norm(one)), float(np.linalg.norm(two))) or 1.0
    yield noted("gravity, rel", {"gravity": float(np.linalg.norm(two - one)) / strength})
    for quantity, members in ACTING.items():
        here, there = (_at_joints(scene, members(scene), states, scales.size) for scene in aligned.both)
        there = _in_first(aligned, there)
        if here or there:
            largest = max(float(np.max(np.abs(values))) for values in (*here.values(), *there.values()))
            unit = (largest or 1.0) if quantity == ROTORS else max(scales.force, largest)
            gaps, nothing = dict[str, float](), np.zeros(1)
            for key in dict.fromkeys([*here, *there]):
                gap = np.abs(there.get(key, nothing) - here.get(key, nothing))
                gaps[key[0]] = max(gaps.get(key[0], 0.0), float(gap.max()) / unit)
            yield noted(quantity, gaps)
    wrenches = np.array([_on_bodies(scene, states, scales.size) for scene in aligned.both])
    if np.any(wrenches):
        unit = max(scales.force, float(np.max(np.abs(wrenches))))
        gap = np.abs(wrenches[1] - wrenches[0]).max(axis=(0, 2)) / unit
        yield noted("forces on bodies, rel", dict(zip(aligned.first.mechanism.body_names, gap, strict=True)))
    yield from motion_rows(pair, first, second, lambda _: failed[0] if failed else None)


def _at_joints(
    scene: Scene, acting: Iterable[Acting], states: Sequence[State], size: float
) -> dict[Key, Array]:
    """Sum the forces of some elements at n states along joint coordinates, or about the axes of a `BALL`.

    Returns:
        (n, 1) or (n, 3) by coordinate, N, and N m over the size; of rotors the momentum, N s.
    """
    found, mechanism = dict[Key, Array](), scene.mechanism
    places = [surroundings(scene, state) for state in states]
    for element in acting:
        slides = not element.on_ball and mechanism.is_slide(*element.key)
        values = np.array([np.atleast_1d(element.at_joint(at)) for at in places]) / (1.0 if slides else size)
        found[element.key] = found.get(element.key, 0.0) + values
    return found


def _in_first(aligned: Aligned, found: Mapping[Key, Array]) -> dict[Key, Array]:
    """Express forces along the second model's coordinates along those of the first; others keep their own."""
    ways = {partner.key: (key, partner.sense) for key, partner in aligned.coordinates.items()}
    for name, other in aligned.joints.items():
        one, two = aligned.joint_pair(name)
        ways[other, BALL] = (name, BALL), 1.0 if one.second == two.second else -1.0
    return {ways.get(key, (key, 1.0))[0]: ways.get(key, (key, 1.0))[1] * x for key, x in found.items()}


def _on_bodies(scene: Scene, states: Iterable[State], size: float) -> Array:
    """(n, b, 6) N, and N m over the size, of springs between points and wrenches; none on the ground."""
    without = replace(scene, forces=tuple(force for force in scene.forces if not force.on_ball))
    found = np.array([body_wrenches(without, surroundings(without, state)) for state in states])
    found[:, 0] = 0.0
    found[..., 3:] /= size
    return found
