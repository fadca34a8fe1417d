"""Scenes from YAML or JSON files.

`read_text` and `parse` make plain lists, dictionaries and texts of a file, pydantic checks the form, and the
mechanism checks the mechanics. YAML's scalars stay texts until a field says what they are to be, so that
none of YAML's own ideas of dates, octal numbers or truth values has a say.
"""

from __future__ import annotations

import json
import reprlib
import stat
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from crosscheck.errors import CrosscheckError
from crosscheck.scenes.file_entries import SceneEntry
from newton_euler.errors import NewtonEulerError
from newton_euler.scene import Scene

MAXIMUM_BYTES = 1_000_000
"""A few seconds of parsing, and some thousand bodies."""


def read_scene(path: str) -> Scene:
    """Read a scene file.

    Raises:
        CrosscheckError: naming the file and the line or field at fault.
    """
    try:
        return SceneEntry.model_validate(_parse(path, _read_text(path))).build()
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(part) for part in first["loc"]) or "file"
        raise CrosscheckError(
            f"{path}: {field:.100}: {first['msg']} (got {reprlib.repr(first['input'])})"
        ) from error
    except (NewtonEulerError, CrosscheckError) as error:
        raise CrosscheckError(f"{path}: {error}") from error


def _read_text(path: str) -> str:
    try:
        status = Path(path).stat()
        if not stat.S_ISREG(status.st_mode):  # a pipe would keep its reader waiting
            raise CrosscheckError("not a regular file")
        if status.st_size > MAXIMUM_BYTES:
            raise CrosscheckError(f"larger than {MAXIMUM_BYTES} bytes")
        return Path(path).read_text(encoding="utf-8-sig")
    except OSError as error:
        raise CrosscheckError(f"cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise CrosscheckError("not a UTF-8 text file") from error


def _parse(path: str, text: str) -> Any:
    try:
        if Path(path).suffix == ".json":
            return json.loads(text, object_pairs_hook=_unique)
        return yaml.load(text, _PlainLoader)
    except json.JSONDecodeError as error:
        raise CrosscheckError(f"not JSON: line {error.lineno}: {error.msg}") from error
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"line {mark.line + 1}: " if mark else ""
        raise CrosscheckError(f"not YAML: {where}{error.problem or error.context}") from error
    except yaml.YAMLError as error:
        raise CrosscheckError(f"not YAML: {error}") from error
    except RecursionError as error:
        raise CrosscheckError("nested too deeply") from error
    except ValueError as error:  # an integer of thousands of digits
        raise CrosscheckError(f"not JSON: {error}") from error


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object; raises `CrosscheckError` for a key that comes twice."""
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise CrosscheckError(f"key {key!r:.100} is given twice in one object")
        found[key] = value
    return found


class _PlainLoader(yaml.BaseLoader):
    """YAML of mappings, sequences and texts alone.

    Aliases are refused because a few lines of them unfold to gigabytes, tags because nothing here
    would heed them, and a key that comes twice because one of its values would be lost.
    """

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        if isinstance(event, yaml.AliasEvent):
            raise _refusal("aliases are not allowed here", event)
        if event.tag is not None:
            raise _refusal("tags are not allowed here", event)
        return super().compose_node(parent, index)

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        node = super().compose_mapping_node(anchor)
        seen = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise _refusal("a key is not a text", key)
            if key.value in seen:
                raise _refusal(f"key {key.value!r:.100} is given twice in one mapping", key)
            seen.add(key.value)
        return node


def _refusal(problem: str, element: Any) -> yaml.MarkedYAMLError:
    """The error that names the line of an event or node."""
    return yaml.MarkedYAMLError(problem=problem, problem_mark=element.start_mark)
