"""Weather of a year at a place: the light of the sky, and perhaps temperature and wind, hour by hour.

`read_weather` in `crosscheck.solar.weather_files` reads weather from a file; `clear_sky` computes it for a
year without clouds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from crosscheck.solar.energy import ClearSky, Sky
from crosscheck.solar.place import SUN, Place, Sun, sun_over, tilted
from crosscheck.support.errors import CrosscheckError
from newton_euler.optional_packages import optional_package
from newton_euler.scalars import Array

if TYPE_CHECKING:
    import pandas as pd

CLEAR_SKY_STEP = 0.5
"""Length of the intervals of a clear sky, h. Irradiation of a year at 0 to 65 degrees north on fixed, tilted
and turning panels differs by 2e-4 or less from that with steps of 5 minutes."""


NEAR = 0.5
"""Largest angle on the globe, degrees, between a place and the place of its weather. It is 56 km: the cells
of weather data and the distances of weather stations are some tens of km."""

KM_PER_DEGREE = 111.2
"""Length of a degree on the globe, km."""


@dataclass(frozen=True, eq=False)
class Weather:
    """Weather over n intervals of equal length.

    Attributes:
        place: the place.
        source: where the weather is from, such as "TMY3 file town.csv".
        times: n times with a zone, at which the sun stands for an interval: the middle of the interval if
            irradiances are averages, or the time of a satellite image.
        step: length of an interval, h.
        dni, ghi, dhi: (n,) W/m^2, direct normal, global horizontal and diffuse horizontal irradiance.
        temperature: (n,) degrees Celsius, of the air; None if unknown, NaN where it is missing.
        wind: (n,) m/s, wind speed; None if unknown, NaN where it is missing.
        rows: names of the n intervals in error messages, such as "line 3".
        notes: sentences on how the source was read.
    """

    place: Place
    source: str
    times: pd.DatetimeIndex
    step: float
    dni: Array
    ghi: Array
    dhi: Array
    temperature: Array | None = None
    wind: Array | None = None
    rows: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def months(self) -> Array:
        """(n,) months of the intervals, from 1 to 12."""
        return np.asarray(self.times.month)

    def irradiation(self, irradiance: Array) -> float:
        """Sum an irradiance (n,), W/m^2, over all intervals, kWh/m^2."""
        return float(np.sum(irradiance)) * self.step / 1000.0

    def sun(self) -> Sun:
        """Compute the positions of the sun."""
        return sun_over(self.place, self.times)

    def sky(self, sun: Sun) -> Sky:
        """Return the light of the sky; `sun` has the positions of the sun at `times`."""
        return Sky(self.place, sun, self.dni, self.ghi, self.dhi)

    def complete(self, name: str, needed_for: str) -> Array:
        """Return the temperature or the wind (n,).

        Args:
            name: "temperature" or "wind".
            needed_for: what it is needed for, for the message.

        Raises:
            CrosscheckError: if it is unknown or missing in an interval, whose row is named.
        """
        values: Array | None = getattr(self, name)
        if values is None:
            raise CrosscheckError(
                f"{self.source} has no {name}, which {needed_for} needs; give a weather file with it"
            )
        for k in np.flatnonzero(np.isnan(values))[:1]:
            problem = f"{self.source}: {self.rows[k]}: {name} is missing, which {needed_for} needs"
            raise CrosscheckError(problem)
        return values


def check_place(weather: Weather, place: Place) -> None:
    """Check that weather is of a given place or near it.

    Raises:
        CrosscheckError: for a place farther than `NEAR` away.
    """
    # positions as directions from the center of the globe
    angles = np.radians([[each.latitude, each.longitude] for each in (weather.place, place)])
    one, other = tilted(0.5 * np.pi - angles[:, 0], angles[:, 1])
    away = float(np.degrees(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other)))
    if away > NEAR:
        raise CrosscheckError(
            f"{weather.source} is of {weather.place}, {away:.1f} degrees ({away * KM_PER_DEGREE:.0f} km) "
            f"from {place}; needed: weather of a place within {NEAR:g} degrees, or no --latitude and "
            "--longitude"
        )


def clear_sky(place: Place, year: int, zone: str | None = None) -> Weather:
    """Compute the weather of a year without clouds, in intervals of `CLEAR_SKY_STEP`.

    Args:
        place: the place.
        year: calendar year.
        zone: time zone, for example "Asia/Phnom_Penh"; the nautical time zone of the place if None.

    Raises:
        CrosscheckError: for an invalid year or zone.
        MissingPackageError: if pvlib is not installed.
    """
    pd = optional_package("pandas", SUN)
    if not 1900 <= year <= 2100:
        raise CrosscheckError(f"year is {year}; needed: 1900 to 2100")
    borders = [
        localized(pd.DatetimeIndex([f"{each}-01-01"]), zone or place.zone)[0] for each in (year, year + 1)
    ]
    step = pd.Timedelta(hours=CLEAR_SKY_STEP)
    times = pd.date_range(borders[0], borders[1], freq=step, inclusive="left") + step / 2
    sky = ClearSky(place, sun_over(place, times))
    notes = ("clear sky (Ineichen, pvlib's turbidity); clouds and the horizon reduce the irradiation",)
    source = f"clear sky of {year}"
    return Weather(place, source, times, CLEAR_SKY_STEP, sky.dni, sky.ghi, sky.dhi, notes=notes)


def localized(times: pd.DatetimeIndex, zone: str) -> pd.DatetimeIndex:
    """Return local times with their time zone.

    Raises:
        CrosscheckError: for an unknown zone, and for times that do not exist in it.
    """
    try:
        return times.tz_localize(zone)
    except Exception as error:  # zoneinfo, dateutil and pandas raise different kinds of errors
        raise CrosscheckError(
            f"time zone {zone!r:.100} is unknown, or its clock changes; needed: a zone such as UTC+07:00"
        ) from error
