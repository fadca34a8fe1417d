"""The tracker as it would stand in the sun: under gravity, its sliders held stiffly."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from crosscheck.scenes.tracker import tracker_gravity
from crosscheck.scenes.tracker_wind import DAMPING, STIFFNESS
from crosscheck.solar.day import following
from crosscheck.solar.place import Place, day_times, sun_over
from crosscheck.solar.tracking import Tracking
from newton_euler import PD, Axis
from newton_euler.model.scene import Scene

PANEL_NORMAL = Axis("panel_7", np.array([0.0, 0.0, 1.0]))

PLACES = {"phnom_penh": Place(11.56, 104.92), "seville": Place(37.39, -5.99), "potsdam": Place(52.4, 13.07)}

DATES = {"march": "2026-03-21", "june": "2026-06-21", "september": "2026-09-23", "december": "2026-12-21"}

FASTER = 300.0
"""Times as fast as the sun: its hour around noon in 12 s, so that all engines can make the run."""

SET_POINTS = 13
"""One a second."""


def sun_tracker() -> Scene:
    """The tracker under gravity with stiff PD laws, for days of any place, see `crosscheck.solar.day`."""
    scene = tracker_gravity()
    control = tuple(
        replace(law, stiffness=STIFFNESS, damping=DAMPING) for law in scene.control if isinstance(law, PD)
    )
    return replace(scene, name="tracker_sun", control=control)


def tracker_sun_day(
    place: Literal["phnom_penh", "seville", "potsdam"] = "phnom_penh",
    date: Literal["march", "june", "september", "december"] = "march",
) -> Scene:
    """The hour before noon of a day, 300 times as fast: set-points that jump, weight fed forward.

    Args:
        place: where the tracker stands.
        date: which day: the begins of the seasons of 2026.
    """
    at = PLACES[place]
    day = day_times(DATES[date], at.zone, FASTER)
    noon = len(day) // 2
    sun = sun_over(at, day[noon - SET_POINTS + 1 : noon + 1])
    scene, _, _ = following(sun_tracker(), PANEL_NORMAL, Tracking().normals(sun), period=1.0)
    description = "solar tracker, the hour before noon at 300 times its pace, under gravity"
    return replace(scene, name="tracker_sun_day", output_period=0.05, description=description)
