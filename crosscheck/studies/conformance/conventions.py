"""Points of the contract about the numbers of a run: what each array means, and in which frame it is.

A point is a function of a candidate that returns what is wrong, or "". Its docstring has three paragraphs:
what the point asks, why comparisons need that, and what a failure means. `crosscheck engine-check -v` prints
them.
"""

from __future__ import annotations

import numpy as np

from crosscheck.studies.conformance.candidate import Candidate
from crosscheck.studies.conformance.differences import (
    EXACT,
    MOTION,
    REACTION,
    TOLERANCE,
    arrays_of,
    first_difference,
    reference,
    relative,
)
from crosscheck.studies.conformance.scenes import backward_swing, bare, driven_swing, swing
from newton_euler.model.euler_parameters import angle_between, rotations
from newton_euler.model.trajectory import QUANTITIES
from newton_euler.runs.assemble import initial_state


def start(candidate: Candidate) -> str:
    """The first row of a run is the initial state of the scene, with its velocities.

    Runs are compared at equal times, so that all engines need the same start.

    The engine starts at rest, from another pose, or its first row is that after a step.
    """
    scene, run = candidate.first_run()
    state = initial_state(scene)
    for name in ("position", "linear_velocity", "angular_velocity"):
        found = getattr(run, name)
        if not relative(None if found is None else found[0], getattr(state, name)) <= EXACT:
            return f"{name} of the first row is not that of the initial state"
    return ""


def quaternion_order(candidate: Candidate) -> str:
    """Quaternions are (w, x, y, z) of norm 1, from the body frame to the world frame.

    Simulators use both orders and both directions. The wrong choice gives other orientations.

    The components are in another order, or the rotation is the inverse one.
    """
    scene, run = candidate.first_run()
    exact = initial_state(scene).quaternion
    if np.shape(run.quaternion) != (len(scene.times), *exact.shape):
        needed = (len(scene.times), *exact.shape)
        return f"quaternion has the shape {np.shape(run.quaternion)}; needed: {needed}"
    found = run.quaternion[0]
    norms = np.linalg.norm(run.quaternion, axis=-1)
    if not np.max(np.abs(norms - 1.0)) <= EXACT:
        return f"a quaternion has the norm {norms.flat[np.argmax(np.abs(norms - 1.0))]:.6g}; needed: 1"
    if np.max(angle_between(found, exact)) <= EXACT:
        return ""
    wrong = {"(x, y, z, w)": np.roll(exact, -1, axis=1), "inverse": exact * [1.0, -1.0, -1.0, -1.0]}
    fits = [f": it is its {name}" for name, q in wrong.items() if np.max(np.abs(found[1] - q[1])) <= EXACT]
    return f"the first quaternion is not the initial one{''.join(fits)}"


def outputs(candidate: Candidate) -> str:
    """A run has the output times, optional outputs and names of the scene, and no other outputs.

    Comparisons ask for the outputs that they compare; other outputs cost time.

    An array is missing, was not asked for, or has rows for other bodies, joints or times.
    """
    first, _ = candidate.first_run()
    for scene in (bare(first), first):
        run, needed = candidate.run(scene), reference(scene)
        if not np.array_equal(run.time, needed.time):
            return "times are not those of the scene"
        for kind in ("body_names", "joint_names"):
            if tuple(getattr(run, kind)) != getattr(needed, kind):
                return f"{kind} is {getattr(run, kind)!r}; needed: {getattr(needed, kind)!r}"
        for name in (*QUANTITIES, "constraint_violation"):
            found, expected = getattr(run, name), getattr(needed, name)
            if (found is None) != (expected is None):
                return f"{name} is {'missing' if found is None else 'there, though not asked for'}"
            if found is not None and np.shape(found) != np.shape(expected):
                return f"{name} has the shape {np.shape(found)}; needed: {np.shape(expected)}"
    return ""


def motion(candidate: Candidate) -> str:
    """Masses, inertias, gravity, joint points and axes are those of the scene, in poses and velocities.

    Every other point needs these numbers. One body on a skew hinge, with a turned frame, shows each of them.

    A number of the model or its frame is wrong, such as an inertia of the body frame as one of the world, or
    velocities are those of another time.
    """
    return first_difference(candidate.run(swing()), arrays_of(reference(swing()), MOTION))


def reaction_sign(candidate: Candidate) -> str:
    """A reaction acts on the second body of its joint, also if the ground is the second body.

    The reactions on both bodies of a joint have opposite signs, and simulators report either one.

    Reactions act on the first body, or always on the moving body.
    """
    for scene in (swing(), backward_swing()):
        run, exact = candidate.run(scene), arrays_of(reference(scene), REACTION)
        for name, values in exact.items():
            if (found := getattr(run, name)) is None:
                return f"{name} is missing"
            if not np.sum(found * values) > 0.0:
                return f"{name} acts on the first body"
    return ""


def reaction_frame(candidate: Candidate) -> str:
    """Reaction forces are in the world frame, and include what carries the weight of the body.

    Simulators also report reactions in the frame of the joint or the body.

    The force is in another frame, or lacks a part. Its sign is the subject of `reaction_sign`.
    """
    run, exact = candidate.run(swing()), reference(swing())
    force = exact.reaction_force
    assert force is not None
    apart = min(relative(run.reaction_force, sign * force) for sign in (1.0, -1.0))
    if apart <= TOLERANCE:
        return ""
    local = np.einsum("nji,nj->ni", rotations(exact.quaternion[:, 1]), force[:, 0])[:, None]
    hint = ": it is in the frame of the body" if relative(run.reaction_force, local) <= TOLERANCE else ""
    return f"reaction_force differs by {apart:.2g} of its largest value{hint}"


def reaction_point(candidate: Candidate) -> str:
    """Reaction torques are in the world frame, and about the joint's point on its second body.

    The torque of a force depends on the point of reference.

    The torque is about the center of mass, the origin, or a point of the other body.
    """
    run, torque = candidate.run(swing()), reference(swing()).reaction_torque
    assert torque is not None
    apart = min(relative(run.reaction_torque, sign * torque) for sign in (1.0, -1.0))
    if apart <= TOLERANCE:
        return ""
    return f"reaction_torque differs by {apart:.2g} of its largest value: it may be about another point"


def drive_force(candidate: Candidate) -> str:
    """The force of a control law is an actuator force, and no part of the reaction.

    Loads of bearings and of motors are compared separately.

    The law has another sign or gain, or the reaction includes the force of the drive.
    """
    exact = reference(driven_swing())
    return first_difference(
        candidate.run(driven_swing()), arrays_of(exact, ("actuator_force", "reaction_torque"))
    )


def energy(candidate: Candidate) -> str:
    """Energies are absolute: the potential energy of a weight is zero at the origin of the world.

    Comparisons use the energies themselves, not only their changes.

    The energy is relative to the start, or lacks the rotation of bodies.
    """
    exact = reference(swing())
    return first_difference(candidate.run(swing()), arrays_of(exact, ("kinetic_energy", "potential_energy")))


def work(candidate: Candidate) -> str:
    """Work is that of control laws, dampers, wrenches and prescribed motions since the start.

    The energy balance is the change of energy minus this work. Its error is that of the integration.

    The work has the wrong sign, is that of one step only, or includes gravity or springs.
    """
    return first_difference(candidate.run(driven_swing()), arrays_of(reference(driven_swing()), ("work",)))
