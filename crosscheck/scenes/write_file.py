"""Scenes to YAML or JSON files, as `crosscheck.scenes.scene_file` reads them."""

from __future__ import annotations

import json
import os
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from crosscheck.errors import CrosscheckError
from newton_euler.model.compound_joint import Compound
from newton_euler.model.control import PD
from newton_euler.model.couplings import Gear
from newton_euler.model.forces import BallArmature, BallSpring, JointSpring, PointSpring, Wrench
from newton_euler.model.geometry import Box, Shape
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import Screw
from newton_euler.model.motions import Polynomial, Sine, TimeFunction
from newton_euler.model.scene import REDUNDANCY_TOLERANCE, Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import atomic_file

KINDS: dict[type[Any], str] = {
    JointSpring: "joint_spring",
    BallSpring: "ball_spring",
    PointSpring: "point_spring",
    Wrench: "wrench",
}


class _NoAliases(yaml.SafeDumper):
    """Scene files may not hold aliases, which PyYAML writes for a list that is there twice."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def write_scene(scene: Scene, path: str | os.PathLike[str]) -> None:
    """Write a scene file, .yaml, .yml or .json; it appears whole or not at all.

    Raises:
        CrosscheckError: for a controller that is Python, and for a path that cannot be written.
    """
    content = entries(scene)
    if Path(path).suffix == ".json":
        text = json.dumps(content, indent=1, allow_nan=False) + "\n"
    else:
        text = yaml.dump(content, Dumper=_NoAliases, sort_keys=False, width=110)
    try:
        with atomic_file(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    except OSError as error:
        raise CrosscheckError(f"cannot write {os.fspath(path)}: {error.strerror}") from error


def entries(scene: Scene) -> dict[str, Any]:
    """The content of a scene file."""
    if scene.sampled:
        raise CrosscheckError(f"{scene.sampled[0].element}: a controller in Python is not for a scene file")
    mechanism = scene.mechanism
    bodies = []
    for body in mechanism.bodies[1:]:
        entry = _plain(body, "shapes", "meshes")
        if body.shapes:
            entry["shapes"] = [_shape(shape) for shape in body.shapes]
        bodies.append(entry)
    content: dict[str, Any] = {
        "name": scene.name,
        "description": scene.description,
        "gravity": scene.gravity.tolist(),
        "duration": scene.duration,
        "output_period": scene.output_period,
        "ground": mechanism.body_names[0],
        "bodies": bodies,
        "joints": [_joint(joint) for joint in mechanism.joints],
        "couplings": [
            {"kind": "gear", **_plain(each)}
            if isinstance(each, Gear)
            else {
                "kind": "linear",
                "name": each.name,
                "terms": [[*key, x] for key, x in each.factors().items()],
            }
            for each in mechanism.couplings
        ],
        "control": [_law(law) for law in scene.control if isinstance(law, PD)],
        "forces": [{"kind": KINDS[type(force)], **_plain(force)} for force in scene.forces],
        "motions": [
            {"joint": m.joint, "coordinate": m.coordinate, "function": _function(m.function)}
            for m in scene.motions
        ],
        "armatures": [
            _plain(armature) | ({"ball": True} if isinstance(armature, BallArmature) else {})
            for armature in scene.armatures
        ],
        "initial_state": _state(scene),
        "outputs": sorted(scene.outputs),
    }
    if scene.redundancy_tolerance != REDUNDANCY_TOLERANCE:
        content["redundancy_tolerance"] = scene.redundancy_tolerance
    return {key: value for key, value in content.items() if value not in ([], {}, "")}


def _plain(thing: Any, *skipped: str) -> dict[str, Any]:
    """The attributes of an object, arrays as lists."""
    names = [field.name for field in fields(thing) if field.name not in skipped]
    return {name: _number(getattr(thing, name)) for name in names}


def _number(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def _shape(shape: Shape) -> dict[str, Any]:
    return {"kind": "box" if isinstance(shape, Box) else "capsule", **_plain(shape)}


def _joint(joint: Joint) -> dict[str, Any]:
    entry = {
        "name": joint.name,
        "kind": joint.kind,
        "first": joint.first,
        "second": joint.second,
        "point": joint.point.tolist(),
    }
    if not np.array_equal(joint.point, joint.reaction_point):
        entry["point_on_second"] = joint.reaction_point.tolist()
    more = [*joint.axis_names]
    more += ["pitch"] if isinstance(joint, Screw) else []
    if isinstance(joint, Compound):
        more += ["slides", "hinges", "ball", *(["offsets"] if np.any(joint.offsets) else [])]
    entry |= {name: _number(getattr(joint, name)) for name in more}
    if joint.actuated:
        entry["actuated"] = True
    return entry


def _law(law: PD) -> dict[str, Any]:
    entry = _plain(law)
    if isinstance(law.feedforward, TimeFunction):
        entry["feedforward"] = _function(law.feedforward)
    return entry


def _function(function: TimeFunction) -> dict[str, Any]:
    if isinstance(function, Polynomial):
        return {"kind": "polynomial", "coefficients": list(function.coefficients)}
    if isinstance(function, Sine):
        return {"kind": "sine", **_plain(function)}
    return {"kind": "sum", "terms": [_function(term) for term in function.terms]}


def _state(scene: Scene) -> dict[str, dict[str, list[float]]]:
    """What of the initial state is not the initial pose at rest."""
    rest, found = State.initial(scene.mechanism), dict[str, dict[str, list[float]]]()
    state = rest if scene.initial_state is None else scene.initial_state
    for field in fields(State):
        given, usual = getattr(state, field.name), getattr(rest, field.name)
        for name, value, plain in zip(scene.mechanism.body_names, given, usual, strict=True):
            if not np.array_equal(value, plain):
                found.setdefault(name, {})[field.name] = value.tolist()
    return found
