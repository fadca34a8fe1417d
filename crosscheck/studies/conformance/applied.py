"""Points of the contract about what acts on joints and bodies: forces, prescribed motions and rotors.

A point is a function of a candidate that returns what is wrong, or "". Its docstring has three paragraphs:
what the point asks, why comparisons need that, and what a failure means. `crosscheck engine-check -v` prints
them.
"""

from __future__ import annotations

import numpy as np

from crosscheck.studies.conformance.candidate import Candidate
from crosscheck.studies.conformance.closed_forms import (
    Arrays,
    braked_motion,
    guided_motion,
    rotor_slide,
    spring_response,
)
from crosscheck.studies.conformance.differences import (
    REACTION,
    TOLERANCE,
    first_difference,
    whole_run,
)
from crosscheck.studies.conformance.element_scenes import (
    armed_ball,
    armed_double,
    armed_slide,
    belted,
    braked_slide,
    guided_double,
    guided_slide,
    pushed_swing,
    sprung_ball,
    sprung_slide,
    sprung_swing,
    stopped_slide,
    tied_double,
    windy_swing,
)
from newton_euler.model.scene import Scene


def joint_springs(candidate: Candidate) -> str:
    """Springs and dampers of slides and hinges act on the coordinate, with their energy and work.

    A spring has potential energy, and a damper does work; neither is part of the reaction.

    The spring or the damper is left out, its rest has the other sign, or its energy or work is missing.
    """
    slide, swing = sprung_slide(), sprung_swing()
    for scene, exact in ((slide, spring_response(slide)), (swing, whole_run(swing))):
        if why := first_difference(candidate.run(scene), exact):
            return why
    return ""


def ball_springs(candidate: Candidate) -> str:
    """The torsion spring of a ball joint acts along the rotation vector from rest, its damper along the spin.

    Simulators have springs of three angles, which are other springs at large rotations.

    The spring or the damper is left out, the orientation at rest is another one, or the torque is a reaction.
    """
    return first_difference(candidate.run(sprung_ball()), _without_torques(sprung_ball()))


def point_springs(candidate: Candidate) -> str:
    """A spring and damper between points of two bodies pulls both along the line between the points.

    The forces on both bodies have moments about their centers of mass.

    The spring or the damper is left out, acts on one body, has no rest length, or acts at other points.
    """
    return first_difference(candidate.run(tied_double()), whole_run(tied_double()))


def wrenches(candidate: Candidate) -> str:
    """A force and torque on a body are constant in the world frame, or turn with the body.

    Simulators apply external forces at the center of mass, the origin of the frame or a point, in one frame.

    The wrench is left out, is in the other frame, or its force acts at another point.
    """
    return first_difference(candidate.run(pushed_swing()), whole_run(pushed_swing()))


def winds(candidate: Candidate) -> str:
    """Wind pushes a plate on a body along the normal of the plate, by the velocity relative to the plate.

    Wind is not part of most simulators; adapters compute the force and apply it at the center of the plate.

    The load is left out, ignores the speed of the plate or the time, or acts at another point.
    """
    return first_difference(candidate.run(windy_swing()), whole_run(windy_swing()))


def frictions(candidate: Candidate) -> str:
    """Dry friction of a joint opposes the motion and does work.

    Simulators regularize dry friction, or solve for it as a constraint.

    The friction is left out, has the other sign, or its work is missing.
    """
    return first_difference(candidate.run(braked_slide()), braked_motion(braked_slide()))


def stops(candidate: Candidate) -> str:
    """An end stop of a joint pushes back beyond its limit by a spring, whose damping grows with the depth.

    Limits of simulators are rigid, or have a damping that makes the force jump at the first touch.

    The stop is left out, is rigid, pulls, or has no dissipation.
    """
    return first_difference(candidate.run(stopped_slide()), whole_run(stopped_slide()))


def elastic_gears(candidate: Candidate) -> str:
    """An elastic gear acts on both of its joints beyond its play, with an efficiency in each direction.

    Simulators have rigid gears only; adapters compute the two torques.

    The gear is left out or rigid, acts on one joint, or ignores its play or efficiency.
    """
    return first_difference(candidate.run(belted()), _without_torques(belted()))


def prescribed_motions(candidate: Candidate) -> str:
    """A prescribed coordinate follows its function of time; its force is part of the reaction and does work.

    Drives of given motion are constraints that depend on time.

    The motion is left out, begins at rest, or lacks its rate or acceleration; or its force is left out.
    """
    slide, chain = guided_slide(), guided_double()
    soft = candidate.engine.soft_constraints
    # Reactions include the forces of motions, which have the declared error if constraints are soft
    reaction_tolerance = TOLERANCE + (0.0 if soft is None else soft.force_error)
    for scene, exact in ((slide, guided_motion(slide)), (chain, whole_run(chain))):
        run = candidate.run(scene)
        for names, tolerance in ((exact.keys() - {*REACTION}, TOLERANCE), (REACTION, reaction_tolerance)):
            compared = {name: values for name, values in exact.items() if name in names}
            if why := first_difference(run, compared, tolerance):
                return why
    return ""


def rotors(candidate: Candidate) -> str:
    """A rotor adds its inertia to the coordinate of a slide or hinge, with its kinetic energy and no weight.

    Between two moving bodies, the rotor resists the relative acceleration only.

    The rotor is left out, its inertia is added to a body, or its kinetic energy is missing.
    """
    slide, chain = armed_slide(), armed_double()
    for scene, exact in ((slide, rotor_slide(slide)), (chain, whole_run(chain))):
        if why := first_difference(candidate.run(scene), exact):
            return why
    return ""


def ball_rotors(candidate: Candidate) -> str:
    """A rotor on a ball joint adds an isotropic inertia to the relative rotation of its two bodies.

    Rotors of simulators belong to coordinates; those of a ball differ from simulator to simulator.

    The rotor is left out, or its inertia acts on rates of angles.
    """
    return first_difference(candidate.run(armed_ball()), _without_torques(armed_ball()))


def _without_torques(scene: Scene) -> Arrays:
    """Return the reference run of a scene whose reaction torques are zero, without their round-off."""
    exact = whole_run(scene)
    return {**exact, "reaction_torque": np.zeros_like(exact["reaction_torque"])}
