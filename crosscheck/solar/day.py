"""A day of a solar tracker: set-points by inverse kinematics, simulated motion, pointing error and energy.

A solar tracker is a mechanism that moves a panel so that the panel's normal points at the sun. Its PD
controllers follow set-points, targets of joint coordinates that change in steps. `tracker_day` computes the
set-points of a day and simulates the motion.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from crosscheck.solar.energy import THIS, ClearSky, over_day
from crosscheck.solar.place import Place, Sun, day_times, sun_over
from crosscheck.solar.tracking import Tracking
from crosscheck.support.errors import CrosscheckError
from newton_euler import Axis, Loads, Poses, simulate, solve_poses, statics
from newton_euler.analysis.kinematics.configurations import smallest_turns
from newton_euler.analysis.loads.envelope import work_and_energy
from newton_euler.model.control import PD
from newton_euler.model.euler_parameters import rotations
from newton_euler.model.scene import Scene
from newton_euler.model.splines import Steps
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

REST_RATE = 1e-8
"""Rates of all coordinates and velocities, SI, below which the tracker counts as at rest: the simulation
skips to the next set-point."""

DEFAULT_TRACKING = Tracking()
"""Rules of tracking of `tracker_day` if the caller gives none."""


@dataclass(frozen=True, eq=False)
class Day:
    """Simulated day of a tracker with n set-points.

    Attributes:
        place: place of the tracker.
        sun: positions of the sun at the times of the set-points.
        wanted: (n, 3) wanted directions of the panel's normal (east, north, up).
        poses: poses of the mechanism whose normal is as close to `wanted` as the mechanism allows.
        loads: static loads of actuators and joints at these poses, under weight only.
        tracking: rules of tracking: dead band, limits of tilt and shadow, and stowing in wind.
        scene: the tracker with these set-points as targets of its controllers.
        run: simulated motion, with an output at the time of each set-point. The pose of an output is that
            which the mechanism reached for the previous set-point.
        axis: the panel's normal as an axis of a body.
        wind: (n,) m/s, wind speed at the times of the set-points; None for calm.
    """

    place: Place
    sun: Sun
    wanted: Array
    poses: Poses
    loads: Loads
    tracking: Tracking
    scene: Scene
    run: Trajectory
    axis: Axis
    wind: Array | None = None

    @cached_property
    def seconds(self) -> Array:
        """(n,) times of the set-points, s since midnight."""
        return self.run.time

    @property
    def period(self) -> float:
        """Time between set-points, s."""
        return self.scene.output_period

    def hours(self, which: Array) -> float:
        """Return the total time, h, of the set-points (n,) that are True in `which`."""
        return float(np.sum(which)) * self.period / 3600.0

    def is_slide(self, joint: str) -> bool:
        """Return True if the set-points of a joint are in m, False if they are in rad."""
        return self.scene.mechanism.is_slide(joint, 0)

    @property
    def set_points(self) -> Mapping[str, Array]:
        """Joint coordinates (n,) of the set-points by actuated joint, m or rad from the initial pose."""
        coordinates = (law.key for law in self.scene.control)  # (joint, index of the coordinate)
        return {joint: self.poses.coordinates[joint, index] for joint, index in coordinates}

    @cached_property
    def normals(self) -> Array:
        """(n, 3) directions of the panel's normal in the simulated motion: east, north, up."""
        body = self.run.body_names.index(self.axis.body)
        return rotations(self.run.quaternion[:, body]) @ self.axis.axis

    @cached_property
    def errors(self) -> Array:
        """(n,) pointing errors: angles between the panel's normal and the direction of the sun, rad."""
        return np.asarray(np.linalg.norm(smallest_turns(self.normals, self.sun.direction), axis=1))

    @property
    def stowed(self) -> Array:
        """(n,) True where the panel is stowed (lies flat) because of the wind."""
        return self.tracking.stows(self.wind, len(self.seconds))

    @property
    def faces(self) -> Array:
        """(n,) True where the panel faces the sun: no limit of tilt, shadow, reach or wind prevents it."""
        return self.tracking.can_face(self.sun) & self.poses.reached & ~self.stowed

    @property
    def sun_seen(self) -> Array:
        """(n, 3) unit vectors to the sun (east, north, up), for drawing; at night in the horizontal plane."""
        seen = self.sun.direction  # a new array at each access
        seen[~self.sun.is_up, 2] = 0.0
        return np.asarray(seen / np.linalg.norm(seen, axis=1, keepdims=True))

    @cached_property
    def irradiance(self) -> dict[str, Array]:
        """(n,) W/m^2, irradiance on this tracker's panel (`THIS`, first) and on other panels, by name."""
        sky = ClearSky(self.place, self.sun)
        return {name: sky.on(normals) for name, normals in {THIS: self.normals, **sky.alternatives()}.items()}

    @cached_property
    def light(self) -> dict[str, float]:
        """W h/m^2, irradiation over the day, by the names of `irradiance`."""
        return {name: over_day(self.seconds, power) for name, power in self.irradiance.items()}

    @cached_property
    def work(self) -> float:
        """Positive work of the actuators against weight over the day, W h, for quasi-static motion.

        Negative work is not recovered. The steps of PD controllers need more energy than this work.
        """
        works = []
        for force, x in zip(self.loads.actuator_force.T, self.set_points.values(), strict=True):
            _, positive_work = work_and_energy(force, x)  # (n,) J, up to each set-point
            works.append(float(positive_work[-1]))
        return sum(works) / 3600.0


def following(scene: Scene, axis: Axis, wanted: Array, period: float) -> tuple[Scene, Poses, Loads]:
    """Give a tracker set-points that make its panel face given directions.

    The feedforward of each PD controller is the static force of its set-point (`newton_euler.statics`), so
    that weight causes no steady-state error.

    Args:
        scene: the tracker; all its controllers are `PD`.
        axis: the panel's normal as an axis of a body.
        wanted: (n, 3) wanted directions of the normal, world frame.
        period: time between set-points, s.

    Returns:
        The scene with these set-points, the poses of the set-points, and the static loads at these poses.

    Raises:
        CrosscheckError: if a controller of the scene is not `PD`.
    """
    laws = [law for law in scene.control if isinstance(law, PD)]
    if not laws or len(laws) < len(scene.control):
        raise CrosscheckError(
            f"scene {scene.name!r}: set-points need PD controllers; found none, or other controllers too"
        )
    # inverse kinematics; `coordinates` of the poses are the measured joint coordinates
    poses = solve_poses(scene, axis=axis, towards=wanted, measure=[law.key for law in laws])
    times = period * np.arange(len(wanted))
    loads = statics(scene, poses, [law.joint for law in laws])
    control = tuple(
        replace(
            law,
            target=Steps(times, poses.coordinates[law.key]),
            feedforward=Steps(times, loads.actuator_force[:, k]),
        )
        for k, law in enumerate(laws)
    )
    start, end = poses.state(0), float(times[-1])
    driven = replace(scene, control=control, initial_state=start, duration=end, output_period=period)
    return driven, poses, loads


def check_period(period: float) -> None:
    """Raise `CrosscheckError` unless the time between set-points is from 1 s to 12 h."""
    if not 1.0 <= period <= 43200.0:
        raise CrosscheckError(f"period is {period:g} s; needed: 1 to 43200 s (12 h)")


def tracker_day(
    scene: Scene,
    axis: Axis,
    place: Place,
    date: str,
    zone: str | None = None,
    tracking: Tracking = DEFAULT_TRACKING,
    period: float = 60.0,
    wind: Array | None = None,
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
        wind: (n,) m/s, wind speed at the times of the n set-points, for `Tracking.stow`; None for calm. The
            wind exerts no force.

    Raises:
        CrosscheckError: for a scene with other controllers, and for an invalid date, zone or period.
        NewtonEulerError: if the simulation fails.
    """
    check_period(period)
    sun = sun_over(place, day_times(date, zone or place.zone, period))
    wanted = tracking.normals(sun, wind)
    driven, poses, loads = following(scene, axis, wanted, period)
    driven = replace(driven, outputs=frozenset({"velocities", "actuation"}))
    run = simulate(driven, rest=REST_RATE)
    return Day(
        place=place,
        sun=sun,
        wanted=wanted,
        poses=poses,
        loads=loads,
        tracking=tracking,
        scene=driven,
        run=run,
        axis=axis,
        wind=wind,
    )
