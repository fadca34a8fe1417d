"""Consistent states: bodies moved the least until every joint closes."""

from __future__ import annotations

import numpy as np

from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.relative import Relative
from newton_euler.errors import AssemblyError
from newton_euler.integrators.stabilize import project_position, project_velocity, worst_joint
from newton_euler.model.mechanism import CLOSURE_TOLERANCE
from newton_euler.model.scene import Scene
from newton_euler.model.state import State

RANDOM_AMPLITUDE = 0.2
"""How far `random_states` moves joints before it closes the loops: radians, and sizes of the mechanism."""

STRAY = 3.0
"""How many times as far as that a joint may end up from where it started."""

ATTEMPTS = 50


def assemble(scene: Scene, guess: State) -> State:
    """The consistent state near a guess: positions first, then velocities, by steps of least length.

    Raises:
        AssemblyError: with the joint that stays open.
        MechanismError: for a guess that is no state of the scene's bodies.
    """
    scene.check_numbers(guess, f"guess for scene {scene.name!r}")
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
    from newton_euler.compiled import Code
    from newton_euler.integrators.run import Projection

    code = Code(scene)
    assert isinstance(code.system, Relative)
    system, project = code.system, Projection(code)
    tree, unit = system.tree, system.velocity_units
    single = [(on_q.start, on_v.start) for motion, on_q, on_v in tree.motions if motion.kind != "ball"]
    single_q, single_v = [place[0] for place in single], [place[1] for place in single]
    start, _ = system.coordinates(scene.initial_state)
    rng = np.random.default_rng(seed)
    states: list[State] = []
    x = code.packed(start, np.zeros(tree.nv))
    for _ in range(ATTEMPTS * count):
        if len(states) == count:
            break
        step = RANDOM_AMPLITUDE * unit * rng.uniform(-1.0, 1.0, tree.nv)
        v = unit * rng.standard_normal(tree.nv)
        x[: code.size] = np.concatenate([system.retract(start, step), v])
        if not project(x):
            continue
        q, v = x[: system.nq], x[system.nq : code.size]
        if np.abs((q - start)[single_q] / unit[single_v]).max(initial=0.0) > STRAY * RANDOM_AMPLITUDE:
            continue  # closed on another branch, perhaps folded flat
        states.append(system.state(q, v))
    if len(states) < count:
        joint, gap = worst_joint(system, system.state(x[: system.nq], x[system.nq : code.size]))
        raise AssemblyError(joint, gap, CLOSURE_TOLERANCE)
    return states
