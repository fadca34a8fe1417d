"""How far the equalities of a file open when MuJoCo runs it as it stands, with its own solref and solimp."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from mjcf.reading.start import Start

MOST_STEPS = 1_000
"""Of the file's own step; longer runs are looked at so far."""


def sag_line(start: Start, duration: float) -> str | None:
    """What to say of them in a run without contacts, limits and dry friction; None if there are none."""
    model, data = start.model, mujoco.MjData(start.model)
    if not start.gaps():
        return None
    for name in ("qpos", "qvel", "act", "ctrl", "mocap_pos", "mocap_quat", "eq_active"):
        getattr(data, name)[:] = getattr(start.data, name)
    step = float(model.opt.timestep)
    integrator = mujoco.mjtIntegrator(model.opt.integrator).name.removeprefix("mjINT_")
    how = f"MuJoCo's own run of the file, {integrator} at {step:g} s"
    worst, owner, time = 0.0, 0, 0.0
    warnings: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(warnings.append)
    try:
        for _ in range(min(int(np.ceil(duration / step)), MOST_STEPS)):
            now = float(data.time)
            mujoco.mj_step(model, data)
            if warnings:  # after one MuJoCo starts again from its initial state
                return f"{how}, goes astray at {now:.3g} s: {' '.join(warnings[0].split())}"
            index, gap = _widest(data)
            if gap > worst:
                worst, owner, time = gap, index, now
    finally:
        mujoco.set_mju_user_warning(before)
    solref = " ".join(f"{x:g}" for x in model.eq_solref[owner])
    return (
        f"{how}, opens its equalities by at most {worst:.1e} (m or rad): {start.equality(owner)} at "
        f"{time:.3g} s, of solref {solref}; here they are rigid"
    )


def _widest(data: Any) -> tuple[int, float]:
    """Number and residual of the equality that is open the most."""
    rows = np.flatnonzero(data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY)
    if not len(rows):
        return 0, 0.0
    row = rows[int(np.argmax(np.abs(data.efc_pos[rows])))]
    return int(data.efc_id[row]), float(abs(data.efc_pos[row]))
