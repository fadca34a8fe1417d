"""Points of the contract about elements of scenes: joints, chains and loops, couplings and controllers.

A point is a function of a candidate that returns what is wrong, or "". Its docstring has three paragraphs:
what the point asks, why comparisons need that, and what a failure means. `crosscheck engine-check -v` prints
them.
"""

from __future__ import annotations

from crosscheck.studies.conformance.candidate import Candidate
from crosscheck.studies.conformance.closed_forms import (
    flight,
    jump_response,
    sampled_motion,
    slide,
    steady_turn,
)
from crosscheck.studies.conformance.differences import (
    POSES,
    REACTION,
    arrays_of,
    first_difference,
    reference,
)
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
    return first_difference(candidate.run(backward_drive()), {**arrays_of(exact, POSES), **forces})


def chain(candidate: Candidate) -> str:
    """Bodies that hang from each other, and the reactions of their joints, are those of the reference.

    A wrong order of bodies or joints, or a wrong parent, does not show with a single body.

    Arrays are in another order, or forces between two moving bodies are wrong.
    """
    return first_difference(candidate.run(double()), arrays_of(reference(double()), (*POSES, *REACTION)))


def loops(candidate: Candidate) -> str:
    """A joint that closes a loop holds.

    Loops need constraints, which simulators solve in different ways.

    The loop is open, or its constraint is too soft.
    """
    return first_difference(candidate.run(linkage()), arrays_of(reference(linkage()), POSES))


def couplings(candidate: Candidate) -> str:
    """A gear turns its second joint by the ratio times the angle of its first joint.

    Some simulators define the ratio of a gear as the inverse.

    The gear is left out, or its ratio is the inverse or has the other sign.
    """
    return first_difference(candidate.run(geared()), arrays_of(reference(geared()), POSES))


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
