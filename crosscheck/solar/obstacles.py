"""Directions that a panel cannot face: bodies would collide, or the mechanism would be nearly singular.

A direction is free if the pose that faces it is on the assembly branch of the initial pose, keeps a clearance
between bodies that no joint connects, and keeps a distance from singular configurations. In a singular
configuration the actuators do not determine the motion (`Poses.independence`).
`Obstacles.nearest_free` finds the free direction
that is nearest to a blocked one.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from functools import cached_property
from typing import NamedTuple

import numpy as np

from crosscheck.solar.moves import Plan
from crosscheck.solar.one_axis import turns_about_one_axis
from crosscheck.solar.place import angles, tilted
from crosscheck.solar.tracking import UP, Tracking
from mjcf.clearance import Closest, closest, pair_names, pairs_within
from newton_euler import Axis, Poses, Scene, solve_poses
from newton_euler.model.joint import Key
from newton_euler.scalars import Array

AZIMUTHS = 72
"""Number of azimuths at which the largest free tilt is computed at first."""

STEEP, REFINEMENTS, INSERTED = np.radians(0.5), 3, 3
"""Change of the largest free tilt between neighboring azimuths, rad, above which other azimuths are inserted
between them, how often, and how many: 5 degrees become 0.08."""

LONG_MOVE = np.radians(2.0)
"""Turn of the panel, rad, above which the way of a move is examined, and not only its end."""

WAY_POINTS = 24
"""Number of poses that are examined on the way of a long move."""

INTERPOLATED = 20
"""Number of azimuths in each interval where the largest free tilt hardly changes and is interpolated."""

SECTIONS, DIVISIONS = 10, 3
"""Number of sections into which an interval of tilts is divided to find the first blocked tilt, and number of
divisions: of 60 degrees, a tilt is known to 0.06 degrees."""


class Cause(IntEnum):
    """Causes why a direction cannot be faced, with their names in tables."""

    FREE = 0
    COLLISION = 1
    SINGULAR = 2
    UNREACHABLE = 3

    @property
    def text(self) -> str:
        """Description of the cause."""
        return ("free", "too close", "near singular", "out of reach")[self]


class Checks(NamedTuple):
    """Clearances of n poses of a tracker, and causes for which they are blocked.

    Attributes:
        clearance: (n,) m, smallest distance between bodies; infinite without shapes.
        bodies: (n, 2) indices of these bodies.
        to_singular: (n,) distance from singular configurations, see `Poses.independence`.
        cause: (n,) `Cause` for which the pose is not free.
    """

    clearance: Array
    bodies: Array
    to_singular: Array
    cause: Array

    def rows(self, which: Array) -> Checks:
        """Return the checks of chosen poses, by their indices (k,)."""
        return Checks(*(values[which] for values in self))


class Obstacles:
    """Obstacles of a tracker.

    Attributes:
        left_out: pairs of bodies whose shapes overlap even if the panel lies flat, by design; such pairs are
            not examined.
        near: other pairs of bodies that are nearer than the clearance if the panel lies flat; such pairs are
            too close in poses in which they overlap.
        can_avoid: True if the flat panel is free, from which free directions are searched.
    """

    def __init__(
        self, scene: Scene, axis: Axis, tracking: Tracking, keys: Sequence[Key] | None = None
    ) -> None:
        """Examine the pose of the flat panel, or the pose nearest to it.

        `keys` are the actuated joint coordinates; None for those of the scene's controllers.
        """
        self._scene, self._axis, self._tracking = scene, axis, tracking
        self._keys = [law.key for law in scene.control] if keys is None else list(keys)
        flat = self.poses(UP[None])
        pose = scene.mechanism, flat.position[0], flat.quaternion[0]
        self.left_out = pairs_within(*pose)
        self.near = pairs_within(*pose, tracking.clearance, self.left_out)
        self.can_avoid = bool(self.check(flat).cause[0] == Cause.FREE)

    @cached_property
    def has_one_axis(self) -> bool:
        """True if the face turns about one axis only."""
        return turns_about_one_axis(self._scene, self._axis)

    def poses(self, directions: Array) -> Poses:
        """Solve the poses that face directions (n, 3), or come nearest to them."""
        return solve_poses(self._scene, axis=self._axis, towards=directions, measure=self._keys)

    def facing(self, directions: Array) -> tuple[Poses, Checks]:
        """Solve and examine the poses that face directions (n, 3).

        The pose of a direction out of reach is not the nearest one, unless the mechanism has one degree of
        freedom: such a mechanism cannot face most directions, and comes as near to them as it can.
        """
        poses = solve_poses(
            self._scene,
            axis=self._axis,
            towards=directions,
            measure=self._keys,
            nearest=self.has_one_axis,
        )
        checks = self.check(poses)
        if self.has_one_axis:
            return poses, checks
        return poses, checks._replace(cause=np.where(poses.reached, checks.cause, Cause.UNREACHABLE))

    def check(self, poses: Poses) -> Checks:
        """Examine n poses."""
        found = self._closest(poses)
        # without actuators, no configuration is singular
        to_singular = poses.independence(self._keys) if self._keys else np.full(len(poses), np.inf)
        cause = np.full(len(poses), int(Cause.FREE))
        # the last cause that applies is kept, so the order is by rank
        cause[to_singular < self._tracking.to_singular] = Cause.SINGULAR
        cause[found.distance < self._tracking.clearance] = Cause.COLLISION
        cause[poses.beyond | ~poses.closed] = Cause.UNREACHABLE
        return Checks(found.distance, found.bodies, to_singular, cause)

    def _closest(self, poses: Poses) -> Closest:
        """Find the closest bodies in n poses: of the pairs in `near`, only those that overlap count."""
        bodies_at = self._scene.mechanism, poses.position, poses.quaternion
        found = closest(*bodies_at, self.left_out | self.near)
        if not self.near:
            return found
        near = closest(*bodies_at, among=self.near)
        overlaps = (near.distance <= 0.0) & (near.distance < found.distance)
        return Closest(
            np.where(overlaps, near.distance, found.distance),
            np.where(overlaps[:, None], near.bodies, found.bodies),
        )

    @property
    def notes(self) -> list[str]:
        """Sentences on the pairs of bodies that are not examined as all others are."""
        lines = []
        if self.left_out:
            lines.append(
                f"overlap even if the panel lies flat, so never examined: {pair_names(self.left_out)}"
            )
        if self.near:
            why = (
                "nearer than the clearance even if the panel lies flat, so too close only where they overlap"
            )
            lines.append(f"{why}: {pair_names(self.near)}")
        return lines

    def nearest_free(self, wanted: Array, reached: Array) -> Array:
        """Return the free directions (m, 3) nearest to blocked ones.

        Free directions are those that the panel reaches from flat at a constant azimuth without an obstacle.
        A face that turns about one axis only turns back towards the flat pose.

        Args:
            wanted: (m, 3) directions that are blocked, in the axes of the scene.
            reached: (m, 3) directions of the poses that come nearest to them.
        """
        if self.has_one_axis:
            azimuth = np.arctan2(reached[:, 0], reached[:, 1])
            return tilted(self._largest_tilts(azimuth), azimuth)
        directions, which = np.unique(wanted.round(9), axis=0, return_inverse=True)
        azimuths, tilts = self._boundary
        azimuth, _ = _nearest(directions, azimuths, tilts)
        chosen, of_direction = np.unique(azimuth, return_inverse=True)
        exact = self._largest_tilts(chosen)[of_direction]
        _, tilt = _nearest(directions, azimuth, exact, paired=True)
        return tilted(tilt, azimuth)[which.ravel()]

    @cached_property
    def _boundary(self) -> tuple[Array, Array]:
        """Azimuths (k,), rad, and the largest free tilt (k,), rad, at each of them.

        The tilt may jump from one azimuth to another. Where it is smooth, it is interpolated.
        """
        # azimuths of a whole turn, the first one again at its end
        azimuths = np.linspace(0.0, 2.0 * np.pi, AZIMUTHS + 1)
        tilts = self._largest_tilts(azimuths)
        for _ in range(REFINEMENTS):
            steep = np.flatnonzero(np.abs(np.diff(tilts)) > STEEP)
            if not len(steep):
                break
            part = np.arange(1, INSERTED + 1) / (INSERTED + 1)
            between = (azimuths[steep, None] + np.diff(azimuths)[steep, None] * part).ravel()
            places = np.repeat(steep + 1, INSERTED)
            tilts = np.insert(tilts, places, self._largest_tilts(between))
            azimuths = np.insert(azimuths, places, between)
        smooth = np.flatnonzero(np.abs(np.diff(tilts)) <= STEEP)
        part = np.arange(1, INTERPOLATED) / INTERPOLATED
        fine = (azimuths[smooth, None] + np.diff(azimuths)[smooth, None] * part).ravel()
        return np.append(azimuths, fine), np.append(tilts, np.interp(fine, azimuths, tilts))

    def ways(self, plan: Plan, poses: Poses) -> Ways:
        """Examine the ways of long moves, which are straight in the joint coordinates of the actuators.

        Args:
            plan: moves between set-points.
            poses: poses of the set-points.
        """
        assert poses.direction is not None
        ends = np.concatenate([[0], plan.target])
        turns = angles(poses.direction[ends[:-1]], poses.direction[ends[1:]])
        is_long = turns > LONG_MOVE
        first, last = ends[:-1][is_long], ends[1:][is_long]
        part = np.linspace(0.0, 1.0, WAY_POINTS)
        coordinates: dict[str | Key, Array] = {
            key: (x[first, None] + (x[last] - x[first])[:, None] * part).ravel()
            for key, x in ((key, poses.coordinates[key]) for key in self._keys)
        }
        if not is_long.any():
            return Ways(np.zeros(0), self.check(poses).rows(np.zeros(0, dtype=int)))
        checks = self.check(solve_poses(self._scene, coordinates, start=poses.state(int(first[0]))))
        # of each way the pose with the highest cause, and among these that with the smallest clearance
        rank = checks.cause - np.tanh(checks.clearance)
        worst = np.argmax(rank.reshape(-1, WAY_POINTS), axis=1)
        return Ways(plan.begin[is_long], checks.rows(worst + WAY_POINTS * np.arange(len(worst))))

    def _largest_tilts(self, azimuths: Array) -> Array:
        """Find the tilts (k,), rad, up to which all directions with given azimuths (k,), rad, are free."""
        low = np.zeros(len(azimuths))
        high = np.full(len(azimuths), np.radians(self._tracking.max_tilt))
        part = np.arange(1, SECTIONS + 1) / SECTIONS
        for _ in range(DIVISIONS):
            # ends of the sections of each interval, and the number of free ones before the first blocked one
            ends = low[:, None] + (high - low)[:, None] * part
            free = self._are_free(ends.ravel(), np.repeat(azimuths, SECTIONS)).reshape(ends.shape)
            count = np.argmin(np.append(free, np.zeros((len(free), 1), dtype=bool), axis=1), axis=1)
            edges, rows = np.hstack([low[:, None], ends, high[:, None]]), np.arange(len(ends))
            low, high = edges[rows, count], edges[rows, count + 1]
        return low

    def _are_free(self, tilts: Array, azimuths: Array) -> Array:
        """Return an array (k,) that is True for free directions among those with given angles (k,), rad."""
        _, checks = self.facing(tilted(tilts, azimuths))
        return np.asarray(checks.cause == Cause.FREE)


def _nearest(directions: Array, azimuths: Array, tilts: Array, paired: bool = False) -> tuple[Array, Array]:
    """Find the points of meridians that are nearest to directions (m, 3).

    Args:
        directions: unit vectors in the axes of the scene.
        azimuths: (k,) rad, of the meridians.
        tilts: (k,) rad, at which the meridians end; they begin at the zenith.
        paired: True if each direction has its own meridian, k = m.

    Returns:
        Azimuth and tilt (m,), rad, of the nearest points.
    """
    across = directions[:, :2] @ np.stack([np.sin(azimuths), np.cos(azimuths)])
    if paired:
        across = np.diagonal(across)[:, None]
        tilts = tilts[:, None]
    up = directions[:, 2:]
    # on a meridian, the cosine of the angle is up cos(tilt) + across sin(tilt)
    tilt = np.clip(np.arctan2(across, up), 0.0, tilts)
    best = np.argmax(up * np.cos(tilt) + across * np.sin(tilt), axis=1)
    rows = np.arange(len(directions))
    return azimuths if paired else azimuths[best], tilt[rows, best]


class Ways(NamedTuple):
    """Clearances on the ways of the m long moves of a tracker.

    Attributes:
        begin: (m,) s, times at which the moves begin.
        checks: of the closest pose on each way.
    """

    begin: Array
    checks: Checks


class Faced(NamedTuple):
    """Directions that a tracker faces instead of n wanted ones, some of which are blocked.

    Attributes:
        directions: (n, 3) unit vectors in the axes of the scene.
        poses: poses of these directions.
        checks: of these poses.
        wanted_checks: of the poses that face the wanted directions.
        obstacles: the obstacles of the tracker.
    """

    directions: Array
    poses: Poses
    checks: Checks
    wanted_checks: Checks
    obstacles: Obstacles

    @property
    def replaced(self) -> Array:
        """(n,) True where the wanted direction is blocked."""
        return np.asarray(self.wanted_checks.cause != Cause.FREE)


def face(
    scene: Scene, axis: Axis, wanted: Array, tracking: Tracking, keys: Sequence[Key] | None = None
) -> Faced:
    """Replace wanted directions (n, 3) that are blocked by the nearest free ones.

    If not even the flat panel is free, the directions are examined and kept.

    Args:
        scene: the tracker.
        axis: the panel's normal as an axis of a body.
        wanted: (n, 3) unit vectors in the axes of the scene.
        tracking: gives the clearance, the distance from singular configurations and the largest tilt.
        keys: actuated joint coordinates; those of the scene's controllers if None.
    """
    obstacles = Obstacles(scene, axis, tracking, keys)
    poses = obstacles.poses(wanted)
    checks = wanted_checks = obstacles.check(poses)
    blocked, directions = np.flatnonzero(checks.cause != Cause.FREE), wanted
    if len(blocked) and obstacles.can_avoid:
        directions = wanted.copy()
        assert poses.direction is not None
        directions[blocked] = obstacles.nearest_free(wanted[blocked], poses.direction[blocked])
        poses = obstacles.poses(directions)
        checks = obstacles.check(poses)
    return Faced(directions, poses, checks, wanted_checks, obstacles)
