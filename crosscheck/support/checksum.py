"""The checksum of a file of results: damage of the file is found when it is read."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

CHECKSUM = "sha256"
"""Field of a file of results: the SHA-256 of all other fields."""


def checksum(content: Mapping[str, Any]) -> str:
    """The SHA-256 of all fields of results but `CHECKSUM`, whatever their order and layout in the file."""
    rest = {name: value for name, value in content.items() if name != CHECKSUM}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


def sealed(content: Mapping[str, Any]) -> dict[str, Any]:
    """Results with their checksum."""
    return {**content, CHECKSUM: checksum(content)}
