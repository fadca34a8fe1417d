"""Stress cases of overconstrained mechanisms whose joint axes and points have the noise of CAD exports.

Overconstrained mechanisms move only if their dimensions are exact, such as parallel axes. With rounded
numbers an engine must recognize redundant constraints, or the mechanism locks. Each case compares the motion
of a noisy mechanism, in one engine at one setting, with the motion of the exact mechanism. `topics.py` lists
these cases as topic (j).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from crosscheck.engines.engine import Engine
from crosscheck.library import load
from crosscheck.studies.stress.cases import Bound, Case, Measurement
from crosscheck.studies.stress.runs import (
    REFERENCE_SETTING,
    Setting,
    largest_distance,
    settings_of,
    with_duration,
)
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import Fixed, Revolute, Spherical
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene

BODY_INERTIA = 0.01 * np.eye(3)
"""Inertia matrix of the bodies, kg m^2."""

X, Y, Z = np.eye(3)
"""Unit vectors (3,) along the axes of the world frame; positions below are multiples of them, m."""

NOISES = (1e-12, 1e-10, 1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3)
"""Largest errors of joint axes, rad, and of joint points, m. The largest noise exceeds the tolerance of
redundant constraints and locks the mechanisms."""

NOISE_SENSITIVITY = 20.0
"""Allowed change of a position, m, divided by the noise, rad or m: a rounded estimate. The noise acts on
levers of 0.1 m, and turns bodies of 0.4 m, which move by up to 1.5 rad."""


def flat_four_bar(tilt: float, duration: float = 0.3) -> Scene:
    """Return a four-bar parallelogram of hinges along y, closed by a weld, for `duration`, s.

    The axis of one hinge is tilted out of its direction by `tilt`, rad. Gravity has a horizontal component of
    3 m/s^2, so that the linkage moves.
    """
    elbow, wrist, foot = 0.2 * Z, 0.4 * X + 0.2 * Z, 0.4 * X
    bodies = [
        Body.ground(),
        Body("crank", 1.0, 0.1 * Z, BODY_INERTIA),
        Body("coupler", 1.0, elbow + 0.2 * X, BODY_INERTIA),
        Body("rocker", 1.0, wrist - 0.1 * Z, BODY_INERTIA),
        Body("foot", 1.0, foot + 0.01 * Z, BODY_INERTIA),
    ]
    joints = [
        Revolute("motor", "ground", "crank", 0.0 * Z, axis=Y),
        Revolute("elbow", "crank", "coupler", elbow, axis=Y),
        Revolute("wrist", "coupler", "rocker", wrist, axis=Y + tilt * Z),
        Revolute("pivot", "ground", "foot", foot, axis=Y),
        Fixed("weld", "rocker", "foot", foot),
    ]
    gravity = 3.0 * X - 9.81 * Z
    return Scene("flat_four_bar", Mechanism(bodies, joints), duration, output_period=0.01, gravity=gravity)


def sarrus(noise: float) -> Scene:
    """Return Sarrus' linkage with noise: two legs of three parallel hinges guide a plate straight up.

    The hinges of one leg are along x, those of the other along y. `noise` is as for `noisy`.
    """
    bodies, joints = [Body.ground(), Body("plate", 1.0, 0.6 * Z, BODY_INERTIA)], list[Joint]()
    for leg, axis, out in (("a", X, Y), ("b", Y, X)):
        foot, knee, hip = 0.5 * out, 0.7 * out + 0.3 * Z, 0.5 * out + 0.6 * Z
        bodies.append(Body(f"shin_{leg}", 0.5, 0.5 * (foot + knee), BODY_INERTIA))
        bodies.append(Body(f"thigh_{leg}", 0.5, 0.5 * (knee + hip), BODY_INERTIA))
        joints.append(Revolute(f"foot_{leg}", "ground", f"shin_{leg}", foot, axis=axis))
        joints.append(Revolute(f"knee_{leg}", f"shin_{leg}", f"thigh_{leg}", knee, axis=axis))
        joints.append(Revolute(f"hip_{leg}", f"thigh_{leg}", "plate", hip, axis=axis))
    mechanism = Mechanism(bodies, joints)
    scene = Scene("sarrus", mechanism, duration=0.3, output_period=0.01, gravity=-9.81 * Z)
    return noisy(scene, noise)


def double_wishbone(noise: float) -> Scene:
    """Return a car's double wishbone suspension with noise, as for `noisy`.

    Each of the two arms has two coaxial hinges, which add five redundant constraints.
    """
    bodies = [
        Body.ground(),
        Body("lower", 2.0, 0.2 * X, BODY_INERTIA),
        Body("upper", 1.5, 0.2 * X + 0.25 * Z, BODY_INERTIA),
        Body("upright", 5.0, 0.42 * X + 0.12 * Z, BODY_INERTIA),
    ]
    joints: list[Joint] = [
        Revolute(f"{arm}_{end}", "ground", arm, side * Y + height * Z, axis=Y)
        for arm, height in (("lower", 0.0), ("upper", 0.25))
        for end, side in (("front", 0.15), ("rear", -0.15))
    ]
    joints.append(Spherical("ball_lower", "lower", "upright", 0.4 * X))
    joints.append(Spherical("ball_upper", "upper", "upright", 0.38 * X + 0.25 * Z))
    mechanism = Mechanism(bodies, joints)
    scene = Scene("double_wishbone", mechanism, duration=0.3, output_period=0.01, gravity=-9.81 * Z)
    return noisy(scene, noise)


def bricard(noise: float) -> Scene:
    """Return Bricard's linkage of the scene library with noise, as for `noisy`, for 0.3 s."""
    return noisy(replace(load("bricard"), duration=0.3), noise)


def noisy(scene: Scene, noise: float) -> Scene:
    """Return the scene with random errors of joint axes and points, the same in each call.

    Components are distributed uniformly between -`noise` and `noise`, rad for axes and m for points.
    """
    rng = np.random.default_rng(0)
    joints = []
    for joint in scene.mechanism.joints:
        point = joint.point + noise * rng.uniform(-1.0, 1.0, 3)
        axes = {name: getattr(joint, name) + noise * rng.uniform(-1.0, 1.0, 3) for name in joint.axis_names}
        joints.append(replace(joint, point=point, point_on_second=point, **axes))
    mechanism = Mechanism(scene.mechanism.bodies, joints, scene.mechanism.couplings)
    return replace(scene, mechanism=mechanism, initial_state=None)


MECHANISMS: dict[str, Callable[[float], Scene]] = {
    build.__name__: build for build in (flat_four_bar, sarrus, double_wishbone, bricard)
}
"""Function of the noise that makes a mechanism, by name."""


def cases(full: bool, engines: Sequence[Engine]) -> Iterator[Case]:
    """Yield all cases or, unless `full`, a few of them."""
    reason = "the effect of the noise; beyond a centimeter the motion is a different one"
    errors = {engine.name: engine.stress().position_error for engine in engines}
    for name in MECHANISMS if full else ("flat_four_bar", "bricard"):
        settings = settings_of(engines, "noise" if full and name == "flat_four_bar" else None)
        for noise in NOISES if full else (1e-12, 1e-6):
            for setting in settings:
                largest = errors[setting.engine] + NOISE_SENSITIVITY * noise
                bound = Bound("distance to the design", "m", survives=largest, degrades=1e-2, reason=reason)
                yield Case(f"{name}, noise {noise:.0e}, 0.3 s", setting, bound, partial(measure, name, noise))


def measure(name: str, noise: float, setting: Setting) -> Measurement:
    """Measure the largest distance, m, between the motion of a noisy mechanism and the exact motion."""
    design, scene = (with_duration(MECHANISMS[name](size), 0.3, periods=10) for size in (0.0, noise))
    return Measurement(largest_distance(setting.simulate(scene), REFERENCE_SETTING.simulate(design)))
