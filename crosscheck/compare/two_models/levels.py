"""Levels at which two models are compared: their own numbers, where they start, and the levels of engines.

Each takes the two models as engines that have the first's bodies, see `crosscheck.compare.levels`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from crosscheck.compare.accelerations import acceleration_rows
from crosscheck.compare.attribution import Cause
from crosscheck.compare.check import (
    ROUND_OFF,
    START,
    Check,
    both_values,
    reach,
    round_off,
    worst_check,
)
from crosscheck.compare.dynamics import motion_rows
from crosscheck.compare.kinematics import kinematics_rows
from crosscheck.compare.levels import Level
from crosscheck.compare.samples import Samples, States
from crosscheck.compare.two_models.align import Aligned, Partner, axes
from newton_euler.equations.applied_forces import applied_wrenches, surroundings
from newton_euler.equations.couplings import Coupling, couplings
from newton_euler.equations.dense import orthonormal_range
from newton_euler.equations.undetermined import undetermined_in_both
from newton_euler.model.constraints import Frame
from newton_euler.model.control import ControlLaw
from newton_euler.model.couplings import MAX_DEGREE
from newton_euler.model.digital_control import Law
from newton_euler.model.elements import OnBall, OnCoordinate
from newton_euler.model.euler_parameters import angle_between, rotation, rotations
from newton_euler.model.forces import Armature, BallArmature, BallSpring, JointSpring
from newton_euler.model.joint import JointEquations, Key
from newton_euler.model.motions import TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array

MOST_NAMED = 4
"""Bodies or joints that differ and are named, the worst first."""

ROTORS = "rotor momentum, rel"

Acting = Law | Armature | BallArmature | JointSpring | BallSpring
"""An element at a joint."""

ACTING: Mapping[str, Callable[[Scene], Iterable[Acting]]] = {
    ROTORS: lambda scene: scene.armatures,
    "actuator force, rel": lambda scene: scene.control,
    "spring force, rel": lambda scene: [f for f in scene.forces if isinstance(f, OnCoordinate | OnBall)],
}
"""Elements that act at joints, by the quantity that they are compared in."""


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
        states = [(state, self.aligned.in_second(state)) for state in self.all]
        return [np.hstack([undetermined_in_both(first, second, joints, both), columns]) for both in states]


def _shared(samples: Samples) -> SharedStates:
    assert isinstance(samples.states, SharedStates)
    return samples.states


class Difference(NamedTuple):
    """One quantity of the models, for each body, joint or coupling."""

    quantity: str
    values: Array
    """(n,)."""
    tolerance: float
    names: Sequence[str]
    both: Callable[[int], tuple[ArrayLike, ArrayLike, str] | None] = lambda number: None
    """Returns the values of the first and the second model, and their unit."""

    @property
    def larger(self) -> list[int]:
        """Numbers of those above the tolerance, the largest first."""
        return [int(k) for k in np.argsort(-self.values) if not self.values[k] <= self.tolerance]

    def figure(self, level: str, pair: tuple[str, str]) -> Check:
        """The largest difference, with all that differ named."""
        larger = self.larger
        found = worst_check(level, self.quantity, pair, self.values, self.tolerance, self.names)
        if larger and (both := self.both(larger[0])):
            found = replace(found, detail=both_values(pair, *both))
        if len(larger) < 2:
            return found
        named = ", ".join(self.names[k] for k in larger[:MOST_NAMED])
        more = f" and {len(larger) - MOST_NAMED} more" if len(larger) > MOST_NAMED else ""
        return replace(found, where=f"{named}{more}")

    @property
    def worst(self) -> str:
        """Name of the largest."""
        return self.names[int(np.argmax(self.values))]


def bodies_row(pair: tuple[str, str], aligned: Aligned) -> Check:
    """Count the bodies that have no partner."""
    alone = [name for names in aligned.alone for name in names]
    return Check("model", "bodies without partner", pair, float(len(alone)), 0.5, ", ".join(alone))


def differences(states: SharedStates) -> Iterator[Difference]:
    """Differences of bodies in their frames, of joints where the first's are closed, and of couplings."""
    aligned, first = states.aligned, states.scene
    names = first.mechanism.body_names[1:]
    pairs = list(zip(*(scene.mechanism.bodies[1:] for scene in aligned.both), strict=True))
    masses = [abs(two.mass - one.mass) / one.mass for one, two in pairs]
    inertias = [np.max(np.abs(two.inertia - one.inertia)) / np.max(np.abs(one.inertia)) for one, two in pairs]
    length = ROUND_OFF * reach(first, initial_state(first).position)

    def of_bodies(attribute: str, unit: str) -> Callable[[int], tuple[ArrayLike, ArrayLike, str]]:
        return lambda k: (*(getattr(body, attribute) for body in pairs[k]), unit)

    apart = np.linalg.norm(aligned.centers[1:], axis=1)
    yield Difference("mass, rel", np.array(masses), ROUND_OFF, names, of_bodies("mass", "kg"))
    yield Difference("center of mass, m", apart, length, names, lambda k: _centers(aligned, names[k]))
    yield Difference("inertia, rel", np.array(inertias), ROUND_OFF, names, of_bodies("inertia", "kg m^2"))
    if joints := [aligned.joint_names.get(name, name) for name in aligned.both[1].mechanism.joint_names]:
        lengths, angles, freedoms = joint_differences(states)
        share = round_off(states.condition, states.noise) + states.condition * states.closure_error
        far = max(reach(first, state.position) for state in states.all)
        of_axes, of_points = (lambda k: _axes(aligned, joints[k])), (lambda k: _points(aligned, joints[k]))
        yield Difference("joint constraint violation, rad", angles, share, joints, of_axes)
        yield Difference("joint constraint violation, m", lengths, share * far, joints, of_points)
        yield Difference("joint Jacobians, rel", freedoms, share, joints)
    if coupled := dict(_couplings_apart(aligned)):
        yield Difference("couplings, rel", np.array(list(coupled.values())), ROUND_OFF, tuple(coupled))


def _arms(aligned: Aligned, body: str) -> tuple[dict[str, Array], dict[str, Array]]:
    """Points (3,) of joints that both models have on a body, from its centers of mass, in its frame, m."""
    first, second = (scene.mechanism for scene in aligned.both)
    found: tuple[dict[str, Array], dict[str, Array]] = {}, {}
    for name, other in aligned.joints.items():
        for arms, mechanism, joint in zip(
            found, (first, second), (first.joint(name), second.joint(other)), strict=True
        ):
            if body in (joint.first, joint.second):
                point = joint.point if joint.first == body else joint.reaction_point
                arms[name] = mechanism.body(body).pose.point_to_body(point)
    return found


def _centers(aligned: Aligned, body: str) -> tuple[ArrayLike, ArrayLike, str] | None:
    """Centers of mass of a body of both models, from one of its joints, in the first's body frame."""
    here, there = _arms(aligned, body)
    joint = next(iter(here), None)
    return (-here[joint], -there[joint], f"m from {joint}") if joint else None


def _points(aligned: Aligned, name: str) -> tuple[ArrayLike, ArrayLike, str] | None:
    """Points of a joint of both models, from another joint of one body, in the first's body frame."""
    found = []
    joint = aligned.first.mechanism.joint(name) if name in aligned.joints else None
    for body in (joint.first, joint.second) if joint else ():
        here, there = _arms(aligned, body)
        for other in [other for other in here if other != name][:1]:
            values = here[name] - here[other], there[name] - there[other]
            found.append((*values, f"m from {other} on {body}"))
    return max(found, key=lambda both: float(np.linalg.norm(both[1] - both[0])), default=None)


def _axes(aligned: Aligned, name: str) -> tuple[ArrayLike, ArrayLike, str] | None:
    """Axes of a joint of both models, in the first's frame of the body in which they differ more."""
    found = []
    for (joint, k), partner in aligned.coordinates.items():
        if joint == name:
            one, two = aligned.joint_pair(name)
            first, second = (scene.mechanism for scene in aligned.both)
            (_, here), (_, there) = [*axes(first, one, one)][k], [*axes(second, two, one)][partner.key[1]]
            for body, a, b in zip((one.first, one.second), here, there, strict=True):
                found.append((a, b if a @ b > 0.0 else -b, f"in {body}"))
    return max(found, key=lambda both: float(np.linalg.norm(both[1] - both[0])), default=None)


def joint_differences(states: SharedStates) -> Array:
    """(3, j) residuals of the second's joints where the first's are closed, m and rad, and differences of the
    wrenches of two joints of one kind, relative.

    A joint that holds and has the same wrenches wherever the first model moves is the same, whatever its
    point and its directions are.
    """
    aligned, size = states.aligned, states.scene.mechanism.size
    own, mechanism = (scene.mechanism for scene in aligned.both)
    found, names = np.zeros((3, len(mechanism.joints))), aligned.joint_names
    alike = {other: name for other, name in names.items() if aligned.same_kind(name)}
    for state in states.all:
        arms = (rotations(state.quaternion) @ aligned.centers[:, :, None])[:, :, 0]
        here, there = state.frames(), replace(state, position=state.position + arms).frames()
        for n, equations in enumerate(mechanism.equations):
            phi = np.abs(equations.phi(there[equations.first], there[equations.second]))
            lengths, angles = phi[equations.is_length], phi[~equations.is_length]
            other = 0.0
            if (joint := equations.joint.name) in alike:
                one = _reactions(own.joint_equations(alike[joint]), here, 0.0 * arms, size)
                two = _reactions(equations, there, arms, size)
                other = np.max(np.abs(two @ two.T - one @ one.T))
            now = np.max(lengths, initial=0.0), np.max(angles, initial=0.0), other
            found[:, n] = np.maximum(found[:, n], now)
    return found


def _reactions(equations: JointEquations, frames: Sequence[Frame], arms: Array, size: float) -> Array:
    """(12, r) orthonormal wrenches of a joint on its two bodies, torques over the size, N.

    Torques are about points from which `arms` (b, 3), m, lead to the centers of mass.
    """
    first, second = equations.first, equations.second
    r_i, theta_i, r_j, theta_j = equations.jacobian(frames[first], frames[second])
    parts = [
        np.hstack([r, (theta + np.cross(arms[body], r)) / size])
        for body, r, theta in sorted(((first, r_i, theta_i), (second, r_j, theta_j)), key=itemgetter(0))
    ]
    return orthonormal_range(np.hstack(parts).T)


def model_rows(pair: tuple[str, str], first: Samples, second: Samples) -> Iterator[Check]:
    """The largest of each of the `differences`, and how many joints are of other kinds, which the levels
    after this have to judge: a ball closes a plane loop as a hinge does."""
    states, aligned = _shared(first), _shared(first).aligned
    yield bodies_row(pair, aligned)
    other = [name for name in aligned.joints if not aligned.same_kind(name)]
    yield Check(
        "model", "joints of another kind", pair, float(len(other)), 0.5, ", ".join(other), judged=False
    )
    for difference in differences(states):
        yield difference.figure("model", pair)


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
        starts = [aligned.at_start[key] for key, _ in pairs]
        one = _expanded(coupling, [(key, x, 1.0) for (key, _), (x, _) in zip(pairs, starts, strict=True)])
        two = _expanded(other, [(p.key, x, p.sense) for (_, p), (_, x) in zip(pairs, starts, strict=True)])
        scale = float(one @ two / (two @ two))
        apart = float(np.max(np.abs(one - scale * two)) / np.max(np.abs(one)))
        yield coupling.name, max(apart, functions_apart(first, coupling, other, scale))
    for coupling in there:
        yield coupling.name, 1.0


def _expanded(coupling: Coupling, places: Sequence[tuple[Key, float, float]]) -> Array:
    """Coefficients of a coupling in displacements u of its coordinates from zero + sense u.

    Those of the powers 1 to `MAX_DEGREE` of each coordinate, one coordinate after the other; constants are
    left out.
    """
    found = np.zeros((len(places), MAX_DEGREE + 1))
    for row, (key, zero, sense) in zip(found, places, strict=True):
        own = np.polynomial.Polynomial((0.0, coupling.factors[key], *coupling.powers.get(key, ())))
        moved = own(np.polynomial.Polynomial((zero, sense))).coef
        row[: len(moved)] = moved
    return found[:, 1:].ravel()


def functions_apart(scene: Scene, one: Coupling, two: Coupling, scale: float) -> float:
    """Difference of functions of time, the second `scale` times, from where they begin, relative to how far
    they go."""
    if one.function is None or two.function is None:
        return float(one.function is not two.function)
    a, b = (np.array([f.value(t) - f.value(0.0) for t in scene.times]) for f in (one.function, two.function))
    return float(np.max(np.abs(scale * b - a)) / max(float(np.max(np.abs(a))), 1e-12))


def start_rows(pair: tuple[str, str], first: Samples, second: Samples) -> Iterator[Check]:
    """Compare starting poses and velocities of bodies; tolerances are round-off times the condition of
    the constraints, which starts are assembled by."""
    states = _shared(first)
    scene, share = states.scene, round_off(first.condition)
    here, there = (initial_state(each) for each in states.aligned.both)
    # where the first's center of mass is on the second's body
    turns = [rotation(p) for p in there.quaternion]
    arms = np.array([-turn @ center for turn, center in zip(turns, states.aligned.centers, strict=True)])
    length = scene.mechanism.size
    speeds = here.linear_velocity, length * here.angular_velocity
    unit = max(length, *(float(np.max(np.abs(speed))) for speed in speeds))
    position = there.position + arms - here.position
    velocity = there.linear_velocity + np.cross(there.angular_velocity, arms) - here.linear_velocity
    spin = there.angular_velocity - here.angular_velocity
    for quantity, values, tolerance in (
        ("positions, m", np.linalg.norm(position, axis=1), share * reach(scene, here.position)),
        ("orientations, rad", angle_between(here.quaternion, there.quaternion), share),
        ("velocities, rel", np.linalg.norm(velocity, axis=1) / unit, share),
        ("angular velocities, rel", np.linalg.norm(spin, axis=1) * length / unit, share),
    ):
        yield worst_check(START, quantity, pair, values, tolerance, scene.mechanism.body_names)


def term_rows(pair: tuple[str, str], first: Samples, second: Samples) -> Iterator[Check]:
    """Gravity, rotors, what acts at joints and on bodies, each blamed on itself; energies, effective inertia
    and force after them. Tolerances are round-off times the condition of the constraints."""
    aligned, states = _shared(first).aligned, first.states.all
    in_second = [aligned.in_second(state) for state in states]
    share = round_off(max(first.condition, second.condition), first.states.noise)
    scales, failed = first.scales, list[Cause]()

    def term(quantity: str, values: Mapping[str, float], of_both: Callable[[str], str]) -> Check:
        found = Difference(quantity, np.array(list(values.values())), share, tuple(values))
        row = found.figure("dynamics", pair)
        if not row.agrees:
            row = replace(row, detail=of_both(found.worst))
            failed.append(Cause(row.where, row.detail))
        return row

    one, two = (scene.gravity for scene in aligned.both)
    strength = max(float(np.linalg.norm(one)), float(np.linalg.norm(two))) or 1.0
    gravity = {"gravity": float(np.linalg.norm(two - one)) / strength}
    yield term("gravity, rel", gravity, lambda _: both_values(pair, one, two, "m/s^2"))
    for quantity, members in ACTING.items():
        here = _at_joints(first, aligned.both[0], states, members, scales.size, _itself)
        there = _at_joints(second, aligned.both[1], in_second, members, scales.size, aligned.of_first)
        if here or there:
            largest = max(float(np.max(np.abs(values))) for values in (*here.values(), *there.values()))
            unit = (largest or 1.0) if quantity == ROTORS else max(scales.force, largest)
            values, nothing = dict[str, float](), np.zeros(1)
            for key in dict.fromkeys([*here, *there]):
                apart = np.abs(there.get(key, nothing) - here.get(key, nothing))
                values[key[0]] = max(values.get(key[0], 0.0), float(apart.max()) / unit)
            yield term(quantity, values, partial(_elements_apart, pair, aligned, members))
    wrenches = np.array([_on_bodies(scene, states, scales.size) for scene in aligned.both])
    if np.any(wrenches):
        unit = max(scales.force, float(np.max(np.abs(wrenches))))
        apart = np.abs(wrenches[1] - wrenches[0]).max(axis=(0, 2)) / unit
        on_bodies = dict(zip(aligned.first.mechanism.body_names, apart, strict=True))
        yield term("forces on bodies, rel", on_bodies, lambda _: "")
    yield from motion_rows(pair, first, second, lambda _: failed[0] if failed else None)


def _elements_apart(
    pair: tuple[str, str], aligned: Aligned, members: Callable[[Scene], Iterable[Acting]], joint: str
) -> str:
    """Word in which parameters the elements at a joint of the first model and at its partner differ."""
    first, second = aligned.both
    here = {element.key: element for element in members(first) if element.joint == joint}
    others = {aligned.of_first(element.key).key: element for element in members(second)}
    there = {key: element for key, element in others.items() if key[0] == joint}
    said = [
        f"{element.noun} only in {name}"
        for name, own, other in zip(pair, (here, there), (there, here), strict=True)
        for key, element in own.items()
        if key not in other
    ]
    for one, two in ((element, there[key]) for key, element in here.items() if key in there):
        for name in [name for name in one.parameters if name in two.parameters]:
            values = getattr(one, name), getattr(two, name)
            if any(isinstance(value, TimeFunction) for value in values):
                said += [name] if values[0] != values[1] else []
            elif not np.array_equal(*values):
                said.append(f"{name} {both_values(pair, *values, '')}")
    return "; ".join(said)


def _itself(key: Key) -> Partner:
    """Return a coordinate of the first model as its own partner."""
    return Partner(key, 1.0)


def _at_joints(
    samples: Samples,
    scene: Scene,
    states: Iterable[State],
    members: Callable[[Scene], Iterable[Acting]],
    size: float,
    of_first: Callable[[Key], Partner],
) -> dict[Key, Array]:
    """Sum the forces of some elements at n states along the first's coordinates, or about a ball's axes.

    Returns:
        (n, 1) or (n, 3) by coordinate, N, and N m over the size; of rotors the momentum, N s.
    """
    found = dict[Key, Array]()
    places = [surroundings(scene, state) for state in states]
    for number, element in enumerate(members(scene)):
        slides = not element.on_ball and scene.mechanism.is_slide(*element.key)
        if isinstance(element, ControlLaw):  # which may act by a model of the mechanism
            values = samples.stack("actuator_force")[:, number, None]
        else:
            values = np.array([np.atleast_1d(element.at_joint(at)) for at in places])
        values = values / (1.0 if slides else size)
        key, sense = of_first(element.key)
        found[key] = found.get(key, 0.0) + sense * values
    return found


def _on_bodies(scene: Scene, states: Iterable[State], size: float) -> Array:
    """(n, b, 6) N, and N m over the size, of springs between points and wrenches; none on the ground."""
    without = replace(scene, forces=tuple(force for force in scene.forces if not force.on_ball))
    found = np.array([applied_wrenches(without, surroundings(without, state)) for state in states])
    found[:, 0] = 0.0
    found[..., 3:] /= size
    return found


LEVELS: tuple[Level, ...] = (
    model_rows,
    start_rows,
    kinematics_rows,
    term_rows,
    acceleration_rows,
)
"""Functions of the levels of two models, in their order; the levels of runs follow."""
