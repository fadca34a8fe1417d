"""What a file sets that no scene holds: how MuJoCo steps it, how soft equalities are, their polynomials."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from newton_euler.scalars import Array


def running(model: Any) -> dict[str, Array]:
    """What MuJoCo steps a compiled model with, and how soft its equalities are, by what it is."""
    found = {"timestep": np.array([model.opt.timestep]), "integrator": np.array([model.opt.integrator])}
    for k in range(model.neq):
        found[f"solref of equality {_name(model, k)!r}"] = model.eq_solref[k]
        found[f"solimp of equality {_name(model, k)!r}"] = model.eq_solimp[k]
    return found


def polynomials(model: Any) -> dict[str, Array]:
    """Coefficients (5,) of the equalities of joints and tendons that are not linear, by their names."""
    kinds = (int(mujoco.mjtEq.mjEQ_JOINT), int(mujoco.mjtEq.mjEQ_TENDON))
    return {
        _name(model, k): model.eq_data[k][:5]
        for k in range(model.neq)
        if int(model.eq_type[k]) in kinds and np.any(model.eq_data[k][2:5])
    }


def _name(model: Any, equality: int) -> str:
    return model.equality(equality).name or str(equality)
