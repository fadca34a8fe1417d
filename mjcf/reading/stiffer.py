"""A model of MuJoCo made stiffer, one change after the other, so that its equalities open less."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from mjcf.write import SOLIMP

CHANGES = ("solref", "solimp", "integrator", "timestep")
"""In the order in which they are to be made, until the gap is small: the cheapest first."""

MARGIN = 0.9
"""Share of the step that the gap asks for, with the square of which it does not fall exactly."""

SHORTEST = 0.02
"""Share of the file's own step; with shorter ones a run would take longer than all else."""


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
