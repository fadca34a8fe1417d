"""Draw the plots of a sweep as PNG files: tornado charts, histograms and scatter plots.

A sweep simulates a scene many times with varied parameters and keeps some numbers of each run. A tornado
chart shows the effects of the parameters on a kept number. Each parameter has one bar, which ends at two
means of the number: over the runs with the lowest values of the parameter, and over those with the highest.
A group of correlated parameters has one bar, named "a, b".
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from crosscheck.report.plots import own_style, png
from crosscheck.support.colors import BLUE, GREEN, VERMILION
from crosscheck.sweeps.analysis import Effect
from crosscheck.sweeps.kept_numbers import KeptNumber, with_unit
from newton_euler.scalars import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MAX_PLOTTED_NUMBERS = 6
"""Largest number of kept numbers in one picture."""

MAX_TORNADO_BARS = 10
"""Largest number of parameters in a tornado chart, those with the largest effects."""

MAX_SCATTER_POINTS = 5000
"""Largest number of runs in a scatter plot."""

NEARLY_EQUAL_RANGE = 1e-2
"""Range of values, relative to the largest magnitude, below which plots show values minus an offset."""

MAX_OPAQUE_POINTS = 100
"""Largest number of runs whose points are drawn large and opaque."""

SCATTER_COLUMNS = 3
"""Largest number of parameters over which each kept number is plotted, those with the largest effects."""

LOW_COLOR, HIGH_COLOR, POINT_COLOR = BLUE, VERMILION, GREEN
"""Colors of low and high values of a parameter, and of points."""

Effects = Sequence[tuple[KeptNumber, Sequence[Effect]]]
"""Kept numbers that vary, each with the effects of the parameters on it, the largest effect first."""


def pictures(
    effects: Effects,
    points: Array,
    inputs: Mapping[str, Array],
    units: Mapping[str, str],
    nominal: Mapping[str, float],
) -> dict[str, bytes]:
    """Draw the plots of a sweep.

    Args:
        effects: kept numbers with the effects on them.
        points: (n,) indices of the runs in scatter plots, among the values of the kept numbers.
        inputs: (n,) values of each parameter in these runs, by name.
        units: unit of each parameter, by name.
        nominal: values of the kept numbers in the run with nominal parameters, by label.

    Returns:
        PNG files by name; empty if nothing varies.
    """
    shown = effects[:MAX_PLOTTED_NUMBERS]
    if not shown:
        return {}
    return {
        "tornado.png": _grid_of_plots(
            rows=len(shown), columns=1, draw=lambda axes: _tornado(axes[:, 0], shown), height=2.6
        ),
        "histograms.png": _grid_of_plots(
            rows=len(shown), columns=1, draw=lambda axes: _histograms(axes[:, 0], shown, nominal), height=2.0
        ),
        "scatter.png": _grid_of_plots(
            rows=len(shown),
            # too few runs have no effects
            columns=max(1, min(SCATTER_COLUMNS, max(len(found) for _, found in shown))),
            draw=lambda axes: _scatter(axes, shown, points, inputs, units),
            height=2.4,
        ),
    }


@own_style()
def _grid_of_plots(rows: int, columns: int, draw: Callable[[Array], None], height: float) -> bytes:
    """Return a PNG of a grid of plots.

    Args:
        rows, columns: size of the grid.
        draw: function that draws into the array (rows, columns) of axes.
        height: height of a row, inches.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, height * rows), layout="constrained")
    draw(figure.subplots(rows, columns, squeeze=False))
    return png(figure)


def _origin(values: Array) -> tuple[float, str]:
    """Return a round offset to subtract from values in a plot, and the text of the subtraction, as " - 9.81".

    If the values are nearly equal, labels of the axis without an offset would be too long. Else the offset is
    0 and the text empty.
    """
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
    spread, largest = high - low, max(abs(low), abs(high))
    if not 0.0 < spread < NEARLY_EQUAL_RANGE * largest:
        return 0.0, ""
    digits = int(np.ceil(np.log10(largest / spread)))
    origin = float(f"{0.5 * (low + high):.{digits}g}")
    return origin, f" {'+' if origin < 0.0 else '-'} {abs(origin):.{digits}g}"


def _label_numbers(ax: Axes, axis: Literal["x", "y"]) -> None:
    """Show powers of ten next to an axis, and no offset of Matplotlib's own."""
    ax.ticklabel_format(axis=axis, scilimits=(-3, 4), useMathText=True, useOffset=False)
    which = ax.xaxis if axis == "x" else ax.yaxis
    which.get_offset_text().set_fontsize("small")


def _tornado(axes: Array, effects: Effects) -> None:
    """Draw a tornado chart of each number: bars as in the module's description, labeled by Sobol indices."""
    for ax, (scalar, found) in zip(axes, effects, strict=True):
        bars = list(found[:MAX_TORNADO_BARS])[::-1]
        annotation = "rank" if bars and bars[0].share is None else "share of variance"
        if len(found) > len(bars):
            annotation += f"; {len(found) - len(bars)} smaller ones are not shown"
        # bars begin at the mean of all runs; `minus_origin` is the text of the subtracted offset
        origin, minus_origin = _origin(np.array([end for bar in bars for end in (bar.low, bar.high)]))
        middle = float(np.nanmean(scalar.values)) - origin
        for end, color, label in (("low", LOW_COLOR, "lowest tenth"), ("high", HIGH_COLOR, "highest tenth")):
            widths = [getattr(effect, end) - origin - middle for effect in bars]
            ax.barh([effect.name for effect in bars], widths, left=middle, color=color, label=label)
        for row, effect in enumerate(bars):
            right_end = max(effect.low - origin, effect.high - origin, middle)
            ax.annotate(f" {share_of(effect)}", (right_end, row), va="center", fontsize="small")
        ax.axvline(middle, color="black", linewidth=0.8)
        ax.margins(x=0.35)
        _label_numbers(ax, "x")
        title = with_unit(scalar.label + minus_origin, scalar.unit)
        ax.set_title(f"{title}: means of runs; {annotation}", fontsize="small")
    # one legend above all plots, where it covers neither bars nor their numbers
    handles, labels = axes[0].get_legend_handles_labels()
    labels = [f"parameter in its {label}" for label in labels]
    axes[0].figure.legend(handles, labels, loc="outside upper center", ncols=2, fontsize="small")


def share_of(effect: Effect) -> str:
    """Format a parameter's first-order Sobol index in % with its 95 % interval, and its total-effect index.

    The index of a group of correlated parameters is a lower bound (`bounds`), written with ≥. Without a Sobol
    index, format the rank correlation.
    """
    if effect.share is None:
        return rank_of(effect)
    either_side = f" ± {np.ceil(100.0 * effect.error):.0f}" if effect.error else ""
    text = f"{'≥ ' * effect.bounds}{round(100.0 * effect.share)}{either_side} %"
    return text if effect.total is None else f"{text}, in all {100.0 * effect.total:.0f} %"


def rank_of(effect: Effect) -> str:
    """Format the rank correlation of a parameter with its 95 % interval."""
    if effect.rank is None:
        return ""
    return f"{effect.rank:+.2f} ± {np.ceil(100.0 * effect.rank_error) / 100.0:.2f}"


def _histograms(axes: Array, effects: Effects, nominal: Mapping[str, float]) -> None:
    """Draw the histogram of each number, with its quantiles and nominal value."""
    for ax, (scalar, _) in zip(axes, effects, strict=True):
        known, nominal_value = scalar.values[np.isfinite(scalar.values)], nominal[scalar.label]
        origin, minus_origin = _origin(np.append(known, nominal_value))
        if origin and np.isfinite(nominal_value):  # the axis has differences, those from the nominal value
            origin, minus_origin = nominal_value, f" - nominal ({nominal_value:.6g})"
        ax.hist(known - origin, bins=60, color=LOW_COLOR)
        for quantile in scalar.quantiles[1:-1]:  # 5 %, 50 % and 95 %, without the extremes
            ax.axvline(quantile - origin, color="black", linewidth=0.8, linestyle=":")
        ax.axvline(nominal_value - origin, color=HIGH_COLOR, label="nominal")
        _label_numbers(ax, "x")
        title = with_unit(scalar.label + minus_origin, scalar.unit)
        ax.set_title(f"{title}; dotted: 5 %, 50 %, 95 %", fontsize="small")
        ax.set_ylabel("runs")
        ax.legend(fontsize="small")


def _scatter(
    axes: Array, effects: Effects, points: Array, inputs: Mapping[str, Array], units: Mapping[str, str]
) -> None:
    """Draw each number over the parameters with the largest effects, with a point for each run.

    The arguments are those of `pictures`, after the array (numbers, at most `SCATTER_COLUMNS`) of axes.
    """
    size, opacity = (6.0, 1.0) if len(points) <= MAX_OPAQUE_POINTS else (2.0, 0.5)
    for row, (scalar, found) in zip(axes, effects, strict=True):
        # of a group of correlated parameters "a, b", the first one
        names = [effect.name.partition(", ")[0] for effect in found[:SCATTER_COLUMNS]]
        y_origin, minus_y_origin = _origin(scalar.values[points])
        y = scalar.values[points] - y_origin
        for ax, name in zip(row, names, strict=False):
            x_origin, minus_x_origin = _origin(inputs[name])
            ax.plot(inputs[name] - x_origin, y, ".", color=POINT_COLOR, markersize=size, alpha=opacity)
            label = with_unit(name.replace(".", ".\n", 1) + minus_x_origin, units[name])
            ax.set_xlabel(label, fontsize="small")  # powers of ten are placed next to it
            ax.tick_params(labelsize="small")
            ax.xaxis.get_major_locator().set_params(nbins=4)  # three plots are side by side
            _label_numbers(ax, "x")
            _label_numbers(ax, "y")
        for ax in row[len(names) :]:
            ax.set_visible(False)
        row[0].set_title(scalar.label + minus_y_origin, fontsize="small", loc="left")
        row[0].set_ylabel(scalar.unit if scalar.unit != "1" else "", fontsize="small")
