"""Colors of engines and models, the same in 3-D recordings, plots and HTML pages."""

from __future__ import annotations

from collections.abc import Sequence

from crosscheck.engines.registry import ENGINES
from crosscheck.support.colors import OTHER_COLORS


def palette(names: Sequence[str]) -> dict[str, str]:
    """Choose a color, #rrggbb, for each name: that of a default engine, or one of `OTHER_COLORS` by order."""
    colors = {name: engine.color for name, engine in ENGINES.items()}
    others = [name for name in names if name not in colors]
    by_order = {name: OTHER_COLORS[k % len(OTHER_COLORS)] for k, name in enumerate(others)}
    return {name: colors.get(name) or by_order[name] for name in names}
