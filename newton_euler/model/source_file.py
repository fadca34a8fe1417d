"""Safe reading of input files from untrusted sources: size limits, and one-line errors that name the file.

The functions read regular files as bytes or UTF-8 text. `TimeTable` has the columns of a CSV file: finite
numbers over ascending times. `scan` checks XML text before another parser builds a tree from it.
`Request` holds the options of the readers of MJCF and URDF files. All errors are `SourceError`s.
"""

from __future__ import annotations

import csv
import io
import os
import re
import stat
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple, TypedDict, TypeGuard, get_args
from xml.parsers import expat

import numpy as np

from newton_euler.errors import NewtonEulerError, check_choice, check_choices, plain_number, quoted
from newton_euler.limits import MB, exceeded, limit, size_in_bytes
from newton_euler.model.scene import REDUNDANCY_TOLERANCE
from newton_euler.scalars import Array, Floats

FrictionName = Literal["off", "regularized"]
"""Treatment of dry friction of model files: not simulated, or as `newton_euler.JointFriction`."""

LimitsName = Literal["off", "compliant"]
"""Treatment of joint limits of model files: not simulated, or as `newton_euler.JointStop`."""


class ReadOptions(TypedDict, total=False):
    """Keyword options of the readers of model files (MJCF and URDF).

    Attributes:
        duration, output_period: duration of the scene and time between outputs, s; 1.0 and 0.01 if they are
            not given. Model files contain neither.
        redundancy_tolerance: dimensionless size of the independent part of a constraint equation below which
            the equation counts as redundant, see `newton_euler.Scene`; 1e-4 if it is not given.
        verified: True (default) to compare the imported scene with the model that MuJoCo or Pinocchio
            compiles from the file.
        excitation: True to drive the actuators by sines and to start joints with small velocities, because a
            model at rest tests little; False by default.
        friction: "regularized" to simulate dry friction of joints by a force that is viscous at low speed;
            "off" (default) to leave dry friction out.
        limits: "compliant" to simulate limits of joints by springs with damping; "off" (default) to leave
            limits out.
    """

    duration: float
    output_period: float
    redundancy_tolerance: float
    verified: bool
    excitation: bool
    friction: FrictionName
    limits: LimitsName


@dataclass(frozen=True)
class Request:
    """Options of the readers of model files (MJCF and URDF), complete with defaults; see `ReadOptions`.

    If `verified` is False, the caller compares the scene with the file later; the import report has what this
    comparison needs.
    """

    duration: float = 1.0
    output_period: float = 0.01
    redundancy_tolerance: float = REDUNDANCY_TOLERANCE
    verified: bool = True
    excitation: bool = False
    friction: FrictionName = "off"
    limits: LimitsName = "off"

    @classmethod
    def of(cls, options: ReadOptions) -> Request:
        """Complete keyword options with the defaults; raises `UnknownNameError` for an unknown option."""
        check_choices("option", options, ReadOptions.__annotations__)
        request = cls(**options)
        check_choice("friction", request.friction, get_args(FrictionName))
        check_choice("limits", request.limits, get_args(LimitsName))
        return request


class SourceError(NewtonEulerError):
    """A file that cannot be used.

    Attributes:
        path: path of the file.
        problem: what is wrong, with the line or element of the file where it is known.
    """

    def __init__(self, path: str, problem: str) -> None:
        self.path = path
        self.problem = problem
        super().__init__(f"{path}: {problem}")


def is_path(text: object) -> TypeGuard[str]:
    """Return True for text that can be the path of a file, whether such a file exists or not."""
    try:
        return isinstance(text, str) and b"\0" not in os.fsencode(text)
    except UnicodeEncodeError:
        return False


def path_text(path: object, error: type[SourceError] = SourceError) -> str:
    """Convert a path to text; raises `error` (a class of `SourceError`) for a value that is not a path."""
    where = os.fspath(path) if isinstance(path, os.PathLike) else path
    if not is_path(where):
        raise error(f"{quoted(where, 200)}", "cannot be read; needed: a path of a file")
    return where


def read_content(
    path: str | os.PathLike[str], limit: str, error: type[SourceError] = SourceError, before: int = 0
) -> bytes:
    """Read the bytes of a regular file.

    Args:
        path: path of the file.
        limit: name of the limit on the file size in `newton_euler.limits`.
        error: class of the error to raise, `SourceError` or a subclass.
        before: bytes of other files that count against the same limit.

    Raises:
        SourceError: of the class `error`, for a file that cannot be read or exceeds the limit.
    """
    where = path_text(path, error)
    try:
        status = Path(where).stat()
        if not stat.S_ISREG(status.st_mode):  # a pipe would keep its reader waiting
            raise error(where, "not a regular file")
        if problem := exceeded(limit, (before + status.st_size) / MB):  # the message, empty if allowed
            raise error(where, problem)
        with Path(where).open("rb") as stream:
            max_size, parts = size_in_bytes(limit), list[bytes]()
            # Stop after the limit, because the file may grow while it is read. Read in parts of 1 MB, because
            # Python allocates memory for the whole size that a single call of `read` asks for
            while (rest := max_size + 1 - sum(map(len, parts))) > 0 and (part := stream.read(min(rest, MB))):
                parts.append(part)
            return b"".join(parts)
    except OSError as failure:
        raise error(where, f"cannot be read: {failure.strerror}") from failure


def read_text(
    path: str | os.PathLike[str], limit: str, error: type[SourceError] = SourceError, before: int = 0
) -> str:
    """Read a regular file of UTF-8 text; arguments and errors are those of `read_content`."""
    try:
        return read_content(path, limit, error, before).decode("utf-8-sig")
    except UnicodeDecodeError as failure:
        raise error(os.fspath(path), "not a UTF-8 text file") from failure


def read_xml(path: str | os.PathLike[str], error: type[SourceError] = SourceError, before: int = 0) -> str:
    """Read an XML file, with spaces for its comments; arguments and errors are those of `read_content`.

    XML forbids two hyphens in a comment, but MuJoCo and Pinocchio accept them, and public models have them.
    """
    text = read_text(path, "file_size", error, before)
    return re.sub("<!--.*?(-->|$)", _blank, text, flags=re.DOTALL)


def _blank(comment: re.Match[str]) -> str:
    """Return spaces for a comment, on as many lines; a comment without end stays, for an error message."""
    return re.sub(r"[^\n]", " ", comment[0]) if comment[1] else comment[0]


class Row(NamedTuple):
    """A row of a CSV file: its line number, from 1, and the text of its cells."""

    line: int
    cells: list[str]


def csv_rows(path: str, text: str, comments: bool = False) -> list[Row]:
    """Split a CSV text into its rows without empty rows; spaces around cells are removed.

    Args:
        path: path of the file, for error messages.
        text: content of the file.
        comments: True to leave out lines that begin with `#`.

    Raises:
        SourceError: for invalid CSV, control characters, and separators other than commas.
    """
    if comments:
        text = re.sub(r"(?:^|(?<=[\r\n]))[ \t]*#[^\r\n]*", "", text)  # lines keep their numbers
    reader = csv.reader(io.StringIO(text, newline=""))
    try:
        rows = [Row(reader.line_num, [cell.strip() for cell in row]) for row in reader if row]
    except csv.Error as error:
        raise SourceError(path, f"line {reader.line_num}: {error}") from error
    for separator, name in ((";", "';'"), ("\t", "tabs")):
        if rows and len(rows[0].cells) == 1 and separator in rows[0].cells[0]:
            problem = f"columns are separated by {name}"
            line = rows[0].line
            raise SourceError(path, f"line {line}: {problem}; needed: commas, and decimal points in numbers")
    for line, cells in rows:
        for cell in cells:
            if not cell.isprintable():
                raise SourceError(path, f"line {line}: {cell!r:.100} has a control character; remove it")
    return rows


def row_numbers(path: str, header: Sequence[str], row: Row) -> list[float]:
    """Convert the cells of a CSV row to floats.

    Args:
        path: path of the file, for error messages.
        header: names of the columns.
        row: line number and cells.

    Raises:
        SourceError: for a wrong number of cells, and for a cell that is empty or not a finite number.
    """
    line, cells = row
    if len(cells) != len(header):
        hint = ", and decimal points, not commas, in numbers" if len(cells) > len(header) else ""
        raise SourceError(path, f"line {line}: has {len(cells)} cells; needed: {len(header)}{hint}")
    return list(_numbers(path, header, line, cells))


def _numbers(path: str, header: Sequence[str], line: int, cells: Sequence[str]) -> Iterator[float]:
    """Yield the cells of a CSV row as floats; raises `SourceError` for a cell that is not a finite number."""
    for name, cell in zip(header, cells, strict=True):
        try:
            yield plain_number(cell)
        except ValueError as error:
            problem = f"{name} is {cell!r:.100}" if cell else f"{name} is missing"
            hint = " with a decimal point" if "," in cell else ""
            raise SourceError(path, f"line {line}: {problem}; needed: a finite number{hint}") from error


class TimeTable(NamedTuple):
    """Columns of numbers from a CSV file that has a column `time` with ascending times, s.

    Attributes:
        path: path of the file.
        lines: (n,) line numbers of the n rows in the file.
        columns: the numbers (n,) of each column, by its name in the header.
    """

    path: str
    lines: list[int]
    columns: dict[str, Floats]

    @classmethod
    def of(cls, path: str, header: Sequence[str], rows: Sequence[Row]) -> TimeTable:
        """Convert the rows of a CSV file to a table.

        Args:
            path: path of the file, for error messages.
            header: names of the columns, with `time` among them.
            rows: the rows after the header.

        Raises:
            SourceError: for a cell that is not a finite number, and for times that do not ascend.
        """
        numbers = np.array([row_numbers(path, header, row) for row in rows])
        table = cls(path, [line for line, _ in rows], dict(zip(header, numbers.T, strict=True)))
        time = table.columns["time"]
        table.refuse(np.append(False, np.diff(time) <= 0.0), "time", time, "times in ascending order")
        return table

    def refuse(self, wrong: Array, what: str, values: Array, needed: str) -> None:
        """Raise `SourceError` for the first invalid row, if there is one.

        Args:
            wrong: (n,) True for invalid rows.
            what: name of the column, for the message.
            values: (n,) numbers of the column.
            needed: description of the valid values.
        """
        for row in np.flatnonzero(wrong)[:1]:
            problem = f"line {self.lines[row]}: {what} is {values[row]:.9g}"
            raise SourceError(self.path, f"{problem}; needed: {needed}")


def check_names(path: str, header: Sequence[str], line: int = 1) -> None:
    """Raise `SourceError` if two columns of a CSV header have the same name.

    Args:
        path: path of the file.
        header: names of the columns.
        line: line of the header.
    """
    for name in header:
        if header.count(name) > 1:
            raise SourceError(path, f"line {line}: column {quoted(name)} is there twice; needed: once")


MAX_XML_DEPTH = 400
"""Largest number of XML elements inside of each other; recursive parsers overflow the stack at more."""

MAX_EXCERPT_BYTES = 40
"""Length of the text in an error message about XML that is not well-formed."""

MAX_MODEL_NUMBER = 1e15
"""Largest magnitude of any number in a model file, so that squares and triple products stay finite."""

NON_FINITE_WORDS = ("nan", "inf", "infinity")
"""Words, in lower case and without sign, that C libraries read as numbers that are not finite."""

Begin = Callable[[str, dict[str, str], int], None]
"""Function that `scan` calls with the tag, the attributes and the line number of an XML element."""


def xml_tree(text: str) -> ET.Element:
    """Return the root element of an XML text that `scan` accepts.

    Tags keep their prefixes, such as "drake:joint". As in MuJoCo and Pinocchio, a prefix needs no namespace.
    """
    builder = ET.TreeBuilder()
    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    parser.Parse(text, True)
    return builder.close()


def scan(path: str, text: str, root: str | None, begin: Begin, error: type[SourceError]) -> None:
    """Call a function for every element of an XML text, and refuse dangerous XML.

    Args:
        path: path of the file, for error messages.
        text: content of the file.
        root: required tag of the outermost element; None allows any tag.
        begin: function to call for each element, in the order of the text.
        error: class of the error to raise, `SourceError` or a subclass.

    Raises:
        SourceError: for text that is not well-formed, another root element, and too many or too deeply nested
            elements. Also for a document type declaration, whose entities can expand to gigabytes or read
            other files.
    """
    parser = expat.ParserCreate()
    depth = count = 0
    max_count = limit("elements")

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, count
        line = parser.CurrentLineNumber
        if count == 0 and root not in (None, tag):
            raise error(path, f"line {line}: root element is <{tag:.100}>, not <{root}>")
        depth, count = depth + 1, count + 1
        if depth > MAX_XML_DEPTH:
            raise error(path, f"line {line}: more than {MAX_XML_DEPTH} nested elements")
        if count > max_count:
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
        rest = text.encode()[parser.ErrorByteIndex :][:MAX_EXCERPT_BYTES].decode(errors="replace")
        place = f" at {rest.splitlines()[0]!r}" if rest.strip() else ""
        raise error(path, f"not XML: line {failure.lineno}: {problem}{place}") from failure


TARGETS = ("joint", "jointinparent", "tendon", "site", "body")
"""Attributes of XML elements that name what the element acts on."""


class SourceLine(NamedTuple):
    """Line of a text file.

    Attributes:
        path: path of the file.
        line: number of the line, from 1.
    """

    path: str
    line: int


def element_lines(texts: Mapping[str, str], error: type[SourceError]) -> dict[tuple[str, str], SourceLine]:
    """Return the line of each element with a name in XML texts, by its tag and its name.

    An element without name that acts on another one, such as an actuator of MJCF, has the name of that one,
    unless an element with this tag and name is there. If several elements have the same tag and name, the
    first one counts.

    Args:
        texts: texts by the paths of their files.
        error: class of the error to raise for a text that is not well-formed.
    """
    lines: dict[tuple[str, str], SourceLine] = {}
    unnamed: dict[tuple[str, str], SourceLine] = {}
    for path, text in texts.items():

        def store(tag: str, attributes: dict[str, str], line: int, path: str = path) -> None:
            if "name" in attributes:
                lines.setdefault((tag, attributes["name"]), SourceLine(path, line))
                return
            target = next((attributes[what] for what in TARGETS if what in attributes), "")
            if target:
                unnamed.setdefault((tag, target), SourceLine(path, line))

        scan(path, text, None, store, error)
    return lines | {key: line for key, line in unnamed.items() if key not in lines}
