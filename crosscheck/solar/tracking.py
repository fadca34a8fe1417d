"""Set-points of a solar tracker: the directions that its panel is to face over a day.

Where the sun is below the horizon the panel waits for the morning. What cannot be faced, low suns mostly, is
faced as nearly as the largest tilt allows.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from crosscheck.solar.place import Sun, tilted
from crosscheck.support.errors import CrosscheckError
from newton_euler.errors import is_finite_number
from newton_euler.scalars import Array

UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Tracking:
    """Rules by which a panel follows the sun.

    Attributes:
        deadband: degrees that it may be off before it moves again; 0 to move at each set-point.
        most_tilt: degrees from the horizontal that it is tilted at most.
        pitch: distance of the next row towards the sun, in lengths of the panel: low suns are backtracked so
            that no shadow falls on it (Lorenzo, Narvarte, Munoz, Progress in Photovoltaics 19, 2011, in the
            vertical plane of the sun); infinite for a panel that stands alone.
        stow: wind in m/s from which it lies flat.

    Raises:
        CrosscheckError: for a value that is none.
    """

    deadband: float = 0.0
    most_tilt: float = 30.0
    pitch: float = np.inf
    stow: float = np.inf

    def __post_init__(self) -> None:
        limits = {
            "deadband": (0.0, 90.0),
            "most_tilt": (0.0, 90.0),
            "pitch": (1.0, np.inf),
            "stow": (0.0, np.inf),
        }
        for field in fields(self):
            value, (low, high) = getattr(self, field.name), limits[field.name]
            is_number = is_finite_number(value) or value == np.inf == high
            if not is_number or not low <= value <= high:
                raise CrosscheckError(f"{field.name} is {value!r:.100}: a number from {low:g} to {high:g}")

    def normals(self, sun: Sun, wind: Array | None = None) -> Array:
        """Return where the panel's normal is to point (n, 3); `wind` (n,) is its speed, m/s.

        Raises:
            CrosscheckError: for a sun that does not rise, and as of `stows`.
        """
        up = sun.is_up
        if not up.any():
            raise CrosscheckError(
                f"the sun does not rise on {sun.times[0].date()}: there is nothing to follow"
            )
        tilt = np.minimum(self._without_shadow(sun.elevation), np.radians(self.most_tilt))
        wanted = tilted(tilt, sun.azimuth)
        waits = np.flatnonzero(~up)
        risen = np.flatnonzero(up)
        nearest = np.searchsorted(risen, waits)  # after sunset the first of the day, which is next morning's
        wanted[waits] = wanted[risen[nearest % len(risen)]]
        wanted[self.stows(wind, len(up))] = UP
        return self._held(wanted)

    def stows(self, wind: Array | None, count: int) -> Array:
        """Return True (n,) where the panel lies flat in winds, m/s, at n = `count` times; None for calm.

        Raises:
            CrosscheckError: for winds at other times.
        """
        if wind is None:
            return np.zeros(count, dtype=bool)
        if np.shape(wind) != (count,) or not np.all(np.isfinite(wind)):
            raise CrosscheckError(f"wind has shape {np.shape(wind)}: {count} speeds, m/s")
        return np.asarray(wind) >= self.stow

    def can_face(self, sun: Sun) -> Array:
        """Return True (n,) where the sun is up and the panel may face it."""
        tilt = self._without_shadow(sun.elevation)
        facing = tilt == 0.5 * np.pi - sun.elevation
        return np.asarray(sun.is_up & facing & (tilt <= np.radians(self.most_tilt)))

    def _without_shadow(self, elevation: Array) -> Array:
        """Compute the tilt (n,) towards the sun, rad, that leaves the next row in the sun.

        A panel of length 1 and tilt t under a sun of elevation e shades sin(e + t) / sin e of the ground.
        """
        facing = 0.5 * np.pi - elevation
        if self.pitch == np.inf:
            return facing
        share = self.pitch * np.sin(np.maximum(elevation, 0.0))
        return np.where(share < 1.0, np.arcsin(np.minimum(share, 1.0)) - elevation, facing)

    def _held(self, wanted: Array) -> Array:
        """Hold directions (n, 3) until they are off by more than the dead band."""
        if self.deadband == 0.0:
            return wanted
        held, least = wanted.copy(), np.cos(np.radians(self.deadband))
        for k in range(1, len(held)):
            if held[k - 1] @ wanted[k] >= least:
                held[k] = held[k - 1]
        return held
