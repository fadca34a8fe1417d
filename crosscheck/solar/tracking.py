"""Rules of solar tracking: the directions that a panel should face over a day.

If the sun is below the horizon, the panel waits in its position of the next morning. If the sun is too low
to be faced, the panel points as close to the sun as its largest tilt allows.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from crosscheck.solar.place import Sun, tilted
from crosscheck.support.errors import CrosscheckError
from newton_euler.errors import is_finite_number
from newton_euler.scalars import Array

UP = np.array([0.0, 0.0, 1.0])
"""Normal of a panel that lies flat, in the axes of the base."""

MIN_RATE, MAX_RATE = 1e-5, 1e3
"""Allowed range of speeds and accelerations of set-points, SI. At the least speed, a move of 0.1 m takes
three hours."""

MAX_CLEARANCE = 100.0
"""Largest clearance between bodies, m."""


@dataclass(frozen=True)
class Tracking:
    """Rules of tracking.

    Attributes:
        deadband: dead band, degrees: the panel moves only if its normal differs from the wanted direction by
            more. 0 to follow each change of that direction.
        max_tilt: largest tilt of the panel from the horizontal, degrees.
        pitch: distance between rows of panels, in panel lengths. If the sun is low, the panel turns back so
            that no shadow falls on the next row (backtracking: Lorenzo, Narvarte, Munoz, Progress in
            Photovoltaics 19, 2011). The rule is applied in the vertical plane through the sun: for each
            azimuth, the next row is assumed at this distance along the shadow. Infinite for a panel that
            stands alone.
        stow: wind speed from which the panel is to lie flat, m/s.
        speed: largest speed of the set-points, m/s at slides and rad/s at hinges.
        acceleration: largest acceleration of the set-points, m/s^2 or rad/s^2.
        clearance: smallest distance, m, between bodies that no joint connects.
        to_singular: smallest distance of poses from singular configurations, in which the actuators do not
            determine the motion; dimensionless, see `newton_euler.Poses.independence`.

    Raises:
        CrosscheckError: naming a value that is out of range.
    """

    deadband: float = 0.0
    max_tilt: float = 30.0
    pitch: float = np.inf
    stow: float = np.inf
    speed: float = 0.01
    acceleration: float = 0.02
    clearance: float = 0.001
    to_singular: float = 0.05

    def __post_init__(self) -> None:
        limits = {
            "deadband": (0.0, 90.0),
            "max_tilt": (0.0, 90.0),
            "pitch": (1.0, np.inf),
            "stow": (0.0, np.inf),
            "speed": (MIN_RATE, MAX_RATE),
            "acceleration": (MIN_RATE, MAX_RATE),
            "clearance": (0.0, MAX_CLEARANCE),
            "to_singular": (0.0, 1.0),
        }
        for field in fields(self):
            value, (low, high) = getattr(self, field.name), limits[field.name]
            is_number = is_finite_number(value) or value == np.inf == high
            if not is_number or not low <= value <= high:
                raise CrosscheckError(
                    f"{field.name} is {value!r:.100}; needed: a number from {low:g} to {high:g}"
                )

    def normals(self, sun: Sun, wind: Array | None = None, held: bool = True) -> Array:
        """Compute the wanted directions (n, 3) of the panel's normal, in the axes of the base.

        Args:
            sun: n positions of the sun in these axes over one day, in the order of time.
            wind: (n,) m/s, wind speed; None for calm.
            held: True to keep a direction until the wanted one has left the dead band.

        Raises:
            CrosscheckError: if the sun does not rise on that day, and for wind speeds that are not finite or
                not n.
        """
        up = sun.is_up
        if not up.any():
            raise CrosscheckError(
                f"the sun does not rise on {sun.times[0].date()}; choose another date or place"
            )
        wanted = self.towards(sun)
        # at night, the direction of the next morning; after sunset that of this day's morning stands for it
        night, daytime = np.flatnonzero(~up), np.flatnonzero(up)
        next_risen = np.searchsorted(daytime, night)
        wanted[night] = wanted[daytime[next_risen % len(daytime)]]
        stowed = self.stows(wind, len(up))
        wanted[stowed] = UP
        return self.with_deadband(wanted, stowed) if held else wanted

    def towards(self, sun: Sun) -> Array:
        """Compute the directions (n, 3) as close to the sun (n positions) as tilt and shadow allow.

        Both are in the axes of the base.
        The rules of night, wind and dead band are not applied.
        """
        tilt = np.minimum(self._without_shadow(sun.elevation), np.radians(self.max_tilt))
        return tilted(tilt, sun.azimuth)

    def stows(self, wind: Array | None, count: int) -> Array:
        """Return an array (n,) that is True where the panel is to lie flat because of the wind.

        Args:
            wind: (n,) m/s, wind speed; None for calm.
            count: n.

        Raises:
            CrosscheckError: for a wrong number of speeds, or speeds that are not finite.
        """
        if wind is None:
            return np.zeros(count, dtype=bool)
        if np.shape(wind) != (count,) or not np.all(np.isfinite(wind)):
            raise CrosscheckError(f"wind has shape {np.shape(wind)}; needed: {count} finite speeds, m/s")
        return np.asarray(wind) >= self.stow

    def can_face(self, sun: Sun) -> Array:
        """Return an array (n,) that is True where the panel may face the sun.

        The sun is up then, and neither the largest tilt nor a shadow prevents it.
        """
        tilt = self._without_shadow(sun.elevation)
        facing = tilt == 0.5 * np.pi - sun.elevation
        return np.asarray(sun.is_up & facing & (tilt <= np.radians(self.max_tilt)))

    def _without_shadow(self, elevation: Array) -> Array:
        """Compute the tilt (n,) towards the sun, rad, at which no shadow falls on the next row.

        The shadow of a panel of length 1 and tilt t under a sun of elevation e is sin(e + t) / sin e long.
        """
        facing = 0.5 * np.pi - elevation
        if self.pitch == np.inf:
            return facing
        # the shadow ends at the next row: sin(e + t) = pitch sin e
        sine = self.pitch * np.sin(np.maximum(elevation, 0.0))
        return np.where(sine < 1.0, np.arcsin(np.minimum(sine, 1.0)) - elevation, facing)

    def with_deadband(self, wanted: Array, stowed: Array | None = None) -> Array:
        """Keep a direction until the wanted one (n, 3) differs by more than the dead band; return (n, 3).

        Args:
            wanted: (n, 3) wanted directions, in the order of time.
            stowed: (n,) True where the panel is to lie flat because of the wind. The dead band delays neither
                the way to the flat position nor the way back.
        """
        if self.deadband == 0.0:
            return wanted
        kept, least_cosine = wanted.copy(), np.cos(np.radians(self.deadband))
        moves = np.zeros(len(kept), dtype=bool) if stowed is None else np.diff(stowed, prepend=stowed[:1])
        for k in range(1, len(kept)):
            if not moves[k] and kept[k - 1] @ wanted[k] >= least_cosine:
                kept[k] = kept[k - 1]
        return kept
