"""Random bodies in a row or a loop of joints of every kind, for tests of engines against each other."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from newton_euler.model.control import PD
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import JOINT_KINDS
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array


def unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))


def random_inertia(rng: np.random.Generator, moments: Array) -> Array:
    """Principal moments along random axes, symmetric to the last digit."""
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    inertia = axes @ np.diag(moments) @ axes.T
    return np.asarray(0.5 * (inertia + inertia.T))


def random_joint(
    kind: str, name: str, first: str, second: str, rng: np.random.Generator, actuated: bool
) -> Joint:
    """A joint anywhere within a meter, its two points apart where the kind allows it."""
    axis, point = unit(rng.normal(size=3)), 0.3 * rng.normal(size=3)
    more: dict[str, Any] = {"actuated": actuated}
    if kind == "universal":
        more |= {
            "axis_on_first": axis,
            "axis_on_second": unit(np.cross(axis, rng.normal(size=3))),
        }
    elif kind == "compound":
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        more |= {"slides": turn[:1], "hinges": turn[1:], "offsets": 0.1 * rng.normal(size=(1, 3))}
    elif kind not in ("spherical", "fixed", "free"):
        more["axis"] = axis
    if kind in ("cylindrical", "translational"):
        more["point_on_second"] = point + 0.1 * axis
    if kind == "screw":
        more["pitch"] = 0.2
    if kind == "parallel_hinges":
        more["offset"] = 0.1 * unit(np.cross(axis, rng.normal(size=3)))
    return JOINT_KINDS[kind](name, first, second, point, **more)


def chain(
    kinds: Sequence[str],
    closed: bool = False,
    reverse: Collection[int] = (),
    actuated: Collection[int] = (),
    seed: int = 0,
) -> Scene:
    """Random bodies joined in a row from the ground, and back to it if closed, under gravity.

    Body frames are turned at random, so that no two of them are parallel. Joints numbered in
    `reverse` have their bodies swapped.
    """
    rng = np.random.default_rng(seed)
    count = len(kinds) - closed
    bodies = [Body("ground", 0.0, 0.1 * rng.normal(size=3), np.zeros((3, 3)))]
    for k in range(count):
        inertia = random_inertia(rng, 1e-2 * rng.uniform(1.0, 1.8, 3))
        center = 0.3 * rng.normal(size=3)
        bodies.append(Body(f"body_{k}", rng.uniform(0.5, 2.0), center, inertia, unit(rng.normal(size=4))))
    names = [body.name for body in bodies]
    joints, control = [], []
    for k, kind in enumerate(kinds):
        first, second = names[k], names[(k + 1) % len(names)]
        if k in reverse:
            first, second = second, first
        joint = random_joint(kind, f"joint_{k}", first, second, rng, k in actuated)
        joints.append(joint)
        if k in actuated:
            coordinates = sum(motion.kind != "ball" for motion in joint.motions)
            control += [PD(joint.name, 5.0, 0.7, 0.1, c) for c in range(coordinates)]
    return Scene(
        "chain",
        Mechanism(bodies, joints),
        duration=0.5,
        output_period=0.1,
        gravity=np.array([0.3, -1.0, -9.81]),
        control=tuple(control),
    )


CHAINS = {
    "heavy top": chain(["spherical"]),
    "heavy top, joint reversed": chain(["spherical"], reverse=[0]),
    "universal, ball, cylindrical": chain(["universal", "spherical", "cylindrical"], actuated=[0, 2]),
    "universal, ball, cylindrical, reversed": chain(
        ["universal", "spherical", "cylindrical"], reverse=[0, 1, 2], actuated=[0, 2]
    ),
    "floating, with a rigid part": chain(["free", "fixed", "revolute"], actuated=[0, 2]),
    "floating, joints reversed": chain(["free", "fixed", "revolute"], reverse=[0, 1, 2], actuated=[2]),
    "loop cut at a ball": chain(
        ["translational", "universal", "spherical", "revolute"], closed=True, actuated=[0], seed=5
    ),
    "loop cut at a ball to the ground": chain(
        ["translational", "universal", "revolute", "spherical"], closed=True, actuated=[1], seed=6
    ),
    "loop cut at a hinge": chain(["revolute"] * 7, closed=True, actuated=[0, 6], seed=2),
    "loop cut at a hinge, half of the joints reversed": chain(
        ["revolute"] * 7, closed=True, reverse=[1, 3, 5, 6], actuated=range(7), seed=2
    ),
    "loop cut at a universal joint": chain(
        ["revolute", "universal", "universal", "cylindrical"],
        closed=True,
        actuated=[1, 2, 3],
        seed=3,
    ),
    "loop cut at a universal joint, joints reversed": chain(
        ["revolute", "universal", "universal", "cylindrical"],
        closed=True,
        reverse=[0, 1, 2],
        actuated=[1, 2, 3],
        seed=3,
    ),
    # the free joint is cut through the body, and one half floats against the ground: slides, then a ball
    "loop through a free joint": chain(["spherical", "free"], closed=True, reverse=[1], seed=9),
    # its second body is on the ground's side: the ball comes before the slides
    "loop through a free joint reversed": chain(["spherical", "free"], closed=True, seed=9),
    "loop through free joints both ways round": chain(
        ["universal", "free", "free", "revolute"], closed=True, reverse=[1], actuated=[0, 3], seed=9
    ),
    # from 60 velocities on MuJoCo keeps its Jacobians sparse
    "long loop of balls": chain(["spherical"] * 21, closed=True, seed=8),
    "loop cut at a cylindrical joint": chain(
        ["revolute", "universal", "cylindrical", "universal"],
        closed=True,
        actuated=[0, 1, 3],
        seed=4,
    ),
}


def tree(seed: int, count: int = 14) -> Scene:
    """Random bodies on joints of all kinds, in branches of some twenty velocities, under gravity."""
    rng = np.random.default_rng(seed)
    bodies, joints, control = [Body.ground()], list[Joint](), []
    kinds = [kind for kind, joint in JOINT_KINDS.items() if not joint.only_closes]
    for k in range(count):
        inertia = random_inertia(rng, 1e-2 * rng.uniform(1.0, 1.8, 3))
        body = Body(
            f"body_{k}", rng.uniform(0.5, 2.0), 0.3 * rng.normal(size=3), inertia, unit(rng.normal(size=4))
        )
        parent = bodies[int(rng.integers(max(0, k - 2), k + 1))].name
        ends = (parent, body.name) if rng.random() < 0.5 else (body.name, parent)
        joint = random_joint(kinds[(k + seed) % len(kinds)], f"joint_{k}", *ends, rng, k % 3 == 0)
        bodies.append(body)
        joints.append(joint)
        if joint.actuated:
            control += [PD(joint.name, 5.0, 0.7, 0.1, c) for c in range(len(joint.coordinate_kinds))]
    mechanism = Mechanism(bodies, joints)
    return Scene("tree", mechanism, 0.5, 0.1, gravity=np.array([0.3, -1.0, -9.81]), control=tuple(control))


TREES = {f"tree {seed}": tree(seed) for seed in range(3)}
