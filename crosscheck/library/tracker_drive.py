"""Scene of the solar tracker with motors and lead screws: friction, play and stops.

The sliders are two carriages on vertical rails, which tilt the panel (`crosscheck.library.tracker`). Each has
the shaft of a motor beside its rail and a self-locking lead screw. The numbers of the drives are typical of
small stepper motors with trapezoidal screws; the paper has none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np

from crosscheck.library.options import Between
from crosscheck.library.tracker import tracker_gravity
from crosscheck.library.tracker_wind import PERIODS, STROKES, up_and_down
from newton_euler.analysis.loads.power_screws import Thread
from newton_euler.model.control import PD
from newton_euler.model.forces import Force
from newton_euler.model.geometry import Capsule
from newton_euler.model.joint_kinds import Revolute
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Sine
from newton_euler.model.switched_forces import ElasticGear, JointFriction, JointStop

LEAD, PITCH_DIAMETER = 0.002, 0.007
"""Travel of the nut in a revolution, and mean diameter of the thread, m."""

RATIO = LEAD / (2.0 * np.pi)
"""Travel of the nut, m/rad."""

NUT_STIFFNESS, NUT_DISSIPATION = 5e4, 5.0
"""Stiffness of a screw with its nut, N/m, and coefficient of their damping, s/m."""

SCREW_TRANSITION_SPEED = 1e-3
"""Speed of the nut, m/s, below which the friction of the thread falls."""

ROTOR_INERTIA = 2e-6
"""Moment of inertia of a motor's rotor with its shaft and screw, kg m^2; 20 kg at the slider."""

SHAFT_MASS, SHAFT_LENGTH, SHAFT_RADIUS = 0.04, 0.1, 0.003
"""Mass of a shaft, kg, its length, and its radius for drawing, m."""

BEARING_FRICTION, BEARING_TRANSITION_SPEED = 1e-3, 2.0
"""Dry friction of the bearings of a shaft and of its motor, N m, and its transition speed, rad/s."""

RAIL_FRICTION, RAIL_STRIBECK = 0.4, 0.2
"""Coulomb friction of a slider on its rail, and its additional friction in slow motion, N."""

RAIL_STRIBECK_SPEED, RAIL_TRANSITION_SPEED = 0.01, 2e-3
"""Speeds of the friction of a slider, m/s."""

TRAVEL = (-0.02, 0.07)
"""Coordinates of a slider at its stops, m from the initial pose. They leave room for a day of the sun."""

STOP_STIFFNESS, STOP_DISSIPATION = 1e5, 1.0
"""Stiffness of a stop, N/m, and coefficient of its damping, s/m."""

ANGLE_GAIN, RATE_GAIN = 0.03, 5e-4
"""Gains of the motors' PD controllers, N m/rad and N m s/rad: 20 Hz with the inertia of the rotor."""


def tracker_drive(
    friction: Annotated[float, Between(0.0, 0.5, "")] = 0.15,
    play: Annotated[float, Between(0.0, 1e-3, "m")] = 5e-5,
) -> Scene:
    """Return the tracker under gravity, moved up and down by motors with lead screws, 2.5 s.

    The controllers measure the angles of the motors, as encoders on their shafts do.

    Args:
        friction: coefficient of friction in the threads of the screws; below 0.091 they are not self-locking.
        play: free travel of the nuts.
    """
    scene = tracker_gravity()
    sliders = [law.joint for law in scene.control]
    parts = [_shaft(scene, slider) for slider in sliders]
    mechanism = Mechanism(
        (*scene.mechanism.bodies, *(shaft for shaft, _ in parts)),
        (*scene.mechanism.joints, *(bearing for _, bearing in parts)),
    )
    control, forces = list[PD](), list[Force]()
    for slider, (_, bearing), stroke, period in zip(sliders, parts, STROKES, PERIODS, strict=True):
        target = up_and_down(stroke, period)
        angle = Sine(target.amplitude / RATIO, target.angular_frequency, target.phase, target.offset / RATIO)
        control.append(PD(bearing.name, ANGLE_GAIN, RATE_GAIN, target=angle))
        forces += _drive(slider, bearing.name, Thread(LEAD, PITCH_DIAMETER, friction), play)
    return replace(
        scene,
        name="tracker_drive",
        description="dual-axis solar tracker moved by lead screws with friction, play and stops",
        mechanism=mechanism,
        duration=PERIODS[1],
        control=tuple(control),
        forces=tuple(forces),
    )


def _shaft(scene: Scene, slider: str) -> tuple[Body, Revolute]:
    """Return the shaft of a slider's motor, a body beside the rail, and its bearing on the ground."""
    joint = scene.mechanism.joint(slider)
    name = slider.removeprefix("slide_1")  # slide_12 has the rail of body 2
    foot, top = joint.point * [1.0, 1.0, 0.0], joint.point * [1.0, 1.0, 0.0] + [0.0, 0.0, SHAFT_LENGTH]
    across = 0.5 * SHAFT_MASS * SHAFT_RADIUS**2 + SHAFT_MASS * SHAFT_LENGTH**2 / 12.0
    shaft = Body(
        f"shaft_{name}",
        SHAFT_MASS,
        0.5 * (foot + top),
        np.diag([across, across, ROTOR_INERTIA]),
        shapes=(Capsule(foot, top, SHAFT_RADIUS),),
    )
    ground = scene.mechanism.body_names[0]
    bearing = Revolute(f"motor_{name}", ground, shaft.name, foot, axis=[0.0, 0.0, 1.0], actuated=True)
    return shaft, bearing


def _drive(slider: str, motor: str, screw: Thread, play: float) -> Sequence[Force]:
    """Return the screw between the motor's shaft and the slider, the friction of both, and the stops."""
    low, high = TRAVEL
    return (
        ElasticGear(
            f"screw_{slider.removeprefix('slide_1')}",
            motor,
            slider,
            RATIO,
            NUT_STIFFNESS,
            play,
            NUT_DISSIPATION,
            screw.efficiency,
            screw.back_efficiency,
            SCREW_TRANSITION_SPEED,
        ),
        JointFriction(motor, BEARING_FRICTION, transition_speed=BEARING_TRANSITION_SPEED),
        JointFriction(slider, RAIL_FRICTION, RAIL_STRIBECK, RAIL_STRIBECK_SPEED, RAIL_TRANSITION_SPEED),
        JointStop(slider, "low", low, STOP_STIFFNESS, STOP_DISSIPATION),
        JointStop(slider, "high", high, STOP_STIFFNESS, STOP_DISSIPATION),
    )
