"""Cache on disk for machine code, and for the selection of independent constraint rows, which is slow.

`read_cache` and `write_cache` store bytes under a key, which `cache_key` makes from all that the bytes depend
on.

Security: the machine code is executed. So the directory and its files must belong to this user or to root,
and nobody else may have permission to write them. A checksum would be no protection, because an attacker who
can write a file can write a matching checksum.

Robustness: a file holds the SHA-256 of its key and content, then the content. A damaged or renamed file
counts as missing. A file is written under a temporary name and then renamed, so that no process reads half a
file. If a file cannot be read or written, the code is compiled again; a run never fails for it.

Size: the cache is kept below `MAX_CACHE_BYTES` by removing the files that have not been used for the longest
time. The modification time of a file is the time of its last use.
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
"""Environment variable with the path of the cache directory; an empty value turns the cache off."""

MAX_CACHE_BYTES = 256 * 2**20
"""Largest size of the cache. It may be exceeded until the next check."""

_REDUCED_FRACTION = 0.75
"""Size of the cache after a reduction, as a fraction of `MAX_CACHE_BYTES`."""

_WRITES_PER_CHECK = 64
"""Average number of writes between two checks of the size of the cache."""

_USE_TIME_RESOLUTION = 3600.0
"""Resolution of the time of last use, s: a file's time is updated only if it is older than this."""

_SUFFIX = ".newton-euler"
_ENTRY_NAME = re.compile(r"[0-9a-f]{64}" + re.escape(_SUFFIX))
_TEMPORARY_PREFIX = ".newton-euler-new-"
"""Suffix and pattern of names of cache entries, and prefix of names of files that are being written. Other
files in the directory are left alone, because the user may have chosen any directory."""

_ABANDONED_AFTER = 3600.0
"""Age of a temporary file, s, after which its process must have been killed, and the file is removed."""

OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
"""Permission bits that the directory and the files of the cache must not have."""

PRIVATE = stat.S_IRWXU
"""Permission bits of a cache directory that this module makes: access for its user only."""

OWN_OR_NOTHING = "a directory of your own that nobody else can write, or nothing for no cache"
"""Text for error messages: what `CACHE_VARIABLE` should name."""

_DIGEST_SIZE = 32
"""Length of a SHA-256 digest, bytes."""


def _digest(key: str, content: bytes) -> bytes:
    """Return the SHA-256 of a key and a content, with which the file of an entry begins."""
    return hashlib.sha256(key.encode() + content).digest()


def cache_key(*parts: object) -> str:
    """Return the key of an entry: the SHA-256 of the texts of all parts that the entry depends on."""
    return hashlib.sha256("\n".join(map(str, parts)).encode()).hexdigest()


def cache_directory() -> Path | None:
    """Return the directory of the cache; None if the user has turned it off or has no home directory.

    Raises:
        OptionError: if the path is not a directory and cannot become one, or if another user owns the
            directory or may write to it.
    """
    chosen = os.environ.get(CACHE_VARIABLE)
    if chosen is not None:
        return _trusted_path(chosen, OWN_OR_NOTHING) if chosen else None
    try:
        directory = user_cache_path("newton_euler", appauthor=False)
    except RuntimeError:  # a user without a home directory
        return None
    if not directory.is_absolute():  # platformdirs 4.2 returns "~" for such a user
        return None
    # in the default directory of this user, take the permission to write away from all others
    with suppress(OSError):
        status = os.lstat(directory)
        if stat.S_ISDIR(status.st_mode) and status.st_uid == os.geteuid() and status.st_mode & OTHERS_WRITE:
            os.chmod(directory, PRIVATE)
    return _trusted_path(str(directory), f"another directory by {CACHE_VARIABLE}, {OWN_OR_NOTHING}")


def _trusted_path(name: str, needed: str) -> Path:
    """Return the path of a directory that can be trusted, does not exist yet, or cannot be accessed.

    Args:
        name: path of the directory.
        needed: text for the error message: what the user should choose.

    Raises:
        OptionError: if the directory cannot be trusted or is not a directory.
    """
    problem = os.strerror(errno.ENOTDIR)
    try:
        status = os.stat(name)
        if stat.S_ISDIR(status.st_mode):
            # the owner must be trusted for a symbolic link too: the owner could change its target later
            problem = _reason_for_distrust(status) or _untrusted_owner(os.lstat(name))
            if not problem:
                return Path(name)
    except (FileNotFoundError, PermissionError):  # no code can be read there
        return Path(name)
    except OSError as error:
        problem = str(error.strerror)
    raise OptionError(CACHE_VARIABLE, f"{name:.100}", f"{needed} ({problem})")


def _reason_for_distrust(status: os.stat_result) -> str:
    """Return why code in a file or directory must not be executed; an empty text if it may be executed."""
    if owner := _untrusted_owner(status):
        return owner
    return "others can write it; chmod go-w" if status.st_mode & OTHERS_WRITE else ""


def _untrusted_owner(status: os.stat_result) -> str:
    """Return a text about the owner if it is neither this user nor root, else an empty text."""
    trusted = (os.geteuid(), 0)
    return "" if status.st_uid in trusted else f"it belongs to user {status.st_uid}, not {trusted[0]}"


def read_cache(key: str) -> bytes | None:
    """Return the content of the entry with this key; None for a missing, damaged or untrusted entry."""
    directory = cache_directory()
    if directory is None:
        return None
    path = directory / (key + _SUFFIX)
    try:
        # do not follow symbolic links, and do not wait if the file is a pipe
        handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
        with os.fdopen(handle, "rb") as stream:
            status = os.fstat(handle)
            if not stat.S_ISREG(status.st_mode) or _reason_for_distrust(status):
                return None
            stored = stream.read()
    except OSError:
        return None
    if time.time() - status.st_mtime > _USE_TIME_RESOLUTION:
        with suppress(OSError):  # the disk is read-only, or another process has removed the file
            os.utime(path)
    digest, content = stored[:_DIGEST_SIZE], stored[_DIGEST_SIZE:]
    return content if _digest(key, content) == digest else None


def write_cache(key: str, content: bytes) -> None:
    """Store the content of an entry under a key; do nothing if the disk does not permit writing."""
    directory = cache_directory()
    if directory is None:
        return
    with suppress(OSError):  # the disk is full or read-only: the next run compiles again
        make_folder(directory, PRIVATE)
        if int(key, 16) % _WRITES_PER_CHECK == 0:  # hashes are evenly distributed
            _reduce(directory)
        handle, name = tempfile.mkstemp(dir=directory, prefix=_TEMPORARY_PREFIX)
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(_digest(key, content) + content)
            Path(name).replace(directory / (key + _SUFFIX))
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise


def _reduce(directory: Path) -> None:
    """Remove abandoned temporary files; if the cache is too large, remove entries not used for longest."""
    # list the entries, and remove abandoned files
    now, total = time.time(), 0
    entries: list[tuple[float, int, str]] = []  # time of last use, size, path
    for entry in os.scandir(directory):
        with suppress(OSError):  # here and below: another process may have removed the file
            if not entry.is_file(follow_symlinks=False):  # not made by the cache
                continue
            status = entry.stat(follow_symlinks=False)
            if _ENTRY_NAME.fullmatch(entry.name):
                entries.append((status.st_mtime, status.st_size, entry.path))
                total += status.st_size
            elif entry.name.startswith(_TEMPORARY_PREFIX) and now - status.st_mtime > _ABANDONED_AFTER:
                os.unlink(entry.path)
    # remove the oldest entries
    if total > MAX_CACHE_BYTES:
        for _, size, path in sorted(entries):
            if total <= _REDUCED_FRACTION * MAX_CACHE_BYTES:
                break
            with suppress(OSError):
                os.unlink(path)
                total -= size
