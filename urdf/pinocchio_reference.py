"""Reference model from a Pinocchio model with loop closures, against which an imported scene is verified.

`newton_euler.reading` compares masses, motions, constraints and forces of an imported scene with those of a
`ReferenceModel`. `PinocchioReference` computes these quantities by Pinocchio. Loop closures, couplings and
mimics (joints that follow others) are constraint rows. `urdf.reference` derives the reference models of URDF
files and of models in memory from `PinocchioReference`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence, Set
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from newton_euler.equations.system import MassProperties
from newton_euler.model.couplings import MAX_DEGREE
from newton_euler.model.scene import Scene
from newton_euler.reading.friction_and_stops import (
    STICK_TIME,
    STOP_DISSIPATION,
    STOP_RATE,
    FrictionAndStops,
)
from newton_euler.reading.import_report import (
    FRICTION,
    LIMITS,
    ImportReport,
    topics_not_simulated,
    unique_name,
)
from newton_euler.reading.quantities import FORCE_KINDS, Constraints, Forces, Kinematics
from newton_euler.reading.reference import MAX_HINGE_ROW_ANGLE, ReferenceModel, Sample, whole_body_names
from newton_euler.scalars import Array, cross, tilde
from urdf.constraints import power_sums
from urdf.loops import REVOLUTE


class Closure(NamedTuple):
    """Loop closure between two frames.

    Attributes:
        element: name of the closure in reports.
        kind: "3d" (the origins of the frames coincide), "6d" (the frames coincide), "rod" (the origins keep
            their distance at the start), or `REVOLUTE` (a hinge about the x axes of both frames).
        first: number of the first frame.
        second: number of the second frame, which no other closure has.
    """

    element: str
    kind: str
    first: int
    second: int


class PointSpring(NamedTuple):
    """Spring and damper between the origins of two frames.

    Attributes:
        name: name of the spring.
        first: number of the first frame.
        second: number of the second frame.
        stiffness: N/m.
        rest_length: m.
        damping: N s/m.
    """

    name: str
    first: int
    second: int
    stiffness: float
    rest_length: float
    damping: float


GRAVITY_ONLY = np.eye(len(FORCE_KINDS))[FORCE_KINDS.index("gravity")][:, None]
"""Factors (kinds, 1) that keep the row of gravity in forces (kinds, nv) of all `FORCE_KINDS`."""


class PinocchioReference(ReferenceModel):
    """Reference model of a Pinocchio model with loop closures.

    Configurations q (nq,) and velocities v (nv,) are Pinocchio's. The residuals of the c couplings and mimics
    are linear in the displacement of joint coordinates from a configuration, plus polynomials of second and
    higher powers of the coordinates.
    """

    def __init__(
        self,
        model: Any,
        joint_names: Sequence[str],
        closures: list[Closure],
        report: ImportReport,
        scene: Scene,
    ) -> None:
        """Take a model, which is changed.

        Subclasses add dampers, springs and couplings, and then call `_begin`.

        Args:
            model: `pinocchio.Model` with the gravity of the scene.
            joint_names: name of each joint in reports, without the kind of the element.
            closures: loop closures.
            report: import report.
            scene: imported scene; its initial pose selects the start among the closed configurations.
        """
        self._model, self._joint_names, self._closures = model, joint_names, closures
        # topics: properties, such as "damping", that the scene leaves out, by element; the reference leaves
        # them out, too
        self._topics_left_out, self._report = topics_not_simulated(report), report
        self._rod_lengths: dict[int, float] = {}  # by number of the closure, once the start is known
        self._data: Any = model.createData()
        self._damping, self._stiffness, self._rests = np.zeros((3, model.nv))
        self._springs: list[PointSpring] = []
        # dry friction and limits of hinges and slides (nv,); only those that the scene has as forces act
        self._friction = np.zeros(model.nv)
        self._low, self._high = np.full((2, model.nv), [[-np.inf], [np.inf]])
        self._friction_and_stops = FrictionAndStops.none(model.nv)
        # couplings and mimics: linear factors (c, nv), constants (c,), elements, and factors of the powers 1
        # to `MAX_DEGREE` of coordinates (c, MAX_DEGREE, nv), with 0 for power 1
        self._linear, self._offsets = np.zeros((0, model.nv)), np.zeros(0)
        self._coupling_elements = list[str]()
        self._higher_powers = np.zeros((0, MAX_DEGREE, model.nv))
        self._set_names_and_units(scene)

    def _begin(self, q: Array, residuals: Array, scene: Scene) -> None:
        """Find the start next to a configuration.

        Args:
            q: (nq,) configuration in the file.
            residuals: (c,) residuals of couplings and mimics at `q`.
            scene: imported scene.
        """
        self._q0, self._residuals_at_q0 = q, residuals
        self.file_state = q, np.zeros(self._model.nv)
        self.find_start(scene)
        self.keep_offsets()
        if topics := self._report.approximated_topics:
            self._friction_and_stops = self._approximated(topics).with_choices_of(scene)

    def _approximated(self, topics: Set[tuple[str, str]]) -> FrictionAndStops:
        """Return friction and limits as forces, with the inertias of coordinates at the start.

        Args:
            topics: elements and topics that the scene has, see `ImportReport.approximated_topics`.
        """
        found = FrictionAndStops.none(self._model.nv)
        # inertia of a coordinate while all other joints move freely: inverse of its acceleration per force
        basis = self.samples[0].freedom.basis
        mass = sum(self.mass_matrix(self.start))
        mobility = np.diag(basis @ np.linalg.pinv(basis.T @ mass @ basis) @ basis.T)
        for k, motion in enumerate(self.motions):
            if (motion, FRICTION) in topics:
                found.friction[k] = self._friction[k]
                found.speed[k] = STICK_TIME * self._friction[k] * mobility[k]
            if (motion, LIMITS) in topics:
                found.low[k], found.high[k] = self._low[k], self._high[k]
                found.stiffness[k] = STOP_RATE / mobility[k]
                found.dissipation[k] = STOP_DISSIPATION
        return found

    def _set_names_and_units(self, scene: Scene) -> None:
        """Set names of bodies and velocities, units, and largest displacements, see `ReferenceModel`."""
        model, self.size = self._model, scene.mechanism.size
        # joints that move a body with mass, and the name of each body
        self._joints = [k for k in range(1, model.njoints) if model.inertias[k].mass > 0.0]
        names = ["ground"]
        for k in self._joints:
            bodies = (f.name for f in model.frames if f.type == pin.FrameType.BODY and f.parentJoint == k)
            names.append(unique_name(str(next(bodies, model.names[k])), f"body_{k}", names))
        # the file may have two halves of a body that was cut to open a loop: both get the body's name
        self.names = whole_body_names(names[1:], scene.mechanism.body_names)
        # for each velocity: the name of its joint (`motions`), and its largest random displacement. This is
        # nearly half a revolution or three sizes of the mechanism; less for hinges in a row without mass
        # between them
        massless = {k for k in range(1, model.njoints) if k not in self._joints}
        self.ranges = np.full(model.nv, 3.0)
        motions = [""] * model.nv
        data, neutral = model.createData(), pin.neutral(model)
        columns = np.reshape(pin.computeJointJacobians(model, data, neutral), (6, model.nv))
        for k in range(1, model.njoints):
            in_v = slice(model.joints[k].idx_v, model.joints[k].idx_v + model.joints[k].nv)
            motions[in_v] = [f"joint {self._joint_names[k]!r}"] * model.joints[k].nv
            if k in massless or model.parents[k] in massless:
                self.ranges[in_v] = MAX_HINGE_ROW_ANGLE
        self.motions = tuple(motions)
        self.lengths = ~np.any(columns[3:] != 0.0, axis=0)  # no angular velocity
        self.units = np.where(self.lengths, self.size, 1.0)

    def _topics(self, element: str) -> set[str]:
        """Return the topics of an element that the import report leaves out; "" is the whole element."""
        return self._topics_left_out.get(element, set())

    # The parts of the model, for `urdf.file_run`, which simulates the model

    @property
    def model(self) -> Any:
        """`pinocchio.Model` with gravity, rotors and frames of closures; not to be changed."""
        return self._model

    @property
    def closures(self) -> Sequence[Closure]:
        """Loop closures between frames of `model`."""
        return self._closures

    @property
    def moving_bodies(self) -> Sequence[int]:
        """Pinocchio's numbers of the joints that carry the bodies of `names`."""
        return self._joints

    @property
    def couplings(self) -> Array:
        """(c, nv) factors of the velocities in couplings and mimics: factors @ v = 0 for linear couplings."""
        return self._linear

    @property
    def has_nonlinear_couplings(self) -> bool:
        """True if a coupling has second or higher powers of coordinates."""
        return bool(np.any(self._higher_powers))

    @property
    def damping(self) -> Array:
        """Damping (nv,) of joints, N s/m or N m s/rad."""
        return self._damping

    @property
    def stiffness(self) -> Array:
        """Stiffness (nv,) of joint springs, N/m or N m/rad."""
        return self._stiffness

    @property
    def point_spring_names(self) -> tuple[str, ...]:
        """Names of the springs and dampers between two points, such as "spring 'strut'"."""
        return tuple(f"spring {spring.name!r}" for spring in self._springs)

    @property
    def has_springs_or_dampers(self) -> bool:
        """True if springs or dampers act in the model."""
        return bool(np.any(self._stiffness) or np.any(self._damping) or self._springs)

    # Quantities that Pinocchio computes

    def integrate(self, q: Array, step: Array) -> Array:
        """Return the configuration (nq,) that velocities `step` (nv,) reach from q (nq,) in 1 s."""
        return np.asarray(pin.integrate(self._model, q, step))

    def difference(self, q: Array, other: Array) -> Array:
        """Return the velocities (nv,) that lead from configuration q (nq,) to `other` (nq,) in 1 s."""
        return np.asarray(pin.difference(self._model, q, other))

    def points(self, q: Array) -> Array:
        """Return centers of mass and origins of all moving joints (k, 3), m, world frame."""
        model, data = self._model, self._data
        pin.forwardKinematics(model, data, q)
        placed = list(zip(list(data.oMi)[1:], list(model.inertias)[1:], strict=True))
        centers = [pose.act(inertia.lever) for pose, inertia in placed]
        return np.array([*centers, *(pose.translation for pose, _ in placed)])

    def mass_properties(self) -> MassProperties:
        """Return masses, centers of mass and inertias of the bodies at the start, world frame."""
        model, data = self._model, self._data
        pin.forwardKinematics(model, data, self.start)
        inertias = [data.oMi[k].act(model.inertias[k]) for k in self._joints]
        return MassProperties(
            mass=np.array([inertia.mass for inertia in inertias]),
            center_of_mass=np.array([inertia.lever for inertia in inertias]),
            inertia=np.array([inertia.inertia for inertia in inertias]),
        )

    def kinematics(self, q: Array, v: Array) -> Kinematics:
        """Compute poses, Jacobians and velocity-dependent accelerations of the bodies."""
        model, data = self._model, self._data
        pin.computeJointJacobians(model, data, q)
        pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
        count = len(self._joints)
        centers, rotations = np.zeros((count, 3)), np.zeros((count, 3, 3))
        jacobians, drift = np.zeros((count, 6, model.nv)), np.zeros((count, 6))
        for n, k in enumerate(self._joints):
            pose = data.oMi[k]
            # from the origin of the joint to the center of mass
            arm = pose.rotation @ model.inertias[k].lever
            centers[n], rotations[n] = pose.translation + arm, pose.rotation
            columns = pin.getJointJacobian(model, data, k, pin.LOCAL_WORLD_ALIGNED)
            jacobians[n] = np.reshape(columns, (6, model.nv))
            jacobians[n, :3] -= tilde(arm) @ jacobians[n, 3:]
            # acceleration at zero accelerations of the coordinates
            acceleration = pin.getClassicalAcceleration(model, data, k, pin.LOCAL_WORLD_ALIGNED)
            omega = jacobians[n, 3:] @ v
            relative = cross(acceleration.angular, arm) + cross(omega, cross(omega, arm))
            drift[n] = np.concatenate([acceleration.linear + relative, acceleration.angular])
        return Kinematics(centers, rotations, jacobians, drift)

    def constraints(self, q: Array) -> Constraints:
        """Return dimensionless residuals and Jacobian of loop closures, couplings and mimics."""
        model, data = self._model, self._data
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        residuals, rows, elements = [np.zeros(0)], [np.zeros((0, model.nv))], list[str]()
        for number, (element, kind, first, second) in enumerate(self._closures):
            a, b = data.oMf[first], data.oMf[second]
            # from the second origin to the first; Jacobian (6, nv) of the relative velocity and angular
            # velocity of both frames
            d = a.translation - b.translation
            relative_jacobian = self._frame_jacobian(first) - self._frame_jacobian(second)
            block_count = len(rows)
            if kind != "rod":
                residuals.append(d / self.size)
                rows.append(relative_jacobian[:3] / self.size)
            elif number in self._rod_lengths:  # the length of a rod is known after the start is found
                length = np.linalg.norm(d)
                residuals.append(np.array([length - self._rod_lengths[number]]) / self.size)
                rows.append((d / length @ relative_jacobian[:3])[None] / self.size)
            if kind == REVOLUTE:
                # the x axis of the first frame is perpendicular to the y and z axes of the second
                x_axis, y_and_z_axes = a.rotation[:, 0], b.rotation[:, 1:].T
                residuals.append(y_and_z_axes @ x_axis)
                rows.append(np.cross(x_axis, y_and_z_axes) @ relative_jacobian[3:])
            if kind == "6d":
                relative_rotation = a.rotation.T @ b.rotation
                residuals.append(pin.log3(relative_rotation))
                rows.append(-pin.Jlog3(relative_rotation) @ b.rotation.T @ relative_jacobian[3:])
            elements += [element] * sum(map(len, rows[block_count:]))
        # couplings and mimics; the linear part is relative to the configuration `_q0`
        x = pin.difference(model, pin.neutral(model), q)
        higher = np.sum(power_sums(self._higher_powers, x, derivative=0), axis=1)
        linear = self._linear @ pin.difference(model, self._q0, q)
        residuals.append(linear + self._residuals_at_q0 + higher)
        rows.append(self._linear + power_sums(self._higher_powers, x, derivative=1))
        jacobian = np.concatenate(rows) * self.units
        return Constraints(np.concatenate(residuals), jacobian, [*elements, *self._coupling_elements])

    def keep_offsets(self) -> None:
        """Redefine loop closures, couplings and mimics so that their residuals are zero at the start.

        The rounded numbers of a file close its loops only approximately. Scenes keep the remaining offsets.
        """
        model, data = self._model, self._data
        pin.framesForwardKinematics(model, data, self.start)
        for number, (_, kind, first, second) in enumerate(self._closures):
            if kind == "rod":
                d = data.oMf[first].translation - data.oMf[second].translation
                self._rod_lengths[number] = float(np.linalg.norm(d))
            else:
                # move the second frame to the first; a ball needs the origin only
                joint = data.oMi[model.frames[second].parentJoint]
                target = data.oMf[first]
                if kind not in ("6d", REVOLUTE):
                    target = pin.SE3(np.eye(3), target.translation)
                model.frames[second].placement = joint.actInv(target)
        self._q0, self._residuals_at_q0 = self.start, np.zeros(len(self._residuals_at_q0))
        self._data = model.createData()  # for the moved frames

    def _frame_jacobian(self, frame: int) -> Array:
        """Return the Jacobian (6, nv) of the linear and angular velocity of a frame, world axes."""
        jacobian = pin.getFrameJacobian(self._model, self._data, frame, pin.LOCAL_WORLD_ALIGNED)
        return np.reshape(jacobian, (6, self._model.nv))

    def mass_matrix(self, q: Array) -> tuple[Array, Array]:
        """Return two mass matrices (nv, nv): of the bodies, and of the armatures (rotor inertias)."""
        upper = np.triu(pin.crba(self._model, self._data, q))
        armatures = np.diag(self._model.armature)
        return upper + np.triu(upper, 1).T - armatures, armatures

    def forces(self, q: Array, v: Array) -> Forces:
        """Return the generalized forces (nv,) of gravity, springs, dampers, actuators, and bias."""
        gravity = -np.array(pin.computeGeneralizedGravity(self._model, self._data, q))
        bias = np.array(pin.nonLinearEffects(self._model, self._data, q, v)) + gravity
        springs, dampers = self.springs_and_dampers(q, v)
        return Forces(
            gravity=gravity,
            springs=springs,
            dampers=dampers,
            actuators=np.zeros(len(v)),
            friction_and_stops=self._friction_and_stops.forces(self._coordinates(q), v),
            bias=bias,
        )

    def springs_and_dampers(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return the generalized forces (nv,) of springs, and those of dampers, N or N m."""
        springs, dampers = -self._stiffness * (self._coordinates(q) - self._rests), -self._damping * v
        for spring in self._springs:
            spring_force, damper_force, _ = self._point_spring_forces(spring, q, v)
            springs, dampers = springs + spring_force, dampers + damper_force
        return springs, dampers

    def _coordinates(self, q: Array) -> Array:
        """Return the coordinates of hinges and slides from neutral, in the order of velocities (nv,)."""
        return np.asarray(pin.difference(self._model, pin.neutral(self._model), q))

    def _point_spring_forces(self, spring: PointSpring, q: Array, v: Array) -> tuple[Array, Array, float]:
        """Return the generalized forces (nv,) of a point spring and of its damper, and the energy, J."""
        model, data = self._model, self._data
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        d = data.oMf[spring.second].translation - data.oMf[spring.first].translation
        length = float(np.linalg.norm(d))
        relative_jacobian = self._frame_jacobian(spring.second) - self._frame_jacobian(spring.first)
        length_jacobian = d / length @ relative_jacobian[:3]
        stretch = length - spring.rest_length
        return (
            -spring.stiffness * stretch * length_jacobian,
            -spring.damping * (length_jacobian @ v) * length_jacobian,
            0.5 * spring.stiffness * stretch**2,
        )

    def energies(self, q: Array, v: Array) -> tuple[float, float]:
        """Return kinetic energy, and potential energy up to a constant, J."""
        kinetic = pin.computeKineticEnergy(self._model, self._data, q, v)
        potential = float(pin.computePotentialEnergy(self._model, self._data, q))
        potential += float(0.5 * self._stiffness @ (self._coordinates(q) - self._rests) ** 2)
        for spring in self._springs:
            _, _, energy = self._point_spring_forces(spring, q, v)
            potential += energy
        of_stops = self._friction_and_stops.energy(self._coordinates(q))
        return float(kinetic), potential + of_stops

    def elements(self, samples: Sequence[Sample]) -> Iterator[tuple[str, list[list[Array]]]]:
        """Yield each element with its forces at all samples, while all other elements have none.

        The forces are a list of variants of the element. A variant has for each sample an array (kinds, nv)
        of all `FORCE_KINDS`.
        """
        # gravity of 1 m/s^2 along each axis
        gravity, gravity_variants = self._model.gravity.linear.copy(), []
        for axis in np.eye(3):
            self._model.gravity.linear = axis
            by_sample = [self._force_kinds(sample) for sample in samples]
            gravity_variants.append([forces * GRAVITY_ONLY for forces in by_sample])
        self._model.gravity.linear = gravity
        yield "gravity", gravity_variants
        all_switched = self._friction_and_stops
        for name, alone in all_switched.elements(self.motions):
            self._friction_and_stops = alone
            rows = np.zeros(len(FORCE_KINDS))[:, None]
            rows[FORCE_KINDS.index("friction_and_stops")] = 1.0
            yield name, [[self._force_kinds(sample) * rows for sample in samples]]
        self._friction_and_stops = FrictionAndStops.none(self._model.nv)
        # springs and dampers of each joint
        for name in dict.fromkeys(self.motions):
            of_joint, by_sample = np.array([motion == name for motion in self.motions]), []
            for sample in samples:
                forces = self._force_kinds(sample)
                by_sample.append(np.where(of_joint, forces, 0.0) * (1.0 - GRAVITY_ONLY))
            if np.any(by_sample):
                what = "stiffness and damping" if np.any(self._stiffness[of_joint]) else "damping"
                yield f"{name}: {what}", [by_sample]
        # point springs
        for spring in self._springs:
            by_sample = []
            for sample in samples:
                spring_force, damper_force, _ = self._point_spring_forces(spring, sample.q, sample.v)
                forces = np.zeros((len(FORCE_KINDS), self._model.nv))
                forces[FORCE_KINDS.index("springs")] = spring_force
                forces[FORCE_KINDS.index("dampers")] = damper_force
                by_sample.append(forces)
            yield f"spring {spring.name!r}", [by_sample]
        self._friction_and_stops = all_switched

    def _force_kinds(self, sample: Sample) -> Array:
        """Return the forces (kinds, nv) of all `FORCE_KINDS` at a sample."""
        without_bias = slice(len(FORCE_KINDS))  # the bias is the last field of `Forces`
        return np.array(self.forces(sample.q, sample.v)[without_bias])

    def armatures(self, samples: Sequence[Sample]) -> Iterator[tuple[str, list[Array]]]:
        """Yield each joint that has an armature, with its mass matrix (nv, nv) at each sample."""
        for name in dict.fromkeys(self.motions):
            of_joint = np.array([motion == name for motion in self.motions])
            if np.any(self._model.armature[of_joint]):
                yield name, [np.diag(np.where(of_joint, self._model.armature, 0.0))] * len(samples)
