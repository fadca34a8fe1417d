"""What a file sets that no scene holds: how MuJoCo steps it, how soft equalities are."""

from __future__ import annotations

from typing import Any

import numpy as np

from newton_euler.scalars import Array


def running(model: Any) -> dict[str, Array]:
    """What MuJoCo steps a compiled model with, and how soft its equalities are, by what it is."""
    found = {"timestep": np.array([model.opt.timestep]), "integrator": np.array([model.opt.integrator])}
    for k in range(model.neq):
        found[f"solref of equality {_name(model, k)!r}"] = model.eq_solref[k]
        found[f"solimp of equality {_name(model, k)!r}"] = model.eq_solimp[k]
    return found


def _name(model: Any, equality: int) -> str:
    return model.equality(equality).name or str(equality)
