"""Changes of 10 % of every element of a scene: what a run has to show of it to test it.

What acts as a force (mass, inertia, springs, dampers, rotors, actuators, wrenches) is 1.1 times itself. Of
joints each axis is tilted by 0.1 rad and the point moved by a tenth of the longest body, each in three
directions; factors of gears and pitches of screws are 1.1 times themselves, and prescribed motions go 1.1
times as far.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from newton_euler.armature import Armature, BallArmature
from newton_euler.assemble import assemble
from newton_euler.constraints import Frame, Jacobian
from newton_euler.control import Law, Sampled
from newton_euler.couplings import (
    Coupling,
    Gear,
    JointCoupling,
    LinearCoupling,
    couplings,
    residuals,
)
from newton_euler.errors import MechanismError
from newton_euler.forces import BallSpring, Force, JointSpring, Wrench
from newton_euler.joints import Fixed, Joint, JointEquations, Screw
from newton_euler.mechanism import Mechanism
from newton_euler.motions import Polynomial, PrescribedMotion, Sine, Sum, TimeFunction
from newton_euler.parameters import numbered, parameter_values, with_values
from newton_euler.scalars import Array
from newton_euler.scene import Scene
from newton_euler.tree import SpanningTree

CHANGE = 0.1
"""Relative change of an element; of a joint's axes in rad, of its points in sizes of the longest body."""

MORE = 1.0 + CHANGE

Moments = Sequence[tuple[float, list[Frame]]]
"""Times, s, of a run and where bodies are then."""


@dataclass(frozen=True)
class Change:
    """One change of an element.

    Attributes:
        of: gives a scene with it.
        parameters: names of the parameters that it changes, see `newton_euler.parameters`; None for a change
            of the equations themselves.
        opened: how far the motion of the scene as it is violates the constraints of the changed one, in
            poses that are off by the given lengths (m) and angles (rad): more than 1 where no motion of the
            changed scene is as near as that. 0 where nothing is told.
    """

    of: Callable[[Scene], Scene]
    parameters: tuple[str, ...] | None = None
    opened: Callable[[Moments, float, float], float] = lambda moments, length, angle: 0.0


@dataclass(frozen=True)
class Element:
    """One element of a scene, such as "mass of body 'crank'", and its changes; any of them shows it."""

    name: str
    changes: tuple[Change, ...]


def elements(scene: Scene) -> Iterator[Element]:
    """All elements of a scene that a motion may depend on."""
    for k, body in enumerate(scene.mechanism.bodies[1:], start=1):
        for what in ("mass", "inertia"):
            yield Element(f"{what} of body {body.name!r}", (_of_values(scene, "bodies", k, what),))
    for k, law in enumerate(scene.control):
        if isinstance(law, Sampled):
            change = Change(partial(_with_controller, number=k), ())
        else:
            change = _of_values(scene, "control", k, "stiffness", "damping", "feedforward")
        yield Element(f"actuator {_at(law)}", (change,))
    for k, force in enumerate(scene.forces):
        if isinstance(force, Wrench):
            yield Element(f"wrench {force.name!r}", (_of_values(scene, "forces", k, "force", "torque"),))
            continue
        for what, name in (("spring", "stiffness"), ("damper", "damping")):
            if getattr(force, name):
                yield Element(f"{what} {_at(force)}", (_of_values(scene, "forces", k, name),))
    for k, rotor in enumerate(scene.armatures):
        yield Element(f"rotor {_at(rotor)}", (_of_values(scene, "armatures", k, "inertia"),))
    yield from _constraints(scene)


def _at(element: Law | Force | Armature | BallArmature) -> str:
    if isinstance(element, BallSpring | BallArmature):
        return f"of the ball of joint {element.joint!r}"
    if isinstance(element, Law | JointSpring | Armature):
        coordinate = f", coordinate {element.coordinate}" if element.coordinate else ""
        return f"of joint {element.joint!r}{coordinate}"
    return repr(element.name)


def _of_values(scene: Scene, what: str, number: int, *attributes: str) -> Change:
    """Parameters of one element, `MORE` times themselves."""
    own = parameter_values(scene, [numbered(what, number, attribute) for attribute in attributes])
    values = {name: MORE * value for name, value in own.items()}
    return Change(lambda scene: with_values(scene, values), tuple(values))


def _with_controller(scene: Scene, number: int) -> Scene:
    """A scene with a sampled controller whose force is `MORE` times what it was."""
    law = scene.control[number]
    assert isinstance(law, Sampled)
    own = law.controller
    stronger = replace(law, controller=lambda time, x, x_rate: MORE * own(time, x, x_rate))
    return replace(scene, control=(*scene.control[:number], stronger, *scene.control[number + 1 :]))


def _constraints(scene: Scene) -> Iterator[Element]:
    mechanism, tree = scene.mechanism, {kept.joint for kept in SpanningTree(scene.mechanism).joints}
    loaded = {each.joint for each in (*scene.joint_forces, *scene.armatures, *scene.motions)}
    loaded |= {joint for coupling in mechanism.couplings for joint, _ in coupling.factors()}
    for number, joint in enumerate(mechanism.joints):
        constrains = mechanism.equations[number].count > 0 or joint.name in loaded
        if isinstance(joint, Fixed) or not constrains:
            continue  # where two bodies are one, or not tied, another point or axis changes nothing
        changes = [_of_joint(mechanism, number, each) for each in _moved(joint, CHANGE * mechanism.longest)]
        if isinstance(joint, Screw):
            changes.append(_of_joint(mechanism, number, replace(joint, pitch=MORE * joint.pitch)))
        yield Element(f"{'joint' if number in tree else 'loop'} {joint.name!r}", tuple(changes))
    for number, coupling in enumerate(mechanism.couplings):
        changes = [_of_coupling(scene, number, each) for each in _other_factors(coupling)]
        yield Element(f"{coupling.kind} {coupling.name!r}", tuple(changes))
    for number, motion in enumerate(scene.motions):
        name = f"motion of joint {motion.joint!r}" + f", coordinate {motion.coordinate}" * bool(
            motion.coordinate
        )
        yield Element(name, (_of_motion(scene, number, motion),))


def _moved(joint: Joint, distance: float) -> Iterator[Joint]:
    """A joint with each of its axes tilted and its point moved, each in three directions."""
    for name in (*joint.axis_names, *(("slides", "hinges") if joint.kind == "compound" else ())):
        axes = np.array(getattr(joint, name))
        rows = axes.reshape(-1, 3)
        for k in range(len(rows)):
            for turn in np.eye(3):
                tilted = rows.copy()
                tilted[k] += CHANGE * np.cross(rows[k], turn)
                with suppress(MechanismError):  # of two axes that have to stay perpendicular
                    yield replace(joint, **{name: tilted.reshape(axes.shape)})  # type: ignore[arg-type]
    for step in distance * np.eye(3):
        yield replace(joint, point=joint.point + step, point_on_second=joint.reaction_point + step)


def _of_joint(mechanism: Mechanism, number: int, changed: Joint) -> Change:
    def of(scene: Scene) -> Scene:
        joints = list(scene.mechanism.joints)
        joints[number] = changed
        return _begun(scene, Mechanism(scene.mechanism.bodies, joints, scene.mechanism.couplings))

    def opened(moments: Moments, length: float, angle: float) -> float:
        own = mechanism.equations[number]
        first, second = (mechanism.bodies[k].pose for k in (own.first, own.second))
        equations = changed.attach(own.first, first, own.second, second)
        found = 0.0
        for _, frames in moments:
            ends = frames[own.first], frames[own.second]
            allowed = _allowed(own, equations.jacobian(*ends), length, angle)
            found = max(found, _ratio(equations.phi(*ends), allowed))
        return found

    return Change(of, opened=opened)


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


def _ratio(residuals: Array, allowed: Array) -> float:
    return float(np.max(np.abs(residuals) / allowed, initial=0.0))


def _other_factors(coupling: JointCoupling) -> Iterator[JointCoupling]:
    """A coupling with each of its factors but the first one `MORE` times itself."""
    if isinstance(coupling, Gear):
        yield replace(coupling, ratio=MORE * coupling.ratio)
    elif isinstance(coupling, LinearCoupling):
        for k in range(1, len(coupling.terms)):
            joint, coordinate, factor = coupling.terms[k]
            more = (joint, coordinate, MORE * factor)
            yield replace(coupling, terms=(*coupling.terms[:k], more, *coupling.terms[k + 1 :]))


def _of_coupling(scene: Scene, number: int, changed: JointCoupling) -> Change:
    others = list(scene.mechanism.couplings)
    others[number] = changed

    def of(scene: Scene) -> Scene:
        return _begun(scene, Mechanism(scene.mechanism.bodies, scene.mechanism.joints, others))

    coupled = list(couplings(scene))
    index = len(coupled) - len(others) + number
    coupled[index] = replace(coupled[index], factors=changed.factors())
    return Change(of, opened=partial(_uncoupled, scene.mechanism, coupled, index))


def _of_motion(scene: Scene, number: int, motion: PrescribedMotion) -> Change:
    start = float(motion.function.value(0.0))
    farther = Sum((_times(motion.function, MORE), Polynomial((-CHANGE * start,))))
    motions = list(scene.motions)
    motions[number] = replace(motion, function=farther)

    def of(scene: Scene) -> Scene:
        return _begun(scene, scene.mechanism, tuple(motions))

    coupled = list(couplings(scene))
    coupled[number] = replace(coupled[number], function=farther)
    return Change(of, opened=partial(_uncoupled, scene.mechanism, coupled, number))


def _uncoupled(
    mechanism: Mechanism,
    coupled: Sequence[Coupling],
    index: int,
    moments: Moments,
    length: float,
    angle: float,
) -> float:
    """See `Change.opened`: of one of some couplings."""
    found = 0.0
    for time, frames in moments:
        allowed = 0.0
        for (joint, coordinate), factor in coupled[index].factors.items():
            ends = mechanism.equations[mechanism.joint_index(joint)]
            jacobian = ends.coordinates[coordinate].jacobian(frames[ends.first], frames[ends.second])
            allowed += abs(factor) * float(_allowed(ends, jacobian, length, angle)[0])
        phi, _ = residuals(mechanism, coupled, frames, time)
        found = max(found, _ratio(phi[index], np.array(allowed)))
    return found


def _times(function: TimeFunction, factor: float) -> TimeFunction:
    if isinstance(function, Sum):
        return Sum(tuple(_times(term, factor) for term in function.terms))
    if isinstance(function, Sine):
        return replace(function, amplitude=factor * function.amplitude, offset=factor * function.offset)
    return Polynomial(tuple(factor * c for c in function.coefficients))


def _begun(scene: Scene, mechanism: Mechanism, motions: tuple[PrescribedMotion, ...] | None = None) -> Scene:
    """A scene of another mechanism or with other motions, begun as near to its start as it can be."""
    own = scene.motions if motions is None else motions
    other = replace(scene, mechanism=mechanism, motions=own, initial_state=None)  # type: ignore[arg-type]
    return replace(other, initial_state=assemble(other, scene.initial_state))
