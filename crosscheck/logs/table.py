"""Read the log of another simulator as a table: named columns of numbers, one row per time.

A log is a CSV file, a Parquet file, a DataFrame of pandas or polars, or a mapping from names to columns. CSV
files need no other package; Parquet files need pyarrow, which the extra `tables` installs. The limit
`log_size` of `newton_euler.limits` bounds the size of files.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from newton_euler.errors import quoted
from newton_euler.model.source_file import (
    SourceError,
    check_names,
    csv_rows,
    path_text,
    read_content,
    read_text,
)
from newton_euler.optional_packages import optional_package
from newton_euler.scalars import Array

PARQUET_SUFFIXES = (".parquet", ".pq")
"""Suffixes of files that are read as Parquet; all other files are read as CSV."""

MIN_ROWS = 3
"""Smallest number of rows of a log. With fewer rows, the rates at the start cannot be estimated."""


@dataclass(frozen=True, eq=False)
class LogTable:
    """Columns of a log.

    Attributes:
        where: file, or name of the run, for messages.
        columns: numbers (n,) by name of the column; NaN for empty cells.
        texts: for each column with cells that are no numbers, the first such cell with its row.
        lines: line of each row in a CSV file; empty for other logs, whose rows are counted from 0.
    """

    where: str
    columns: dict[str, Array]
    texts: dict[str, str]
    lines: tuple[int, ...] = ()

    def row(self, index: int) -> str:
        """Return the name of a row in messages: "line 7" of a CSV file, else "row 5"."""
        return f"line {self.lines[index]}" if self.lines else f"row {index}"

    def error(self, problem: str) -> SourceError:
        """Return the error for this log."""
        return SourceError(self.where, problem)


def read_table(given: Any, where: str = "log") -> LogTable:
    """Read a log.

    Args:
        given: path of a file, DataFrame, or mapping from names to columns.
        where: name of the run for messages; the path of a file replaces it.

    Raises:
        SourceError: for a file or table that cannot be read, with the column at fault.
        MissingPackageError: for a Parquet file without pyarrow.
    """
    if isinstance(given, str | os.PathLike):
        where = path_text(given)
        table = _read_parquet(where) if Path(where).suffix in PARQUET_SUFFIXES else _read_csv(where)
    else:
        table = _from_columns(where, given)
    lengths = {len(column) for column in table.columns.values()}
    if not lengths or min(lengths) < MIN_ROWS:
        count = min(lengths, default=0)
        raise table.error(f"has {count} {'row' if count == 1 else 'rows'}; needed: {MIN_ROWS} or more")
    return table


def _read_csv(where: str) -> LogTable:
    """Read a CSV file whose first line names the columns; comments may stand before it."""
    rows = csv_rows(where, _without_comments(where, read_text(where, "log_size")))
    header = rows[0].cells if rows else []
    check_names(where, header, rows[0].line if rows else 1)
    for line, cells in rows:
        if len(cells) != len(header):
            raise SourceError(where, f"line {line}: has {len(cells)} cells; needed: {len(header)}")
    columns, texts = dict[str, Array](), dict[str, str]()
    lines = [line for line, _ in rows[1:]]
    for k, name in enumerate(header):
        cells_of_column = [cells[k] for _, cells in rows[1:]]
        columns[name], bad = _numbers(cells_of_column)
        if bad is not None:
            texts[name] = f"line {lines[bad]}: {cells_of_column[bad]!r:.60}"
    return LogTable(where, columns, texts, tuple(lines))


def _without_comments(where: str, text: str) -> str:
    """Return the text of a CSV file with empty lines in place of the comments before the header.

    Comments begin with `#`. The last comment is the header if numbers follow, as in files of `numpy.savetxt`.
    """
    lines = text.splitlines(keepends=True)
    count = next((k for k, line in enumerate(lines) if line.strip() and not _is_comment(line)), len(lines))
    comments = [k for k in range(count) if _is_comment(lines[k])]
    if not comments:
        return text
    following = lines[count].split(",") if count < len(lines) else []
    if any(_is_number(cell) for cell in following):
        names = lines[comments[-1]].lstrip().lstrip("#")
        if names.count(",") + 1 != len(following):
            problem = f"line {count + 1}: has numbers after comments that name no columns"
            raise SourceError(where, f"{problem}; needed: a line with {len(following)} names before it")
        lines[comments.pop()] = names
    for k in comments:
        lines[k] = "\n"
    return "".join(lines)


def _is_comment(line: str) -> bool:
    """Return True if a line begins with `#`."""
    return line.lstrip().startswith("#")


def _is_number(cell: str) -> bool:
    """Return True if a cell of a CSV file is a number."""
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _read_parquet(where: str) -> LogTable:
    """Read a Parquet file."""
    parquet = optional_package("pyarrow.parquet", "tables")
    read_content(where, "log_size")  # a regular file of an allowed size
    try:
        table = parquet.read_table(where)
    except (OSError, ValueError) as error:  # pyarrow's errors are subclasses of these
        raise SourceError(where, f"cannot be read as Parquet: {' '.join(str(error).split())}") from error
    return _from_columns(where, {name: table[name].to_numpy() for name in table.column_names})


def _from_columns(where: str, given: Any) -> LogTable:
    """Convert a DataFrame or a mapping to a table."""
    names = list(given) if isinstance(given, Mapping) else list(getattr(given, "columns", ()))
    if not names:
        needed = "a file, a DataFrame or a mapping from names to columns"
        raise SourceError(where, f"is {quoted(given)}; needed: {needed}")
    check_names(where, [str(name) for name in names])
    columns, texts = dict[str, Array](), dict[str, str]()
    for name in names:
        column = given[name]
        if str(getattr(column, "dtype", "")).startswith("datetime64") and not isinstance(column, np.ndarray):
            # with a time zone, as pandas has it, or without one
            column = column.to_numpy(dtype="datetime64[ns]")
        cells = np.asarray(column)
        if cells.ndim != 1:
            problem = f"column {quoted(str(name))} has shape {cells.shape}"
            raise SourceError(where, f"{problem}; needed: one number per row, such as {name}.x, {name}.y")
        columns[str(name)], bad = _numbers(cells)
        if bad is not None:
            texts[str(name)] = f"row {bad}: {quoted(str(cells[bad]))}"
    counts = {name: len(column) for name, column in columns.items()}
    for name, count in counts.items():
        if count != (first := next(iter(counts.values()))):
            raise SourceError(where, f"column {quoted(name)} has {count} rows; needed: {first}")
    return LogTable(where, columns, texts)


def _numbers(cells: Any) -> tuple[Array, int | None]:
    """Convert cells to floats, dates and durations to s; also return the row of the first cell that is text.

    Empty cells become NaN.
    """
    if isinstance(cells, np.ndarray) and cells.dtype.kind in "fiub":
        return cells.astype(float), None
    if isinstance(cells, np.ndarray) and cells.dtype.kind in "mM":
        kind = "timedelta64[ns]" if cells.dtype.kind == "m" else "datetime64[ns]"
        return np.where(np.isnat(cells), np.nan, cells.astype(kind).astype(np.int64) * 1e-9), None
    numbers, bad = np.full(len(cells), np.nan), None
    try:
        return np.array([cell if cell not in ("", None) else np.nan for cell in cells], dtype=float), None
    except (TypeError, ValueError):
        pass
    for k, cell in enumerate(cells):
        try:
            numbers[k] = float(cell) if cell not in ("", None) else np.nan
        except (TypeError, ValueError):
            bad = k if bad is None else bad
    return numbers, bad
