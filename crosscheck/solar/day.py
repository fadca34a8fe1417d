"""A day of a solar tracker: set-points by inverse kinematics, the motion between them, and what it yields."""

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

REST = 1e-8
"""Rates, SI, below which the tracker stays where it is until the next set-point."""


FOLLOWING = Tracking()


@dataclass(frozen=True, eq=False)
class Day:
    """A tracker's day; n set-points.

    Attributes:
        place: where.
        sun: at the set-points.
        wanted: (n, 3) where the panel's normal was to point.
        poses: that face there, or as nearly as the mechanism can.
        loads: on actuators and joints where they hold these poses at rest, under weight alone.
        tracking: how it was to follow the sun.
        scene: the tracker with these set-points.
        run: its motion, with an output at each set-point, just before the next.
        axis: the panel's normal.
        wind: (n,) m/s at the set-points; None for calm.
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
        """(n,) s since midnight."""
        return self.run.time

    @property
    def period(self) -> float:
        """s between set-points."""
        return self.scene.output_period

    def hours(self, which: Array) -> float:
        """Compute the time, h, of those set-points (n,) that are True."""
        return float(np.sum(which)) * self.period / 3600.0

    def is_slide(self, joint: str) -> bool:
        """Return True if the set-points of a joint are in m, False if they are in rad."""
        return self.scene.mechanism.is_slide(joint, 0)

    @property
    def commands(self) -> Mapping[str, Array]:
        """Joint coordinates (n,) of the set-points by actuated joint, m or rad from the initial pose."""
        laws = (law.key for law in self.scene.control)
        return {key[0]: self.poses.coordinates[key] for key in laws}

    @cached_property
    def normals(self) -> Array:
        """(n, 3) the panel's normal as it moved: east, north, up."""
        body = self.run.body_names.index(self.axis.body)
        return rotations(self.run.quaternion[:, body]) @ self.axis.axis

    @cached_property
    def errors(self) -> Array:
        """(n,) rad between the panel's normal and the sun."""
        return np.asarray(np.linalg.norm(smallest_turns(self.normals, self.sun.direction), axis=1))

    @property
    def stowed(self) -> Array:
        """(n,) True where the panel is to lie flat in the wind."""
        return self.tracking.stows(self.wind, len(self.seconds))

    @property
    def faces(self) -> Array:
        """(n,) True where the sun is up, and neither tilt, shadow, reach nor wind keep the panel off it."""
        return self.tracking.can_face(self.sun) & self.poses.reached & ~self.stowed

    @property
    def sun_seen(self) -> Array:
        """(n, 3) the sun's direction, at night along the horizon below which it is."""
        seen = self.sun.direction
        seen[~self.sun.is_up, 2] = 0.0
        return np.asarray(seen / np.linalg.norm(seen, axis=1, keepdims=True))

    @cached_property
    def irradiance(self) -> dict[str, Array]:
        """W/m^2 (n,) of sunlight on this panel, the first, and on others by name."""
        sky = ClearSky(self.place, self.sun)
        return {name: sky.on(normals) for name, normals in {THIS: self.normals, **sky.alternatives()}.items()}

    @cached_property
    def light(self) -> dict[str, float]:
        """W h/m^2 over the day, by the same names."""
        return {name: over_day(self.seconds, power) for name, power in self.irradiance.items()}

    @cached_property
    def work(self) -> float:
        """W h that the actuators take over the day against weight, as if they moved slowly, see
        `work_and_energy`. Jumps that PD laws make take more."""
        pairs = zip(self.loads.actuator_force.T, self.commands.values(), strict=True)
        return sum(float(work_and_energy(force, x)[1][-1]) for force, x in pairs) / 3600.0


def following(scene: Scene, axis: Axis, wanted: Array, period: float) -> tuple[Scene, Poses, Loads]:
    """Return a tracker that is sent to face directions, the poses that do, and what holds these at rest.

    The feedforward of each PD law is the force that holds the pose of its set-point
    (`newton_euler.statics`), so that weight does not pull the panel off it.

    Args:
        scene: the tracker; actuated joints have PD laws.
        axis: of the panel, its normal.
        wanted: (n, 3) where it is to point.
        period: s between set-points.

    Raises:
        CrosscheckError: for a scene without PD laws.
    """
    laws = [law for law in scene.control if isinstance(law, PD)]
    if not laws or len(laws) < len(scene.control):
        raise CrosscheckError(
            f"scene {scene.name!r}: its laws are not PD laws alone, whose targets set-points are"
        )
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
    """Raise `CrosscheckError` for a time between set-points, s, that days are not made with."""
    if not 1.0 <= period <= 43200.0:
        raise CrosscheckError(f"period is {period:g} s: from 1 s to half a day")


def tracker_day(
    scene: Scene,
    axis: Axis,
    place: Place,
    date: str,
    zone: str | None = None,
    tracking: Tracking = FOLLOWING,
    period: float = 60.0,
    wind: Array | None = None,
) -> Day:
    """Simulate a day of a tracker from midnight to midnight, its set-points changed every `period` s.

    Rests between set-points are skipped, see `newton_euler.integrators.options.Options`.

    Args:
        scene, axis: as of `following`; x is east, y north, z up.
        place: where.
        date: YYYY-MM-DD.
        zone: time zone of that day; the place's own hours from Greenwich if None.
        tracking: how to follow the sun.
        period: s.
        wind: (n,) m/s at the n set-points from midnight on, for `Tracking.stow`; None for calm.

    Raises:
        CrosscheckError: for a scene without PD laws, a date, a zone or a period that is none.
        NewtonEulerError: for a run that cannot go on.
    """
    check_period(period)
    sun = sun_over(place, day_times(date, zone or place.zone, period))
    wanted = tracking.normals(sun, wind)
    driven, poses, loads = following(scene, axis, wanted, period)
    driven = replace(driven, outputs=frozenset({"velocities", "actuation"}))
    run = simulate(driven, rest=REST)
    return Day(place, sun, wanted, poses, loads, tracking, driven, run, axis, wind)
