"""Scenes of a published dual-axis solar tracker: 7 bodies, 8 joints, two loops, 2 degrees of freedom.

Two sliders on vertical rails move a panel by two legs; the panel also rests on a column. Paper: S. Srang, S.
Ath, M. Yamakita, "Newton-Euler Based Dynamic Modeling and Control Simulation for Dual-Axis Parallel Mechanism
Solar Tracker", Advances in Science, Technology and Engineering Systems Journal 5(5), 709-716, 2020,
doi:10.25046/aj050587. The module has the tables of its Appendix C as printed, their corrections, and four
scenes. Body k of the paper has index k - 1 in arrays. J_k is the inertia matrix of body k. Errata are errors
of the paper, numbered as in docs/explanation/errata.md. Joint `slide_12` connects bodies 1 and 2.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from importlib.resources import files
from typing import Annotated, Any, Literal

import numpy as np

from crosscheck.library.options import Between, OnlyWith, Text
from newton_euler.model.control import PD
from newton_euler.model.euler_parameters import rotation
from newton_euler.model.geometry import Box, Capsule, Mesh, Shape
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import JOINT_KINDS
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.motions import TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Sine
from newton_euler.runs.moving_base import base_motion_from_csv, on_moving_base
from newton_euler.scalars import Array

BODY_NAMES = ("base", "slider_2", "slider_3", "column_4", "leg_5", "leg_6", "panel_7")
"""Names of the bodies, with the numbers of the paper."""

MASSES = 1e-3 * np.array([475.09, 189.7, 189.7, 104.45, 53.25, 54.4, 890.5])
"""Masses of Table 1, kg."""

CENTER_OF_MASS = 1e-3 * np.array(
    [
        [-63.93, 63.93, 30.41],
        [-123.99, 15.0, 24.6],
        [-15.0, 123.99, 24.6],
        [-11.50, 18.37, 99.21],
        [-12.99, 98.33, 68.84],
        [-92.31, 15.0, 66.27],
        [-34.28, 42.89, 136.56],
    ]
)
"""Centers of mass of Table 2 in the world at the initial position, m."""

EULER_PARAMETERS = np.array([[1.0, 0.0, 0.0, 0.0]] * 6 + [[0.89043, -0.19791, -0.10481, 0.39619]])
"""Orientations (w, x, y, z) of Table 3 at the initial position."""

INERTIA_SCALE = np.array([1e-4, 1e-4, 1.0, 1.0, 1e-4, 1e-4, 1e-4])
"""Factors of the matrices of Table 4, kg m^2. Two factors are missing in print and stand here as 1."""

INERTIAS = np.array(
    [
        [[20.0, 8.0, -1.0], [8.0, 20.0, 1.0], [1.0, 1.0, 26.0]],
        [[0.2774, 0.0, -0.00102], [0.0, 0.2015, 0.0], [-0.0102, 0.0, 0.1987]],
        [[0.2015, 0.0, 0.0], [0.0, 0.2774, 0.0102], [0.0, 0.0102, 0.1987]],
        [[0.1217, 0.0, 0.0], [0.0, 0.1248, 0.0], [0.0, 0.0, 0.0054]],
        [[0.5827, 0.0, -0.0824], [0.0, 0.5940, 0.0], [-0.0824, 0.0, 0.0172]],
        [[0.6242, 0.0, 0.0], [0.0, 0.6231, 0.0], [0.0, 0.0, 0.0058]],
        [[12.0, 0.0, 1.0], [0.0, 12.0, 0.0], [1.0, 0.0, 24.0]],
    ]
)
"""Inertia matrices of Table 4 as printed, to be multiplied by `INERTIA_SCALE`. One rendering of the article
prints J2 (1,3) as -0.00102, another as -0.0102. The first is kept here, so that the erratum is visible."""


@dataclass
class Tables:
    """The four tables of Appendix C, with one row per body.

    Attributes:
        mass: (7,) kg.
        center_of_mass: (7, 3) m, world frame, initial position.
        euler_parameters: (7, 4) orientations (w, x, y, z).
        inertia: (7, 3, 3), to be multiplied by `inertia_scale`.
        inertia_scale: (7,) kg m^2.
    """

    mass: Array
    center_of_mass: Array
    euler_parameters: Array
    inertia: Array
    inertia_scale: Array

    @classmethod
    def as_printed(cls) -> Tables:
        """Return copies of the tables as printed."""
        return cls(
            MASSES.copy(),
            CENTER_OF_MASS.copy(),
            EULER_PARAMETERS.copy(),
            INERTIAS.copy(),
            INERTIA_SCALE.copy(),
        )

    @property
    def scaled_inertia(self) -> Array:
        """Inertia matrices (7, 3, 3), body frame, kg m^2."""
        return self.inertia * self.inertia_scale[:, None, None]


def corrected_tables(*, literal_panel: bool = False) -> Tables:
    """Return the tables with the errata of docs/explanation/errata.md applied.

    Args:
        literal_panel: leave J7 as printed, which no rigid body can have.
    """
    tables = Tables.as_printed()
    tables.inertia[0, 2, 0] = -1.0  # erratum 5: symmetric
    tables.inertia[1, 0, 2] = tables.inertia[1, 2, 0] = -0.0102  # erratum 6: the mirror image of J3
    tables.inertia_scale[2], tables.inertia_scale[3] = 1e-4, 1e-3  # erratum 7: not printed
    if not literal_panel:  # erratum 8: the nearest round numbers that a rigid body can have
        tables.inertia[6] = [[12.09, 0.0, 1.0], [0.0, 12.09, 0.0], [1.0, 0.0, 23.9]]
    tables.euler_parameters[6] /= np.linalg.norm(tables.euler_parameters[6])  # erratum 9
    return tables


TARGET_HEIGHT = 0.046
"""Target height of the centers of mass of both sliders, m (section 4)."""

PANEL = (0.07, 0.055)
"""Half the side lengths of the panel along its x and y axes, m, also for the wind loads of `tracker_wind`."""

POSITION_GAIN = 50.0
"""Proportional gain K_p of both actuators, N/m (section 5)."""

VELOCITY_GAINS = (20.0, 25.0)
"""Derivative gains K_d of the actuators of sliders 2 and 3, N s/m (section 5)."""


def joint_data() -> dict[str, Any]:
    """Read `tracker_joints.json`: the joint geometry, which the paper does not give.

    `crosscheck.library.tracker_geometry` identifies the geometry from the tables.
    """
    data: dict[str, Any] = json.loads(
        files("crosscheck.library").joinpath("tracker_joints.json").read_text(encoding="utf-8")
    )
    return data


def tracker(panel_inertia: Literal["realisable", "literal"] = "realisable") -> Scene:
    """Return the paper's simulation: no gravity, PD control of both sliders, from rest, 5 s.

    Args:
        panel_inertia: "literal" for the inertia of the panel as printed, which no rigid body can have
            (erratum 8); "realisable" for the nearest possible one.
    """
    return _scene(
        "tracker",
        "dual-axis solar tracker, PD control to a horizontal panel, no gravity",
        literal_panel=panel_inertia == "literal",
    )


def tracker_gravity() -> Scene:
    """Return the paper's simulation under gravity along -z, which the control laws do not compensate."""
    return _scene(
        "tracker_gravity", "dual-axis solar tracker, PD control, under gravity", gravity=(0.0, 0.0, -9.81)
    )


def tracker_aligned() -> Scene:
    """Return the paper's simulation with the inertias J4 to J6 along the links instead of along the world's z
    (erratum 10)."""
    return _scene(
        "tracker_aligned",
        "dual-axis solar tracker, inertias of the legs along the legs, no gravity",
        aligned_legs=True,
    )


WAVES = OnlyWith("poses", "")
"""Condition of the options of waves: the poses of the boat are not read from a file."""

Amplitude = Annotated[float, Between(0.0, 0.5, "rad"), WAVES]
"""Type of an option of `tracker_on_boat`: amplitude of a rotation."""

Height = Annotated[float, Between(0.0, 2.0, "m"), WAVES]
"""Type of an option of `tracker_on_boat`: amplitude of the vertical motion."""

Period = Annotated[float, Between(1.0, 60.0, "s"), WAVES]
"""Type of an option of `tracker_on_boat`: period of a motion."""


def tracker_on_boat(
    roll: Amplitude = 0.15,
    pitch: Amplitude = 0.08,
    heave: Height = 0.1,
    roll_period: Period = 4.0,
    pitch_period: Period = 5.0,
    heave_period: Period = 6.0,
    poses: Annotated[str, Text("CSV")] = "",
) -> Scene:
    """Return the tracker under gravity on the deck of a boat that rolls, pitches and heaves in sines.

    Args:
        roll, pitch, heave: amplitudes of the sines.
        roll_period, pitch_period, heave_period: periods of the sines, which start at 0 and rise.
        poses: path of a CSV of the boat's poses to use instead, see `newton_euler.base_motion_from_csv`.
    """
    # Functions of time by the names of the boat's motions
    motions: dict[str, TimeFunction] = {}
    if poses:
        motions |= base_motion_from_csv(poses)
    else:
        waves = {"roll": (roll, roll_period), "pitch": (pitch, pitch_period), "heave": (heave, heave_period)}
        for name, (amplitude, period) in waves.items():
            motions[name] = Sine(amplitude, 2.0 * np.pi / period)
    # The boat: a hull below the plate of the tracker, which turns about the middle of the hull
    scene = tracker_gravity()
    base = scene.mechanism.bodies[0]
    # the plate ends at z = -0.006 m (see `_shapes`), half the height of the hull below is 0.01 m
    middle = base.center_of_mass * [1.0, 1.0, 0.0] - [0.0, 0.0, 0.016]
    hull = replace(base, shapes=(Box(np.array([0.2, 0.12, 0.01]), middle),), meshes=())
    moving = on_moving_base(scene, motions, hull, point=middle)
    description = "dual-axis solar tracker, PD control, under gravity, on a boat"
    return replace(moving, name="tracker_on_boat", description=description)


def _scene(
    name: str,
    description: str,
    literal_panel: bool = False,
    aligned_legs: bool = False,
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Scene:
    """Make a scene of the tracker with PD control of both sliders, 5 s.

    Args:
        name, description: name and description of the scene.
        literal_panel: use the panel's inertia as printed (erratum 8).
        aligned_legs: turn the inertias J4 to J6 along the links (erratum 10).
        gravity: (3,) m/s^2, world frame.
    """
    # Joints, and inertias with their corrections
    tables = corrected_tables(literal_panel=literal_panel)
    joints = []
    for entry in joint_data()["joints"]:
        fields = {field: value for field, value in entry.items() if field != "kind"}
        joints.append(JOINT_KINDS[entry["kind"]](**fields))
    if aligned_legs:
        for k in (3, 4, 5):  # column and legs
            turn = _rotation_from_z(_link_axis(BODY_NAMES[k], joints))
            tables.inertia[k] = turn @ tables.inertia[k] @ turn.T
    # Bodies
    bodies = [
        Body(
            body,
            tables.mass[k],
            tables.center_of_mass[k],
            tables.scaled_inertia[k],
            tables.euler_parameters[k],
            shapes=shapes,
            meshes=(solar_cells(tables.center_of_mass[k], tables.euler_parameters[k], PANEL),)
            if body == "panel_7"
            else (),
            allow_unrealisable_inertia=body == "panel_7" and literal_panel,
        )
        for k, (body, shapes) in enumerate(zip(BODY_NAMES, _shapes(tables, joints), strict=True))
    ]
    # Control of both sliders; a target is a displacement from the initial position
    control = tuple(
        PD(joint, POSITION_GAIN, damping, target=TARGET_HEIGHT - float(tables.center_of_mass[slider, 2]))
        for joint, damping, slider in (("slide_12", VELOCITY_GAINS[0], 1), ("slide_13", VELOCITY_GAINS[1], 2))
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
    """Return the unit vector (3,) from the lower to the upper joint of a link, world frame."""
    low, high = sorted(
        (joint.point for joint in joints if body in (joint.first, joint.second)), key=lambda p: p[2]
    )
    return np.asarray((high - low) / np.linalg.norm(high - low))


def _rotation_from_z(axis: Array) -> Array:
    """Return the smallest rotation (3, 3) that turns the world's z axis to a unit vector (3,)."""
    z = np.array([0.0, 0.0, 1.0])
    # the quaternion of the smallest rotation from a to b is proportional to (1 + a . b, a x b)
    p = np.array([1.0 + z @ axis, *np.cross(z, axis)])
    return rotation(p / np.linalg.norm(p))


def _shapes(tables: Tables, joints: list[Joint]) -> list[tuple[Shape, ...]]:
    """Return the shapes of each body for drawing, as in the paper's Figure 2. Shapes have no effect on the
    motion."""
    # A capsule has two end points and a radius, a box half its side lengths, a center and an orientation; m
    point = {joint.name: joint.point for joint in joints}
    centers = tables.center_of_mass
    base = centers[0] * [1.0, 1.0, 0.0]
    # the ground: a plate, the rails of both sliders, and the foot of the column
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
    # the panel: a plate, arms to its three joints, and the cross of the universal joint along its y axis, eta
    panel_rotation = rotation(tables.euler_parameters[6])
    eta, normal = panel_rotation[:, 1], panel_rotation[:, 2]
    panel: tuple[Shape, ...] = (
        Box(np.array([*PANEL, 0.002]), centers[6], tables.euler_parameters[6]),
        Capsule(point["ball_67"], point["ball_57"], 0.003),
        *(
            Capsule(point[joint], point[joint] + (centers[6] - point[joint]) @ normal * normal, 0.003)
            for joint in ("ball_67", "ball_57", "universal_47")
        ),
        Capsule(point["universal_47"] - 0.01 * eta, point["universal_47"] + 0.01 * eta, 0.004),
    )

    def slider(body: int, joint: str) -> tuple[Shape, ...]:
        """Return a block at the center of a slider, and the arm to the joint of its leg."""
        block = Box(np.array([0.012, 0.012, 0.01]), centers[body])
        return (block, Capsule(centers[body], point[joint], 0.003))

    # in the order of the bodies; column and legs are bars between their joints
    return [
        ground,
        slider(1, "hinge_26"),
        slider(2, "universal_35"),
        (Capsule(point["hinge_14"], point["universal_47"], 0.004),),
        (Capsule(point["universal_35"], point["ball_57"], 0.003),),
        (Capsule(point["hinge_26"], point["ball_67"], 0.003),),
        panel,
    ]


def solar_cells(center: Array, quaternion: Array, half_sizes: tuple[float, float]) -> Mesh:
    """Return the solar cells, six by four, as a dark mesh slightly above the panel.

    Args:
        center, quaternion: (3,) m and (4,), center of mass and orientation of the panel.
        half_sizes: half the lengths of the panel's sides, m.
    """
    # Centers (24, 3) of the cells, and corners (4, 3) of a cell from its center, panel frame, m
    cells = (6, 4)
    x, y = ((2.0 * np.arange(n) + 1.0 - n) / n * half for n, half in zip(cells, half_sizes, strict=True))
    centers = np.array([[a, b, 0.0025] for a in x for b in y])
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * [
        *np.divide(half_sizes, cells),
        0.0,
    ]
    # Four vertices and two triangles per cell; a cell is drawn 10 % smaller, with a gap to the next one
    vertices = (centers[:, None] + 0.9 * corners).reshape(-1, 3) @ rotation(quaternion).T
    first_vertex = 4 * np.arange(len(centers))[:, None]
    triangles = np.concatenate([first_vertex + triangle for triangle in ([0, 1, 2], [0, 2, 3])])
    dark_blue = (0.03, 0.05, 0.12, 1.0)
    return Mesh(center + vertices, triangles, dark_blue)
