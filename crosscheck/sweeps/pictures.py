"""Pictures of a sweep: tornado charts, histograms and scatter plots, as PNG."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from crosscheck.palette import ENGINE_COLORS
from crosscheck.report.plots import png
from crosscheck.sweeps.analysis import Effect, Scalar
from newton_euler.scalars import Array

MOST_DRAWN = 6
"""Numbers in one picture."""

MOST_BARS = 10
"""Parameters in a tornado chart, those that matter most."""

MOST_POINTS = 5000
"""Runs in a scatter plot."""

SIDE_BY_SIDE = 3
"""Parameters beside a number in scatter plots."""

LOW, HIGH, PLAIN = ENGINE_COLORS["newton_euler"], ENGINE_COLORS["mujoco"], ENGINE_COLORS["pinocchio"]

Effects = Sequence[tuple[Scalar, Sequence[Effect]]]
"""Numbers that vary, and the effects of parameters on each."""


def pictures(
    effects: Effects, points: Array, inputs: Mapping[str, Array], nominal: Mapping[str, float]
) -> dict[str, bytes]:
    """Draw what varies, by the names of files.

    Args:
        effects: of each number, the largest first.
        points: (n,) places of values that scatter plots have.
        inputs: (n,) there by the name of a parameter.
        nominal: numbers of the nominal run by their labels.
    """
    shown = effects[:MOST_DRAWN]
    if not shown:
        return {}
    return {
        "tornado.png": _rows(len(shown), 1, lambda axes: _tornado(axes[:, 0], shown), 2.6),
        "histograms.png": _rows(len(shown), 1, lambda axes: _histograms(axes[:, 0], shown, nominal), 2.0),
        "scatter.png": _rows(
            len(shown), SIDE_BY_SIDE, lambda axes: _scatter(axes, shown, points, inputs), 2.4
        ),
    }


def _rows(rows: int, columns: int, draw: Callable[[Array], None], height: float) -> bytes:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, height * rows), layout="constrained")
    draw(figure.subplots(rows, columns, squeeze=False))
    return png(figure)


def _tornado(axes: Array, effects: Effects) -> None:
    """Draw the means of the runs in which a parameter is low and high, and its share of the variance."""
    for ax, (scalar, found) in zip(axes, effects, strict=True):
        bars = list(found[:MOST_BARS])[::-1]
        beside = "rank" if bars and bars[0].share is None else "share of variance"
        if len(found) > len(bars):
            beside += f"; {len(found) - len(bars)} smaller ones are not shown"
        middle = float(np.nanmean(scalar.values))
        for end, color, label in (("low", LOW, "low"), ("high", HIGH, "high")):
            widths = [getattr(effect, end) - middle for effect in bars]
            ax.barh([effect.name for effect in bars], widths, left=middle, color=color, label=label)
        for row, effect in enumerate(bars):
            ends = max(effect.low, effect.high, middle)
            ax.annotate(f" {share_of(effect)}", (ends, row), va="center", fontsize="small")
        ax.axvline(middle, color="black", linewidth=0.8)
        ax.margins(x=0.35)
        ax.set_title(f"{scalar.heading}: mean where a parameter is low or high; {beside}", fontsize="small")
        ax.legend(fontsize="small", loc="lower right")


def share_of(effect: Effect) -> str:
    """Word the share of a parameter and its 95 % interval, or its rank where there is none."""
    if effect.share is None:
        return rank_of(effect)
    text = f"{round(100.0 * effect.share)} ± {np.ceil(100.0 * effect.error):.0f} %"
    return text if effect.total is None else f"{text}, in all {100.0 * effect.total:.0f} %"


def rank_of(effect: Effect) -> str:
    """Word the rank correlation of a parameter and its 95 % interval."""
    if effect.rank is None:
        return ""
    return f"{effect.rank:+.2f} ± {np.ceil(100.0 * effect.rank_error) / 100.0:.2f}"


def _histograms(axes: Array, effects: Effects, nominal: Mapping[str, float]) -> None:
    for ax, (scalar, _) in zip(axes, effects, strict=True):
        ax.hist(scalar.values[np.isfinite(scalar.values)], bins=60, color=LOW)
        for level in scalar.quantiles[[1, 2, 3]]:
            ax.axvline(level, color="black", linewidth=0.8, linestyle=":")
        ax.axvline(nominal[scalar.label], color=HIGH, label="nominal")
        ax.set_title(f"{scalar.heading}; dotted: 5 %, 50 %, 95 %", fontsize="small")
        ax.set_ylabel("runs")
        ax.legend(fontsize="small")


def _scatter(axes: Array, effects: Effects, points: Array, inputs: Mapping[str, Array]) -> None:
    for row, (scalar, found) in zip(axes, effects, strict=True):
        names = [effect.name.partition(", ")[0] for effect in found[:SIDE_BY_SIDE]]
        for ax, name in zip(row, names, strict=False):
            ax.plot(inputs[name], scalar.values[points], ".", color=PLAIN, markersize=2.0, alpha=0.5)
            ax.set_xlabel(name, fontsize="small")
            ax.tick_params(labelsize="small")
            ax.xaxis.get_major_locator().set_params(nbins=4)  # three plots are side by side
            ax.ticklabel_format(scilimits=(-3, 4), useMathText=True)
            for axis in (ax.xaxis, ax.yaxis):
                axis.get_offset_text().set_fontsize("small")
        for ax in row[len(names) :]:
            ax.set_visible(False)
        row[0].set_title(scalar.heading, fontsize="small", loc="left")
