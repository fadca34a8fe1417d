"""Loads of dry friction, stops and elastic gears on joint coordinates, computed from their attributes.

The equations of motion of newton_euler call methods of these elements (`newton_euler.model.switched_forces`).
This module evaluates the same formulas independently, in plain floats. MuJoCo and Pinocchio, which have no
such elements, get their forces from here, and so do the checks of imported files. The comparison of engines
therefore also finds mistakes in the methods.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, assert_never

import numpy as np

from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.switched_forces import ElasticGear, JointFriction, JointStop, SwitchedElement
from newton_euler.scalars import Array


class SwitchedLoad(NamedTuple):
    """Load of one element on its joint coordinates.

    Attributes:
        forces: on each joint coordinate of the element, N or N m.
        elastic: the parts of these forces that have a potential energy.
        energy: potential energy, J.
    """

    forces: Sequence[float]
    elastic: Sequence[float]
    energy: float


def switched_load(element: SwitchedElement, x: Sequence[float], rates: Sequence[float]) -> SwitchedLoad:
    """Compute the load of an element; the formulas and their sources are in the docstrings of the classes.

    Args:
        element: dry friction, a stop or an elastic gear.
        x: coordinates of `element.keys`, m or rad from the initial pose.
        rates: their rates.
    """
    if isinstance(element, JointFriction):
        (rate,) = rates
        # friction that grows with the reaction of the joint is added by `SwitchedLoads.forces`
        curve = element.coulomb + element.stribeck / (1.0 + (rate / element.stribeck_speed) ** 2)
        saturated = min(max(rate / element.transition_speed, -1.0), 1.0)
        return SwitchedLoad([-curve * saturated], [0.0], 0.0)
    if isinstance(element, JointStop):
        # `inward` is the direction in which the stop pushes
        inward = -1.0 if element.side == "high" else 1.0
        depth, depth_rate = inward * (element.limit - x[0]), -inward * rates[0]
        push, damped = _push(element.stiffness, element.dissipation, depth, depth_rate)
        return SwitchedLoad([inward * damped], [inward * push], 0.5 * push * max(depth, 0.0))
    if isinstance(element, ElasticGear):
        return _gear_load(element, x, rates)
    assert_never(element)


def _push(stiffness: float, dissipation: float, depth: float, depth_rate: float) -> tuple[float, float]:
    """Compute the force of a one-sided spring, N or N m, and the force with Hunt and Crossley's damping."""
    push = stiffness * max(depth, 0.0)
    return push, push * max(1.0 + dissipation * depth_rate, 0.0)


def _gear_load(gear: ElasticGear, x: Sequence[float], rates: Sequence[float]) -> SwitchedLoad:
    """Compute the load of an elastic gear on its driver and its follower."""
    y, rate = gear.ratio * x[0] - x[1] - gear.rest, gear.ratio * rates[0] - rates[1]
    # the spring that acts: that of a driver ahead of its follower, or behind it
    ahead = 1.0 if y > 0.0 else -1.0
    depth = abs(y) - 0.5 * gear.play
    push, damped = _push(gear.stiffness, gear.dissipation, depth, ahead * rate)
    # torque of the driver by its saturated speed in the direction of the push: the parabola through that of a
    # driver which is driven, at -1, of a gear without friction, at 0, and of a driver which drives, at 1
    speed = ahead * min(max(gear.ratio * rates[0] / gear.transition_speed, -1.0), 1.0)
    driven, driving = gear.backward_efficiency, 1.0 / gear.forward_efficiency
    factor = driven * speed * (speed - 1.0) / 2.0 + (1.0 - speed**2) + driving * speed * (speed + 1.0) / 2.0
    forces = [-ahead * gear.ratio * damped * factor, ahead * damped]
    return SwitchedLoad(forces, [-ahead * gear.ratio * push, ahead * push], 0.5 * push * max(depth, 0.0))


class SwitchedLoads:
    """Loads of all switched forces of a scene.

    Attributes:
        keys: joint coordinates on which the elements act, with repetitions.
        loaded: indices in `keys` of the frictions that grow with reactions, in the order of the scene.
    """

    def __init__(self, scene: Scene) -> None:
        self.keys: list[Key] = [key for element in scene.switched_forces for key in element.keys]
        self._elements, first = list[tuple[SwitchedElement, slice]](), 0
        for element in scene.switched_forces:
            self._elements.append((element, slice(first, first + len(element.keys))))
            first += len(element.keys)
        self.loaded = [
            place.start
            for each, place in self._elements
            if isinstance(each, JointFriction) and each.is_loaded
        ]

    def forces(
        self, x: Array, rates: Array, friction: Callable[[], Mapping[str, float]]
    ) -> tuple[Array, Array]:
        """Compute the forces of all elements.

        Args:
            x, rates: coordinates of `keys`, m or rad from the initial pose, and their rates.
            friction: computes, by identity of the element, the frictions that grow with reactions. It is not
                called without such elements.

        Returns:
            The forces (k,) on the coordinates, N or N m; the parts (k,) that have a potential energy.
        """
        forces, elastic = list[float](), list[float]()
        coordinates, speeds = x.tolist(), rates.tolist()
        loaded = friction() if self.loaded else {}
        for element, place in self._elements:
            load = switched_load(element, coordinates[place], speeds[place])
            forces += load.forces
            if element.identity in loaded:
                forces[-1] += loaded[element.identity]
            elastic += load.elastic
        return np.array(forces, dtype=float), np.array(elastic, dtype=float)

    def energy(self, x: Array) -> float:
        """Compute the potential energy of all elements, J, at coordinates x of `keys`."""
        coordinates, at_rest = x.tolist(), [0.0] * len(x)
        loads = (switched_load(each, coordinates[place], at_rest[place]) for each, place in self._elements)
        return sum((load.energy for load in loads), start=0.0)
