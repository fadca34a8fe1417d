"""Fingerprints of compiled programs: a hash of all objects that a program depends on, for the cache on disk.

The hash includes the source code of this package, because the package computes the program from the objects.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np


def fingerprint(*values: object, neutral: frozenset[str] = frozenset()) -> str | None:
    """Return a hash of the contents of some values and of the source code of this package.

    The result is None if a value contains an object of a class outside this package, such as one of the user:
    its behavior cannot be hashed.

    Args:
        values: numbers, texts, arrays, collections, and objects of classes of this package.
        neutral: names of fields that are not hashed, because the program does not depend on them.
    """
    try:
        parts = [part for value in values for part in _parts(value, neutral)]
    except TypeError:
        return None
    return hashlib.sha256(b"\0".join([SOURCE, *parts])).hexdigest()


PACKAGE = Path(__file__).parents[1]
"""Folder of the package `newton_euler`, with the equations of motion as well as their compiler."""


def _source() -> bytes:
    """Return the SHA-256 of all source files of the package."""
    digest = hashlib.sha256()
    for path in sorted(PACKAGE.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.digest()


SOURCE = _source()
"""Digest of the source files at import time; later edits of the files do not affect this process."""


def _parts(value: Any, neutral: frozenset[str]) -> Iterator[bytes]:
    """Yield bytes that identify the content of a value, the same in every process.

    Args:
        value: see `fingerprint`. A class of this package that is no dataclass lists the attributes that
            define its objects in `DEFINED_BY`.
        neutral: names of fields to ignore.

    Raises:
        TypeError: if the value has no fingerprint.
    """
    if value is None or isinstance(value, str | int | float):
        yield repr(value).encode()
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
        yield f"{value.dtype.str}{value.shape}".encode()
        yield value.tobytes()
    elif isinstance(value, tuple | list | frozenset | Mapping):
        items = sorted(value) if isinstance(value, frozenset) else value
        yield f"{type(value).__name__} {len(value)}".encode()
        for item in items.items() if isinstance(items, Mapping) else items:
            yield from _parts(item, neutral)
    elif type(value).__module__.startswith("newton_euler."):
        yield type(value).__qualname__.encode()
        names = [f.name for f in fields(value)] if is_dataclass(value) else value.DEFINED_BY
        for name in names:
            if name not in neutral:
                yield name.encode()
                yield from _parts(getattr(value, name), neutral)
    else:
        raise TypeError(f"{type(value)} has no fingerprint")
