"""Scenes of the contract with forces, rotors, prescribed motions and less common joints.

Each scene adds one kind of element to a scene of `scenes.py`, or exchanges its joint. The module also lists
all scenes of the contract.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

from crosscheck.studies.conformance.scenes import (
    SKEW_GRAVITY,
    SLIDE_AXIS,
    SLIDE_DAMPING,
    SLIDE_STIFFNESS,
    backward_drive,
    backward_slide,
    backward_swing,
    body,
    conical,
    double,
    driven_swing,
    fast_swing,
    floating,
    geared,
    jumping,
    linkage,
    moving,
    sampled,
    sliding,
    swing,
)
from newton_euler.model.armatures import Armature, BallArmature
from newton_euler.model.forces import BallSpring, JointSpring, PointSpring, Wrench
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import Rod, Screw, Universal
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.motions import PrescribedMotion
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Polynomial, Sine
from newton_euler.model.switched_forces import ElasticGear, JointFriction, JointStop
from newton_euler.model.wind import WindLoad
from newton_euler.scalars import Array

SPRING_REST = 0.05
"""Coordinate of a slide at which its spring has no force, m."""

SLIDE_FRICTION = 5.0
"""Dry friction of a slide, N."""

SLIDE_ROTOR = 3.0
"""Rotor inertia of a slide, kg."""

GUIDE = Sine(amplitude=0.12, angular_frequency=9.0, phase=0.4, offset=0.02)
"""Prescribed displacement of a sliding body, m."""


@cache
def sprung_slide() -> Scene:
    """Return the sliding body with a spring and damper on its slide."""
    spring = JointSpring("slide", SLIDE_STIFFNESS, SLIDE_DAMPING, SPRING_REST)
    return replace(sliding(), name="sprung_slide", forces=(spring,))


@cache
def sprung_swing() -> Scene:
    """Return the swing with a spring and damper on its hinge."""
    return replace(swing(), name="sprung_swing", forces=(JointSpring("hinge", 30.0, 4.0, 0.5),))


@cache
def sprung_ball() -> Scene:
    """Return the body on a ball joint, with a torsion spring and damper on the ball."""
    spring = BallSpring("ball", 20.0, 0.5, rest=(0.3, -0.2, 0.4))
    return replace(conical(), name="sprung_ball", forces=(spring,))


@cache
def tied_double() -> Scene:
    """Return the two bars with a spring and damper between points of both."""
    ends = (0.1, 0.1, 0.2), (0.7, -0.1, -0.3)
    spring = PointSpring("cord", "upper", "lower", *ends, stiffness=80.0, rest_length=0.5, damping=3.0)
    return replace(double(), name="tied_double", forces=(spring,))


@cache
def pushed_swing() -> Scene:
    """Return the swing with a wrench that is constant in the world and one that turns with the bar."""
    in_world = Wrench("push", "bar", (0.8, 0.3, -0.2), (4.0, -3.0, 6.0), (0.5, 2.0, -1.0))
    in_body = Wrench("thrust", "bar", (0.7, 0.0, 0.1), (-5.0, 2.0, 8.0), (1.0, -3.0, 0.5), frame="body")
    return replace(swing(), name="pushed_swing", forces=(in_world, in_body))


@cache
def windy_swing() -> Scene:
    """Return the swing with a plate on the bar in a wind that freshens."""
    wind = WindLoad(
        "wind",
        "bar",
        (0.6, 0.2, 0.1),
        first_side=(1.2, 0.0, 0.0),
        second_side=(0.0, 0.8, 0.6),
        direction=(1.0, 2.0, -2.0),
        speed=Polynomial((6.0, 10.0)),  # m/s and m/s^2
    )
    return replace(swing(), name="windy_swing", forces=(wind,))


@cache
def braked_slide() -> Scene:
    """Return the sliding body with dry friction, which the body exceeds all the time."""
    return replace(sliding(), name="braked_slide", forces=(JointFriction("slide", SLIDE_FRICTION),))


@cache
def stopped_slide() -> Scene:
    """Return the sliding body with an end stop, which the body reaches between two outputs."""
    stop = JointStop("slide", "high", limit=0.15, stiffness=400.0, dissipation=0.1)
    return replace(sliding(), name="stopped_slide", forces=(stop,))


@cache
def belted() -> Scene:
    """Return the two bars on parallel hinges with an elastic gear with play in place of the gear."""
    belt = ElasticGear(
        "belt",
        "at_left",
        "at_right",
        ratio=-2.0,
        stiffness=60.0,
        play=0.02,
        dissipation=0.1,
        forward_efficiency=0.9,
        backward_efficiency=0.8,
        transition_speed=0.1,
    )
    return replace(_without_gear("belted"), forces=(belt,))


@cache
def guided_slide() -> Scene:
    """Return the sliding body with the prescribed displacement `GUIDE`."""
    motion = PrescribedMotion("slide", GUIDE)
    return replace(sliding(), name="guided_slide", motions=(motion,), initial_state=None)


@cache
def guided_double() -> Scene:
    """Return the two bars with a prescribed angle of the shoulder."""
    motion = PrescribedMotion("shoulder", Sine(amplitude=0.3, angular_frequency=7.0))
    return replace(double(), name="guided_double", motions=(motion,))


@cache
def armed_slide() -> Scene:
    """Return the sliding body with a rotor on its slide."""
    return replace(sliding(), name="armed_slide", armatures=(Armature("slide", SLIDE_ROTOR),))


@cache
def armed_double() -> Scene:
    """Return the two bars with a rotor on the elbow, between two bodies that move."""
    return replace(double(), name="armed_double", armatures=(Armature("elbow", 0.1),))


@cache
def armed_ball() -> Scene:
    """Return the body on a ball joint, with a rotor on the ball."""
    return replace(conical(), name="armed_ball", armatures=(BallArmature("ball", 0.1),))


@cache
def cardan() -> Scene:
    """Return a body on a universal joint that turns about both axes."""
    on_first, on_second = SLIDE_AXIS, np.array([0.8, 0.0, 0.6])
    joint = Universal(
        "cross", "ground", "bar", np.array([0.1, 0.0, 0.1]), axis_on_first=on_first, axis_on_second=on_second
    )
    return _on_joint("cardan", joint, 2.0 * on_first - 1.5 * on_second, np.zeros(3))


@cache
def screwed() -> Scene:
    """Return a body on a screw that moves along its axis and turns about it."""
    pitch, rate = 0.2, 3.0  # m/rad, rad/s
    joint = Screw("nut", "ground", "bar", np.array([0.1, 0.0, 0.1]), axis=SLIDE_AXIS, pitch=pitch)
    return _on_joint("screwed", joint, rate * SLIDE_AXIS, pitch * rate * SLIDE_AXIS)


def _on_joint(name: str, joint: Joint, spin: Array, velocity: Array) -> Scene:
    """Return the body of the swing on another joint, with its angular velocity, rad/s, and the velocity of
    the joint's point on the body, m/s."""
    bar = body("bar", np.array([0.5, 0.2, -0.1]), np.diag([0.1, 0.3, 0.25]))
    arm = bar.center_of_mass - joint.point
    mechanism, state = moving(joint, bar, spin, velocity + np.cross(spin, arm))
    return Scene(name, mechanism, 0.4, 0.1, SKEW_GRAVITY, initial_state=state)


@cache
def rodded() -> Scene:
    """Return the two bars on parallel hinges with a rod between them in place of the gear."""
    rod = Rod("rod", "left", "right", (0.1, 0.2, -0.4), point_on_second=np.array([0.8, -0.1, -0.2]))
    scene = _without_gear("rodded")
    bodies, hinges = scene.mechanism.bodies, scene.mechanism.joints
    return replace(scene, mechanism=Mechanism(bodies, [*hinges, rod]))


def _without_gear(name: str) -> Scene:
    """Return the two bars on parallel hinges without the gear, under another name."""
    mechanism = geared().mechanism
    return replace(geared(), name=name, mechanism=Mechanism(mechanism.bodies, mechanism.joints))


SCENES: tuple[Callable[[], Scene], ...] = (
    *(swing, backward_swing, fast_swing, driven_swing, backward_drive, floating, conical),
    *(sliding, backward_slide, jumping, sampled, double, linkage, geared),
    *(sprung_slide, sprung_swing, sprung_ball, tied_double, pushed_swing, windy_swing),
    *(braked_slide, stopped_slide, belted, guided_slide, guided_double),
    *(armed_slide, armed_double, armed_ball, cardan, screwed, rodded),
)
"""Constructors of all scenes whose runs come to their end."""
