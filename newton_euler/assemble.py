"""Consistent states: bodies moved the least until every joint closes."""

from __future__ import annotations

import numpy as np

from newton_euler.cartesian import Cartesian
from newton_euler.errors import AssemblyError
from newton_euler.relative import Relative
from newton_euler.scene import Scene
from newton_euler.stabilize import project_position, project_velocity
from newton_euler.state import State

RANDOM_AMPLITUDE = 0.2
"""How far `random_states` moves joints before it closes the loops: radians, and sizes of the mechanism."""

ATTEMPTS = 50


def assemble(scene: Scene, guess: State) -> State:
    """The consistent state near a guess: positions first, then velocities, by steps of least length.

    Raises:
        AssemblyError: with the joint that stays open.
    """
    system = Cartesian(scene)
    q, v = system.coordinates(guess)
    q = project_position(system, q)
    return system.state(q, project_velocity(system, q, v))


def random_states(scene: Scene, count: int, seed: int = 0) -> list[State]:
    """Consistent states at random around the initial one, with random velocities; same seed, same states.

    Joint velocities are of the order of 1 rad/s and of one size of the mechanism per second.

    Raises:
        AssemblyError: if the mechanism hardly ever closes from nearby.
    """
    system = Relative(scene)
    tree = system.tree
    unit = np.ones(tree.nv)
    for motion, _, on_v in tree.motions:
        if motion.kind == "slide":
            unit[on_v] = scene.mechanism.size
    start, _ = system.coordinates(scene.initial_state)
    rng = np.random.default_rng(seed)
    states: list[State] = []
    for _ in range(ATTEMPTS * count):
        if len(states) == count:
            break
        step = RANDOM_AMPLITUDE * unit * rng.uniform(-1.0, 1.0, tree.nv)
        v = unit * rng.standard_normal(tree.nv)
        try:
            q = project_position(system, tree.retract(start, step))
        except AssemblyError as error:
            failure = error
            continue
        states.append(system.state(q, project_velocity(system, q, v)))
    if len(states) < count:
        raise failure
    return states
