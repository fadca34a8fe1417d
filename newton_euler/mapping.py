"""What became of the elements of a model file on their way into a scene."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

Fate = Literal["exactly", "approximated", "left out"]

FATES: tuple[Fate, ...] = ("exactly", "approximated", "left out")


@dataclass(frozen=True)
class Mapped:
    """One element of a model file.

    Attributes:
        element: its kind and name, such as "equality 'close'".
        fate: carried over exactly, approximated, or left out.
        how: what it became, how it was approximated, or why it was left out.
    """

    element: str
    fate: Fate
    how: str

    def __str__(self) -> str:
        return f"{self.element}: {self.fate}: {self.how}"


class Mapping:
    """A mapping report, filled while a file is read.

    Attributes:
        entries: in the order in which they were added.
        start: lines about the pose and the velocities that the scene starts from.
    """

    def __init__(self) -> None:
        self.entries: list[Mapped] = []
        self.start: list[str] = []

    def exactly(self, element: str, how: str) -> None:
        self.entries.append(Mapped(element, "exactly", how))

    def approximated(self, element: str, how: str) -> None:
        self.entries.append(Mapped(element, "approximated", how))

    def left_out(self, element: str, why: str) -> None:
        self.entries.append(Mapped(element, "left out", why))

    def of(self, fate: Fate) -> list[Mapped]:
        """The entries of one fate."""
        return [entry for entry in self.entries if entry.fate == fate]


def unique_name(wanted: str, fallback: str, taken: Iterable[str]) -> str:
    """A name of letters, digits, `_`, `.` and `-` that is not taken, as near to the wanted one as can be."""
    name = "".join(c if c.isascii() and (c.isalnum() or c in "_.-") else "_" for c in wanted) or fallback
    known, candidate, number = set(taken), name, 2
    while candidate in known:
        candidate, number = f"{name}_{number}", number + 1
    return candidate
