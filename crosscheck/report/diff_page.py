"""Bar charts on the page of `crosscheck diff`: what each difference does to the motion, and where.

In: rows of differences, and the comparison of motions. Out: a `BarChart` of each.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from crosscheck.differences.difference import Difference, Standing
from crosscheck.differences.motion import Motion
from crosscheck.report.chart import BarChart, Measure, log_chart
from crosscheck.report.diff import what_differs
from crosscheck.report.diff_values import MIN_EFFECT
from crosscheck.report.own_run import percent


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
    """Yield a chart of the values that are large enough, if there are any.

    Args:
        title, caption: texts of the chart.
        values: label, relative change, and the change at which a mark stands, None for no mark.
    """
    measures = [
        Measure(label, 100.0 * value, percent(value), mark and 100.0 * mark)
        for label, value, mark in values
        if MIN_EFFECT <= value < math.inf
    ]
    yield from log_chart(title, caption, measures, "%")
