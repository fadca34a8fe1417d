"""Diagrams of studies, both axes logarithmic."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from crosscheck.report.plots import png
from newton_euler.scalars import Array

COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#000000", "#999999")

DASHES = ("-", "--", ":")


@dataclass(frozen=True, eq=False)
class Line:
    """One line of a diagram.

    Attributes:
        label: in the legend.
        points: (n, 2) positive numbers.
        color, dash: as matplotlib has them.
        beside: (m, 2) points that are drawn without a line.
    """

    label: str
    points: Array
    color: str
    dash: str = "-"
    beside: Array | None = None


@dataclass(frozen=True, eq=False)
class Diagram:
    """Lines over two logarithmic axes.

    Attributes:
        title: of the diagram.
        x_label, y_label: quantities and units.
        lines: in the order of the legend.
        falling: whether the first axis points to smaller numbers.
        mark: a first coordinate that is marked, and why.
    """

    title: str
    x_label: str
    y_label: str
    lines: tuple[Line, ...]
    falling: bool = False
    mark: tuple[float, str] | None = None

    @property
    def slug(self) -> str:
        """The title as part of a file name."""
        return re.sub(r"[^a-z0-9]+", "_", self.title.lower()).strip("_")

    @property
    def points(self) -> Array:
        """(n, 2), of all lines."""
        arrays = [array for line in self.lines for array in (line.points, line.beside) if array is not None]
        return np.concatenate(arrays)


def picture(*diagrams: Diagram) -> bytes:
    """Diagrams side by side with one legend, as a PNG."""
    from matplotlib.figure import Figure

    drawn = Figure(figsize=(2.5 + 6.5 * len(diagrams), 5.0))
    axes = [drawn.add_subplot(1, len(diagrams), k + 1) for k in range(len(diagrams))]
    for ax, diagram in zip(axes, diagrams, strict=True):
        _draw(ax, diagram)
    legend = drawn.legend(*axes[0].get_legend_handles_labels(), loc="upper right", fontsize="x-small")
    # a layout of matplotlib's own takes three times as long as all the rest
    room = 0.99 - legend.get_window_extent().width / drawn.bbox.width
    each, margin = room / len(diagrams), 0.09 / len(diagrams)
    for k, ax in enumerate(axes):
        ax.set_position((k * each + margin, 0.11, each - 1.2 * margin, 0.81))
    return png(drawn, dpi=110)


def _draw(ax: Any, diagram: Diagram) -> None:
    from matplotlib.ticker import NullLocator

    for line in diagram.lines:
        if line.beside is not None:
            ax.plot(*line.beside.T, ".", color=line.color, markersize=4, alpha=0.3)
        ax.plot(*line.points.T, marker=".", color=line.color, linestyle=line.dash, label=line.label)
    if diagram.mark is not None:
        ax.axvline(diagram.mark[0], color="0.5", linestyle=":", label=diagram.mark[1])
    ax.set(xscale="log", yscale="log", title=diagram.title, xlabel=diagram.x_label, ylabel=diagram.y_label)
    if diagram.falling:
        ax.invert_xaxis()
    ax.grid(which="major", alpha=0.3)
    for axis, (low, high) in zip(
        (ax.xaxis, ax.yaxis), np.sort(diagram.points, axis=0)[[0, -1]].T, strict=True
    ):
        axis.set_major_formatter(lambda value, _: f"{value:.0e}")  # formulas on ticks take long
        if high > 100.0 * low:  # two decades at least are labeled
            axis.set_minor_locator(NullLocator())
