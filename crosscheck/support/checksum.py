"""The checksum that crosscheck stores in its JSON result files, to detect files that were damaged or
edited."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

CHECKSUM = "sha256"
"""Name of the field of a result file that holds the SHA-256 of all other fields."""


def checksum(content: Mapping[str, Any]) -> str:
    """Compute the SHA-256, in hexadecimal digits, of all fields of a result file except `CHECKSUM`.

    The order of the fields and the layout of the file do not change the checksum.
    """
    rest = {name: value for name, value in content.items() if name != CHECKSUM}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


def with_checksum(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a result file with the field `CHECKSUM` added."""
    return {**content, CHECKSUM: checksum(content)}
