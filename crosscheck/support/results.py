"""Files of results that a command left, read and checked before they are used."""

from __future__ import annotations

import hashlib
import json
import reprlib
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from crosscheck.support.checksum import CHECKSUM, checksum
from crosscheck.support.errors import CrosscheckError
from newton_euler.model.source_file import SourceError, read_content

Kind = TypeVar("Kind", bound=BaseModel)


def read_json(path: Path, kind: type[Kind], remedy: str = "run the command again that wrote it") -> Kind:
    """The content of a JSON file, whose checksum is compared if the kind of file has one.

    Args:
        path: of the file.
        kind: its form.
        remedy: what to do about a file whose checksum does not fit.

    Raises:
        CrosscheckError: naming the file and the field at fault.
    """
    try:
        text = read_content(path, "result_size")
        content = kind.model_validate_json(text)
        if CHECKSUM in kind.model_fields and checksum(json.loads(text)) != getattr(content, CHECKSUM):
            problem = "does not fit the other fields, the file is damaged or was edited"
            raise CrosscheckError(f"{path}: {CHECKSUM}: {problem}; {remedy}")
        return content
    except SourceError as error:
        raise CrosscheckError(str(error)) from error
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(part) for part in first["loc"]) or "file"
        # all of the file is at fault where it is not JSON, and would be no help in a message
        got = f" (got {reprlib.repr(first['input'])})" if first["loc"] and first["type"] != "missing" else ""
        reason = first["msg"].removeprefix("Value error, ")
        raise CrosscheckError(f"{path}: {field:.100}: {reason}{got}") from error


def digest(path: Path) -> str:
    """The SHA-256 of a file of arrays or a recording; raises `CrosscheckError` naming it."""
    try:
        return hashlib.sha256(read_content(path, "array_size")).hexdigest()
    except SourceError as error:
        raise CrosscheckError(str(error)) from error
