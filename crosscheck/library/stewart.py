"""Scene of a Stewart platform: six legs on universal joints, and springs in the legs on which the platform
drops.

Geometry and masses are those of the case study "Stewart platform" of The MathWorks' SimMechanics (edition of
2002): the legs are steel tubes and rods, the platform is a disc. The case study has no springs. Here each leg
has a spring of a different stiffness, and the platform is released at rest in the home position.
"""

from __future__ import annotations

import numpy as np

from crosscheck.library.measure import Quantity, angular_velocity, components, position, quaternion, velocity
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
    """Return points (len(degrees), 3), m, on a horizontal circle about the z axis."""
    angles = np.radians(degrees)
    return np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(len(degrees), height)])


HOME = 2.0 * Z
"""Initial center of mass of the platform, m. It lies in the plane of the platform's joints."""

BASE = _circle(3.0, (-2.5, 2.5, 117.5, 122.5, 237.5, 242.5), 0.0)
"""Joint points (6, 3) of the legs at the base, m."""

PLATFORM = _circle(1.0, (-50.0, 50.0, 70.0, 170.0, 190.0, 290.0), HOME[2])
"""Initial joint points (6, 3) of the legs at the platform, m."""

LEG_LENGTH = float(np.linalg.norm(PLATFORM[0] - BASE[0]))
"""Initial length of each leg, m."""

PART_LENGTH = 0.75 * LEG_LENGTH
"""Length of the lower and of the upper part of a leg, m."""

DENSITY = 76e3 / 9.81
"""Density of steel, kg/m^3: 76 kN/m^3 by weight."""

LOWER_RADII, UPPER_RADII = (0.03, 0.05), (0.0, 0.03)
"""Inner and outer radii of the parts of a leg, m."""

PLATFORM_RADIUS, PLATFORM_THICKNESS = 1.0, 0.05
"""Size of the platform, a disc, m."""

LEG_STIFFNESS = (30e3, 36e3, 42e3, 48e3, 54e3, 60e3)
"""Stiffness of the springs in legs 1 to 6, N/m. All springs are unstretched at the start."""


def stewart() -> Scene:
    """Return the platform, 1.2 t on six springs, which drops from rest, 2 s; gravity along -z."""
    mass = DENSITY * np.pi * PLATFORM_RADIUS**2 * PLATFORM_THICKNESS
    across = mass * (3.0 * PLATFORM_RADIUS**2 + PLATFORM_THICKNESS**2) / 12.0
    axial = 0.5 * mass * PLATFORM_RADIUS**2
    # shape for pictures: the square around the disc
    plate = Box(np.array([PLATFORM_RADIUS, PLATFORM_RADIUS, 0.5 * PLATFORM_THICKNESS]), HOME)
    bodies = [
        Body.ground(),
        Body("platform", mass, HOME, np.diag([across, across, axial]), shapes=(plate,)),
    ]
    # Legs: two parts on a cylindrical joint, with a universal joint at each end
    joints: list[Joint] = []
    for k, (low, high) in enumerate(zip(BASE, PLATFORM, strict=True), start=1):
        along = (high - low) / LEG_LENGTH
        fixed = np.cross(along, Z)  # axis of the universal joints in the base and in the platform
        turning = np.cross(along, fixed)  # axis of the universal joints in the parts of the leg
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
        # on the first coordinate of the cylindrical joint, the slide, which is zero at the start
        forces=tuple(
            JointSpring(f"leg_{k}", stiffness=stiffness) for k, stiffness in enumerate(LEG_STIFFNESS, start=1)
        ),
        description="Stewart platform, six sprung legs on universal joints, six degrees of freedom",
    )


def _part(name: str, end: Array, along: Array, radii: tuple[float, float]) -> Body:
    """Return a part of a leg, a tube from its end (3,), m, along a unit vector (3,).

    The frame of the part is parallel to the world. `radii` are the inner and the outer one, m.
    """
    inner, outer = radii
    mass = DENSITY * np.pi * (outer**2 - inner**2) * PART_LENGTH
    axial = 0.5 * mass * (outer**2 + inner**2)
    across = 0.5 * axial + mass * PART_LENGTH**2 / 12.0
    projector = np.outer(along, along)
    inertia = axial * projector + across * (np.eye(3) - projector)
    bar = Capsule(end, end + PART_LENGTH * along, outer)
    return Body(name, mass, end + 0.5 * PART_LENGTH * along, inertia, shapes=(bar,))


CENTER = np.zeros(3)
"""Center of mass (3,) of a body, in its own frame, m."""


def _leg_length(k: int) -> Quantity:
    """Return the function that measures the length (n,), m, of leg k, counted from 0, between its joints."""

    def length(run: Trajectory) -> Array:
        """Return the distance (n,), m, between the joints of the leg."""
        return np.asarray(np.linalg.norm(position(run, "platform", PLATFORM[k] - HOME) - BASE[k], axis=1))

    return length


REFERENCE_QUANTITIES: dict[str, Quantity] = {
    **components(("x", "y", "z"), lambda run: position(run, "platform", CENTER)),
    **components(("vx", "vy", "vz"), lambda run: velocity(run, "platform", CENTER)),
    **components(("q0", "q1", "q2", "q3"), lambda run: quaternion(run, "platform")),
    **components(("wx", "wy", "wz"), lambda run: angular_velocity(run, "platform")),
    **{f"leg{k + 1}_length": _leg_length(k) for k in range(6)},
}
"""Center of mass (m), velocity (m/s), orientation (w, x, y, z) and angular velocity (rad/s, world frame) of
the platform, and lengths of the legs between their joints (m).

`crosscheck.library.references` has values of these quantities from other sources than simulations."""
