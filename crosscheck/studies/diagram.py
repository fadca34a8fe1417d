"""Diagrams of studies, both axes logarithmic, as pictures and as Rerun recordings.

Rerun has no logarithmic axes, so its coordinates are decades.
"""

from __future__ import annotations

import re
import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from crosscheck.report.plots import png
from newton_euler.scalars import Array

DECADE = np.array([100.0, -60.0])
"""A decade in Rerun's view, whose second axis points down."""

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
        notes: (m,) texts about the points beside it.
    """

    label: str
    points: Array
    color: str
    dash: str = "-"
    beside: Array | None = None
    notes: tuple[str, ...] = ()


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
        if high > 100.0 * low:  # two decades at least are labelled
            axis.set_minor_locator(NullLocator())


def recording(name: str, diagrams: Sequence[Diagram], text: str) -> bytes:
    """Diagrams, a tab each, and a report in Markdown, as an .rrd."""
    import rerun as rr
    import rerun.blueprint as rrb

    rr.set_strict_mode(True)
    stream = rr.RecordingStream(f"crosscheck_{name.split()[0]}", recording_id=uuid.uuid4())
    # in memory first: the writer's own thread would wait for ever on a disk that is full
    memory = stream.memory_recording()
    views = [rrb.Spatial2DView(origin=f"/plots/{diagram.slug}", name=diagram.title) for diagram in diagrams]
    report = rrb.TextDocumentView(origin="/report", name="Report")
    stream.send_blueprint(rrb.Blueprint(rrb.Tabs(report, *views), collapse_panels=True), make_active=False)
    stream.send_recording_name(name)
    stream.log("/report", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)
    for diagram in diagrams:
        for line in diagram.lines:
            path = rr.new_entity_path(["plots", diagram.slug, line.label])
            color = tuple(int(line.color[k : k + 2], 16) for k in (1, 3, 5))
            strip = _places(diagram, line.points)
            stream.log(
                path, rr.LineStrips2D([strip], colors=color, radii=0.8, labels=[line.label]), static=True
            )
            if line.beside is not None:
                dots = _places(diagram, line.beside)
                look = {"colors": color, "radii": 1.5, "labels": line.notes, "show_labels": False}
                stream.log(f"{path}/settings", rr.Points2D(dots, **look), static=True)
        _log_axes(stream, diagram)
    return bytes(memory.drain_as_bytes())


def _places(diagram: Diagram, points: Array) -> Array:
    """(n, 2): points in Rerun's coordinates."""
    sense = np.array([-1.0 if diagram.falling else 1.0, 1.0])
    return np.asarray(DECADE * sense * np.log10(points))


def _log_axes(stream: Any, diagram: Diagram) -> None:
    """A labelled tick for each decade; the axes' names beyond the last of them."""
    import rerun as rr

    decades = np.log10(diagram.points)
    low, high = np.floor(decades.min(axis=0)), np.ceil(decades.max(axis=0))
    across, up = (np.arange(low[k], high[k] + 1.0) for k in (0, 1))
    left = high[0] + 0.3 if diagram.falling else low[0] - 0.3
    ticks = [[x, low[1] - 0.5] for x in across] + [[left, y] for y in up]
    labels = [f"1e{int(x)}" for x in across] + [f"1e{int(y)}" for y in up]
    ticks += [[0.5 * (low[0] + high[0]), low[1] - 1.2], [left, high[1] + 0.8]]
    labels += [diagram.x_label, diagram.y_label]
    places = _places(diagram, 10.0 ** np.array(ticks))
    axes = rr.Points2D(places, colors=(128, 128, 128), radii=1.0, labels=labels)
    stream.log(rr.new_entity_path(["plots", diagram.slug, "axes"]), axes, static=True)
