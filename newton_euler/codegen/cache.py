"""Machine code and chosen constraint rows kept on disk, by name.

What the cache holds is executed. Its directory and its files must belong to this user, or to root, and nobody
else may write them; the directory is made for this user alone. A checksum would be no protection: whoever can
write a file can write a checksum that fits it.

A file holds the SHA-256 of its name and content and then the content, so that a damaged or renamed file
counts as missing. A file is written beside its place and renamed, so that no reader ever sees half of it,
whoever else writes at the same time and wherever a run is killed. A file that cannot be read or written
costs a compilation, never a run.

The cache is kept below `LIMIT` by removing what has not been used for longest. A file's time of modification
is when it was last used, to `_RECENT`. Files are counted with one write in `_COUNT_EVERY`, never by a read.
"""

from __future__ import annotations

import errno
import hashlib
import os
import re
import stat
import tempfile
import time
from contextlib import suppress
from pathlib import Path

from platformdirs import user_cache_path

from newton_euler.errors import OptionError
from newton_euler.folders import make_folder

CACHE_VARIABLE = "NEWTON_EULER_CACHE"
"""Environment variable that names the cache directory; empty for no cache."""

LIMIT = 256 * 2**20
"""Bytes that the cache is kept below, but for what is written between two counts."""

_FULL = 0.75
"""Share of the limit that is left of a cache that exceeded it."""

_COUNT_EVERY = 64
_RECENT = 3600.0
"""s within which uses are not distinguished."""

_ENDING = ".newton-euler"
_OWN = re.compile(r"[0-9a-f]{64}" + re.escape(_ENDING))
_UNFINISHED = ".newton-euler-new-"
"""Names of the cache's own files, among all that may be in a directory that somebody chose."""

_ABANDONED = 3600.0
"""s after which an unfinished file is that of a run that was killed."""

OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
"""Permissions that no directory and no file of the cache may have."""

PRIVATE = stat.S_IRWXU
"""Permissions of the directory that the cache makes."""

OWN_OR_NOTHING = "a directory of your own that nobody else can write, or nothing for no cache"

_DIGEST = 32
"""Bytes of a SHA-256."""


def _digest(key: str, code: bytes) -> bytes:
    return hashlib.sha256(key.encode() + code).digest()


def cache_key(*parts: object) -> str:
    """Return the name of an entry that depends on the text of these parts alone."""
    return hashlib.sha256("\n".join(map(str, parts)).encode()).hexdigest()


def cache_directory() -> Path | None:
    """Return the directory of the cache; None if the user wants none or has no home directory.

    Raises:
        OptionError: for a name of what is no directory and cannot become one, and for a directory that others
            own or can write.
    """
    chosen = os.environ.get(CACHE_VARIABLE)
    if chosen is not None:
        return _checked(chosen, OWN_OR_NOTHING) if chosen else None
    try:
        directory = user_cache_path("newton_euler", appauthor=False)
    except RuntimeError:  # a user without a home directory
        return None
    if not directory.is_absolute():  # platformdirs 4.2 leaves "~" to such a user
        return None
    with suppress(OSError):
        status = os.lstat(directory)
        if stat.S_ISDIR(status.st_mode) and status.st_uid == os.geteuid() and status.st_mode & OTHERS_WRITE:
            os.chmod(directory, PRIVATE)
    return _checked(str(directory), f"another directory by {CACHE_VARIABLE}, {OWN_OR_NOTHING}")


def _checked(name: str, needed: str) -> Path:
    """Return the path of a directory that is there, or that may be made later if the disk permits."""
    problem = os.strerror(errno.ENOTDIR)
    try:
        status = os.stat(name)
        if stat.S_ISDIR(status.st_mode):
            # who owns a link can point it elsewhere later
            problem = _foreign(status) or _foreign_owner(os.lstat(name))
            if not problem:
                return Path(name)
    except (FileNotFoundError, PermissionError):
        return Path(name)
    except OSError as error:
        problem = str(error.strerror)
    raise OptionError(CACHE_VARIABLE, f"{name:.100}", f"{needed} ({problem})")


def _foreign(status: os.stat_result) -> str:
    """Word why code of a file or directory is not executed; empty if it may be."""
    if owner := _foreign_owner(status):
        return owner
    return "others can write it; chmod go-w" if status.st_mode & OTHERS_WRITE else ""


def _foreign_owner(status: os.stat_result) -> str:
    trusted = (os.geteuid(), 0)
    return "" if status.st_uid in trusted else f"it belongs to user {status.st_uid}, not {trusted[0]}"


def read_cache(key: str) -> bytes | None:
    """Read the entry of a key; None if there is none, or none that can be trusted."""
    directory = cache_directory()
    if directory is None:
        return None
    path = directory / (key + _ENDING)
    try:
        # a link is not followed, and a pipe does not keep its reader waiting
        handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
        with os.fdopen(handle, "rb") as stream:
            status = os.fstat(handle)
            if not stat.S_ISREG(status.st_mode) or _foreign(status):
                return None
            content = stream.read()
    except OSError:
        return None
    if time.time() - status.st_mtime > _RECENT:
        with suppress(OSError):  # a read-only disk, or another process has removed it
            os.utime(path)
    digest, code = content[:_DIGEST], content[_DIGEST:]
    return code if _digest(key, code) == digest else None


def write_cache(key: str, code: bytes) -> None:
    """Write an entry under a key, if the disk permits."""
    directory = cache_directory()
    if directory is None:
        return
    with suppress(OSError):  # a full or read-only disk: the next run compiles again
        make_folder(directory, PRIVATE)
        if int(key, 16) % _COUNT_EVERY == 0:
            _tidy(directory)
        handle, name = tempfile.mkstemp(dir=directory, prefix=_UNFINISHED)
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(_digest(key, code) + code)
            Path(name).replace(directory / (key + _ENDING))
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise


def _tidy(directory: Path) -> None:
    """Remove files that killed runs left unfinished, and entries beyond the limit, those unused for longest
    first."""
    now, total = time.time(), 0
    found: list[tuple[float, int, str]] = []
    for entry in os.scandir(directory):
        with suppress(OSError):  # here and below: another process may have been quicker
            if not entry.is_file(follow_symlinks=False):  # somebody's own
                continue
            status = entry.stat(follow_symlinks=False)
            if _OWN.fullmatch(entry.name):
                found.append((status.st_mtime, status.st_size, entry.path))
                total += status.st_size
            elif entry.name.startswith(_UNFINISHED) and now - status.st_mtime > _ABANDONED:
                os.unlink(entry.path)
    if total > LIMIT:
        for _, size, path in sorted(found):
            if total <= _FULL * LIMIT:
                break
            with suppress(OSError):
                os.unlink(path)
                total -= size
