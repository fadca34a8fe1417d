"""Times of calls that take turns, their medians and spread, and the machine that they were measured on."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from crosscheck.support.versions import versions
from newton_euler.codegen.compile import uncollected

MESSAGES = 5
"""Messages of progress about all turns."""

Progress = Callable[[str], None]


class Timed:
    """Base of records with times.

    Attributes:
        times: s, of the repeats.
    """

    times: tuple[float, ...]

    @property
    def median(self) -> float:
        """s"""
        return float(np.median(self.times))

    @property
    def spread(self) -> str:
        """The difference between the quartiles as a share of the median."""
        low, high = np.quantile(self.times, [0.25, 0.75])
        return f"{(high - low) / self.median:.0%}"

    def ratio(self, other: Timed) -> float:
        """Return how many times as long as the other this takes.

        The median over turns: a machine whose speed changes does so for both of a turn.
        """
        if len(self.times) != len(other.times):
            return self.median / other.median
        return float(np.median(np.divide(self.times, other.times)))


def in_turns(
    calls: Sequence[Callable[[], float]], repeats: Sequence[int], progress: Progress
) -> list[tuple[float, ...]]:
    """Make timed calls in turns, so that a machine that slows down slows all of them down.

    Args:
        calls: each returns the s that it took.
        repeats: of each call; those of which there are fewer are evenly spread over the turns.
        progress: told `MESSAGES` of the turns.
    """
    times: list[list[float]] = [[] for _ in calls]
    turns = max(repeats, default=0)
    for turn in range(turns):
        if turn * MESSAGES % turns < MESSAGES:
            progress(f"timing {len(calls)} settings in turns: {turn + 1} of {turns}")
        for call, count, row in zip(calls, repeats, times, strict=True):
            if turn * count % turns < count:
                with uncollected():
                    row.append(call())
    return [tuple(row) for row in times]


def machine() -> dict[str, Any]:
    """Describe the machine: processor, cores, load by others now, system, versions."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "load": round(os.getloadavg()[0], 2),
        "system": f"{platform.system()} {platform.machine()}",
        "versions": versions(),
    }


def _processor() -> str:
    """Return the name of the processor, from where Linux keeps it or as Python knows it."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            name, _, value = line.partition(":")
            if name.strip() == "model name":
                return value.strip()
    return platform.processor() or platform.machine()


def rounded(value: float) -> str:
    """Three digits, and zeros instead of an exponent."""
    return f"{float(f'{value:.3g}'):,.12g}"


def shown(seconds: float) -> str:
    """Three digits of a time in the unit that suits it."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds / 1e-9:.3g} ns"
