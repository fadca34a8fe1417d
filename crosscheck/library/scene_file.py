"""Scenes from YAML or JSON files, and to them. SI, world frame at the initial pose.

`newton_euler.model.yaml_source` or the JSON parser make plain lists, dictionaries and texts of a file, and
`crosscheck.library.entries` a scene of these. `content` is the way back.
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
from newton_euler.model.digital_control import Digital, Law, Sampled
from newton_euler.model.forces import BallArmature
from newton_euler.model.joint import Joint, Key
from newton_euler.model.mechanism import Body
from newton_euler.model.scene import REDUNDANCY_TOLERANCE, Scene
from newton_euler.model.source_file import SourceError, read_text
from newton_euler.model.state import State
from newton_euler.model.yaml_source import parse_yaml
from newton_euler.runs.assemble import initial_state


def content(element: Any) -> dict[str, Any]:
    """Return what a file says of an element: its attributes, those that are made of elements last."""
    form = ENTRIES[type(element)]
    found: dict[str, Any] = {"kind": form.named} if form.named else {}
    found |= {name: plain(getattr(element, name)) for name in form.model_fields if name != "kind"}
    return dict(sorted(found.items(), key=lambda item: item[0] in ("shapes", "function")))


def _law(law: Law) -> dict[str, Any]:
    """Return what a file says of a control law."""
    if isinstance(law, Sampled):
        raise CrosscheckError(f"{law.element}: a controller in Python is not for a scene file")
    if not isinstance(law, Digital):
        return {name: value for name, value in content(law).items() if value != {} and value is not False}
    found: dict[str, Any] = {"kind": "digital", "period": law.period, "delay": law.delay}
    found |= {name: _limit(getattr(law, name)) for name in ("resolution", "force_limit", "slew_limit")}
    return found | {"stroke": [_limit(end) for end in law.stroke], "law": _law(law.law)}  # type: ignore[arg-type]


def _limit(number: float) -> float | str:
    return number if np.isfinite(number) else str(number)


def plain(value: Any) -> Any:
    """Return an attribute as files have it, arrays and tuples as lists."""
    if isinstance(value, tuple):
        return [plain(each) for each in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return {_name(place): plain(each) for place, each in value.items()}
    return content(value) if type(value) in ENTRIES else value


def _name(place: str | Key) -> str:
    """Return the name of a joint for its first coordinate."""
    if not isinstance(place, str) and place[1]:
        problem = f"coordinate {place[1]} of joint {place[0]!r} is read by a law"
        raise CrosscheckError(f"{problem}; scene files name first coordinates alone")
    return place if isinstance(place, str) else place[0]


def read_scene(path: str) -> Scene:
    """Read a scene file.

    Raises:
        CrosscheckError: naming the file and the line or field at fault.
    """
    try:
        scene = SCENE.model_validate(_parse(path, read_text(path, "scene_size"))).build()
        initial_state(scene)  # refused here, with the file's name, if its joints are open
    except ValidationError as error:
        found = error.errors()
        # a key that nothing knows is often the one that is missing, misspelled
        kinds = ([each for each in found if each["type"] == kind] for kind in ("extra_forbidden", "missing"))
        first = [each for kind in kinds for each in kind[:2]] or found[:1]
        raise CrosscheckError(f"{path}: {'; '.join(map(_problem, first))}") from error
    except SourceError as error:
        raise CrosscheckError(str(error)) from error
    except (NewtonEulerError, CrosscheckError) as error:
        raise CrosscheckError(f"{path}: {error}") from error
    return scene


def _problem(error: ErrorDetails) -> str:
    """Say what is wrong with a field, and what it is unless all of its entry would be shown."""
    # files need not say the kind of a PD law
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


class _NoAliases(yaml.SafeDumper):
    """Scene files may not hold aliases, which PyYAML writes for a list that is there twice."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def write_scene(scene: Scene, path: str | os.PathLike[str]) -> None:
    """Write a scene file, .yaml, .yml or .json; it appears whole or not at all.

    Raises:
        CrosscheckError: for a controller that is Python, and for a path that cannot be written.
    """
    found = _content(scene)
    if Path(path).suffix == ".json":
        text = json.dumps(found, indent=1, allow_nan=False) + "\n"
    else:
        text = yaml.dump(found, Dumper=_NoAliases, sort_keys=False, width=110)
    write_files({Path(path): text.encode()})


def _content(scene: Scene) -> dict[str, Any]:
    """The content of a scene file."""
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
    if scene.redundancy_tolerance != REDUNDANCY_TOLERANCE:
        found["redundancy_tolerance"] = scene.redundancy_tolerance
    return {key: value for key, value in found.items() if value not in ([], {}, "")}


def _body(body: Body) -> dict[str, Any]:
    found = content(body)
    return found if body.shapes else {name: value for name, value in found.items() if name != "shapes"}


def _joint(joint: Joint) -> dict[str, Any]:
    """Return the entries of a joint that are not as usual."""
    found = {"name": joint.name} | content(joint)
    if np.array_equal(joint.point, joint.reaction_point):
        del found["point_on_second"]
    offsets, actuated = found.pop("offsets", []), found.pop("actuated")
    if np.any(offsets):
        found["offsets"] = offsets
    if actuated:
        found["actuated"] = True
    if found.get("opposed") is False:
        del found["opposed"]
    return found


def _state_content(scene: Scene) -> dict[str, dict[str, list[float]]]:
    """Return the entries of the initial state that are not the initial pose at rest."""
    rest, found = State.initial(scene.mechanism), dict[str, dict[str, list[float]]]()
    state = rest if scene.initial_state is None else scene.initial_state
    for quantity in StateEntry.model_fields:
        given, usual = getattr(state, quantity), getattr(rest, quantity)
        for name, value, resting in zip(scene.mechanism.body_names, given, usual, strict=True):
            if not np.array_equal(value, resting):
                found.setdefault(name, {})[quantity] = value.tolist()
    return found


def _angles_content(scene: Scene) -> dict[str, float]:
    """Return the angles of the initial state, rad with revolutions, by joint coordinate."""
    labels, state = scene.mechanism.coordinate_labels, scene.initial_state
    return {} if state is None else {labels[key]: float(angle) for key, angle in state.angles.items()}
