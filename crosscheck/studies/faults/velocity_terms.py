"""Dropped velocity terms: equations without omega x axis v in the angular acceleration of one hinge.

No scene can express this fault, therefore it is injected into the equations of an engine.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np

from newton_euler.equations.kinematics import Link
from newton_euler.equations.relative import Relative
from newton_euler.equations.system import Evaluation, System
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array, cross


def without_turning(system: System, joint: str) -> System:
    """Return an engine's equations without the velocity term of the last hinge of a joint.

    The angular accelerations of the two bodies of a hinge differ by axis dv/dt + omega x axis v, where omega
    is the angular velocity of the first body. The second term is dropped, for all bodies beyond the hinge.

    Args:
        system: equations of an engine.
        joint: name of a joint of the spanning tree whose last motion is a hinge.
    """
    return cast(System, _WithoutTurning(system, joint))


class _Dropped(Relative):
    """Joint-coordinate equations with the fault.

    Attributes:
        hinge: name of the joint whose last motion is the hinge at fault.
    """

    def __init__(self, scene: Scene, hinge: str) -> None:
        super().__init__(scene)
        self.hinge = hinge

    def links(self, q: Array, v: Array) -> list[Link]:
        links = list(super().links(q, v))
        (joint,) = (each for each in self.tree.joints if self.tree.joint(each.joint).name == self.hinge)
        place, child = joint.v.stop - 1, links[joint.child]
        turning = child.angular[:, -1] * v[place]  # axis v
        term = cross(child.frame.angular_velocity - turning, turning)
        apart = 0.0 if joint.forward else self.tree.joint(joint.joint).apart
        arm = self.mechanism.bodies[joint.child].center_of_mass - (joint.points[-1] - apart)
        point = child.frame.position - child.frame.rotation @ arm
        for body, link in enumerate(links):
            if place in link.path:
                links[body] = replace(
                    link,
                    acceleration=link.acceleration - cross(term, link.frame.position - point),
                    angular_acceleration=link.angular_acceleration - term,
                )
        return links

    def body_accelerations(self, q: Array, v: Array, vdot: Array) -> tuple[Array, Array]:
        links = self.links(q, v)
        return (
            np.array([link.acceleration + link.linear @ vdot[link.path] for link in links]),
            np.array([link.angular_acceleration + link.angular @ vdot[link.path] for link in links]),
        )


class _WithoutTurning:
    """An engine's equations plus the change that the fault makes in newton_euler's equations."""

    def __init__(self, system: System, hinge: str) -> None:
        self._system = system
        self._right, self._wrong = Relative(system.scene), _Dropped(system.scene, hinge)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._system, name)

    def _own(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Convert an engine's coordinates to newton_euler's."""
        return self._right.coordinates(self._system.state(q, v))

    def mass_and_force(self, q: Array, v: Array) -> tuple[Array, Array]:
        mass, force = self._system.mass_and_force(q, v)
        (_, right), (_, wrong) = (each.mass_and_force(*self._own(q, v)) for each in self._both)
        return mass, force + self._onto(q, v).T @ (wrong - right)

    def acceleration(self, q: Array, v: Array) -> Array:
        right, wrong = (each.acceleration(*self._own(q, v)) for each in self._both)
        change = np.linalg.lstsq(self._onto(q, v), wrong - right)[0]
        return np.asarray(self._system.acceleration(q, v) + change)

    def evaluate(self, q: Array, v: Array) -> Evaluation:
        found = self._system.evaluate(q, v)
        right, wrong = (each.evaluate(*self._own(q, v)) for each in self._both)
        names = ("linear_acceleration", "angular_acceleration", "reaction_force", "reaction_torque")
        changes = {name: getattr(wrong, name) - getattr(right, name) for name in names}
        return replace(found, **{name: getattr(found, name) + changes[name] for name in names})

    @property
    def _both(self) -> tuple[Relative, Relative]:
        return self._right, self._wrong

    def _onto(self, q: Array, v: Array) -> Array:
        """Compute newton_euler's velocities for each of the engine's, (nv, nv)."""
        right = self._right.velocity_transformation(self._own(q, v)[0])
        return np.asarray(np.linalg.lstsq(right, self._system.velocity_transformation(q))[0])
