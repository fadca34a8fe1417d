"""Colors of plots, 3-D recordings and HTML pages, #rrggbb, which color-blind people can tell apart.

They are from M. Okabe and K. Ito, Color Universal Design, 2008.
"""

from __future__ import annotations

BLUE, VERMILION, GREEN, ORANGE, SKY_BLUE = "#0072b2", "#d55e00", "#009e73", "#e69f00", "#56b4e9"

OTHER_COLORS = ("#cc79a7", ORANGE, SKY_BLUE, "#999999", "#f0e442")
"""Colors of what has none of its own, such as compared models and baselines, in the order of use."""

RESERVE_COLORS = ("#881122", "#3300cc", "#9966ff", "#bbbb99", "#663377")
"""Further colors of medium lightness, far from the five named ones and from the first of `OTHER_COLORS`.

They are the result of a search that maximizes the smallest distance (OKLab), also as people without one kind
of cones see the colors (simulation by G. M. Machado et al., 2009)."""


def rgb(color: str) -> tuple[int, int, int]:
    """Convert a color #rrggbb to its red, green and blue components, from 0 to 255 each."""
    red, green, blue = bytes.fromhex(color[1:])
    return red, green, blue
