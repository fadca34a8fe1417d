"""A compiled MJCF file held to the report of its reading, element by element.

For `mjcf.reference`: names of elements are all that is shared with the reading. What a report leaves out is
switched off in MuJoCo's model, and equalities are rows of constraints by MuJoCo's own functions, made
dimensionless, with the offsets that are left at the start.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import mujoco
import numpy as np

from mjcf.layout import element_name
from newton_euler.reading.import_report import ImportReport
from newton_euler.reading.quantities import Constraints
from newton_euler.scalars import Array

TORQUE_SCALE = 10
"""Place in `eq_data` of a weld's factor on its angles."""


def unaccounted(model: Any, roots: Sequence[int], report: ImportReport) -> Iterator[str]:
    """Elements that act and that a report says nothing of.

    Args:
        model: as MuJoCo compiled it.
        roots: bodies with joints of their own.
        report: of a reading.
    """
    known = {entry.element for entry in report.entries}
    acting = model.tendon_stiffness != 0.0
    acting |= (model.tendon_damping != 0.0) | (model.tendon_armature != 0.0)
    numbers = {
        "joint": range(model.njnt),
        "equality": range(model.neq),
        "actuator": range(model.nactuator),
        "body": roots,
        "tendon": np.flatnonzero(acting).tolist(),
    }
    names = (element_name(model, kind, k) for kind, each in numbers.items() for k in each)
    yield from (name for name in names if name not in known)


def without_force(report: ImportReport) -> set[str]:
    """Elements that a report says are left out with all that they do."""
    return {entry.element for entry in report.of("left out") if not entry.topic}


def switch_off(model: Any, kind: str, k: int, topic: str) -> None:
    """Switch off what a report says is left out of element number k of a kind other than equalities."""
    match kind, topic:
        case "joint", "not linear":
            model.jnt_stiffnesspoly[k] = 0.0
            model.dof_dampingpoly[model.dof_jntid == k] = 0.0
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
            # motors divide by their parameters, so these cannot all be zero without another type
            model.actuator_gaintype[k] = mujoco.mjtGain.mjGAIN_FIXED
            model.actuator_biastype[k] = mujoco.mjtBias.mjBIAS_NONE
            model.actuator_gainprm[k] = model.actuator_biasprm[k] = model.actuator_gear[k] = 0.0
            model.actuator_armature[k] = 0.0
            model.actuator_damping[k] = model.actuator_dampingpoly[k] = 0.0
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
        case _ if kind.endswith("flexes"):
            for field in ("stiffness", "bending", "edgestiffness", "damping", "edgedamping"):
                getattr(model, f"flex_{field}")[:] = 0.0


class Equalities:
    """All equalities of a compiled file.

    Attributes:
        active: (neq,) 0 for those that hold nothing.
    """

    def __init__(self, model: Any, data: Any, units: Array, size: float) -> None:
        """Take a compiled model and its data, which are changed.

        Args:
            model, data: of MuJoCo.
            units: (nv,) of velocities.
            size: of the scene, m.
        """
        self._model, self._data, self._units, self._size = model, data, units, size
        self.active = model.eq_active0.copy()
        rows = [self._units_of(k) for k in range(model.neq)]
        # (k,) number of the equality that each row is of, and units of the rows, m or 1
        self._owners = np.repeat(np.arange(len(rows)), [len(unit) for unit in rows])
        self._row_units = np.concatenate([np.ones(0), *rows])

    def constraints(self, q: Array) -> Constraints:
        """Rows of the equalities that are not left out."""
        model, data = self._model, self._data
        data.qpos[:] = q
        data.eq_active[:] = self.active
        mujoco.mj_fwdPosition(model, data)
        equalities = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        equalities &= np.isin(data.efc_id, self._owners)  # those of flexes are left out
        residual, jacobian = np.zeros(len(self._row_units)), np.zeros((len(self._row_units), model.nv))
        there = np.isin(self._owners, data.efc_id[equalities])  # MuJoCo drops those of zeros
        residual[there] = data.efc_pos[equalities]
        jacobian[there] = data.efc_J.reshape(-1, model.nv)[equalities]
        names = [element_name(self._model, "equality", int(k)) for k in self._owners]
        return Constraints(
            residual / self._row_units, jacobian / self._row_units[:, None] * self._units, names
        )

    def _units_of(self, equality: int) -> Array:
        """Units of the rows of an equality; those of welds have a `torquescale` too."""
        model, size = self._model, self._size
        first = int(model.eq_obj1id[equality])
        match mujoco.mjtEq(model.eq_type[equality]):
            case mujoco.mjtEq.mjEQ_CONNECT:
                return np.full(3, size)
            case mujoco.mjtEq.mjEQ_WELD:
                scale = float(model.eq_data[equality, TORQUE_SCALE]) or 1.0
                return np.array([size] * 3 + [scale] * 3)
            case mujoco.mjtEq.mjEQ_JOINT:
                return self._units[model.jnt_dofadr[first], None]
            case mujoco.mjtEq.mjEQ_TENDON:
                sums = model.wrap_type[model.tendon_adr[first]] == mujoco.mjtWrap.mjWRAP_JOINT
                return np.ones(1) if sums else np.full(1, size)
        return np.ones(0)  # flexes have no joints

    def keep_offsets(self, start: Array) -> None:
        """Let each equality be closed where it is at a start (nq,), its second end put to the first."""
        model, data, residuals = self._model, self._data, self.constraints(start).residual
        residuals = residuals * self._row_units
        for k in np.flatnonzero(self.active).tolist():
            kind, values = mujoco.mjtEq(model.eq_type[k]), model.eq_data[k]
            if kind in (mujoco.mjtEq.mjEQ_JOINT, mujoco.mjtEq.mjEQ_TENDON):
                values[0] += residuals[self._owners == k][0]
            elif kind in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD):
                point = self._first_end(k)
                ends = self._bodies_of(k)
                first, second = (data.xmat[body].reshape(3, 3).T @ (point - data.xpos[body]) for body in ends)
                model.eq_objtype[k] = mujoco.mjtObj.mjOBJ_BODY
                model.eq_obj1id[k], model.eq_obj2id[k] = ends
                if kind == mujoco.mjtEq.mjEQ_CONNECT:
                    values[:6] = [*first, *second]
                    continue
                back, turn = np.zeros(4), np.zeros(4)
                mujoco.mju_negQuat(back, data.xquat[ends[0]])
                mujoco.mju_mulQuat(turn, back, data.xquat[ends[1]])
                values[:TORQUE_SCALE] = [*second, *first, *turn]

    def _bodies_of(self, equality: int) -> tuple[int, int]:
        """MuJoCo's bodies of a connect or weld."""
        model = self._model
        ends = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
        if model.eq_objtype[equality] == mujoco.mjtObj.mjOBJ_SITE:
            return int(model.site_bodyid[ends[0]]), int(model.site_bodyid[ends[1]])
        return ends

    def _first_end(self, equality: int) -> Array:
        """(3,) the point of a connect or weld on its first body, world frame."""
        model, data, first = self._model, self._data, int(self._model.eq_obj1id[equality])
        if model.eq_objtype[equality] == mujoco.mjtObj.mjOBJ_SITE:
            return np.array(data.site_xpos[first])
        place = 0 if model.eq_type[equality] == mujoco.mjtEq.mjEQ_CONNECT else 3
        arm = model.eq_data[equality, place : place + 3]
        return np.asarray(data.xpos[first] + data.xmat[first].reshape(3, 3) @ arm)
