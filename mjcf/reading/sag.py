"""How far the equalities of a file open when MuJoCo runs it as it stands, with its own solref and solimp."""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np

from mjcf.reading.start import Start

MOST_STEPS = 1_000
"""Of the file's own step; longer runs are looked at so far."""


class Sag(NamedTuple):
    """Where equalities are open the most in a run.

    Attributes:
        gap: m or rad.
        equality: number of the one that is.
        time: s.
    """

    gap: float
    equality: int
    time: float


def sag(start: Start, model: Any, duration: float) -> Sag | str:
    """How far equalities open in a run of so many s, without contacts, limits and dry friction.

    Args:
        start: where it starts.
        model: what is run: its model, or one that differs in what is no part of a state.
        duration: s.

    Returns:
        Where they do, or at which time MuJoCo warns of what.
    """
    data = mujoco.MjData(model)
    for name in ("qpos", "qvel", "act", "ctrl", "mocap_pos", "mocap_quat", "eq_active"):
        getattr(data, name)[:] = getattr(start.data, name)
    span = min(duration, MOST_STEPS * float(start.model.opt.timestep))
    worst = Sag(0.0, 0, 0.0)
    warnings: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(warnings.append)
    try:
        for _ in range(int(np.ceil(span / model.opt.timestep))):
            now = float(data.time)
            mujoco.mj_step(model, data)
            if warnings:  # after one MuJoCo starts again from its initial state
                return f"at {now:.3g} s: {' '.join(warnings[0].split())}"
            index, gap = _widest(data)
            if gap > worst.gap:
                worst = Sag(gap, index, now)
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
        f"{how}, opens its equalities by at most {found.gap:.1e} (m or rad): "
        f"{start.equality(found.equality)} at {found.time:.3g} s, of solref {solref}; here they are rigid"
    )


def _widest(data: Any) -> tuple[int, float]:
    """Number and residual of the equality that is open the most."""
    rows = np.flatnonzero(data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY)
    if not len(rows):
        return 0, 0.0
    row = rows[int(np.argmax(np.abs(data.efc_pos[rows])))]
    return int(data.efc_id[row]), float(abs(data.efc_pos[row]))
