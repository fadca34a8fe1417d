"""Colors of engines and models, the same in 3-D recordings, plots and HTML pages.

All colors are from M. Okabe and K. Ito, Color Universal Design, 2008, and can be told apart by color-blind
people.
"""

from __future__ import annotations

from collections.abc import Sequence

ENGINE_COLORS = {"newton_euler": "#0072b2", "mujoco": "#d55e00", "pinocchio": "#009e73"}
"""Color of each engine, #rrggbb."""

OTHER_COLORS = ("#cc79a7", "#e69f00", "#56b4e9", "#999999", "#f0e442")
"""Colors of everything that is not an engine, such as compared models and baselines, in the order of use."""


def palette(names: Sequence[str]) -> dict[str, str]:
    """Choose a color, #rrggbb, for each name: engines by `ENGINE_COLORS`, other names by their order."""
    others = [name for name in names if name not in ENGINE_COLORS]
    by_order = {name: OTHER_COLORS[k % len(OTHER_COLORS)] for k, name in enumerate(others)}
    return {name: ENGINE_COLORS.get(name) or by_order[name] for name in names}


def rgb(color: str) -> tuple[int, int, int]:
    """Convert a color #rrggbb to its red, green and blue components, from 0 to 255 each."""
    red, green, blue = bytes.fromhex(color[1:])
    return red, green, blue
