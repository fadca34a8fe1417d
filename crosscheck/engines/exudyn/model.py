"""A scene as a system of Exudyn: rigid bodies with Euler parameters, and joints as algebraic equations.

Facts about Exudyn 1.13 on which this module depends:

- Coordinates of nodes are relative to their reference coordinates; Euler parameters are (w, x, y, z).
- The order of an inertia is (xx, yy, zz, yz, xz, xy), body frame, about the center of mass.
- The ground has its frame at the world's origin.
- A generic joint always has six algebraic equations; that of a free axis is: multiplier = 0.
- The solvers need independent equations: redundant ones must be left out of the model. A joint of which an
  equation is left out is divided into joints of one equation each, see `crosscheck.engines.exudyn.joints`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import count
from typing import Any, NamedTuple

import exudyn as exu
import numpy as np
from exudyn.itemInterface import (
    LoadForceVector,
    LoadMassProportional,
    LoadTorqueVector,
    MarkerBodyMass,
    MarkerBodyRigid,
    MarkerNodeCoordinates,
    MarkerObjectODE2Coordinates,
    Node1D,
    NodePointGround,
    NodeRigidBodyEP,
    ObjectConnectorCoordinateVector,
    ObjectConnectorDistance,
    ObjectGenericODE2,
    ObjectGround,
    ObjectJointGeneric,
    ObjectMass1D,
    ObjectRigidBody,
)

from crosscheck.engines.applied import Motions, coordinate_elements, coordinate_load
from crosscheck.engines.exudyn.connectors import (
    Connector,
    CoordinateForce,
    add_connector,
    add_point_spring,
    add_wrench,
    is_native,
)
from crosscheck.engines.exudyn.coordinates import NODAL, JointCoordinates
from crosscheck.engines.exudyn.couplings import CoordinateEquation, rotor_equations
from crosscheck.engines.exudyn.forces import loaded_bodies
from crosscheck.engines.exudyn.joints import parts, rows
from newton_euler.equations.couplings import couplings
from newton_euler.model.control import ControlLaw, DeclaredLaw
from newton_euler.model.forces import PointSpring, Wrench
from newton_euler.model.joint import Joint, Key
from newton_euler.model.joint_kinds import Rod
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array


class Row(NamedTuple):
    """A constraint equation.

    Attributes:
        joint: number of its joint; None for a coupling, a prescribed motion and a rotor.
        unit: divisor that makes the residual dimensionless: the mechanism's size, m, or 1.
        equation: number of the equation in Exudyn's vector of algebraic equations.
    """

    joint: int | None
    unit: float
    equation: int


@dataclass
class Model:
    """A system of Exudyn.

    Attributes:
        scene: scene with the present forces of sampled controllers and pieces of functions that jump; user
            functions read it.
        angles: hinge angles with full revolutions at a close state, rad, which the caller updates.
        container: `SystemContainer`, which must outlive the system.
        mbs: `MainSystem`.
        nodes: node of each moving body.
        bodies: object of each body, the ground first.
        weights: load of gravity on each moving body.
        objects: objects of each joint, none for a free joint.
        rows: constraint equations that are in the model.
        equations: couplings and prescribed motions, then rotors, as far as they are in the model.
        wrenches: computes the forces and torques (b, 6) on the bodies that Exudyn does not, at the present
            state, N and N m, about the centers of mass, world frame, for a time, s; the owner of the model
            sets it.
        given: computes the forces of laws that use a model of the mechanism, N or N m, by joint coordinate,
            at the present state and a time, s; the owner of the model sets it.
        connectors: connector of each element whose force Exudyn applies, by the element's place in
            `coordinate_elements`.
        native: forces on bodies that Exudyn computes: springs between points, and wrenches.
    """

    scene: Scene
    angles: dict[Key, float] = field(default_factory=dict)
    container: Any = None
    mbs: Any = None
    nodes: list[Any] = field(default_factory=list)
    bodies: list[Any] = field(default_factory=list)
    weights: list[Any] = field(default_factory=list)
    objects: list[list[Any]] = field(default_factory=list)
    rows: list[Row] = field(default_factory=list)
    equations: list[CoordinateEquation] = field(default_factory=list)
    connectors: dict[int, Connector] = field(default_factory=dict)
    native: list[PointSpring | Wrench] = field(default_factory=list)
    wrenches: Callable[[float], Array] | None = None
    given: Callable[[float], Mapping[Key, float]] | None = None

    @property
    def reference(self) -> Array:
        """Reference coordinates (n,) of all nodes: those of the initial pose, and zero for rotors."""
        poses = [
            np.concatenate([body.center_of_mass, body.quaternion]) for body in self.scene.mechanism.bodies[1:]
        ]
        return np.concatenate([np.zeros(0), *poses, np.zeros(len(self.scene.armatures))])


def build(
    scene: Scene,
    left_out: Collection[int] = (),
    shifts: Mapping[str, Array] | None = None,
    divided: bool = False,
) -> Model:
    """Build and assemble the system of a scene without limits.

    Args:
        scene: the scene.
        left_out: numbers of the redundant constraint equations, in the order of `Model.rows` of the divided
            model with all of them.
        shifts: displacement (3,), m, world frame at the initial pose, of the point of a joint in its second
            body, by joint: faults of the model.
        divided: True to divide all joints into joints of one equation each; False to divide only the joints
            of which an equation is left out.
    """
    model = Model(scene)
    model.container = exu.SystemContainer()
    model.mbs = model.container.AddSystem()
    _add_bodies(model)
    # objects and their equations: (object, place of the equation in the object, joint, unit)
    equations: list[tuple[Any, int, int | None, float]] = []
    numbers = count()

    def is_used() -> bool:
        """Return whether the next constraint equation is in the model."""
        return next(numbers) not in left_out

    elements = coordinate_elements(scene)
    for number, joint in enumerate(scene.mechanism.joints):
        shift = (shifts or {}).get(joint.name, np.zeros(3))
        equations += _add_joint(model, number, joint, shift, is_used, divided)
    for place, element in enumerate(elements):
        if is_native(scene, element):
            _add_element(model, place)
        else:
            _add_coordinate_force(model, place)
    equations += _add_coordinate_equations(model, is_used)
    for force in scene.forces:
        if isinstance(force, PointSpring) and force.rest_length > 0.0:  # Exudyn refuses a length of zero
            add_point_spring(model.mbs, scene.mechanism, force, model.bodies)
            model.native.append(force)
        elif isinstance(force, Wrench):
            add_wrench(model.mbs, scene.mechanism, force, model.bodies)
            model.native.append(force)
    _add_loads(model)
    model.mbs.Assemble()
    for item, k, owner, unit in equations:
        equation = int(model.mbs.systemData.GetObjectLTGAE(item)[k])
        model.rows.append(Row(owner, unit, equation))
    return model


def _add_bodies(model: Model) -> None:
    """Add the ground, the bodies with gravity, and the rotors."""
    mbs, scene = model.mbs, model.scene
    model.bodies.append(mbs.AddObject(ObjectGround(referencePosition=[0.0, 0.0, 0.0])))
    for body in scene.mechanism.bodies[1:]:
        reference = np.concatenate([body.center_of_mass, body.quaternion])
        node = mbs.AddNode(NodeRigidBodyEP(referenceCoordinates=reference))
        inertia = [body.inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))]
        item = mbs.AddObject(ObjectRigidBody(mass=body.mass, inertia=inertia, nodeNumber=node))
        marker = mbs.AddMarker(MarkerBodyMass(bodyNumber=item))
        load = LoadMassProportional(markerNumber=marker, loadVector=list(scene.gravity))
        model.weights.append(mbs.AddLoad(load))
        model.nodes.append(node)
        model.bodies.append(item)
    for armature in scene.armatures:
        node = mbs.AddNode(Node1D(referenceCoordinates=[0.0]))
        mbs.AddObject(ObjectMass1D(physicsMass=armature.inertia, nodeNumber=node))
        model.nodes.append(node)


def _markers(model: Model, joint: Joint, axes: Array, shift: Array) -> list[Any]:
    """Add the markers of a joint on its two bodies.

    Args:
        model: the model.
        joint: the joint.
        axes: (3, 3) axes of the markers, in columns, world frame at the initial pose.
        shift: (3,) displacement of the point in the second body, m.
    """
    mechanism, markers = model.scene.mechanism, []
    for name, point in ((joint.first, joint.point), (joint.second, joint.point_on_second + shift)):
        index, transform = mechanism.body_index(name), np.eye(4)
        pose = mechanism.bodies[index].pose
        transform[:3, :3] = pose.rotation.T @ axes if index else axes
        transform[:3, 3] = pose.point_to_body(point) if index else point
        item = MarkerBodyRigid(bodyNumber=model.bodies[index], localHT=transform)
        markers.append(model.mbs.AddMarker(item))
    return markers


def _add_joint(
    model: Model, number: int, joint: Joint, shift: Array, is_used: Callable[[], bool], divided: bool
) -> list[tuple[Any, int, int | None, float]]:
    """Add a joint, and return its equations: object, place in the object, number of the joint, unit."""
    mbs, size = model.mbs, model.scene.mechanism.size
    model.objects.append([])
    if isinstance(joint, Rod):
        if not is_used():
            return []
        markers = _markers(model, joint, np.eye(3), shift)
        item = mbs.AddObject(ObjectConnectorDistance(markerNumbers=markers, distance=joint.length))
        model.objects[-1].append(item)
        return [(item, 0, number, size)]
    found: list[tuple[Any, int, int | None, float]] = []
    for whole in parts(joint):
        single = rows(whole)
        used = [row for row in single if is_used()]
        for part in used if divided or len(used) < len(single) else [whole]:
            markers = _markers(model, joint, part.axes, shift)
            item = mbs.AddObject(ObjectJointGeneric(markerNumbers=markers, constrainedAxes=part.flags))
            model.objects[-1].append(item)
            found += [(item, k, number, size if k < 3 else 1.0) for k, flag in enumerate(part.flags) if flag]
    return found


def _add_element(model: Model, place: int) -> None:
    """Add the connector of the element at a place in `coordinate_elements`."""
    mechanism = model.scene.mechanism
    element = coordinate_elements(model.scene)[place]
    (key,) = element.keys
    joint = mechanism.joint(key[0])
    (part,) = parts(joint)

    def force(x: float, rate: float, time: float) -> float:
        present = coordinate_elements(model.scene)[place]
        return coordinate_load(present, {key: (x, rate)}, time, {}).forces[0]

    markers = _markers(model, joint, part.axes, np.zeros(3))
    model.connectors[place] = add_connector(model.mbs, mechanism, element, markers, force)


def _add_coordinate_force(model: Model, place: int) -> None:
    """Add the forces of the element at a place in `coordinate_elements` on the coordinates of bodies."""
    element = coordinate_elements(model.scene)[place]
    reads = element.reads if isinstance(element, ControlLaw) else ()
    coordinates = JointCoordinates(model.scene.mechanism, (*element.keys, *reads), model.angles)

    def load(motions: Motions, time: float) -> dict[Key, float]:
        present = coordinate_elements(model.scene)[place]
        uses_model = isinstance(present, DeclaredLaw) and present.uses_model
        given = model.given(time) if uses_model and model.given is not None else {}
        return dict(zip(present.keys, coordinate_load(present, motions, time, given).forces, strict=True))

    chosen = [NODAL * (body - 1) + k for body in coordinates.bodies for k in range(NODAL)]
    force = CoordinateForce(coordinates, model.reference[chosen], load)
    item = ObjectGenericODE2(
        nodeNumbers=[model.nodes[body - 1] for body in coordinates.bodies],
        massMatrix=np.zeros((coordinates.size,) * 2),
        forceUserFunction=force.force,
        jacobianUserFunction=force.jacobian,
    )
    model.mbs.AddObject(item)


def _add_coordinate_equations(
    model: Model, is_used: Callable[[], bool]
) -> list[tuple[Any, int, int | None, float]]:
    """Add couplings, prescribed motions and rotors, and return their equations, see `_add_joint`."""
    mbs, mechanism = model.mbs, model.scene.mechanism
    moving = len(mechanism.bodies) - 1
    rotors = rotor_equations(model.scene.armatures, mechanism)
    found: list[tuple[Any, int, int | None, float]] = []
    for number, coupling in enumerate((*couplings(model.scene), *rotors)):
        if not is_used():
            continue
        rotor = number - len(couplings(model.scene))
        equation = CoordinateEquation(coupling, mechanism, model.angles, rotor=rotor >= 0)
        nodes = [model.nodes[body - 1] for body in equation.coordinates.bodies]
        size = equation.coordinates.size
        collected = mbs.AddObject(ObjectGenericODE2(nodeNumbers=nodes, massMatrix=np.zeros((size, size))))
        other = model.nodes[moving + rotor] if rotor >= 0 else mbs.AddNode(NodePointGround())
        markers = [
            mbs.AddMarker(MarkerObjectODE2Coordinates(objectNumber=collected)),
            mbs.AddMarker(MarkerNodeCoordinates(nodeNumber=other)),
        ]
        item = ObjectConnectorCoordinateVector(
            markerNumbers=markers,
            scalingMarker0=np.zeros((1, size)),  # their number of rows is the number of equations
            scalingMarker1=np.zeros((1, 1 if rotor >= 0 else 3)),
            constraintUserFunction=equation.phi,
            jacobianUserFunction=equation.jacobian,
        )
        found.append((mbs.AddObject(item), 0, None, mechanism.size if coupling.is_length else 1.0))
        model.equations.append(equation)
    return found


def _add_loads(model: Model) -> None:
    """Add loads on the bodies whose forces and torques Python computes."""
    mechanism, loaded = model.scene.mechanism, set[int]()
    for force in model.scene.body_forces:
        if not any(force is each for each in model.native):
            loaded |= loaded_bodies(mechanism, force)

    def load(body: int, part: slice, _mbs: Any, time: float, _load: Any) -> Array:
        assert model.wrenches is not None
        return model.wrenches(time)[body, part]

    for k in sorted(loaded - {0}):
        item = MarkerBodyRigid(bodyNumber=model.bodies[k], localPosition=[0.0, 0.0, 0.0])
        marker = model.mbs.AddMarker(item)
        on_force, on_torque = partial(load, k, slice(0, 3)), partial(load, k, slice(3, 6))
        model.mbs.AddLoad(LoadForceVector(markerNumber=marker, loadVectorUserFunction=on_force))
        model.mbs.AddLoad(LoadTorqueVector(markerNumber=marker, loadVectorUserFunction=on_torque))
