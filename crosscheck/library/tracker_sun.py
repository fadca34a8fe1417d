"""Scenes of the solar tracker that follows the sun: under gravity, with stiff PD control of its sliders.

The sliders are two carriages on vertical rails, which tilt the panel (`crosscheck.library.tracker`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from crosscheck.library.tracker import tracker_gravity
from crosscheck.library.tracker_panel import HEIGHT, MASS, WIDTH, Mass, Side, with_panel
from crosscheck.library.tracker_wind import WIND_POSITION_GAIN, WIND_VELOCITY_GAIN
from newton_euler import PD, Axis, solve_poses
from newton_euler.model.scene import Scene

PANEL_NORMAL = Axis("panel_7", np.array([0.0, 0.0, 1.0]))
"""Normal of the panel, in the frame of the panel: the axis that points at the sun."""

PLACES = {"phnom_penh": (11.56, 104.92), "seville": (37.39, -5.99), "potsdam": (52.4, 13.07)}
"""Latitude and longitude of each place, degrees north and east."""

DATES = {"march": "2026-03-21", "june": "2026-06-21", "september": "2026-09-23", "december": "2026-12-21"}
"""First days of the seasons of 2026, by month."""

SPEED_UP = 300.0
"""Speed of the scene relative to the real sun: an hour takes 12 s, which all engines can simulate."""

PACE_SPEED, PACE_ACCELERATION = 0.1, 0.2
"""Largest speed, m/s, and acceleration, m/s^2, of the set-points of the accelerated scene."""

SET_POINTS = 13
"""Number of set-points (targets) of the sliders in the run of 12 s, one per second."""


def sun_tracker(panel_width: Side = WIDTH, panel_height: Side = HEIGHT, panel_mass: Mass = MASS) -> Scene:
    """Return the tracker under gravity with stiff PD control; `crosscheck.solar.day` adds set-points.

    Args:
        panel_width, panel_height: sides of the panel, m, along the first and the second axis of its frame.
        panel_mass: mass of the panel, kg.
    """
    scene = with_panel(tracker_gravity(), panel_width, panel_height, panel_mass)
    control = tuple(
        replace(law, stiffness=WIND_POSITION_GAIN, damping=WIND_VELOCITY_GAIN)
        for law in scene.control
        if isinstance(law, PD)
    )
    description = "dual-axis solar tracker, stiff PD control, under gravity, of crosscheck sun and year"
    return replace(scene, name="tracker_sun", description=description, control=control)


def tracker_sun_day(
    place: Literal["phnom_penh", "seville", "potsdam"] = "phnom_penh",
    date: Literal["march", "june", "september", "december"] = "march",
) -> Scene:
    """Return the tracker in the hour before noon of a day, 300 times as fast as the real sun, 12 s.

    The sliders move from set-point to set-point with trapezoidal speed. The forces that balance the weight
    are fed forward.

    Args:
        place: location of the tracker.
        date: month whose date is given in `DATES`.
    """
    # imported here, since other scenes need no solar positions
    from crosscheck.solar.geared import Geared
    from crosscheck.solar.place import Place, day_times, sun_over
    from crosscheck.solar.set_points import following
    from crosscheck.solar.tracking import Tracking

    # times of a day in the nautical time zone (whole hours from Greenwich), every 300 s of the real sun:
    # 1 s of the scene; then the hour before noon
    location = Place(*PLACES[place])
    day = day_times(DATES[date], location.zone, SPEED_UP)
    noon = len(day) // 2
    sun = sun_over(location, day[noon - SET_POINTS + 1 : noon + 1])
    # set-points at which the panel faces the sun, up to its largest tilt. The default rules of tracking are
    # for a panel that stands alone, without a wind limit. Only the scene is needed here
    wanted = Tracking().normals(sun)
    tracking = Tracking(speed=PACE_SPEED, acceleration=PACE_ACCELERATION)
    tracker = sun_tracker()
    keys = [law.key for law in tracker.control]
    poses = solve_poses(tracker, axis=PANEL_NORMAL, towards=wanted, measure=keys)
    scene = following(Geared.of(tracker), poses, 1.0, tracking).scene
    description = "solar tracker, the hour before noon at 300 times its pace, under gravity"
    return replace(scene, name="tracker_sun_day", output_period=0.05, description=description)
