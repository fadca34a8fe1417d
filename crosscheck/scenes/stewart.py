"""A Stewart platform of six legs on universal joints that drops onto the springs in its legs.

Geometry and masses of the platform in the case study "Stewart platform" of The MathWorks' SimMechanics
(edition of 2002): steel tubes and rods for legs, a disc for the platform. The springs, each of another
stiffness, and the drop from rest at the home position are this library's own, and so are the reference
figures.
"""

from __future__ import annotations

import numpy as np

from crosscheck.scenes.measure import Quantity, angular_velocity, components, position, quaternion, velocity
from newton_euler.model.forces import JointSpring
from newton_euler.model.geometry import Box, Capsule
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import Cylindrical, Universal
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

X, Y, Z = np.eye(3)


def _circle(radius: float, degrees: tuple[float, ...], height: float) -> Array:
    """(len(degrees), 3) points, m."""
    angles = np.radians(degrees)
    return np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(len(degrees), height)])


HOME = 2.0 * Z
"""Center of mass of the platform at first, m, in the plane of its joints."""

BASE = _circle(3.0, (-2.5, 2.5, 117.5, 122.5, 237.5, 242.5), 0.0)
PLATFORM = _circle(1.0, (-50.0, 50.0, 70.0, 170.0, 190.0, 290.0), HOME[2])
"""Joint points of the legs at first, (6, 3) m."""

LEG_LENGTH = float(np.linalg.norm(PLATFORM[0] - BASE[0]))
"""Of each leg at first, m."""

PART_LENGTH = 0.75 * LEG_LENGTH
"""Of the lower and of the upper part of a leg, m."""

DENSITY = 76e3 / 9.81
"""Of steel, kg/m^3."""

LOWER_RADII, UPPER_RADII = (0.03, 0.05), (0.0, 0.03)
"""Inner and outer ones of the parts of a leg, m."""

PLATFORM_RADIUS, PLATFORM_THICKNESS = 1.0, 0.05
"""m."""

STIFFNESS = (30e3, 36e3, 42e3, 48e3, 54e3, 60e3)
"""Of the springs in the legs, at rest at first, N/m."""


def stewart() -> Scene:
    """A platform of 1.2 t on six springs that drops from rest, 2 s; gravity along -z."""
    mass = DENSITY * np.pi * PLATFORM_RADIUS**2 * PLATFORM_THICKNESS
    across = mass * (3.0 * PLATFORM_RADIUS**2 + PLATFORM_THICKNESS**2) / 12.0
    axial = 0.5 * mass * PLATFORM_RADIUS**2
    plate = Box(np.array([PLATFORM_RADIUS, PLATFORM_RADIUS, 0.5 * PLATFORM_THICKNESS]), HOME)
    bodies = [
        Body.ground(),
        Body("platform", mass, HOME, np.diag([across, across, axial]), shapes=(plate,)),
    ]
    joints: list[Joint] = []
    for k, (low, high) in enumerate(zip(BASE, PLATFORM, strict=True), start=1):
        along = (high - low) / LEG_LENGTH
        fixed = np.cross(along, Z)  # axis of both universal joints in the base and the platform
        turning = np.cross(along, fixed)
        bodies += [
            _part(f"lower_{k}", low, along, LOWER_RADII),
            _part(f"upper_{k}", high, -along, UPPER_RADII),
        ]
        joints += [
            Universal(f"base_{k}", "ground", f"lower_{k}", low, axis_on_first=fixed, axis_on_second=turning),
            Cylindrical(f"leg_{k}", f"lower_{k}", f"upper_{k}", low, axis=along, point_on_second=high),
            Universal(
                f"top_{k}", "platform", f"upper_{k}", high, axis_on_first=fixed, axis_on_second=turning
            ),
        ]
    return Scene(
        "stewart",
        Mechanism(bodies, joints),
        duration=2.0,
        output_period=0.01,
        gravity=-9.81 * Z,
        forces=tuple(JointSpring(f"leg_{k + 1}", stiffness) for k, stiffness in enumerate(STIFFNESS)),
        description="Stewart platform, six sprung legs on universal joints, six degrees of freedom",
    )


def _part(name: str, end: Array, along: Array, radii: tuple[float, float]) -> Body:
    """A part of a leg from its end along a unit vector (3,); its frame is parallel to the world."""
    inner, outer = radii
    mass = DENSITY * np.pi * (outer**2 - inner**2) * PART_LENGTH
    axial = 0.5 * mass * (outer**2 + inner**2)
    across = 0.5 * axial + mass * PART_LENGTH**2 / 12.0
    projector = np.outer(along, along)
    inertia = axial * projector + across * (np.eye(3) - projector)
    bar = Capsule(end, end + PART_LENGTH * along, outer)
    return Body(name, mass, end + 0.5 * PART_LENGTH * along, inertia, shapes=(bar,))


CENTER = np.zeros(3)


def _leg_length(k: int) -> Quantity:
    def length(run: Trajectory) -> Array:
        return np.asarray(np.linalg.norm(position(run, "platform", PLATFORM[k] - HOME) - BASE[k], axis=1))

    return length


FIGURES: dict[str, Quantity] = {
    **components(("x", "y", "z"), lambda run: position(run, "platform", CENTER)),
    **components(("vx", "vy", "vz"), lambda run: velocity(run, "platform", CENTER)),
    **components(("q0", "q1", "q2", "q3"), lambda run: quaternion(run, "platform")),
    **components(("wx", "wy", "wz"), lambda run: angular_velocity(run, "platform")),
    **{f"leg{k + 1}_length": _leg_length(k) for k in range(6)},
}
"""Of the platform: center of mass (m), velocity (m/s), orientation w-x-y-z, angular velocity (rad/s, world);
lengths of the legs between their joints (m)."""
