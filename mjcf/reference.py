"""MJCF file as MuJoCo compiles it: the reference model of an imported scene.

See `newton_euler.reading`. The module shares only the compiled model and the names of elements with
`mjcf.reading`. Loop closure, rigid groups and acting elements are found here by MuJoCo's own functions.
Elements that the import report leaves out are switched off in a copy of the model, by their names.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import mujoco
import numpy as np

from mjcf.layout import element_name
from mjcf.report_audit import Equalities, switch_off, unaccounted, without_force
from newton_euler.equations.system import MassProperties
from newton_euler.model.scene import Scene
from newton_euler.reading.activity import Bounds
from newton_euler.reading.import_report import ImportReport, left_out, unique_name
from newton_euler.reading.quantities import Constraints, ForceLimit, Forces, Kinematics
from newton_euler.reading.reference import MAX_HINGE_ROW_ANGLE, ReferenceModel, Sample, names_of_wholes
from newton_euler.scalars import Array, cross

PASSIVE_ROUND_OFF = 1e-14
"""Relative round-off of MuJoCo's sum of passive forces minus its parts."""

UNSIMULATED_FEATURES = ("CONTACT", "LIMIT", "FRICTIONLOSS")
"""Features that scenes do not simulate; the import report lists their elements instead."""

FORCE_ARRAYS = {
    "jnt": ("stiffness", "stiffnesspoly"),
    "dof": ("damping", "dampingpoly"),
    "tendon": ("stiffness", "stiffnesspoly", "damping", "dampingpoly"),
    "actuator": ("gainprm", "biasprm", "damping", "dampingpoly"),
    "body": ("gravcomp",),
}
"""Arrays of the model that forces depend on, by kind of element; zeros mean no force."""


class MjcfReference(ReferenceModel):
    """Reference model of a compiled MJCF file."""

    def __init__(
        self,
        model: Any,
        key: str | None,
        report: ImportReport,
        scene: Scene,
        controls: tuple[Array, Array] | None = None,
    ) -> None:
        """Take a compiled model, which is changed.

        Args:
            model: model compiled by MuJoCo.
            key: keyframe, see `mjcf.read`.
            report: import report.
            scene: imported scene; its initial pose selects the start among the closed configurations.
            controls: controls (nu,) and activations (na,); None for the controls of the keyframe.
        """
        self._model: Any = model
        self._model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        for name in UNSIMULATED_FEATURES:
            self._model.opt.disableflags |= int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}"))
        self._model.actuator_actearly[:] = 0  # early activations belong to the next time step
        self._model.body_sameframe[self._model.body_simple == 0] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
        self._data = mujoco.MjData(self._model)
        self._place(key)
        stated = self._data.act.copy()
        if controls is not None:
            self._data.ctrl[:], self._data.act[:] = controls
        mujoco.mj_normalizeQuat(self._model, self._data.qpos)
        self._velocity = self._data.qvel.copy()
        self.stated = self._data.qpos.copy(), self._velocity
        self._group(scene)
        self._measure(scene)
        self._equalities = Equalities(self._model, self._data, self.units, self.size)
        self.unaccounted = tuple(unaccounted(self._model, self._roots, report))
        self.begin(scene)
        self.unaccounted += tuple(self._changing(report, self._data.act == stated))
        self._watched = tuple(self._force_watches(report))
        self._leave_out(report)
        self.keep_offsets()

    def _place(self, key: str | None) -> None:
        model, names = self._model, [self._model.key(k).name or f"{k}" for k in range(self._model.nkey)]
        if key is None and names:
            key = names[0]
        if key in names:
            mujoco.mj_resetDataKeyframe(model, self._data, names.index(key))

    def _group(self, scene: Scene) -> None:
        """Group bodies that are fixed to each other."""
        model = self._model
        root = [0] * model.nbody
        for k, parent in enumerate(model.body_parentid.tolist()):
            root[k] = k if model.body_jntnum[k] else root[parent]
        self._roots = [k for k in range(1, model.nbody) if root[k] == k]
        self._members = [np.flatnonzero(np.array(root) == k) for k in self._roots]
        taken = ["ground"]
        for k in self._roots:
            taken.append(unique_name(model.body(k).name, f"body_{k}", taken))
        self.names = names_of_wholes(taken[1:], scene.mechanism.body_names)

    def _measure(self, scene: Scene) -> None:
        """Set names, units and ranges of velocities."""
        model = self._model
        slides = model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE
        hinges = model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE
        self.size = scene.mechanism.size
        self.motions = tuple(element_name(self._model, "joint", int(k)) for k in model.dof_jntid)
        self.lengths = slides[model.dof_jntid]
        self.ranges = np.full(model.nv, 3.0)
        for dof, joint in enumerate(model.dof_jntid.tolist()):
            if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE and dof < model.jnt_dofadr[joint] + 3:
                self.lengths[dof] = True
            if np.sum(hinges & (model.jnt_bodyid == model.jnt_bodyid[joint])) > 1:
                self.ranges[dof] = MAX_HINGE_ROW_ANGLE
        self.units = np.where(self.lengths, self.size, 1.0)

    def _force_watches(self, report: ImportReport) -> Iterator[tuple[str, str, int, Bounds]]:
        """Yield element, kind, number and watch of each limited force in the report."""
        model = self._model
        for topic, kind, count in (
            ("limit of the force", "actuator", model.nactuator),
            ("limit of actuator forces", "joint", model.njnt),
        ):
            numbers = {element_name(model, kind, k): k for k in range(count)}
            for entry, watches in ((report.entries[n], each) for n, each in report.watches.items()):
                if entry.topic == topic:
                    for watch in watches:
                        assert isinstance(watch, Bounds)
                        yield entry.element, kind, numbers[entry.element], watch

    def _changing(self, report: ImportReport, kept: Array) -> Iterator[str]:
        """Yield actuators of the scene whose activations change at the start.

        `kept` (na,) is False for activations that differ from the keyframe's.
        """
        model, data, without = self._model, self._data, without_force(report)
        self._go(self.start, self._velocity)
        for k in np.flatnonzero(model.actuator_actnum).tolist():
            first, name = int(model.actuator_actadr[k]), element_name(model, "actuator", k)
            rows = slice(first, first + int(model.actuator_actnum[k]))
            # rates of resting activations are exactly 0: differences of equal numbers
            if name not in without and np.any(data.act_dot[rows][kept[rows]]):
                yield f"{name}: its activation changes"

    def _leave_out(self, report: ImportReport) -> None:
        """Switch off the elements and topics that the report leaves out."""
        model, without = self._model, left_out(report)
        counts = {
            "joint": model.njnt,
            "equality": model.neq,
            "tendon": model.ntendon,
            "actuator": model.nactuator,
        }
        numbers = {element_name(model, kind, k): (kind, k) for kind, n in counts.items() for k in range(n)}
        for element, topics in without.items():
            kind, k = numbers.get(element, (element, -1))
            for topic in topics:
                if kind == "equality":
                    self._equalities.active[k] = 0
                else:
                    switch_off(model, kind, k, topic)

    # Quantities by MuJoCo

    def _go(self, q: Array, v: Array) -> None:
        model, data = self._model, self._data
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fwdActuation(model, data)

    def moved(self, q: Array, step: Array) -> Array:
        q = q.copy()
        mujoco.mj_integratePos(self._model, q, step, 1.0)
        return q

    def difference(self, q: Array, other: Array) -> Array:
        step = np.zeros(self._model.nv)
        mujoco.mj_differentiatePos(self._model, step, 1.0, q, other)
        return step

    def points(self, q: Array) -> Array:
        self._go(q, np.zeros(self._model.nv))
        return np.concatenate([self._data.xipos[self._model.body_weldid != 0], self._data.xanchor])

    def mass_properties(self) -> MassProperties:
        model, data = self._model, self._data
        self._go(self.start, np.zeros(model.nv))
        masses, centers, inertias = [], [], []
        for members, center in zip(self._members, self._centers(), strict=True):
            mass = model.body_mass[members]
            axes, arms = data.ximat[members].reshape(-1, 3, 3), data.xipos[members] - center
            about = np.einsum("kij,kj,klj->il", axes, model.body_inertia[members], axes)
            spread = np.einsum("k,ki,kj->ij", mass, arms, arms)
            masses.append(mass.sum())
            centers.append(center)
            inertias.append(about + np.trace(spread) * np.eye(3) - spread)
        return MassProperties(np.array(masses), np.array(centers), np.array(inertias))

    def _centers(self) -> Array:
        """Return centers of mass (b, 3) of the groups, m, after `_go`."""
        mass, places = self._model.body_mass, self._data.xipos
        return np.array([mass[k] @ places[k] / max(mass[k].sum(), 1e-300) for k in self._members])

    def kinematics(self, q: Array, v: Array) -> Kinematics:
        model, data = self._model, self._data
        self._go(q, v)
        centers = self._centers()
        rows, drift, found = np.zeros((len(centers), 6, model.nv)), np.zeros((len(centers), 6)), np.zeros(6)
        # mj_jacDot is not used: it is wrong for a slide above a ball or hinge of the same body
        data.qacc[:] = 0.0
        mujoco.mj_rnePostConstraint(model, data)
        weight = data.cacc[0, 3:]
        for k, (root, center) in enumerate(zip(self._roots, centers, strict=True)):
            mujoco.mj_jac(model, data, rows[k, :3], rows[k, 3:], center, root)
            mujoco.mj_objectAcceleration(model, data, mujoco.mjtObj.mjOBJ_BODY, root, found, 0)
            arm, omega = center - data.xipos[root], rows[k, 3:] @ v
            linear = found[3:] - weight + cross(found[:3], arm) + cross(omega, cross(omega, arm))
            drift[k] = np.concatenate([linear, found[:3]])
        turns = data.xmat[self._roots].reshape(-1, 3, 3).copy()
        return Kinematics(centers, turns, rows, drift)

    def constraints(self, q: Array) -> Constraints:
        return self._equalities.constraints(q)

    def keep_offsets(self) -> None:
        self._equalities.keep_offsets(self.start)

    def mass_matrix(self, q: Array) -> tuple[Array, Array]:
        model, joints = self._model, np.diag(self._model.dof_armature)
        others = np.any(model.tendon_armature) or np.any(model.actuator_armature)
        bare = self._full(q)
        return bare - joints, joints + (self._full(q, "tendon", "actuator") - bare if others else 0.0)

    def _full(self, q: Array, *kinds: str) -> Array:
        """Return MuJoCo's mass matrix (nv, nv) with armatures of joints and of these kinds of elements."""
        model, mass = self._model, np.zeros((self._model.nv, self._model.nv))
        kept = {kind: getattr(model, f"{kind}_armature").copy() for kind in ("tendon", "actuator")}
        for kind in kept:
            if kind not in kinds:
                getattr(model, f"{kind}_armature")[:] = 0.0
        self._data.qpos[:] = q
        mujoco.mj_fwdPosition(model, self._data)
        mujoco.mj_fullM(model, self._data, mass)
        for kind, values in kept.items():
            getattr(model, f"{kind}_armature")[:] = values
        return mass

    def forces(self, q: Array, v: Array) -> Forces:
        data = self._data
        self._go(q, np.zeros(len(v)))
        weight = -data.qfrc_bias
        self._go(q, v)
        springs, dampers = data.qfrc_spring.copy(), data.qfrc_damper.copy()
        others = data.qfrc_passive - springs - dampers
        others[
            np.abs(others) <= PASSIVE_ROUND_OFF * np.abs(springs) + PASSIVE_ROUND_OFF * np.abs(dampers)
        ] = 0.0
        return Forces(weight, springs, dampers, data.qfrc_actuator + others, data.qfrc_bias + weight)

    def force_limits(self, q: Array, v: Array) -> list[ForceLimit]:
        model, data = self._model, self._data
        self._go(q, v)
        found = []
        for element, kind, k, watch in self._watched:
            if kind == "actuator":
                force, limits = data.actuator_force[model.actuator_outadr[k]], model.actuator_forcerange[k]
            else:
                force, limits = data.qfrc_actuator[model.jnt_dofadr[k]], model.jnt_actfrcrange[k]
            found.append(ForceLimit(element, watch, float(force), *(float(x) for x in limits)))
        return found

    def energies(self, q: Array, v: Array) -> tuple[float, float]:
        self._go(q, v)
        mujoco.mj_energyPos(self._model, self._data)
        mujoco.mj_energyVel(self._model, self._data)
        potential, kinetic = self._data.energy
        return float(kinetic), float(potential)

    # One element at a time

    def elements(self, samples: Sequence[Sample]) -> Iterator[tuple[str, list[list[Array]]]]:
        model = self._model
        whole = {f"{kind}_{field}" for kind, fields in FORCE_ARRAYS.items() for field in fields}
        kept = {name: getattr(model, name).copy() for name in whole}
        gravity = model.opt.gravity.copy()
        for name in whole:
            getattr(model, name)[:] = 0.0
        along = []
        for axis in np.eye(3):
            model.opt.gravity[:] = axis
            weights = self._alone(samples)
            for forces in weights:
                forces[1:] = 0.0
            along.append(weights)
        yield "gravity", along
        model.opt.gravity[:] = 0.0
        for kind, fields in FORCE_ARRAYS.items():
            count = model.njnt if kind == "dof" else len(kept[f"{kind}_{fields[0]}"])
            for k in range(count):
                rows = model.dof_jntid == k if kind == "dof" else np.arange(count) == k
                if not any(np.any(kept[f"{kind}_{field}"][rows]) for field in fields):
                    continue
                for field in fields:
                    getattr(model, f"{kind}_{field}")[rows] = kept[f"{kind}_{field}"][rows]
                what = {"jnt": ": stiffness", "dof": ": damping"}.get(kind, "")
                yield (
                    element_name(self._model, "joint" if what else kind, k) + what,
                    self._ways(kind, k, samples, gravity),
                )
                for field in fields:
                    getattr(model, f"{kind}_{field}")[rows] = 0.0
        for name, values in kept.items():
            getattr(model, name)[:] = values
        model.opt.gravity[:] = gravity

    def _ways(self, kind: str, k: int, samples: Sequence[Sample], gravity: Array) -> list[list[Array]]:
        """Return the forces of an element alone, for each way in which a fault may change them."""
        model = self._model
        if kind == "body":  # gravity compensation without weight
            model.opt.gravity[:] = gravity
            found = self._alone(samples)
            model.opt.gravity[:] = 0.0
            for forces in found:
                forces[0] = 0.0
            return [found]
        ways = [self._alone(samples)]
        if kind == "tendon":
            model.tendon_lengthspring[k] += self.size
            ways.append(self._alone(samples))
            model.tendon_lengthspring[k] -= self.size
        if kind == "actuator" and model.actuator_trntype[k] == mujoco.mjtTrn.mjTRN_SITE:
            gear = model.actuator_gear[k].copy()
            for axis in np.flatnonzero(gear):
                model.actuator_gear[k] = np.where(np.arange(len(gear)) == axis, gear, 0.0)
                ways.append(self._alone(samples))
            model.actuator_gear[k] = gear
        return ways

    def _alone(self, samples: Sequence[Sample]) -> list[Array]:
        return [np.array(self.forces(sample.q, sample.v)[:-1]) for sample in samples]

    def rotors(self, samples: Sequence[Sample]) -> Iterator[tuple[str, list[Array]]]:
        model = self._model
        for joint in range(model.njnt):
            alone = np.where(model.dof_jntid == joint, model.dof_armature, 0.0)
            if np.any(alone):
                yield element_name(self._model, "joint", joint), [np.diag(alone)] * len(samples)
        bodies = [self._full(sample.q) for sample in samples]
        for kind in ("tendon", "actuator"):
            inertia = getattr(model, f"{kind}_armature")
            kept = inertia.copy()
            for k in np.flatnonzero(kept):
                inertia[:] = 0.0
                inertia[k] = kept[k]
                full = [self._full(sample.q, kind) for sample in samples]
                yield (
                    element_name(self._model, kind, int(k)),
                    [m - m0 for m, m0 in zip(full, bodies, strict=True)],
                )
            inertia[:] = kept
