"""Openings of the equalities of a file when MuJoCo runs it, and changes of the model that lessen them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np

from mjcf.reading.start import TORQUE_SCALE, Start
from mjcf.write import SOLIMP
from newton_euler.scalars import Array

MOST_STEPS = 1_000
"""Of the file's own step; longer runs are looked at so far."""

CHANGES = ("solref", "solimp", "integrator", "timestep")
"""In the order in which they are to be made, until the gap is small: the cheapest first."""

MARGIN = 0.9
"""Share of the step that the gap asks for, with the square of which it does not fall exactly."""

SHORTEST = 0.02
"""Share of the file's own step; with shorter ones a run would take longer than all else."""


class Sag(NamedTuple):
    """The place where equalities are open the most in a run.

    Attributes:
        gap: m or rad: distance of the points of a connect; of a weld, distance or angle.
        equality: number of the one that is.
        time: s.
    """

    gap: float
    equality: int
    time: float


def span(start: Start, duration: float) -> float:
    """Duration of a run that is looked at, s."""
    return min(duration, MOST_STEPS * float(start.model.opt.timestep))


def looked_at(start: Start, duration: float) -> str:
    """Words to add where that is not all of it."""
    seen = span(start, duration)
    return f" in its first {seen:g} s" if seen < duration else ""


def sag(start: Start, model: Any, duration: float) -> Sag | str:
    """Find how far equalities open in a run of so many s, without contacts, limits and dry friction.

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
    steps = int(np.ceil(span(start, duration) / model.opt.timestep))
    staged = model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
    worst, gaps = Sag(0.0, 0, 0.0), np.zeros(0)
    warnings: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(warnings.append)
    try:
        for step in range(steps + 1):
            now = float(data.time)
            # a step leaves the constraints of where it began, with stages those of its last one
            if staged or step == steps:
                mujoco.mj_fwdPosition(model, data)
                gaps = _gaps(model, data)
            if step < steps:
                mujoco.mj_step(model, data)
                gaps = gaps if staged else _gaps(model, data)
            if warnings:  # after one MuJoCo starts again from its initial state
                return f"at {now:.3g} s: {' '.join(warnings[0].split())}"
            if step and len(gaps) and np.max(gaps) > worst.gap:
                worst = Sag(float(np.max(gaps)), int(np.argmax(gaps)), now)
    finally:
        mujoco.set_mju_user_warning(before)
    return worst


def _gaps(model: Any, data: Any) -> Array:
    """(neq,) distances, m, or angles, rad, of all equalities; of a weld the larger."""
    rows = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
    numbers, squares = data.efc_id[rows], data.efc_pos[rows] ** 2
    place = np.arange(len(numbers)) - np.searchsorted(numbers, numbers)  # among the rows of the equality
    sums = [np.bincount(numbers[own], squares[own], model.neq) for own in (place < 3, place >= 3)]
    scale = np.abs(model.eq_data[:, TORQUE_SCALE])
    welds = (model.eq_type == mujoco.mjtEq.mjEQ_WELD) & (scale > 0.0)
    half = np.arcsin(np.minimum(1.0, np.sqrt(sums[1]) / np.where(welds, scale, 1.0)))
    return np.maximum(np.sqrt(sums[0]), np.where(welds, 2.0 * half, 0.0))


def stiffen(model: Any, change: str, gap: float, wanted: float) -> str:
    """Make one of the `CHANGES` in a model whose equalities open by a gap, to become `wanted` (m or rad).

    Returns:
        What was changed, as the file would have it.
    """
    step = float(model.opt.timestep)
    match change:
        case "solref":
            model.eq_solref[:] = (2.0 * step, 1.0)
            return f"solref {words(model.eq_solref[0])}, the stiffest at its timestep of {step:g} s"
        case "solimp":
            model.eq_solimp[:] = SOLIMP
            return f"solimp {words(SOLIMP)}"
        case "integrator":
            model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
            return "integrator RK4"
    model.opt.timestep = float(f"{step * max(SHORTEST, MARGIN * np.sqrt(wanted / gap)):.1e}")
    model.eq_solref[:] = (2.0 * model.opt.timestep, 1.0)
    return f"timestep {model.opt.timestep:g} s and solref {words(model.eq_solref[0])}"


def words(numbers: Sequence[float]) -> str:
    """As an attribute has them."""
    return '"' + " ".join(f"{x:g}" for x in numbers) + '"'
