"""Colors of plots, 3-D recordings and HTML pages, #rrggbb, which color-blind people can tell apart.

They are from M. Okabe and K. Ito, Color Universal Design, 2008.
"""

from __future__ import annotations

BLUE, VERMILION, GREEN = "#0072b2", "#d55e00", "#009e73"

OTHER_COLORS = ("#cc79a7", "#e69f00", "#56b4e9", "#999999", "#f0e442")
"""Colors of what has none of its own, such as compared models and baselines, in the order of use."""


def rgb(color: str) -> tuple[int, int, int]:
    """Convert a color #rrggbb to its red, green and blue components, from 0 to 255 each."""
    red, green, blue = bytes.fromhex(color[1:])
    return red, green, blue
