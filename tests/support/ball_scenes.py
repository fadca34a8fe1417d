"""Scenes with springs, dampers and rotors on their balls."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from armed_scenes import COMPOUNDS, armed, sprung
from elements import JOINTS
from mechanisms import GRAVITY, ball_loop, slider_tree, spinning_top

from newton_euler import BallArmature, BallSpring, Body, Mechanism, Scene, State
from newton_euler.model.euler_parameters import from_rotation_vector
from newton_euler.model.joint_kinds import Spherical

AXIS = np.array([2.0, -1.0, 2.0]) / 3.0


def with_balls(scene: Scene) -> Scene:
    """The scene with a spring, a damper and a rotor on each ball."""
    rng = np.random.default_rng(8)
    forces, armatures = list(scene.forces), list(scene.armatures)
    for joint in scene.mechanism.joints:
        if any(motion.kind == "ball" for motion in joint.motions):
            rest = 0.7 * rng.normal(size=3)
            forces.append(BallSpring(joint.name, rng.uniform(1.0, 9.0), rng.uniform(0.1, 0.5), rest))
            armatures.append(BallArmature(joint.name, rng.uniform(0.05, 0.5)))
    return replace(scene, forces=tuple(forces), armatures=tuple(armatures))


def twisted_loop() -> Scene:
    """A loop whose ball has to stay in the tree of engines, where it would be cut."""
    return with_balls(ball_loop())


def two_ball_loop(loaded: str) -> Scene:
    """A loop with the balls `at_b` and `at_c`, one with a spring; engines cut the loop at the other."""
    scene = ball_loop()
    joints = [
        Spherical(joint.name, joint.first, joint.second, joint.point) if joint.name == "at_b" else joint
        for joint in scene.mechanism.joints
    ]
    return replace(
        scene, mechanism=Mechanism(scene.mechanism.bodies, joints), forces=(BallSpring(loaded, 3.0),)
    )


SCENES = {
    "ball": with_balls(spinning_top()),
    "ball in a loop": twisted_loop(),
    "ball on the way back, free joint": with_balls(slider_tree()),
    "slide and ball": with_balls(JOINTS["point on line"]),
    "ball and slide, cut": with_balls(JOINTS["point on line, cut"]),
    "rods": with_balls(JOINTS["rods"]),
    "compound": with_balls(sprung(armed(COMPOUNDS["compound"]))),
    "compound, reversed": with_balls(sprung(armed(COMPOUNDS["compound, reversed"]))),
}


def sphere(*forces: BallSpring, rotor: float = 0.0, spin: float = 0.0, **fields: object) -> Scene:
    """A body of moment of inertia 0.5 kg m^2 about all axes, on a ball at its center of mass."""
    turn = from_rotation_vector(np.array([0.4, -0.7, 1.1]))  # of its frame: no matter
    body = Body("globe", 2.0, [0.1, 0.2, 0.3], 0.5 * np.eye(3), turn)
    mechanism = Mechanism([Body.ground(), body], [Spherical("ball", "ground", "globe", [0.1, 0.2, 0.3])])
    state = replace(State.initial(mechanism), angular_velocity=np.array([np.zeros(3), spin * AXIS]))
    rotors = (BallArmature("ball", rotor),) if rotor else ()
    return Scene("globe", mechanism, 5.0, 0.1, GRAVITY, (), state, forces=forces, armatures=rotors, **fields)  # type: ignore[arg-type]
