"""Fault "dropped velocity term": equations of motion without a term of the angular acceleration of one hinge.

A study of crosscheck injects such faults into engines, and measures which ones crosscheck detects. The term
is omega x axis v: omega is the angular velocity (3,) of the hinge's first body, axis the unit vector (3,) of
the hinge, v its rate. A scene cannot have this fault, therefore the fault is injected into the equations of
an engine: the difference between newton_euler's equations with and without the fault is added.
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


def without_velocity_term(system: System, joint: str) -> System:
    """Return an engine's equations without the velocity term of the last hinge of a joint.

    The angular accelerations of the two bodies of a hinge differ by axis dv/dt + omega x axis v, where omega
    is the angular velocity of the first body. The second term is dropped. This changes the accelerations of
    all bodies that the hinge carries.

    Args:
        system: equations of an engine.
        joint: name of a joint whose last elementary motion (hinge, slide or ball) is a hinge. It belongs to
            the spanning tree, whose joints are the coordinates; other joints close loops.
    """
    return cast(System, _WithoutVelocityTerm(system, joint))


class _FaultyRelative(Relative):
    """newton_euler's equations in joint coordinates, with the fault.

    Attributes:
        hinge: name of the joint whose last elementary motion is the hinge at fault.
    """

    def __init__(self, scene: Scene, hinge: str) -> None:
        super().__init__(scene)
        self.hinge = hinge

    def links(self, q: Array, v: Array) -> list[Link]:
        """Return the kinematics of all bodies with accelerations at dv/dt = 0, without the dropped term.

        Args:
            q: coordinates (nq,).
            v: velocities (nv,).
        """
        # The dropped term of the hinge, whose velocity is the last one of its joint. `path` of a body has the
        # indices of the velocities between the ground and the body; the columns of `angular` map these
        # velocities to the angular velocity of the body. `joint.joint` is the index in the mechanism.
        links = list(super().links(q, v))
        (joint,) = (each for each in self.tree.joints if self.tree.joint(each.joint).name == self.hinge)
        hinge_index, child = joint.v.stop - 1, links[joint.child]
        axis_v = child.angular[:, -1] * v[hinge_index]
        term = cross(child.frame.angular_velocity - axis_v, axis_v)
        # A point on the hinge axis, in the current pose. `points` are on the joint's second body; `apart` is
        # their displacement from the points on its first body, which is the child if not `forward`.
        apart = 0.0 if joint.forward else self.tree.joint(joint.joint).point_gap
        arm = self.mechanism.bodies[joint.child].center_of_mass - (joint.points[-1] - apart)
        point = child.frame.position - child.frame.rotation @ arm
        # Remove the term from the accelerations of all bodies that the hinge carries
        for body, link in enumerate(links):
            if hinge_index in link.path:
                links[body] = replace(
                    link,
                    acceleration=link.acceleration - cross(term, link.frame.position - point),
                    angular_acceleration=link.angular_acceleration - term,
                )
        return links

    def body_accelerations(self, q: Array, v: Array, vdot: Array) -> tuple[Array, Array]:
        """Return linear and angular accelerations (b, 3) of the bodies for dv/dt = vdot (nv,)."""
        links = self.links(q, v)
        return (
            np.array([link.acceleration + link.linear @ vdot[link.path] for link in links]),
            np.array([link.angular_acceleration + link.angular @ vdot[link.path] for link in links]),
        )


class _WithoutVelocityTerm:
    """Equations of an engine, plus the change that the fault makes in newton_euler's equations.

    Methods have the arguments and results of `System`, whose other members are those of the engine. The
    arguments q and v are coordinates and velocities of the engine, which may differ from newton_euler's.
    """

    def __init__(self, system: System, hinge: str) -> None:
        self._system = system
        self._right, self._wrong = Relative(system.scene), _FaultyRelative(system.scene, hinge)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._system, name)

    def _relative_coordinates(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Convert coordinates and velocities of the engine to newton_euler's joint coordinates."""
        return self._right.coordinates(self._system.state(q, v))

    def mass_and_force(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return the mass matrix and the force; the change of the force is transformed to the engine's v."""
        mass, force = self._system.mass_and_force(q, v)
        (_, right), (_, wrong) = (
            each.mass_and_force(*self._relative_coordinates(q, v)) for each in self._equations
        )
        return mass, force + self._velocity_map(q, v).T @ (wrong - right)

    def acceleration(self, q: Array, v: Array) -> Array:
        """Return dv/dt of the engine with the fault."""
        right, wrong = (each.acceleration(*self._relative_coordinates(q, v)) for each in self._equations)
        change = np.linalg.lstsq(self._velocity_map(q, v), wrong - right)[0]
        return np.asarray(self._system.acceleration(q, v) + change)

    def evaluate(self, q: Array, v: Array) -> Evaluation:
        """Return accelerations and reactions with the fault."""
        found = self._system.evaluate(q, v)
        right, wrong = (each.evaluate(*self._relative_coordinates(q, v)) for each in self._equations)
        names = ("linear_acceleration", "angular_acceleration", "reaction_force", "reaction_torque")
        changes = {name: getattr(wrong, name) - getattr(right, name) for name in names}
        return replace(found, **{name: getattr(found, name) + changes[name] for name in names})

    @property
    def _equations(self) -> tuple[Relative, Relative]:
        """newton_euler's equations without and with the fault."""
        return self._right, self._wrong

    def _velocity_map(self, q: Array, v: Array) -> Array:
        """Return the matrix (nv, nv) that maps velocities of the engine to newton_euler's velocities."""
        right = self._right.velocity_transformation(self._relative_coordinates(q, v)[0])
        return np.asarray(np.linalg.lstsq(right, self._system.velocity_transformation(q))[0])
