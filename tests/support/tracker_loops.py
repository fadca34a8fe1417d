"""The loops of the solar tracker by hand, and a search that misses none of their solutions.

Unknown are three angles from the initial pose: of the column's hinge, and about both axes of the universal
joint on top of it. With H and U the points of these joints, a ball at P of the panel is at

    H + R(hinge, lean) (U - H + R(first, pitch) R(second, roll) (P - U))

and the equations are: ball_67 stays in the plane across hinge_26, and both legs keep their lengths. Nothing
here is taken from newton_euler.
"""

from __future__ import annotations

import numpy as np

from crosscheck.library.tracker import joint_data

JOINTS = {joint["name"]: joint for joint in joint_data()["joints"]}

H, U = (np.array(JOINTS[name]["point"]) for name in ("hinge_14", "universal_47"))

AXES = [
    np.array(axis) / np.linalg.norm(axis)
    for axis in (
        JOINTS["hinge_14"]["axis"],
        JOINTS["universal_47"]["axis_on_first"],
        JOINTS["universal_47"]["axis_on_second"],
    )
]

BALLS = [np.array(JOINTS[name]["point"]) for name in ("ball_67", "ball_57")]

FEET = [np.array(JOINTS[name]["point"]) for name in ("hinge_26", "universal_35")]

LENGTHS = [float(np.linalg.norm(ball - foot)) for ball, foot in zip(BALLS, FEET, strict=True)]

REACHES = [float(np.linalg.norm(U - H) + 3.0 * np.linalg.norm(ball - U)) for ball in BALLS]
"""m/rad: by how much a ball moves at most where all three angles change by as much."""

BOXES = 24
"""Of the first division of each angle."""

SMALL = 2e-3
"""Half width of boxes, rad, from which Newton's method goes on."""

NEWTON_STEPS, DIFFERENCE = 12, 1e-6


def turned(axis, angle, vectors):
    """Vectors (..., 3) turned about a unit axis by angles (...), by Rodrigues' formula."""
    c, s = np.cos(angle)[..., None], np.sin(angle)[..., None]
    return c * vectors + s * np.cross(axis, vectors) + (1.0 - c) * (vectors @ axis)[..., None] * axis


def place(angles, ball):
    """Positions (..., 3) of a ball at angles (..., 3)."""
    lean, pitch, roll = np.moveaxis(angles, -1, 0)
    arm = np.broadcast_to(ball - U, (*lean.shape, 3))
    return H + turned(AXES[0], lean, U - H + turned(AXES[1], pitch, turned(AXES[2], roll, arm)))


def panel(angles):
    """Rotation (3, 3) of the panel from its initial orientation at angles (3,)."""
    columns = np.eye(3)
    for axis, angle in zip(reversed(AXES), reversed(angles), strict=True):
        columns = turned(axis, np.full(3, angle), columns)
    return columns.T


def residuals(angles, heights):
    """Residuals (..., 3) of the plane and of both lengths, m, at heights of the sliders, m."""
    points = [place(angles, ball) for ball in BALLS]
    found = [points[0][..., 1] - FEET[0][1]]
    for point, foot, length, height in zip(points, FEET, LENGTHS, heights, strict=True):
        found.append(np.linalg.norm(point - foot - [0.0, 0.0, height], axis=-1) - length)
    return np.stack(found, axis=-1)


def solutions(heights, around=(0.0, 0.0, 0.0), reach=np.pi):
    """All angles (n, 3) within reach that close the loops: boxes without any are left out, others divided.

    No residual is zero in a box if it is larger at its center than its change to any corner can be.
    """
    limits = np.array([REACHES[0], *REACHES])
    half = reach / BOXES
    middle = -reach + half * (2.0 * np.arange(BOXES) + 1.0)
    centers = around + np.stack(np.meshgrid(middle, middle, middle), axis=-1).reshape(-1, 3)
    corners = np.array(list(np.ndindex(2, 2, 2))) - 0.5
    while True:
        centers = centers[np.all(np.abs(residuals(centers, heights)) <= half * limits, axis=1)]
        if half < SMALL:
            break
        centers = (centers[:, None] + half * corners).reshape(-1, 3)
        half *= 0.5
    found = np.zeros((0, 3))
    for angles in newton(centers, heights):
        if np.all(np.abs(residuals(angles, heights)) < 1e-12) and np.all(_apart(found, angles) > 1e-6):
            found = np.vstack([found, angles])
    return found


def newton(angles, heights):
    """Solutions (n, 3) near angles (n, 3), by Newton's method with differences."""
    for _ in range(NEWTON_STEPS):
        columns = [
            (residuals(angles + step, heights) - residuals(angles - step, heights)) / (2.0 * DIFFERENCE)
            for step in DIFFERENCE * np.eye(3)
        ]
        right = residuals(angles, heights)[..., None]
        angles = angles - np.clip(np.linalg.solve(np.stack(columns, axis=-1), right)[..., 0], -0.1, 0.1)
    return angles


def _apart(angles, other):
    """Largest differences (n,) of angles (n, 3) from others (3,), rad."""
    return np.max(np.abs(np.remainder(angles - other + np.pi, 2.0 * np.pi) - np.pi), axis=1)
