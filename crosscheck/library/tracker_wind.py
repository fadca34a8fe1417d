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
from newton_euler.model.wind import WindLoad, wind_gust, wind_turbulence

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
"""Number of sines that make up the turbulence."""


def tracker_wind(
    wind: Literal["turbulent", "gust", "steady"] = "turbulent",
    speed: Annotated[float, Between(0.0, 60.0, "m/s")] = 10.0,
    direction: Annotated[float, Between(0.0, 360.0, "deg")] = 30.0,
    seed: Annotated[int, range(1000), OnlyWith("wind", "turbulent")] = 1,
) -> Scene:
    """Return the tracker under gravity and wind, both sliders moved up and down by stiff PD laws, 5 s.

    Args:
        wind: turbulent, one gust of half the mean speed, or steady.
        speed: mean speed of the wind, m/s.
        direction: direction to which the wind blows, degrees from the x axis about the vertical.
        seed: random seed of the turbulence.
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
    )
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
    description = "dual-axis solar tracker, stiff PD control along a motion, under gravity and wind"
    return replace(scene, name="tracker_wind", description=description, control=control, forces=(load,))


def up_and_down(stroke: float, period: float) -> Sine:
    """Return a motion from 0 to a stroke (m) and back in a period (s), starting at rest."""
    return Sine(-0.5 * stroke, angular_frequency=2.0 * np.pi / period, phase=0.5 * np.pi, offset=0.5 * stroke)


def _speed(wind: str, speed: float, seed: int) -> float | TimeFunction:
    """Return the wind's speed, m/s, constant or over time; arguments as of `tracker_wind`."""
    if wind == "steady" or speed == 0.0:
        return speed
    if wind == "gust":
        return wind_gust(speed, gust=0.5 * speed, period=5.0)
    deviation = TURBULENCE_INTENSITY * (0.75 * speed + SPEED_OFFSET)
    return wind_turbulence(speed, deviation, TURBULENCE_LENGTH, seed, *FREQUENCY_BAND, SINE_COUNT)
