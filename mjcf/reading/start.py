"""Compiled MJCF model at its start state: a keyframe or qpos0, moved so that all loops are closed.

`ModelAtStart` holds MuJoCo's model and data. All modules of the reader take element values from this model
and positions from this data. The base class `FileStart` closes the loops by Newton steps on the equality
constraints. For this purpose, `ModelAtStart` provides residuals and Jacobian of MuJoCo's equalities, and
their units.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any, Self

import mujoco
import numpy as np

from mjcf.evaluate import constraint_jacobian
from mjcf.layout import element_name
from mjcf.loops import closure_ends
from mjcf.reading.xml_scan import SourceError
from newton_euler.equations.loop_closure import FileStart, Units, reach
from newton_euler.errors import choices
from newton_euler.model.mechanism import characteristic_length
from newton_euler.reading.import_report import ImportReport
from newton_euler.scalars import Array

TORQUE_SCALE_INDEX = 10
"""Index, in `eq_data` of a weld, of `torquescale`: MuJoCo's factor of the weld's rotational residuals."""

SWITCHED_OFF_FEATURES = ("CONTACT", "LIMIT", "FRICTIONLOSS", "WARMSTART")
"""MuJoCo's names of features that imported models (`Scene`) do not have, and of its solver's warm start, by
which results would depend on earlier ones."""


CONSTRAINT_FEATURES = ("CONTACT", "EQUALITY", "FRICTIONLOSS", "LIMIT")
"""MuJoCo's names of features that the flag "CONSTRAINT" disables, too."""

PASSIVE_FEATURES = ("SPRING", "DAMPER")
"""MuJoCo's names of passive forces. A file that disables both disables all passive forces."""


@dataclass(frozen=True, eq=False)
class ModelToImport:
    """Copy of a compiled model for one or several imports, which do not change it.

    Attributes:
        model: MuJoCo's model without contacts, limits and dry friction.
        flags_of_file: `disableflags` of the compiled model, the features that the file itself disables.
    """

    model: Any
    flags_of_file: int

    @classmethod
    def of(cls, compiled_model: Any) -> Self:
        """Copy a compiled model, and switch off `SWITCHED_OFF_FEATURES`."""
        found = cls(copy.copy(compiled_model), int(compiled_model.opt.disableflags))
        model = found.model
        model.opt.disableflags |= sum(
            int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{feature}")) for feature in SWITCHED_OFF_FEATURES
        )
        # otherwise MuJoCo replaces inertial frames that are nearly the body frame by the body frame. Simple
        # bodies keep this, because MuJoCo also takes their mass matrix, as diagonal, in the body frame
        model.body_sameframe[model.body_simple == 0] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
        if found.disabled("GRAVITY"):
            model.opt.gravity[:] = 0.0
        return found

    def disabled(self, feature: str) -> bool:
        """Return True if the file itself disables a feature, such as "GRAVITY", by `<flag>`.

        The flag "CONSTRAINT" disables each of `CONSTRAINT_FEATURES`.
        """
        flags = [feature, "CONSTRAINT"] if feature in CONSTRAINT_FEATURES else [feature]
        return any(
            self.flags_of_file & int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag}")) for flag in flags
        )


class ModelAtStart(FileStart):
    """Compiled model at its start state.

    Attributes:
        path: file of the model, for messages.
        model: MuJoCo's model without contacts, limits and dry friction.
        data: MuJoCo's data at the start state, after `mj_fwdVelocity`.
        key: name of the keyframe in reports, or "qpos0".
        disabled: function `ModelToImport.disabled`.
    """

    error = SourceError
    """Class of the error that `FileStart` raises for loops that do not close."""

    def __init__(
        self,
        path: str,
        imported: ModelToImport,
        key: str | None,
        report: ImportReport,
        tolerance: float,
        control: Array | None = None,
    ) -> None:
        """Close the loops near a keyframe.

        Args:
            path: file of the model.
            imported: model of the file.
            key: name of the keyframe; None for the first one, or for qpos0 without keyframes.
            report: report that receives lines about the start.
            tolerance: a constraint counts as redundant if the part of its dimensionless Jacobian row that the
                other rows do not span is shorter than this (`redundancy_tolerance` of the later scene).
            control: (nu,) controls; None for the controls of the keyframe.

        Raises:
            SourceError: for an unknown keyframe, and for loops that do not close.
        """
        self.path, self.model, self.disabled = path, imported.model, imported.disabled
        model = self.model
        self.data: Any = mujoco.MjData(model)
        # set the state of the keyframe, and close the loops
        self.key = self._place(key)
        if control is not None:
            self.data.ctrl[:] = control
        mujoco.mj_normalizeQuat(model, self.data.qpos)
        data = self.data
        # `closed` (base class) returns the configuration, lines for the report, and a record of how far the
        # start has moved
        data.qpos[:], lines, report.moved = self.closed(np.array(data.qpos), self.key, tolerance)
        report.start.extend(lines)
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)

    def _place(self, key: str | None) -> str:
        """Set the state to a keyframe or qpos0; return the name of the keyframe in reports.

        A keyframe without a name is selected by its number, such as "0".
        """
        model, data = self.model, self.data
        names = [model.key(k).name or f"{k}" for k in range(model.nkey)]
        if key is None:
            key = names[0] if names else "qpos0"
        if key in names:
            number = names.index(key)
            mujoco.mj_resetDataKeyframe(model, data, number)
            return key if model.key(number).name else f"keyframe {number}"
        if key == "qpos0":
            mujoco.mj_resetData(model, data)
        else:
            raise SourceError(self.path, f"no keyframe {key!r}; {choices(key, ['qpos0', *names])}")
        return key

    def residuals(self, q: Array) -> tuple[Array, Array]:
        """Compute residuals (k,) of the equalities, m or rad, and their Jacobian (k, nv), at qpos q (nq,)."""
        model, data = self.model, self.data
        data.qpos[:] = q
        mujoco.mj_fwdPosition(model, data)
        rows, factors = self._equality_rows(), self._row_factors()
        return data.efc_pos[rows] / factors, constraint_jacobian(model, data)[rows] / factors[:, None]

    @property
    def owners(self) -> list[str]:  # type: ignore[override]
        """Name of the equality of each residual, as reports print it."""
        return [self.equality(int(index)) for index in self.data.efc_id[self._equality_rows()]]

    def _equality_rows(self) -> Array:
        """Return the numbers (k,) of MuJoCo's constraint rows (efc) that belong to equalities."""
        return np.flatnonzero(self.data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY)

    def _row_factors(self) -> Array:
        """Return MuJoCo's factors (k,) of residuals: `torquescale` for angles of welds, 1 for others."""
        model, equality_of_row = self.model, self.data.efc_id[self._equality_rows()]
        factors = np.ones(len(equality_of_row))
        for weld in np.flatnonzero(model.eq_type == mujoco.mjtEq.mjEQ_WELD):
            # a weld has three rows of translations, then three of rotations
            rotational = np.flatnonzero(equality_of_row == weld)[3:]
            # MuJoCo drops the rotational rows of a weld with the factor 0
            factors[rotational] = model.eq_data[weld, TORQUE_SCALE_INDEX] or 1.0
        return factors

    def units(self) -> Units:
        """Return units of velocities (nv,) and of residuals (k,), which make loop closure dimensionless."""
        model, data = self.model, self.data
        # velocities: 1 rad/s for rotations; for translations the size of the mechanism, m, per second: the
        # largest distance of a moving center of mass or a joint from their mean
        movable = data.xipos[np.flatnonzero(model.body_weldid)]
        is_rotation = np.any(data.cdof[:, :3] != 0.0, axis=1)  # `cdof`: angular, then linear velocity
        velocity_units = np.where(is_rotation, 1.0, characteristic_length([*movable, *data.xanchor]))
        # residuals of couplings (equalities of joint coordinates or tendons): norm of the Jacobian row in
        # these units
        _, jacobian = self.residuals(np.array(data.qpos))
        row_units = np.linalg.norm(jacobian * velocity_units, axis=1)
        # residuals of loop closures: the largest motion that one unit velocity gives to the closing point on
        # one of the two bodies alone, see `reach`; motions of both bodies can cancel in the row
        equality_of_row = data.efc_id[self._equality_rows()]
        for equality in np.unique(equality_of_row):
            kind = mujoco.mjtEq(model.eq_type[equality])
            if kind not in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD):
                continue
            rows = np.flatnonzero(equality_of_row == equality)
            body_jacobians, levers = [], []
            for body, point in zip(*closure_ends(model, data, equality), strict=True):
                jacobian_of_body = np.zeros((6, model.nv))
                mujoco.mj_jacBodyCom(model, data, jacobian_of_body[:3], jacobian_of_body[3:], body)
                body_jacobians.append(jacobian_of_body)
                levers.append(float(np.linalg.norm(point - data.xipos[body])))
            row_units[rows[:3]], row_units[rows[3:]] = reach(body_jacobians, levers, velocity_units)
        return Units(velocity_units, np.where(row_units > 0.0, row_units, 1.0))

    def centers(self) -> Array:
        """Return the centers of mass (nbody, 3) of MuJoCo's bodies, m, world frame; they show `FileStart` how
        far the start has moved."""
        return np.array(self.data.xipos)

    def center_names(self) -> list[str]:
        """Return the names of MuJoCo's bodies, in the order of `centers`."""
        return [self.model.body(number).name for number in range(self.model.nbody)]

    def moved(self, q: Array, step: Array) -> Array:
        """Return the configuration (nq,) that velocities `step` (nv,) reach from q (nq,) in 1 s."""
        q = q.copy()
        mujoco.mj_integratePos(self.model, q, step, 1.0)
        return q

    def difference(self, q: Array, other: Array) -> Array:
        """Return the velocities (nv,) that lead from configuration q (nq,) to `other` (nq,) in 1 s."""
        step = np.zeros(self.model.nv)
        mujoco.mj_differentiatePos(self.model, step, 1.0, q, other)
        return step

    def joint_of(self, dof: int) -> str:
        """Return the name of the joint that velocity number `dof` belongs to."""
        number = int(self.model.dof_jntid[dof])
        return self.model.joint(number).name or f"number {number}"

    def equality(self, index: int) -> str:
        """Return the name of an equality in reports."""
        return element_name(self.model, "equality", index)
