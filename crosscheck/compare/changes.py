"""Changes of 10 % of every element of a scene: what a run has to show of it to test it.

What acts as a force (mass, inertia, springs, dampers, rotors, actuators, wrenches) is 1.1 times itself. A
joint is turned by 0.1 rad and moved by a tenth of the longest body, axes and points together and on both
bodies, so that it closes as before. Factors of gears and pitches of screws are 1.1 times themselves, and
prescribed motions go 1.1 times as far.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from newton_euler.equations.couplings import Coupling, couplings, residuals
from newton_euler.equations.parameters import numbered, parameter_values, with_values
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
"""Relative change of an element; of a joint's axes in rad, of its points in sizes of the longest body."""

MORE = 1.0 + CHANGE

SKEW = np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0)
"""A direction that few axes have."""


class Moment(NamedTuple):
    """A time of a run.

    Attributes:
        time: s.
        frames: of all bodies.
        angles: as of `State.angles`.
    """

    time: float
    frames: list[Frame]
    angles: Mapping[Key, float]


@dataclass(frozen=True)
class Element:
    """One element of a scene, and the change of it.

    Attributes:
        name: kind and name, such as "mass of body 'crank'".
        changed: gives a scene with the change.
        parameters: names of the parameters that it changes, see `newton_euler.equations.parameters`; None for
            a change of the equations themselves.
        violated: by how much poses violate the changed constraints, in what they may where they are off by a
            length (m) and an angle (rad): with more than 1 they are no poses of the changed scene, nor within
            that of any. 0 where nothing is told.
        displaced: the changed joint, where the element is one that nothing acts on but its reaction.
        body: the number of the body whose "mass" or "inertia" it changes.
        shared: True for an element that is the same code in all engines: their agreement tells nothing of it,
            and it is not changed.
    """

    name: str
    changed: Callable[[Scene], Scene]
    parameters: tuple[str, ...] | None = None
    violated: Callable[[Sequence[Moment], float, float], float] = lambda moments, length, angle: 0.0
    displaced: JointEquations | None = None
    body: tuple[int, str] | None = None
    shared: bool = False


def elements(scene: Scene) -> Iterator[Element]:
    """All elements of a scene that a motion may depend on."""
    for k, body in enumerate(scene.mechanism.bodies[1:], start=1):
        for what in ("mass", "inertia"):
            element = _of_values(scene, f"{what} of body {body.name!r}", "bodies", k, what)
            yield replace(element, body=(k, what))
    for field in ("control", "forces", "armatures"):
        for k, acting in enumerate(getattr(scene, field)):
            if isinstance(acting, HeldLaw):
                yield Element(f"actuator {acting.where}", lambda scene: scene, shared=True)
            for what, attributes in acting.strengths.items():
                if any(np.any(getattr(acting, attribute)) for attribute in attributes):
                    yield _of_values(scene, f"{what} {acting.where}", field, k, *attributes)
    yield from _constraints(scene)


def _of_values(scene: Scene, name: str, what: str, number: int, *attributes: str) -> Element:
    """An element whose parameters become `MORE` times themselves."""
    own = parameter_values(scene, [numbered(what, number, attribute) for attribute in attributes])
    values = {parameter: MORE * value for parameter, value in own.items()}
    return Element(name, partial(with_values, values=values), tuple(values))


def _constraints(scene: Scene) -> Iterator[Element]:
    mechanism, tree = scene.mechanism, {kept.joint for kept in SpanningTree(scene.mechanism).joints}
    loaded = {each.joint for each in (*scene.joint_forces, *scene.armatures, *scene.motions)}
    loaded |= {joint for coupling in mechanism.couplings for joint, _ in coupling.factors()}
    for number, joint in enumerate(mechanism.joints):
        constrains = mechanism.equations[number].count > 0 or joint.name in loaded
        if isinstance(joint, Fixed) or not constrains:
            continue  # where two bodies are one, or not tied, another point or axis changes nothing
        name = f"{'joint' if number in tree else 'loop'} {joint.name!r}"
        element = _of_joint(mechanism, name, number, _displaced(joint, CHANGE * mechanism.longest))
        yield replace(element, displaced=None) if joint.name in loaded else element
    for number, coupling in enumerate(mechanism.couplings):
        yield _of_coupling(scene, number, _with_other_factors(coupling))
    for number, motion in enumerate(scene.motions):
        yield _of_motion(scene, number, motion)


def _displaced(joint: Joint, distance: float) -> Joint:
    """A joint turned by `CHANGE` rad and moved by a distance, m, both along `SKEW` and on both bodies."""
    turn = rotation(from_rotation_vector(CHANGE * SKEW))
    names = (*joint.axis_names, *joint.vector_names)
    fields: dict[str, Any] = {name: getattr(joint, name) @ turn.T for name in names}
    if isinstance(joint, Screw):
        fields["pitch"] = MORE * joint.pitch
    point = joint.point + distance * SKEW
    beyond = point + turn @ (joint.reaction_point - joint.point)
    return replace(joint, point=point, point_on_second=beyond, **fields)


def _of_joint(mechanism: Mechanism, name: str, number: int, displaced: Joint) -> Element:
    def changed(scene: Scene) -> Scene:
        joints = list(scene.mechanism.joints)
        joints[number] = displaced
        return _begun(scene, Mechanism(scene.mechanism.bodies, joints, scene.mechanism.couplings))

    own = mechanism.equations[number]
    first, second = (mechanism.bodies[k].pose for k in (own.first, own.second))
    equations = displaced.attach(own.first, first, own.second, second)

    def violated(moments: Sequence[Moment], length: float, angle: float) -> float:
        found = 0.0
        for _, frames, _ in moments:
            ends = frames[own.first], frames[own.second]
            allowed = _allowed(own, equations.jacobian(*ends), length, angle)
            found = max(found, float(np.max(np.abs(equations.phi(*ends)) / allowed, initial=0.0)))
        return found

    return Element(name, changed, violated=violated, displaced=equations)


def _allowed(ends: JointEquations, jacobian: Jacobian, length: float, angle: float) -> Array:
    """(k,) by how much residuals change at most where both bodies move by a length and turn by an angle."""
    by_body = (
        np.linalg.norm(r, axis=1) * length + np.linalg.norm(theta, axis=1) * angle
        for number, r, theta in (
            (ends.first, jacobian.r_first, jacobian.theta_first),
            (ends.second, jacobian.r_second, jacobian.theta_second),
        )
        if number > 0
    )
    return np.sum(list(by_body), axis=0)


def _with_other_factors(coupling: JointCoupling) -> JointCoupling:
    """A coupling with all of its factors but the first one `MORE` times themselves."""
    if isinstance(coupling, Gear):
        return replace(coupling, ratio=MORE * coupling.ratio)
    if isinstance(coupling, PolynomialCoupling):
        return replace(coupling, coefficients=tuple(MORE * c for c in coupling.coefficients))
    assert isinstance(coupling, LinearCoupling)
    first, *others = coupling.terms
    return replace(coupling, terms=(first, *((joint, k, MORE * factor) for joint, k, factor in others)))


def _of_coupling(scene: Scene, number: int, other: JointCoupling) -> Element:
    others = list(scene.mechanism.couplings)
    others[number] = other

    def changed(scene: Scene) -> Scene:
        return _begun(scene, Mechanism(scene.mechanism.bodies, scene.mechanism.joints, others))

    coupled = list(couplings(scene))
    index = len(coupled) - len(others) + number
    coupled[index] = replace(coupled[index], factors=other.factors(), powers=other.powers())
    violated = partial(_uncoupled, scene.mechanism, coupled, index)
    return Element(f"{other.kind} {other.name!r}", changed, violated=violated)


def _of_motion(scene: Scene, number: int, motion: PrescribedMotion) -> Element:
    start = float(motion.function.value(0.0))
    farther = Sum((scaled(motion.function, MORE), Polynomial((-CHANGE * start,))))
    motions = list(scene.motions)
    motions[number] = replace(motion, function=farther)

    def changed(scene: Scene) -> Scene:
        return _begun(scene, scene.mechanism, tuple(motions))

    coupled = list(couplings(scene))
    coupled[number] = replace(coupled[number], function=farther)
    violated = partial(_uncoupled, scene.mechanism, coupled, number)
    return Element(f"motion {motion.where}", changed, violated=violated)


def _uncoupled(
    mechanism: Mechanism,
    coupled: Sequence[Coupling],
    index: int,
    moments: Sequence[Moment],
    length: float,
    angle: float,
) -> float:
    """See `Element.violated`: of one of some couplings."""
    found = 0.0
    for time, frames, angles in moments:
        seen = residuals(mechanism, coupled, frames, time, angles)
        allowed = 0.0
        for (joint, coordinate), slope in seen.slopes[index].items():
            ends = mechanism.joint_equations(joint)
            jacobian = ends.coordinates[coordinate].jacobian(frames[ends.first], frames[ends.second])
            allowed += abs(slope) * float(_allowed(ends, jacobian, length, angle)[0])
        found = max(found, abs(float(seen.phi[index])) / allowed)
    return found


def _begun(scene: Scene, mechanism: Mechanism, motions: tuple[PrescribedMotion, ...] | None = None) -> Scene:
    """A scene of another mechanism or with other motions, begun as near to its start as it can be."""
    own = scene.motions if motions is None else motions
    other = replace(scene, mechanism=mechanism, motions=own, initial_state=None)
    return replace(other, initial_state=assemble(other, initial_state(scene)))
