"""The tracker as it would stand in the sun: under gravity, its sliders held stiffly."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from crosscheck.library.tracker import tracker_gravity
from crosscheck.library.tracker_wind import DAMPING, STIFFNESS
from newton_euler import PD, Axis
from newton_euler.model.scene import Scene

PANEL_NORMAL = Axis("panel_7", np.array([0.0, 0.0, 1.0]))

PLACES = {"phnom_penh": (11.56, 104.92), "seville": (37.39, -5.99), "potsdam": (52.4, 13.07)}
"""Latitude and longitude by name, degrees."""

DATES = {"march": "2026-03-21", "june": "2026-06-21", "september": "2026-09-23", "december": "2026-12-21"}

FASTER = 300.0
"""Speed of the run relative to the sun: the hour before noon takes 12 s, which all engines can simulate."""

SET_POINTS = 13
"""Number of set-points of the run, one per second."""


def sun_tracker() -> Scene:
    """Return the tracker under gravity with stiff PD laws, to follow the sun, see `crosscheck.solar.day`."""
    scene = tracker_gravity()
    control = tuple(
        replace(law, stiffness=STIFFNESS, damping=DAMPING) for law in scene.control if isinstance(law, PD)
    )
    return replace(scene, name="tracker_sun", control=control)


def tracker_sun_day(
    place: Literal["phnom_penh", "seville", "potsdam"] = "phnom_penh",
    date: Literal["march", "june", "september", "december"] = "march",
) -> Scene:
    """Return the hour before noon of a day, 300 times as fast: stepped set-points, weight fed forward.

    Args:
        place: location of the tracker.
        date: first day of a season of 2026.
    """
    # other scenes need no solar positions
    from crosscheck.solar.day import following
    from crosscheck.solar.place import Place, day_times, sun_over
    from crosscheck.solar.tracking import Tracking

    at = Place(*PLACES[place])
    day = day_times(DATES[date], at.zone, FASTER)
    noon = len(day) // 2
    sun = sun_over(at, day[noon - SET_POINTS + 1 : noon + 1])
    scene, _, _ = following(sun_tracker(), PANEL_NORMAL, Tracking().normals(sun), period=1.0)
    description = "solar tracker, the hour before noon at 300 times its pace, under gravity"
    return replace(scene, name="tracker_sun_day", output_period=0.05, description=description)
