"""Checks of a formulation's constraints along paths that meet them, shared by tests."""

from __future__ import annotations

import numpy as np

from crosscheck.compare.allowed_motions import admissible_basis, body_units
from newton_euler.equations.formulation import Formulation
from newton_euler.equations.relative import Relative
from newton_euler.equations.system import System, at_time
from newton_euler.integrators.projection import project_position, project_velocity
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array


def admissible_projector(system: System, state: State) -> Array:
    """Orthogonal projector (6 b, 6 b) onto the body velocities that the constraints leave free."""
    basis, _ = admissible_basis(system, system.coordinates(state)[0], body_units(system.scene))
    return basis @ basis.T


def moving(system: Formulation, t: float, seed: int = 0) -> tuple[Formulation, Array, Array]:
    """The system at time t, and q and v that meet all constraints, in random motion."""
    rng = np.random.default_rng(seed)
    now = at_time(system, t)
    q, _ = now.coordinates(initial_state(now.scene))
    q = project_position(now, now.retract(q, 0.1 * now.velocity_units * rng.uniform(-1, 1, now.nv)))
    return now, q, project_velocity(now, q, now.velocity_units * rng.standard_normal(now.nv))


def states_near_start(scene: Scene, count: int) -> list[State]:
    """Consistent states at random within 0.05 rad: cranks far from flat, where a loop may fold."""
    system = Relative(scene)
    start, _ = system.coordinates(initial_state(scene))
    rng = np.random.default_rng(0)
    states = []
    for _ in range(count):
        q = project_position(system, system.retract(start, rng.uniform(-0.05, 0.05, system.nv)))
        states.append(system.state(q, project_velocity(system, q, rng.standard_normal(system.nv))))
    return states
