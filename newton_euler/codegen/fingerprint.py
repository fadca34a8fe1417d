"""What a traced program depends on, as one hash: the scene, and the source that traces it."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

NEUTRAL = frozenset({"description", "duration", "output_period", "controller", "shapes", "meshes"})
"""Fields of scenes, control laws and bodies that no equation sees."""


def fingerprint(*values: object) -> str | None:
    """The hash of some values and of this package's source.

    None if one of them holds something whose meaning lies outside this package: an object of a class of the
    user's own, for one.
    """
    try:
        parts = [part for value in values for part in _parts(value)]
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
"""Of the files as they are imported; later they may be edited, and this process would not know."""


def _parts(value: Any) -> Iterator[bytes]:
    """The same bytes for the same value, in every process."""
    if value is None or isinstance(value, str | int | float):
        yield repr(value).encode()
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
        yield f"{value.dtype.str}{value.shape}".encode()
        yield value.tobytes()
    elif isinstance(value, tuple | list | frozenset | Mapping):
        items = sorted(value) if isinstance(value, frozenset) else value
        yield f"{type(value).__name__} {len(value)}".encode()
        for item in items.items() if isinstance(items, Mapping) else items:
            yield from _parts(item)
    elif type(value).__module__.startswith("newton_euler."):
        yield type(value).__qualname__.encode()
        names = [f.name for f in fields(value)] if is_dataclass(value) else value.DEFINED_BY
        for name in names:
            if name not in NEUTRAL:
                yield name.encode()
                yield from _parts(getattr(value, name))
    else:
        raise TypeError(f"{type(value)} has no fingerprint")
