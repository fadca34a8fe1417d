"""Files that somebody else wrote: read within limits, refused with one line that names the file."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from newton_euler.errors import NewtonEulerError

LONGEST_PROBLEM = 1000
"""Characters of a message; names and values in files have any length."""


class SourceError(NewtonEulerError):
    """A file that cannot be used: names the file and what is wrong where."""

    def __init__(self, path: str, problem: str) -> None:
        self.path = path
        self.problem = problem
        super().__init__(f"{path}: {shortened(problem)}")


def shortened(problem: str) -> str:
    """A message of at most `LONGEST_PROBLEM` characters."""
    return problem if len(problem) <= LONGEST_PROBLEM else f"{problem[: LONGEST_PROBLEM - 4]} ..."


def read_text(path: str | os.PathLike[str], maximum: int, error: type[SourceError] = SourceError) -> str:
    """The text of a regular UTF-8 file of at most `maximum` bytes.

    Raises:
        SourceError: of the class `error`.
    """
    where = os.fspath(path)
    try:
        if not stat.S_ISREG(Path(where).stat().st_mode):  # a pipe would keep its reader waiting
            raise error(where, "not a regular file")
        with Path(where).open("rb") as stream:
            content = stream.read(maximum + 1)
        if len(content) > maximum:
            raise error(where, f"larger than {maximum} bytes")
        return content.decode("utf-8-sig")
    except OSError as failure:
        raise error(where, f"cannot be read: {failure.strerror}") from failure
    except UnicodeDecodeError as failure:
        raise error(where, "not a UTF-8 text file") from failure
    except ValueError as failure:  # a null in the path
        raise error(repr(where), f"cannot be read: {failure}") from failure
