"""Joint coordinates that gears tie to each other, so that one of them tells a sum of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from newton_euler.model.couplings import Gear, JointCoupling
from newton_euler.model.joint import Key


class Ties:
    """Groups of joint coordinates, zero at the start, each in a constant ratio to the first of its group."""

    def __init__(self, gears: Iterable[JointCoupling]) -> None:
        self._of: dict[Key, tuple[Key, float]] = {}
        for gear in gears:
            if not isinstance(gear, Gear):
                continue  # which leaves its coordinates a freedom
            driver = (gear.driver, gear.driver_coordinate)
            follower = (gear.follower, gear.follower_coordinate)
            (first, a), (second, b) = self._member(driver), self._member(follower)
            ratio = gear.ratio * a / b  # of the second group's first coordinate to that of the first
            for key in (driver, follower):
                self._of.setdefault(key, (key, 1.0))
            for key, (group, factor) in list(self._of.items()):
                if group == second != first:
                    self._of[key] = (first, factor * ratio)

    def _member(self, key: Key) -> tuple[Key, float]:
        return self._of.get(key, (key, 1.0))

    def rates(self, keys: Iterable[Key]) -> dict[Key, float] | None:
        """Derivative of each of these coordinates by the first of them; None if they do not all follow it."""
        members = {key: self._member(key) for key in keys}
        if len({group for group, _ in members.values()}) != 1:
            return None
        first = next(iter(members.values()))[1]
        return {key: factor / first for key, (_, factor) in members.items()}

    def slopes(self, weights: Mapping[Key, float]) -> dict[Key, float] | None:
        """Derivative of a sum of weighted coordinates by each of them, the others following.

        None if some of them do not follow, so that no single coordinate tells the sum.
        """
        rates = self.rates(weights)
        if rates is None:
            return None
        total = sum(weight * rates[key] for key, weight in weights.items())
        return {key: total / rate for key, rate in rates.items()}
