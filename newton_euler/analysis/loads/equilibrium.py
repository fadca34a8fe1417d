"""Equilibrium: poses in which a mechanism stays at rest, by Newton's method with linear models."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from newton_euler.analysis.kinematics.freedoms import chosen_freedoms
from newton_euler.analysis.linear.linear_model import RIGID_MODE
from newton_euler.analysis.linear.linearization import linearize
from newton_euler.arguments import checked
from newton_euler.equations.dense import largest, least_squares
from newton_euler.equations.relative import Relative
from newton_euler.errors import MechanismError
from newton_euler.integrators.projection import project_position
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.runs.assemble import initial_state

MAX_EQUILIBRIUM_STEP = 0.2
"""Longest step towards an equilibrium, rad or sizes of the mechanism."""

MAX_ITERATIONS = 100
"""Largest number of steps towards an equilibrium."""

CONVERGED_STEP = 1e-10
"""Length of a step, rad or sizes of the mechanism, below which an equilibrium is found. Newton's method
converges quadratically: the remaining error is about the square of the step."""


def at_rest(scene: Scene) -> Scene:
    """Return the scene with a start at rest and prescribed motions held at their values at time 0."""
    start = initial_state(scene)
    zero = np.zeros_like(start.position)
    motions = tuple(motion.held_at_start() for motion in scene.motions)
    state = replace(start, linear_velocity=zero, angular_velocity=zero)
    return replace(scene, motions=motions, initial_state=state)


@checked
def equilibrium(scene: Scene, state: State | None = None) -> State:
    """Find a pose near a state in which the mechanism stays at rest.

    Control laws, springs, wrenches and gravity balance in this pose. The pose is unstable only if no force
    leads the search away from it, for example if the search begins there. Prescribed motions hold their
    values at time 0, as in the scene that `at_rest` returns.

    Args:
        scene: the mechanism with its forces and control laws.
        state: state to begin at, its velocities ignored; the scene's initial state if None.

    Raises:
        MechanismError: if no equilibrium is nearby, naming a coordinate that still accelerates.
        NewtonEulerError: see `linearize`.

    Examples:
        >>> scene = load("stewart")
        >>> linearize(scene, equilibrium(scene)).is_equilibrium
        True
    """
    scene = at_rest(scene)
    start = initial_state(scene)
    if state is not None:
        scene.check_numbers(state, f"state of scene {scene.name!r}")
        start = replace(state, linear_velocity=start.linear_velocity, angular_velocity=start.angular_velocity)
    state = start
    # d independent joint coordinates, and the linear model of their deviations; x = (deviations, rates)
    names = [freedom.name for freedom in chosen_freedoms(scene, state, names=None)]
    system, model = Relative(scene), linearize(scene, state, names, inputs=[], outputs=[])
    d = len(names)
    for _ in range(MAX_ITERATIONS):
        # the model is xdot = f + A x: accelerations, and their derivatives -M^-1 K with respect to the
        # coordinates, with mass matrix M and stiffness matrix K
        accelerations, derivatives = model.f[d:], model.A[d:, :d]
        # The step in each mode is the acceleration divided by the magnitude of the eigenvalue, 1/s^2. For a
        # stable mode this is Newton's step; for an unstable mode it follows the force, away from the
        # equilibrium. `RIGID_MODE` limits the step in a mode without stiffness.
        values, vectors = np.linalg.eig(derivatives * model.units / model.units[:, None])
        along = least_squares(vectors, accelerations / model.units)
        step = (vectors @ (along / np.maximum(np.abs(values), RIGID_MODE))).real
        if model.is_equilibrium and largest(step) < CONVERGED_STEP:
            return state
        # take the step with limited length, and close the loops; `twists` (b, 6, d) are derivatives of the
        # linear and angular displacements of the b bodies with respect to the coordinates
        step *= min(1.0, MAX_EQUILIBRIUM_STEP / max(largest(step), MAX_EQUILIBRIUM_STEP))
        q, _ = system.coordinates(state)
        body_displacements = model.twists.reshape(-1, d) @ (model.units * step)
        tree_step = least_squares(system.velocity_transformation(q), body_displacements)
        q = project_position(system, system.retract(q, tree_step))
        state = system.state(q, np.zeros(system.nv))
        model = linearize(scene, state, names, inputs=[], outputs=[])
    worst = names[int(np.argmax(np.abs(accelerations / model.units)))]
    problem = f"has no equilibrium nearby: coordinate {worst!r} still accelerates"
    raise MechanismError(f"scene {scene.name!r}", problem, "a state near one")
