"""Stores of sweeps with one value of their metadata, or bytes of one file, replaced."""

from __future__ import annotations

import json
import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

VALUES: tuple[Any, ...] = (
    None, True, 0, 1, -1, 3, 2**31, 2**63, 10**30, 0.5, 1e300, "", "x", "NaN", "../x", "a\x1b[31m", [], [0],
    [-1], [1, 1], [10**30], ["x"], {}, {"name": "x"}, [[]], "9" * 3000,
)  # fmt: skip
"""Values of other types and sizes than a field has."""


def places(content: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the path of every value of a JSON document."""
    if path:
        yield path
    if not isinstance(content, dict | list):
        return
    for key, value in content.items() if isinstance(content, dict) else enumerate(content):
        yield from places(value, (*path, key))


def replaced(file: Path, dice: random.Random) -> str:
    """Replace or remove one value of a JSON file; returns what was done."""
    content = json.loads(file.read_text())
    *parents, last = path = dice.choice(list(places(content)))
    holder = content
    for key in parents:
        holder = holder[key]
    if dice.random() < 0.1:
        del holder[last]
        done = f"{path} removed"
    else:
        holder[last] = dice.choice(VALUES)
        done = f"{path} is {holder[last]!r:.60}"
    file.write_text(json.dumps(content))
    return f"{file.parent.name}/{file.name}: {done}"


def damaged(store: Path, dice: random.Random) -> str:
    """Damage one file of a store; returns what was done."""
    files = sorted(path for path in store.rglob("*") if path.is_file())
    file = dice.choice(files)
    if file.name == "zarr.json" and dice.random() < 0.9:
        return replaced(file, dice)
    content = bytearray(file.read_bytes())
    kind = dice.choice(("bit", "cut", "noise", "longer"))
    if kind == "bit" and content:
        content[dice.randrange(len(content))] ^= 1 << dice.randrange(8)
    elif kind == "cut":
        content = content[: dice.randrange(len(content) or 1)]
    elif kind == "noise":
        content = bytearray(dice.randbytes(len(content)))
    else:
        content += dice.randbytes(50)
    file.write_bytes(content)
    return f"{file.relative_to(store)}: {kind}"
