"""Attribution of a difference between two engines to a body, a joint or a parameter.

In: the equations of two engines at the same states (`Samples`). Out: the name of the element whose model is
likely wrong. A scene is the mechanism with its forces that both engines have to simulate. The results of each
engine are inserted into the equations of the scene, which are right by definition; the equations of the wrong
element are violated:

- Kinematics: poses of an engine violate the scene's constraints of the wrong joint, or of all joints of a
  body whose frame is wrong.
- Dynamics: accelerations and reactions of an engine violate Newton's and Euler's equations with the scene's
  masses and forces. A wrong mass or inertia violates the equations of a single body. Wrong gravity violates
  those of all bodies, and a wrong spring or controller those of the two bodies of a joint.
- Velocity terms: accelerations satisfy the equations of the bodies, but violate the constraints of the joint
  whose velocity-dependent term is wrong.
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
from newton_euler.model.balls import SPIN, joint_bodies
from newton_euler.model.digital_control import Law
from newton_euler.model.elements import OnBall, OnCoordinate, Surroundings
from newton_euler.model.forces import BallSpring, JointSpring
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.model.state import State
from newton_euler.scalars import Array

ForceAtJoint = Law | JointSpring | BallSpring
"""Control law of an actuator, or spring, that acts at a joint."""

MIN_VIOLATION = 1e-11
"""Smallest constraint violation that is not round-off: of poses, sizes of the mechanism or rad; of
velocities, 1/s."""

MIN_ACCELERATION_VIOLATION = 1e-9
"""Smallest violation of joint constraints by accelerations that is not round-off, divided by the largest
acceleration."""

MIN_RESIDUAL_RATIO = 1e-2
"""Residuals below this fraction of the largest one are side effects, such as squares of a small error."""

MAX_UNEXPLAINED_RATIO = 1e-4
"""Largest residual of Newton's and Euler's equations that may remain after the fit of a wrong parameter,
divided by the largest residual before. Residuals are linear in a small error up to about this fraction."""

MIN_RELATIVE_RESIDUAL = 1e-10
"""Smallest residual of Newton's and Euler's equations, N, that is not round-off, divided by a typical force:
the scene's unit of energy over its size. 1e-10 is the round-off of some hundred operations, 1e-12, at a
condition number of 100."""


def kinematic_cause(first: Samples, second: Samples) -> str | None:
    """Find the joint, or the body, whose kinematics are wrong in one of two engines.

    Three searches follow each other. The first one closes the loops of each engine. If a wrong joint prevents
    that, the second one compares poses before loops are closed. The third one looks at the closing joints of
    the engine's model alone.

    Returns:
        Name of the joint whose constraints in the scene are violated, or of the body if the constraints of
        all its joints are. None if no constraint is violated: the engines then differ because one of them has
        additional constraints.
    """
    for search in (_violated_after_closure, _violated_in_tree, _violated_closure):
        # the second engine first: the first one is usually newton_euler, this project's solver
        for samples in (second, first):
            if (name := search(samples)) is not None:
                return name
    return None


def _violated_after_closure(samples: Samples) -> str | None:
    """Find the joint that an engine violates while its own loops are closed.

    If several joints are violated that have exactly one body (not the ground) in common, the name of this
    body is returned: its frame is wrong.
    """
    mechanism = samples.states.scene.mechanism
    violations = _violations(samples)
    if not np.max(violations, initial=0.0) > MIN_VIOLATION:
        return None
    violated = np.flatnonzero(violations > MIN_RESIDUAL_RATIO * violations.max())
    connected = [{mechanism.joints[k].first, mechanism.joints[k].second} for k in violated]
    common = set.intersection(*connected) - {mechanism.body_names[0]}
    if len(violated) > 1 and len(common) == 1:
        return common.pop()
    return mechanism.joint_names[int(np.argmax(violations))]


def _violations(samples: Samples) -> Array:
    """Compute how much an engine's kinematics violate the scene's constraints of each joint.

    Returns:
        (j,) the largest residual of each joint over all states: of poses with closed loops, sizes of the
        mechanism or rad, or of their rates under the velocities that the engine allows, 1/s.
    """
    system, mechanism = samples.system, samples.states.scene.mechanism
    size = mechanism.size
    violations = np.zeros(len(mechanism.joints))
    # the engine's own coordinates and velocities at each state, the body states (`State`) that follow by its
    # kinematics, and a basis of the body velocities that its constraints allow
    for (q, v), motion, basis in zip(samples.coordinates, samples.motions, samples.bases, strict=True):
        # Poses; some loops cannot be closed
        with suppress(AssemblyError):
            closed = system.state(project_position(system, q), 0.0 * v)
            violations = np.maximum(violations, _residuals(mechanism, closed))
        # Rates under each allowed body velocity: columns of `basis`, linear ones divided by the size
        frames = motion.frames()
        velocities = basis.reshape(len(frames), 6, -1)
        for k, equations in enumerate(mechanism.equations):
            i, j = equations.first, equations.second
            blocks = equations.jacobian(frames[i], frames[j])
            linear = blocks.r_first @ velocities[i, :3] + blocks.r_second @ velocities[j, :3]
            angular = blocks.theta_first @ velocities[i, 3:] + blocks.theta_second @ velocities[j, 3:]
            # `units`: the size for each equation in m, 1 for each equation in rad
            rates = np.abs(size * linear + angular) / equations.units(size)[:, None]
            violations[k] = max(violations[k], float(np.max(rates, initial=0.0)))
    return violations


def _residuals(mechanism: Mechanism, state: State) -> Array:
    """Compute the largest constraint residual (j,) of each joint in a state, mechanism sizes or rad."""
    frames, gaps = state.frames(), []
    for equations in mechanism.equations:
        phi = equations.phi(frames[equations.first], frames[equations.second])
        gaps.append(float(np.max(np.abs(phi) / equations.units(mechanism.size), initial=0.0)))
    return np.array(gaps)


def _violated_in_tree(samples: Samples) -> str | None:
    """Find the joint of the spanning tree that an engine violates before its loops are closed.

    Joints that close loops (cuts of the spanning tree) are ignored: before loops are closed these joints are
    violated whichever joint is wrong.
    """
    mechanism = samples.states.scene.mechanism
    residuals = np.max([_residuals(mechanism, motion) for motion in samples.motions], axis=0)
    residuals[list(SpanningTree(mechanism).cuts)] = 0.0  # joints by number
    if not np.max(residuals, initial=0.0) > MIN_VIOLATION:
        return None
    return mechanism.joint_names[int(np.argmax(residuals))]


def _violated_closure(samples: Samples) -> str | None:
    """Find the loop-closing ball joint whose two points are farthest apart in an engine's own model.

    None if all points coincide, up to round-off.
    """
    gaps = {
        name: float(np.linalg.norm(joint.points[1] - joint.points[0]))
        for name, joint in samples.joints.items()
        if joint.kinds == ("ball",) and np.all(np.isfinite(joint.points))
    }
    name = max(gaps, key=lambda name: gaps[name], default="")
    return name if name and gaps[name] > MIN_VIOLATION * samples.states.scene.mechanism.size else None


def accelerated_joint(first: Samples, second: Samples) -> str | None:
    """Find the joint whose constraints the body accelerations of one of two engines violate.

    Accelerations with a wrong velocity term satisfy the equations of motion of the bodies, but violate the
    constraints of the joint that the term belongs to. None if they violate no constraint.
    """
    mechanism = first.states.scene.mechanism
    for samples in (second, first):
        violations = [_acceleration_violations(mechanism, evaluation) for evaluation in samples.evaluations]
        largest = np.max(violations, axis=0)
        if np.max(largest, initial=0.0) > MIN_ACCELERATION_VIOLATION * samples.scales.acceleration:
            return mechanism.joint_names[int(np.argmax(largest))]
    return None


def _acceleration_violations(mechanism: Mechanism, evaluation: Evaluation) -> Array:
    """Compute the residuals (j,) of the joint constraints at the level of accelerations, m/s^2.

    The residual of a joint is |J a - gamma|, with the constraint Jacobian J, the body accelerations a and the
    velocity term gamma. Angular residuals are multiplied by the mechanism's size.

    Args:
        mechanism: the mechanism.
        evaluation: an engine's body accelerations at one state.
    """
    frames = evaluation.state.frames()
    linear, angular = evaluation.linear_acceleration, evaluation.angular_acceleration
    residuals = []
    for equations in mechanism.equations:
        i, j = equations.first, equations.second
        blocks = equations.jacobian(frames[i], frames[j])
        rate = blocks.r_first @ linear[i] + blocks.r_second @ linear[j]
        rate = rate + blocks.theta_first @ angular[i] + blocks.theta_second @ angular[j]
        residual = (rate - equations.gamma(frames[i], frames[j])) / equations.units(mechanism.size)
        residuals.append(mechanism.size * float(np.max(np.abs(residual), initial=0.0)))
    return np.array(residuals)


class Cause(NamedTuple):
    """Cause of a difference between two engines.

    Attributes:
        where: name of a body or a joint, or "gravity".
        detail: the wrong parameter with its value in the engine and its value in the scene, for gravity and
            for a control law or spring at a joint; empty otherwise.
    """

    where: str
    detail: str = ""


def dynamic_cause(first: Samples, second: Samples, forces: bool = True) -> Cause | None:
    """Find the body, the joint or gravity whose model is wrong in one of two engines.

    A joint is found in two cases: a control law or spring there explains the residuals of Newton's and
    Euler's equations, or these equations hold but accelerations violate the constraints of the joint.

    Args:
        first, second: equations of the two engines at the same states.
        forces: False if a force or gravity cannot be the cause, for example of different kinetic energies.

    Returns:
        The cause; None if neither the equations of bodies nor the constraints are violated.
    """
    scene = first.states.scene
    for samples in (second, first):
        residuals = momentum_residuals(samples)
        largest = np.abs(residuals).max(axis=(0, 2))  # of each moving body
        if not largest.max() > MIN_RELATIVE_RESIDUAL * first.states.energy / scene.mechanism.size:
            continue
        if forces and (fitted := _fitted_gravity(scene, residuals)) is not None:
            return Cause("gravity", _instead_of(fitted, scene.gravity, "m/s^2"))
        if forces and (cause := _force_cause(samples, residuals)):
            return cause
        return Cause(scene.mechanism.body_names[1 + int(np.argmax(largest))])  # without the ground
    violated = accelerated_joint(first, second)
    return None if violated is None else Cause(violated)


def _fitted_gravity(scene: Scene, residuals: Array) -> Array | None:
    """Return the gravity (3,), m/s^2, that explains the residuals of all bodies; None if none does.

    Args:
        scene: the scene.
        residuals: (n, b - 1, 6) residuals of Newton's and Euler's equations, see `momentum_residuals`.
    """
    mass = np.array([body.mass for body in scene.mechanism.bodies[1:]])
    # Least squares: residual force of a body = its mass times the change of gravity
    change = np.einsum("nbi,b->i", residuals[..., :3], mass) / (len(residuals) * (mass @ mass))
    remaining = residuals.copy()
    remaining[..., :3] -= mass[:, None] * change
    explains = np.abs(remaining).max() < MAX_UNEXPLAINED_RATIO * np.abs(residuals).max()
    return scene.gravity + change if explains else None


def _force_cause(samples: Samples, residuals: Array) -> Cause | None:
    """Find the joint whose control law or spring explains the residuals of an engine; None if none does.

    Springs that the scene does not have are tried as well, at all joint coordinates without a spring: the
    engine may have one. A single parameter of such a spring must explain the residuals.

    Args:
        samples: equations of the engine at n states.
        residuals: (n, b - 1, 6) residuals of Newton's and Euler's equations, see `momentum_residuals`.
    """
    scene = samples.states.scene
    with_spring = {force.key for force in scene.forces if isinstance(force, OnCoordinate)}
    absent = tuple(  # springs of zero stiffness and damping
        JointSpring(joint.name, coordinate=k)
        for joint in scene.mechanism.joints
        for k in range(len(joint.coordinate_kinds))
        if (joint.name, k) not in with_spring
    )
    extended = replace(scene, forces=(*scene.forces, *absent))
    equations = Cartesian(extended)
    present = (*scene.joint_forces, *(force for force in scene.forces if isinstance(force, OnBall)))
    for force in (*present, *absent):
        unit_loads = np.array([_unit_loads(equations, force, each.state) for each in samples.evaluations])
        fitted = _fitted_forces(unit_loads, residuals)
        if fitted is not None:
            at_states = [surroundings(extended, each.state) for each in samples.evaluations]
            detail = _wrong_parameter(force, fitted, at_states)
            if detail or force in present:
                return Cause(force.joint, detail)
    return None


def _fitted_forces(unit_loads: Array, residuals: Array) -> Array | None:
    """Fit the forces of an element at a joint to the residuals, state by state.

    Args:
        unit_loads: (n, k, b - 1, 6) loads on the bodies by k unit forces of the element.
        residuals: (n, b - 1, 6) residuals of Newton's and Euler's equations.

    Returns:
        (n, k) forces, N or N m; None if the forces do not explain the residuals.
    """
    flat = residuals.reshape(len(residuals), -1)
    remaining, forces = flat.copy(), []
    for residual, loads in zip(remaining, unit_loads.reshape(*unit_loads.shape[:2], -1), strict=True):
        forces.append(np.linalg.lstsq(loads.T, residual)[0])
        residual -= forces[-1] @ loads  # in place: changes `remaining`
    explains = np.abs(remaining).max() < MAX_UNEXPLAINED_RATIO * np.abs(flat).max()
    return np.array(forces) if explains else None


def _wrong_parameter(force: ForceAtJoint, extra: Array, at_states: Sequence[Surroundings]) -> str:
    """Find the single parameter of a control law or spring whose change explains extra forces.

    Args:
        force: control law or spring.
        extra: (n, k) forces in addition to those of `force` at n states, N or N m. If they are the same in
            all states, they do not show which parameter they depend on.
        at_states: positions, velocities and time at the n states, which `force` depends on.

    Returns:
        Text with the name of the parameter and both values; empty if no parameter explains the forces.
    """
    if np.ptp(extra, axis=0).max() < MAX_UNEXPLAINED_RATIO * np.abs(extra).max():
        return ""
    given = np.array([np.atleast_1d(force.at_joint(state)) for state in at_states])
    for name in force.parameters:
        value = getattr(force, name)
        if not isinstance(value, float):
            continue  # functions of time, and rest orientations of balls
        # Forces are linear in each parameter: fit its change to the extra forces
        larger: ForceAtJoint = replace(force, **{name: value + 1.0})  # type: ignore[arg-type]
        slope = np.array([np.atleast_1d(larger.at_joint(state)) for state in at_states]) - given
        if not np.any(slope):
            continue
        change = float(np.sum(slope * extra) / np.sum(slope * slope))
        if np.abs(extra - change * slope).max() < MAX_UNEXPLAINED_RATIO * np.abs(extra).max():
            return f"{name} {_instead_of(np.array([value + change]), np.array([value]))}"
    return ""


def _instead_of(fitted: Array, of_scene: Array, unit: str = "") -> str:
    """Format fitted numbers (n,) and those of the scene, as "1.1 instead of 1 m/s^2"."""
    # Numbers far below the change are round-off of zero
    rounded = np.where(np.abs(fitted) > MAX_UNEXPLAINED_RATIO * np.abs(fitted - of_scene).max(), fitted, 0.0)
    texts = (" ".join(f"{number:.4g}" for number in numbers) for numbers in (rounded, of_scene))
    return f"{' instead of '.join(texts)} {unit}".rstrip()


def _unit_loads(equations: Cartesian, force: ForceAtJoint, state: State) -> Array:
    """Compute the loads on the moving bodies by unit forces of a control law or spring.

    Args:
        equations: Cartesian equations of the scene.
        force: control law or spring at a joint.
        state: poses of the bodies.

    Returns:
        (k, b - 1, 6) loads in the units of `momentum_residuals`: for k = 1 unit force along a joint
        coordinate, or for k = 3 unit torques of a ball joint.
    """
    q, _ = equations.coordinates(state)
    frames = state.frames()
    # The loads are the Jacobian of the coordinate with respect to motions of its two bodies (virtual work)
    if force.on_ball:
        first, second = joint_bodies(equations.mechanism, force.joint)  # numbers of the bodies
        jacobian = SPIN  # of the three components of the relative angular velocity
    else:
        coordinate = equations.between[force.key]  # a joint coordinate, with the numbers of its two bodies
        first, second = coordinate.first, coordinate.second
        jacobian = coordinate.measure(q, frames).jacobian
    # Derivatives (k, 3) by position (r) and rotation (theta, world frame) of the first and the second body
    r_first, theta_first, r_second, theta_second = jacobian
    loads = np.zeros((len(r_first), len(frames), 6))
    for body, r, theta in ((first, r_first, theta_first), (second, r_second, theta_second)):
        loads[:, body] += np.hstack([r, theta @ frames[body].rotation / equations.mechanism.size])
    return loads[:, 1:]
