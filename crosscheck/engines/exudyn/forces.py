"""Applied forces of a scene: those that Exudyn does not compute, and the energy and power of all of them.

Exudyn's connectors and loads have springs, dampers, constant PD laws and wrenches of their own, see
`crosscheck.engines.exudyn.connectors`. The other forces are user functions in Python, which take them from
`crosscheck.engines.applied`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import NamedTuple

import numpy as np

from crosscheck.engines.applied import Motions, body_loads, coordinate_elements, coordinate_load
from newton_euler.model.forces import BallSpring, Force, PointSpring, Wrench
from newton_euler.model.joint import Key
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.wind import WindLoad
from newton_euler.scalars import Array


def loaded_bodies(mechanism: Mechanism, force: Force) -> set[int]:
    """Return the numbers of the bodies on which a force of `Scene.body_forces` acts."""
    if isinstance(force, BallSpring):
        equations = mechanism.joint_equations(force.joint)
        return {equations.first, equations.second}
    if isinstance(force, PointSpring):
        return {mechanism.body_index(name) for name in (force.first, force.second)}
    if isinstance(force, Wrench | WindLoad):
        return {mechanism.body_index(force.body)}
    raise TypeError(f"{force!r} acts on no bodies")


def motions_of(scene: Scene, state: State) -> Motions:
    """Return the joint coordinates that forces act on or that laws read, and their rates, by key."""
    found = dict[Key, tuple[float, float]]()
    keys = dict.fromkeys((*scene.loaded_coordinates, *scene.sensed))
    frames = state.frames() if keys else []
    for key in keys:
        x, rate = scene.mechanism.measure(key, frames)
        found[key] = float(x + state.revolutions(key, x)), float(rate)
    return found


class AppliedForces(NamedTuple):
    """Forces on bodies at one state that Exudyn does not compute, and what all forces of a scene do.

    Attributes:
        on_bodies: (b, 6) forces and torques about the centers of mass, N and N m, world frame.
        control: (a,) forces of the control laws, N or N m.
        power: W, of all forces without potential energy.
        energy: J, of all springs.
        given: forces of laws that use a model of the mechanism, N or N m, by joint coordinate.
    """

    on_bodies: Array
    control: Array
    power: float
    energy: float
    given: Mapping[Key, float]


def applied_forces(
    scene: Scene, state: State, time: float, native: Collection[object], given: Mapping[Key, float]
) -> AppliedForces:
    """Compute the applied forces of a scene at a state and a time, s.

    Args:
        scene: the scene.
        state: poses and velocities of the bodies, with full revolutions of the hinge angles.
        time: s.
        native: forces on bodies that Exudyn computes.
        given: see `AppliedForces`.
    """
    loads = body_loads(scene, state, time, native)
    power, energy = loads.power, loads.energy + loads.native_energy
    motions, control = motions_of(scene, state), list[float]()
    for place, element in enumerate(coordinate_elements(scene)):
        load = coordinate_load(element, motions, time, given)
        energy += load.energy
        for key, force, elastic in zip(element.keys, load.forces, load.elastic, strict=True):
            power += (force - elastic) * motions[key][1]
        if place < len(scene.control):
            control += load.forces
    return AppliedForces(loads.wrenches, np.array(control), power, energy, given)
