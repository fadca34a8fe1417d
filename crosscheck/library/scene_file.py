"""Read and write scene files, YAML or JSON: `read_scene` and `write_scene`.

All numbers are in SI units; vectors are in the world frame at the initial pose. `read_scene` parses a file to
lists, dictionaries and texts, from which the schema in `crosscheck.library.entries` builds a scene.
`write_scene` converts a scene back to such content; entries that have their default values are left out where
that shortens the file.
"""

from __future__ import annotations

import json
import os
import reprlib
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from pydantic import ValidationError
from pydantic_core import ErrorDetails

from crosscheck.library.entries import ENTRIES, SCENE, StateEntry
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.files import write_files
from newton_euler.errors import NewtonEulerError, choices, quoted
from newton_euler.model.armatures import BallArmature
from newton_euler.model.digital_control import Digital, Law, Sampled
from newton_euler.model.joint import Joint, Key
from newton_euler.model.mechanism import Body
from newton_euler.model.scene import REDUNDANCY_TOLERANCE, Scene
from newton_euler.model.source_file import SourceError, read_text
from newton_euler.model.state import State
from newton_euler.model.yaml_source import parse_yaml
from newton_euler.runs.assemble import initial_state


def content(element: Any) -> dict[str, Any]:
    """Convert an element to the content of its entry in a file: attributes by name, nested elements last.

    An element is a part of a scene such as a body, joint or force; its entry is the schema of that part.
    """
    entry = ENTRIES[type(element)]
    found: dict[str, Any] = {"kind": entry.kind_name} if entry.kind_name else {}
    found |= {name: plain(getattr(element, name)) for name in entry.model_fields if name != "kind"}
    return dict(sorted(found.items(), key=lambda item: item[0] in ("shapes", "function")))


def _law(law: Law) -> dict[str, Any]:
    """Convert a control law to the content of its entry.

    Raises:
        CrosscheckError: for a controller that is a Python function.
    """
    if isinstance(law, Sampled):
        raise CrosscheckError(f"{law.element}: a controller in Python cannot be written to a scene file")
    if not isinstance(law, Digital):
        return {name: value for name, value in content(law).items() if value != {} and value is not False}
    found: dict[str, Any] = {"kind": "digital", "period": law.period, "delay": law.delay}
    found |= {name: _limit(getattr(law, name)) for name in ("resolution", "force_limit", "slew_limit")}
    return found | {"stroke": [_limit(end) for end in law.stroke], "law": _law(law.law)}  # type: ignore[arg-type]


def _limit(number: float) -> float | str:
    """Return a number as files have it: a finite number unchanged, an infinite one as text."""
    return number if np.isfinite(number) else str(number)


def plain(value: Any) -> Any:
    """Convert an attribute to content of a file: arrays and tuples become lists, elements become
    dictionaries."""
    if isinstance(value, tuple):
        return [plain(each) for each in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return {_joint_name(key): plain(each) for key, each in value.items()}
    return content(value) if type(value) in ENTRIES else value


def _joint_name(key: str | Key) -> str:
    """Return the name of the joint of a joint coordinate, which control laws give as (joint, number) or name.

    Raises:
        CrosscheckError: for a coordinate other than the first, which files cannot name.
    """
    if isinstance(key, str):
        return key
    joint, number = key
    if number:
        problem = f"coordinate {number} of joint {joint!r} is read by a control law"
        raise CrosscheckError(f"{problem}; scene files can only name the first coordinate of a joint")
    return joint


def read_scene(path: str) -> Scene:
    """Read a scene file.

    Raises:
        CrosscheckError: for a file that cannot be read or is not a scene; the message names the file and the
            line or field.
    """
    try:
        text = read_text(path, limit="scene_size")  # name of the limit of the file's size
        scene = SCENE.model_validate(_parse(path, text)).build()
        initial_state(scene)  # raises an error if joints are open
    except ValidationError as error:
        found = error.errors()
        # an unknown key is often the misspelled name of a missing one: show both
        kinds = ([each for each in found if each["type"] == kind] for kind in ("extra_forbidden", "missing"))
        first = [each for kind in kinds for each in kind[:2]] or found[:1]
        raise CrosscheckError(f"{path}: {'; '.join(map(_problem, first))}") from error
    except SourceError as error:
        raise CrosscheckError(str(error)) from error
    except (NewtonEulerError, CrosscheckError) as error:
        raise CrosscheckError(f"{path}: {error}") from error
    return scene


def _problem(error: ErrorDetails) -> str:
    """Format an error of validation: field, problem and value."""
    # "pd" is the kind that the schema assumes for a control law without one: files need not have the key
    field = ".".join(str(part) for part in error["loc"] if part != "pd")[:100]
    match error["type"]:
        case "missing":
            return f"{field}: missing"
        case "extra_forbidden":
            return f"{field}: unknown key"
        case "union_tag_invalid":
            tags = [each.strip(" '") for each in error["ctx"]["expected_tags"].split(",")]
            return f"{field}.kind: {quoted(error['ctx']['tag'])}; {choices(error['ctx']['tag'], tags)}"
        case _ if not field:
            return "not a mapping from keys to values; examples/four_bar.yaml is one to start from"
    return f"{field}: {error['msg']} (got {reprlib.repr(error['input'])})"


def _parse(path: str, text: str) -> Any:
    """Parse the text of a file as JSON if its name ends in .json, otherwise as YAML.

    Raises:
        CrosscheckError: for invalid JSON.
        SourceError: for invalid YAML.
    """
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
    """Make a dictionary of the pairs of a JSON object.

    Raises:
        CrosscheckError: for a key that is given twice.
    """
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise CrosscheckError(f"key {key!r:.100} is given twice in one object")
        found[key] = value
    return found


class _NoAliases(yaml.SafeDumper):
    """YAML dumper without aliases, the references that PyYAML writes for an object that occurs twice."""

    def ignore_aliases(self, data: Any) -> bool:
        """Write every object in full."""
        return True


def write_scene(scene: Scene, path: str | os.PathLike[str]) -> None:
    """Write a scene file (.yaml, .yml or .json); if writing fails, no partial file is left.

    Raises:
        CrosscheckError: for a controller in Python, and for a path that cannot be written.
    """
    found = _scene_content(scene)
    if Path(path).suffix == ".json":
        text = json.dumps(found, indent=1, allow_nan=False) + "\n"
    else:
        text = yaml.dump(found, Dumper=_NoAliases, sort_keys=False, width=110)
    write_files({Path(path): text.encode()})


def _scene_content(scene: Scene) -> dict[str, Any]:
    """Convert a scene to the content of a scene file."""
    mechanism = scene.mechanism
    found: dict[str, Any] = {
        "name": scene.name,
        "description": scene.description,
        "gravity": plain(scene.gravity),
        "duration": scene.duration,
        "output_period": scene.output_period,
        "ground": mechanism.body_names[0],
        "bodies": [_body(body) for body in mechanism.bodies[1:]],
        "joints": [_joint(joint) for joint in mechanism.joints],
        "couplings": plain(mechanism.couplings),
        "control": [_law(law) for law in scene.control],
        "forces": plain(scene.forces),
        "motions": plain(scene.motions),
        "armatures": [
            {field.name: getattr(armature, field.name) for field in fields(armature)}
            | ({"ball": True} if isinstance(armature, BallArmature) else {})
            for armature in scene.armatures
        ],
        "initial_state": _state_content(scene),
        "initial_angles": _angles_content(scene),
        "outputs": sorted(scene.outputs),
    }
    if scene.redundancy_tolerance != REDUNDANCY_TOLERANCE:  # size of dependent constraint equations
        found["redundancy_tolerance"] = scene.redundancy_tolerance
    return {key: value for key, value in found.items() if value not in ([], {}, "")}


def _body(body: Body) -> dict[str, Any]:
    """Convert a body to the content of its entry."""
    found = content(body)
    return found if body.shapes else {name: value for name, value in found.items() if name != "shapes"}


def _joint(joint: Joint) -> dict[str, Any]:
    """Convert a joint to the content of its entry, without fields that have their default values."""
    found = {"name": joint.name} | content(joint)
    if np.array_equal(joint.point, joint.point_on_second):  # the second body's point, by default `point`
        del found["point_on_second"]
    # `offsets` from each hinge axis of a compound joint to the next one, by default zero
    offsets, actuated = found.pop("offsets", []), found.pop("actuated")
    if np.any(offsets):
        found["offsets"] = offsets
    if actuated:
        found["actuated"] = True
    if found.get("opposed") is False:
        del found["opposed"]
    return found


def _state_content(scene: Scene) -> dict[str, dict[str, list[float]]]:
    """Convert the initial state: values by body and quantity that differ from the initial pose at rest."""
    rest, found = State.initial(scene.mechanism), dict[str, dict[str, list[float]]]()
    state = rest if scene.initial_state is None else scene.initial_state
    for quantity in StateEntry.model_fields:
        values, rest_values = getattr(state, quantity), getattr(rest, quantity)
        for name, value, rest_value in zip(scene.mechanism.body_names, values, rest_values, strict=True):
            if not np.array_equal(value, rest_value):
                found.setdefault(name, {})[quantity] = value.tolist()
    return found


def _angles_content(scene: Scene) -> dict[str, float]:
    """Convert the hinge angles of the initial state: rad, with full revolutions, by label of the joint
    coordinate."""
    labels, state = scene.mechanism.coordinate_labels, scene.initial_state
    return {} if state is None else {labels[key]: float(angle) for key, angle in state.angles.items()}
