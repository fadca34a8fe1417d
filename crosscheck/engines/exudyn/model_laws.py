"""Forces of control laws that use a model of the mechanism, by the equations of Exudyn's model of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from crosscheck.engines.applied import commands
from crosscheck.engines.exudyn.forces import motions_of
from newton_euler.equations.engine_solution import servo_forces
from newton_euler.equations.model_control import known_scene, roles
from newton_euler.equations.parameters import measuring
from newton_euler.equations.system import System
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array


class ModelSystem(System, Protocol):
    """Equations of the controller's model."""

    def gamma(self, q: Array, v: Array) -> Array:
        """Compute the right side (k,) of J dv/dt = gamma."""


class ModelLaws:
    """Inverse dynamics of the controller's model, for computed torque and for gravity compensation."""

    def __init__(self, scene: Scene, build: Callable[[Scene], ModelSystem]) -> None:
        """Build the controller's models; `build` makes the equations of a scene."""
        self._torque, self._holding, values = roles(scene)
        self._moving = self._resting = None
        if self._torque or self._holding:
            known = known_scene(scene, values)
            self._moving = build(measuring(known, self._torque)) if self._torque else None
            self._resting = build(measuring(known, self._holding)) if self._holding else None

    def forces(self, scene: Scene, state: State, time: float) -> dict[Key, float]:
        """Compute the forces of the laws, N or N m, by joint coordinate.

        Args:
            scene: scene with the laws, in which set-points that jump are those of the time.
            state: poses and velocities of the bodies.
            time: s.
        """
        found: dict[Key, float] = {}
        if self._resting is not None:
            at_rest = replace(
                state,
                linear_velocity=np.zeros_like(state.linear_velocity),
                angular_velocity=np.zeros_like(state.angular_velocity),
            )
            none = np.zeros(len(self._holding))
            found |= _servo_forces(self._resting, at_rest, time, self._holding, none, moves=False)
        if self._moving is not None:
            wanted = np.array(list(commands(scene.control, motions_of(scene, state), time)))
            found |= _servo_forces(self._moving, state, time, self._torque, wanted, moves=True)
        return found


def _servo_forces(
    system: ModelSystem, state: State, time: float, keys: Sequence[Key], accelerations: Array, moves: bool
) -> dict[Key, float]:
    """Compute the forces on joint coordinates, N or N m, that cause given accelerations of them.

    Additional constraints prescribe the accelerations; their multipliers are the forces.

    Args:
        system: equations of the controller's model.
        state: poses and velocities of the bodies.
        time: s.
        keys: the joint coordinates.
        accelerations: of these coordinates, m/s^2 or rad/s^2.
        moves: False if prescribed motions stand still.

    Raises:
        SingularityError: in a state in which the coordinates do not determine the motion.
    """
    system.time = time
    q, v = system.coordinates(state)
    mass_and_force, jacobian = system.mass_and_force(q, v), system.phi_jacobian(q)
    gamma = system.gamma(q, v) if moves else np.zeros(len(jacobian))
    rows, terms = _coordinate_rows(system, state, keys)
    forces = servo_forces(system, mass_and_force, (jacobian, gamma), keys, (rows, accelerations + terms))
    return dict(zip(keys, forces.tolist(), strict=True))


def _coordinate_rows(system: ModelSystem, state: State, keys: Sequence[Key]) -> tuple[Array, Array]:
    """Return the derivatives (n, nv) of the rates of n joint coordinates by the velocities v.

    Returns:
        The derivatives; and minus the terms (n,) of the accelerations that do not depend on dv/dt.
    """
    frames, rows, terms = state.frames(), np.zeros((len(keys), system.nv)), np.zeros(len(keys))
    for n, (joint, coordinate) in enumerate(keys):
        equations = system.mechanism.joint_equations(joint)
        first, second = equations.first, equations.second
        measure = equations.coordinates[coordinate]
        of = measure.jacobian(frames[first], frames[second])
        terms[n] = measure.gamma(frames[first], frames[second])[0]
        blocks = (first, of.r_first, of.theta_first), (second, of.r_second, of.theta_second)
        for body, by_position, by_rotation in blocks:
            if body:
                rows[n, 6 * body - 6 : 6 * body - 3] = by_position[0]
                rows[n, 6 * body - 3 : 6 * body] = by_rotation[0] @ frames[body].rotation
    return rows, terms
