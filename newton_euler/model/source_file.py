"""Files that somebody else wrote: read within limits, refused with one line that names the file."""

from __future__ import annotations

import os
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import TypedDict

from newton_euler.errors import NewtonEulerError
from newton_euler.limits import MB, exceeded, size_in_bytes
from newton_euler.model.scene import REDUNDANCY_TOLERANCE

LONGEST_PROBLEM = 1000  # characters of a message; names and values in files have any length


class ReadOptions(TypedDict, total=False):
    """Options of a reader of model files, as keywords; see `Request`."""

    duration: float
    output_period: float
    redundancy_tolerance: float
    verified: bool
    exercise: bool


@dataclass(frozen=True)
class Request:
    """Options of a reader of model files.

    Attributes:
        duration, output_period: of the scene, s; files say nothing about either.
        redundancy_tolerance: of the scene, see `newton_euler.Scene`.
        verified: True to verify the reading. If not, `report.originals` is what to verify it against.
        exercise: True to drive actuators by sines and to let joints move at the start.
    """

    duration: float = 1.0
    output_period: float = 0.01
    redundancy_tolerance: float = REDUNDANCY_TOLERANCE
    verified: bool = True
    exercise: bool = False


class SourceError(NewtonEulerError):
    """A file that cannot be used: names the file and what is wrong where."""

    def __init__(self, path: str, problem: str) -> None:
        self.path = path
        self.problem = problem
        super().__init__(f"{path}: {shortened(problem)}")


def shortened(problem: str) -> str:
    """A message of at most `LONGEST_PROBLEM` characters."""
    return problem if len(problem) <= LONGEST_PROBLEM else f"{problem[: LONGEST_PROBLEM - 4]} ..."


def path_text(path: object, error: type[SourceError] = SourceError) -> str:
    """Return a path as text; raises `SourceError`, of the class `error`, for what is none."""
    where = os.fspath(path) if isinstance(path, os.PathLike) else path
    if not isinstance(where, str) or "\0" in where:
        raise error(f"{where!r:.200}", "cannot be read; needed: a path of a file")
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
            return stream.read(size_in_bytes(limit) + 1)  # it may grow
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
