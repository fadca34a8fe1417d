"""Scenes of the points of the contract: each as small as its point allows.

The scenes have no symmetries that would hide a wrong convention: axes are skew, body frames are turned, and
bodies move already at the start. Scenes are constructed once, because engines keep the code and the last run
of a scene.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

from newton_euler.model.control import PD
from newton_euler.model.couplings import Gear
from newton_euler.model.digital_control import Controller, Sampled
from newton_euler.model.euler_parameters import from_rotation_vector, rotation
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import Free, Prismatic, Revolute, Spherical
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.splines import Steps
from newton_euler.model.state import State
from newton_euler.scalars import Array

GRAVITY = np.array([0.0, 0.0, -9.81])
"""Gravity of scenes that need not be skew, m/s^2."""

SKEW_GRAVITY = np.array([0.5, 0.3, -9.81])
"""Gravity of scenes whose bodies would else move in a coordinate plane, m/s^2."""

TURN = from_rotation_vector(np.array([0.7, -0.4, 0.9]))
"""Orientation of body frames at the start: a rotation about no axis of the world."""

SHORT_STEP = 2e-4
"""Step of short runs at fixed steps, s: a method of order 2 errs by 2e-5 in the fast swing."""

SLIDE_AXIS = np.array([0.48, 0.6, -0.64])
"""Unit vector along which bodies slide."""

SLIDE_STIFFNESS, SLIDE_DAMPING = 240.0, 6.0
"""Gains of controllers of a slide, N/m and N s/m: an oscillation of about 12 rad/s that decays."""

JUMP_TIME, SET_POINTS = 0.153, (0.05, -0.15)
"""Time at which a set-point jumps, s, and the set-points before and after it, m. The time is no output and no
multiple of a usual step."""

SAMPLING_PERIOD = 0.07
"""Sampling period of a controller, s; outputs at multiples of 0.1 s are no samples, except the start."""

FAILURE_TIME = SAMPLING_PERIOD
"""Time of the sample at which a controller fails, s: the second one, between two outputs at multiples of 0.03
s."""


def body(name: str, center: Array, moments: Array) -> Body:
    """Return a body of 2 kg with a turned frame.

    Args:
        name: name of the body.
        center: (3,) m, center of mass.
        moments: (3, 3) kg m^2, inertia about the center of mass in the world frame.
    """
    turn = rotation(TURN)
    inertia = turn.T @ moments @ turn
    return Body(name, 2.0, center, 0.5 * (inertia + inertia.T), TURN)


def moving(joint: Joint, bar: Body, spin: Array, velocity: Array) -> tuple[Mechanism, State]:
    """Return the mechanism of one body on one joint, and its state of the initial pose with velocities.

    Args:
        joint: the joint.
        bar: the body.
        spin: (3,) rad/s, angular velocity.
        velocity: (3,) m/s, velocity of the center of mass.
    """
    mechanism = Mechanism([Body.ground(), bar], [joint])
    state = State.initial(mechanism)
    state.angular_velocity[1], state.linear_velocity[1] = spin, velocity
    return mechanism, state


@cache
def swing() -> Scene:
    """Return a bar on a skew hinge, 0.4 s of its motion."""
    return _swing("ground", "bar", "swing")


@cache
def backward_swing() -> Scene:
    """Return the swing with the ground as the second body of the hinge."""
    return _swing("bar", "ground", "backward_swing")


def _swing(first: str, second: str, name: str) -> Scene:
    """Return a bar on a skew hinge between two bodies, by name."""
    bar = body("bar", np.array([0.5, 0.2, -0.1]), np.diag([0.1, 0.3, 0.25]))
    hinge = Revolute("hinge", first, second, np.array([0.1, 0.0, 0.1]), axis=np.array([0.2, 1.0, 0.1]))
    spin = 1.5 * hinge.axis
    mechanism, state = moving(hinge, bar, spin, np.cross(spin, bar.center_of_mass - hinge.point))
    return Scene(name, mechanism, 0.4, 0.1, SKEW_GRAVITY, initial_state=state)


@cache
def fast_swing() -> Scene:
    """Return 0.1 s of the swing in 1000 times the gravity.

    The bar turns at up to 100 rad/s: at such a speed, errors of integration are far above round-off, 4e-11 of
    the reach for adaptive steps and 3e-4 for a method of order 2 at 0.2 ms.
    """
    gravity = 1000.0 * SKEW_GRAVITY
    return replace(swing(), name="fast_swing", gravity=gravity, duration=0.1, output_period=0.025)


@cache
def short_swing(steps: int) -> Scene:
    """Return the first part of the fast swing, a number of steps of `SHORT_STEP` long."""
    duration = steps * SHORT_STEP
    return replace(fast_swing(), name="short_swing", duration=duration, output_period=0.5 * duration)


@cache
def bare(scene: Scene) -> Scene:
    """Return a scene without its optional outputs."""
    return replace(scene, name=f"bare_{scene.name}", outputs=frozenset())


@cache
def driven_swing() -> Scene:
    """Return the swing with a PD law on its hinge."""
    return _with_law(swing(), "driven_swing", 1.0)


@cache
def backward_drive() -> Scene:
    """Return the swing with a PD law and the ground as the second body of the hinge. The bar moves as in
    `driven_swing`: angle, set-point and torque have the other sign."""
    return _with_law(backward_swing(), "backward_drive", -1.0)


def _with_law(scene: Scene, name: str, sign: float) -> Scene:
    """Return a swing with a PD law whose set-point and feedforward have a sign."""
    (hinge,) = scene.mechanism.joints
    mechanism = Mechanism(scene.mechanism.bodies, [replace(hinge, actuated=True)])
    law = PD("hinge", 30.0, 4.0, 0.5 * sign, feedforward=3.0 * sign)
    return replace(scene, name=name, mechanism=mechanism, control=(law,))


@cache
def floating() -> Scene:
    """Return a body of two equal moments of inertia that flies freely and turns about a skew axis.

    Its axis of symmetry is (2, -1, 2) / 3 at the start.
    """
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    bar = body("bar", np.array([0.3, -0.2, 0.4]), 0.3 * np.eye(3) - 0.2 * np.outer(axis, axis))
    joint = Free("float", "ground", "bar", np.zeros(3))
    mechanism, state = moving(joint, bar, np.array([2.0, 3.0, -1.0]), np.array([0.4, -0.3, 1.0]))
    return Scene("floating", mechanism, 0.4, 0.1, SKEW_GRAVITY, initial_state=state)


@cache
def conical() -> Scene:
    """Return a body on a ball joint that turns steadily about the vertical through the joint.

    The body has two equal moments of inertia about the joint. Its axis of symmetry leans by 0.6 rad.
    """
    lean, length, across, along = 0.6, 0.5, 0.2, 0.05
    axis = np.array([0.6 * np.sin(lean), 0.8 * np.sin(lean), -np.cos(lean)])
    moments = across * np.eye(3) + (along - across) * np.outer(axis, axis)
    point = np.array([0.1, 0.3, -0.2])
    bar = body("bar", point + length * axis, moments)
    # the moment of the weight changes the direction of the angular momentum: Goldstein, section 5.7
    about_ball = across + bar.mass * length**2
    rate = np.sqrt(bar.mass * 9.81 * length / ((about_ball - along) * np.cos(lean)))
    spin = np.array([0.0, 0.0, rate])
    joint = Spherical("ball", "ground", "bar", point)
    mechanism, state = moving(joint, bar, spin, np.cross(spin, length * axis))
    return Scene("conical", mechanism, 0.4, 0.1, GRAVITY, initial_state=state)


@cache
def sliding() -> Scene:
    """Return a body on a skew slide, which its weight accelerates."""
    return _sliding("ground", "bar", "sliding")


@cache
def backward_slide() -> Scene:
    """Return the sliding body with the ground as the second body of the slide."""
    return _sliding("bar", "ground", "backward_slide")


def _sliding(first: str, second: str, name: str) -> Scene:
    """Return a sliding body with two bodies of its joint, by name."""
    bar = body("bar", np.array([0.3, 0.1, -0.2]), np.diag([0.1, 0.3, 0.25]))
    joint = Prismatic("slide", first, second, np.array([0.1, 0.0, 0.1]), axis=SLIDE_AXIS, actuated=True)
    mechanism, state = moving(joint, bar, np.zeros(3), 0.8 * SLIDE_AXIS)
    return Scene(name, mechanism, 0.4, 0.1, SKEW_GRAVITY, initial_state=state)


@cache
def jumping() -> Scene:
    """Return the sliding body with a PD law whose set-point jumps at `JUMP_TIME`."""
    law = PD("slide", SLIDE_STIFFNESS, SLIDE_DAMPING, Steps((0.0, JUMP_TIME), SET_POINTS))
    return replace(sliding(), name="jumping", control=(law,))


def sampled_force(time: float, x: float, x_rate: float) -> float:
    """Return the force, N, of a controller at a time, s, from its coordinate, m, and its rate, m/s."""
    return -SLIDE_STIFFNESS * x - SLIDE_DAMPING * x_rate + 20.0 * time


@cache
def sampled() -> Scene:
    """Return the sliding body with a controller that is called once a period."""
    return _with_controller("sampled", lambda time, x, x_rate: sampled_force(time, x[0], x_rate[0]))


@cache
def stopping() -> Scene:
    """Return the sliding body whose controller returns no number from `FAILURE_TIME` on."""

    def failing(time: float, x: Array, x_rate: Array) -> float:
        if time > 0.5 * FAILURE_TIME:
            return float("nan")
        return sampled_force(time, float(x[0]), float(x_rate[0]))

    return replace(_with_controller("stopping", failing), duration=0.42, output_period=0.03)


def _with_controller(name: str, controller: Controller) -> Scene:
    """Return the sliding body with a sampled controller."""
    return replace(sliding(), name=name, control=(Sampled("slide", controller, SAMPLING_PERIOD),))


@cache
def geared() -> Scene:
    """Return two bars on parallel hinges that a gear couples."""
    places = {"left": np.zeros(3), "right": np.array([1.0, 0.0, 0.0])}
    down, beside = np.array([0.0, 0.0, -0.3]), np.array([0.2, 0.0, 0.0])
    bars = [Body(name, 1.0, place + down, 0.02 * np.eye(3)) for name, place in places.items()]
    axis = np.array([0.0, 1.0, 0.0])
    hinges = [
        Revolute(f"at_{name}", "ground", name, place - beside, axis=axis) for name, place in places.items()
    ]
    mechanism = Mechanism([Body.ground(), *bars], hinges, [Gear("mesh", "at_left", "at_right", -2.0)])
    return Scene("geared", mechanism, 0.3, 0.1, GRAVITY)


@cache
def linkage() -> Scene:
    """Return a four-bar linkage of three unequal bars, which a loop closes, released at rest."""
    y = np.array([0.0, 1.0, 0.0])
    corners = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.4], [0.9, 0.0, 0.6], [1.0, 0.0, 0.0]])
    names, bodies = ("crank", "coupler", "rocker"), [Body.ground()]
    for k, name in enumerate(names):
        bodies.append(Body(name, 1.0, 0.5 * (corners[k] + corners[k + 1]), 0.02 * np.eye(3)))
    around = ("ground", *names, "ground")
    hinges = [Revolute(f"hinge_{k}", around[k], around[k + 1], corners[k], axis=y) for k in range(4)]
    return Scene("linkage", Mechanism(bodies, hinges), 0.3, 0.1, GRAVITY)


@cache
def double() -> Scene:
    """Return two bars that hang from each other on parallel hinges, with inertias about skew axes."""
    skew = rotation(from_rotation_vector(np.array([0.2, 0.5, -0.3])))
    inertia = skew @ np.diag([0.02, 0.05, 0.06]) @ skew.T
    y = np.array([0.0, 1.0, 0.0])
    centers = {"upper": np.array([0.3, 0.0, 0.0]), "lower": np.array([0.6, 0.05, -0.2])}
    turned = from_rotation_vector(np.array([0.4, 0.1, -0.6]))
    bars = [Body(name, 1.5, center, 0.5 * (inertia + inertia.T), turned) for name, center in centers.items()]
    hinges = [
        Revolute("shoulder", "ground", "upper", np.zeros(3), axis=y),
        Revolute("elbow", "upper", "lower", np.array([0.6, 0.0, 0.0]), axis=-y),
    ]
    return Scene("double", Mechanism([Body.ground(), *bars], hinges), 0.3, 0.1, GRAVITY)


ONE_BODY: tuple[Callable[[], Scene], ...] = (swing, sliding, floating, conical)
"""Constructors of scenes of one body on one joint. Conventions that do not depend on the joint are checked on
the first of these scenes that an engine can express."""
