"""Plots of a stress run: pictures, and the same in a Rerun recording.

All axes are logarithmic. Rerun has none of that kind, so its coordinates are decades.
"""

from __future__ import annotations

import io
import re
import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from crosscheck.studies.stress.topics import Row
from newton_euler.scalars import Array

DECADE = np.array([100.0, -60.0])
"""A decade in Rerun's view, whose second axis points down."""

COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#000000", "#999999")

DASHES = ("-", "--", ":")


@dataclass(frozen=True, eq=False)
class Plot:
    """Lines by their labels, (n, 2) positive numbers each, sorted by the first."""

    title: str
    x_label: str
    y_label: str
    lines: dict[str, Array]

    @property
    def slug(self) -> str:
        """The title as part of a file name."""
        return re.sub(r"[^a-z0-9]+", "_", self.title.lower()).strip("_")


def plots(rows: Sequence[Row]) -> list[Plot]:
    """All plots that rows have curves for; curves of one label are one line."""
    points: dict[tuple[str, str, str], dict[str, list[tuple[float, float]]]] = {}
    for row in rows:
        for curve in row.curves:
            lines = points.setdefault((curve.plot, curve.x_label, curve.y_label), {})
            pairs = zip(curve.x, curve.y, strict=True)
            # what diverged is in the tables; a logarithmic axis that reaches 1e300 shows nothing else
            lines.setdefault(curve.label, []).extend((x, min(y, 1e3)) for x, y in pairs if 0.0 < y < np.inf)
    return [
        Plot(*names, {label: np.array(sorted(pairs)) for label, pairs in lines.items() if pairs})
        for names, lines in points.items()
    ]


def png(plot: Plot) -> bytes:
    """The plot as a picture."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullLocator

    drawn = Figure(figsize=(9.0, 5.0))
    ax = drawn.add_subplot()
    for k, (label, line) in enumerate(plot.lines.items()):
        dash = DASHES[k // len(COLORS) % len(DASHES)]
        ax.plot(*line.T, marker=".", color=COLORS[k % len(COLORS)], linestyle=dash, label=label)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_title(plot.title)
    ax.set_xlabel(plot.x_label)
    ax.set_ylabel(plot.y_label)
    ax.grid(which="major", alpha=0.3)
    points = np.concatenate(list(plot.lines.values()))
    for axis, (low, high) in zip((ax.xaxis, ax.yaxis), np.sort(points, axis=0)[[0, -1]].T, strict=True):
        axis.set_major_formatter(lambda value, _: f"{value:.0e}")
        if high > 100.0 * low:  # two decades at least are labelled
            axis.set_minor_locator(NullLocator())
    legend = drawn.legend(loc="upper right", fontsize="x-small")
    # a layout of matplotlib's own, and its formulas on ticks, take three times as long as all the rest
    ax.set_position((0.09, 0.11, 0.88 - legend.get_window_extent().width / drawn.bbox.width, 0.81))
    picture = io.BytesIO()
    drawn.savefig(picture, dpi=110, format="png")
    return picture.getvalue()


def recording(drawn: Sequence[Plot], text: str) -> bytes:
    """All plots, a tab each, and the report's text as an .rrd."""
    import rerun as rr
    import rerun.blueprint as rrb

    rr.set_strict_mode(True)
    stream = rr.RecordingStream("crosscheck_stress", recording_id=uuid.uuid4())
    # in memory first: the writer's own thread would wait for ever on a disk that is full
    memory = stream.memory_recording()
    views = [rrb.Spatial2DView(origin=f"/plots/{plot.slug}", name=plot.title) for plot in drawn]
    report = rrb.TextDocumentView(origin="/report", name="Report")
    stream.send_blueprint(
        rrb.Blueprint(rrb.Tabs(report, *views), collapse_panels=True),
        make_active=False,
    )
    stream.send_recording_name("stress")
    stream.log("/report", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)
    for plot in drawn:
        for k, (label, line) in enumerate(plot.lines.items()):
            color = tuple(int(COLORS[k % len(COLORS)][j : j + 2], 16) for j in (1, 3, 5))
            path = rr.new_entity_path(["plots", plot.slug, label])
            strip = rr.LineStrips2D([DECADE * np.log10(line)], colors=color, radii=0.8, labels=[label])
            stream.log(f"{path}", strip, static=True)
        _log_axes(stream, plot)
    return bytes(memory.drain_as_bytes())


def _log_axes(stream: Any, plot: Plot) -> None:
    """A labelled tick for each decade; the axes' names beyond the last of them."""
    import rerun as rr

    places = np.log10(np.concatenate(list(plot.lines.values())))
    low, high = np.floor(places.min(axis=0)), np.ceil(places.max(axis=0))
    across, up = (np.arange(low[k], high[k] + 1.0) for k in (0, 1))
    ticks = [[x, low[1] - 0.5] for x in across] + [[low[0] - 0.3, y] for y in up]
    labels = [f"1e{int(x)}" for x in across] + [f"1e{int(y)}" for y in up]
    ticks += [[0.5 * (low[0] + high[0]), low[1] - 1.2], [low[0] - 0.3, high[1] + 0.8]]
    labels += [plot.x_label, plot.y_label]
    axes = rr.Points2D(DECADE * np.array(ticks), colors=(128, 128, 128), radii=1.0, labels=labels)
    stream.log(rr.new_entity_path(["plots", plot.slug, "axes"]), axes, static=True)
