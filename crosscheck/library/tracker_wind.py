"""Scene of the solar tracker that moves its panel under gravity and wind.

The tracker tilts a panel by two sliders on vertical rails. `crosscheck.library.tracker` describes the tracker
and cites the paper that published it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

import numpy as np

from crosscheck.library.options import Between, OnlyWith
from crosscheck.library.tracker import tracker_gravity
from crosscheck.library.tracker_panel import HEIGHT, MASS, WIDTH, Mass, Side, with_panel
from newton_euler.model.control import PD
from newton_euler.model.motions import TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Sine
from newton_euler.model.wind import WindLoad, vertical_turbulence, wind_gust, wind_turbulence
from newton_euler.scalars import Array

WIND_POSITION_GAIN, WIND_VELOCITY_GAIN = 5000.0, 100.0
"""Gains of the PD controllers, N/m and N s/m: 100 and 5 times those of the paper.

With the gains of the paper the panel sags by decimeters under gravity."""

HOLD_POSITION_GAIN, HOLD_VELOCITY_GAIN = 1e5, 500.0
"""Gains of the PD controllers that hold a pose, N/m and N s/m: stiff as lead screws with motors at rest.

With the gains of a motion, a gust turns a tilted panel over."""

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

WORST_TILTS, WORST_AZIMUTHS = 3, 24
"""Number of tilts up to the largest one, and of azimuths, among which the worst pose is searched. The flat
pose is searched, too."""

LOAD_CASES = {
    "operating": {"pose": "worst", "wind": "steady", "speed": "14", "wind_from": "15"},
    "gust": {"pose": "worst", "wind": "gust", "speed": "14", "wind_from": "15"},
    "gust_west": {"pose": "worst", "wind": "gust", "speed": "14", "wind_from": "270"},
    "stow_up": {"pose": "stow", "wind": "steady", "speed": "40", "wind_from": "180", "vertical": "10"},
    "stow_down": {"pose": "stow", "wind": "steady", "speed": "40", "wind_from": "345", "vertical": "-10"},
}
"""Default load cases of `crosscheck loads tracker_wind`: operating limit, gust, and survival in stow.

The speeds are examples: 14 m/s at which the tracker would be stowed, and a gust of 40 m/s that it has to
survive in stow, with a vertical gust in both directions. 10 m/s is three standard deviations of the vertical
turbulence at 40 m/s for an intensity of 17 % along the wind. The wind of each case comes from the direction
in which an actuator has the largest force at rest, of all directions in steps of 15 degrees; the gust from
the west is the worst one of the first slider."""


def tracker_wind(
    wind: Literal["turbulent", "gust", "steady"] = "turbulent",
    speed: Annotated[float, Between(0.0, 60.0, "m/s")] = 10.0,
    wind_from: Annotated[float, Between(0.0, 360.0, "deg")] = 240.0,
    seed: Annotated[int, range(1000), OnlyWith("wind", "turbulent")] = 1,
    vertical: Annotated[float, Between(-20.0, 20.0, "m/s"), OnlyWith("wind", "steady")] = 0.0,
    pose: Literal["moving", "tilted", "stow", "worst"] = "moving",
    max_tilt: Annotated[float, Between(0.0, 30.0, "deg"), OnlyWith("pose", "worst")] = 30.0,
    panel_width: Side = WIDTH,
    panel_height: Side = HEIGHT,
    panel_mass: Mass = MASS,
) -> Scene:
    """Return the tracker under gravity and wind, its sliders moved or held by stiff PD laws, 5 s.

    Args:
        wind: turbulent along the wind and vertically, one gust of half the mean speed, or steady.
        speed: mean speed of the wind, m/s.
        wind_from: direction that the wind comes from, degrees clockwise from north; x is east, y north.
        seed: random seed of the turbulence.
        vertical: upward component of a steady wind, m/s, such as the vertical gust that loads a flat panel.
        pose: both sliders move up and down; hold the panel as tilted in the paper's initial pose; hold it
            flat; or hold it in the pose in which an actuator has the largest force in this wind at rest.
        max_tilt: largest tilt of the panel from the horizontal among which the worst pose is searched,
            degrees.
        panel_width, panel_height: sides of the panel, m, along the first and the second axis of its frame.
        panel_mass: mass of the panel, kg.
    """
    scene = with_panel(tracker_gravity(), panel_width, panel_height, panel_mass)
    panel = scene.mechanism.body("panel_7")
    axes, angle = panel.pose.rotation, np.radians(wind_from)
    load = WindLoad(
        "wind",
        panel.name,
        panel.center_of_mass,
        first_side=panel_width * axes[:, 0],
        second_side=panel_height * axes[:, 1],
        direction=[-np.sin(angle), -np.cos(angle), 0.0],
        speed=_speed(wind, speed, seed),
        vertical_speed=_vertical_speed(speed, seed) if wind == "turbulent" else vertical,
    )
    description = "dual-axis solar tracker, stiff PD control along a motion, under gravity and wind"
    scene = replace(scene, name="tracker_wind", description=description)
    if pose != "moving":
        return _held(replace(scene, forces=(load,)), pose, max_tilt)
    feedforward = FEEDFORWARD if panel_mass == MASS else _weight_forces(scene)
    control = tuple(
        PD(
            law.joint,
            WIND_POSITION_GAIN,
            WIND_VELOCITY_GAIN,
            target=up_and_down(stroke, period),
            feedforward=force,
        )
        for law, stroke, period, force in zip(scene.control, STROKES, PERIODS, feedforward, strict=True)
    )
    return replace(scene, control=control, forces=(load,))


def _weight_forces(scene: Scene) -> tuple[float, ...]:
    """Return the forces of the actuators, N, that balance the weight at the start."""
    from newton_euler import statics

    return tuple(statics(scene).actuator_force.tolist())


def _held(scene: Scene, pose: str, max_tilt: float) -> Scene:
    """Return the tracker at rest, held by PD laws in a pose; `pose` and `max_tilt` as of `tracker_wind`.

    The laws feed forward the forces of equilibrium with the weight and the wind at time 0, so that the run
    starts without a transient.
    """
    # imported here, since other scenes need no kinematics
    from newton_euler import Axis, initial_state, solve_poses, statics
    from newton_euler.analysis.loads.rest import wind_at_peak

    start, targets = initial_state(scene), [0.0] * len(scene.control)
    if pose != "tilted":
        keys, row = [law.key for law in scene.control], 0
        normal = Axis("panel_7", np.array([0.0, 0.0, 1.0]))
        towards = np.array([UPWARD]) if pose == "stow" else tilted_directions(max_tilt)
        poses = solve_poses(scene, axis=normal, towards=towards, measure=keys)
        if pose == "worst":
            windy, _ = wind_at_peak(scene)
            row = int(np.argmax(np.abs(statics(windy, poses).actuator_force).max(axis=1)))
        start, targets = poses.state(row), [float(poses.coordinates[key][row]) for key in keys]
    forces = statics(scene, start).actuator_force
    control = tuple(
        PD(law.joint, HOLD_POSITION_GAIN, HOLD_VELOCITY_GAIN, target=target, feedforward=float(force))
        for law, target, force in zip(scene.control, targets, forces, strict=True)
    )
    description = "dual-axis solar tracker, panel held by stiff PD control, under gravity and wind"
    return replace(scene, description=description, control=control, initial_state=start)


def tilted_directions(max_tilt: float) -> Array:
    """Return directions (n, 3) of the panel's normal, east, north, up, up to a tilt in degrees; up first."""
    tilts = np.radians(max_tilt * np.arange(1, WORST_TILTS + 1) / WORST_TILTS)
    azimuths = np.radians(np.arange(WORST_AZIMUTHS) * 360.0 / WORST_AZIMUTHS)
    tilt, azimuth = (each.ravel() for each in np.meshgrid(tilts, azimuths))
    tilted = [np.sin(tilt) * np.sin(azimuth), np.sin(tilt) * np.cos(azimuth), np.cos(tilt)]
    return np.vstack([UPWARD, np.stack(tilted, axis=1)])


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
