"""How far the equalities of a file open when MuJoCo runs it as it stands, with its own solref and solimp."""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np

from mjcf.reading.start import TORQUE_SCALE, Start
from newton_euler.scalars import Array

MOST_STEPS = 1_000
"""Of the file's own step; longer runs are looked at so far."""


class Sag(NamedTuple):
    """Where equalities are open the most in a run.

    Attributes:
        gap: m or rad: distance of the points of a connect; of a weld, distance or angle.
        equality: number of the one that is.
        time: s.
    """

    gap: float
    equality: int
    time: float


def span(start: Start, duration: float) -> float:
    """How much of a run is looked at, s."""
    return min(duration, MOST_STEPS * float(start.model.opt.timestep))


def looked_at(start: Start, duration: float) -> str:
    """What to add where that is not all of it."""
    seen = span(start, duration)
    return f" in its first {seen:g} s" if seen < duration else ""


def sag(start: Start, model: Any, duration: float) -> Sag | str:
    """How far equalities open in a run of so many s, without contacts, limits and dry friction.

    Args:
        start: where it starts.
        model: what is run: its model, or one that differs in what is no part of a state.
        duration: s; no more than `span` of it is looked at.

    Returns:
        Where they do, of the states after all steps, or at which time MuJoCo warns of what.
    """
    data = mujoco.MjData(model)
    for name in ("qpos", "qvel", "act", "ctrl", "mocap_pos", "mocap_quat", "eq_active"):
        getattr(data, name)[:] = getattr(start.data, name)
    worst = Sag(0.0, 0, 0.0)
    warnings: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(warnings.append)
    try:
        for _ in range(int(np.ceil(span(start, duration) / model.opt.timestep))):
            now = float(data.time)
            mujoco.mj_step(model, data)
            if warnings:  # after one MuJoCo starts again from its initial state
                return f"at {now:.3g} s: {' '.join(warnings[0].split())}"
            # a step leaves the constraints of where it began, or of its last stage
            mujoco.mj_fwdPosition(model, data)
            index, gap = _widest(model, data)
            if gap > worst.gap:
                worst = Sag(gap, index, float(data.time))
    finally:
        mujoco.set_mju_user_warning(before)
    return worst


def sag_line(start: Start, duration: float) -> str | None:
    """What to say of the file's own run; None if it has no equalities."""
    model = start.model
    if not start.gaps():
        return None
    integrator = mujoco.mjtIntegrator(model.opt.integrator).name.removeprefix("mjINT_")
    how = f"MuJoCo's own run of the file, {integrator} at {float(model.opt.timestep):g} s"
    found = sag(start, model, duration)
    if isinstance(found, str):
        return f"{how}, goes astray {found}"
    solref = " ".join(f"{x:g}" for x in model.eq_solref[found.equality])
    return (
        f"{how}, opens its equalities by at most {found.gap:.1e} (m or rad){looked_at(start, duration)}: "
        f"{start.equality(found.equality)} at {found.time:.3g} s, of solref {solref}; here they are rigid"
    )


def _widest(model: Any, data: Any) -> tuple[int, float]:
    """Number and gap of the equality that is open the most."""
    rows = np.flatnonzero(data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY)
    numbers = data.efc_id[rows]
    gaps = {
        int(index): _gap(model, index, data.efc_pos[rows[numbers == index]]) for index in np.unique(numbers)
    }
    return max(gaps.items(), key=lambda item: item[1], default=(0, 0.0))


def _gap(model: Any, index: int, residual: Array) -> float:
    """Distance, m, or angle, rad, of an equality with residuals (1,), (3,) or (6,); of a weld the larger."""
    distance = float(np.linalg.norm(residual[:3]))
    scale = abs(float(model.eq_data[index, TORQUE_SCALE]))
    if model.eq_type[index] != mujoco.mjtEq.mjEQ_WELD or scale == 0.0:
        return distance
    half_angle = np.arcsin(min(1.0, float(np.linalg.norm(residual[3:])) / scale))
    return max(distance, 2.0 * float(half_angle))
