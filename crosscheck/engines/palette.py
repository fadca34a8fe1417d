"""Colors and lines of engines and models, the same in 3-D recordings, plots and HTML pages."""

from __future__ import annotations

from collections.abc import Sequence

from crosscheck.engines.registry import ENGINES, find, names
from crosscheck.support.colors import OTHER_COLORS


def palette(shown: Sequence[str]) -> dict[str, str]:
    """Choose a color, #rrggbb, for each name: that of the engine, or one of `OTHER_COLORS` by order."""
    colors = {name: color for name in shown if (color := _engine_color(name))}
    others = [name for name in shown if name not in colors]
    by_order = {name: OTHER_COLORS[k % len(OTHER_COLORS)] for k, name in enumerate(others)}
    return {name: colors.get(name) or by_order[name] for name in shown}


def line_of(name: str) -> tuple[str, float] | None:
    """Return dash pattern and width, points, of the curves of an engine; None for other names."""
    engine = find(name)
    return engine.line if engine else None


def _engine_color(name: str) -> str:
    """Return the color of an engine, or "" for other names.

    An engine without a color has one of `OTHER_COLORS` by its place in the registry, so that the color does
    not depend on the engines beside it. The first of these colors is that of runs with a file's own settings.
    """
    if (engine := find(name)) and engine.color:
        return engine.color
    others = names()[len(ENGINES) :]
    return OTHER_COLORS[(1 + others.index(name)) % len(OTHER_COLORS)] if name in others else ""
