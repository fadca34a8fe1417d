"""Fingerprints of traced programs: one hash of all they depend on, the source that traces them included."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np


def fingerprint(*values: object, neutral: frozenset[str] = frozenset()) -> str | None:
    """Hash some values and this package's source.

    None if one of them holds something whose meaning lies outside this package: an object of a class of the
    user's own, for one.

    Args:
        neutral: names of fields that no program depends on.
    """
    try:
        parts = [part for value in values for part in _parts(value, neutral)]
    except TypeError:
        return None
    return hashlib.sha256(b"\0".join([SOURCE, *parts])).hexdigest()


PACKAGE = Path(__file__).parents[1]
"""Every module of `newton_euler`: the equations as well as their compiler."""


def _source() -> bytes:
    """Hash the package's files."""
    found = hashlib.sha256()
    for path in sorted(PACKAGE.rglob("*.py")):
        found.update(path.read_bytes())
    return found.digest()


SOURCE = _source()
"""Digest of the source files at import time; later edits of the files do not affect this process."""


def _parts(value: Any, neutral: frozenset[str]) -> Iterator[bytes]:
    """Yield the same bytes for the same value, in every process."""
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
