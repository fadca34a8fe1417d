"""Identify the joint points of a published solar tracker from the paper's tables.

The tables list bodies but no joints; `crosscheck.library.tracker` cites the paper. Run
`python -m crosscheck.library.tracker_geometry` to repeat the identification and print its residuals. The
result is stored in `tracker_joints.json`. Numbers in names of bodies are those of the paper: fixed base 1,
sliders 2 and 3, column 4, legs 5 and 6, panel 7. Joint `hinge_26` connects bodies 2 and 6.

Assumption: the design is symmetric about the vertical plane through (1, -1, 0). Both sliders carry their
joint at the same height and inward offset. The column stands on a hinge with axis (-1, 1, 0). The universal
joint on top turns about the column's (1, 1, 0) and the panel's eta (y) axis. Two balls lie at (-a, b, c) and
(a, b, c) of the panel. The legs have equal length. With both sliders at 46 mm, the paper's target, the column
is upright and the panel is horizontal with a yaw of 45 degrees.

Eleven lengths and ratios remain. Least squares fits them to fifteen published numbers: the centers of mass
of bodies 4 to 7 and the orientation of body 7. A last step moves the joint points as little as possible so
that the published pose and the horizontal pose both close exactly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares, root

from crosscheck.library.tracker import TARGET_HEIGHT, corrected_tables, joint_data
from newton_euler.model.euler_parameters import from_rotation_vector, rotation
from newton_euler.scalars import Array

TABLES = corrected_tables()
"""Tables of the paper with their errata applied."""

CENTERS = TABLES.center_of_mass
"""Published centers of mass (7, 3), m, world frame; body k has index k - 1."""

PANEL_ROTATION = rotation(TABLES.euler_parameters[6])
"""Published orientation (3, 3) of the panel at the initial position."""

RISE = TARGET_HEIGHT - CENTERS[1, 2]
"""Distance by which the sliders rise from the initial position to the target, m."""

HINGE_AXIS = np.array([-1.0, 1.0, 0.0]) / np.sqrt(2.0)
"""Axis (3,) of the column's hinge, world frame."""

CROSS_AXIS = np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0)
"""Axis (3,) of the universal joint in the upright column, world frame."""

HORIZONTAL = rotation(from_rotation_vector(np.array([0.0, 0.0, np.pi / 4])))
"""Orientation (3, 3) of the horizontal panel: xi (x) along (1, 1, 0), eta (y) along (-1, 1, 0)."""

PANEL_RADIUS = 0.1
"""Length that converts an orientation error of the panel (rad) into a length, m."""

PARAMETERS = (
    "inward offset of the slider joints",
    "height of the slider joints at the initial position",
    "height of the column's hinge",
    "length of the column",
    "universal joint in the panel, eta",
    "universal joint in the panel, zeta",
    "balls in the panel, a",
    "balls in the panel, c",
    "height of the column's center of mass above its hinge",
    "place of leg 5's center of mass along the leg, share",
    "place of leg 6's center of mass along the leg, share",
)
"""Names of the unknowns of the fit: lengths, m, and two fractions ("share") of the length of a leg.

xi, eta and zeta are the x, y and z axis of the panel's frame."""

GUESS = np.array([0.016, 0.018, 0.046, 0.09, -0.03, -0.015, 0.05, -0.01, 0.053, 0.5, 0.5])
"""Initial values (11,) of `PARAMETERS` for the fit."""


def turn(axis: Array, angle: float) -> Array:
    """Return the rotation (3, 3) by an angle, rad, about a unit vector (3,)."""
    return rotation(from_rotation_vector(angle * axis))


def mirror(point: Array) -> Array:
    """Return the mirror image of a point (3,) across the plane through (1, -1, 0) and the vertical."""
    return np.array([-point[1], -point[0], point[2]])


@dataclass(frozen=True, eq=False)
class Design:
    """Symmetric design of the tracker, with its sliders at the published heights.

    Attributes:
        parameters: (11,) values of `PARAMETERS`.
    """

    parameters: Array

    def points(self) -> tuple[Array, ...]:
        """Return the five joint points of the design, each (3,), m.

        The first two are in the world frame: joint of slider 2 and leg 6; hinge of the column. The others are
        in the frame of the panel, from its center of mass: universal joint; ball of leg 6; ball of leg 5.
        """
        offset, height, hinge, _, eta, zeta, a, c = self.parameters[:8]  # `_` is the length of the column
        slider = np.array([CENTERS[1, 0] + offset, CENTERS[1, 1], height])
        foot = np.array([CENTERS[2, 0], CENTERS[1, 1], hinge])
        universal = np.array([0.0, eta, zeta])
        # leg 6 swings in the vertical plane y = const. of its slider, which contains the column's foot; ball
        # 6 at (-a, b, c) is in this plane in the horizontal pose (yaw 45 degrees) if b = a + eta
        ball_6, ball_5 = np.array([-a, a + eta, c]), np.array([a, a + eta, c])
        return slider, foot, universal, ball_6, ball_5

    def panel(self, lean: float, pitch: float, roll: float) -> tuple[Array, Array]:
        """Return the center of mass (3,), m, and the rotation (3, 3) of the panel for given angles.

        Args:
            lean: angle of the column's hinge, rad.
            pitch, roll: angles of the universal joint about its axes in the column and in the panel, rad.
        """
        _, foot, universal, _, _ = self.points()
        column = turn(HINGE_AXIS, lean)
        column_length = self.parameters[3]
        top = foot + column @ [0.0, 0.0, column_length]
        orientation = column @ turn(CROSS_AXIS, pitch) @ turn(HINGE_AXIS, roll) @ HORIZONTAL
        return top - orientation @ universal, orientation

    def predict(self) -> tuple[Array, Array]:
        """Return the initial centers of mass (4, 3) of bodies 4 to 7, m, and the rotation of body 7."""
        # Length of both legs, from the pose with an upright column and a horizontal panel
        slider, foot, _, ball_6, ball_5 = self.points()
        horizontal_center, horizontal = self.panel(0.0, 0.0, 0.0)
        rise = np.array([0.0, 0.0, RISE])
        length = np.linalg.norm(horizontal_center + horizontal @ ball_6 - slider - rise)

        # Angles of the initial position, at which both legs have this length
        def gaps(angles: Array) -> Array:
            """Return the excess lengths of legs 6 and 5 and the displacement of leg 6 from its plane, m."""
            center, orientation = self.panel(*angles)
            top_6, top_5 = center + orientation @ ball_6, center + orientation @ ball_5
            return np.array(
                [
                    np.linalg.norm(top_6 - slider) - length,
                    np.linalg.norm(top_5 - mirror(slider)) - length,
                    top_6[1] - slider[1],
                ]
            )

        lean_guess = 0.09  # of the published column, rad
        solution = root(gaps, np.array([lean_guess, 0.0, 0.0]), tol=1e-14)
        # Centers of mass: those of column and legs lie on the lines between their joints
        center, orientation = self.panel(*solution.x)
        top_6, top_5 = center + orientation @ ball_6, center + orientation @ ball_5
        height, share_5, share_6 = self.parameters[8:]
        column = foot + turn(HINGE_AXIS, solution.x[0]) @ [0.0, 0.0, height]
        leg_5 = mirror(slider) + share_5 * (top_5 - mirror(slider))
        leg_6 = slider + share_6 * (top_6 - slider)
        return np.array([column, leg_5, leg_6, center]), orientation

    def residuals(self) -> Array:
        """Return predicted minus published numbers (15,), m: 12 of centers of mass, 3 of the panel's
        orientation.

        The rotation error is multiplied by `PANEL_RADIUS`.
        """
        centers, orientation = self.predict()
        error = orientation @ PANEL_ROTATION.T
        # axis times sine of the angle of this rotation: its skew-symmetric part
        rotation_error = 0.5 * np.array(
            [error[2, 1] - error[1, 2], error[0, 2] - error[2, 0], error[1, 0] - error[0, 1]]
        )
        return np.concatenate([(centers - CENTERS[3:7]).ravel(), PANEL_RADIUS * rotation_error])


def fit() -> Design:
    """Return the design that fits the published numbers best in the sense of least squares."""
    solution = least_squares(
        lambda x: Design(x).residuals(),
        GUESS,
        x_scale=np.maximum(np.abs(GUESS), 0.01),
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
    )
    return Design(solution.x)


def close_exactly(design: Design) -> dict[str, Array]:
    """Return the joint points nearest to the design's that close both poses exactly, world frame, m.

    Both poses are the published initial position and the pose with a horizontal panel. Six equations: the
    point of the universal joint moves with the column (3), both legs keep their lengths (2), leg 6 stays in
    its vertical plane (1).
    """
    # start values of fifteen unknowns: 11 coordinates of joint points at the initial position, then, for the
    # horizontal pose, the center of the panel (3) and the angle of the column from its initial position, rad
    slider, foot, universal, ball_6, ball_5 = design.points()
    on_panel = [CENTERS[6] + PANEL_ROTATION @ s for s in (universal, ball_6, ball_5)]
    start = np.concatenate([slider[[0, 2]], foot[2:], on_panel[0], on_panel[1][[0, 2]], on_panel[2]])
    horizontal_center, _ = design.panel(0.0, 0.0, 0.0)

    # the equations as functions of the unknowns
    def unpack(x: Array) -> dict[str, Array]:
        """Return the joint points (3,), m, by name of the joint."""
        slider_6 = np.array([x[0], slider[1], x[1]])
        return {
            "hinge_26": slider_6,
            "universal_35": mirror(slider_6),
            "hinge_14": np.array([foot[0], foot[1], x[2]]),
            "universal_47": x[3:6],
            "ball_67": np.array([x[6], slider[1], x[7]]),
            "ball_57": x[8:11],
        }

    def gaps(x: Array) -> Array:
        """Return the six closure errors of the horizontal pose, m."""
        initial = unpack(x)
        center, lean = x[11:14], x[14]
        horizontal = {
            name: center + HORIZONTAL @ PANEL_ROTATION.T @ (initial[name] - CENTERS[6])
            for name in ("universal_47", "ball_67", "ball_57")
        }
        column_vector = initial["universal_47"] - initial["hinge_14"]
        column_top = initial["hinge_14"] + turn(HINGE_AXIS, lean) @ column_vector
        rise = np.array([0.0, 0.0, RISE])

        def stretch(ball: str, foot_of_leg: str) -> float:
            """Return by how much a leg is longer than at the initial position, m."""
            before = np.linalg.norm(initial[ball] - initial[foot_of_leg])
            return float(np.linalg.norm(horizontal[ball] - initial[foot_of_leg] - rise) - before)

        return np.array(
            [
                *(horizontal["universal_47"] - column_top),
                stretch("ball_67", "hinge_26"),
                stretch("ball_57", "universal_35"),
                horizontal["ball_67"][1] - initial["ball_67"][1],
            ]
        )

    return unpack(_nearest_root(gaps, np.concatenate([start, horizontal_center, [-0.09]]), free=4))


def _nearest_root(gaps: Callable[[Array], Array], start: Array, free: int) -> Array:
    """Return the root of `gaps` nearest to `start`, by Newton steps of least norm.

    Args:
        gaps: function of n unknowns with fewer than n values.
        start: (n,) unknowns.
        free: number of unknowns, the last ones, whose change counts only by 1e-3 in the norm.
    """
    scale = np.ones(len(start))
    scale[-free:] = 1e3
    x = start.copy()
    for _ in range(30):  # more than enough: Newton's method converges quadratically
        jacobian = np.column_stack([(gaps(x + 1e-6 * e) - gaps(x - 1e-6 * e)) / 2e-6 for e in np.eye(len(x))])
        # the smallest change from `start`, divided by `scale`, that solves the linearized equations
        right_side = jacobian @ (x - start) - gaps(x)
        x = start + scale * (np.linalg.pinv(jacobian * scale) @ right_side)
    return x


def main() -> None:
    """Print the identified design, its residuals, and its distances from the joint points in
    `tracker_joints.json`."""
    design = fit()
    for name, value in zip(PARAMETERS, design.parameters, strict=True):
        print(f"{name:55s} {value:8.4f}" if "share" in name else f"{name:55s} {1e3 * value:8.3f} mm")
    residuals = 1e3 * design.residuals()
    print("\nresiduals, mm:      x        y        z")
    # r: center of mass of a body, p: orientation
    for name, row in zip(("r4", "r5", "r6", "r7", "p7"), residuals.reshape(5, 3), strict=True):
        print(f"{name:12s}" + "".join(f"{value:9.3f}" for value in row))
    print(f"rms {np.sqrt(np.mean(residuals**2)):.4f} mm over {len(residuals)} numbers")
    points = close_exactly(design)
    used = {joint["name"]: np.array(joint["point"]) for joint in joint_data()["joints"]}
    print("\njoint points that close both poses exactly, and how far the scene's own are from them, mm:")
    for name, point in points.items():
        gap = 1e3 * np.linalg.norm(point - used[name])
        print(f"{name:13s}" + "".join(f"{1e3 * value:10.3f}" for value in point) + f"{gap:10.3f}")


if __name__ == "__main__":
    main()
