"""Bar charts of reports, which pages draw as tables with bars.

In: labels and values, `Measure`. Out: a `BarChart`, whose bars have lengths in percent of the axis. Such a
chart is legible on narrow screens, in dark mode, and by screen readers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from crosscheck.compare.outcome import Verdict

MAX_BARS = 12
"""Largest number of bars of a chart."""


@dataclass(frozen=True)
class Bar:
    """Bar of a chart.

    Attributes:
        label: text beside the bar.
        value: the value in words.
        length: length of the bar, percent of the axis.
        mark: place of a mark on the axis, percent; None for no mark.
        verdict: judgment of the value, which selects the color of the bar.
    """

    label: str
    value: str
    length: float
    mark: float | None = None
    verdict: Verdict = ""


@dataclass(frozen=True)
class BarChart:
    """Bars with a common axis.

    Attributes:
        title: title of the chart.
        caption: what the bars show, with both ends of the axis.
        bars: the bars, in their order.
    """

    title: str
    caption: str
    bars: list[Bar]


class Measure(NamedTuple):
    """Value that a bar shows.

    Attributes:
        label: text beside the bar.
        value: the value; a value that is not finite has a bar over the whole axis.
        text: the value in words.
        mark: value at which a mark stands; None for no mark.
        verdict: judgment of the value.
    """

    label: str
    value: float
    text: str
    mark: float | None = None
    verdict: Verdict = ""


def linear_chart(title: str, caption: str, measures: Sequence[Measure], end: float = 0.0) -> list[BarChart]:
    """Make a chart whose axis begins at zero; no chart without measures.

    Args:
        title, caption: texts of the chart.
        measures: values, at least zero, of which the first `MAX_BARS` are shown.
        end: smallest value at the end of the axis.
    """
    shown = measures[:MAX_BARS]
    if not shown:
        return []
    largest = max([end, *_finite(shown)]) or 1.0  # without any length the axis has no scale
    return [_chart(title, caption, measures, lambda value: value / largest)]


def log_chart(title: str, caption: str, measures: Sequence[Measure], unit: str = "") -> list[BarChart]:
    """Make a chart with a logarithmic axis of whole decades; no chart without a positive value.

    The axis covers all bars, and marks beyond the longest bar.

    Args:
        title, caption: texts of the chart; the ends of the axis are added to the caption.
        measures: values, of which the first `MAX_BARS` are shown; a value of zero has no bar.
        unit: unit of the values, for the ends of the axis.
    """
    shown = measures[:MAX_BARS]
    values = [value for value in _finite(shown) if value > 0.0]
    if not values:
        return []
    marks = [each.mark for each in shown if each.mark and math.isfinite(each.mark)]
    low, high = math.floor(math.log10(min(values)) - 0.1), math.ceil(math.log10(max([*values, *marks])))

    def place(value: float) -> float:
        """Return the place of a value on the axis, from 0 to 1."""
        return (math.log10(max(value, 10.0**low)) - low) / (high - low)

    ends = " to ".join(f"{10.0**decade:g} {unit}".rstrip() for decade in (low, high))
    return [_chart(title, f"{caption}; logarithmic from {ends}", measures, place)]


def _chart(
    title: str, caption: str, measures: Sequence[Measure], place: Callable[[float], float]
) -> BarChart:
    """Make a chart of the first measures.

    Args:
        title, caption: texts of the chart; the number of bars that are left out is added to the caption.
        measures: the values.
        place: returns the place of a value on the axis, from 0 to 1.
    """

    def percent(value: float) -> float:
        """Return the place of a value on the axis, percent."""
        return round(100.0 * min(place(value), 1.0), 1) if math.isfinite(value) else 100.0

    bars = []
    for each in measures[:MAX_BARS]:
        mark = percent(each.mark) if each.mark and math.isfinite(each.mark) else None
        bars.append(Bar(each.label, each.text, percent(each.value), mark, each.verdict))
    more = f"; the first {MAX_BARS} of {len(measures)}" if len(measures) > MAX_BARS else ""
    return BarChart(title, f"{caption}{more}", bars)


def _finite(measures: Sequence[Measure]) -> list[float]:
    """Return the finite values."""
    return [each.value for each in measures if math.isfinite(each.value)]
