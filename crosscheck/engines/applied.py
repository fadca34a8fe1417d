"""Applied forces of a scene for engines whose equations Python evaluates, from the attributes of its
elements.

The methods of the elements, which newton_euler's equations use, are not called here. A mistake in them shows
therefore as a difference between engines. An engine that has springs of its own uses these, and takes the
other forces from this module.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import NamedTuple, assert_never

import numpy as np

from newton_euler.model.control import ComputedTorque, DeclaredLaw
from newton_euler.model.digital_control import HeldLaw, Law
from newton_euler.model.forces import BallSpring, Force, JointSpring, PointSpring, Wrench
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.switched_forces import ElasticGear, JointFriction, JointStop
from newton_euler.model.variable import altered
from newton_euler.model.wind import WindLoad
from newton_euler.reading.switched_loads import SwitchedLoad, switched_load
from newton_euler.reading.wrenches import Wrenches
from newton_euler.scalars import Array

CoordinateElement = Law | JointSpring | JointFriction | JointStop | ElasticGear
"""Element whose forces act along joint coordinates."""

Motions = Mapping[Key, tuple[float, float]]
"""Joint coordinates, m or rad with full revolutions, and their rates, by key."""


def coordinate_elements(scene: Scene) -> list[CoordinateElement]:
    """Return the control laws, then the other forces along joint coordinates; the order is the scene's."""
    found: list[CoordinateElement] = [*scene.control]
    for force in scene.forces:
        if isinstance(force, JointSpring | JointFriction | JointStop | ElasticGear):
            found.append(force)
        elif not isinstance(force, BallSpring | PointSpring | Wrench | WindLoad):
            assert_never(force)
    return found


def coordinate_load(
    element: CoordinateElement, motions: Motions, time: float, given: Mapping[Key, float]
) -> SwitchedLoad:
    """Compute the forces of an element along its joint coordinates `element.keys`.

    Args:
        element: control law, spring, friction, stop or elastic gear.
        motions: coordinates that the element acts on or reads.
        time: s.
        given: forces of laws that use a model of the mechanism, N or N m, by coordinate.
    """
    if isinstance(element, JointSpring):
        x, rate = motions[element.key]
        pull = element.stiffness * (element.rest - x)
        return SwitchedLoad([pull - element.damping * rate], [pull], 0.5 * pull * (element.rest - x))
    if isinstance(element, HeldLaw):
        return SwitchedLoad([element.held], [0.0], 0.0)
    if isinstance(element, DeclaredLaw):
        force, references = float(element.feedforward_at(time)), element.references(time)
        for key, (k_p, k_d) in element.feedback.items():
            x, rate = motions[key]
            force += k_p * (references[key].value - x) + k_d * (references[key].rate - rate)
        return SwitchedLoad([force + given[element.key] if element.uses_model else force], [0.0], 0.0)
    if isinstance(element, JointFriction | JointStop | ElasticGear):
        # friction that grows with the reaction of its joint is not part of this load
        x_and_rates = zip(*(motions[key] for key in element.keys), strict=True)
        return switched_load(element, *x_and_rates)
    assert_never(element)


def commands(laws: Sequence[Law], motions: Motions, time: float) -> Iterator[float]:
    """Yield the acceleration, m/s^2 or rad/s^2, that each computed-torque law commands at a time, s."""
    for law in laws:
        if isinstance(law, ComputedTorque):
            (x, rate), reference = motions[law.key], law.references(time)[law.key]
            feedback = law.stiffness * (reference.value - x) + law.damping * (reference.rate - rate)
            yield float(reference.acceleration) + feedback


class BodyLoads(NamedTuple):
    """Forces on bodies at one state: springs of points and balls, wrenches and wind.

    Attributes:
        wrenches: (b, 6) forces and torques about the centers of mass, N and N m, world frame, without those
            of springs that the engine's own model has.
        power: W, of all forces without potential energy.
        energy: J, potential energy of the springs, without that of springs of the engine's own model.
        native_energy: J, potential energy of the springs of the engine's own model.
    """

    wrenches: Array
    power: float
    energy: float
    native_energy: float

    @classmethod
    def none(cls, bodies: int) -> BodyLoads:
        """Return no forces on a number of bodies."""
        return cls(np.zeros((bodies, 6)), power=0.0, energy=0.0, native_energy=0.0)


def body_loads(scene: Scene, state: State, time: float, native: Collection[object] = ()) -> BodyLoads:
    """Compute the forces on bodies at a state and a time, s.

    Args:
        scene: the scene.
        state: poses and velocities of the bodies.
        time: s.
        native: springs that the engine's own model has.
    """
    if not scene.body_forces:
        return BodyLoads.none(len(scene.mechanism.bodies))
    rates = np.hstack([state.linear_velocity, state.angular_velocity])
    wrenches, power, energies = np.zeros(rates.shape), 0.0, [0.0, 0.0]
    of_element = Wrenches(scene.mechanism, state, time)

    def applied(force: Force) -> Array:
        """Return the wrenches (b, 6) of one element."""
        of_element.total[:] = 0.0
        of_element.add_force(force)
        return of_element.total.copy()

    for force in scene.body_forces:
        is_native = any(force is each for each in native)
        if isinstance(force, PointSpring):
            at = of_element.stretch(force)
            # products, which are infinite where powers of a diverging run would raise an OverflowError
            power -= force.damping * at.rate * at.rate
            deflection = at.length - force.rest_length
            energies[is_native] += 0.5 * force.stiffness * deflection * deflection
            if not is_native:
                wrenches += applied(force)
            continue
        total = applied(force)
        power += float(np.sum(total * rates))
        if not is_native:
            wrenches += total
        if isinstance(force, BallSpring) and force.stiffness:
            # the torque of an undamped spring is its stiffness times its deflection
            elastic = applied(altered(force, damping=0.0))
            power -= float(np.sum(elastic * rates))
            pull = elastic[scene.mechanism.joint_equations(force.joint).second, 3:]
            energies[is_native] += 0.5 * float(pull @ pull) / force.stiffness
    return BodyLoads(wrenches, power, *energies)
