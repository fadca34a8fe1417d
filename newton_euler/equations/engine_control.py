"""Forces of control laws that know the mechanism, by another engine's own mass matrix, bias and Jacobians."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from newton_euler.equations.couplings import TreeCouplings
from newton_euler.equations.dense import solve_constrained
from newton_euler.equations.model_control import known_scene, roles
from newton_euler.equations.parameters import measuring
from newton_euler.equations.redundancy import rows_left_out, without
from newton_euler.equations.system import System
from newton_euler.errors import SingularityError
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.scalars import Array


class EngineModel(Protocol):
    """An engine's model of a mechanism."""

    time: float
    couplings: TreeCouplings

    def servo_forces(self, q: Array, v: Array, keys: Sequence[Key], accelerations: Array) -> Array:
        """Compute the forces on joint coordinates, N or N m, that give them accelerations."""


class EngineControl:
    """Inverse dynamics of the controller's model, which has no wind, for the control laws of a scene."""

    def __init__(self, scene: Scene, build: Callable[[Scene], EngineModel]) -> None:
        """`build` makes the engine's model of a scene."""
        self._torque, self._holding, values = roles(scene)
        known = known_scene(scene, values)
        self._moving = build(measuring(known, self._torque)) if self._torque else None
        self._resting = build(measuring(known, self._holding)) if self._holding else None
        if self._resting:
            coupled = self._resting.couplings
            coupled.couplings = tuple(replace(each, function=None) for each in coupled.couplings)
        self._last: tuple[Any, Mapping[Key, float]] = None, {}

    def forces(self, q: Array, v: Array, time: float, accelerations: Sequence[float]) -> Mapping[Key, float]:
        """Compute the forces, N or N m, by joint coordinates.

        Args:
            q, v: (nq,) and (nv,) tree coordinates and velocities.
            time: s.
            accelerations: that laws of computed torque command, in order.
        """
        state = q.tobytes(), v.tobytes(), time, tuple(accelerations)
        if self._last[0] != state:  # the power asks for them as well
            found: dict[Key, float] = {}
            wanted = np.zeros(len(self._holding)), np.array(accelerations)
            keys, models = (self._holding, self._torque), (self._resting, self._moving)
            for model, on, values, rates in zip(models, keys, wanted, (np.zeros(len(v)), v), strict=True):
                if model:
                    model.time = time
                    found |= dict(zip(on, model.servo_forces(q, rates, on, values).tolist(), strict=True))
            self._last = state, found
        return self._last[1]


def servo_forces(
    system: System,
    tree: SpanningTree,
    mass_and_force: tuple[Array, Array],
    jacobian_and_gamma: tuple[Array, Array],
    keys: Sequence[Key],
    accelerations: Array,
) -> Array:
    """Compute the forces on joint coordinates, N or N m, for accelerations that are further constraints.

    Args:
        system: an engine's, whose matrices these are.
        tree: of its coordinates.
        mass_and_force: M (nv, nv) and f (nv,) of M vdot = f + J^T lambda.
        jacobian_and_gamma: J (k, nv) and gamma (k,) of J vdot = gamma.
        keys, accelerations: the joint coordinates, none of which is cut, and m/s^2 or rad/s^2.

    Raises:
        SingularityError: where the coordinates do not determine the motion.
    """
    rows = np.zeros((len(keys), system.nv))
    places = [tree.place(*key) for key in keys]
    rows[np.arange(len(keys)), [place[1] for place in places if place]] = 1.0
    units = [system.mechanism.size if system.mechanism.is_slide(*key) else 1.0 for key in keys]
    unused = rows_left_out(system)
    jacobian, gamma = (without(each, unused) for each in jacobian_and_gamma)
    try:
        _, multipliers = solve_constrained(
            *mass_and_force,
            np.concatenate([jacobian, rows]),
            np.concatenate([gamma, accelerations]),
            np.concatenate([system.phi_units, units]),
            system.velocity_units,
        )
    except np.linalg.LinAlgError as error:
        raise SingularityError(keys[0][0], "control laws cannot choose the accelerations there") from error
    return np.asarray(multipliers[len(system.phi_units) :])
