"""Changes of 10 % of every element of a scene, for the coverage analysis.

In: a scene (a mechanism with its forces, controllers and initial state). Out: an `Element` for each mass,
inertia, joint, spring, actuator and so on, with a function that returns the scene with this element changed.
`coverage.py` compares the motion with and without the change; if the motion is the same, a run does not test
the element.

Masses, inertias, springs, dampers, armatures (rotor inertias), actuators and wrenches become 1.1 times as
large. A joint is rotated by 0.1 rad and moved by a tenth of the longest body, on both of its bodies alike, so
that the joint is still closed. Factors of couplings such as gears, pitches of screws and the displacements of
prescribed motions become 1.1 times as large.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from newton_euler.equations.coupling_equations import residuals
from newton_euler.equations.couplings import Coupling, couplings
from newton_euler.equations.parameter_names import numbered
from newton_euler.equations.parameters import parameter_values, with_values
from newton_euler.model.constraints import Frame, Jacobian
from newton_euler.model.couplings import Gear, JointCoupling, LinearCoupling, PolynomialCoupling
from newton_euler.model.digital_control import HeldLaw
from newton_euler.model.euler_parameters import from_rotation_vector, rotation
from newton_euler.model.joint import Joint, JointEquations, Key
from newton_euler.model.joint_kinds import Fixed, Screw
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.motions import PrescribedMotion, Sum, scaled
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Polynomial
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.runs.assemble import assemble, initial_state
from newton_euler.scalars import Array

CHANGE = 0.1
"""Relative change of an element. Axes of joints are rotated by this angle, rad, and their points are moved by
this fraction of the longest body's length."""

CHANGE_FACTOR = 1.0 + CHANGE
"""Ratio of a changed number to the original one."""

SKEW = np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0)
"""Unit vector in which joints are moved and about which they are rotated: parallel to few axes of models."""


class TimePoint(NamedTuple):
    """Poses of all bodies at one time of a run.

    Attributes:
        time: time, s.
        frames: position and rotation of each body.
        angles: joint angles with their revolutions, as `State.angles`.
    """

    time: float
    frames: list[Frame]
    angles: Mapping[Key, float]


@dataclass(frozen=True)
class Element:
    """One element of a scene, and its change.

    Attributes:
        name: kind and name, such as "mass of body 'crank'".
        changed: returns a scene with the change.
        parameters: names of the changed parameters, see `newton_euler.equations.parameters`; None if the
            equations themselves change (joints, couplings, prescribed motions).
        violation: returns how much the poses of a run violate the changed constraints. Arguments are the time
            points and tolerances of positions, m, and orientations, rad. The violation is divided by the
            largest violation possible within these tolerances, so a result above 1 proves that the changed
            scene moves differently. The result is 0 if no constraint changes.
        displaced: equations of the changed joint, for a bound on the change of the motion from the joint's
            reactions. None if the element is no joint, or if forces, motions or couplings act at the joint.
        body: number of the changed body, and "mass" or "inertia"; None for other elements.
        shared: True for an element whose code is the same in all engines, such as a digital controller. The
            agreement of engines does not test the element, and `changed` returns the scene unchanged.
    """

    name: str
    changed: Callable[[Scene], Scene]
    parameters: tuple[str, ...] | None = None
    violation: Callable[[Sequence[TimePoint], float, float], float] = lambda points, length, angle: 0.0
    displaced: JointEquations | None = None
    body: tuple[int, str] | None = None
    shared: bool = False


def elements(scene: Scene) -> Iterator[Element]:
    """Yield all elements of a scene that a motion may depend on, each with its change."""
    # Mass properties
    for k, body in enumerate(scene.mechanism.bodies[1:], start=1):
        for what in ("mass", "inertia"):
            element = _parameter_element(scene, f"{what} of body {body.name!r}", "bodies", k, what)
            yield replace(element, body=(k, what))
    # Actuators, forces and armatures: one element for each strength, such as "spring" or "damper"
    for field in ("control", "forces", "armatures"):
        for k, force in enumerate(getattr(scene, field)):
            if isinstance(force, HeldLaw):  # a digital controller: all engines call the same code
                yield Element(f"actuator {force.where}", lambda scene: scene, shared=True)
            # `strengths` maps each name to the attributes that scale the force; zero ones are no elements
            for what, attributes in force.strengths.items():
                if any(np.any(getattr(force, attribute)) for attribute in attributes):
                    yield _parameter_element(scene, f"{what} {force.where}", field, k, *attributes)
    yield from _constraint_elements(scene)


def _parameter_element(scene: Scene, name: str, field: str, number: int, *attributes: str) -> Element:
    """Return an element whose parameters are multiplied by `CHANGE_FACTOR`.

    Args:
        scene: the scene.
        name: name of the element.
        field: group of the scene that the element is in, such as "bodies" or "forces".
        number: number of the element in the group.
        attributes: names of the attributes that are the parameters.
    """
    given = parameter_values(scene, [numbered(field, number, attribute) for attribute in attributes])
    values = {parameter: CHANGE_FACTOR * value for parameter, value in given.items()}
    return Element(name, changed=partial(with_values, values=values), parameters=tuple(values))


def _constraint_elements(scene: Scene) -> Iterator[Element]:
    """Yield the elements that are constraints: joints, couplings and prescribed motions."""
    mechanism = scene.mechanism
    in_tree = {tree_joint.joint for tree_joint in SpanningTree(mechanism).joints}  # numbers of joints
    # Joints at which forces, armatures, motions or couplings act
    loaded = {force.joint for force in (*scene.joint_forces, *scene.armatures, *scene.motions)}
    loaded |= {joint for coupling in mechanism.couplings for joint, _ in coupling.factors()}
    for number, joint in enumerate(mechanism.joints):
        constrains = mechanism.equations[number].count > 0 or joint.name in loaded
        if isinstance(joint, Fixed) or not constrains:
            continue  # another point or axis changes nothing between rigidly connected or unconnected bodies
        name = f"{'joint' if number in in_tree else 'loop'} {joint.name!r}"  # "loop": the joint closes one
        element = _joint_element(
            mechanism, name, number, _displaced(joint, CHANGE * mechanism.largest_extent)
        )
        yield replace(element, displaced=None) if joint.name in loaded else element
    for number, coupling in enumerate(mechanism.couplings):
        yield _coupling_element(scene, number, _with_changed_factors(coupling))
    for number, motion in enumerate(scene.motions):
        yield _motion_element(scene, number, motion)


def _displaced(joint: Joint, distance: float) -> Joint:
    """Return a joint rotated by `CHANGE` rad about `SKEW` and moved by a distance, m, along it."""
    turn = rotation(from_rotation_vector(CHANGE * SKEW))
    names = (*joint.axis_names, *joint.vector_names)
    fields: dict[str, Any] = {name: getattr(joint, name) @ turn.T for name in names}
    if isinstance(joint, Screw):
        fields["pitch"] = CHANGE_FACTOR * joint.pitch
    point = joint.point + distance * SKEW
    point_on_second = point + turn @ (joint.point_on_second - joint.point)
    return replace(joint, point=point, point_on_second=point_on_second, **fields)


def _joint_element(mechanism: Mechanism, name: str, number: int, displaced: Joint) -> Element:
    """Return the element of a joint, whose change is another joint in its place.

    Args:
        mechanism: the mechanism.
        name: name of the element.
        number: number of the joint in the mechanism.
        displaced: the other joint.
    """

    def changed(scene: Scene) -> Scene:
        joints = list(scene.mechanism.joints)
        joints[number] = displaced
        return _with_constraints(scene, Mechanism(scene.mechanism.bodies, joints, scene.mechanism.couplings))

    original = mechanism.equations[number]
    first, second = (mechanism.bodies[k].pose for k in (original.first, original.second))
    equations = displaced.attach(original.first, first, original.second, second)

    def violation(points: Sequence[TimePoint], length: float, angle: float) -> float:
        largest = 0.0
        for point in points:
            frames = point.frames[original.first], point.frames[original.second]
            allowed = _allowed_residuals(original, equations.jacobian(*frames), length, angle)
            largest = max(largest, float(np.max(np.abs(equations.phi(*frames)) / allowed, initial=0.0)))
        return largest

    return Element(name, changed, violation=violation, displaced=equations)


def _allowed_residuals(joint: JointEquations, jacobian: Jacobian, length: float, angle: float) -> Array:
    """Return the largest change (k,) of k residuals if both bodies move by a length and turn by an angle.

    Args:
        joint: joint equations with the numbers of both bodies; the ground does not move.
        jacobian: Jacobian of the residuals with respect to the motions of both bodies.
        length, angle: m and rad.
    """
    by_body = (
        np.linalg.norm(r, axis=1) * length + np.linalg.norm(theta, axis=1) * angle
        for number, r, theta in (
            (joint.first, jacobian.r_first, jacobian.theta_first),
            (joint.second, jacobian.r_second, jacobian.theta_second),
        )
        if number > 0  # not the ground
    )
    return np.sum(list(by_body), axis=0)


def _with_changed_factors(coupling: JointCoupling) -> JointCoupling:
    """Return a coupling with all factors but the first one multiplied by `CHANGE_FACTOR`."""
    if isinstance(coupling, Gear):
        return replace(coupling, ratio=CHANGE_FACTOR * coupling.ratio)
    if isinstance(coupling, PolynomialCoupling):
        return replace(coupling, coefficients=tuple(CHANGE_FACTOR * c for c in coupling.coefficients))
    assert isinstance(coupling, LinearCoupling)
    first, *others = coupling.terms
    changed = ((joint, k, CHANGE_FACTOR * factor) for joint, k, factor in others)
    return replace(coupling, terms=(first, *changed))


def _coupling_element(scene: Scene, number: int, other: JointCoupling) -> Element:
    """Return the element of a coupling, whose change is another coupling in its place.

    Args:
        scene: the scene.
        number: number of the coupling in the mechanism.
        other: the other coupling.
    """
    of_mechanism = list(scene.mechanism.couplings)
    of_mechanism[number] = other

    def changed(scene: Scene) -> Scene:
        mechanism = Mechanism(scene.mechanism.bodies, scene.mechanism.joints, of_mechanism)
        return _with_constraints(scene, mechanism)

    # `couplings(scene)` are prescribed motions and screws, then the couplings of the mechanism.
    # `factors` and `powers` are coefficients of x, and of x^2, x^3, ..., by joint coordinate x
    of_scene = list(couplings(scene))
    index = len(of_scene) - len(of_mechanism) + number
    of_scene[index] = replace(of_scene[index], factors=other.factors(), powers=other.powers())
    violation = partial(_coupling_violation, scene.mechanism, of_scene, index)
    return Element(f"{other.kind} {other.name!r}", changed, violation=violation)


def _motion_element(scene: Scene, number: int, motion: PrescribedMotion) -> Element:
    """Return the element of a prescribed motion; the changed motion goes 1.1 times as far from its start.

    Args:
        scene: the scene.
        number: number of the motion in the scene.
        motion: the motion.
    """
    start = float(motion.function.value(0.0))
    # start + 1.1 (f(t) - start) = 1.1 f(t) - 0.1 start
    farther = Sum((scaled(motion.function, CHANGE_FACTOR), Polynomial((-CHANGE * start,))))
    motions = list(scene.motions)
    motions[number] = replace(motion, function=farther)

    def changed(scene: Scene) -> Scene:
        return _with_constraints(scene, scene.mechanism, tuple(motions))

    of_scene = list(couplings(scene))  # prescribed motions come first
    of_scene[number] = replace(of_scene[number], function=farther)
    violation = partial(_coupling_violation, scene.mechanism, of_scene, number)
    return Element(f"motion {motion.where}", changed, violation=violation)


def _coupling_violation(
    mechanism: Mechanism,
    of_scene: Sequence[Coupling],
    index: int,
    points: Sequence[TimePoint],
    length: float,
    angle: float,
) -> float:
    """Compute `Element.violation` of a coupling or prescribed motion.

    Args:
        mechanism: the mechanism.
        of_scene: all couplings and prescribed motions of the scene, the changed one included.
        index: number of the changed one.
        points, length, angle: arguments of `Element.violation`.
    """
    largest = 0.0
    for time, frames, angles in points:
        of_pose = residuals(mechanism, of_scene, frames, time, angles)
        # The residual is a function of joint coordinates; `slopes` has its derivative by each of them
        allowed = 0.0
        for (joint, coordinate), slope in of_pose.slopes[index].items():
            equations = mechanism.joint_equations(joint)
            bodies = frames[equations.first], frames[equations.second]
            jacobian = equations.coordinates[coordinate].jacobian(*bodies)
            allowed += abs(slope) * float(_allowed_residuals(equations, jacobian, length, angle)[0])
        largest = max(largest, abs(float(of_pose.phi[index])) / allowed)
    return largest


def _with_constraints(
    scene: Scene, mechanism: Mechanism, motions: tuple[PrescribedMotion, ...] | None = None
) -> Scene:
    """Return the scene with another mechanism or other motions.

    The initial state is the state nearest to that of the given scene that satisfies the new constraints.
    """
    kept = scene.motions if motions is None else motions
    changed = replace(scene, mechanism=mechanism, motions=kept, initial_state=None)
    return replace(changed, initial_state=assemble(changed, initial_state(scene)))
