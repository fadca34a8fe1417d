"""Variants of parametrized tests that are slow, although other variants of the same test are fast.

    python -m pytest --durations=0 > REPORT
    python tests/support/slow_variants.py REPORT

adds the variants in the report that took more than `LONGEST` to `tests/slow_variants.txt`, whose variants
`tests/conftest.py` marks as slow. The shortest variant of each test stays among the fast tests.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

SLOW_VARIANTS = Path(__file__).parents[1] / "slow_variants.txt"
"""Names of slow variants, one a line, sorted."""

LONGEST = 1.0
"""Longest duration of a fast variant, s, with an empty cache on two cores of which other work has a part."""

DURATION = re.compile(r"\s*(?P<seconds>[0-9.]+)s call +(?P<test>\S+?)\[(?P<variant>.*)\]")
"""Line of a report: the duration of a call, the test and its variant."""


def slow_variants() -> frozenset[str]:
    """Return the names of the variants in `SLOW_VARIANTS`."""
    return frozenset(SLOW_VARIANTS.read_text(encoding="utf-8").splitlines())


def found_in(report: str) -> set[str]:
    """Return the names of the slow variants in a report of durations."""
    durations: dict[str, dict[str, float]] = {}
    for line in report.splitlines():
        if match := DURATION.fullmatch(line):
            durations.setdefault(match["test"], {})[match["variant"]] = float(match["seconds"])
    found = set[str]()
    for test, variants in durations.items():
        shortest = min(variants, key=lambda name: variants[name])
        found |= {
            f"{test}[{name}]" for name, seconds in variants.items() if seconds > LONGEST and name != shortest
        }
    return found


if __name__ == "__main__":
    names = slow_variants() | found_in(Path(sys.argv[1]).read_text(encoding="utf-8"))
    SLOW_VARIANTS.write_text("".join(f"{name}\n" for name in sorted(names)), encoding="utf-8")
