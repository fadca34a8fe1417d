"""Check the import report of an MJCF file against the compiled model, for `mjcf.reference`.

An import report lists how the reader imported every element of a file, and which elements the reader left
out: whole elements, or one topic of an element, such as "armature". `unaccounted` lists acting elements that
the report does not mention. `switch_off_left_out` switches off in the compiled model what the report leaves
out, so that the rest of the model can be compared with the imported scene. `Equalities` computes residuals
and Jacobian of MuJoCo's equality constraints by MuJoCo's own functions. The module shares only the names of
elements with the reader, so that a mistake of the reader is not repeated here.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import mujoco
import numpy as np

from mjcf.layout import element_name
from newton_euler.reading.import_report import ImportReport, topics_not_simulated
from newton_euler.reading.quantities import Constraints
from newton_euler.scalars import Array

TORQUE_SCALE_INDEX = 10
"""Index, in `eq_data` of a weld, of `torquescale`: MuJoCo's factor of the weld's rotational residuals."""

WELD_ANCHORS_AND_POSE = slice(0, 10)
"""Part of `eq_data` of a weld: anchor in body 2, anchor in body 1, orientation of body 2 in body 1."""


def unaccounted(model: Any, roots: Sequence[int], report: ImportReport) -> Iterator[str]:
    """Yield the names of acting elements that a report does not mention.

    Args:
        model: compiled model.
        roots: numbers of the bodies that have joints; bodies without joints are fixed to their parents.
        report: report to check.
    """
    mentioned = {entry.element for entry in report.entries}
    acting_tendons = model.tendon_armature != 0.0
    for feature, values in (("SPRING", model.tendon_stiffness), ("DAMPER", model.tendon_damping)):
        if not model.opt.disableflags & int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{feature}")):
            acting_tendons |= values != 0.0
    numbers_by_kind = {
        "joint": range(model.njnt),
        "equality": range(model.neq),
        "actuator": range(model.nactuator),
        "body": roots,
        "tendon": np.flatnonzero(acting_tendons).tolist(),
    }
    for kind, numbers in numbers_by_kind.items():
        for number in numbers:
            name = element_name(model, kind, number)
            if name not in mentioned:
                yield name


def elements_left_out(report: ImportReport) -> set[str]:
    """Return the names of the elements that a report leaves out entirely, with all their topics."""
    return {entry.element for entry in report.of("left out") if not entry.topic}


def switch_off(model: Any, kind: str, k: int, topic: str) -> None:
    """Switch off one topic of an element in a compiled model, because the report leaves the topic out.

    Args:
        model: compiled model, which is changed.
        kind: kind of the element, such as "joint"; for elements without number, the whole name in the report,
            such as "option wind". Equalities are not switched off here, but by `Equalities.active`.
        k: number of the element.
        topic: property in the report, such as "armature"; "" for the whole element.
    """
    match kind, topic:
        case "joint", "not linear":
            model.jnt_stiffnesspoly[k] = 0.0
            model.dof_dampingpoly[model.dof_jntid == k] = 0.0
        case "joint", "limits":
            model.jnt_limited[k] = 0
        case "joint", "dry friction":
            model.dof_frictionloss[model.dof_jntid == k] = 0.0
        case "tendon", "limits":
            model.tendon_limited[k] = 0
        case "tendon", "dry friction":
            model.tendon_frictionloss[k] = 0.0
        case "joint", "limit of actuator forces":
            model.jnt_actfrclimited[k] = 0
        case "tendon", "not linear":
            model.tendon_stiffnesspoly[k] = model.tendon_dampingpoly[k] = 0.0
        case "tendon", "armature":
            model.tendon_armature[k] = 0.0
        case "tendon", "":
            model.tendon_stiffness[k] = model.tendon_damping[k] = 0.0
            model.tendon_stiffnesspoly[k] = model.tendon_dampingpoly[k] = 0.0
        case "actuator", "":
            # gain and bias types are changed, too: DC motors divide by parameters, which are set to zero here
            model.actuator_gaintype[k] = mujoco.mjtGain.mjGAIN_FIXED
            model.actuator_biastype[k] = mujoco.mjtBias.mjBIAS_NONE
            model.actuator_gainprm[k] = model.actuator_biasprm[k] = model.actuator_gear[k] = 0.0
            model.actuator_armature[k] = 0.0
            model.actuator_damping[k] = model.actuator_dampingpoly[k] = 0.0
            model.actuator_dyntype[k] = mujoco.mjtDyn.mjDYN_NONE  # the activation stays constant
        case "actuator", "armature":
            model.actuator_armature[k] = 0.0
        case "actuator", "damping":
            model.actuator_damping[k] = model.actuator_dampingpoly[k] = 0.0
        case "actuator", "limit of the force":
            model.actuator_forcelimited[k] = 0
        case "actuator", "limit of its tendon":
            model.tendon_actfrclimited[model.actuator_trnid[k, 0]] = 0
        case _, "density" | "viscosity":
            setattr(model.opt, topic, 0.0)
        case "option wind", _:
            model.opt.wind[:] = 0.0
        case _ if kind.endswith("flexes"):  # one entry for all deformable bodies, such as "2 flexes"
            for field in ("stiffness", "bending", "edgestiffness", "damping", "edgedamping"):
                getattr(model, f"flex_{field}")[:] = 0.0


def switch_off_left_out(model: Any, report: ImportReport) -> list[int]:
    """Switch off the elements and topics that the report leaves out.

    Returns:
        Numbers of the equalities among these elements, which are not switched off yet.
    """
    counts = {
        "joint": model.njnt,
        "equality": model.neq,
        "tendon": model.ntendon,
        "actuator": model.nactuator,
    }
    numbers = {element_name(model, kind, k): (kind, k) for kind, n in counts.items() for k in range(n)}
    equalities = []
    for element, topics in topics_not_simulated(report).items():
        kind, k = numbers.get(element, (element, -1))  # -1: an element without number
        for topic in topics:
            if kind == "equality":
                equalities.append(k)
            else:
                switch_off(model, kind, k, topic)
    return equalities


class Equalities:
    """Dimensionless residuals and Jacobian of the equality constraints of a compiled model.

    Attributes:
        active: (neq,) 0 for equalities that are switched off.
    """

    def __init__(self, model: Any, data: Any, units: Array, size: float) -> None:
        """Take a compiled model and its data; the methods change both.

        Args:
            model: `MjModel`.
            data: `MjData`.
            units: (nv,) units of velocities: `size` for translations, 1 for rotations.
            size: size of the mechanism, m.
        """
        self._model, self._data, self._velocity_units, self._size = model, data, units, size
        self.active = model.eq_active0.copy()
        units_by_equality = [self._units_of_rows(k) for k in range(model.neq)]
        # for each constraint row (k,): number of its equality, and its unit, m or 1
        self._equality_of_row = np.repeat(np.arange(model.neq), [len(rows) for rows in units_by_equality])
        self._row_units = np.concatenate([np.ones(0), *units_by_equality])

    def constraints(self, q: Array) -> Constraints:
        """Return residuals (k,) and Jacobian (k, nv) of all equalities at a configuration q (nq,).

        Rows of equalities that are not active are zero, and so are rows of equalities with a zero Jacobian,
        which MuJoCo drops.
        """
        model, data = self._model, self._data
        data.qpos[:] = q
        data.eq_active[:] = self.active
        mujoco.mj_fwdPosition(model, data)
        # rows of MuJoCo that belong to equalities, without deformable bodies (flexes)
        mujoco_rows = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        mujoco_rows &= np.isin(data.efc_id, self._equality_of_row)
        residual, jacobian = np.zeros(len(self._row_units)), np.zeros((len(self._row_units), model.nv))
        # rows here and rows of MuJoCo are both in the order of the equalities
        present = np.isin(self._equality_of_row, data.efc_id[mujoco_rows])
        residual[present] = data.efc_pos[mujoco_rows]
        jacobian[present] = data.efc_J.reshape(-1, model.nv)[mujoco_rows]
        names = [element_name(self._model, "equality", int(k)) for k in self._equality_of_row]
        return Constraints(
            residual=residual / self._row_units,
            jacobian=jacobian / self._row_units[:, None] * self._velocity_units,
            owners=names,
        )

    def _units_of_rows(self, equality: int) -> Array:
        """Return the units of an equality's rows: `size` (m) for lengths, 1 or `torquescale` for angles."""
        model, size = self._model, self._size
        first = int(model.eq_obj1id[equality])
        match mujoco.mjtEq(model.eq_type[equality]):
            case mujoco.mjtEq.mjEQ_CONNECT:
                return np.full(3, size)
            case mujoco.mjtEq.mjEQ_WELD:
                torque_scale = float(model.eq_data[equality, TORQUE_SCALE_INDEX]) or 1.0
                return np.array([size] * 3 + [torque_scale] * 3)
            case mujoco.mjtEq.mjEQ_JOINT:
                return self._velocity_units[model.jnt_dofadr[first], None]
            case mujoco.mjtEq.mjEQ_TENDON:
                # a fixed tendon is a weighted sum of joint coordinates, a spatial tendon has a length
                is_fixed = model.wrap_type[model.tendon_adr[first]] == mujoco.mjtWrap.mjWRAP_JOINT
                return np.ones(1) if is_fixed else np.full(1, size)
        return np.ones(0)  # equalities of deformable bodies have no rows here

    def keep_offsets(self, start: Array) -> None:
        """Redefine each active equality so that its residual is zero at the configuration `start` (nq,).

        The rounded numbers of a file close its loops only approximately. Scenes keep the remaining offsets.
        """
        # residuals in the units of the file; `constraints` also sets the state in `data` to `start`
        model, data, residuals = self._model, self._data, self.constraints(start).residual
        residuals = residuals * self._row_units
        for k in np.flatnonzero(self.active).tolist():
            kind, eq_data = mujoco.mjtEq(model.eq_type[k]), model.eq_data[k]
            if kind in (mujoco.mjtEq.mjEQ_JOINT, mujoco.mjtEq.mjEQ_TENDON):
                eq_data[0] += residuals[self._equality_of_row == k][0]  # constant term of the polynomial
            elif kind in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD):
                # anchor both bodies at the point on the first body
                point = self._point_on_first(k)
                bodies = self._bodies_of(k)
                in_first, in_second = (
                    data.xmat[body].reshape(3, 3).T @ (point - data.xpos[body]) for body in bodies
                )
                model.eq_objtype[k] = mujoco.mjtObj.mjOBJ_BODY
                model.eq_obj1id[k], model.eq_obj2id[k] = bodies
                if kind == mujoco.mjtEq.mjEQ_CONNECT:
                    eq_data[:6] = [*in_first, *in_second]
                    continue
                # relative orientation conj(q1) q2
                conjugate, relative = np.zeros(4), np.zeros(4)
                mujoco.mju_negQuat(conjugate, data.xquat[bodies[0]])
                mujoco.mju_mulQuat(relative, conjugate, data.xquat[bodies[1]])
                eq_data[WELD_ANCHORS_AND_POSE] = [*in_second, *in_first, *relative]

    def _bodies_of(self, equality: int) -> tuple[int, int]:
        """Return the numbers of the two bodies of a connect or weld."""
        model = self._model
        # numbers of two bodies, or of two sites
        first, second = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
        if model.eq_objtype[equality] == mujoco.mjtObj.mjOBJ_SITE:
            return int(model.site_bodyid[first]), int(model.site_bodyid[second])
        return first, second

    def _point_on_first(self, equality: int) -> Array:
        """Return the constrained point (3,) on the first body of a connect or weld, m, world frame."""
        model, data, first = self._model, self._data, int(self._model.eq_obj1id[equality])
        if model.eq_objtype[equality] == mujoco.mjtObj.mjOBJ_SITE:
            return np.array(data.site_xpos[first])
        # eq_data of a connect begins with the anchor in body 1, eq_data of a weld with the anchor in body 2
        is_connect = model.eq_type[equality] == mujoco.mjtEq.mjEQ_CONNECT
        anchor = model.eq_data[equality, slice(0, 3) if is_connect else slice(3, 6)]
        return np.asarray(data.xpos[first] + data.xmat[first].reshape(3, 3) @ anchor)
