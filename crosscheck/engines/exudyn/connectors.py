"""Forces of a scene as connectors of Exudyn: springs, dampers and laws on hinges, slides and between points.

Exudyn measures the rotation or displacement of a connector, and applies its force to both bodies. Springs
and PD laws with constant numbers have constant parameters of Exudyn's own law. For other laws, frictions and
stops, a user function returns the force for the rotation and the rate that Exudyn passes. Exudyn
differentiates such functions numerically, so that its Newton iteration knows their stiffness.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from exudyn.itemInterface import (
    LoadForceVector,
    LoadTorqueVector,
    MarkerBodyRigid,
    NodeGenericData,
    ObjectConnectorLinearSpringDamper,
    ObjectConnectorSpringDamper,
    ObjectConnectorTorsionalSpringDamper,
)

from crosscheck.engines.applied import CoordinateElement, Motions
from crosscheck.engines.exudyn.coordinates import JointCoordinates
from newton_euler.equations.load_friction import loaded_frictions
from newton_euler.model.control import PD, StateFeedback
from newton_euler.model.digital_control import HeldLaw
from newton_euler.model.forces import JointSpring, PointSpring, Wrench
from newton_euler.model.joint import AxisJoint, Key
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.switched_forces import JointFriction, JointStop
from newton_euler.scalars import Array

HINGES = frozenset({"revolute", "cylindrical", "screw", "planar"})
"""Kinds of joints whose hinge turns about z of both markers, so that a torsional spring measures it."""

SLIDES = frozenset({"prismatic", "translational", "cylindrical", "screw"})
"""Kinds of joints whose points stay on the axis of the slide. Forces along the axis at either point are then
the same, as are Exudyn's, which act at the points of both markers."""

Force = Callable[[float, float, float], float]
"""Function of a joint coordinate, m or rad, its rate and the time, s, that returns a force, N or N m."""


Load = Callable[[Motions, float], Mapping[Key, float]]
"""Function of joint coordinates with their rates and of time, s, that returns forces, N or N m, by key."""

DIFFERENCE = 1e-6
"""Step of difference quotients of forces, m, rad or their rates, for a Newton iteration."""


class Connector(NamedTuple):
    """Connector on a joint coordinate.

    Attributes:
        key: the joint coordinate.
        number: number of the object in Exudyn.
        node: node whose coordinate is the rotation with full revolutions; None for a slide.
    """

    key: Key
    number: Any
    node: Any


def is_native(scene: Scene, element: CoordinateElement) -> bool:
    """Return True for an element on one coordinate that a connector of Exudyn measures."""
    if isinstance(element, StateFeedback) or len(element.keys) != 1:
        return False
    if isinstance(element, JointFriction) and element in loaded_frictions(scene):
        return False
    if not isinstance(element, PD | HeldLaw | JointSpring | JointFriction | JointStop):
        return False
    if isinstance(element, PD) and element.uses_model:
        return False
    ((joint, coordinate),) = element.keys
    kinds = SLIDES if scene.mechanism.is_slide(joint, coordinate) else HINGES
    return scene.mechanism.joint(joint).kind in kinds


def add_connector(
    mbs: Any, mechanism: Mechanism, element: CoordinateElement, markers: Sequence[Any], force: Force
) -> Connector:
    """Add the connector of an element, for which `is_native` is True.

    Args:
        mbs: Exudyn's system.
        mechanism: mechanism with the joint.
        element: the element.
        markers: markers of the joint on its first and its second body, with the axis as z.
        force: computes the force of an element without constant numbers.
    """
    (key,) = element.keys
    joint = mechanism.joint(key[0])
    assert isinstance(joint, AxisJoint)
    # the displacement of the markers is that of the joint's points, which is not zero at the initial pose
    zero = float(joint.axis @ joint.span) if mechanism.is_slide(*key) else 0.0
    numbers = _constant_numbers(element, zero)

    def opposed(_mbs: Any, time: float, _item: int, x: float, rate: float, *_parameters: float) -> float:
        """Return the force that Exudyn subtracts."""
        return -force(x - zero, rate, time)

    if mechanism.is_slide(*key):
        if numbers is None:
            numbers = {"springForceUserFunction": opposed}
        else:
            numbers["force"] = numbers.pop("constant")
        item = ObjectConnectorLinearSpringDamper(
            markerNumbers=[*markers], axisMarker0=[0.0, 0.0, 1.0], **numbers
        )
        return Connector(key, mbs.AddObject(item), None)
    if numbers is None:
        numbers = {"springTorqueUserFunction": opposed}
    else:
        numbers["torque"] = numbers.pop("constant")
    node = mbs.AddNode(NodeGenericData(numberOfDataCoordinates=1, initialCoordinates=[0.0]))
    item = ObjectConnectorTorsionalSpringDamper(markerNumbers=[*markers], nodeNumber=node, **numbers)
    return Connector(key, mbs.AddObject(item), node)


def _constant_numbers(element: CoordinateElement, zero: float) -> dict[str, Any] | None:
    """Return the parameters of Exudyn's own law for an element, K (x - x0) + D dx/dt + constant; else None.

    Args:
        element: the element.
        zero: displacement of the markers at which the joint coordinate is zero.
    """
    if isinstance(element, JointSpring):
        rest, constant = element.rest, 0.0
    elif isinstance(element, PD) and not element.depends_on_time:
        rest, constant = float(element.references(0.0)[element.key].value), float(element.feedforward_at(0.0))
    else:
        return None
    return {
        "stiffness": element.stiffness,
        "damping": element.damping,
        "offset": zero + rest,
        "constant": -constant,
    }


def add_point_spring(mbs: Any, mechanism: Mechanism, spring: PointSpring, bodies: Sequence[Any]) -> None:
    """Add Exudyn's spring and damper between points of two bodies; the rest length must not be zero.

    Args:
        mbs: Exudyn's system.
        mechanism: mechanism with the bodies.
        spring: the spring.
        bodies: object of each body in Exudyn, the ground first.
    """
    markers = []
    for name, point in ((spring.first, spring.point_on_first), (spring.second, spring.point_on_second)):
        index = mechanism.body_index(name)
        # Exudyn's ground has its frame at the world's origin
        arm = mechanism.bodies[index].pose.point_to_body(point) if index else point
        markers.append(mbs.AddMarker(MarkerBodyRigid(bodyNumber=bodies[index], localPosition=arm)))
    item = ObjectConnectorSpringDamper(
        markerNumbers=markers,
        referenceLength=spring.rest_length,
        stiffness=spring.stiffness,
        damping=spring.damping,
    )
    mbs.AddObject(item)


def add_wrench(mbs: Any, mechanism: Mechanism, wrench: Wrench, bodies: Sequence[Any]) -> None:
    """Add a force and a torque of constant components, in the world or in the body.

    Args:
        mbs, mechanism, bodies: see `add_point_spring`.
        wrench: force and torque.
    """
    index = mechanism.body_index(wrench.body)
    pose = mechanism.bodies[index].pose
    in_body = wrench.frame == "body"
    # components in the body frame, which is turned against the world at the initial pose
    to_frame = pose.rotation.T if in_body else np.eye(3)
    item = MarkerBodyRigid(bodyNumber=bodies[index], localPosition=pose.point_to_body(wrench.point))
    marker = mbs.AddMarker(item)
    for load, vector in ((LoadForceVector, wrench.force), (LoadTorqueVector, wrench.torque)):
        mbs.AddLoad(load(markerNumber=marker, loadVector=to_frame @ vector, bodyFixed=in_body))


class CoordinateForce:
    """Forces along joint coordinates that no connector of Exudyn measures, such as those of an elastic gear.

    An `ObjectGenericODE2` without mass has the coordinates of all bodies on which the forces depend. Its user
    functions are `force` and `jacobian`.
    """

    def __init__(self, coordinates: JointCoordinates, reference: Array, load: Load) -> None:
        """Prepare the forces.

        Args:
            coordinates: joint coordinates on which the forces act or depend.
            reference: reference coordinates of the bodies of `coordinates`.
            load: computes the forces.
        """
        self._coordinates, self._reference, self._load = coordinates, reference, load

    def _state(self, q: Array, rates: Array) -> tuple[dict[Key, tuple[float, float]], dict[Key, Array]]:
        """Return the joint coordinates with their rates, and their derivatives by the coordinates of bodies.

        Args:
            q: coordinates of the bodies, relative to the reference.
            rates: rates of q.
        """
        q = self._reference + np.asarray(q)
        frames = self._coordinates.frames(q)
        rows = self._coordinates.rows(q, frames)
        x = self._coordinates.x(frames)
        return {key: (x[key], float(row @ np.asarray(rates))) for key, row in rows.items()}, rows

    def force(self, _mbs: Any, time: float, _item: int, q: Array, rates: Array) -> Array:
        """Return the forces on the coordinates of the bodies."""
        motions, rows = self._state(q, rates)
        loads = self._load(motions, time)
        return np.asarray(sum(force * rows[key] for key, force in loads.items()))

    def jacobian(
        self, _mbs: Any, time: float, _item: int, q: Array, rates: Array, by_q: float, by_rates: float
    ) -> Array:
        """Return minus the derivative of `force` for a Newton iteration, without that of the directions.

        Args:
            time: s.
            q, rates: see `force`.
            by_q, by_rates: factors of the derivatives by q and by its rates.
        """
        motions, rows = self._state(q, rates)
        loads, found = self._load(motions, time), np.zeros((len(self._reference),) * 2)
        for key, (x, rate) in motions.items():
            for factor, moved in ((by_q, (x + DIFFERENCE, rate)), (by_rates, (x, rate + DIFFERENCE))):
                for other, force in self._load({**motions, key: moved}, time).items():
                    slope = factor * (force - loads[other]) / DIFFERENCE
                    found -= slope * np.outer(rows[other], rows[key])
        return found
