"""Coefficients of a flat plate in wind, by the formulas that `newton_euler.WindLoad` cites, in degrees."""

from __future__ import annotations

import numpy as np


def blended(degrees: float, ratio: float, longer: float) -> tuple[float, float]:
    """Coefficient and its product with the lead in chords, by the formulas of `WindLoad` in degrees."""
    a = np.radians(degrees)
    stall = 7.6 + 19.5 / (1.0 + (ratio / 1.09) ** 8) + 14.9 / (1.0 + (ratio / 3.18) ** 2)
    s = 1.0 / (1.0 + np.exp((stall - degrees) / 2.4))
    potential = (1.0 - s) * slope(ratio) * np.sin(a) * np.cos(a)
    vortex = (1.0 - s) * np.pi * np.sin(a) ** 2
    separated = s * separated_flow(a, longer)
    moment = 0.25 * potential + 0.08 * vortex + 0.175 * (1.0 - degrees / 90.0) * separated
    return potential + vortex + separated, moment


def slope(ratio: float) -> float:
    return 2.0 * np.pi * ratio / (ratio + 2.0 * (ratio + 4.0) / (ratio + 2.0))


def separated_flow(a, longer: float):
    hoerner = 1.0 / (0.56 + 0.44 * np.sin(a))
    return 1.98 * np.sin(a) * (hoerner - 0.41 * (1.0 - np.exp(-17.0 / longer)))
