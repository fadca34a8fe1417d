"""Reading the result files of earlier commands: JSON checked against its pydantic model and its checksum.

`read_content` of `newton_euler.model.source_file` limits the size of the files; its second argument is the
name of the limit.
"""

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

Content = TypeVar("Content", bound=BaseModel)
"""Type of the content of a JSON file: the pydantic model of its fields."""


def read_json(
    path: Path, kind: type[Content], remedy: str = "run the command again that wrote it"
) -> Content:
    """Read and validate a JSON file, and verify its checksum if files of this kind have one.

    Args:
        path: path of the file.
        kind: pydantic model of the file's content.
        remedy: what the user can do about a file whose checksum is wrong, for the error message.

    Raises:
        CrosscheckError: if the file cannot be read or is invalid; the message names the file and the field.
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
        # if the file is not JSON, the invalid input is the whole file, which would not help in a message
        got = f" (got {reprlib.repr(first['input'])})" if first["loc"] and first["type"] != "missing" else ""
        reason = first["msg"].removeprefix("Value error, ")
        raise CrosscheckError(f"{path}: {field:.100}: {reason}{got}") from error


def digest(path: Path) -> str:
    """Compute the SHA-256, in hexadecimal digits, of a file of arrays (.npz), a recording or a picture.

    Raises:
        CrosscheckError: if the file cannot be read or is too large; the message names the file.
    """
    try:
        return hashlib.sha256(read_content(path, "array_size")).hexdigest()
    except SourceError as error:
        raise CrosscheckError(str(error)) from error
