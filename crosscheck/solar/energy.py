"""Irradiance on a solar tracker's panel, and on panels with common mountings.

The irradiance of the sky is given (`Sky`) or that of a clear sky (`ClearSky`). The models are pvlib's: clear
sky of climatological turbidity (Ineichen and Perez, Solar Energy 73, 2002), diffuse light after Hay and
Davies, ground of albedo 0.2. Losses by reflection, heat, dirt or shadows are not modeled.
"""

from __future__ import annotations

import numpy as np

from crosscheck.solar.place import SUN, Place, Sun, tilted
from newton_euler.optional_packages import optional_package
from newton_euler.scalars import Array

ALBEDO = 0.2
"""Fraction of the light that the ground reflects, a common value."""

ROW_TILT = 60.0
"""Largest rotation of a horizontal single-axis tracker, degrees; a common value in solar fields."""

THIS, FIXED, FACING = "this tracker", "tilted by the latitude", "facing the sun"
FLAT, ONE_AXIS = "flat", f"one axis, {ROW_TILT:g} deg"
"""Names of the panels that are compared."""


class Sky:
    """Irradiance over a place at n times.

    Attributes:
        place: the place.
        sun: positions of the sun at the n times.
    """

    def __init__(self, place: Place, sun: Sun, dni: Array, ghi: Array, dhi: Array) -> None:
        """Keep the direct normal, global horizontal and diffuse horizontal irradiance (n,), W/m^2."""
        self.place, self.sun = place, sun
        self.dni, self.ghi, self.dhi = dni, ghi, dhi
        self._pvlib = optional_package("pvlib", extra=SUN)
        self._extraterrestrial = self._pvlib.irradiance.get_extra_radiation(sun.times).to_numpy()

    def on(self, normals: Array) -> Array:
        """Compute the irradiance (n,), W/m^2, on a panel with the normals (n, 3): east, north, up."""
        tilt = np.degrees(np.arccos(np.clip(normals[:, 2], -1.0, 1.0)))
        azimuth = np.degrees(np.arctan2(normals[:, 0], normals[:, 1])) % 360.0
        total = self._pvlib.irradiance.get_total_irradiance(
            tilt,
            azimuth,
            90.0 - np.degrees(self.sun.elevation),
            np.degrees(self.sun.azimuth),
            self.dni,
            self.ghi,
            self.dhi,
            dni_extra=self._extraterrestrial,
            albedo=ALBEDO,
            model="haydavies",
        )
        return np.nan_to_num(np.asarray(total["poa_global"], dtype=float))

    def alternatives(self) -> dict[str, Array]:
        """Return the normals (n, 3) of the panels that a tracker is compared with, by name.

        Two panels are fixed: one lies flat, one is tilted by the latitude towards the equator. One turns
        about a horizontal north-south axis by up to `ROW_TILT`. One always faces the sun.
        """
        count, latitude = len(self.sun.times), np.radians(self.place.latitude)
        fixed = np.array([0.0, -np.sin(latitude), np.cos(latitude)])
        zenith, azimuth = 90.0 - np.degrees(self.sun.elevation), np.degrees(self.sun.azimuth)
        row = self._pvlib.tracking.singleaxis(zenith, azimuth, max_angle=ROW_TILT, backtrack=False)
        # NaN at night becomes 0, a panel that lies flat
        row_tilt, row_azimuth = (
            np.radians(np.nan_to_num(row[f"surface_{name}"])) for name in ("tilt", "azimuth")
        )
        return {
            FLAT: np.tile([0.0, 0.0, 1.0], (count, 1)),
            FIXED: np.tile(fixed, (count, 1)),
            ONE_AXIS: tilted(row_tilt, row_azimuth),
            FACING: self.sun.direction,
        }


class ClearSky(Sky):
    """Irradiance of a clear sky over a place at n times."""

    def __init__(self, place: Place, sun: Sun) -> None:
        """Compute the direct, global and diffuse irradiance at all times."""
        location = optional_package("pvlib", extra=SUN).location.Location(
            place.latitude, place.longitude, altitude=place.altitude
        )
        light = location.get_clearsky(sun.times, model="ineichen")
        super().__init__(place, sun, *(light[name].to_numpy() for name in ("dni", "ghi", "dhi")))


def over_day(times: Array, power: Array) -> float:
    """Integrate power (n,), W, over times (n,), s, by the trapezoidal rule. Returns W h."""
    return float(np.trapezoid(power, times)) / 3600.0
