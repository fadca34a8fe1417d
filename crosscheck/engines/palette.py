"""Colors and lines of engines and models, the same in 3-D recordings, plots and HTML pages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple
from zlib import crc32

from crosscheck.engines.engine import LineStyle
from crosscheck.engines.registry import find, names
from crosscheck.support.colors import (
    BLUE,
    GREEN,
    ORANGE,
    OTHER_COLORS,
    RESERVE_COLORS,
    SKY_BLUE,
    VERMILION,
)


class Look(NamedTuple):
    """Color #rrggbb and line of the curves of an engine."""

    color: str
    line: LineStyle


LOOKS: Mapping[str, Look] = {
    "newton_euler": Look(BLUE, ("-", 2.6)),
    "mujoco": Look(VERMILION, ("--", 1.6)),
    "pinocchio": Look(GREEN, (":", 1.8)),
    "drake": Look(ORANGE, ("-.", 1.6)),
    "exudyn": Look(SKY_BLUE, ((0, (5, 1, 1, 1, 1, 1)), 1.6)),
}
"""Look of each engine of this project, installed or not; thick solid under thin dashed lines, so that all of
several equal curves are visible."""


def palette(shown: Sequence[str]) -> dict[str, str]:
    """Choose a color, #rrggbb, for each name.

    The color of an engine does not depend on the other names. Names that stand for something else have those
    of `OTHER_COLORS` that no engine beside them has, by order.
    """
    colors = {name: color for name in shown if (color := _engine_color(name))}
    free = [color for color in OTHER_COLORS if color not in colors.values()]
    others = [name for name in shown if name not in colors]
    by_order = {name: free[k % len(free)] for k, name in enumerate(others)}
    return {name: colors.get(name) or by_order[name] for name in shown}


def line_of(name: str) -> LineStyle | None:
    """Return the line of the curves of an engine; None for other names."""
    if name in LOOKS:
        return LOOKS[name].line
    engine = find(name)
    return engine.line if engine else None


def _engine_color(name: str) -> str:
    """Return the color of an engine, or "" for other names.

    An engine of another package that has no color of its own has one of `RESERVE_COLORS` by its name.
    """
    if name in LOOKS:
        return LOOKS[name].color
    if (engine := find(name)) and engine.color:
        return engine.color
    return RESERVE_COLORS[crc32(name.encode()) % len(RESERVE_COLORS)] if name in names() else ""
