"""The body, joint or term that a difference between two engines comes from.

The scene's own equations are the referee. What is right in an engine's model satisfies them wherever the
engine ends up; the one thing that is wrong does not:

- bodies placed by an engine's kinematics, its own loops closed, leave open in the scene's eyes the joint
  that is wrong, or all joints of a body whose frame is wrong;
- accelerations and reactions of an engine violate Newton's and Euler's equations, with the scene's masses
  and forces, of the body whose mass or inertia is wrong, of all bodies as another gravity would, or of the
  two bodies of a joint as another spring or control law there would;
- accelerations that satisfy these equations open the joint whose velocity term is wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from crosscheck.compare.momentum import momentum_residuals
from crosscheck.compare.samples import Samples
from newton_euler.equations.applied_forces import surroundings
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.system import Evaluation
from newton_euler.errors import AssemblyError
from newton_euler.integrators.projection import project_position
from newton_euler.model.balls import SPIN, ends
from newton_euler.model.digital_control import Law
from newton_euler.model.elements import OnBall, OnCoordinate, Surroundings
from newton_euler.model.forces import BallSpring, JointSpring
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.model.state import State
from newton_euler.scalars import Array

ForceAtJoint = Law | JointSpring | BallSpring

MIN_VIOLATION = 1e-11
"""Sizes of the mechanism, rad, and as many a second: what is more is not round-off, see `kinematics`."""

MIN_ACCELERATION_VIOLATION = 1e-9
"""Share of the largest acceleration: round-off of ill-conditioned masses opens joints by less."""

MIN_RESIDUAL_RATIO = 1e-2
"""Residuals below this fraction of the largest one are side effects, such as squares of a small error."""

EXPLAINED = 1e-4
"""Share of all residuals that a cause may leave over: small errors act in proportion, and this is how far."""

UNBALANCED = 1e-10
"""Residual in units of the scene's energy divided by its size, N: round-off at a condition number of 100."""


def kinematic_cause(first: Samples, second: Samples) -> str | None:
    """The joint that one of two systems opens, or the body all of whose joints it opens.

    A joint may be wrong in such a way that its loop cannot move at all; then it shows before the loop is
    closed. None if no joint is open in the scene's eyes: then a system holds what the scene leaves free.
    """
    for look in (_opened, _stuck, _open_closure):
        for samples in (second, first):
            if (found := look(samples)) is not None:
                return found
    return None


def _opened(samples: Samples) -> str | None:
    """The joint that a system opens where it keeps its own closed, or the body whose joints these are."""
    mechanism = samples.states.scene.mechanism
    openings = _openings(samples)
    if not np.max(openings, initial=0.0) > MIN_VIOLATION:
        return None
    opened = np.flatnonzero(openings > MIN_RESIDUAL_RATIO * openings.max())
    ends = [{mechanism.joints[k].first, mechanism.joints[k].second} for k in opened]
    common = set.intersection(*ends) - {mechanism.body_names[0]}
    if len(opened) > 1 and len(common) == 1:
        return common.pop()
    return mechanism.joint_names[int(np.argmax(openings))]


def _openings(samples: Samples) -> Array:
    """(j,) how far, in sizes or rad, a system's own kinematics open each joint, and how fast, in 1/s."""
    system, mechanism = samples.system, samples.states.scene.mechanism
    size = mechanism.size
    found = np.zeros(len(mechanism.joints))
    for (q, v), motion, basis in zip(samples.coordinates, samples.motions, samples.bases, strict=True):
        with suppress(AssemblyError):
            closed = system.state(project_position(system, q), 0.0 * v)
            found = np.maximum(found, _gaps(mechanism, closed))
        frames = motion.frames()
        velocities = basis.reshape(len(frames), 6, -1)
        for k, equations in enumerate(mechanism.equations):
            i, j = equations.first, equations.second
            blocks = equations.jacobian(frames[i], frames[j])
            linear = blocks.r_first @ velocities[i, :3] + blocks.r_second @ velocities[j, :3]
            angular = blocks.theta_first @ velocities[i, 3:] + blocks.theta_second @ velocities[j, 3:]
            rates = np.abs(size * linear + angular) / equations.units(size)[:, None]
            found[k] = max(found[k], float(np.max(rates, initial=0.0)))
    return found


def _gaps(mechanism: Mechanism, state: State) -> Array:
    """(j,) how far a state opens each joint, in sizes or rad."""
    frames, gaps = state.frames(), []
    for equations in mechanism.equations:
        phi = equations.phi(frames[equations.first], frames[equations.second])
        gaps.append(float(np.max(np.abs(phi) / equations.units(mechanism.size), initial=0.0)))
    return np.array(gaps)


def _stuck(samples: Samples) -> str | None:
    """The joint of the tree that is open where a system's coordinates put the bodies.

    Those that close loops are left out: they are open there whichever joint is wrong.
    """
    mechanism = samples.states.scene.mechanism
    gaps = np.max([_gaps(mechanism, motion) for motion in samples.motions], axis=0)
    gaps[list(SpanningTree(mechanism).cuts)] = 0.0
    return mechanism.joint_names[int(np.argmax(gaps))] if np.max(gaps, initial=0.0) > MIN_VIOLATION else None


def _open_closure(samples: Samples) -> str | None:
    """The closure whose two points lie farthest apart in a system's own model, if they do."""
    gaps = {
        name: float(np.linalg.norm(joint.points[1] - joint.points[0]))
        for name, joint in samples.joints.items()
        if joint.kinds == ("ball",) and np.all(np.isfinite(joint.points))
    }
    name = max(gaps, key=lambda name: gaps[name], default="")
    return name if name and gaps[name] > MIN_VIOLATION * samples.states.scene.mechanism.size else None


def accelerated_joint(first: Samples, second: Samples) -> str | None:
    """Find the joint whose constraints the body accelerations of one of two systems violate.

    Accelerations with a wrong velocity term satisfy the equations of motion of bodies and open the joint that
    the term belongs to. None if all joints stay closed.
    """
    mechanism = first.states.scene.mechanism
    for samples in (second, first):
        gaps = np.max([_acceleration_gaps(mechanism, found) for found in samples.evaluations], axis=0)
        if np.max(gaps, initial=0.0) > MIN_ACCELERATION_VIOLATION * samples.scales.acceleration:
            return mechanism.joint_names[int(np.argmax(gaps))]
    return None


def _acceleration_gaps(mechanism: Mechanism, found: Evaluation) -> Array:
    """Compute the violation (j,) of joints by accelerations, m/s^2; angular ones count at the size."""
    frames, linear, angular = found.state.frames(), found.linear_acceleration, found.angular_acceleration
    gaps = []
    for equations in mechanism.equations:
        i, j = equations.first, equations.second
        blocks = equations.jacobian(frames[i], frames[j])
        rate = blocks.r_first @ linear[i] + blocks.r_second @ linear[j]
        rate = rate + blocks.theta_first @ angular[i] + blocks.theta_second @ angular[j]
        gap = (rate - equations.gamma(frames[i], frames[j])) / equations.units(mechanism.size)
        gaps.append(mechanism.size * float(np.max(np.abs(gap), initial=0.0)))
    return np.array(gaps)


class Cause(NamedTuple):
    """Source of a difference.

    Attributes:
        where: a body, a joint or "gravity".
        detail: gravity, or the parameter of a joint's control law or spring, as it is and as it should be.
    """

    where: str
    detail: str = ""


def dynamic_cause(first: Samples, second: Samples, forces: bool = True) -> Cause | None:
    """The body, joint or "gravity" that one of two systems gets wrong in Newton's and Euler's equations.

    A joint if it is what a control law or spring does there, or if accelerations open it while these
    equations hold. None if all joints stay closed, too: then what differs is no force on a body. Without
    `forces` the bodies alone come into question, as where inertia differs.
    """
    scene = first.states.scene
    for samples in (second, first):
        residuals = momentum_residuals(samples)
        largest = np.abs(residuals).max(axis=(0, 2))
        if not largest.max() > UNBALANCED * first.states.energy / scene.mechanism.size:
            continue
        if forces and (other := _other_gravity(scene, residuals)) is not None:
            return Cause("gravity", _instead(other, scene.gravity, "m/s^2"))
        if forces and (found := _at_joint(samples, residuals)):
            return found
        return Cause(scene.mechanism.body_names[1 + int(np.argmax(largest))])
    opened = accelerated_joint(first, second)
    return None if opened is None else Cause(opened)


def _other_gravity(scene: Scene, residuals: Array) -> Array | None:
    """(3,) gravity, m/s^2, that explains residuals (n, b - 1, 6) of several bodies; None if none does."""
    mass = np.array([body.mass for body in scene.mechanism.bodies[1:]])
    other = np.einsum("nbi,b->i", residuals[..., :3], mass) / (len(residuals) * (mass @ mass))
    left = residuals.copy()
    left[..., :3] -= mass[:, None] * other
    explains = np.abs(left).max() < EXPLAINED * np.abs(residuals).max()
    return scene.gravity + other if explains else None


def _at_joint(samples: Samples, residuals: Array) -> Cause | None:
    """The joint whose control law or spring explains residuals (n, b - 1, 6), with the parameter if one does.

    Where the scene has no spring there may be one, which one parameter has to explain.
    """
    scene = samples.states.scene
    taken = {law.key for law in scene.forces if isinstance(law, OnCoordinate)}
    absent = tuple(
        JointSpring(joint.name, coordinate=k)
        for joint in scene.mechanism.joints
        for k in range(len(joint.coordinate_kinds))
        if (joint.name, k) not in taken
    )
    probed = replace(scene, forces=(*scene.forces, *absent))
    equations = Cartesian(probed)
    own = (*scene.joint_forces, *(force for force in scene.forces if isinstance(force, OnBall)))
    for law in (*own, *absent):
        pushes = np.array([_pushes(equations, law, evaluation) for evaluation in samples.evaluations])
        multiples = _multiples(pushes, residuals)
        if multiples is not None:
            places = [surroundings(probed, evaluation.state) for evaluation in samples.evaluations]
            detail = _parameter(law, multiples, places)
            if detail or law in own:
                return Cause(law.joint, detail)
    return None


def _multiples(pushes: Array, residuals: Array) -> Array | None:
    """(n, k) multiples of `pushes` (n, k, b - 1, 6) that explain residuals (n, b - 1, 6), state by state."""
    flat = residuals.reshape(len(residuals), -1)
    left, found = flat.copy(), []
    for rest, pushed in zip(left, pushes.reshape(*pushes.shape[:2], -1), strict=True):
        found.append(np.linalg.lstsq(pushed.T, rest)[0])
        rest -= found[-1] @ pushed
    return np.array(found) if np.abs(left).max() < EXPLAINED * np.abs(flat).max() else None


def _parameter(law: ForceAtJoint, forces: Array, places: Sequence[Surroundings]) -> str:
    """The parameter of a law that alone explains forces (n, k) beside its own, and its value; or nothing.

    Forces that are the same in all states say nothing of what they depend on.
    """
    if np.ptp(forces, axis=0).max() < EXPLAINED * np.abs(forces).max():
        return ""
    own = np.array([np.atleast_1d(law.at_joint(at)) for at in places])
    for name in law.parameters:
        value = getattr(law, name)
        if not isinstance(value, float):
            continue  # functions of time and rests of balls
        more: ForceAtJoint = replace(law, **{name: value + 1.0})  # type: ignore[arg-type]
        change = np.array([np.atleast_1d(more.at_joint(at)) for at in places]) - own
        if not np.any(change):
            continue
        by = float(np.sum(change * forces) / np.sum(change * change))
        if np.abs(forces - by * change).max() < EXPLAINED * np.abs(forces).max():
            return f"{name} {_instead(np.array([value + by]), np.array([value]))}"
    return ""


def _instead(found: Array, own: Array, unit: str = "") -> str:
    """Word numbers (n,) that residuals explain, and the scene's own."""
    known = np.where(np.abs(found) > EXPLAINED * np.abs(found - own).max(), found, 0.0)
    texts = (" ".join(f"{number:.4g}" for number in numbers) for numbers in (known, own))
    return f"{' instead of '.join(texts)} {unit}".rstrip()


def _pushes(equations: Cartesian, law: ForceAtJoint, found: Evaluation) -> Array:
    """(k, b - 1, 6) what one unit force of a law, or three of a ball, do to the bodies, as of `_residual`."""
    q, _ = equations.coordinates(found.state)
    frames = found.state.frames()
    if law.on_ball:
        first, second = ends(equations.mechanism, law.joint)
        jacobian = SPIN
    else:
        driven = equations.between[law.key]
        first, second = driven.first, driven.second
        jacobian = driven.measure(q, frames).jacobian
    r_i, theta_i, r_j, theta_j = jacobian
    pushes = np.zeros((len(r_i), len(frames), 6))
    for body, r, theta in ((first, r_i, theta_i), (second, r_j, theta_j)):
        pushes[:, body] += np.hstack([r, theta @ frames[body].rotation / equations.mechanism.size])
    return pushes[:, 1:]
