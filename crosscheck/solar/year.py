"""A year of a solar tracker: irradiation of its panel hour by hour, with quasi-static poses.

For each interval of the weather, inverse kinematics gives the pose whose face points as close to the sun as
the mechanism and the rules of tracking allow. Motion between the poses is not simulated.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import NamedTuple

import numpy as np

from crosscheck.solar.base import Base
from crosscheck.solar.energy import FACING, THIS
from crosscheck.solar.geared import Geared
from crosscheck.solar.obstacles import Cause, Obstacles, face
from crosscheck.solar.place import SUN, Sun, sun_over
from crosscheck.solar.tracking import UP, Tracking
from crosscheck.solar.weather import Weather
from crosscheck.support.errors import CrosscheckError
from newton_euler import Axis, solve_poses
from newton_euler.equations.redundancy import mobility
from newton_euler.errors import choices, is_finite_number, plain_number
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.optional_packages import optional_package
from newton_euler.scalars import Array

FLAT_ON_BASE = "flat on the base"
"""Name of a panel that lies flat on a base that is not level."""

DEADBAND_STEPS = 12
"""Number of times in an interval at which the dead band is applied: every 5 minutes of an hour."""

NOT_NEAREST_SLOPE = 1e-7
"""Slope of the distance to a direction above which a pose is not the nearest one, see `Poses`."""

REFERENCE_IRRADIANCE = 1000.0
"""W/m^2, irradiance at which the efficiency of a module is given (standard test conditions)."""

USUAL_WIND = 1.0
"""m/s, wind speed for the temperature of a module if it is unknown; pvlib's default."""


class Limit(IntEnum):
    """The cause that keeps the face from the sun in an interval."""

    NONE = 0
    """The face points at the sun, within the dead band."""
    TILT = 1
    """The largest tilt of the rules of tracking."""
    SHADOW = 2
    """The face is flatter, so that no shadow falls on the next row (backtracking)."""
    REACH = 3
    """The mechanism does not reach the wanted direction."""
    COLLISION = 4
    """Bodies would come too close; the face takes the nearest free direction."""
    SINGULAR = 5
    """The mechanism would be nearly singular; the face takes the nearest free direction."""
    STROKE = 6
    """An actuator is at the end of its stroke."""
    WIND = 7
    """The face lies flat because of the wind."""
    DOWN = 8
    """The sun is below the horizon."""


BLOCKED = {
    Cause.COLLISION: Limit.COLLISION,
    Cause.SINGULAR: Limit.SINGULAR,
    Cause.UNREACHABLE: Limit.REACH,
}
"""Limit by the cause for which a direction is blocked."""


@dataclass(frozen=True)
class Module:
    """A photovoltaic module, after PVWatts (Dobos, PVWatts Version 5 Manual, NREL/TP-6A20-62641, 2014).

    Its temperature is that of Faiman's model (Progress in Photovoltaics 16, 2008) with pvlib's constants of
    25 W/(m^2 K) and 6.84 W s/(m^3 K). Losses by reflection, spectrum, dirt, shading, wires and the inverter
    are not modeled.

    Attributes:
        area: m^2.
        efficiency: ratio of electric to solar power at 1000 W/m^2 and 25 degrees Celsius.
        temperature_coefficient: relative change of the power, 1/K, negative for silicon; 0 for none.

    Raises:
        CrosscheckError: naming a value that is out of range.
    """

    area: float
    efficiency: float
    temperature_coefficient: float = 0.0

    def __post_init__(self) -> None:
        limits = {
            "area": (1e-6, 1e6),
            "efficiency": (1e-3, 1.0),
            "temperature_coefficient": (-0.02, 0.02),
        }
        for name, (low, high) in limits.items():
            value = getattr(self, name)
            if not is_finite_number(value) or not low <= value <= high:
                raise CrosscheckError(f"{name} is {value!r:.100}; needed: a number from {low:g} to {high:g}")

    def power(self, irradiance: Array, weather: Weather) -> Array:
        """Compute the electric power (n,), W, for an irradiance (n,), W/m^2, on the module.

        Raises:
            CrosscheckError: if the weather lacks the temperature, and the coefficient is not 0.
        """
        pvlib, cell = optional_package("pvlib", SUN), np.full(len(irradiance), 25.0)
        if self.temperature_coefficient != 0.0:
            air = weather.complete("temperature", "--temperature-coefficient")
            wind = USUAL_WIND if weather.wind is None else np.nan_to_num(weather.wind, nan=USUAL_WIND)
            cell = pvlib.temperature.faiman(irradiance, air, wind)
        rated = self.area * self.efficiency * REFERENCE_IRRADIANCE
        return np.asarray(pvlib.pvsystem.pvwatts_dc(irradiance, cell, rated, self.temperature_coefficient))


@dataclass(frozen=True, eq=False)
class Year:
    """Year of a tracker, in the n intervals of the weather.

    Attributes:
        scene: the tracker.
        axis: the panel's normal as an axis of a body.
        weather: the weather.
        sun: positions of the sun.
        tracking: rules of tracking.
        base: motion of the base.
        lit: (n,) True for intervals with light, for which poses are solved.
        coordinates: (n,) set-points by label of the joint coordinate, m or rad from the initial pose; NaN in
            the dark.
        notes: sentences on poses that need attention.
        normals: (n, 3) directions of the panel's normal (east, north, up); up in the dark.
        limits: (n,) what keeps the panel from the sun, a `Limit`.
        module: photovoltaic module on the panel, or None.
    """

    scene: Scene
    axis: Axis
    weather: Weather
    sun: Sun
    tracking: Tracking
    base: Base
    lit: Array
    coordinates: Mapping[str, Array]
    notes: tuple[str, ...]
    normals: Array
    limits: Array
    module: Module | None = None

    @cached_property
    def irradiance(self) -> dict[str, Array]:
        """(n,) W/m^2, irradiance on this tracker's panel (`THIS`, first) and on other panels, by name.

        Other panels stand on level ground, `FLAT_ON_BASE` excepted.
        """
        sky = self.weather.sky(self.sun)
        normals = {THIS: self.normals, **sky.alternatives()}
        if self.base.motions:
            seconds = _seconds(self.weather)
            normals[FLAT_ON_BASE] = self.base.rotations(seconds) @ UP
        return {name: sky.on(each) for name, each in normals.items()}

    @cached_property
    def light(self) -> dict[str, float]:
        """kWh/m^2, irradiation of the year, by the names of `irradiance`."""
        return {name: self.weather.irradiation(power) for name, power in self.irradiance.items()}

    @cached_property
    def by_month(self) -> dict[str, Array]:
        """(12,) kWh/m^2, irradiation of each month, by the names of `irradiance`."""
        return {name: self.monthly(power) for name, power in self.irradiance.items()}

    @cached_property
    def power(self) -> Array | None:
        """(n,) W, electric power of the module on the panel; None without a module."""
        return None if self.module is None else self.module.power(self.irradiance[THIS], self.weather)

    @cached_property
    def electric(self) -> dict[str, float]:
        """kWh, electric energy of the same module on each panel, by the names of `irradiance`; empty without
        a module."""
        if self.module is None:
            return {}
        return {
            name: self.weather.irradiation(self.module.power(light, self.weather))
            for name, light in self.irradiance.items()
        }

    def monthly(self, power: Array) -> Array:
        """Sum a power (n,), W or W/m^2, over each month: (12,) kWh or kWh/m^2."""
        sums = np.bincount(self.weather.months - 1, weights=power, minlength=12)
        return np.asarray(sums * self.weather.step / 1000.0)

    @cached_property
    def lost(self) -> Array:
        """(n,) W/m^2, irradiance on a panel that always faces the sun, minus that on this tracker's panel.

        Negative under clouds, where a panel that lies flat receives more.
        """
        return self.irradiance[FACING] - self.irradiance[THIS]

    def hours(self, limit: Limit) -> float:
        """Return the time of the year, h, with a certain limit."""
        return float(np.sum(self.limits == limit)) * self.weather.step

    def lost_by(self, limit: Limit) -> float:
        """Return the irradiation, kWh/m^2, that a panel that always faces the sun has more at this limit."""
        return self.weather.irradiation(np.where(self.limits == limit, self.lost, 0.0))

    @property
    def off_sun(self) -> Array:
        """(n,) angle between the panel's normal and the sun, rad."""
        across = np.linalg.norm(np.cross(self.normals, self.sun.direction), axis=1)
        return np.arctan2(across, np.sum(self.normals * self.sun.direction, axis=1))

    @cached_property
    def strokes(self) -> Mapping[str, tuple[float, float]]:
        """Least and largest set-point of the year by label, m or rad from the initial pose."""
        return {
            label: (float(np.nanmin(values)), float(np.nanmax(values)))
            for label, values in self.coordinates.items()
        }


def tracker_year(
    scene: Scene,
    axis: Axis,
    weather: Weather,
    tracking: Tracking,
    base: Base | None = None,
    module: Module | None = None,
    strokes: Mapping[str, tuple[float, float]] | None = None,
) -> Year:
    """Compute the irradiation of a tracker over the intervals of the weather.

    Args:
        scene: the tracker on a level base at rest; x is east, y north, z up.
        axis: the panel's normal as an axis of a body.
        weather: the weather. `Tracking.stow` needs wind speeds.
        tracking: rules of tracking. Tilt and rows are relative to the base.
        base: motion of the base, with times since the beginning of the weather; level and at rest if None.
        module: photovoltaic module on the panel, or None.
        strokes: least and largest set-points by label of an actuated joint coordinate, m or rad from the
            initial pose. A set-point beyond is replaced by the end of the stroke; others are kept.

    Raises:
        CrosscheckError: for a stroke of a joint without actuator, and if the weather lacks what the rules or
            the module need.
        newton_euler.NewtonEulerError: for a scene whose poses cannot be solved.
    """
    base = base or Base()
    sun, seconds = weather.sun(), _seconds(weather)
    lit = sun.is_up | (weather.ghi > 0.0)
    if not lit.any():
        raise CrosscheckError(f"{weather.source}: the sun never rises")
    wind = None if tracking.stow == np.inf else weather.complete("wind", "--stow")
    stowed = tracking.stows(wind, len(lit))
    wanted = _wanted(weather, sun, tracking, base, stowed)[lit]
    # poses of directions that differ from those before
    changes = np.append(True, np.any(np.diff(wanted, axis=0) != 0.0, axis=1))
    found = _found_poses(scene, axis, wanted[changes], tracking, strokes or {})
    pose = np.cumsum(changes) - 1  # index of the pose of each interval with light
    normals, kinds = np.tile(UP, (len(lit), 1)), np.full(len(lit), Limit.NONE)
    normals[lit] = np.einsum("nij,nj->ni", base.rotations(seconds[lit]), found.direction[pose])
    kinds[lit] = found.kind[pose]
    coordinates = {label: np.full(len(lit), np.nan) for label in found.coordinates}
    for label, values in found.coordinates.items():
        coordinates[label][lit] = values[pose]
    return Year(
        scene=scene,
        axis=axis,
        weather=weather,
        sun=sun,
        tracking=tracking,
        base=base,
        lit=lit,
        coordinates=coordinates,
        notes=found.notes,
        normals=normals,
        limits=_limits(sun, base.sun(sun, seconds), tracking, stowed, kinds),
        module=module,
    )


class _Found(NamedTuple):
    """Poses for p directions.

    Attributes:
        direction: (p, 3) directions of the axis.
        coordinates: (p,) set-points by label, m or rad.
        kind: (p,) limit of the mechanism: `Limit.NONE`, `REACH`, `COLLISION`, `SINGULAR` or `STROKE`.
        notes: sentences on poses that need attention.
    """

    direction: Array
    coordinates: dict[str, Array]
    kind: Array
    notes: tuple[str, ...]


def _found_poses(
    scene: Scene,
    axis: Axis,
    wanted: Array,
    tracking: Tracking,
    strokes: Mapping[str, tuple[float, float]],
) -> _Found:
    """Solve poses for wanted directions (p, 3) in which no bodies collide and no actuator leaves its stroke.

    Args:
        scene, axis, tracking, strokes: see `tracker_year`.
        wanted: directions of the axis.
    """
    # actuated joint coordinates; all of a mechanism without actuators and without loops. With gears, they are
    # those of the followers, and set-points those of the motors
    geared, labels = Geared.of(scene), scene.mechanism.coordinate_labels
    keys, ratios, names = list(geared.keys), list(geared.ratios), [labels[law.key] for law in scene.control]
    if not keys and mobility(geared.planned).degrees_of_freedom == len(labels):
        keys, ratios, names = list(labels), [1.0] * len(labels), list(labels.values())
    for name in strokes:
        if name not in names:
            raise CrosscheckError(f"stroke of {name!r:.100}: {choices(name, names)}")
    # blocked directions are replaced by the nearest free ones
    faced = face(geared.planned, axis, wanted, tracking, keys)
    poses, causes = faced.poses, faced.wanted_checks.cause
    assert poses.direction is not None  # there is an axis
    kind = np.where(poses.reached, Limit.NONE, Limit.REACH)
    if faced.obstacles.can_avoid:
        for cause, limit in BLOCKED.items():
            kind[causes == cause] = limit
    direction, values = poses.direction.copy(), {key: poses.coordinates[key].copy() for key in keys}
    ends = {
        key: np.sort(np.multiply(ratio, strokes.get(name, (-np.inf, np.inf))))
        for key, ratio, name in zip(keys, ratios, names, strict=True)
    }
    beyond = np.zeros(len(wanted), dtype=bool)
    for key, (low, high) in ends.items():
        beyond |= (values[key] < low) | (values[key] > high)
    if beyond.any():
        stopped: dict[str | Key, Array] = {key: np.clip(values[key][beyond], *ends[key]) for key in keys}
        there = solve_poses(geared.planned, stopped, axis=axis)
        assert there.direction is not None
        direction[beyond], kind[beyond] = there.direction, Limit.STROKE
        for key in keys:
            values[key][beyond] = there.coordinates[key]
    missed = int(np.sum((poses.slope > NOT_NEAREST_SLOPE) & ~beyond))
    coordinates = {name: values[key] / ratio for key, ratio, name in zip(keys, ratios, names, strict=True)}
    return _Found(direction, coordinates, kind, tuple(_notes(faced.obstacles, missed)))


def _notes(obstacles: Obstacles, missed: int) -> Iterator[str]:
    """Yield sentences on poses that need attention.

    Args:
        obstacles: obstacles of the mechanism.
        missed: number of poses that are not the nearest ones.
    """
    yield from obstacles.notes
    if not obstacles.can_avoid:
        yield "the pose of the flat panel is blocked: collisions and singular configurations are not avoided"
    if missed:
        yield f"the nearest pose was not found for {missed} directions; losses are too large"


def stroke_of(text: str) -> tuple[str, tuple[float, float]]:
    """Parse a stroke JOINT=LOW:HIGH, m or rad from the initial pose.

    Returns:
        Label of the joint coordinate, and both ends.

    Raises:
        CrosscheckError: if the text has another form, or the range is empty.
    """
    label, _, ends = text.partition("=")
    try:
        low, high = map(plain_number, ends.split(":"))
    except ValueError:
        low, high = 0.0, 0.0  # an empty range, which is refused below
    if not label or not low < high:
        raise CrosscheckError(f"--stroke {text!r:.200} is not of the form JOINT=LOW:HIGH, in m or rad")
    return label, (low, high)


def _seconds(weather: Weather) -> Array:
    """Return the middles (n,) of the intervals, s since the beginning of the weather."""
    return 3600.0 * weather.step * (np.arange(len(weather.times)) + 0.5)


def _wanted(weather: Weather, sun: Sun, tracking: Tracking, base: Base, stowed: Array) -> Array:
    """Compute the wanted directions (n, 3) of the panel's normal in the axes of the base.

    With a dead band, the panel moves several times in an interval, and waits at night.

    Args:
        weather: weather of n intervals.
        sun: positions of the sun in the intervals.
        tracking: rules of tracking.
        base: motion of the base.
        stowed: (n,) True where the panel lies flat because of the wind.
    """
    count = 1 if tracking.deadband == 0.0 else DEADBAND_STEPS
    # times relative to the middle of an interval, h; one of them is 0
    shifts = (np.arange(count) - count // 2) * weather.step / count
    pd = optional_package("pandas", SUN)
    repeated = weather.times.repeat(count) + pd.to_timedelta(np.tile(shifts, len(stowed)), unit="h")
    seconds = (_seconds(weather)[:, None] + 3600.0 * shifts).ravel()
    if count > 1:
        sun = sun_over(weather.place, repeated)
    wanted = tracking.towards(base.sun(sun, seconds))
    stowed = np.repeat(stowed, count)
    wanted[stowed] = UP
    lit = sun.is_up | np.repeat(weather.ghi > 0.0, count)
    kept = wanted.copy()
    kept[lit] = tracking.with_deadband(wanted[lit], stowed[lit])
    return kept[count // 2 :: count]


def _limits(sun: Sun, from_base: Sun, tracking: Tracking, stowed: Array, kinds: Array) -> Array:
    """Find what keeps the panel from the sun: (n,) a `Limit` for each interval.

    Args:
        sun: n positions of the sun in the world.
        from_base: the same in the axes of the base.
        tracking: rules of tracking.
        stowed: (n,) True where the panel lies flat in wind.
        kinds: (n,) limits of the mechanism.
    """
    tilt = np.degrees(np.arccos(np.clip(tracking.towards(from_base)[:, 2], -1.0, 1.0)))
    flatter = tilt < tracking.max_tilt - 1e-9  # degrees; if not because of its limit, because of shadows
    limits = np.full(len(stowed), Limit.NONE)
    limits[~tracking.can_face(from_base)] = Limit.TILT
    limits[~tracking.can_face(from_base) & flatter] = Limit.SHADOW
    limits[kinds != Limit.NONE] = kinds[kinds != Limit.NONE]
    limits[stowed] = Limit.WIND
    limits[~sun.is_up] = Limit.DOWN
    return limits
