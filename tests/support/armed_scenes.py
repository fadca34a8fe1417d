"""Scenes with compound joints, and rotors and springs on each joint coordinate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from mechanisms import GRAVITY, bar

from newton_euler import Armature, JointSpring, Mechanism
from newton_euler.model.compound_joint import Compound
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import Universal
from newton_euler.model.mechanism import Body
from newton_euler.model.scene import Scene


def armed(scene: Scene) -> Scene:
    """The scene with a rotor on each of its hinges and slides."""
    rng = np.random.default_rng(5)
    armatures = [
        Armature(joint.name, rng.uniform(0.05, 0.5), k)
        for joint in scene.mechanism.joints
        for k in range(len(joint.coordinate_kinds))
    ]
    return replace(scene, armatures=tuple(armatures))


def compound_chain(forward: bool = True) -> Scene:
    """Slides and three hinges askew, then two hinges askew, then a ball on a slide."""
    ends = [("ground", "a"), ("a", "b"), ("b", "c")]
    if not forward:
        ends = [(second, first) for first, second in ends]
    points = [[0.1, 0.2, 0.0], [0.5, 0.1, 0.3], [0.9, 0.4, 0.2]]
    names = "abc"
    bodies = [
        bar(name, point, np.add(point, [0.3, 0.1, 0.2])) for name, point in zip(names, points, strict=True)
    ]
    joints: list[Joint] = [
        Compound("first", *ends[0], points[0], slides=[[1, 0, 0], [0.3, 1, 0]],
                 hinges=[[1, 0.2, 0], [0, 1, 0.3], [0.2, 0, 1]]),
        Compound("second", *ends[1], points[1], hinges=[[0, 1, 0], [0.6, 0.5, 0]]),
        Compound("third", *ends[2], points[2], slides=[[0, 1, 1]], ball=True),
    ]  # fmt: skip
    mechanism = Mechanism([Body.ground(), *bodies], joints)
    return Scene("compound_chain", mechanism, 0.3, 0.1, GRAVITY)


def compound_loop() -> Scene:
    """A loop of a universal joint and compound ones, which is cut at one of them: 7 + 1 - 6 freedoms."""
    a, b, c = [0.0, 0.0, 0.0], [0.1, 0.1, 0.5], [0.9, 0.3, 0.3]
    bodies = [Body.ground(), bar("crank", a, b), bar("coupler", b, c, 2.0)]
    joints: list[Joint] = [
        Universal("at_a", "ground", "crank", a, axis_on_first=[0, 1, 0], axis_on_second=[1, 0, 0]),
        Compound("at_b", "crank", "coupler", b, hinges=[[0, 1, 0], [0.6, 0.2, 0.8]]),
        Compound("at_c", "ground", "coupler", c, slides=[[1, 0, 0.2]],
                 hinges=[[0.1, 0.2, 1], [1, 0, 0], [0.2, 1, 0.1]]),
    ]  # fmt: skip
    return Scene("compound_loop", Mechanism(bodies, joints), 0.3, 0.1, GRAVITY)


def skew_chain() -> Scene:
    """A slide before two hinges whose axes do not meet, then three such hinges."""
    bodies = [bar("a", [0.2, 0.0, 0.3], [0.5, 0.1, 0.3]), bar("b", [0.6, 0.3, 0.3], [0.9, 0.4, 0.5])]
    joints: list[Joint] = [
        Compound("first", "ground", "a", [0.1, 0.2, 0.0], slides=[[1, 0.2, 0.3]],
                 hinges=[[1, 0.2, 0], [0, 1, 0.3]], offsets=[[0.1, -0.2, 0.3]]),
        Compound("second", "a", "b", [0.5, 0.1, 0.3], hinges=[[0, 1, 0], [0.6, 0.5, 0], [0.2, 0, 1]],
                 offsets=[[0.1, 0.0, 0.1], [0.0, 0.2, -0.1]]),
    ]  # fmt: skip
    return Scene("skew_chain", Mechanism([Body.ground(), *bodies], joints), 0.3, 0.1, GRAVITY)


COMPOUNDS = {
    "compound, skew": skew_chain(),
    "compound": compound_chain(),
    "compound, reversed": compound_chain(forward=False),
    "compound, cut": compound_loop(),
}


def sprung(scene: Scene) -> Scene:
    """The scene with a spring and damper on each of its hinges and slides."""
    rng = np.random.default_rng(6)
    forces = [
        JointSpring(joint.name, rng.uniform(1.0, 9.0), rng.uniform(0.1, 0.2), rng.normal(), k)
        for joint in scene.mechanism.joints
        for k in range(len(joint.coordinate_kinds))
    ]
    return replace(scene, forces=tuple(forces))
