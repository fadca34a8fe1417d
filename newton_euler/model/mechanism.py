"""Body and Mechanism: the description of a multibody system from which every engine's model is built.

Points and axes are given in the world frame at one pose of the mechanism, the initial pose; inertia tensors
in the frame of their body. The frame of a body has its origin at the center of mass and the orientation
`Body.quaternion`. The constructor of `Mechanism` checks names, inertias and connections, and that the
constraint equations of all joints are satisfied at the initial pose.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any, ClassVar, Self, get_args

import numpy as np

from newton_euler.errors import (
    MechanismError,
    check_choice,
    check_flag,
    check_key,
    elements_of,
    is_finite_number,
    listed,
    quoted,
    set_finite_arrays,
)
from newton_euler.model.constraints import Frame
from newton_euler.model.couplings import JointCoupling
from newton_euler.model.description import ArrayField, description
from newton_euler.model.euler_parameters import rotation
from newton_euler.model.fields import NumberField
from newton_euler.model.geometry import UNIT_TOLERANCE, Capsule, Mesh, Shape, Solid, total_inertia
from newton_euler.model.joint import Joint, JointEquations, Key, Pose
from newton_euler.model.variable import Change, Variable
from newton_euler.scalars import Array, Scalar, sqrt

CLOSURE_TOLERANCE = 1e-9
"""Largest constraint violation of a joint at the initial pose, m or rad: round-off of the numbers of a
description."""

MIN_INERTIA = 1e-150
"""Smallest mass, kg, and principal moment of inertia, kg m^2; products of smaller numbers with squares of
lengths would lose digits to underflow."""

REALISABLE_TOLERANCE = 1e-12
"""Relative tolerance of the triangle inequality A + B >= C of principal moments: round-off of eigenvalues."""

APPEARANCE = "what bodies look like, and moves nothing"
"""Reason, for error messages, why shapes and meshes cannot vary from run to run."""

_NAME_PATTERN = re.compile(r"[A-Za-z0-9_.\-]+")


def characteristic_length(points: Sequence[Array]) -> float:
    """Compute the size of a set of points (3,), m: their largest distance from their mean; 1 if all
    coincide."""
    largest = float(np.max(np.linalg.norm(np.array(points) - np.mean(points, axis=0), axis=1)))
    return largest if largest > 0.0 else 1.0


def check_name(what: str, name: object) -> None:
    """Raise `MechanismError` for a name that files and reports cannot use; `what` is the kind of the named
    element."""
    if not isinstance(name, str) or not _NAME_PATTERN.fullmatch(name):
        raise MechanismError(
            f"{what} {quoted(name)}", "has an unusable name", "letters, digits, _, . and - only"
        )


def check_coordinate(element: str, joint: Joint, coordinate: int) -> None:
    """Raise `MechanismError` unless a joint has a coordinate (hinge or slide) of this index.

    Args:
        element: name of the element that acts on the coordinate, for the message.
        joint: the joint.
        coordinate: index of the coordinate, from 0.
    """
    count = len(joint.coordinate_kinds)
    if not 0 <= coordinate < count:
        needed = f"an index below {count}" if count else "a joint with a hinge or a slide"
        raise MechanismError(element, f"coordinate is {quoted(coordinate)}", needed)


@description  # makes a frozen dataclass
class Body(Variable):
    """A rigid body.

    Attributes:
        name: unique in its mechanism; letters, digits, `_`, `.` and `-`.
        mass: kg.
        center_of_mass: (3,) m, world at the initial pose.
        inertia: (3, 3) inertia tensor about the center of mass, kg m^2, body frame.
        quaternion: (4,) orientation of the body frame at the initial pose, (w, x, y, z).
        shapes: boxes, capsules, cylinders and spheres that viewers draw and model files contain, in the world
            frame at the initial pose; if empty, bars from the center of mass to the joints. They do not
            change mass and inertia, see `Body.solid`.
        allow_unrealisable_inertia: True accepts principal moments with A + B < C, which no mass distribution
            has. A published table with such values can then be simulated as printed.
        meshes: detailed surfaces for viewers; exported model files contain the shapes instead.

    Examples:
        >>> rod = Body("rod", 1.0, [0.5, 0.0, 0.0], np.diag([0.001, 0.1, 0.1]))
        >>> rod.mass
        1.0
    """

    name: str
    mass: float
    center_of_mass: ArrayField
    inertia: ArrayField
    quaternion: ArrayField = (1.0, 0.0, 0.0, 0.0)  # type: ignore[assignment]
    shapes: tuple[Shape, ...] = ()
    allow_unrealisable_inertia: bool = False
    meshes: tuple[Mesh, ...] = ()

    # Attributes that may vary from run to run, as in parameter studies. `allowed`: rule for their values.
    # `moves_loops`: a change moves the poses in which loops are closed. `constant`: reasons why other
    # attributes cannot vary
    number_fields: ClassVar = {
        "mass": NumberField("kg"),
        "center_of_mass": NumberField("m", shape=(3,), moves_loops=True),
        "inertia": NumberField("kg m^2", shape=(3, 3), allowed="inertia"),
        "quaternion": NumberField(shape=(4,), allowed="direction", moves_loops=True),
    }
    constant: ClassVar = {"shapes": APPEARANCE, "meshes": APPEARANCE}

    def __post_init__(self) -> None:
        check_name("body", self.name)
        where = f"body {quoted(self.name)}"
        set_finite_arrays(self, where, mass=(), center_of_mass=(3,), inertia=(3, 3), quaternion=(4,))
        check_flag(where, self, "allow_unrealisable_inertia")
        for field, kinds in (("shapes", get_args(Shape)), ("meshes", (Mesh,))):
            object.__setattr__(self, field, elements_of(where, field, getattr(self, field), *kinds))

    @classmethod
    def ground(
        cls, name: str = "ground", shapes: tuple[Shape, ...] = (), meshes: tuple[Mesh, ...] = ()
    ) -> Body:
        """Return the fixed body of a mechanism, whose frame is the world frame; its mass has no effect.

        Args:
            name: name of the body.
            shapes, meshes: appearance in viewers, world frame.
        """
        return cls(name, 0.0, np.zeros(3), np.zeros((3, 3)), shapes=shapes, meshes=meshes)

    @classmethod
    def solid(
        cls, name: str, *solids: Solid, density: float | None = None, mass: float | None = None
    ) -> Body:
        """Return a body that consists of homogeneous solids, which are also its appearance.

        A region where solids overlap counts once for each of them. The body frame is parallel to the world at
        the initial pose.

        Args:
            name: name of the body.
            solids: boxes, spheres, cylinders, capsules and closed meshes, world frame at the initial pose.
            density: density of all solids, kg/m^3; give either density or mass.
            mass: mass of all solids together, kg, which have the same density.

        Raises:
            MechanismError: naming the body and the invalid shape or value.

        Examples:
            >>> link = Cylinder([0.0, 0.0, 0.0], [0.5, 0.0, 0.0], radius=0.01)
            >>> pendulum = Body.solid("pendulum", link, Sphere([0.5, 0.0, 0.0], 0.05), density=7800.0)
            >>> print(f"{pendulum.mass:.3f} kg at {pendulum.center_of_mass[0]:.3f} m")
            5.309 kg at 0.442 m
        """
        where = f"body {quoted(name)}"
        if (density is None) == (mass is None):
            given = "no density and no mass" if mass is None else "a density and a mass"
            raise MechanismError(where, f"is given {given}", "one of them")
        if mass is not None and (not is_finite_number(mass) or mass <= 0.0):
            raise MechanismError(where, f"mass is {quoted(mass)}", "a positive number of kg")
        solids = elements_of(where, "solids", solids, *get_args(Solid))
        if not solids:
            raise MechanismError(where, "has no solids", "one or more")
        try:
            properties = total_inertia(
                [solid.inertia(1.0 if density is None else density) for solid in solids]
            )
            properties = properties if mass is None else properties.scaled(mass / properties.mass)
        except MechanismError as error:
            raise MechanismError(f"{where}: {error.element}", error.problem, error.needed) from error
        return cls(
            name,
            properties.mass,
            properties.center_of_mass,
            properties.inertia,
            shapes=tuple(solid for solid in solids if not isinstance(solid, Mesh)),
            meshes=tuple(solid for solid in solids if isinstance(solid, Mesh)),
        )

    def check(self) -> None:
        """Raise `MechanismError` unless mass and inertia are those of a rigid body: positive, symmetric,
        realisable."""
        where = f"body {quoted(self.name)}"
        if self.mass < MIN_INERTIA:
            needed = f"a positive mass, {MIN_INERTIA:g} kg or more"
            raise MechanismError(where, f"mass is {self.mass:g} kg", needed)
        scale = float(np.max(np.abs(self.inertia)))
        asymmetry = float(np.max(np.abs(self.inertia - self.inertia.T)))
        if asymmetry > 1e-12 * scale:
            raise MechanismError(
                where, f"inertia differs from its transpose by {asymmetry:.3g} kg m^2", "a symmetric inertia"
            )
        a, b, c = (float(x) for x in np.linalg.eigvalsh(self.inertia))
        moments = f"principal moments are {a:.6g}, {b:.6g}, {c:.6g} kg m^2"
        if a < MIN_INERTIA:
            needed = f"a positive definite inertia, of {MIN_INERTIA:g} kg m^2 or more"
            raise MechanismError(where, moments, needed)
        if a + b < c * (1.0 - REALISABLE_TOLERANCE) and not self.allow_unrealisable_inertia:
            raise MechanismError(
                where, moments, "a realisable inertia, the two smaller adding up to the largest at least"
            )

    def fields_with(self, values: Mapping[str, Any], change: Change) -> dict[str, Any]:
        """Return the new values of the attributes that vary, with a unit quaternion.

        Args:
            values: new values by attribute name; the quaternion may have any nonzero length.
            change: function that copies an object with other values of some of its fields.
        """
        fields = super().fields_with(values, change)
        if "quaternion" in fields:
            p = np.asarray(fields["quaternion"])
            if p.dtype != object and not np.any(p):  # dtype object: symbols of the code generator
                raise MechanismError(f"body {quoted(self.name)}", "quaternion is zero", "one that is not")
            fields["quaternion"] = p / sqrt(p @ p)
        return fields

    def rebuilt(self, values: Mapping[str, Any]) -> Self:
        """Construct the body again with other values of some attributes; raises `MechanismError` as
        `check`."""
        rebuilt = super().rebuilt(values)
        rebuilt.check()
        return rebuilt

    @property
    def pose(self) -> Pose:
        """The body frame at the initial pose: its origin, m, and its rotation matrix to the world frame."""
        return Pose(self.center_of_mass, rotation(self.quaternion))


class Mechanism:
    """Bodies, the joints between them, and couplings of joint coordinates; checked on construction and then
    immutable.

    Attributes:
        bodies: `bodies[0]` is the ground, which never moves.
        joints: joints in the order of constraint equations and reactions.
        couplings: gears and other equations between joint coordinates.

    Raises:
        MechanismError: naming the body, joint or coupling that is invalid.

    Examples:
        >>> rod = Body("rod", 1.0, [0.5, 0.0, 0.0], np.diag([0.001, 0.1, 0.1]))
        >>> hinge = Revolute("hinge", "ground", "rod", [0.0, 0.0, 0.0], axis=[0.0, 1.0, 0.0])
        >>> Mechanism([Body.ground(), rod], [hinge])
        <Mechanism: bodies: 2; joints: 1 revolute; couplings: 0>
    """

    DEFINED_BY = ("bodies", "joints", "couplings")
    """Names of the attributes that define a mechanism; everything else follows from them."""

    @np.errstate(all="ignore")  # numbers that overflow are refused
    def __init__(
        self, bodies: Iterable[Body], joints: Iterable[Joint], couplings: Iterable[JointCoupling] = ()
    ) -> None:
        self.bodies = elements_of("mechanism", "bodies", bodies, Body)
        self.joints = elements_of("mechanism", "joints", joints, Joint)
        self.couplings = elements_of("mechanism", "couplings", couplings, JointCoupling)
        if len(self.bodies) < 2:
            raise MechanismError(
                "mechanism", f"has {len(self.bodies)} bodies", "the ground and at least one more"
            )

        # Names are valid and unique
        for joint in self.joints:
            check_name("joint", joint.name)
        for coupling in self.couplings:
            check_name(coupling.kind, coupling.name)
        for what, named in (("body", self.bodies), ("joint", self.joints)):
            for name, count in Counter(element.name for element in named).items():
                if count > 1:
                    raise MechanismError(f"{what} {quoted(name)}", f"{count} of that name", "unique names")

        # Bodies have unit quaternions, and moving bodies valid inertias; joints and couplings are valid
        for body in self.bodies:
            norm = float(np.linalg.norm(body.quaternion))
            if abs(norm - 1.0) > UNIT_TOLERANCE:
                raise MechanismError(
                    f"body {quoted(body.name)}",
                    f"quaternion has norm {norm:.9g}",
                    "a unit quaternion, w-x-y-z",
                )
        for body in self.bodies[1:]:
            body.check()
        self._check_joints()
        self._check_labels()
        self._check_couplings()

    def __setattr__(self, name: str, value: object) -> None:
        """Allow an attribute to be set only once, because cached results depend on the attributes."""
        if name in self.__dict__:
            raise AttributeError(f"{name} of a mechanism cannot be changed; make another mechanism")
        super().__setattr__(name, value)

    def __repr__(self) -> str:
        kinds = Counter(joint.kind for joint in self.joints)
        joints = ", ".join(f"{count} {kind}" for kind, count in kinds.items())
        return f"<Mechanism: bodies: {len(self.bodies)}; joints: {joints}; couplings: {len(self.couplings)}>"

    def _check_joints(self) -> None:
        """Raise `MechanismError` for joints to unknown bodies, unconnected bodies, and joints whose
        constraints the initial pose violates."""
        for joint in self.joints:
            where = f"joint {quoted(joint.name)}"
            for body in (joint.first, joint.second):
                if not isinstance(body, str) or body not in self._body_indices:
                    raise MechanismError(
                        where,
                        f"connects an unknown body {quoted(body)}",
                        f"one of {listed(self.body_names)}",
                    )
            if joint.first == joint.second:
                raise MechanismError(where, f"connects {quoted(joint.first)} to itself", "two bodies")
        self._check_connected()
        still = np.zeros(3)
        frames = [
            Frame(body.center_of_mass, rotation(body.quaternion), velocity=still, angular_velocity=still)
            for body in self.bodies
        ]
        self.check_closed(frames, "at the initial pose")

    def _check_labels(self) -> None:
        """Raise `MechanismError` for a joint whose name is also the label of a coordinate of another
        joint."""
        names = {joint.name for joint in self.joints}
        for (joint, k), label in self.coordinate_labels.items():
            if label != joint and label in names:
                problem = f"has the name of coordinate {k} of joint {quoted(joint)}"
                raise MechanismError(f"joint {quoted(label)}", problem, "another name")

    def _check_couplings(self) -> None:
        """Raise `MechanismError` for couplings with repeated names, or on unknown joint coordinates."""
        names = Counter([*self.joint_names, *(coupling.name for coupling in self.couplings)])
        for coupling in self.couplings:
            where = f"{coupling.kind} {quoted(coupling.name)}"
            if names[coupling.name] > 1:
                raise MechanismError(where, f"{names[coupling.name]} of that name", "unique names")
            for joint, coordinate in coupling.factors():  # keys: the coupled joint coordinates
                on_joint = f"{where} on joint {quoted(joint)}"
                check_coordinate(on_joint, self.joint(joint), coordinate)

    def _check_connected(self) -> None:
        """Raise `MechanismError` for a body that no chain of joints connects to the ground."""
        reached, to_visit = {0}, [0]
        while to_visit:
            joints = [self.joints[k] for k in self.joints_at[to_visit.pop()]]
            neighbors = {self.body_index(name) for joint in joints for name in (joint.first, joint.second)}
            to_visit.extend(neighbors - reached)
            reached |= neighbors
        for index, name in enumerate(self.body_names):
            if index not in reached:
                raise MechanismError(
                    f"body {quoted(name)}",
                    "no joint leads to it from the ground",
                    "a joint, `free` if it floats",
                )

    def check_closed(self, frames: list[Frame], when: str) -> None:
        """Raise `MechanismError` for the first joint whose constraint violation exceeds `CLOSURE_TOLERANCE`.

        Args:
            frames: frames (pose and velocity) of all bodies, ground first.
            when: description of the pose for the message, such as "at the initial pose".
        """
        for equations in self.equations:
            # residuals of the joint's constraint equations, m or rad, which vanish if the joint is closed
            phi = equations.phi(frames[equations.first], frames[equations.second])
            gap = float(np.max(np.abs(phi), initial=0.0))
            if not gap <= CLOSURE_TOLERANCE:  # true also for NaN, which follows from numbers that overflow
                unit = "m" if equations.is_length[int(np.argmax(np.abs(phi)))] else "rad"
                raise MechanismError(
                    f"joint {quoted(equations.joint.name)}",
                    f"is open by {gap:.3g} {unit} {when}",
                    f"a closed loop, to {CLOSURE_TOLERANCE:g}",
                )

    @cached_property
    def body_names(self) -> tuple[str, ...]:
        """Names of all bodies, ground first."""
        return tuple(body.name for body in self.bodies)

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of all joints, in order."""
        return tuple(joint.name for joint in self.joints)

    @cached_property
    def size(self) -> float:
        """Characteristic length, m: largest distance of joint points and centers of mass from their mean."""
        return characteristic_length(
            [*(body.center_of_mass for body in self.bodies[1:]), *(j.point for j in self.joints)]
        )

    @cached_property
    def extents(self) -> tuple[float, ...]:
        """Extent of each body from its center of mass, m, ground first; that of the ground is 0.

        The extent is the largest distance to a joint with constraint equations, or the root mean square
        distance of the body's mass from the center of mass if that is larger. Unlike `size`, it does not
        depend on where floating bodies are.
        """
        # the integral of r^2 over the mass is half the trace of the inertia tensor
        lengths = [float(np.sqrt(0.5 * np.trace(body.inertia) / body.mass)) for body in self.bodies[1:]]
        lengths.insert(0, 0.0)
        for equations in self.equations:
            # the joint point fixed in the first body, and the one fixed in the second body
            ends = (
                (equations.first, equations.joint.point),
                (equations.second, equations.joint.point_on_second),
            )
            for index, point in ends:
                if index > 0 and equations.count > 0:
                    distance = float(np.linalg.norm(point - self.bodies[index].center_of_mass))
                    lengths[index] = max(lengths[index], distance)
        return tuple(lengths)

    @property
    def largest_extent(self) -> float:
        """Largest extent of a body from its center of mass, m, see `extents`."""
        return max(self.extents)

    @cached_property
    def connected_bodies(self) -> tuple[tuple[int, ...], ...]:
        """Groups of bodies, by their indices, that joints with constraint equations connect without the
        ground."""
        group_of = list(range(len(self.bodies)))  # number of the group of each body
        for each in self.equations:
            if each.first and each.second and each.count:
                merged, kept = group_of[each.second], group_of[each.first]
                group_of = [kept if group == merged else group for group in group_of]
        groups: dict[int, list[int]] = {}
        for body, group in enumerate(group_of):
            if body:
                groups.setdefault(group, []).append(body)
        return tuple(tuple(bodies) for bodies in groups.values())

    @cached_property
    def _body_indices(self) -> dict[str, int]:
        """Index of each body by name."""
        return {name: index for index, name in enumerate(self.body_names)}

    @cached_property
    def _joint_indices(self) -> dict[str, int]:
        """Index of each joint by name."""
        return {name: index for index, name in enumerate(self.joint_names)}

    def body_index(self, name: str) -> int:
        """Return the index of a body in `bodies` by its name; raises `UnknownNameError`."""
        check_choice("body", name, self.body_names)
        return self._body_indices[name]

    def joint_index(self, name: str) -> int:
        """Return the index of a joint in `joints` by its name; raises `UnknownNameError`."""
        check_choice("joint", name, self.joint_names)
        return self._joint_indices[name]

    def body(self, name: str) -> Body:
        """Return a body by its name; raises `UnknownNameError`."""
        return self.bodies[self.body_index(name)]

    def joint(self, name: str) -> Joint:
        """Return a joint by its name; raises `UnknownNameError`."""
        return self.joints[self.joint_index(name)]

    def is_slide(self, joint: str, coordinate: int) -> bool:
        """Return True if the coordinate of a joint is a slide, in m, False for a hinge, in rad.

        Raises:
            UnknownNameError: for an unknown joint.
            MechanismError: for a joint without such a coordinate.
        """
        joint, coordinate = self.coordinate((joint, coordinate))
        return self.joint(joint).coordinate_kinds[coordinate] == "slide"

    def coordinate(self, name: str | Key) -> Key:
        """Return a joint coordinate as (name of the joint, index).

        Args:
            name: name of a joint with one coordinate, or (name, index) for a joint with several.

        Raises:
            UnknownNameError: for an unknown joint.
            MechanismError: for a joint without such a coordinate, and for the bare name of a joint with
                several.
        """
        joint, number = name if isinstance(name, tuple) and len(name) == 2 else (name, 0)
        count, where = len(self.joint(joint).coordinate_kinds), f"joint {quoted(joint)}"
        check_key(where, joint, number)
        check_coordinate(where, self.joint(joint), number)
        if count > 1 and not isinstance(name, tuple):
            raise MechanismError(where, f"has {count} coordinates", f"which one, as ({quoted(joint)}, 0)")
        return joint, int(number)

    @cached_property
    def coordinate_labels(self) -> dict[Key, str]:
        """Labels of all joint coordinates (joint, index): `JOINT`, or `JOINT.0`, `JOINT.1`, ... for a joint
        with several."""
        counts = {joint.name: len(joint.coordinate_kinds) for joint in self.joints}
        keys = [(joint, k) for joint, count in counts.items() for k in range(count)]
        return {(joint, k): f"{joint}.{k}" if counts[joint] > 1 else joint for joint, k in keys}

    def coordinate_name(self, key: Key) -> str | Key:
        """Return the shortest name of a joint coordinate: the name of its joint, if that has no other
        coordinates.

        Raises:
            UnknownNameError: for an unknown joint.
            MechanismError: for a joint without such a coordinate.
        """
        key = self.coordinate(key)
        return key[0] if len(self.joint(key[0]).coordinate_kinds) == 1 else key

    def joint_equations(self, name: str) -> JointEquations:
        """Return the equations of a joint by its name; raises `UnknownNameError`."""
        return self.equations[self.joint_index(name)]

    def measure(self, key: Key, frames: Sequence[Frame]) -> tuple[Scalar, Scalar]:
        """Measure a joint coordinate, m or rad from the initial pose, and its rate, at given frames of all
        bodies."""
        return self.joint_equations(key[0]).measure(key[1], frames)

    @cached_property
    def joints_at(self) -> tuple[tuple[int, ...], ...]:
        """Indices of the joints at each body, ascending; one tuple per body."""
        indices: list[list[int]] = [[] for _ in self.bodies]
        for index, joint in enumerate(self.joints):
            for name in (joint.first, joint.second):
                indices[self.body_index(name)].append(index)
        return tuple(map(tuple, indices))

    def attach(self, poses: list[Pose]) -> tuple[JointEquations, ...]:
        """Return the equations of all joints for body frames with given poses at the initial pose.

        Args:
            poses: pose of each body frame, ground first; `Body.pose`, or others such as frames parallel to
                the world.
        """
        attached = []
        for joint in self.joints:
            i, j = self.body_index(joint.first), self.body_index(joint.second)
            attached.append(joint.attach(i, poses[i], j, poses[j]))
        return tuple(attached)

    @cached_property
    def equations(self) -> tuple[JointEquations, ...]:
        """Equations of all joints in the frames of the bodies, in the order of `joints`."""
        return self.attach([body.pose for body in self.bodies])

    @cached_property
    def reaction_arms(self) -> tuple[Array, ...]:
        """Reaction point (3,) of each joint: the joint point fixed in its second body, m from the center of
        mass, in the body frame."""
        return tuple(
            self.bodies[each.second].pose.point_to_body(each.joint.point_on_second) for each in self.equations
        )

    def shapes(self, index: int) -> tuple[Shape, ...]:
        """Return the shapes of the body with an index: those of `Body.shapes`, or bars from its center to its
        joints."""
        body = self.bodies[index]
        if body.shapes or index == 0:
            return body.shapes
        joints = [self.joints[k] for k in self.joints_at[index]]
        points = [joint.point if joint.first == body.name else joint.point_on_second for joint in joints]
        return tuple(
            Capsule(body.center_of_mass, point, radius=0.02 * self.size)
            for point in points  # a joint at the center of mass needs no bar
            if float(np.linalg.norm(point - body.center_of_mass)) > 1e-6 * self.size
        )
