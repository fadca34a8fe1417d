"""Pictures of a sweep: tornado charts, histograms and scatter plots, as PNG."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from crosscheck.report.plots import own_style, png
from crosscheck.support.palette import ENGINE_COLORS
from crosscheck.sweeps.analysis import Effect, Scalar, with_unit
from newton_euler.scalars import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_DRAWN = 6
"""Numbers in one picture."""

MOST_BARS = 10
"""Parameters in a tornado chart, those that matter most."""

MOST_POINTS = 5000
"""Runs in a scatter plot."""

NEARLY = 1e-2
"""Range of values, by the largest, below which they are drawn from another number than 0."""

SIDE_BY_SIDE = 3
"""Parameters beside a number in scatter plots."""

LOW, HIGH, PLAIN = ENGINE_COLORS["newton_euler"], ENGINE_COLORS["mujoco"], ENGINE_COLORS["pinocchio"]

Effects = Sequence[tuple[Scalar, Sequence[Effect]]]
"""Numbers that vary, and the effects of parameters on each."""


def pictures(
    effects: Effects,
    points: Array,
    inputs: Mapping[str, Array],
    units: Mapping[str, str],
    nominal: Mapping[str, float],
) -> dict[str, bytes]:
    """Draw what varies, by the names of files.

    Args:
        effects: of each number, the largest first.
        points: (n,) places of values that scatter plots have.
        inputs, units: (n,) there by the name of a parameter, and of it.
        nominal: numbers of the nominal run by their labels.
    """
    shown = effects[:MOST_DRAWN]
    if not shown:
        return {}
    return {
        "tornado.png": _rows(len(shown), 1, lambda axes: _tornado(axes[:, 0], shown), 2.6),
        "histograms.png": _rows(len(shown), 1, lambda axes: _histograms(axes[:, 0], shown, nominal), 2.0),
        "scatter.png": _rows(
            len(shown), SIDE_BY_SIDE, lambda axes: _scatter(axes, shown, points, inputs, units), 2.4
        ),
    }


@own_style()
def _rows(rows: int, columns: int, draw: Callable[[Array], None], height: float) -> bytes:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, height * rows), layout="constrained")
    draw(figure.subplots(rows, columns, squeeze=False))
    return png(figure)


def _origin(values: Array) -> tuple[float, str]:
    """Return a round number that values are drawn from, and how it is taken off in words.

    It is not 0 where they hardly differ: labels would have an offset beside the axis, or be too long to read.
    """
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
    spread, largest = high - low, max(abs(low), abs(high))
    if not 0.0 < spread < NEARLY * largest:
        return 0.0, ""
    digits = int(np.ceil(np.log10(largest / spread)))
    origin = float(f"{0.5 * (low + high):.{digits}g}")
    return origin, f" {'+' if origin < 0.0 else '-'} {abs(origin):.{digits}g}"


def _label_numbers(ax: Axes, axis: Literal["x", "y"]) -> None:
    """Label numbers along an axis without an offset, powers of ten beside it."""
    ax.ticklabel_format(axis=axis, scilimits=(-3, 4), useMathText=True, useOffset=False)
    which = ax.xaxis if axis == "x" else ax.yaxis
    which.get_offset_text().set_fontsize("small")


def _tornado(axes: Array, effects: Effects) -> None:
    """Draw the means of the runs in which a parameter is low and high, and its share of the variance."""
    for ax, (scalar, found) in zip(axes, effects, strict=True):
        bars = list(found[:MOST_BARS])[::-1]
        beside = "rank" if bars and bars[0].share is None else "share of variance"
        if len(found) > len(bars):
            beside += f"; {len(found) - len(bars)} smaller ones are not shown"
        origin, less = _origin(np.array([end for bar in bars for end in (bar.low, bar.high)]))
        middle = float(np.nanmean(scalar.values)) - origin
        for end, color, label in (("low", LOW, "lowest tenth"), ("high", HIGH, "highest tenth")):
            widths = [getattr(effect, end) - origin - middle for effect in bars]
            ax.barh([effect.name for effect in bars], widths, left=middle, color=color, label=label)
        for row, effect in enumerate(bars):
            ends = max(effect.low - origin, effect.high - origin, middle)
            ax.annotate(f" {share_of(effect)}", (ends, row), va="center", fontsize="small")
        ax.axvline(middle, color="black", linewidth=0.8)
        ax.margins(x=0.35)
        _label_numbers(ax, "x")
        title = with_unit(scalar.label + less, scalar.unit)
        ax.set_title(f"{title}: means of runs; {beside}", fontsize="small")
        ax.legend(fontsize="small", title="parameter in its", title_fontsize="small", loc="lower right")


def share_of(effect: Effect) -> str:
    """Word the share of a parameter and its 95 % interval, or its rank where there is none."""
    if effect.share is None:
        return rank_of(effect)
    either_side = f" ± {np.ceil(100.0 * effect.error):.0f}" if effect.error else ""
    text = f"{'≥ ' * effect.bounds}{round(100.0 * effect.share)}{either_side} %"
    return text if effect.total is None else f"{text}, in all {100.0 * effect.total:.0f} %"


def rank_of(effect: Effect) -> str:
    """Word the rank correlation of a parameter and its 95 % interval."""
    if effect.rank is None:
        return ""
    return f"{effect.rank:+.2f} ± {np.ceil(100.0 * effect.rank_error) / 100.0:.2f}"


def _histograms(axes: Array, effects: Effects, nominal: Mapping[str, float]) -> None:
    for ax, (scalar, _) in zip(axes, effects, strict=True):
        known, own = scalar.values[np.isfinite(scalar.values)], nominal[scalar.label]
        origin, less = _origin(np.append(known, own))
        ax.hist(known - origin, bins=60, color=LOW)
        for level in scalar.quantiles[[1, 2, 3]]:
            ax.axvline(level - origin, color="black", linewidth=0.8, linestyle=":")
        ax.axvline(own - origin, color=HIGH, label="nominal")
        _label_numbers(ax, "x")
        title = with_unit(scalar.label + less, scalar.unit)
        ax.set_title(f"{title}; dotted: 5 %, 50 %, 95 %", fontsize="small")
        ax.set_ylabel("runs")
        ax.legend(fontsize="small")


def _scatter(
    axes: Array, effects: Effects, points: Array, inputs: Mapping[str, Array], units: Mapping[str, str]
) -> None:
    for row, (scalar, found) in zip(axes, effects, strict=True):
        names = [effect.name.partition(", ")[0] for effect in found[:SIDE_BY_SIDE]]
        y, less = _origin(scalar.values[points])
        for ax, name in zip(row, names, strict=False):
            x, less_x = _origin(inputs[name])
            ax.plot(inputs[name] - x, scalar.values[points] - y, ".", color=PLAIN, markersize=2.0, alpha=0.5)
            label = with_unit(name.replace(".", ".\n", 1) + less_x, units[name])
            ax.set_xlabel(label, fontsize="small")  # powers of ten stand beside it
            ax.tick_params(labelsize="small")
            ax.xaxis.get_major_locator().set_params(nbins=4)  # three plots are side by side
            _label_numbers(ax, "x")
            _label_numbers(ax, "y")
        for ax in row[len(names) :]:
            ax.set_visible(False)
        row[0].set_title(scalar.label + less, fontsize="small", loc="left")
        row[0].set_ylabel(scalar.unit if scalar.unit != "1" else "", fontsize="small")
