"""Scenes from YAML or JSON files.

`newton_euler.model.yaml_source` or the JSON parser make plain lists, dictionaries and texts of a file,
pydantic checks the form, and the mechanism checks the mechanics.
"""

from __future__ import annotations

import json
import reprlib
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from crosscheck.errors import CrosscheckError
from crosscheck.scenes.file_entries import SceneEntry
from newton_euler.assemble import initial_state
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.model.source_file import SourceError, read_text, shortened
from newton_euler.model.yaml_source import parse_yaml


def read_scene(path: str) -> Scene:
    """Read a scene file.

    Raises:
        CrosscheckError: naming the file and the line or field at fault.
    """
    try:
        scene = SceneEntry.model_validate(_parse(path, read_text(path, "scene_size"))).build()
        initial_state(scene)  # refused here, with the file's name, if its joints are open
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(part) for part in first["loc"]) or "file"
        raise CrosscheckError(
            f"{path}: {field:.100}: {first['msg']} (got {reprlib.repr(first['input'])})"
        ) from error
    except SourceError as error:
        raise CrosscheckError(str(error)) from error
    except (NewtonEulerError, CrosscheckError) as error:
        raise CrosscheckError(f"{path}: {shortened(str(error))}") from error
    return scene


def _parse(path: str, text: str) -> Any:
    if Path(path).suffix != ".json":
        return parse_yaml(path, text)
    try:
        return json.loads(text, object_pairs_hook=_unique)
    except json.JSONDecodeError as error:
        raise CrosscheckError(f"not JSON: line {error.lineno}: {error.msg}") from error
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
