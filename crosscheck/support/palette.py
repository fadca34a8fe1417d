"""Colors of engines and models, the same in recordings, plots and pages."""

from __future__ import annotations

from collections.abc import Sequence

ENGINE_COLORS = {"newton_euler": "#0072b2", "mujoco": "#d55e00", "pinocchio": "#009e73"}

OTHER_COLORS = ("#cc79a7", "#e69f00", "#56b4e9", "#f0e442")
"""Colors of models and baselines, in order, from M. Okabe and K. Ito, Color Universal Design, 2008."""


def palette(names: Sequence[str]) -> dict[str, str]:
    """Choose a color, #rrggbb, for each name: an engine's own, those of others by their order."""
    others = [name for name in names if name not in ENGINE_COLORS]
    by_order = {name: OTHER_COLORS[k % len(OTHER_COLORS)] for k, name in enumerate(others)}
    return {name: ENGINE_COLORS.get(name) or by_order[name] for name in names}


def rgb(color: str) -> tuple[int, int, int]:
    """Red, green and blue of #rrggbb, from 0 to 255 each."""
    red, green, blue = bytes.fromhex(color[1:])
    return red, green, blue
