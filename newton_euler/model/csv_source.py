"""CSV that somebody else wrote, as columns of finite numbers over ascending times."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from newton_euler.errors import plain_number
from newton_euler.model.source_file import SourceError
from newton_euler.scalars import Array, Floats

Row = tuple[int, list[str]]  # number of a line, the first being 1, and its cells


def csv_rows(path: str, text: str) -> list[Row]:
    """Return the rows of a CSV text that are not empty, cells stripped; raises `SourceError`."""
    reader = csv.reader(io.StringIO(text, newline=""))
    try:
        rows = [(reader.line_num, [cell.strip() for cell in row]) for row in reader if row]
    except csv.Error as error:
        raise SourceError(path, f"line {reader.line_num}: {error}") from error
    for separator in ";\t":
        if rows and len(rows[0][1]) == 1 and separator in rows[0][1][0]:
            problem = f"columns are separated by {separator!r}"
            raise SourceError(path, f"line 1: {problem}; needed: commas, and decimal points in numbers")
    return rows


def row_numbers(path: str, header: Sequence[str], row: Row) -> list[float]:
    """Return the numbers of a row; raises `SourceError` for cells that are missing or no finite numbers."""
    line, cells = row
    if len(cells) != len(header):
        hint = ", and decimal points, not commas, in numbers" if len(cells) > len(header) else ""
        raise SourceError(path, f"line {line}: has {len(cells)} cells; needed: {len(header)}{hint}")
    return list(_numbers(path, header, line, cells))


def _numbers(path: str, header: Sequence[str], line: int, cells: Sequence[str]) -> Iterator[float]:
    for name, cell in zip(header, cells, strict=True):
        try:
            yield plain_number(cell)
        except ValueError as error:
            problem = f"{name} is {cell!r:.100}" if cell else f"{name} is missing"
            hint = " with a decimal point" if "," in cell else ""
            raise SourceError(path, f"line {line}: {problem}; needed: a finite number{hint}") from error


class TimeTable(NamedTuple):
    """Numbers of a file, one of whose columns is `time`.

    Attributes:
        path: of the file.
        lines: (n,) numbers of the rows in the file.
        columns: (n,) each, by name.
    """

    path: str
    lines: list[int]
    columns: dict[str, Floats]

    @classmethod
    def of(cls, path: str, header: Sequence[str], rows: Sequence[Row]) -> TimeTable:
        """Read the numbers of rows; raises `SourceError`, for times that do not ascend, too."""
        numbers = np.array([row_numbers(path, header, row) for row in rows])
        table = cls(path, [line for line, _ in rows], dict(zip(header, numbers.T, strict=True)))
        time = table.columns["time"]
        table.refuse(np.append(False, np.diff(time) <= 0.0), "time", time, "times in ascending order")
        return table

    def refuse(self, wrong: Array, what: str, values: Array, needed: str) -> None:
        """Raise `SourceError` for the first row that is wrong."""
        for row in np.flatnonzero(wrong)[:1]:
            problem = f"line {self.lines[row]}: {what} is {values[row]:.9g}"
            raise SourceError(self.path, f"{problem}; needed: {needed}")


def check_names(path: str, header: Sequence[str]) -> None:
    """Raise `SourceError` for columns that are there twice."""
    for name in header:
        if header.count(name) > 1:
            raise SourceError(path, f"line 1: column {name!r:.100} is there twice; needed: once")
