"""Check the import report against the compiled model.

The module belongs to `mjcf.reference` and shares only the names of elements with the reader. It lists
elements that the report does not mention, switches off what the report leaves out, and computes the
constraint rows of equalities by MuJoCo's own functions. Rows are dimensionless and keep the offsets of loops
at the start.
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

TORQUE_SCALE_PLACE = 10
"""Index of the factor of angles, `torquescale`, in `eq_data` of a weld."""


def unaccounted(model: Any, roots: Sequence[int], report: ImportReport) -> Iterator[str]:
    """Yield the names of acting elements that a report does not mention.

    Args:
        model: compiled model.
        roots: numbers of bodies that have joints.
        report: report to check.
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
    """Return the elements that a report leaves out entirely."""
    return {entry.element for entry in report.of("left out") if not entry.topic}


def switch_off(model: Any, kind: str, k: int, topic: str) -> None:
    """Switch off one topic of element number `k`, which the report leaves out; not for equalities."""
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
            # types are changed too, because motors divide by their parameters
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
    """Equality constraints of a compiled model.

    Attributes:
        active: (neq,) 0 for equalities that are switched off.
    """

    def __init__(self, model: Any, data: Any, units: Array, size: float) -> None:
        """Take a compiled model and its data. Both are changed later.

        Args:
            model: `MjModel`.
            data: `MjData`.
            units: (nv,) units of velocities.
            size: size of the mechanism, m.
        """
        self._model, self._data, self._units, self._size = model, data, units, size
        self.active = model.eq_active0.copy()
        rows = [self._units_of(k) for k in range(model.neq)]
        # (k,) number of the equality and unit, m or 1, of each row
        self._owners = np.repeat(np.arange(len(rows)), [len(unit) for unit in rows])
        self._row_units = np.concatenate([np.ones(0), *rows])

    def constraints(self, q: Array) -> Constraints:
        """Return the rows of all active equalities at a configuration."""
        model, data = self._model, self._data
        data.qpos[:] = q
        data.eq_active[:] = self.active
        mujoco.mj_fwdPosition(model, data)
        equalities = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        equalities &= np.isin(data.efc_id, self._owners)  # rows of flexes are left out
        residual, jacobian = np.zeros(len(self._row_units)), np.zeros((len(self._row_units), model.nv))
        there = np.isin(self._owners, data.efc_id[equalities])  # MuJoCo drops rows of zeros
        residual[there] = data.efc_pos[equalities]
        jacobian[there] = data.efc_J.reshape(-1, model.nv)[equalities]
        names = [element_name(self._model, "equality", int(k)) for k in self._owners]
        return Constraints(
            residual / self._row_units, jacobian / self._row_units[:, None] * self._units, names
        )

    def _units_of(self, equality: int) -> Array:
        """Return the units of the rows of an equality; angles of welds are scaled by `torquescale`."""
        model, size = self._model, self._size
        first = int(model.eq_obj1id[equality])
        match mujoco.mjtEq(model.eq_type[equality]):
            case mujoco.mjtEq.mjEQ_CONNECT:
                return np.full(3, size)
            case mujoco.mjtEq.mjEQ_WELD:
                scale = float(model.eq_data[equality, TORQUE_SCALE_PLACE]) or 1.0
                return np.array([size] * 3 + [scale] * 3)
            case mujoco.mjtEq.mjEQ_JOINT:
                return self._units[model.jnt_dofadr[first], None]
            case mujoco.mjtEq.mjEQ_TENDON:
                sums = model.wrap_type[model.tendon_adr[first]] == mujoco.mjtWrap.mjWRAP_JOINT
                return np.ones(1) if sums else np.full(1, size)
        return np.ones(0)  # equalities of flexes have no rows here

    def keep_offsets(self, start: Array) -> None:
        """Define each equality as closed at a start (nq,): move its second end to the first."""
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
                values[:TORQUE_SCALE_PLACE] = [*second, *first, *turn]

    def _bodies_of(self, equality: int) -> tuple[int, int]:
        """Return the two bodies of a connect or weld."""
        model = self._model
        ends = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
        if model.eq_objtype[equality] == mujoco.mjtObj.mjOBJ_SITE:
            return int(model.site_bodyid[ends[0]]), int(model.site_bodyid[ends[1]])
        return ends

    def _first_end(self, equality: int) -> Array:
        """Return the point (3,) of a connect or weld on its first body, m, world frame."""
        model, data, first = self._model, self._data, int(self._model.eq_obj1id[equality])
        if model.eq_objtype[equality] == mujoco.mjtObj.mjOBJ_SITE:
            return np.array(data.site_xpos[first])
        place = 0 if model.eq_type[equality] == mujoco.mjtEq.mjEQ_CONNECT else 3
        arm = model.eq_data[equality, place : place + 3]
        return np.asarray(data.xpos[first] + data.xmat[first].reshape(3, 3) @ arm)
