"""Small mechanisms that tests share, beside the scene library."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from newton_euler.equations.relative import Relative
from newton_euler.equations.system import Evaluation
from newton_euler.model.digital_control import Law
from newton_euler.model.euler_parameters import from_rotation_vector, rotation
from newton_euler.model.forces import Force, PointSpring
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import (
    Cylindrical,
    Fixed,
    Free,
    Revolute,
    Spherical,
    Translational,
    Universal,
)
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State

GRAVITY = (0.0, 0.0, -9.81)

X, Y, Z, ORIGIN = [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]

SLIDER_ACCELERATIONS = (0.277549, 1.394930)
"""m/s^2, of the tracker's sliders at its start: published with the scene, six digits; three independent
formulations agree on them to 1e-12."""


def inertia(*moments: float, turn: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """A tensor with these principal moments, about axes turned by a rotation vector."""
    a = rotation(from_rotation_vector(np.array(turn)))
    return a @ np.diag(moments) @ a.T


def bar(name: str, start: list[float], end: list[float], mass: float = 1.0) -> Body:
    """A bar between two points, its frame turned at random-looking but fixed angles."""
    p = from_rotation_vector(np.array([0.3, -0.5, 0.2]) * len(name))
    along = np.subtract(end, start)
    length = float(np.linalg.norm(along))
    u = along / length
    tensor = mass * length**2 / 12.0 * (1.01 * np.eye(3) - np.outer(u, u))
    a = rotation(p)
    return Body(name, mass, 0.5 * np.add(start, end), a.T @ tensor @ a, p)


def wheel(name: str, center: list[float], polar: float) -> Body:
    """A disc of 1 kg in a plane across z, with its moment of inertia about z in kg m^2."""
    return Body(name, 1.0, center, np.diag([0.6 * polar, 0.6 * polar, polar]))


def pendulum(length: float = 1.0, angle: float = np.pi / 2) -> Scene:
    """A bar on a hinge along y, started at rest at `angle` from hanging down."""
    tip = [length * np.sin(angle), 0.0, -length * np.cos(angle)]
    mechanism = Mechanism(
        [Body.ground(), bar("rod", [0.0, 0.0, 0.0], tip)],
        [Revolute("pivot", "ground", "rod", [0.0, 0.0, 0.0], axis=[0.0, 1.0, 0.0])],
    )
    return Scene("pendulum", mechanism, duration=2.0, output_period=0.1, gravity=GRAVITY)


CART = 2.0
"""kg, of each of `carts`."""


def carts(*control: Law, duration: float = 0.25, output_period: float = 0.01) -> Scene:
    """Carts on rails side by side, `rail_0` and `rail_1`, at rest and without gravity."""
    names = ["cart_0", "cart_1"]
    bodies = [Body(name, CART, [0.0, k, 0.0], 0.1 * np.eye(3)) for k, name in enumerate(names)]
    joints = [
        Translational(f"rail_{k}", "ground", name, [0.0, k, 0.0], axis=[1.0, 0.0, 0.0], actuated=True)
        for k, name in enumerate(names)
    ]
    mechanism = Mechanism([Body.ground(), *bodies], joints)
    return Scene("carts", mechanism, duration, output_period, control=control)


def spinning_top() -> Scene:
    """An asymmetric body on a ball joint under gravity, with a spin."""
    p = from_rotation_vector(np.array([0.4, 0.7, -0.3]))
    mechanism = Mechanism(
        [
            Body.ground(),
            Body("top", 2.0, [0.1, 0.2, 0.5], inertia(0.02, 0.03, 0.04, turn=(0.5, 0.1, 0.9)), p),
        ],
        [Spherical("tip", "ground", "top", [0.0, 0.0, 0.0])],
    )
    start = State.initial(mechanism)
    omega = np.array([0.5, -1.0, 12.0])
    state = State(
        start.position,
        start.quaternion,
        np.array([np.zeros(3), np.cross(omega, start.position[1])]),
        np.array([np.zeros(3), omega]),
    )
    return Scene("top", mechanism, 1.0, 0.1, GRAVITY, initial_state=state)


def _spatial_loop(name: str, closing: type[Joint], **axes: list[float]) -> Scene:
    """Ground, crank, coupler, rocker: a spatial loop of one or two degrees of freedom."""
    a, b = [0.0, 0.0, 0.0], [0.1, 0.1, 0.5]
    c, d = [0.9, 0.3, 0.8], [1.0, 0.2, 0.1]
    bodies = [Body.ground(), bar("crank", a, b), bar("coupler", b, c, 2.0), bar("rocker", d, c, 1.5)]
    joints: list[Joint] = [
        Revolute("at_a", "ground", "crank", a, axis=[0.2, 1.0, 0.1]),
        Universal("at_b", "coupler", "crank", b, axis_on_first=[0, 1, 0], axis_on_second=[0.6, 0, 0.8]),
        closing("at_c", "rocker", "coupler", c, **axes),  # type: ignore[arg-type]
        Universal("at_d", "ground", "rocker", d, axis_on_first=[0, 1, 0], axis_on_second=[1, 0, 0]),
    ]
    return Scene(name, Mechanism(bodies, joints), 1.0, 0.1, GRAVITY)


def all_universal_loop() -> Scene:
    """A loop of a hinge and three universal joints, cut at a universal joint: 7 - 6 = 1 freedom."""
    return _spatial_loop(
        "universal_loop", Universal, axis_on_first=[0.0, 1.0, 0.0], axis_on_second=[0.0, 0.0, 1.0]
    )


def ball_loop() -> Scene:
    """The same with a ball joint at C: 8 - 6 = 2 freedoms."""
    return _spatial_loop("ball_loop", Spherical)


def seven_hinges() -> Scene:
    """A loop of seven hinges askew: one freedom, cut at a hinge, no redundant equation."""
    points = np.array(
        [
            [0.0, 0.0, 0.0],
            [0.5, 0.1, 0.2],
            [0.9, 0.4, -0.1],
            [1.1, 0.9, 0.3],
            [0.8, 1.3, 0.6],
            [0.2, 1.2, 0.4],
            [-0.2, 0.6, 0.3],
        ]
    )
    axes = np.array(
        [
            [0.1, 0.2, 1.0],
            [1.0, 0.3, 0.2],
            [0.2, 1.0, -0.3],
            [0.5, -0.4, 1.0],
            [-1.0, 0.2, 0.5],
            [0.3, 0.8, 0.6],
            [0.7, -0.2, 0.9],
        ]
    )
    names = ["ground", *(f"link_{k}" for k in range(1, 7))]
    bodies = [Body.ground()] + [bar(names[k], list(points[k - 1]), list(points[k])) for k in range(1, 7)]
    joints = [
        Revolute(f"hinge_{k}", names[(k) % 7], names[(k + 1) % 7], points[k], axis=axes[k]) for k in range(7)
    ]
    return Scene("seven_hinges", Mechanism(bodies, joints), 1.0, 0.1, GRAVITY)


def slider_tree() -> Scene:
    """A tree of slides (one on a turning body), a cylindrical joint, a ball, a free and a fixed body."""
    bodies = [
        Body.ground(),
        bar("cart", [0.0, 0.0, 0.0], [0.2, 0.0, 0.0]),
        bar("sleeve", [0.1, 0.0, 0.0], [0.1, 0.1, 0.6]),
        bar("bob", [0.1, 0.1, 0.6], [0.3, 0.3, 0.9]),
        bar("stone", [1.0, 1.0, 1.0], [1.2, 1.0, 1.3]),
        bar("rider", [0.2, 0.0, 0.0], [0.2, 0.1, 0.3]),
        bar("collar", [0.1, 0.05, 0.3], [0.3, 0.05, 0.3]),
    ]
    joints: list[Joint] = [
        Translational("rail", "cart", "ground", [0.0, 0.0, 0.0], axis=[1.0, 0.2, 0.0]),
        Cylindrical("sleeve_on_cart", "cart", "sleeve", [0.1, 0.0, 0.0], axis=[0.0, 0.3, 1.0]),
        Spherical("bob_on_sleeve", "bob", "sleeve", [0.1, 0.1, 0.6]),
        Free("stone_floats", "stone", "ground", [0.0, 0.0, 0.0]),
        Translational("collar_on_sleeve", "sleeve", "collar", [0.1, 0.05, 0.3], axis=[0.8, 0.0, 0.6]),
        Fixed("rider_on_cart", "rider", "cart", [0.2, 0.0, 0.0]),
    ]
    return Scene("slider_tree", Mechanism(bodies, joints), 1.0, 0.1, GRAVITY)


def planar_four_bar(
    pin: tuple[float, float] = (0.1, 0.4), wrist: tuple[float, float] = (0.9, 0.7), foot: float = 1.0
) -> Scene:
    """A flat loop of four hinges: one freedom, three equations redundant.

    Args:
        pin, wrist: (2,) x and z of the coupler's ends at the crank and at the rocker, m.
        foot: x of the rocker's foot, m; the crank's foot is at the origin.
    """
    a, b, c, d = ([x, 0.0, z] for x, z in ((0.0, 0.0), pin, wrist, (foot, 0.0)))
    bodies = [Body.ground(), bar("crank", a, b), bar("coupler", b, c, 2.0), bar("rocker", d, c, 1.5)]
    joints = [
        Revolute("at_a", "ground", "crank", a, axis=[0.0, 1.0, 0.0]),
        Revolute("at_b", "crank", "coupler", b, axis=[0.0, 1.0, 0.0]),
        Revolute("at_c", "coupler", "rocker", c, axis=[0.0, 1.0, 0.0]),
        Revolute("at_d", "ground", "rocker", d, axis=[0.0, 1.0, 0.0]),
    ]
    return Scene("planar_four_bar", Mechanism(bodies, joints), 1.0, 0.1, GRAVITY)


def parallel_cranks() -> Scene:
    """Three equal cranks under one beam: redundant equations that drift can make inconsistent."""
    rise = np.array([0.1, 0.0, 0.3])
    feet = [np.array([x, 0.0, 0.0]) for x in (0.0, 0.3, 0.7)]
    bodies = [Body.ground(), bar("beam", list(feet[0] + rise), list(feet[2] + rise), 2.0)]
    joints: list[Joint] = []
    for k, foot in enumerate(feet):
        bodies.append(bar(f"crank_{k}", list(foot), list(foot + rise)))
        joints.append(Revolute(f"foot_{k}", "ground", f"crank_{k}", foot, axis=[0, 1, 0]))
        joints.append(Revolute(f"head_{k}", f"crank_{k}", "beam", foot + rise, axis=[0, 1, 0]))
    return Scene("parallel_cranks", Mechanism(bodies, joints), 1.0, 0.1, GRAVITY)


def scaled(scene: Scene, factor: float) -> Scene:
    """The same scene, `factor` times as large at the same density, in gravity that much stronger.

    Its angular accelerations are those of the original and its linear ones `factor` times theirs.
    """
    bodies = [
        replace(
            body,
            mass=factor**3 * body.mass,
            center_of_mass=factor * body.center_of_mass,
            inertia=factor**5 * body.inertia,
        )
        for body in scene.mechanism.bodies
    ]
    joints = [
        replace(joint, point=factor * joint.point, point_on_second=factor * joint.point_on_second)
        for joint in scene.mechanism.joints
    ]
    return replace(
        scene, mechanism=Mechanism(bodies, joints), gravity=factor * scene.gravity, initial_state=None
    )


def bolted(extra: type[Joint] | None, **axes: list[float]) -> Scene:
    """Two bodies bolted together on a universal joint; a second joint between them adds nothing."""
    bodies = [
        Body.ground(),
        bar("a", [0.0, 0.0, 0.0], [0.5, 0.1, 0.2]),
        bar("b", [0.5, 0.1, 0.2], [0.9, 0.5, 0.1]),
    ]
    joints: list[Joint] = [
        Universal(
            "pivot",
            "ground",
            "a",
            [0.0, 0.0, 0.0],
            axis_on_first=[0.0, 1.0, 0.0],
            axis_on_second=[1.0, 0.0, 0.0],
        ),
        Fixed("bolt", "a", "b", [0.5, 0.1, 0.2]),
    ]
    if extra is not None:
        joints.append(extra("second_bolt", "a", "b", [0.6, 0.2, 0.1], **axes))  # type: ignore[arg-type]
    return Scene("bolted", Mechanism(bodies, joints), 1.0, 0.1, GRAVITY)


REGULAR = (pendulum, spinning_top, all_universal_loop, ball_loop, seven_hinges, slider_tree)
"""Mechanisms whose constraints are independent."""


MASS, STIFFNESS, DAMPING = 2.0, 50.0, 3.0
"""kg, N/m and N s/m of `mass_on_rail` and what pulls it."""


def mass_on_rail(
    *forces: Force,
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    duration: float = 10.0,
    **fields: Any,
) -> Scene:
    """A body on a vertical rail through the world's origin, at rest."""
    bodies = [Body.ground(), Body("mass", MASS, [0.0, 0.0, 0.0], inertia(0.1, 0.2, 0.3))]
    rail = Translational("rail", "ground", "mass", [0.0, 0.0, 0.0], axis=[0.0, 0.0, 1.0], actuated=True)
    mechanism = Mechanism(bodies, [rail])
    return Scene("mass", mechanism, duration, 0.1, gravity, forces=forces, **fields)


def line_spring(**values: float) -> PointSpring:
    """From 2 m above to the mass of `mass_on_rail`."""
    ends = ([0.0, 0.0, 2.0], [0.0, 0.0, 0.0])
    return PointSpring("line", "ground", "mass", *ends, **({"stiffness": STIFFNESS} | values))


def at_rest(scene: Scene) -> Evaluation:
    """Evaluate the joint-coordinate form at the initial pose, without velocities."""
    system = Relative(scene)
    return system.evaluate(*system.coordinates(State.initial(scene.mechanism)))
