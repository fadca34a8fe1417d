"""Bar charts on the page of `crosscheck diff`: what each difference does to the motion, and where.

In: rows of differences, and the comparison of motions. Out: `BarChart`, which the template `diff.html` draws
as a table with bars, so that the page is legible on narrow screens.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from crosscheck.differences.difference import Difference, Standing
from crosscheck.differences.motion import Motion
from crosscheck.report.diff import MIN_EFFECT, what_differs
from crosscheck.report.own_run import percent

MAX_BARS = 12
"""Largest number of bars of a chart."""


@dataclass(frozen=True)
class Bar:
    """Bar of a chart with a logarithmic axis.

    Attributes:
        label: text beside the bar.
        value: the value in words.
        length: of the bar, percent of the axis.
        mark: place of a mark on the axis, percent; None for no mark.
    """

    label: str
    value: str
    length: float
    mark: float | None = None


@dataclass(frozen=True)
class BarChart:
    """Bars, the longest first.

    Attributes:
        title: title of the chart.
        caption: what the bars show, with both ends of the axis.
        bars: the bars.
    """

    title: str
    caption: str
    bars: list[Bar]


def bar_charts(rows: Sequence[Difference], motion: Motion) -> Iterator[BarChart]:
    """Yield a chart of the effects of rows, and one of the changes of bodies, unless it would be empty.

    Args:
        rows: differences, in the order of their numbers on the page.
        motion: comparison of the motions.
    """
    effects = [
        (f"{number}  {what_differs(row)}", row.effect, None)
        for number, row in enumerate(rows, start=1)
        if row.standing is Standing.DIFFERENT and row.effect is not None
    ]
    yield from _chart(
        "Effect of each difference",
        "Largest change of accelerations if this number, and no other, is taken from the second file",
        effects,
    )
    changes = [(each.body, each.change, each.uncertainty) for each in motion.bodies]
    changes.sort(key=lambda each: each[1], reverse=True)
    yield from _chart(
        "Change of motion by body",
        "Largest difference of the accelerations of each body; the mark is what the digits explain",
        changes,
    )


def _chart(title: str, caption: str, values: Sequence[tuple[str, float, float | None]]) -> Iterator[BarChart]:
    """Yield a chart of the first values that are large enough.

    Args:
        title, caption: of the chart.
        values: label, relative change, and the change at which a mark stands, None for no mark.
    """
    shown = [each for each in values if MIN_EFFECT <= each[1] < math.inf][:MAX_BARS]
    if not shown:
        return
    decades = [math.log10(value) for _, value, _ in shown]
    low, high = math.floor(min(decades) - 0.1), math.ceil(max(decades))

    def part(value: float) -> float:
        """Return the place of a value on the axis, percent."""
        place = (math.log10(max(value, 10.0**low)) - low) / (high - low)
        return round(100.0 * min(place, 1.0), 1)

    bars = [
        Bar(label, percent(value), part(value), part(mark) if mark and math.isfinite(mark) else None)
        for label, value, mark in shown
    ]
    more = f"; the largest {MAX_BARS} of {len(values)}" if len(values) > len(shown) == MAX_BARS else ""
    axis = f"logarithmic from {percent(10.0**low)} to {percent(10.0**high)}"
    yield BarChart(title, f"{caption}; {axis}{more}", bars)
