"""The tracker as it moves its panel in the wind, under its own weight."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

import numpy as np

from crosscheck.scenes.options import Beside, Between
from crosscheck.scenes.tracker import PANEL, tracker_gravity
from newton_euler.model.control import PD
from newton_euler.model.motions import TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Sine
from newton_euler.model.wind import WindLoad, wind_gust, wind_turbulence

STIFFNESS, DAMPING = 5000.0, 100.0
"""N/m and N s/m, a hundred and five times the paper's, whose gains let the panel sag by decimetres."""

WEIGHT = (7.056, 5.767)
"""N, feedforward of the actuators: what holds the tracker at the start, where stiff laws alone would sag by a
millimetre."""

STROKE = (0.02, 0.015)
"""m that the sliders are sent up and down by, from rest."""

PERIODS = (5.0, 2.5)
"""s, of their strokes."""

INTENSITY, LEAST = 0.14, 5.6
"""Of turbulence, for a deviation of INTENSITY (0.75 speed + LEAST m/s): class B of IEC 61400-1 (2005)."""

LENGTH = 5.67 * 2.0
"""m, of turbulence 2 m above the ground, where the tracker is taken to stand: an assumption, as 5.67 times
the height is the standard's for hubs of wind turbines."""

BAND = (0.1, 5.0)
"""Hz, of turbulence: from half a period of the run to what moves the panel little."""

SINES = 16
"""Of turbulence."""


def tracker_wind(
    wind: Literal["turbulent", "gust", "steady"] = "turbulent",
    speed: Annotated[float, Between(0.0, 60.0, "m/s")] = 10.0,
    direction: Annotated[float, Between(0.0, 360.0, "deg")] = 30.0,
    seed: Annotated[int, range(1000), Beside("wind", "turbulent")] = 1,
) -> Scene:
    """The tracker under gravity and wind, its sliders sent up and down by stiff PD laws, 5 s.

    Args:
        wind: turbulent, one gust of half the speed, or steady.
        speed: m/s, its mean.
        direction: degrees from the x axis about the vertical that the wind blows to.
        seed: of turbulence.
    """
    scene = tracker_gravity()
    panel = scene.mechanism.body("panel_7")
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
        PD(law.joint, STIFFNESS, DAMPING, _up_and_down(stroke, period), feedforward=weight)
        for law, stroke, period, weight in zip(scene.control, STROKE, PERIODS, WEIGHT, strict=True)
    )
    description = "dual-axis solar tracker, stiff PD control along a motion, under gravity and wind"
    return replace(scene, name="tracker_wind", description=description, control=control, forces=(load,))


def _up_and_down(stroke: float, period: float) -> Sine:
    """Go from 0 to a stroke, m, and back in a period, s, beginning at rest."""
    return Sine(-0.5 * stroke, 2.0 * np.pi / period, 0.5 * np.pi, offset=0.5 * stroke)


def _speed(wind: str, speed: float, seed: int) -> float | TimeFunction:
    if wind == "steady" or speed == 0.0:
        return speed
    if wind == "gust":
        return wind_gust(speed, 0.5 * speed, period=5.0)
    deviation = INTENSITY * (0.75 * speed + LEAST)
    return wind_turbulence(speed, deviation, LENGTH, seed, *BAND, SINES)
