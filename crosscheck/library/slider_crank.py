"""Scene of a spatial slider-crank: a crank drives a slider through a rod with a ball and a universal joint.

Problem "spatial rigid slider-crank mechanism" of the IFToMM library of computational benchmark problems,
by R. Masoudi. The joint at the slider is universal, with one axis along the guide and fixed in the slider;
with a ball joint the rod could spin. Published solutions use different inertias of the rod. Variant A has the
small moment along the rod, as real rods have. Variant B, of the problem's author, has it across the rod.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from crosscheck.library.measure import Quantity, angle, angular_velocity, position, velocity
from newton_euler.model.geometry import Box
from newton_euler.model.joint_kinds import Prismatic, Revolute, Spherical, Universal
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array

PIVOT, PIN, WRIST = np.array([0.0, 0.1, 0.12]), np.array([0.0, 0.1, 0.2]), np.array([0.2, 0.0, 0.0])
"""Initial positions of the crank's pivot, the ball joint and the universal joint at the slider, m."""

MASSES = {"crank": 0.12, "rod": 0.5, "slider": 2.0}
"""Masses of the bodies, kg."""

CRANK_MOMENTS = (1e-4, 1e-4, 1e-5)
"""Moments of inertia of the crank about its center of mass, z along the crank, kg m^2."""

ROD_MOMENTS = {"A": (4e-4, 4e-3, 4e-3), "B": (4e-3, 4e-3, 4e-4)}
"""Moments of inertia of the rod by variant, kg m^2: along the rod, along the axis of the universal joint
that is fixed in the rod, and across both."""

SLIDER_MOMENT = 1e-4
"""Moment of inertia of the slider, kg m^2. The slider never turns."""

CRANK_SPEED = 6.0
"""Initial angular velocity of the crank about x, rad/s."""

ROD_SPIN = np.array([1.92, -0.96, 0.48])
"""Initial angular velocity of the rod, world frame, rad/s. It follows from the constraints."""

X, Y, Z = np.eye(3)


def slider_crank(variant: Literal["A", "B"] = "A") -> Scene:
    """Return the slider-crank: 0.08 m crank, 0.3 m rod, 2 kg slider, at first 6 rad/s, 5 s; gravity along -z.

    Args:
        variant: moments of inertia of the rod, see `ROD_MOMENTS`.
    """
    # principal axes of the rod: along the rod, the axis of the universal joint in the rod, across both
    along = (WRIST - PIN) / np.linalg.norm(WRIST - PIN)
    cardan = np.cross(along, X)
    cardan /= np.linalg.norm(cardan)
    axes = np.array([along, cardan, np.cross(along, cardan)])
    rod_inertia = axes.T @ np.diag(ROD_MOMENTS[variant]) @ axes
    block = Box(half_sizes=np.array([0.02, 0.012, 0.012]), center=WRIST)
    # name, mass, center of mass (initial position), and inertia about the center of mass in axes parallel to
    # the world's at the initial pose
    bodies = [
        Body.ground(),
        Body("crank", MASSES["crank"], 0.5 * (PIVOT + PIN), np.diag(CRANK_MOMENTS)),
        Body("rod", MASSES["rod"], 0.5 * (PIN + WRIST), rod_inertia),
        Body("slider", MASSES["slider"], WRIST, SLIDER_MOMENT * np.eye(3), shapes=(block,)),
    ]
    joints = [
        Revolute("pivot", "ground", "crank", PIVOT, axis=X),
        Spherical("ball", "crank", "rod", PIN),
        Universal("wrist", "slider", "rod", WRIST, axis_on_first=X, axis_on_second=cardan),
        Prismatic("guide", "ground", "slider", WRIST, axis=X),
    ]
    mechanism = Mechanism(bodies, joints)
    return Scene(
        "slider_crank",
        mechanism,
        duration=5.0,
        output_period=0.01,
        gravity=-9.81 * Z,
        initial_state=_turning(mechanism),
        description="spatial slider-crank with a universal joint, driven by its initial speed",
    )


def _turning(mechanism: Mechanism) -> State:
    """Return the initial pose with the crank at `CRANK_SPEED` and the other bodies at matching velocities."""
    state = State.initial(mechanism)
    pin_velocity = np.cross(CRANK_SPEED * X, PIN - PIVOT)
    wrist_velocity = pin_velocity + np.cross(ROD_SPIN, WRIST - PIN)
    state.angular_velocity[1:3] = CRANK_SPEED * X, ROD_SPIN  # row 0 is the ground
    # centers of mass of crank, rod and slider
    state.linear_velocity[1:] = 0.5 * pin_velocity, 0.5 * (pin_velocity + wrist_velocity), wrist_velocity
    return state


CENTER: Array = np.zeros(3)
"""Center of mass (3,) of a body, in its own frame, m."""

REFERENCE_QUANTITIES: dict[str, Quantity] = {
    "crank_angle": lambda run: angle(run, "crank", X),
    "crank_omega": lambda run: angular_velocity(run, "crank") @ X,
    "slider_x": lambda run: position(run, "slider", CENTER)[:, 0],
    "slider_vx": lambda run: velocity(run, "slider", CENTER)[:, 0],
}
"""Functions of a run (`Trajectory`) whose values over time are compared with published ones: angle (rad) and
angular velocity (rad/s) of the crank about x; position (m) and velocity (m/s) of the slider along x."""
