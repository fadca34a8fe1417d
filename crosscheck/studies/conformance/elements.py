"""Points of the contract about elements of scenes: joints, chains and loops, couplings and controllers.

A point is a function of a candidate that returns what is wrong, or "". Its docstring has three paragraphs:
what the point asks, why comparisons need that, and what a failure means. `crosscheck engine-check -v` prints
them.
"""

from __future__ import annotations

import numpy as np

from crosscheck.studies.conformance.candidate import Candidate
from crosscheck.studies.conformance.closed_forms import (
    flight,
    jump_response,
    sampled_motion,
    slide,
    steady_turn,
)
from crosscheck.studies.conformance.differences import (
    EXACT,
    MOTION,
    REACTION,
    TOLERANCE,
    arrays_of,
    first_difference,
    reference,
    violations,
)
from crosscheck.studies.conformance.element_scenes import cardan, rodded, screwed
from crosscheck.studies.conformance.scenes import (
    backward_drive,
    backward_slide,
    conical,
    double,
    driven_swing,
    floating,
    geared,
    jumping,
    linkage,
    sampled,
    sliding,
)


def slides(candidate: Candidate) -> str:
    """A body on a slide moves as in closed form, with its reaction, whichever body is the second.

    The joint's points on both bodies move apart, so that torques about them differ.

    The axis turns with the wrong body, or the torque is about the point of the first body.
    """
    for scene in (sliding(), backward_slide()):
        if why := first_difference(candidate.run(scene), slide(scene)):
            return why
    return ""


def balls(candidate: Candidate) -> str:
    """A body on a ball joint turns steadily about the vertical, as in closed form.

    Spatial rotation shows mistakes in angular velocities and gyroscopic torques that hinges hide.

    Angular velocities are in the frame of the body, or are rates of angles.
    """
    return first_difference(candidate.run(conical()), steady_turn(conical()))


def free_bodies(candidate: Candidate) -> str:
    """A body without constraints flies and turns as in closed form.

    Simulators have different conventions for the coordinates and velocities of a free joint.

    Velocities are those of the frame's origin, not the center of mass, or are in the body frame.
    """
    return first_difference(candidate.run(floating()), flight(floating()))


def ground_second(candidate: Candidate) -> str:
    """If the ground is the second body of a driven hinge, angle, torque and reaction have the other sign.

    Simulators build trees from the ground and exchange the bodies; coordinates then change their sign.

    The set-point or the torque of the law has the wrong sign, or the reaction acts on the wrong body.
    """
    exact = reference(driven_swing())
    forces = {name: -values for name, values in arrays_of(exact, ("actuator_force", *REACTION)).items()}
    return first_difference(candidate.run(backward_drive()), {**arrays_of(exact, MOTION), **forces})


def chain(candidate: Candidate) -> str:
    """Bodies that hang from each other, and the reactions of their joints, are those of the reference.

    A wrong order of bodies or joints, or a wrong parent, does not show with a single body.

    Arrays are in another order, or forces between two moving bodies are wrong.
    """
    return first_difference(candidate.run(double()), arrays_of(reference(double()), (*MOTION, *REACTION)))


def loops(candidate: Candidate) -> str:
    """A joint that closes a loop holds, and the constraint violation is that of the poses.

    Loops need constraints, which simulators solve in different ways. `crosscheck run` trusts the violation.

    The loop is open, its constraint is too soft, or the violation is not computed from the poses.
    """
    run, exact = candidate.run(linkage()), reference(linkage())
    by_poses = violations(linkage(), run)
    if why := first_difference(run, arrays_of(exact, MOTION)):
        return why
    found = np.asarray(run.constraint_violation, dtype=float)
    if found.shape != by_poses.shape:
        return f"constraint_violation has the shape {found.shape}; needed: {by_poses.shape}"
    if np.allclose(found, by_poses, rtol=TOLERANCE, atol=EXACT):
        return ""
    return f"constraint_violation is at most {np.max(found):.2g}; by the poses: {np.max(by_poses):.2g}"


def universals(candidate: Candidate) -> str:
    """A universal joint has one axis in its first body, and a perpendicular one in its second body.

    Simulators build universal joints from two hinges, whose order matters at large angles.

    The axes are exchanged, or both are fixed in one body.
    """
    return first_difference(candidate.run(cardan()), arrays_of(reference(cardan()), (*MOTION, *REACTION)))


def screws(candidate: Candidate) -> str:
    """A screw moves by its pitch times its angle, in meters per radian.

    Simulators define the pitch per radian or per revolution.

    The pitch is per revolution, has the other sign, or the joint is a hinge or a cylinder.
    """
    return first_difference(candidate.run(screwed()), arrays_of(reference(screwed()), (*MOTION, *REACTION)))


def rods(candidate: Candidate) -> str:
    """A rod keeps the distance of a point of one body and a point of the other, by a force along the rod.

    Simulators have constraints of distances, or rods as bodies with a mass.

    The rod is left out, its ends are other points, or its force acts on the wrong body.
    """
    return first_difference(candidate.run(rodded()), arrays_of(reference(rodded()), (*MOTION, *REACTION)))


def couplings(candidate: Candidate) -> str:
    """A gear turns its second joint by the ratio times the angle of its first joint.

    Some simulators define the ratio of a gear as the inverse.

    The gear is left out, or its ratio is the inverse or has the other sign.
    """
    return first_difference(candidate.run(geared()), arrays_of(reference(geared()), MOTION))


def jumps(candidate: Candidate) -> str:
    """A set-point jumps at its time, also inside a step, and the motion is that in closed form.

    A step across a jump has a large error, which hides other differences.

    The jump is left out, is smoothed, or acts from the next step or output on.
    """
    return first_difference(candidate.run(jumping()), jump_response(jumping()))


def sampled_control(candidate: Candidate) -> str:
    """A sampled controller is called once a period from time 0, and its force is held in between.

    Controllers are Python functions that the engine itself calls at the right times.

    The controller reads another time, is called at each step, or its force acts a period late.
    """
    return first_difference(candidate.run(sampled()), sampled_motion(sampled()))
