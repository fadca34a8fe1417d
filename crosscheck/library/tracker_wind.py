"""Scene of the solar tracker that moves its panel under gravity and wind.

The tracker tilts a panel by two sliders on vertical rails. `crosscheck.library.tracker` describes the tracker
and cites the paper that published it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

import numpy as np

from crosscheck.library.options import Between, OnlyWith
from crosscheck.library.tracker import PANEL, tracker_gravity
from newton_euler.model.control import PD
from newton_euler.model.motions import TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Sine
from newton_euler.model.wind import WindLoad, vertical_turbulence, wind_gust, wind_turbulence

WIND_POSITION_GAIN, WIND_VELOCITY_GAIN = 5000.0, 100.0
"""Gains of the PD controllers, N/m and N s/m: 100 and 5 times those of the paper.

With the gains of the paper the panel sags by decimeters under gravity."""

FEEDFORWARD = (7.056, 5.767)
"""Constant forces of the actuators, N, added to those of the PD controllers; they balance the weight at the
start.

Without these forces the tracker sags by a millimeter."""

STROKES = (0.02, 0.015)
"""Strokes of both sliders, m: from rest upwards and back."""

PERIODS = (5.0, 2.5)
"""Periods of the motion of both sliders, s."""

TURBULENCE_INTENSITY, SPEED_OFFSET = 0.14, 5.6
"""Turbulence of class B of IEC 61400-1 (2005): dimensionless intensity, and wind speed in m/s.

The standard deviation of the wind speed is TURBULENCE_INTENSITY (0.75 speed + SPEED_OFFSET)."""

TURBULENCE_LENGTH = 5.67 * 2.0
"""Length scale of turbulence, m, for an assumed height of 2 m above the ground. The factor 5.67 is the
standard's for hubs of wind turbines."""

FREQUENCY_BAND = (0.1, 5.0)
"""Lowest and highest frequency of the turbulence, Hz.

The lowest makes half a period in a run. Higher frequencies have little effect on the panel."""

SINE_COUNT = 16
"""Number of sines that make up the turbulence along the wind, and of those that make up the vertical one."""

UPWARD = [0.0, 0.0, 1.0]
"""Direction of the panel's normal in stow: the panel is flat."""

LOAD_CASES = {
    "operating": {"pose": "tilted", "wind": "steady", "speed": "14", "direction": "345"},
    "gust": {"pose": "tilted", "wind": "gust", "speed": "14", "direction": "345"},
    "stow_up": {"pose": "stow", "wind": "steady", "speed": "40", "direction": "345", "vertical": "10"},
    "stow_down": {"pose": "stow", "wind": "steady", "speed": "40", "direction": "345", "vertical": "-10"},
}
"""Default load cases of `crosscheck loads tracker_wind`: operating limit, gust, and survival in stow.

The speeds are examples: 14 m/s at which the tracker would be stowed, and a gust of 40 m/s that it has to
survive in stow, with a vertical gust in both directions. 10 m/s is three standard deviations of the vertical
turbulence at 40 m/s for an intensity of 17 % along the wind. Of all directions in steps of 15 degrees, 345
degrees has the largest force of an actuator in the tilted pose."""


def tracker_wind(
    wind: Literal["turbulent", "gust", "steady"] = "turbulent",
    speed: Annotated[float, Between(0.0, 60.0, "m/s")] = 10.0,
    direction: Annotated[float, Between(0.0, 360.0, "deg")] = 30.0,
    seed: Annotated[int, range(1000), OnlyWith("wind", "turbulent")] = 1,
    vertical: Annotated[float, Between(-20.0, 20.0, "m/s"), OnlyWith("wind", "steady")] = 0.0,
    pose: Literal["moving", "tilted", "stow"] = "moving",
) -> Scene:
    """Return the tracker under gravity and wind, its sliders moved or held by stiff PD laws, 5 s.

    Args:
        wind: turbulent along the wind and vertically, one gust of half the mean speed, or steady.
        speed: mean speed of the wind, m/s.
        direction: direction to which the wind blows, degrees from the x axis about the vertical.
        seed: random seed of the turbulence.
        vertical: upward component of a steady wind, m/s, such as the vertical gust that loads a flat panel.
        pose: both sliders move up and down, hold the panel as tilted at the start, or hold it flat.
    """
    scene = tracker_gravity()
    panel = scene.mechanism.body("panel_7")
    # `PANEL`: half the lengths of the panel's sides, which are along the first two axes of its body frame
    axes, angle = panel.pose.rotation, np.radians(direction)
    load = WindLoad(
        "wind",
        panel.name,
        panel.center_of_mass,
        first_side=2.0 * PANEL[0] * axes[:, 0],
        second_side=2.0 * PANEL[1] * axes[:, 1],
        direction=[np.cos(angle), np.sin(angle), 0.0],
        speed=_speed(wind, speed, seed),
        vertical_speed=_vertical_speed(speed, seed) if wind == "turbulent" else vertical,
    )
    description = "dual-axis solar tracker, stiff PD control along a motion, under gravity and wind"
    scene = replace(scene, name="tracker_wind", description=description)
    if pose != "moving":
        return _held(replace(scene, forces=(load,)), flat=pose == "stow")
    control = tuple(
        PD(
            law.joint,
            WIND_POSITION_GAIN,
            WIND_VELOCITY_GAIN,
            target=up_and_down(stroke, period),
            feedforward=force,
        )
        for law, stroke, period, force in zip(scene.control, STROKES, PERIODS, FEEDFORWARD, strict=True)
    )
    return replace(scene, control=control, forces=(load,))


def _held(scene: Scene, flat: bool) -> Scene:
    """Return the tracker at rest, held by PD laws in its initial pose or with a flat panel.

    The laws feed forward the forces of equilibrium with the weight and the wind at time 0, so that the run
    starts without a transient.
    """
    # imported here, since other scenes need no kinematics
    from newton_euler import Axis, initial_state, solve_poses, statics

    start, targets = initial_state(scene), [0.0] * len(scene.control)
    if flat:
        keys = [law.key for law in scene.control]
        normal = Axis("panel_7", np.array([0.0, 0.0, 1.0]))
        poses = solve_poses(scene, axis=normal, towards=[UPWARD], measure=keys)
        start, targets = poses.state(0), [float(poses.coordinates[key][0]) for key in keys]
    forces = statics(scene, start).actuator_force
    control = tuple(
        PD(law.joint, WIND_POSITION_GAIN, WIND_VELOCITY_GAIN, target=target, feedforward=float(force))
        for law, target, force in zip(scene.control, targets, forces, strict=True)
    )
    description = "dual-axis solar tracker, panel held by stiff PD control, under gravity and wind"
    return replace(scene, description=description, control=control, initial_state=start)


def up_and_down(stroke: float, period: float) -> Sine:
    """Return a motion from 0 to a stroke (m) and back in a period (s), starting at rest."""
    return Sine(-0.5 * stroke, angular_frequency=2.0 * np.pi / period, phase=0.5 * np.pi, offset=0.5 * stroke)


def _speed(wind: str, speed: float, seed: int) -> float | TimeFunction:
    """Return the wind's speed, m/s, constant or over time; arguments as of `tracker_wind`."""
    if wind == "steady" or speed == 0.0:
        return speed
    if wind == "gust":
        return wind_gust(speed, gust=0.5 * speed, period=5.0)
    return wind_turbulence(speed, _deviation(speed), TURBULENCE_LENGTH, seed, *FREQUENCY_BAND, SINE_COUNT)


def _vertical_speed(speed: float, seed: int) -> float | TimeFunction:
    """Return the vertical speed of turbulent wind, m/s; arguments as of `tracker_wind`."""
    if speed == 0.0:
        return 0.0
    return vertical_turbulence(speed, _deviation(speed), TURBULENCE_LENGTH, seed, *FREQUENCY_BAND, SINE_COUNT)


def _deviation(speed: float) -> float:
    """Return the standard deviation, m/s, of a turbulent wind with a mean speed in m/s."""
    return TURBULENCE_INTENSITY * (0.75 * speed + SPEED_OFFSET)
