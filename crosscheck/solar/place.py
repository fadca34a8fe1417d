"""Places on the globe, times of a day, and directions of the sun (computed by pvlib).

Directions are in the world frame of a scene: x is east, y north, z up.
"""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from crosscheck.support.errors import CrosscheckError
from newton_euler.analysis.kinematics.configurations import smallest_turns
from newton_euler.errors import is_finite_number
from newton_euler.optional_packages import optional_package
from newton_euler.scalars import Array

if TYPE_CHECKING:
    import pandas as pd

RANGES = {"latitude": (-90.0, 90.0, "degrees north"), "longitude": (-180.0, 180.0, "degrees east")}
"""Allowed range and unit of each coordinate of a place."""

ALTITUDES = (-500.0, 9000.0)
"""Allowed range of altitudes, m above the sea."""


@dataclass(frozen=True)
class Place:
    """A place on the globe.

    Attributes:
        latitude: degrees north.
        longitude: degrees east.
        altitude: m above the sea.

    Raises:
        CrosscheckError: for a place off the globe.
    """

    latitude: float
    longitude: float
    altitude: float = 0.0

    def __post_init__(self) -> None:
        for name, (low, high, unit) in {**RANGES, "altitude": (*ALTITUDES, "m")}.items():
            value = getattr(self, name)
            if not is_finite_number(value) or not low <= value <= high:
                raise CrosscheckError(f"{name} {value!r:.100} is off the globe: {low:g} to {high:g} {unit}")

    def __str__(self) -> str:
        north, east = "N" if self.latitude >= 0.0 else "S", "E" if self.longitude >= 0.0 else "W"
        return f"{abs(self.latitude):g} {north}, {abs(self.longitude):g} {east}"

    @property
    def zone(self) -> str:
        """The nautical time zone: whole hours from Greenwich, 15 degrees wide."""
        return f"UTC{round(self.longitude / 15.0):+03d}:00"


SUN = "sun"
"""Name of the optional dependencies (`pip install crosscheck-dynamics[sun]`): pvlib and pandas."""


def day_times(date: str, zone: str, period: float) -> pd.DatetimeIndex:
    """Return times every `period` s from midnight to midnight, see `seconds_of_day`.

    Args:
        date: YYYY-MM-DD.
        zone: name of a time zone, for example "Asia/Phnom_Penh" or "UTC+07:00".
        period: time between two times, s.

    Raises:
        CrosscheckError: for an invalid date or time zone.
        MissingPackageError: if pandas is not installed.
    """
    pd = optional_package("pandas", SUN)

    try:
        start = datetime.date.fromisoformat(date)
    except (ValueError, TypeError) as error:
        raise CrosscheckError(f"date {date!r:.100} is not a day of the form YYYY-MM-DD") from error
    try:
        begin = pd.Timestamp(start).tz_localize(zone)
    except Exception as error:  # zoneinfo, dateutil and pandas raise different kinds of errors
        raise CrosscheckError(
            f"time zone {zone!r:.100} is unknown; needed: a name such as Asia/Phnom_Penh or UTC+07:00"
        ) from error
    return begin + pd.to_timedelta(seconds_of_day(period), unit="s")


def seconds_of_day(period: float) -> Array:
    """Return times (n,), s since midnight, every `period` s; the last is the one nearest to 24 hours."""
    return np.arange(0.0, 86400.0 + 0.5 * period, period)


def tilted(tilt: Array, azimuth: Array) -> Array:
    """Return unit vectors (n, 3): east, north, up.

    Args:
        tilt: (n,) angle from the vertical, rad.
        azimuth: (n,) angle from north to the east of the horizontal part, rad.
    """
    horizontal = np.sin(tilt)
    return np.stack([horizontal * np.sin(azimuth), horizontal * np.cos(azimuth), np.cos(tilt)], axis=1)


def angles(one: Array, other: Array) -> Array:
    """Compute the angles (n,) between unit vectors (n, 3), rad."""
    return np.asarray(np.linalg.norm(smallest_turns(one, other), axis=1))


@dataclass(frozen=True, eq=False)
class Sun:
    """Positions of the sun at n times.

    Attributes:
        times: n times with a zone.
        azimuth: (n,) rad from north to the east.
        elevation: (n,) rad above the horizon, refraction included.
    """

    times: pd.DatetimeIndex
    azimuth: Array
    elevation: Array

    @property
    def direction(self) -> Array:
        """(n, 3) unit vectors to the sun: east, north, up."""
        return tilted(0.5 * np.pi - self.elevation, self.azimuth)

    @property
    def is_up(self) -> Array:
        """(n,) True where the sun is above the horizon."""
        return self.elevation > 0.0


def sun_over(place: Place, times: pd.DatetimeIndex) -> Sun:
    """Compute positions of the sun by NREL's algorithm (Reda and Andreas, Solar Energy 76, 2004) in pvlib.

    Refraction is that of 12 degrees Celsius and of the pressure at the place's altitude.

    Raises:
        CrosscheckError: for times without a zone.
        MissingPackageError: if pvlib is not installed.
    """
    if times.tz is None:
        raise CrosscheckError(f"times from {times[0]} on have no time zone")
    found = optional_package("pvlib", SUN).solarposition.get_solarposition(
        times, place.latitude, place.longitude, place.altitude, method="nrel_numpy"
    )
    return Sun(
        times,
        np.radians(found["azimuth"].to_numpy()),
        np.radians(found["apparent_elevation"].to_numpy()),
    )
