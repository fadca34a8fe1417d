"""Solar tracking from a base that is not level or that moves: a slope, a ship, a float, a vehicle.

The base turns with the world as in `newton_euler.runs.moving_base`: its rotation is
R_z(yaw) R_y(pitch) R_x(roll). Without rotation its axes x, y, z point east, north and up. The heading of a
ship whose bow points along x is the angle of x from north to the east: 90 degrees minus the yaw.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from crosscheck.solar.geared import Geared
from crosscheck.solar.place import Sun
from crosscheck.solar.set_points import pd_laws
from crosscheck.support.errors import CrosscheckError
from newton_euler import Axis, Polynomial, Poses, Spline, on_moving_base, solve_poses, statics
from newton_euler.errors import choices, plain_number
from newton_euler.model.motions import TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.runs.moving_base import HINGES, SLIDES
from newton_euler.scalars import Array, Stack, unstacked

EAST = 90.0
"""Heading, degrees from north to the east, of a base that is not turned: its x axis points east."""


LEVEL = Polynomial((0.0,))
"""Angle, rad, of a base about an axis about which it is not turned."""


@dataclass(frozen=True)
class Base:
    """Motion of the base of a tracker.

    Attributes:
        motions: functions of time by name, as for `newton_euler.on_moving_base`: surge, sway, heave, m, and
            roll, pitch, yaw, rad. Others stay 0.
    """

    motions: Mapping[str, TimeFunction] = field(default_factory=dict)

    def __post_init__(self) -> None:
        names = (*SLIDES, *HINGES)
        for name in self.motions:
            if name not in names:
                raise CrosscheckError(f"base: unknown motion {name!r:.100}; {choices(name, names)}")

    @classmethod
    def at_rest(cls, heading: float = EAST, roll: float = 0.0, pitch: float = 0.0) -> Base:
        """Return a base at rest.

        Args:
            heading: direction of the base's x axis, degrees from north to the east.
            roll: rotation about the base's x axis, degrees; positive raises the y axis.
            pitch: rotation about the base's y axis, degrees; positive lowers the x axis.
        """
        angles = {"yaw": EAST - heading, "pitch": pitch, "roll": roll}
        return cls({name: Polynomial((float(np.radians(angle)),)) for name, angle in angles.items()})

    def rotations(self, seconds: Array) -> Array:
        """Compute the rotations (n, 3, 3) from the base's axes to the world's at times (n,), s."""
        turned = np.tile(np.eye(3), (len(seconds), 1, 1))
        for name, axis in HINGES.items():  # from the world to the base: yaw, pitch, roll
            if name in self.motions:
                angles = unstacked([self.motions[name].value(Stack(seconds))], len(seconds))[:, 0]
                turned = turned @ _turns(axis, angles)
        return turned

    def rotation_at_rest(self) -> Array:
        """Return the rotation (3, 3) from the base's axes to the world's of a base that does not turn.

        Raises:
            CrosscheckError: if the base turns.
        """
        for name in HINGES:
            angle = self.motions.get(name, LEVEL)
            if not isinstance(angle, Polynomial) or len(angle.coefficients) > 1:
                raise CrosscheckError(f"base: {name} varies with time; needed: a base at rest")
        return np.asarray(self.rotations(np.zeros(1))[0])

    def sun(self, sun: Sun, seconds: Array) -> Sun:
        """Return the positions of the sun in the axes of the base: azimuth from y to x, elevation above xy.

        `sun` has n positions in the world, at the times `seconds` (n,) of the base's motion, s.
        """
        if not self.motions:
            return sun
        east, north, up = np.einsum("nji,nj->ni", self.rotations(seconds), sun.direction).T
        azimuth, elevation = np.arctan2(east, north) % (2.0 * np.pi), np.arctan2(up, np.hypot(east, north))
        return Sun(sun.times, azimuth, elevation)


def _turns(axis: Array, angles: Array) -> Array:
    """Compute the matrices (n, 3, 3) of rotations by angles (n,), rad, about a unit vector (3,)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, versine = np.sin(angles)[:, None, None], (1.0 - np.cos(angles))[:, None, None]
    return np.eye(3) + sine * cross + versine * (cross @ cross)  # Rodrigues' formula


def base_of(text: str) -> Base:
    """Parse the orientation of a base at rest, such as "heading=180,roll=20", degrees.

    Raises:
        CrosscheckError: for another form, an unknown or repeated name, and angles beyond 360 degrees.
    """
    names = ("heading", "roll", "pitch")
    angles: dict[str, float] = {}
    for part in text.split(","):
        name, _, value = part.partition("=")
        if name not in names or name in angles:
            raise CrosscheckError(f"--base {text!r:.100}: needed: each of {', '.join(names)} at most once")
        try:
            angles[name] = plain_number(value)
        except ValueError as error:
            raise CrosscheckError(
                f"--base {text!r:.100}: {name} is {value!r:.40}; needed: degrees"
            ) from error
        if abs(angles[name]) > 360.0:
            raise CrosscheckError(f"--base {text!r:.100}: {name} is {value}; needed: at most 360 degrees")
    return Base.at_rest(**angles)


def following_on_base(
    scene: Scene, axis: Axis, wanted: Array, base: Base, period: float, **names: Any
) -> tuple[Scene, Poses]:
    """Put a tracker on a moving base, with set-points that make its face point in given directions.

    Splines join the set-points. The feedforward of each controller is the static force at its set-point, with
    the weight in the axes of the base at that time; forces of acceleration are not fed forward.

    Args:
        scene: the tracker on a level base at rest; all its controllers are `PD`.
        axis: normal of the face as an axis of a body.
        wanted: (n, 3) wanted directions of the normal in the axes of the world, such as those to the sun. To
            limit the tilt, use `Tracking.towards(base.sun(...))` and turn the result to the world.
        base: motion of the base.
        period: time between set-points, s.
        names: names of the new ground and of its joint, as for `newton_euler.on_moving_base`.

    Returns:
        The scene, and the poses of the set-points relative to the base.

    Raises:
        CrosscheckError: if a controller of the scene is not `PD`.
        newton_euler.NewtonEulerError: for fewer than 6 directions, which a spline needs.
    """
    laws, geared, seconds = pd_laws(scene), Geared.of(scene), period * np.arange(len(wanted))
    rotations = base.rotations(seconds)
    from_base = np.einsum("nji,nj->ni", rotations, wanted)
    poses = solve_poses(geared.planned, axis=axis, towards=from_base, measure=geared.keys)
    # forces are linear in gravity: those without weight, and changes by 1 m/s^2 along each axis of the base
    weightless, *along = (
        statics(replace(geared.planned, gravity=gravity), poses, geared.keys).actuator_force
        for gravity in (np.zeros(3), *np.eye(3))
    )
    gravity = np.einsum("nji,j->ni", rotations, np.asarray(scene.gravity, dtype=float))
    force = weightless + sum(
        (part - weightless) * g[:, None] for part, g in zip(along, gravity.T, strict=True)
    )
    control = tuple(
        replace(
            law,
            target=Spline(seconds, poses.coordinates[key] / ratio),
            feedforward=Spline(seconds, held * ratio),
        )
        for law, key, ratio, held in zip(laws, geared.keys, geared.ratios, force.T, strict=True)
    )
    driven = replace(
        scene,
        control=control,
        initial_state=geared.start(poses),
        duration=float(seconds[-1]),
        output_period=period,
    )
    return on_moving_base(driven, dict(base.motions), **names), poses
