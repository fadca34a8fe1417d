"""The body, joint or term that a difference between two engines comes from.

The scene's own equations are the referee. What is right in an engine's model satisfies them wherever the
engine ends up; the one thing that is wrong does not:

- bodies placed by an engine's kinematics, its own loops closed, leave open in the scene's eyes the joint
  that is wrong, or all joints of a body whose frame is wrong;
- accelerations and reactions of an engine violate Newton's and Euler's equations, with the scene's masses
  and forces, of the body whose mass or inertia is wrong, of all bodies as another gravity would, or of the
  two bodies of a joint as another spring or control law there would.
"""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from crosscheck.comparison.momentum import momentum_residuals
from crosscheck.comparison.samples import Samples
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.system import Evaluation
from newton_euler.errors import AssemblyError
from newton_euler.integrators.projection import project_position
from newton_euler.model.balls import SPIN, ends
from newton_euler.model.elements import OnBall, OnCoordinate
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.model.state import State
from newton_euler.scalars import Array

OPEN = 1e-11
"""Sizes of the mechanism, rad, and as many a second: what is more is not round-off, see `kinematics`."""

SHARE = 1e-2
"""Of the largest residual: what is less comes along with it, such as products of a small error and itself."""

EXPLAINED = 1e-4
"""Share of all residuals that a cause may leave over: small errors act in proportion, and this is how far."""


UNBALANCED = 1e-10
"""Of the scene's energy over its size, N: residuals of equations of condition 1e2 that hold to round-off."""


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
    if not np.max(openings, initial=0.0) > OPEN:
        return None
    opened = np.flatnonzero(openings > SHARE * openings.max())
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
    return mechanism.joint_names[int(np.argmax(gaps))] if np.max(gaps, initial=0.0) > OPEN else None


def _open_closure(samples: Samples) -> str | None:
    """The closure whose two points lie farthest apart in a system's own model, if they do."""
    gaps = {
        name: float(np.linalg.norm(joint.points[1] - joint.points[0]))
        for name, joint in samples.joints.items()
        if joint.kinds == ("ball",) and np.all(np.isfinite(joint.points))
    }
    name = max(gaps, key=lambda name: gaps[name], default="")
    return name if name and gaps[name] > OPEN * samples.states.scene.mechanism.size else None


def dynamic_cause(first: Samples, second: Samples, forces: bool = True) -> str | None:
    """The body, joint or "gravity" that one of two systems gets wrong in Newton's and Euler's equations.

    A joint if it is what a control law or spring does there. None if the equations hold: then what differs
    is no force on a body. Without `forces` the bodies alone come into question, as where inertia differs.
    """
    scene = first.states.scene
    equations = Cartesian(scene)
    for samples in (second, first):
        residuals = momentum_residuals(samples)
        largest = np.abs(residuals).max(axis=(0, 2))
        if not largest.max() > UNBALANCED * first.states.energy / scene.mechanism.size:
            continue
        if forces and _is_gravity(scene, residuals):
            return "gravity"
        for law in _at_joints(scene) if forces else ():
            pushes = np.array([_pushes(equations, law, evaluation) for evaluation in samples.evaluations])
            if _explains(pushes, residuals):
                return law.joint
        return scene.mechanism.body_names[1 + int(np.argmax(largest))]
    return None


def _is_gravity(scene: Scene, residuals: Array) -> bool:
    """True if one change of gravity explains residuals (n, b - 1, 6) of several bodies."""
    mass = np.array([body.mass for body in scene.mechanism.bodies[1:]])
    other = np.einsum("nbi,b->i", residuals[..., :3], mass) / (len(residuals) * (mass @ mass))
    left = residuals.copy()
    left[..., :3] -= mass[:, None] * other
    return bool(np.abs(left).max() < EXPLAINED * np.abs(residuals).max())


def _at_joints(scene: Scene) -> tuple[OnCoordinate | OnBall, ...]:
    """Control laws and springs of joints and of their balls."""
    return (*scene.joint_forces, *(force for force in scene.forces if isinstance(force, OnBall)))


def _explains(pushes: Array, residuals: Array) -> bool:
    """True if residuals (n, b - 1, 6) are sums of multiples of `pushes` (n, k, b - 1, 6), state by state."""
    flat = residuals.reshape(len(residuals), -1)
    left = flat.copy()
    for rest, pushed in zip(left, pushes.reshape(*pushes.shape[:2], -1), strict=True):
        rest -= np.linalg.lstsq(pushed.T, rest)[0] @ pushed
    return bool(np.abs(left).max() < EXPLAINED * np.abs(flat).max())


def _pushes(equations: Cartesian, law: OnCoordinate | OnBall, found: Evaluation) -> Array:
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
