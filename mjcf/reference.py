"""Reference model of an MJCF file: the compiled model, against which the imported scene is verified.

`newton_euler.reading` compares masses, motions, constraints and forces of an imported scene with those of a
`ReferenceModel`. `MjcfReference` computes these quantities by MuJoCo's own functions. The module shares only
the compiled model and the names of elements with the reader, `mjcf.reading`, so that both cannot make the
same mistake. The import report has an entry for each element, or for one topic of it, such as "armature".
Elements and topics that the report leaves out are switched off in the compiled model.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np

from mjcf.layout import element_name
from mjcf.report_audit import Equalities, elements_left_out, switch_off_left_out, unaccounted
from mjcf.switched_rows import approximated, coordinates
from newton_euler.equations.system import MassProperties
from newton_euler.model.scene import Scene
from newton_euler.reading.activity import Bounds
from newton_euler.reading.friction_and_stops import FrictionAndStops
from newton_euler.reading.import_report import ACTUATOR_LIMIT, JOINT_LIMIT, ImportReport, unique_name
from newton_euler.reading.quantities import FORCE_KINDS, Constraints, ForceLimit, Forces, Kinematics
from newton_euler.reading.reference import MAX_HINGE_ROW_ANGLE, ReferenceModel, Sample, whole_body_names
from newton_euler.scalars import Array, cross

PASSIVE_ROUND_OFF = 1e-14
"""Round-off of the difference between all passive forces of MuJoCo and its springs and dampers, relative to
springs and dampers. Smaller differences count as zero."""

UNSIMULATED_FEATURES = ("CONTACT", "LIMIT", "FRICTIONLOSS")
"""Features that scenes do not simulate; the import report lists their elements instead."""

PROPORTIONAL_ARRAYS = {
    "jnt": ("stiffness", "stiffnesspoly"),
    "dof": ("damping", "dampingpoly"),
    "tendon": ("stiffness", "stiffnesspoly", "damping", "dampingpoly"),
    "actuator": ("gainprm", "biasprm", "damping", "dampingpoly"),
    "body": ("gravcomp",),
}
"""Arrays of the model that forces are proportional to, by prefix of the array; zeros mean no force.

Damping of joints is stored by degree of freedom ("dof")."""

GRAVITY_ROW, ROWS_BUT_GRAVITY = FORCE_KINDS.index("gravity"), slice(1, None)
"""Row of gravity, and rows of all other forces, in arrays (kinds, nv) of all `FORCE_KINDS`."""


class WatchedForceLimit(NamedTuple):
    """Limit of a force that the scene does not simulate; after a run, a watch tests whether it was passed.

    Attributes:
        element: name of the actuator or joint in the report.
        kind: "actuator" or "joint".
        number: MuJoCo's number of the actuator or joint.
        watch: force and limit as the reader imported them.
    """

    element: str
    kind: str
    number: int
    watch: Bounds


class MjcfReference(ReferenceModel):
    """Reference model of a compiled MJCF file.

    Configurations q (nq,) and velocities v (nv,) are MuJoCo's qpos and qvel. Bodies that no joint separates
    form a rigid group, which is one body of the scene. The root of a group is its first body.
    """

    def __init__(
        self,
        model: Any,
        key: str | None,
        report: ImportReport,
        scene: Scene,
        controls: tuple[Array, Array] | None = None,
    ) -> None:
        """Take a compiled model, which is changed, and find its start configuration.

        Args:
            model: model compiled by MuJoCo.
            key: name of the keyframe, see `mjcf.read`.
            report: import report.
            scene: imported scene; its initial pose selects the start among the closed configurations.
            controls: controls (nu,) and activations (na,); None for the controls of the keyframe.
        """
        # the model without unsimulated features, and with the activations of the present time instead of the
        # next time step (`actearly`)
        self._model: Any = model
        self._model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        for name in UNSIMULATED_FEATURES:
            self._model.opt.disableflags |= int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}"))
        self._model.actuator_actearly[:] = 0
        # otherwise MuJoCo replaces inertial frames that are nearly the body frame by the body frame. Simple
        # bodies keep this, because MuJoCo also takes their mass matrix, as diagonal, in the body frame
        self._model.body_sameframe[self._model.body_simple == 0] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
        # the state in the file
        self._data = mujoco.MjData(self._model)
        self._set_keyframe(key)
        keyframe_activations = self._data.act.copy()
        if controls is not None:
            self._data.ctrl[:], self._data.act[:] = controls
        mujoco.mj_normalizeQuat(self._model, self._data.qpos)
        self._velocity = self._data.qvel.copy()
        self.file_state = self._data.qpos.copy(), self._velocity
        # rigid groups, units and constraints
        self._group_bodies(scene)
        self._set_units(scene)
        self._equalities = Equalities(self._model, self._data, self.units, self.size)
        # elements without an entry in the report; the closed start `self.start`
        self.unaccounted = tuple(unaccounted(self._model, self._roots, report))
        self.find_start(scene)
        self.unaccounted += tuple(self._changing_activations(report, self._data.act == keyframe_activations))
        # switch off the elements that the scene leaves out, after all elements were compared with the report
        self._force_limits = tuple(self._watched_force_limits(report))
        self._friction_and_stops = approximated(self._model, report).with_choices_of(scene)
        self._leave_out(report)
        # the scene keeps the loop-closure errors of the start, and so does the reference
        self.keep_offsets()

    def _set_keyframe(self, key: str | None) -> None:
        """Set the state to a keyframe; without keyframes, and for "qpos0", the state stays at qpos0."""
        model, names = self._model, [self._model.key(k).name or f"{k}" for k in range(self._model.nkey)]
        if key is None and names:
            key = names[0]
        if key in names:
            mujoco.mj_resetDataKeyframe(model, self._data, names.index(key))

    @property
    def mocap_poses(self) -> tuple[Array, Array]:
        """Positions (m, 3), m, and quaternions (m, 4) of the m mocap bodies in the keyframe, world frame."""
        return self._data.mocap_pos.copy(), self._data.mocap_quat.copy()

    @property
    def groups(self) -> list[tuple[int, Array]]:
        """Root and members, numbers of MuJoCo's bodies, of each rigid group, in the order of `names`."""
        return list(zip(self._roots, self._members, strict=True))

    def _group_bodies(self, scene: Scene) -> None:
        """Group bodies that are fixed to each other, and find the name of each group in the scene."""
        model = self._model
        # root of a body: the nearest ancestor with joints, or the body itself if it has joints
        root = [0] * model.nbody
        for k, parent in enumerate(model.body_parentid.tolist()):
            root[k] = k if model.body_jntnum[k] else root[parent]
        self._roots = [k for k in range(1, model.nbody) if root[k] == k]
        self._members = [np.flatnonzero(np.array(root) == k) for k in self._roots]
        names = ["ground"]
        for k in self._roots:
            names.append(unique_name(model.body(k).name, f"body_{k}", names))
        # an export of scenes cuts a body in two to open a loop; both halves get the name of the scene's body
        self.names = whole_body_names(names[1:], scene.mechanism.body_names)

    def _set_units(self, scene: Scene) -> None:
        """Set the names, units and largest random displacements of the velocities, see `ReferenceModel`."""
        model = self._model
        slides = model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE
        hinges = model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE
        self.size = scene.mechanism.size
        self.motions = tuple(element_name(self._model, "joint", int(k)) for k in model.dof_jntid)
        self.lengths = slides[model.dof_jntid]
        # largest random displacements: nearly half a revolution, or three sizes of the mechanism; less for
        # several hinges in a row
        self.ranges = np.full(model.nv, 3.0)
        for dof, joint in enumerate(model.dof_jntid.tolist()):
            # the first three velocities of a free joint are translations
            if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE and dof < model.jnt_dofadr[joint] + 3:
                self.lengths[dof] = True
            hinges_of_body = hinges & (model.jnt_bodyid == model.jnt_bodyid[joint])
            if np.sum(hinges_of_body) > 1:
                self.ranges[dof] = MAX_HINGE_ROW_ANGLE
        self.units = np.where(self.lengths, self.size, 1.0)

    def _watched_force_limits(self, report: ImportReport) -> Iterator[WatchedForceLimit]:
        """Yield the limits of forces for which the report has watches."""
        model = self._model
        for topic, kind, count in (
            (ACTUATOR_LIMIT, "actuator", model.nactuator),
            (JOINT_LIMIT, "joint", model.njnt),
        ):
            numbers = {element_name(model, kind, k): k for k in range(count)}
            for entry_number, watches in report.watches.items():
                entry = report.entries[entry_number]
                if entry.topic != topic:
                    continue
                for watch in watches:
                    assert isinstance(watch, Bounds)
                    yield WatchedForceLimit(entry.element, kind, numbers[entry.element], watch)

    def _changing_activations(self, report: ImportReport, unchanged: Array) -> Iterator[str]:
        """Yield a message for each imported actuator whose activation changes at the start.

        Scenes hold activations constant, so that such an actuator is not imported correctly.

        Args:
            report: import report.
            unchanged: (na,) True for activations of the keyframe; activations that `controls` replaced are
                not examined.
        """
        model, data, omitted = self._model, self._data, elements_left_out(report)
        self._evaluate(self.start, self._velocity)
        for k in np.flatnonzero(model.actuator_actnum).tolist():
            first, name = int(model.actuator_actadr[k]), element_name(model, "actuator", k)
            activations = slice(first, first + int(model.actuator_actnum[k]))
            # the rate of a constant activation is exactly 0: a difference of equal numbers
            if name not in omitted and np.any(data.act_dot[activations][unchanged[activations]]):
                yield f"{name}: its activation changes"

    def _leave_out(self, report: ImportReport) -> None:
        """Switch off the elements and topics that the report leaves out."""
        self._equalities.active[switch_off_left_out(self._model, report)] = 0

    # Quantities that MuJoCo computes

    def _evaluate(self, q: Array, v: Array) -> None:
        """Compute positions, velocities and actuator forces of a state in MuJoCo's data."""
        model, data = self._model, self._data
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fwdActuation(model, data)

    def integrate(self, q: Array, step: Array) -> Array:
        """Return the configuration (nq,) that velocities `step` (nv,) reach from q (nq,) in 1 s."""
        q = q.copy()
        mujoco.mj_integratePos(self._model, q, step, 1.0)
        return q

    def difference(self, q: Array, other: Array) -> Array:
        """Return the velocities (nv,) that lead from configuration q (nq,) to `other` (nq,) in 1 s."""
        step = np.zeros(self._model.nv)
        mujoco.mj_differentiatePos(self._model, step, 1.0, q, other)
        return step

    def points(self, q: Array) -> Array:
        """Return the centers of mass of moving bodies and the joint anchors (k, 3), m, world frame."""
        self._evaluate(q, np.zeros(self._model.nv))
        moving = self._model.body_weldid != 0  # bodies that are not fixed to the world
        return np.concatenate([self._data.xipos[moving], self._data.xanchor])

    def mass_properties(self) -> MassProperties:
        """Return masses, centers of mass and inertias of the rigid groups at the start, world frame."""
        model, data = self._model, self._data
        self._evaluate(self.start, np.zeros(model.nv))
        masses, centers, inertias = [], [], []
        for members, center in zip(self._members, self._centers(), strict=True):
            mass = model.body_mass[members]
            axes, arms = data.ximat[members].reshape(-1, 3, 3), data.xipos[members] - center
            # sum of the inertias about the members' own centers, and parallel-axis theorem
            own_inertia = np.einsum("kij,kj,klj->il", axes, model.body_inertia[members], axes)
            second_moment = np.einsum("k,ki,kj->ij", mass, arms, arms)
            masses.append(mass.sum())
            centers.append(center)
            inertias.append(own_inertia + np.trace(second_moment) * np.eye(3) - second_moment)
        return MassProperties(np.array(masses), np.array(centers), np.array(inertias))

    def _centers(self) -> Array:
        """Return the centers of mass (b, 3) of the rigid groups, m, world frame, after `_evaluate`."""
        mass, positions = self._model.body_mass, self._data.xipos
        return np.array([mass[k] @ positions[k] / max(mass[k].sum(), 1e-300) for k in self._members])

    def kinematics(self, q: Array, v: Array) -> Kinematics:
        """Compute poses, Jacobians and velocity-dependent accelerations of the rigid groups."""
        model, data = self._model, self._data
        self._evaluate(q, v)
        centers = self._centers()
        jacobians, drift = np.zeros((len(centers), 6, model.nv)), np.zeros((len(centers), 6))
        # accelerations for qacc = 0; mj_jacDot is not used, because it is wrong for a ball that a slide of
        # the same body follows
        data.qacc[:] = 0.0
        mujoco.mj_rnePostConstraint(model, data)
        world_acceleration = data.cacc[0, 3:]  # MuJoCo gives the world body the acceleration -gravity
        acceleration = np.zeros(6)  # angular, then linear
        for k, (root, center) in enumerate(zip(self._roots, centers, strict=True)):
            mujoco.mj_jac(model, data, jacobians[k, :3], jacobians[k, 3:], center, root)
            mujoco.mj_objectAcceleration(model, data, mujoco.mjtObj.mjOBJ_BODY, root, acceleration, 0)
            # from the center of the root body to the center of the group
            arm, omega = center - data.xipos[root], jacobians[k, 3:] @ v
            angular = acceleration[:3]
            linear = acceleration[3:] - world_acceleration
            linear = linear + cross(angular, arm) + cross(omega, cross(omega, arm))
            drift[k] = np.concatenate([linear, angular])
        rotations = data.xmat[self._roots].reshape(-1, 3, 3).copy()
        return Kinematics(centers, rotations, jacobians, drift)

    def constraints(self, q: Array) -> Constraints:
        """Return residuals and Jacobian of the equalities that are switched on, dimensionless."""
        return self._equalities.constraints(q)

    def keep_offsets(self) -> None:
        """Redefine the equalities so that their residuals are zero at the start."""
        self._equalities.keep_offsets(self.start)

    def mass_matrix(self, q: Array) -> tuple[Array, Array]:
        """Return two mass matrices (nv, nv): of the bodies, and of the armatures (rotor inertias)."""
        model, joint_armatures = self._model, np.diag(self._model.dof_armature)
        has_other_armatures = np.any(model.tendon_armature) or np.any(model.actuator_armature)
        with_joints = self._full_mass_matrix(q)
        others = self._full_mass_matrix(q, "tendon", "actuator") - with_joints if has_other_armatures else 0.0
        return with_joints - joint_armatures, joint_armatures + others

    def _full_mass_matrix(self, q: Array, *kinds: str) -> Array:
        """Return MuJoCo's mass matrix (nv, nv) with the armatures of joints and of some kinds of elements.

        Args:
            q: (nq,) configuration.
            kinds: any of "tendon" and "actuator".
        """
        model, mass = self._model, np.zeros((self._model.nv, self._model.nv))
        saved = {kind: getattr(model, f"{kind}_armature").copy() for kind in ("tendon", "actuator")}
        for kind in saved:
            if kind not in kinds:
                getattr(model, f"{kind}_armature")[:] = 0.0
        self._data.qpos[:] = q
        mujoco.mj_fwdPosition(model, self._data)
        mujoco.mj_fullM(model, self._data, mass)
        for kind, values in saved.items():
            getattr(model, f"{kind}_armature")[:] = values
        return mass

    def forces(self, q: Array, v: Array) -> Forces:
        """Return the generalized forces (nv,) of gravity, springs, dampers, actuators, and bias."""
        data = self._data
        # MuJoCo's bias force at rest is minus the gravity force
        self._evaluate(q, np.zeros(len(v)))
        gravity = -data.qfrc_bias
        self._evaluate(q, v)
        springs, dampers = data.qfrc_spring.copy(), data.qfrc_damper.copy()
        # other passive forces, such as gravity compensation
        others = data.qfrc_passive - springs - dampers
        round_off = PASSIVE_ROUND_OFF * np.abs(springs) + PASSIVE_ROUND_OFF * np.abs(dampers)
        others[np.abs(others) <= round_off] = 0.0
        return Forces(
            gravity=gravity,
            springs=springs,
            dampers=dampers,
            actuators=data.qfrc_actuator + others,
            friction_and_stops=self._friction_and_stops.forces(coordinates(self._model, q), v),
            bias=data.qfrc_bias + gravity,
        )

    def force_limits(self, q: Array, v: Array) -> list[ForceLimit]:
        """Return the watched limits, with the force at this state and the limits in the file."""
        model, data = self._model, self._data
        self._evaluate(q, v)
        limits = []
        for element, kind, k, watch in self._force_limits:
            if kind == "actuator":  # `actuator_outadr`: index of the force of its first output
                force, (low, high) = (
                    data.actuator_force[model.actuator_outadr[k]],
                    model.actuator_forcerange[k],
                )
            else:
                force, (low, high) = data.qfrc_actuator[model.jnt_dofadr[k]], model.jnt_actfrcrange[k]
            limits.append(ForceLimit(element, watch, float(force), float(low), float(high)))
        return limits

    def energies(self, q: Array, v: Array) -> tuple[float, float]:
        """Return kinetic energy, and potential energy up to a constant, J."""
        self._evaluate(q, v)
        mujoco.mj_energyPos(self._model, self._data)
        mujoco.mj_energyVel(self._model, self._data)
        potential, kinetic = self._data.energy
        of_stops = self._friction_and_stops.energy(coordinates(self._model, q))
        return float(kinetic), float(potential) + of_stops

    # One element at a time

    def elements(self, samples: Sequence[Sample]) -> Iterator[tuple[str, list[list[Array]]]]:
        """Yield each element with its forces at all samples, while all other elements have none.

        The forces are a list of variants of the element, see `_force_variants`.
        """
        model = self._model
        # save all arrays that forces are proportional to, and set them to zero
        array_names = {f"{kind}_{field}" for kind, fields in PROPORTIONAL_ARRAYS.items() for field in fields}
        saved = {name: getattr(model, name).copy() for name in array_names}
        saved_gravity = model.opt.gravity.copy()
        for name in array_names:
            getattr(model, name)[:] = 0.0
        all_switched = self._friction_and_stops
        self._friction_and_stops = FrictionAndStops.none(model.nv)
        # gravity of 1 m/s^2 along each axis; other forces that depend on gravity are another element
        gravity_variants = []
        for axis in np.eye(3):
            model.opt.gravity[:] = axis
            by_sample = self._force_kinds(samples)
            for forces in by_sample:
                forces[ROWS_BUT_GRAVITY] = 0.0
            gravity_variants.append(by_sample)
        yield "gravity", gravity_variants
        model.opt.gravity[:] = 0.0
        # one element at a time: restore its values, evaluate, set them to zero again
        for kind, fields in PROPORTIONAL_ARRAYS.items():
            count = model.njnt if kind == "dof" else len(saved[f"{kind}_{fields[0]}"])
            for k in range(count):
                rows = model.dof_jntid == k if kind == "dof" else np.arange(count) == k
                if not any(np.any(saved[f"{kind}_{field}"][rows]) for field in fields):
                    continue
                for field in fields:
                    getattr(model, f"{kind}_{field}")[rows] = saved[f"{kind}_{field}"][rows]
                # stiffness and damping of a joint are separate elements; the fields of others act together
                topic = {"jnt": ": stiffness", "dof": ": damping"}.get(kind, "")
                name = element_name(self._model, "joint" if topic else kind, k) + topic
                yield name, self._force_variants(kind, k, samples, saved_gravity)
                for field in fields:
                    getattr(model, f"{kind}_{field}")[rows] = 0.0
        for name, alone in all_switched.elements(self.motions):
            self._friction_and_stops = alone
            yield name, [self._force_kinds(samples)]
        # restore the model
        self._friction_and_stops = all_switched
        for name, values in saved.items():
            getattr(model, name)[:] = values
        model.opt.gravity[:] = saved_gravity

    def _force_variants(
        self, kind: str, k: int, samples: Sequence[Sample], gravity: Array
    ) -> list[list[Array]]:
        """Return the forces of the only element that is not zero, and of variations of the element.

        A wrong import of the element may show only in a variation, such as another rest length of a tendon or
        one axis of a force on a site.

        Args:
            kind: key of `PROPORTIONAL_ARRAYS`.
            k: number of the element.
            samples: states at which forces are evaluated.
            gravity: (3,) gravity of the model, m/s^2; the present gravity is zero.

        Returns:
            For each variant and each sample, forces (kinds, nv) of all `FORCE_KINDS`.
        """
        model = self._model
        if kind == "body":  # gravity compensation is proportional to gravity; the weight itself is removed
            model.opt.gravity[:] = gravity
            by_sample = self._force_kinds(samples)
            model.opt.gravity[:] = 0.0
            for forces in by_sample:
                forces[GRAVITY_ROW] = 0.0
            return [by_sample]
        variants = [self._force_kinds(samples)]
        if kind == "tendon":
            model.tendon_lengthspring[k] += self.size
            variants.append(self._force_kinds(samples))
            model.tendon_lengthspring[k] -= self.size
        if kind == "actuator" and model.actuator_trntype[k] == mujoco.mjtTrn.mjTRN_SITE:
            gear = model.actuator_gear[k].copy()
            for axis in np.flatnonzero(gear):
                model.actuator_gear[k] = np.where(np.arange(len(gear)) == axis, gear, 0.0)
                variants.append(self._force_kinds(samples))
            model.actuator_gear[k] = gear
        return variants

    def _force_kinds(self, samples: Sequence[Sample]) -> list[Array]:
        """Return forces (kinds, nv) of all `FORCE_KINDS` for each sample."""
        without_bias = slice(len(FORCE_KINDS))  # the bias is the last field of `Forces`
        return [np.array(self.forces(sample.q, sample.v)[without_bias]) for sample in samples]

    def armatures(self, samples: Sequence[Sample]) -> Iterator[tuple[str, list[Array]]]:
        """Yield each element that has an armature, with its mass matrix (nv, nv) at each sample."""
        model = self._model
        for joint in range(model.njnt):
            armatures = np.where(model.dof_jntid == joint, model.dof_armature, 0.0)
            if np.any(armatures):
                yield element_name(self._model, "joint", joint), [np.diag(armatures)] * len(samples)
        # tendons and actuators: difference of two mass matrices
        without = [self._full_mass_matrix(sample.q) for sample in samples]
        for kind in ("tendon", "actuator"):
            inertia = getattr(model, f"{kind}_armature")
            saved = inertia.copy()
            for k in np.flatnonzero(saved):
                inertia[:] = 0.0
                inertia[k] = saved[k]
                with_element = [self._full_mass_matrix(sample.q, kind) for sample in samples]
                yield (
                    element_name(self._model, kind, int(k)),
                    [m - m0 for m, m0 in zip(with_element, without, strict=True)],
                )
            inertia[:] = saved
