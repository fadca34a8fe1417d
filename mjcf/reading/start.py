"""The configuration that a model starts from: a keyframe or qpos0, its equalities closed."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from mjcf.reading.source import SourceError
from newton_euler.equations.dense import largest
from newton_euler.equations.loop_closure import CLOSED, Units, assembled, branch, close, reach
from newton_euler.model.mechanism import spread
from newton_euler.scalars import Array
from newton_euler.verification.import_report import ImportReport

TORQUE_SCALE = 10
"""Where `eq_data` of a weld has the factor on its last three residuals, the vector part of a quaternion."""

MOST_KEYFRAMES = 20
"""That are looked at."""

DISABLED = ("CONTACT", "LIMIT", "FRICTIONLOSS", "WARMSTART")
"""What is outside of rigid dynamics with bilateral constraints."""


class Start:
    """A model and where it starts.

    Attributes:
        path: of the file, for errors.
        model: without contacts, limits and dry friction.
        data: at the start, positions and velocities worked out.
        key: what reports call the keyframe, or "qpos0".
    """

    def __init__(
        self,
        path: str,
        model: Any,
        key: str | None,
        report: ImportReport,
        tolerance: float,
        control: Array | None = None,
    ) -> None:
        """Close the loops near the keyframe of that name; the first one, or qpos0, if None.

        Rows are redundant by the `redundancy_tolerance` of the scene. Actuators have the keyframe's controls
        unless others (nu,) are given.

        Raises:
            SourceError: for an unknown keyframe, and for loops that do not close from there.
        """
        self.path, self.model = path, model
        self.data: Any = mujoco.MjData(model)
        self._disabled = int(model.opt.disableflags)
        model.opt.disableflags |= sum(int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{n}")) for n in DISABLED)
        # frames that are nearly a body's own would be taken for it, as they are in the mass of simple bodies
        model.body_sameframe[model.body_simple == 0] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
        if self.disabled("GRAVITY"):
            model.opt.gravity[:] = 0.0
        others = self._keyframes() if model.nkey > 1 else []
        self.key = self._place(key)
        if control is not None:
            self.data.ctrl[:] = control
        mujoco.mj_normalizeQuat(model, self.data.qpos)
        self._close(report, tolerance)
        if others:
            report.start.append(f"keyframes of the file, as they stand, in m or rad: {'; '.join(others)}")

    def _keyframes(self) -> list[str]:
        """Of each keyframe, whether it closes, and where it is open the most if not."""
        lines = []
        for number in range(min(self.model.nkey, MOST_KEYFRAMES)):
            name = self._place(self.model.key(number).name or f"{number}")
            mujoco.mj_normalizeQuat(self.model, self.data.qpos)
            gaps = self.gaps()
            worst = max(gaps, key=lambda index: gaps[index], default=-1)
            closed = worst < 0 or gaps[worst] <= CLOSED
            lines.append(
                f"{name} closed" if closed else f"{name} open by {gaps[worst]:.3g} at {self.equality(worst)}"
            )
        return lines

    def disabled(self, feature: str) -> bool:
        """True if the file itself switches a feature off."""
        return bool(self._disabled & int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{feature}")))

    def _place(self, key: str | None) -> str:
        """Go to a keyframe or qpos0; what reports call it."""
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
            raise SourceError(self.path, f"no keyframe {key!r}; choose from: {', '.join(['qpos0', *names])}")
        return key

    def gaps(self) -> dict[int, float]:
        """Largest residual (m or rad) of each equality with rows, by its number, at the present qpos."""
        mujoco.mj_fwdPosition(self.model, self.data)
        rows = self._rows()
        gaps: dict[int, float] = {}
        for index, gap in zip(self.data.efc_id[rows], np.abs(self._residuals()), strict=True):
            gaps[int(index)] = max(gaps.get(int(index), 0.0), float(gap))
        return gaps

    def _rows(self) -> Array:
        return np.flatnonzero(self.data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY)

    def _scales(self) -> Array:
        """(k, 1) what MuJoCo has multiplied the equalities' rows with: angles of welds with `torquescale`."""
        model, numbers = self.model, self.data.efc_id[self._rows()]
        scales = np.ones((len(numbers), 1))
        for weld in np.flatnonzero(model.eq_type == mujoco.mjtEq.mjEQ_WELD):
            turning = np.flatnonzero(numbers == weld)[3:]
            scales[turning] = model.eq_data[weld, TORQUE_SCALE] or 1.0  # rows of zeros are none
        return scales

    def _residuals(self) -> Array:
        """(k,) m or rad, of the equalities' rows, after `gaps`."""
        return np.asarray(self.data.efc_pos[self._rows()] / self._scales()[:, 0])

    def jacobian(self) -> Array:
        """(k, nv) of the equalities' rows, after `gaps`."""
        model, data = self.model, self.data
        columns = np.zeros((model.nv, data.nefc))
        for column, unit in zip(columns, np.eye(model.nv), strict=True):
            mujoco.mj_mulJacVec(model, data, column, unit)
        return np.asarray(columns.T[self._rows()] / self._scales())

    def ends(self, index: int) -> tuple[tuple[int, int], tuple[Array, Array]]:
        """MuJoCo's bodies of a connect or weld, and its point as each of them has it, (3,) world."""
        model, data = self.model, self.data
        first, second = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
        if model.eq_objtype[index] == mujoco.mjtObj.mjOBJ_SITE:
            bodies = int(model.site_bodyid[first]), int(model.site_bodyid[second])
            return bodies, (data.site_xpos[first].copy(), data.site_xpos[second].copy())
        anchors = model.eq_data[index][:3], model.eq_data[index][3:6]
        if model.eq_type[index] == mujoco.mjtEq.mjEQ_WELD:
            anchors = anchors[::-1]  # the anchor is in the second body's frame, its place in the first's next
        p, q = (
            data.xpos[body] + data.xmat[body].reshape(3, 3) @ anchor
            for body, anchor in zip((first, second), anchors, strict=True)
        )
        return (first, second), (p, q)

    def _units(self) -> Units:
        """Return the units of the equalities' rows, after `gaps`."""
        model, data = self.model, self.data
        movable = data.xipos[np.flatnonzero(model.body_weldid)]
        turning = np.any(data.cdof[:, :3] != 0.0, axis=1)
        velocities = np.where(turning, 1.0, spread([*movable, *data.xanchor]))
        rows = np.linalg.norm(self.jacobian() * velocities, axis=1)
        numbers = data.efc_id[self._rows()]
        for index in np.unique(numbers):
            if mujoco.mjtEq(model.eq_type[index]) in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD):
                own = np.flatnonzero(numbers == index)
                motions, levers = [], []
                for body, point in zip(*self.ends(index), strict=True):
                    motion = np.zeros((6, model.nv))
                    mujoco.mj_jacBodyCom(model, data, motion[:3], motion[3:], body)
                    motions.append(motion)
                    levers.append(float(np.linalg.norm(point - data.xipos[body])))
                rows[own[:3]], rows[own[3:]] = reach(motions, levers, velocities)
        return Units(velocities, np.where(rows > 0.0, rows, 1.0))

    def _close(self, report: ImportReport, tolerance: float) -> None:
        model, data = self.model, self.data
        first = data.qpos.copy()
        before = self.gaps()
        units = self._units() if before else None
        if units is None or largest(self._residuals() / units.rows) <= CLOSED:
            worst = max(before.values(), default=0.0)
            count = "1 equality" if len(before) == 1 else f"{len(before)} equalities"
            state = f"{count} closed, to {worst:.1e}" if before else "no equalities"
            report.start.append(f"starts from {self.key}: {state}")
            self._finish()
            return
        places, rows_there = data.xipos.copy(), units.jacobian(self.jacobian())
        found = close(first, self._at, self._moved, units, tolerance)
        data.qpos[:] = found.q
        after = self.gaps()
        lines = [f"{self.equality(i)} {gap:.3g}" for i, gap in before.items() if gap > CLOSED]
        if not found.is_closed:
            index = max(after, key=lambda i: after[i])
            raise SourceError(
                self.path,
                f"{self.equality(index)} cannot be closed from {self.key}: open by {before[index]:.3g} "
                f"there, and by {after[index]:.3g} (m or rad) at best",
            )
        moved = np.zeros(model.nv)
        mujoco.mj_differentiatePos(model, moved, 1.0, first, data.qpos)
        side = branch(rows_there, units.jacobian(self.jacobian()), tolerance)
        apart = float(np.max(np.linalg.norm(data.xipos - places, axis=1)))
        report.start.append(f"{self.key} is open, in m or rad: {'; '.join(lines)}")
        joints = [self._joint(dof) for dof in range(model.nv)]
        report.start.extend(assembled(self.key, side, joints, found, moved, apart))
        self._finish()

    def _at(self, qpos: Array) -> tuple[Array, Array]:
        """Residuals (k,) and Jacobian (k, nv) of the equalities at a configuration."""
        self.data.qpos[:] = qpos
        self.gaps()
        return self._residuals(), self.jacobian()

    def _moved(self, qpos: Array, step: Array) -> Array:
        moved = qpos.copy()
        mujoco.mj_integratePos(self.model, moved, step, 1.0)
        return moved

    def _joint(self, dof: int) -> str:
        """Name of the joint that a velocity belongs to."""
        number = int(self.model.dof_jntid[dof])
        return self.model.joint(number).name or f"number {number}"

    def equality(self, index: int) -> str:
        """Name an equality for reports."""
        return f"equality {self.model.equality(index).name or index!r}"

    def _finish(self) -> None:
        mujoco.mj_fwdPosition(self.model, self.data)
        mujoco.mj_fwdVelocity(self.model, self.data)
