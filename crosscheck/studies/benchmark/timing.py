"""Timing for benchmarks: alternating calls, median and spread of their times, and the machine's data."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from crosscheck.engines.engine import Engine
from crosscheck.engines.versions import versions
from crosscheck.support.units import TIME_UNITS, quantity_text
from newton_euler.codegen.compile import garbage_collection_off

Progress = Callable[[str], None]
"""Function that shows one line on the progress of a benchmark."""


class Timed:
    """Base class of records with repeated times.

    Attributes:
        times: duration of each repeat, s.
    """

    times: tuple[float, ...]

    @property
    def median(self) -> float:
        """Median of the times, s."""
        return float(np.median(self.times))

    @property
    def spread(self) -> str:
        """Difference between the quartiles in percent of the median, as text."""
        low, high = np.quantile(self.times, [0.25, 0.75])
        return f"{(high - low) / self.median:.0%}"

    def ratio(self, other: Timed) -> float:
        """Return the ratio of the times of this record to those of another record.

        Records with the same number of times were timed alternately, in turns. Their ratio is the median of
        the ratios of all turns, since a change of the machine's speed affects both times of a turn alike.
        """
        if len(self.times) != len(other.times):
            return self.median / other.median
        return float(np.median(np.divide(self.times, other.times)))


def time_alternately(
    calls: Sequence[Callable[[], float]], repeats: Sequence[int], progress: Progress
) -> list[tuple[float, ...]]:
    """Repeat timed calls alternately, so that a change of the machine's speed affects all of them.

    Args:
        calls: functions that return the time that they took, s.
        repeats: number of repeats of each call. There are as many turns as the largest of these numbers. In
            a turn each call runs at most once; the repeats of a call are spread evenly over the turns.
        progress: called at five of the turns.

    Returns:
        The times of each call.
    """
    times: list[list[float]] = [[] for _ in calls]
    turns, messages = max(repeats, default=0), 5
    for turn in range(turns):
        # the condition (turn * n) % turns < n holds in n of the turns, evenly spaced
        if turn * messages % turns < messages:
            progress(f"timing {len(calls)} settings alternately: {turn + 1} of {turns}")
        for call, count, row in zip(calls, repeats, times, strict=True):
            if turn * count % turns < count:
                with garbage_collection_off():
                    row.append(call())
    return [tuple(row) for row in times]


def machine(engines: Iterable[Engine]) -> dict[str, Any]:
    """Describe the machine: processor, number of cores, mean number of running processes in the last minute
    (load), system, and versions of packages, also those of engines."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "load": round(os.getloadavg()[0], 2),
        "system": f"{platform.system()} {platform.machine()}",
        "versions": versions(engines),
    }


def _processor() -> str:
    """Return the name of the processor, from /proc/cpuinfo or from Python."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            name, _, value = line.partition(":")
            if name.strip() == "model name":
                return value.strip()
    return platform.processor() or platform.machine()


def rounded(value: float) -> str:
    """Format a number with three significant digits and without an exponent."""
    return f"{float(f'{value:.3g}'):,.12g}"


def time_text(seconds: float) -> str:
    """Format a time, given in s, with three significant digits in s, ms, us or ns."""
    return quantity_text(seconds, TIME_UNITS)
