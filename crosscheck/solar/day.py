"""A day of a solar tracker: set-points by inverse kinematics, simulated motion, pointing error and energy.

A solar tracker is a mechanism that moves a panel so that the panel's normal points at the sun. Its PD
controllers follow set-points, positions of the actuators. From one set-point to the next the actuators move
with limited speed and acceleration (`crosscheck.solar.moves`). `tracker_day` computes the set-points of a day
and simulates the motion.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from crosscheck.solar.base import Base
from crosscheck.solar.energy import THIS, ClearSky, over_day
from crosscheck.solar.geared import Geared
from crosscheck.solar.moves import Plan
from crosscheck.solar.obstacles import Faced, Ways, face
from crosscheck.solar.one_axis import MIN_ELEVATION, aim_of
from crosscheck.solar.place import Place, Sun, angles, day_times, sun_over
from crosscheck.solar.set_points import check_period, check_tracker, following
from crosscheck.solar.tracking import Tracking
from crosscheck.solar.wind import WIND, wind_on_panel
from newton_euler import Axis, Loads, Poses, compile_scene
from newton_euler.analysis.loads.actuator_motions import ActuatorMotion, actuator_motions
from newton_euler.analysis.loads.envelope import work_and_energy
from newton_euler.model.euler_parameters import rotations
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.model.wind import WindLoad
from newton_euler.scalars import Array

REST_RATE = 1e-8
"""Rates of all coordinates and velocities, SI, below which the tracker counts as at rest: the simulation
skips to the next set-point."""

MAX_DEVIATION = float(np.radians(1.0))
"""Angle, rad, between a panel and its set-point above which the report warns of it."""

MAX_OFF_VERTICAL = 1e-12
"""Largest distance from 1 of the upward component of the normal of a panel that is horizontal: 1.4e-6 rad."""

LARGE_ANGLE = 10.0
"""Set-point, rad, above which those of an actuator are printed in rad and not in mrad."""

DEFAULT_TRACKING = Tracking()
"""Rules of tracking of `tracker_day` if the caller gives none."""


LEVEL_BASE = Base()
"""Base of `tracker_day` if the caller gives none: level, with x to the east."""


@dataclass(frozen=True, eq=False)
class ActuatorDay:
    """Force and speed of an actuator over a day with n set-points and k outputs.

    Attributes:
        unit: unit of the force: N, or N m about a hinge.
        force: (k,) N or N m.
        speed: (k,) m/s or rad/s.
        power: (k,) W.
        energy: J, positive mechanical work over the day; negative work is not recovered.
        holding: (n,) force at the time of each set-point, just before its move: the force that holds the
            previous set-point. NaN while a move lasts.
        moving: (n,) force with the largest magnitude from each set-point to the next, in the move and after
            it; NaN at the last set-point.
    """

    unit: str
    force: Array
    speed: Array
    power: Array
    energy: float
    holding: Array
    moving: Array

    @classmethod
    def of(cls, motion: ActuatorMotion, day: Day) -> ActuatorDay:
        """Sum up the motion of an actuator over a day."""
        rows, force = day.rows, motion.force
        holding = np.where(day.plan.is_moving(day.seconds), np.nan, force[rows])
        moving = np.full(len(rows), np.nan)
        for k, (begin, end) in enumerate(pairwise(rows)):
            if end > begin + 1:
                part = force[begin + 1 : end]
                moving[k] = part[np.argmax(np.abs(part))]
        _, energy = work_and_energy(force, motion.position)
        unit, power = "N" if motion.is_slide else "N m", force * motion.speed
        return cls(unit, force, motion.speed, power, float(energy[-1]), holding, moving)


@dataclass(frozen=True, eq=False)
class Day:
    """Simulated day of a tracker with n set-points.

    Attributes:
        place: place of the tracker.
        sun: positions of the sun at the times of the set-points.
        aim: positions that the panel is to face: those of the sun, or for a mechanism with one degree of
            freedom the nearest directions that it can face (`crosscheck.solar.one_axis`).
        wanted: (n, 3) wanted directions of the panel's normal.
        faced: directions that the panel faces instead of those that are blocked, and the poses of the
            set-points, whose normal is as close to these directions as the mechanism allows.
        loads: static loads of actuators and joints at these poses, under weight only; those of the followers
            of gears, not of motors.
        tracking: rules of tracking: dead band, limits of tilt and shadow, and stowing in wind.
        plan: moves of the actuators between set-points.
        scene: the tracker with these moves as targets of its controllers.
        geared: the gears between the controllers and the joints that move the panel.
        motion: simulated motion, with outputs at the times of the set-points, and during and after each move.
            The pose at the time of a set-point is that which the mechanism reached for the previous one.
        ways: clearances on the ways of long moves.
        axis: the panel's normal as an axis of a body.
        wind: (n,) m/s, wind speed at the times of the set-points; None for calm.
        wind_up: upward speed of the wind as a fraction of `wind`.
        base: orientation of the base. Directions and vectors of a day are in the axes of the base, which are
            those of the scene; without rotation x is east, y north and z up.
    """

    place: Place
    sun: Sun
    aim: Sun
    wanted: Array
    faced: Faced
    loads: Loads
    tracking: Tracking
    plan: Plan
    scene: Scene
    geared: Geared
    motion: Trajectory
    ways: Ways
    axis: Axis
    wind: Array | None = None
    wind_up: float = 0.0
    base: Base = LEVEL_BASE

    @cached_property
    def seen(self) -> Sun:
        """Positions of the sun in the axes of the base."""
        return self.base.sun(self.sun, self.seconds)

    def in_world(self, directions: Array) -> Array:
        """Turn directions (n, 3) from the axes of the base to east, north and up."""
        return directions @ self.base.rotation_at_rest().T

    @property
    def has_one_axis(self) -> bool:
        """True if the face turns about one axis only, and cannot face the sun but by chance."""
        return self.faced.obstacles.has_one_axis

    @property
    def poses(self) -> Poses:
        """Poses of the set-points."""
        return self.faced.poses

    @cached_property
    def seconds(self) -> Array:
        """(n,) times of the set-points, s since midnight."""
        return self.scene.times

    @cached_property
    def rows(self) -> Array:
        """(n,) indices of the outputs of `motion` at the times of the set-points."""
        return np.searchsorted(self.motion.time, self.seconds)

    @cached_property
    def run(self) -> Trajectory:
        """The simulated motion at the times of the set-points."""
        arrays: dict[str, Any] = {
            name: values[self.rows]
            for name, values in self.motion.arrays().items()
            if values.dtype.kind == "f"
        }
        return replace(self.motion, **arrays)

    @cached_property
    def motions(self) -> tuple[ActuatorMotion, ...]:
        """Force, position and speed of each actuator at the outputs of `motion`."""
        return actuator_motions(self.scene, self.motion)

    @cached_property
    def actuators(self) -> dict[str, ActuatorDay]:
        """Forces and speeds of the actuators over the day, by the label of their joint coordinate."""
        return {motion.name: ActuatorDay.of(motion, self) for motion in self.motions}

    @property
    def period(self) -> float:
        """Time between set-points, s."""
        return self.scene.output_period

    @property
    def wind_acts(self) -> bool:
        """True if the wind has a load on the panel."""
        return any(isinstance(force, WindLoad) and force.name == WIND for force in self.scene.forces)

    def hours(self, which: Array) -> float:
        """Return the total time, h, of the set-points (n,) that are True in `which`."""
        return float(np.sum(which)) * self.period / 3600.0

    @cached_property
    def keys(self) -> dict[str, Key]:
        """Joint coordinates of the actuators by their labels, such as `slide_12`."""
        labels = self.scene.mechanism.coordinate_labels
        return {labels[law.key]: law.key for law in self.scene.control}

    def is_slide(self, actuator: str) -> bool:
        """Return True if the set-points of an actuator are in m, False if they are in rad."""
        return self.scene.mechanism.is_slide(*self.keys[actuator])

    def scale(self, actuator: str) -> tuple[float, str]:
        """Return the factor and the unit of the printed set-points of an actuator: mm, mrad, or rad for
        motors that turn far."""
        if self.is_slide(actuator):
            return 1e3, "mm"
        return (1.0, "rad") if np.abs(self.set_points[actuator]).max() > LARGE_ANGLE else (1e3, "mrad")

    @property
    def set_points(self) -> Mapping[str, Array]:
        """Joint coordinates (n,) of the set-points by actuator, m or rad from the initial pose."""
        geared = zip(self.keys, self.geared.keys, self.geared.ratios, strict=True)
        return {name: self.poses.coordinates[key] / ratio for name, key, ratio in geared}

    @cached_property
    def normals(self) -> Array:
        """(n, 3) directions of the panel's normal in the simulated motion."""
        body = self.run.body_names.index(self.axis.body)
        return rotations(self.run.quaternion[:, body]) @ self.axis.axis

    @cached_property
    def errors(self) -> Array:
        """(n,) pointing errors: angles between the panel's normal and the direction of the sun, rad.

        They are those at the times of the set-points, just before the panel moves on.
        """
        return angles(self.normals, self.seen.direction)

    @cached_property
    def error_parts(self) -> dict[str, Array]:
        """(n,) parts of the pointing error, rad, by cause. Their sum is the error or more.

        The panel at the time of a set-point has followed the previous one. The rules are those of `Tracking`.
        """
        # directions at each time: wanted now, and those of the previous set-point: wanted without and with
        # the dead band, faced, and reached by its pose
        free_now = self.tracking.normals(self.aim, self.wind, held=False)
        previous = np.maximum(np.arange(len(self.seconds)) - 1, 0)
        free, held = free_now[previous], self.wanted[previous]
        assert self.poses.direction is not None
        faced, reached = self.faced.directions[previous], self.poses.direction[previous]
        # a sun behind the plane of a base that leans is aimed at in this plane: the tilt is limited there
        in_front = above_base(self.sun, self.seen).direction
        behind = angles(in_front, self.seen.direction)
        return {
            "one axis only": angles(self.aim.direction, in_front),
            "limits of tilt, shadow and wind": angles(free_now, self.aim.direction) + behind,
            "motion of the sun between set-points": angles(free, free_now),
            "dead band": angles(held, free),
            "obstacles": angles(faced, held),
            "reach of the mechanism": angles(reached, faced),
            "motion, control and wind load": angles(self.normals, reached),
        }

    @cached_property
    def off_set_points(self) -> Array:
        """(n,) True where the panel is more than `MAX_DEVIATION` off its set-point, although it had a period
        to come there: controllers are too soft, a move is too long, or the wind turns the panel over. Moves
        at night may take longer, such as those to the position of the next morning."""
        is_off = self.error_parts["motion, control and wind load"] > MAX_DEVIATION
        return is_off & (self.sun.is_up | ~self.plan.is_moving(self.seconds))

    @property
    def stowed(self) -> Array:
        """(n,) True where the panel is stowed (lies flat) because of the wind."""
        return self.tracking.stows(self.wind, len(self.seconds))

    @property
    def is_level(self) -> Array:
        """(n,) True where the panel is horizontal in the pose of the set-point."""
        assert self.poses.direction is not None
        return self.in_world(self.poses.direction)[:, 2] > 1.0 - MAX_OFF_VERTICAL

    @property
    def faces(self) -> Array:
        """(n,) True where the panel faces the sun: no limit of tilt, shadow, reach or wind prevents it.

        This holds at the time of the set-point and of the previous one, which the panel has followed.
        """
        can_face = self.tracking.can_face(self.aim) & self.seen.is_up
        may_face = can_face & self.poses.reached & ~self.stowed & ~self.faced.replaced
        return may_face & np.append(may_face[0], may_face[:-1])

    @property
    def sun_seen(self) -> Array:
        """(n, 3) unit vectors to the sun, for drawing; at night in the plane of the base."""
        seen = self.seen.direction  # a new array at each access
        seen[~self.sun.is_up, 2] = 0.0
        return np.asarray(seen / np.linalg.norm(seen, axis=1, keepdims=True))

    @cached_property
    def sky(self) -> ClearSky:
        """Light of the clear sky at the times of the set-points."""
        return ClearSky(self.place, self.sun)

    @cached_property
    def lost_light(self) -> float:
        """W h/m^2, irradiation that is lost because wanted directions are blocked."""
        wanted, faced = (self.sky.on(self.in_world(each)) for each in (self.wanted, self.faced.directions))
        return over_day(self.seconds, wanted - faced)

    @cached_property
    def irradiance(self) -> dict[str, Array]:
        """(n,) W/m^2, irradiance on this tracker's panel (`THIS`, first) and on other panels, by name."""
        normals = {THIS: self.in_world(self.normals), **self.sky.alternatives()}
        return {name: self.sky.on(each) for name, each in normals.items()}

    @cached_property
    def light(self) -> dict[str, float]:
        """W h/m^2, irradiation over the day, by the names of `irradiance`."""
        return {name: over_day(self.seconds, power) for name, power in self.irradiance.items()}


def tracker_day(
    scene: Scene,
    axis: Axis,
    place: Place,
    date: str,
    zone: str | None = None,
    tracking: Tracking = DEFAULT_TRACKING,
    period: float = 60.0,
    wind: Array | None = None,
    wind_from: float = 0.0,
    wind_up: float = 0.0,
    base: Base = LEVEL_BASE,
) -> Day:
    """Simulate a day of a tracker, from midnight to midnight, with a new set-point every `period` s.

    The simulation skips the time in which the tracker is at rest, see `rest` of
    `newton_euler.integrators.options.Options`.

    Args:
        scene: the tracker, with PD controllers; x is east, y north, z up.
        axis: the panel's normal as an axis of a body.
        place: place of the tracker.
        date: YYYY-MM-DD.
        zone: time zone, for example "Asia/Phnom_Penh"; the nautical time zone of the place if None.
        tracking: rules of tracking.
        period: time between set-points, s.
        wind: (n,) m/s, wind speed at the times of the n set-points, for `Tracking.stow` and the load on the
            panel; None for calm. Each speed lasts until the next set-point. There is a load if the panel is a
            box, see `crosscheck.solar.wind.panel_box`.
        wind_from: direction that the wind comes from, degrees from north to the east.
        wind_up: upward speed of the wind as a fraction of `wind`, in addition, such as 0.25 or -0.25 for a
            gust on a panel that lies flat.
        base: orientation of the base, at rest. Tilt and rows are relative to the base.

    Raises:
        CrosscheckError: for a scene with other controllers, and for an invalid date, zone or period.
        NewtonEulerError: if the simulation fails.
    """
    check_period(period)
    sun = sun_over(place, day_times(date, zone or place.zone, period))
    check_tracker(scene)  # before poses are solved
    # in the axes of the base, the weight is turned
    rotation = base.rotation_at_rest()
    scene = replace(scene, gravity=rotation.T @ scene.gravity)
    geared = Geared.of(scene)
    aim = aim_of(geared.planned, axis, above_base(sun, base.sun(sun, period * np.arange(len(sun.times)))))
    wanted = tracking.normals(aim, wind)
    faced = face(geared.planned, axis, wanted, tracking)
    scene, loads, plan = following(geared, faced.poses, period, tracking)
    if wind is not None:
        load = wind_on_panel(scene, axis, scene.times, wind, wind_from, wind_up, rotation)
        scene = replace(scene, forces=(*scene.forces, *([load] if load else [])))
    scene = replace(scene, outputs=frozenset({"velocities", "actuation"}))
    motion = compile_scene(scene).simulate(times=plan.samples(scene.times), rest=REST_RATE)
    return Day(
        place=place,
        sun=sun,
        aim=aim,
        wanted=wanted,
        faced=faced,
        loads=loads,
        tracking=tracking,
        plan=plan,
        scene=scene,
        geared=geared,
        motion=motion,
        ways=faced.obstacles.ways(plan, faced.poses),
        axis=axis,
        wind=wind,
        wind_up=wind_up,
        base=base,
    )


def above_base(sun: Sun, seen: Sun) -> Sun:
    """Return the positions of the sun as seen from a base, above its plane by day and below it by night.

    By day a sun behind the plane of a base that leans is faced as nearly as the plane allows.
    """
    if np.array_equal(sun.is_up, seen.is_up):
        return seen
    night = np.minimum(seen.elevation, 0.0)
    return replace(seen, elevation=np.where(sun.is_up, np.maximum(seen.elevation, MIN_ELEVATION), night))
