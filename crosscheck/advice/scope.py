"""The model that advice is about, where a file holds more than what is compared."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from crosscheck.advice.measured import Advice, Found
from newton_euler.verification.import_report import ImportedElement

MOST_NAMED = 4
"""Elements; the report before the tables has all."""


def scope_advice(found: Found) -> Iterator[Advice]:
    """For models of which something that moves bodies was left out or approximated."""
    if found.mapping is None:
        return
    left_out = [entry for entry in found.mapping.of("left out") if not entry.inert]
    approximated = found.mapping.of("approximated")
    parts = []
    if left_out:
        parts.append(f"without {_list(left_out)}")
    if approximated:
        parts.append(f"with {_list(approximated)} as approximated")
    if parts:
        yield Advice(
            "model",
            f"what follows is for the model {' and '.join(parts)}; where those act its errors, its cost and "
            "the steps that it needs are others",
        )


def _list(entries: Sequence[ImportedElement]) -> str:
    named = [f"{entry.element} ({entry.how})" for entry in entries[:MOST_NAMED]]
    rest = len(entries) - len(named)
    return ", ".join(named) + (f" and {rest} more" if rest else "")
