"""Start of a compiled model: a keyframe or qpos0, with closed loops."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from mjcf.evaluate import constraint_jacobian
from mjcf.layout import element_name
from mjcf.loops import closure_ends
from mjcf.reading.source import SourceError
from newton_euler.equations.loop_closure import FileStart, Units, reach
from newton_euler.errors import choices
from newton_euler.model.mechanism import spread
from newton_euler.reading.import_report import ImportReport
from newton_euler.scalars import Array

TORQUE_SCALE_PLACE = 10
"""Index of the factor of angles, `torquescale`, in `eq_data` of a weld."""

SWITCHED_OFF_FEATURES = ("CONTACT", "LIMIT", "FRICTIONLOSS", "WARMSTART")
"""Features of MuJoCo that scenes do not simulate."""


class ModelAtStart(FileStart):
    """Compiled model at its start.

    Attributes:
        model: model without contacts, limits and dry friction.
        data: state at the start, after `mj_fwdVelocity`.
        key: name of the keyframe in reports, or "qpos0".
    """

    error = SourceError

    def __init__(
        self,
        path: str,
        model: Any,
        key: str | None,
        report: ImportReport,
        tolerance: float,
        control: Array | None = None,
    ) -> None:
        """Close the loops near a keyframe.

        Args:
            path: file of the model.
            model: compiled model, which is changed.
            key: name of the keyframe; None for the first one, or for qpos0 without keyframes.
            report: report that receives lines about the start.
            tolerance: `redundancy_tolerance` of the scene.
            control: (nu,) controls; None for the controls of the keyframe.

        Raises:
            SourceError: for an unknown keyframe, and for loops that do not close.
        """
        self.path, self.model = path, model
        self.data: Any = mujoco.MjData(model)
        self._disabled = int(model.opt.disableflags)
        model.opt.disableflags |= sum(
            int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{n}")) for n in SWITCHED_OFF_FEATURES
        )
        # otherwise MuJoCo replaces inertial frames that are nearly the body frame
        model.body_sameframe[model.body_simple == 0] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
        if self.disabled("GRAVITY"):
            model.opt.gravity[:] = 0.0
        self.key = self._place(key)
        if control is not None:
            self.data.ctrl[:] = control
        mujoco.mj_normalizeQuat(model, self.data.qpos)
        data = self.data
        data.qpos[:], lines, report.moved = self.closed(np.array(data.qpos), self.key, tolerance)
        report.start.extend(lines)
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)

    def disabled(self, feature: str) -> bool:
        """True if the file itself disables a feature."""
        return bool(self._disabled & int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{feature}")))

    def _place(self, key: str | None) -> str:
        """Set the state to a keyframe or qpos0; return its name in reports."""
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
        """Compute residuals (k,) of the equalities, m or rad, and their Jacobian (k, nv)."""
        model, data = self.model, self.data
        data.qpos[:] = q
        mujoco.mj_fwdPosition(model, data)
        rows, scales = self._rows(), self._scales()
        return data.efc_pos[rows] / scales, constraint_jacobian(model, data)[rows] / scales[:, None]

    @property
    def owners(self) -> list[str]:  # type: ignore[override]
        """Equality of each residual."""
        return [self.equality(int(index)) for index in self.data.efc_id[self._rows()]]

    def _rows(self) -> Array:
        return np.flatnonzero(self.data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY)

    def _scales(self) -> Array:
        """Return MuJoCo's factors (k,) of rows: `torquescale` for angles of welds, 1 for others."""
        model, numbers = self.model, self.data.efc_id[self._rows()]
        scales = np.ones(len(numbers))
        for weld in np.flatnonzero(model.eq_type == mujoco.mjtEq.mjEQ_WELD):
            turning = np.flatnonzero(numbers == weld)[3:]
            scales[turning] = model.eq_data[weld, TORQUE_SCALE_PLACE] or 1.0  # a factor of 0 leaves no rows
        return scales

    def units(self) -> Units:
        model, data = self.model, self.data
        movable = data.xipos[np.flatnonzero(model.body_weldid)]
        turning = np.any(data.cdof[:, :3] != 0.0, axis=1)
        velocities = np.where(turning, 1.0, spread([*movable, *data.xanchor]))
        _, jacobian = self.residuals(np.array(data.qpos))
        rows = np.linalg.norm(jacobian * velocities, axis=1)
        numbers = data.efc_id[self._rows()]
        for index in np.unique(numbers):
            if mujoco.mjtEq(model.eq_type[index]) in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD):
                own = np.flatnonzero(numbers == index)
                motions, levers = [], []
                for body, point in zip(*closure_ends(model, data, index), strict=True):
                    motion = np.zeros((6, model.nv))
                    mujoco.mj_jacBodyCom(model, data, motion[:3], motion[3:], body)
                    motions.append(motion)
                    levers.append(float(np.linalg.norm(point - data.xipos[body])))
                rows[own[:3]], rows[own[3:]] = reach(motions, levers, velocities)
        return Units(velocities, np.where(rows > 0.0, rows, 1.0))

    def centers(self) -> Array:
        return np.array(self.data.xipos)

    def center_names(self) -> list[str]:
        return [self.model.body(number).name for number in range(self.model.nbody)]

    def moved(self, q: Array, step: Array) -> Array:
        moved = q.copy()
        mujoco.mj_integratePos(self.model, moved, step, 1.0)
        return moved

    def difference(self, q: Array, other: Array) -> Array:
        step = np.zeros(self.model.nv)
        mujoco.mj_differentiatePos(self.model, step, 1.0, q, other)
        return step

    def joint_of(self, dof: int) -> str:
        number = int(self.model.dof_jntid[dof])
        return self.model.joint(number).name or f"number {number}"

    def equality(self, index: int) -> str:
        """Return the name of an equality in reports."""
        return element_name(self.model, "equality", index)
