"""Levels at which two models of one mechanism are compared.

In: the equations of two aligned models (`align.py`) at the same states. Alignment gives the second model the
order, names and frames of the first model's bodies; centers of mass may differ. Out: checks.

The level "model" compares masses, inertias, joints and couplings, "start" the initial states, "dynamics" the
forces element by element. The levels "kinematics" and "accelerations and reactions" are those of the
comparison of engines.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from crosscheck.compare.accelerations import acceleration_checks
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
from crosscheck.compare.dynamics import motion_checks
from crosscheck.compare.kinematics import kinematics_checks
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

MAX_NAMED = 4
"""Largest number of differing bodies or joints that a check names, the worst one first."""

ROTORS = "rotor momentum, rel"
"""Quantity in which armatures (rotor inertias at joints) are compared."""

Acting = Law | Armature | BallArmature | JointSpring | BallSpring
"""Element that acts at a joint: control law, armature or spring."""

ACTING: Mapping[str, Callable[[Scene], Iterable[Acting]]] = {
    ROTORS: lambda scene: scene.armatures,
    "actuator force, rel": lambda scene: scene.control,
    "spring force, rel": lambda scene: [f for f in scene.forces if isinstance(f, OnCoordinate | OnBall)],
}
"""Functions that return the elements of a scene that act at joints, by the quantity of their check."""


@dataclass(frozen=True, eq=False)
class SharedStates(States):
    """States of the first model at which two models are compared.

    Attributes:
        aligned: the alignment of the two models.
    """

    aligned: Aligned

    @cached_property
    def undetermined(self) -> list[Array]:
        """(6 j, r) at each state: combinations of reactions that are not compared.

        They are undetermined in one of the models, or are reactions of a joint without partner.
        """
        first, second = self.aligned.both
        alone = [name not in self.aligned.joints for name in first.mechanism.joint_names]
        columns = np.eye(6 * len(alone))[:, np.repeat(alone, 6)]
        joints = self.aligned.joints
        states = [(state, self.aligned.in_second(state)) for state in self.all]
        return [np.hstack([undetermined_in_both(first, second, joints, both), columns]) for both in states]


def _shared(samples: Samples) -> SharedStates:
    """Return the states of the samples, which have the alignment of the two models."""
    assert isinstance(samples.states, SharedStates)
    return samples.states


class Difference(NamedTuple):
    """Differences of one quantity of two models, for each body, joint or coupling.

    Attributes:
        quantity: compared quantity, with its unit.
        values: (n,) differences of n elements.
        tolerance: largest difference that passes.
        names: names of the n elements.
        both: returns the values in the first and in the second model and their unit, for the element with a
            number; None if there is nothing to show.
    """

    quantity: str
    values: Array
    tolerance: float
    names: Sequence[str]
    both: Callable[[int], tuple[ArrayLike, ArrayLike, str] | None] = lambda number: None

    @property
    def differing(self) -> list[int]:
        """Numbers of the elements whose difference exceeds the tolerance, the largest difference first."""
        return [int(k) for k in np.argsort(-self.values) if not self.values[k] <= self.tolerance]

    def check(self, level: str, pair: tuple[str, str]) -> Check:
        """Make the check of the largest difference; the check names up to `MAX_NAMED` differing elements."""
        differing = self.differing
        found = worst_check(level, self.quantity, pair, self.values, self.tolerance, self.names)
        if differing and (both := self.both(differing[0])):
            found = replace(found, detail=both_values(pair, *both))
        if len(differing) < 2:
            return found
        named = ", ".join(self.names[k] for k in differing[:MAX_NAMED])
        more = f" and {len(differing) - MAX_NAMED} more" if len(differing) > MAX_NAMED else ""
        return replace(found, where=f"{named}{more}")

    @property
    def worst(self) -> str:
        """Name of the element with the largest difference."""
        return self.names[int(np.argmax(self.values))]


def bodies_check(pair: tuple[str, str], aligned: Aligned) -> Check:
    """Make the check of the number of bodies without partner in the other model."""
    alone = [name for names in aligned.alone for name in names]
    return Check("model", "bodies without partner", pair, float(len(alone)), 0.5, ", ".join(alone))


def differences(states: SharedStates) -> Iterator[Difference]:
    """Yield the differences of the two models in bodies, joints and couplings.

    Bodies are compared in their own frames. Joints are compared by the constraint violations of the second
    model in states that satisfy the constraints of the first one.
    """
    # Bodies
    aligned, first = states.aligned, states.scene
    names = first.mechanism.body_names[1:]  # without the ground
    pairs = list(zip(*(scene.mechanism.bodies[1:] for scene in aligned.both), strict=True))
    masses = [abs(two.mass - one.mass) / one.mass for one, two in pairs]
    inertias = [np.max(np.abs(two.inertia - one.inertia)) / np.max(np.abs(one.inertia)) for one, two in pairs]
    length = ROUND_OFF * reach(first, initial_state(first).position)

    def of_bodies(attribute: str, unit: str) -> Callable[[int], tuple[ArrayLike, ArrayLike, str]]:
        return lambda k: (*(getattr(body, attribute) for body in pairs[k]), unit)

    center_distances = np.linalg.norm(aligned.centers[1:], axis=1)
    yield Difference("mass, rel", np.array(masses), ROUND_OFF, names, of_bodies("mass", "kg"))
    yield Difference(
        "center of mass, m", center_distances, length, names, lambda k: _centers(aligned, names[k])
    )
    yield Difference("inertia, rel", np.array(inertias), ROUND_OFF, names, of_bodies("inertia", "kg m^2"))
    # Joints and couplings
    if joints := [aligned.joint_names.get(name, name) for name in aligned.both[1].mechanism.joint_names]:
        lengths, angles, freedoms = joint_differences(states)
        # `noise`: relative error of nearly redundant constraints; `closure_error`: residual of the states
        tolerance = round_off(states.condition, states.noise) + states.condition * states.closure_error
        largest_reach = max(reach(first, state.position) for state in states.all)
        of_axes, of_points = (lambda k: _axes(aligned, joints[k])), (lambda k: _points(aligned, joints[k]))
        yield Difference("joint constraint violation, rad", angles, tolerance, joints, of_axes)
        yield Difference(
            "joint constraint violation, m", lengths, tolerance * largest_reach, joints, of_points
        )
        yield Difference("joint Jacobians, rel", freedoms, tolerance, joints)
    if coupled := dict(_coupling_differences(aligned)):
        yield Difference("couplings, rel", np.array(list(coupled.values())), ROUND_OFF, tuple(coupled))


def _arms(aligned: Aligned, body: str) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the points of paired joints on a body, from its center of mass, in its frame, m.

    Returns:
        Points (3,) by name of the joint in the first model: those of the first model and those of the second.
    """
    first, second = (scene.mechanism for scene in aligned.both)
    found: tuple[dict[str, Array], dict[str, Array]] = {}, {}
    for name, other in aligned.joints.items():
        for arms, mechanism, joint in zip(
            found, (first, second), (first.joint(name), second.joint(other)), strict=True
        ):
            if body in (joint.first, joint.second):
                # `point` is fixed in the first body of the joint, `point_on_second` in the second
                point = joint.point if joint.first == body else joint.point_on_second
                arms[name] = mechanism.body(body).pose.point_to_body(point)
    return found


def _centers(aligned: Aligned, body: str) -> tuple[ArrayLike, ArrayLike, str] | None:
    """Return the center of mass of a body in both models, from one of its joints, and the unit as text.

    None if the body has no paired joint. The components are in the body frame of the first model.
    """
    here, there = _arms(aligned, body)
    joint = next(iter(here), None)
    return (-here[joint], -there[joint], f"m from {joint}") if joint else None


def _points(aligned: Aligned, name: str) -> tuple[ArrayLike, ArrayLike, str] | None:
    """Return the point of a joint in both models, from another joint of the same body, and the unit as text.

    Of the joint's two bodies, the one with the larger difference is shown; None if there is no other joint.
    The components are in the body frame of the first model.
    """
    found = []
    joint = aligned.first.mechanism.joint(name) if name in aligned.joints else None
    for body in (joint.first, joint.second) if joint else ():
        here, there = _arms(aligned, body)
        for other in [other for other in here if other != name][:1]:
            values = here[name] - here[other], there[name] - there[other]
            found.append((*values, f"m from {other} on {body}"))
    return max(found, key=lambda both: float(np.linalg.norm(both[1] - both[0])), default=None)


def _axes(aligned: Aligned, name: str) -> tuple[ArrayLike, ArrayLike, str] | None:
    """Return the axis of a joint in both models, and the name of the body as text.

    Of the joint's axes and two bodies, those with the largest difference are shown; None without an axis. The
    components are in the body frame of the first model.
    """
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
    """Compute differences (3, j) of the j joints of the second model from their partners in the first.

    Row 0 has residuals of length constraints, m, and row 1 those of angle constraints, rad: the constraints
    of the second model in states of the first one. Row 2 has relative differences of the wrenches that two
    joints of the same kind can exert.

    Two joints with the same constraints and wrenches in all states are equal. Their points and axes may be
    given differently, as a hinge point may lie anywhere on its axis.
    """
    aligned, size = states.aligned, states.scene.mechanism.size
    own, mechanism = (scene.mechanism for scene in aligned.both)
    found, names = np.zeros((3, len(mechanism.joints))), aligned.joint_names
    alike = {other: name for other, name in names.items() if aligned.same_kind(name)}
    for state in states.all:
        # Centers of mass of the second model: `arms` from those of the first, `centers` in body frames
        arms = (rotations(state.quaternion) @ aligned.centers[:, :, None])[:, :, 0]
        here, there = state.frames(), replace(state, position=state.position + arms).frames()
        for n, equations in enumerate(mechanism.equations):
            phi = np.abs(equations.phi(there[equations.first], there[equations.second]))
            lengths, angles = phi[equations.is_length], phi[~equations.is_length]
            wrenches = 0.0
            if (joint := equations.joint.name) in alike:
                one = _wrench_basis(own.joint_equations(alike[joint]), here, 0.0 * arms, size)
                two = _wrench_basis(equations, there, arms, size)
                wrenches = np.max(np.abs(two @ two.T - one @ one.T))
            of_state = np.max(lengths, initial=0.0), np.max(angles, initial=0.0), wrenches
            found[:, n] = np.maximum(found[:, n], of_state)
    return found


def _wrench_basis(equations: JointEquations, frames: Sequence[Frame], arms: Array, size: float) -> Array:
    """Return an orthonormal basis (12, r) of the wrenches that a joint can exert on its two bodies.

    Args:
        equations: equations of the joint.
        frames: frames of all bodies.
        arms: (b, 3) centers of mass relative to the points that torques are taken about, m, world frame.
        size: size of the mechanism, m, by which torques are divided.
    """
    first, second = equations.first, equations.second
    r_i, theta_i, r_j, theta_j = equations.jacobian(frames[first], frames[second])
    parts = [
        np.hstack([r, (theta + np.cross(arms[body], r)) / size])
        for body, r, theta in sorted(((first, r_i, theta_i), (second, r_j, theta_j)), key=itemgetter(0))
    ]
    return orthonormal_range(np.hstack(parts).T)


def model_checks(pair: tuple[str, str], first: Samples, second: Samples) -> Iterator[Check]:
    """Make the checks of the level "model": bodies without partner, and the largest of each of `differences`.

    Joints of another kind are counted but not judged, since the motion may be the same: in a planar loop a
    ball joint may replace a hinge. The later levels show whether the motion differs.
    """
    states, aligned = _shared(first), _shared(first).aligned
    yield bodies_check(pair, aligned)
    other = [name for name in aligned.joints if not aligned.same_kind(name)]
    yield Check(
        "model", "joints of another kind", pair, float(len(other)), 0.5, ", ".join(other), judged=False
    )
    for difference in differences(states):
        yield difference.check("model", pair)


def _coupling_differences(aligned: Aligned) -> Iterator[tuple[str, float]]:
    """Yield name and relative difference of each gear, screw and prescribed motion; 1 without partner.

    A coupling is an equation, so two couplings are equal if their coefficients are proportional.
    """
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
        starts = [aligned.at_start[key] for key, _ in pairs]  # values in both models at the same poses
        one = _expanded(coupling, [(key, x, 1.0) for (key, _), (x, _) in zip(pairs, starts, strict=True)])
        two = _expanded(other, [(p.key, x, p.sense) for (_, p), (_, x) in zip(pairs, starts, strict=True)])
        scale = float(one @ two / (two @ two))
        difference = float(np.max(np.abs(one - scale * two)) / np.max(np.abs(one)))
        yield coupling.name, max(difference, functions_apart(first, coupling, other, scale))
    for coupling in there:
        yield coupling.name, 1.0


def _expanded(coupling: Coupling, places: Sequence[tuple[Key, float, float]]) -> Array:
    """Expand a polynomial coupling in displacements u of its coordinates, x = zero + sense u.

    Args:
        coupling: the coupling.
        places: key, zero and sense of each coordinate.

    Returns:
        Coefficients of the powers 1 to `MAX_DEGREE` of u, one coordinate after the other, without constants.
    """
    found = np.zeros((len(places), MAX_DEGREE + 1))
    for row, (key, zero, sense) in zip(found, places, strict=True):
        own = np.polynomial.Polynomial((0.0, coupling.factors[key], *coupling.powers.get(key, ())))
        moved = own(np.polynomial.Polynomial((zero, sense))).coef
        row[: len(moved)] = moved
    return found[:, 1:].ravel()


def functions_apart(scene: Scene, one: Coupling, two: Coupling, scale: float) -> float:
    """Return the relative difference of the prescribed functions of time of two couplings.

    Both functions are measured from their initial values, and the second one is multiplied by `scale`. The
    difference is divided by the largest displacement of the first function. It is 1 if only one coupling has
    a function, and 0 if none has.
    """
    if one.function is None or two.function is None:
        return float(one.function is not two.function)
    a, b = (np.array([f.value(t) - f.value(0.0) for t in scene.times]) for f in (one.function, two.function))
    return float(np.max(np.abs(scale * b - a)) / max(float(np.max(np.abs(a))), 1e-12))


def start_checks(pair: tuple[str, str], first: Samples, second: Samples) -> Iterator[Check]:
    """Compare the initial poses and velocities of the bodies of two models.

    Tolerances are round-off times the condition number of the constraints, since initial states are computed
    by closing loops.
    """
    states = _shared(first)
    scene, rel_tolerance = states.scene, round_off(first.condition)
    here, there = (initial_state(each) for each in states.aligned.both)
    # Compare at the first model's centers of mass: `arms` from those of the second
    turns = [rotation(p) for p in there.quaternion]
    arms = np.array([-turn @ center for turn, center in zip(turns, states.aligned.centers, strict=True)])
    length = scene.mechanism.size
    speeds = here.linear_velocity, length * here.angular_velocity
    # the unit of velocities, m/s: the largest speed, at least one size of the mechanism per second
    unit = max(length, *(float(np.max(np.abs(speed))) for speed in speeds))
    position = there.position + arms - here.position
    velocity = there.linear_velocity + np.cross(there.angular_velocity, arms) - here.linear_velocity
    spin = there.angular_velocity - here.angular_velocity
    for quantity, values, tolerance in (
        ("positions, m", np.linalg.norm(position, axis=1), rel_tolerance * reach(scene, here.position)),
        ("orientations, rad", angle_between(here.quaternion, there.quaternion), rel_tolerance),
        ("velocities, rel", np.linalg.norm(velocity, axis=1) / unit, rel_tolerance),
        ("angular velocities, rel", np.linalg.norm(spin, axis=1) * length / unit, rel_tolerance),
    ):
        yield worst_check(START, quantity, pair, values, tolerance, scene.mechanism.body_names)


def term_checks(pair: tuple[str, str], first: Samples, second: Samples) -> Iterator[Check]:
    """Compare the forces of two models: gravity, elements at joints, forces on bodies, and their sum.

    Energies, effective inertia and effective force follow; if they fail, they are attributed to the first
    element that differs. Tolerances are round-off times the condition number of the constraints.

    Args:
        pair: names of the two models.
        first, second: their equations at the same states.
    """
    aligned, states = _shared(first).aligned, first.states.all
    in_second = [aligned.in_second(state) for state in states]
    tolerance = round_off(max(first.condition, second.condition), first.states.noise)
    scales, failed = first.scales, list[Cause]()

    def term(quantity: str, values: Mapping[str, float], detail: Callable[[str], str]) -> Check:
        """Make the check of the largest of some differences, by name of the joint or body.

        If it fails, `detail` returns a text with the values that differ, for the name.
        """
        found = Difference(quantity, np.array(list(values.values())), tolerance, tuple(values))
        row = found.check("dynamics", pair)
        if not row.agrees:
            row = replace(row, detail=detail(found.worst))
            failed.append(Cause(row.where, row.detail))
        return row

    # Gravity

    one, two = (scene.gravity for scene in aligned.both)
    strength = max(float(np.linalg.norm(one)), float(np.linalg.norm(two))) or 1.0
    gravity = {"gravity": float(np.linalg.norm(two - one)) / strength}
    yield term("gravity, rel", gravity, lambda _: both_values(pair, one, two, "m/s^2"))
    # Elements at joints
    for quantity, members in ACTING.items():
        here = _at_joints(first, aligned.both[0], states, members, scales.size, _itself)
        there = _at_joints(second, aligned.both[1], in_second, members, scales.size, aligned.of_first)
        if here or there:
            largest = max(float(np.max(np.abs(values))) for values in (*here.values(), *there.values()))
            unit = (largest or 1.0) if quantity == ROTORS else max(scales.force, largest)
            values, nothing = dict[str, float](), np.zeros(1)
            for key in dict.fromkeys([*here, *there]):
                difference = np.abs(there.get(key, nothing) - here.get(key, nothing))
                joint = key[0]
                values[joint] = max(values.get(joint, 0.0), float(difference.max()) / unit)
            yield term(quantity, values, partial(_element_differences, pair, aligned, members))
    # Forces on bodies, which depend on poses and velocities but not on the joint angles of `in_second`; then
    # energies, effective inertia and force
    wrenches = np.array([_on_bodies(scene, states, scales.size) for scene in aligned.both])
    if np.any(wrenches):
        unit = max(scales.force, float(np.max(np.abs(wrenches))))
        difference = np.abs(wrenches[1] - wrenches[0]).max(axis=(0, 2)) / unit
        on_bodies = dict(zip(aligned.first.mechanism.body_names, difference, strict=True))
        yield term("forces on bodies, rel", on_bodies, lambda _: "")
    yield from motion_checks(pair, first, second, lambda _: failed[0] if failed else None)


def _element_differences(
    pair: tuple[str, str], aligned: Aligned, members: Callable[[Scene], Iterable[Acting]], joint: str
) -> str:
    """Format the parameters in which the elements at a joint differ between the two models.

    Args:
        pair: names of the two models.
        aligned: their alignment.
        members: returns the elements of a scene that are compared.
        joint: name of the joint in the first model.
    """
    # Elements at the joint in each model, by the coordinate of the first model
    first, second = aligned.both
    here = {element.key: element for element in members(first) if element.joint == joint}
    others = {aligned.of_first(element.key).key: element for element in members(second)}
    there = {key: element for key, element in others.items() if key[0] == joint}
    texts = [
        f"{element.noun} only in {name}"
        for name, own, other in zip(pair, (here, there), (there, here), strict=True)
        for key, element in own.items()
        if key not in other
    ]
    for one, two in ((element, there[key]) for key, element in here.items() if key in there):
        for name in [name for name in one.parameters if name in two.parameters]:
            values = getattr(one, name), getattr(two, name)
            if any(isinstance(value, TimeFunction) for value in values):
                texts += [name] if values[0] != values[1] else []
            elif not np.array_equal(*values):
                texts.append(f"{name} {both_values(pair, *values, '')}")
    return "; ".join(texts)


def _itself(key: Key) -> Partner:
    """Return a joint coordinate of the first model as its own partner."""
    return Partner(key, 1.0)


def _at_joints(
    samples: Samples,
    scene: Scene,
    states: Iterable[State],
    members: Callable[[Scene], Iterable[Acting]],
    size: float,
    of_first: Callable[[Key], Partner],
) -> dict[Key, Array]:
    """Sum the forces of some elements at n states along the joint coordinates of the first model.

    Args:
        samples: equations of the model.
        scene: the model.
        states: states, with angles as this model counts them.
        members: returns the elements of a scene that are compared.
        size: size of the mechanism, m, by which torques are divided.
        of_first: returns the partner in the first model of a coordinate of this model.

    Returns:
        Arrays (n, 1) for a coordinate or (n, 3) for a ball joint, by coordinate: forces, N, and torques /
        size. For armatures, momenta, N s, instead of forces.
    """
    found = dict[Key, Array]()
    places = [surroundings(scene, state) for state in states]  # what forces depend on
    for number, element in enumerate(members(scene)):
        slides = not element.on_ball and scene.mechanism.is_slide(*element.key)
        if isinstance(element, ControlLaw):  # the force may depend on a model of the mechanism
            values = samples.stack("actuator_force")[:, number, None]
        else:
            values = np.array([np.atleast_1d(element.at_joint(place)) for place in places])
        values = values / (1.0 if slides else size)
        key, sense = of_first(element.key)
        found[key] = found.get(key, 0.0) + sense * values
    return found


def _on_bodies(scene: Scene, states: Iterable[State], size: float) -> Array:
    """Sum the forces on bodies that do not act at joints, such as wrenches and springs between points.

    Args:
        scene: the model.
        states: n states.
        size: size of the mechanism, m, by which torques are divided.

    Returns:
        (n, b, 6) forces, N, and torques / size; 0 on the ground.
    """
    # `applied_wrenches` omits forces on joint coordinates, but not springs of ball joints
    without = replace(scene, forces=tuple(force for force in scene.forces if not force.on_ball))
    found = np.array([applied_wrenches(without, surroundings(without, state)) for state in states])
    found[:, 0] = 0.0
    found[..., 3:] /= size
    return found


LEVELS: tuple[Level, ...] = (
    model_checks,
    start_checks,
    kinematics_checks,
    term_checks,
    acceleration_checks,
)
"""Functions of the levels of two models, in their order; the levels of runs follow."""
