"""A log that is read wrongly: the other reading, both errors, and the line that names column and option."""

from __future__ import annotations

from dataclasses import dataclass

from crosscheck.own_run.errors import RunError
from newton_euler.errors import quoted


@dataclass(frozen=True)
class Mistake:
    """Another reading of a log with a much smaller error.

    Attributes:
        columns: columns that are read wrongly.
        what: the other reading, such as "order x, y, z, w".
        option: option that selects the other reading, such as "--log-set quaternion=xyzw"; "" for none.
        before: error of the first reading; None if that reading fits no state of the model.
        after: error of the other reading.
    """

    columns: tuple[str, ...]
    what: str
    option: str
    before: RunError | None
    after: RunError


def mistake_line(mistake: Mistake) -> str:
    """Word a wrong reading in one line: columns, other reading, both errors, and the option to give."""
    first, *others = mistake.columns
    columns = f"column {quoted(first)}"
    if others:
        columns = f"columns {quoted(first)} and {len(others)} more"
    after = f"an error of {_percent(mistake.after.relative)} of the motion"
    instead = "while the log as read fits no state of the model"
    if mistake.before is not None:
        instead = f"instead of {_percent(mistake.before.relative)}"
    remedy = f"; give {mistake.option}" if mistake.option else ""
    return f"{columns}: {mistake.what}: {after} {instead}{remedy}"


def _percent(value: float) -> str:
    """Write a ratio in percent with two digits."""
    return f"{100.0 * value:.0f} %" if value >= 0.1 else f"{100.0 * value:.2g} %"
