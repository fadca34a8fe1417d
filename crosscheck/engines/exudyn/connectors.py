"""Forces of a scene as connectors of Exudyn: springs, dampers and laws on hinges, slides and between points.

Exudyn measures the rotation or displacement of a connector, and applies its force to both bodies. Springs
and PD laws with constant numbers have constant parameters of Exudyn's own law. For other laws, frictions and
stops, a user function returns the force for the rotation and the rate that Exudyn passes. Exudyn
differentiates such functions numerically, so that its Newton iteration knows their stiffness.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from exudyn.itemInterface import (
    MarkerBodyRigid,
    NodeGenericData,
    ObjectConnectorLinearSpringDamper,
    ObjectConnectorSpringDamper,
    ObjectConnectorTorsionalSpringDamper,
)

from crosscheck.engines.exudyn.forces import CoordinateElement
from newton_euler.equations.load_friction import loaded_frictions
from newton_euler.model.control import PD, StateFeedback
from newton_euler.model.digital_control import HeldLaw
from newton_euler.model.forces import JointSpring, PointSpring
from newton_euler.model.joint import AxisJoint, Key
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.switched_forces import JointFriction, JointStop

HINGES = frozenset({"revolute", "cylindrical", "screw", "planar"})
"""Kinds of joints whose hinge turns about z of both markers, so that a torsional spring measures it."""

SLIDES = frozenset({"prismatic", "translational", "cylindrical", "screw"})
"""Kinds of joints whose points stay on the axis of the slide. Forces along the axis at either point are then
the same, as are Exudyn's, which act at the points of both markers."""

Force = Callable[[float, float, float], float]
"""Function of a joint coordinate, m or rad, its rate and the time, s, that returns a force, N or N m."""


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
