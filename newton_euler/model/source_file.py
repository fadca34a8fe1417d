"""Files that somebody else wrote: read within limits, refused with one line that names the file.

CSV becomes columns of finite numbers over ascending times; XML is looked at once before any parser builds or
expands anything of it.
"""

from __future__ import annotations

import csv
import io
import os
import stat
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, TypedDict, TypeGuard
from xml.parsers import expat

import numpy as np

from newton_euler.errors import NewtonEulerError, check_choices, plain_number, quoted
from newton_euler.limits import MB, exceeded, limit, size_in_bytes
from newton_euler.model.scene import REDUNDANCY_TOLERANCE
from newton_euler.scalars import Array, Floats


class ReadOptions(TypedDict, total=False):
    """Options of a reader of model files, as keywords; see `Request`."""

    duration: float
    output_period: float
    redundancy_tolerance: float
    verified: bool
    excitation: bool


@dataclass(frozen=True)
class Request:
    """Options of a reader of model files.

    Attributes:
        duration, output_period: of the scene, s; files say nothing about either.
        redundancy_tolerance: of the scene, see `newton_euler.Scene`.
        verified: True to verify the reading. If not, `report.references` is what to verify it against.
        excitation: True to drive actuators by sines and to let joints move at the start.
    """

    duration: float = 1.0
    output_period: float = 0.01
    redundancy_tolerance: float = REDUNDANCY_TOLERANCE
    verified: bool = True
    excitation: bool = False

    @classmethod
    def of(cls, options: ReadOptions) -> Request:
        """Return these options, and defaults; raises `UnknownNameError` for one that there is not."""
        check_choices("option", options, ReadOptions.__annotations__)
        return cls(**options)


class SourceError(NewtonEulerError):
    """A file that cannot be used: names the file and what is wrong where."""

    def __init__(self, path: str, problem: str) -> None:
        self.path = path
        self.problem = problem
        super().__init__(f"{path}: {problem}")


def is_path(text: object) -> TypeGuard[str]:
    """Return True for a text that the file system can look up, whether there is such a file or not."""
    try:
        return isinstance(text, str) and b"\0" not in os.fsencode(text)
    except UnicodeEncodeError:
        return False


def path_text(path: object, error: type[SourceError] = SourceError) -> str:
    """Return a path as text; raises `SourceError`, of the class `error`, for what is none."""
    where = os.fspath(path) if isinstance(path, os.PathLike) else path
    if not is_path(where):
        raise error(f"{quoted(where, 200)}", "cannot be read; needed: a path of a file")
    return where


def read_content(
    path: str | os.PathLike[str], limit: str, error: type[SourceError] = SourceError, before: int = 0
) -> bytes:
    """Read a regular file.

    Args:
        limit: name of the limit of its size, see `newton_euler.limits`.
        error: class of what is raised.
        before: bytes that count beside those of the file.

    Raises:
        SourceError: of the class `error`.
    """
    where = path_text(path, error)
    try:
        status = Path(where).stat()
        if not stat.S_ISREG(status.st_mode):  # a pipe would keep its reader waiting
            raise error(where, "not a regular file")
        if problem := exceeded(limit, (before + status.st_size) / MB):
            raise error(where, problem)
        with Path(where).open("rb") as stream:
            most, parts = size_in_bytes(limit), list[bytes]()
            # it may grow; in parts, as Python gets memory for all that it is asked to read
            while (rest := most + 1 - sum(map(len, parts))) > 0 and (part := stream.read(min(rest, MB))):
                parts.append(part)
            return b"".join(parts)
    except OSError as failure:
        raise error(where, f"cannot be read: {failure.strerror}") from failure


def read_text(
    path: str | os.PathLike[str], limit: str, error: type[SourceError] = SourceError, before: int = 0
) -> str:
    """Read a regular file of UTF-8 text; arguments and errors as of `read_content`."""
    try:
        return read_content(path, limit, error, before).decode("utf-8-sig")
    except UnicodeDecodeError as failure:
        raise error(os.fspath(path), "not a UTF-8 text file") from failure


Row = tuple[int, list[str]]  # number of a line, the first being 1, and its cells


def csv_rows(path: str, text: str) -> list[Row]:
    """Return the rows of a CSV text that are not empty, cells stripped; raises `SourceError`."""
    reader = csv.reader(io.StringIO(text, newline=""))
    try:
        rows = [(reader.line_num, [cell.strip() for cell in row]) for row in reader if row]
    except csv.Error as error:
        raise SourceError(path, f"line {reader.line_num}: {error}") from error
    for line, cells in rows:
        for cell in cells:
            if not cell.isprintable():
                raise SourceError(path, f"line {line}: {cell!r:.100} has a control character; remove it")
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
            raise SourceError(path, f"line 1: column {quoted(name)} is there twice; needed: once")


MAXIMUM_DEPTH = 400  # of nested elements; recursive parsers run out of stack somewhere above
LARGEST = 1e15  # of any number of a model, so that squares and triple products stay finite and keep digits
NOT_FINITE = ("nan", "inf", "infinity")

Begin = Callable[[str, dict[str, str], int], None]
"""Function that is called with the tag, the attributes and the line of an element."""


def scan(path: str, text: str, root: str | None, begin: Begin, error: type[SourceError]) -> None:
    """Call `begin` for every element of an XML text.

    Args:
        path: of the file, for errors.
        text: of the file.
        root: tag of the outermost element; any if None.
        begin: called in the order of the text.
        error: class of what is raised.

    Raises:
        SourceError: for text that is not well-formed, that has another root, a document type (entities
            unfold to gigabytes or to other files) or too many elements.
    """
    parser = expat.ParserCreate()
    depth = count = 0
    most = limit("elements")

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, count
        line = parser.CurrentLineNumber
        if count == 0 and root not in (None, tag):
            raise error(path, f"line {line}: root element is <{tag:.100}>, not <{root}>")
        depth, count = depth + 1, count + 1
        if depth > MAXIMUM_DEPTH:
            raise error(path, f"line {line}: more than {MAXIMUM_DEPTH} nested elements")
        if count > most:
            raise error(path, f"line {line}: {exceeded('elements', text.count('<'))}")
        begin(tag, attributes, line)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1

    def refuse(*_: object) -> None:
        raise error(path, f"line {parser.CurrentLineNumber}: a document type declaration, refused")

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
    try:
        parser.Parse(text, True)
    except expat.ExpatError as failure:
        problem = expat.errors.messages[failure.code]
        raise error(path, f"not XML: line {failure.lineno}: {problem}") from failure
