"""The published dual-axis solar tracker: 7 bodies, 8 joints, two loops, 2 degrees of freedom."""

from __future__ import annotations

import json
from importlib.resources import files
from typing import Any, Literal

import numpy as np

from crosscheck.scenes.tracker_tables import BODY_NAMES, Tables, corrected_tables
from newton_euler.model.control import PD
from newton_euler.model.euler_parameters import rotation
from newton_euler.model.geometry import Box, Capsule, Shape
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import JOINT_KINDS
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array

TARGET_HEIGHT = 0.046
"""Wanted height of both sliders' centers of mass, m (section 4)."""

STIFFNESS = 50.0
"""K_p of both actuators, N/m (section 5)."""

DAMPING = (20.0, 25.0)
"""K_d of the actuators, N s/m (section 5)."""


def joint_data() -> dict[str, Any]:
    """The reconstructed joint geometry, `tracker_joints.json`."""
    data: dict[str, Any] = json.loads(
        files("crosscheck.scenes").joinpath("tracker_joints.json").read_text(encoding="utf-8")
    )
    return data


def tracker(panel_inertia: Literal["realisable", "literal"] = "realisable") -> Scene:
    """The paper's simulation: no gravity, PD control of both sliders, from rest, 5 s.

    Args:
        panel_inertia: J7 that a rigid body can have, or as printed (erratum 8).
    """
    return _scene(
        "tracker",
        "dual-axis solar tracker, PD control to a horizontal panel, no gravity",
        literal_panel=panel_inertia == "literal",
    )


def tracker_gravity() -> Scene:
    """The paper's simulation under gravity along -z, which the control laws know nothing of."""
    return _scene(
        "tracker_gravity", "dual-axis solar tracker, PD control, under gravity", gravity=(0.0, 0.0, -9.81)
    )


def tracker_aligned() -> Scene:
    """The paper's simulation with J4 to J6 turned with the links, not along the world's z (erratum 10)."""
    return _scene(
        "tracker_aligned",
        "dual-axis solar tracker, inertias of the legs along the legs, no gravity",
        aligned_legs=True,
    )


def _scene(
    name: str,
    description: str,
    literal_panel: bool = False,
    aligned_legs: bool = False,
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Scene:
    tables = corrected_tables(literal_panel=literal_panel)
    data = joint_data()
    joints = [JOINT_KINDS[entry.pop("kind")](**entry) for entry in (dict(joint) for joint in data["joints"])]
    if aligned_legs:
        for body in (3, 4, 5):
            turn = _along(_link_axis(BODY_NAMES[body], joints))
            tables.inertia[body] = turn @ tables.inertia[body] @ turn.T
    bodies = [
        Body(
            body,
            tables.mass[k],
            tables.center_of_mass[k],
            tables.scaled_inertia[k],
            tables.euler_parameters[k],
            shapes=shapes,
            allow_unrealisable_inertia=body == "panel_7" and literal_panel,
        )
        for k, (body, shapes) in enumerate(zip(BODY_NAMES, _shapes(tables, joints), strict=True))
    ]
    control = tuple(
        PD(joint, STIFFNESS, damping, TARGET_HEIGHT - float(tables.center_of_mass[slider, 2]))
        for joint, damping, slider in (("slide_12", DAMPING[0], 1), ("slide_13", DAMPING[1], 2))
    )
    return Scene(
        name,
        Mechanism(bodies, joints),
        duration=5.0,
        output_period=0.01,
        gravity=np.array(gravity),
        control=control,
        description=description,
    )


def _link_axis(body: str, joints: list[Joint]) -> Array:
    """Unit vector from a link's lower joint to its upper joint."""
    low, high = sorted(
        (joint.point for joint in joints if body in (joint.first, joint.second)), key=lambda p: p[2]
    )
    return np.asarray((high - low) / np.linalg.norm(high - low))


def _along(axis: Array) -> Array:
    """The smallest rotation that takes the world's z to `axis`."""
    z = np.array([0.0, 0.0, 1.0])
    p = np.array([1.0 + z @ axis, *np.cross(z, axis)])
    return rotation(p / np.linalg.norm(p))


def _shapes(tables: Tables, joints: list[Joint]) -> list[tuple[Shape, ...]]:
    """Base, sliders, column, legs and panel as in the paper's Figure 2; sizes are for the eye only."""
    point = {joint.name: joint.point for joint in joints}
    centers = tables.center_of_mass
    base = centers[0] * [1.0, 1.0, 0.0]
    rails = [
        Capsule(centers[k] * [1.0, 1.0, 0.0], centers[k] * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.07], 0.003)
        for k in (1, 2)
    ]
    foot = point["hinge_14"] * [1.0, 1.0, 0.0]
    ground: tuple[Shape, ...] = (
        Box(np.array([0.085, 0.085, 0.003]), base - [0.0, 0.0, 0.003]),
        *rails,
        Capsule(foot, point["hinge_14"], 0.006),
    )
    panel_rotation = rotation(tables.euler_parameters[6])
    eta = panel_rotation[:, 1]
    panel_center = centers[6] + panel_rotation @ [0.0, 0.0, 0.006]
    panel: tuple[Shape, ...] = (
        Box(np.array([0.07, 0.055, 0.002]), panel_center, tables.euler_parameters[6]),
        Capsule(point["ball_67"], point["ball_57"], 0.003),
        Capsule(point["universal_47"] - 0.01 * eta, point["universal_47"] + 0.01 * eta, 0.004),
    )

    def slider(body: int, joint: str) -> tuple[Shape, ...]:
        block = Box(np.array([0.012, 0.012, 0.01]), centers[body])
        return (block, Capsule(centers[body], point[joint], 0.003))

    return [
        ground,
        slider(1, "hinge_26"),
        slider(2, "universal_35"),
        (Capsule(point["hinge_14"], point["universal_47"], 0.004),),
        (Capsule(point["universal_35"], point["ball_57"], 0.003),),
        (Capsule(point["hinge_26"], point["ball_67"], 0.003),),
        panel,
    ]
