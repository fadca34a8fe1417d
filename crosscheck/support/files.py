"""Writing result files safely.

Before a long computation, `check_writable` verifies that its files can be written. After it, `write_files`
writes all of the files or none of them, unless the process is killed, or an error occurs, in the short time
in which it renames them. The first file, such as a summary of the others, is renamed last: if it has been
replaced, all files have.
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
import time
from collections.abc import Iterable, Mapping
from contextlib import ExitStack, suppress
from itertools import product
from pathlib import Path

from crosscheck.support.errors import CrosscheckError
from crosscheck.support.time_limits import signals_as_interrupts
from newton_euler.errors import quoted
from newton_euler.folders import make_folder
from newton_euler.model.source_file import is_path
from newton_euler.model.written_file import atomic_file, is_special

ABANDONED_AFTER_S = 60.0
"""Age, s, from which an unfinished file counts as left behind by a process that was killed. Contents are
prepared in memory first, so that writing takes less time than this."""


def path_of(given: str | os.PathLike[str]) -> Path:
    """Return a path; raise `CrosscheckError` for text that cannot be a path, such as a null character."""
    if not is_path(text := os.fspath(given)):
        raise CrosscheckError(f"{quoted(text)} is no path")
    return Path(text)


def check_writable(*paths: Path) -> None:
    """Create the folders of some files, and raise `CrosscheckError` if one of the files cannot be written.

    Unfinished versions of these files, left behind by processes that were killed, are removed.
    """
    for path in paths:
        try:
            if path.is_dir():
                raise CrosscheckError(f"cannot write {path}: it is a directory")
            if is_special(path):
                raise CrosscheckError(f"cannot write {path}: not a regular file")
            make_folder(path.parent)
            with tempfile.TemporaryFile(dir=path.parent):
                pass
        except OSError as error:
            raise CrosscheckError(f"cannot write {path}: {error.strerror}") from error
        # `atomic_file` writes to .STEM-XXXXXXXX.SUFFIX (X: hexadecimal digit) and renames the file at the end
        unfinished = re.compile(rf"\.{re.escape(path.stem)}-[0-9a-f]{{8}}{re.escape(path.suffix)}")
        remove_abandoned(each for each in path.parent.iterdir() if unfinished.fullmatch(each.name))


def remove_abandoned(unfinished: Iterable[Path]) -> None:
    """Remove unfinished files and folders that have not changed for `ABANDONED_AFTER_S` seconds."""
    for path in unfinished:
        with suppress(OSError):  # another process may remove them at the same time
            if time.time() - path.stat().st_mtime > ABANDONED_AFTER_S:
                shutil.rmtree(path) if path.is_dir() else path.unlink()


def write_files(files: Mapping[Path, bytes], stale: Iterable[Path] = ()) -> None:
    """Write files, all of them or none.

    Each file is written under a temporary name first. When all are complete, stale files are removed and the
    files are renamed, the first of `files` last.

    Args:
        files: content by path.
        stale: files of earlier results to remove.

    Raises:
        CrosscheckError: if a file cannot be written; the message names the path.
    """
    path = Path()
    try:
        # at its end, the stack renames the files in reverse order; it removes all of them after an error, and
        # after a signal that would end the process
        with signals_as_interrupts(), ExitStack() as stack:
            for path, content in files.items():
                stack.enter_context(atomic_file(path)).write_bytes(content)
            for path in stale:
                path.unlink(missing_ok=True)
    except OSError as error:
        # `filename2`: final path of a file that could not be renamed
        raise CrosscheckError(f"cannot write {error.filename2 or path}: {error.strerror}") from error


def check_no_source(targets: Iterable[Path], sources: Iterable[str | Path]) -> None:
    """Raise `CrosscheckError` if one of the files to write (targets) is also a file to read (sources)."""
    for target, source in product(targets, list(sources)):
        if os.path.exists(target) and os.path.exists(source) and os.path.samefile(target, source):
            raise CrosscheckError(f"the output would overwrite the input file {source}; name another file")
