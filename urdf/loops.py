"""Parse the loop file of a URDF, which describes what a URDF cannot: closed loops and ball joints.

The file is YAML. Its keys have the meaning that loader_tools.py of Gepetto's example-parallel-robots gives
them (`robot.yaml`). An additional key is `coupled`: sums of polynomials of joint coordinates that are zero.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from newton_euler.errors import choices
from newton_euler.model.couplings import MAX_DEGREE
from newton_euler.model.source_file import MAX_MODEL_NUMBER, SourceError, read_text
from newton_euler.model.yaml_source import parse_yaml
from newton_euler.reading.import_report import unique_name
from urdf.errors import LoopFileError

CLOSURE_TYPES = ("3d", "6d", "rod")
"""Types of loop closures in a loop file, in upper or lower case.

"3d": the origins of two frames coincide; "6d": the frames coincide; "rod": the origins keep the distance that
they have at the start, where all other loops are closed."""

REVOLUTE = "revolute"
"""Type of a loop closure by a hinge about the x axes of both frames.

A loop file cannot have this type. Readers of elements that tools such as Gazebo add to a URDF use it."""

UNIVERSAL = {f"UJOINT_{a}{b}": a + b for a in "XYZ" for b in "XYZ" if a != b} | {"CARDAN": "XY"}
"""Axes of the two hinges of a universal joint, in the frame of the joint, by type in a loop file."""

JOINT_TYPES = ("SPHERICAL", "FIXED", *UNIVERSAL)
"""Types that a loop file can give to a joint instead of the joint's type in the URDF."""

LOOP_FILE_KEYS = ("closed_loop", "type", "name_mot", "joint_name", "joint_type", "coupled")
"""Keys of a loop file; `coupled`, and `joint_name` with `joint_type`, may be missing."""


@dataclass(frozen=True)
class Loops:
    """Content of a loop file, or its equivalent from additional elements of a URDF or from a Pinocchio model.

    The attributes have the names of the keys in the file.

    Attributes:
        source: name of the file, for messages.
        closed_loop: pairs of names of links or joints whose frames a loop closure connects.
        type: for each pair, one of `CLOSURE_TYPES`, or `REVOLUTE`.
        name_mot: names of joints with a motor.
        joint_name: names of joints whose type differs from the URDF.
        joint_type: for each of these joints, one of `JOINT_TYPES`. FIXED joints are held at 0; for the other
            types, the axis in the URDF is ignored.
        coupled: for each coupling, a polynomial of each coupled joint's coordinate q, by name of the joint:
            its coefficients (c_1, c_2, ...) of q, q^2, ... The sum of the polynomials is zero.
    """

    source: str
    closed_loop: tuple[tuple[str, str], ...]
    type: tuple[str, ...]
    name_mot: tuple[str, ...]
    joint_name: tuple[str, ...]
    joint_type: tuple[str, ...]
    coupled: tuple[dict[str, tuple[float, ...]], ...]


NO_LOOPS = Loops("", (), (), (), (), (), ())
"""Loops of a URDF without a loop file."""


def closure_names(model: Any, constraints: Sequence[Any]) -> tuple[tuple[str, str], ...]:
    """Name the two frames of each loop-closing constraint of a Pinocchio model in memory.

    Such a model has no loop file. Readers add frames with these names to a copy of the model, and pairs of
    the names take the place of `Loops.closed_loop`. The form "<constraint>_on_<joint>" is that of frames in
    files by `urdf.write`, so that readers find the name of the constraint in both.

    Args:
        model: `pinocchio.Model`.
        constraints: its `RigidConstraintModel`s.
    """
    pairs: list[tuple[str, str]] = []
    used_names: list[str] = []
    for number, constraint in enumerate(constraints):
        name = unique_name(str(constraint.name), fallback=f"constraint_{number + 1}", taken=used_names)
        used_names.append(name)
        first, second = (model.names[k] for k in (constraint.joint1_id, constraint.joint2_id))
        pairs.append((f"{name}_on_{first}", f"{name}_on_{second}"))
    return tuple(pairs)


def parse_loops(text: str, source: str) -> Loops:
    """Read the text of a loop file named `source`.

    Raises:
        LoopFileError: for text that is not plain YAML (such as aliases and tags, see
            `newton_euler.model.yaml_source`). Also for missing or unknown keys, wrong forms, different
            lengths, and unknown types.
    """
    try:
        document = parse_yaml(source, text)  # mappings and lists of texts
    except SourceError as error:
        raise LoopFileError(source, "document", error.problem) from error
    if not isinstance(document, dict):
        raise LoopFileError(source, "document", "not a mapping from keys to lists")
    # keys, and forms of the values; missing optional keys get an empty list
    for key in document:
        if key not in LOOP_FILE_KEYS:
            raise LoopFileError(source, f"{key!s:.100}", f"unknown key; {choices(key, LOOP_FILE_KEYS)}")
    if "joint_name" not in document and "joint_type" not in document:
        document |= {"joint_name": [], "joint_type": []}
    document.setdefault("coupled", [])
    for key in LOOP_FILE_KEYS:
        if key not in document:
            raise LoopFileError(source, key, "missing")
        if not isinstance(document[key], list):
            raise LoopFileError(source, key, f"{document[key]!r:.200} is not a list")
        for entry in document[key] if key in ("type", "name_mot", "joint_name", "joint_type") else ():
            if not isinstance(entry, str):
                raise LoopFileError(source, key, f"{entry!r:.200} is not a name")
    for pair in document["closed_loop"]:
        if not isinstance(pair, list) or len(pair) != 2 or not all(isinstance(n, str) for n in pair):
            raise LoopFileError(source, "closed_loop", f"{pair!r:.200} is not a pair of frame names")
        if pair[0] == pair[1]:
            raise LoopFileError(source, "closed_loop", f"{pair!r:.200} is one frame; needed: two")
    # lists that belong together have equal lengths; known types
    document["type"] = [kind.lower() for kind in document["type"]]
    for type_key, valid, key in (
        ("type", CLOSURE_TYPES, "closed_loop"),
        ("joint_type", JOINT_TYPES, "joint_name"),
    ):
        if len(document[type_key]) != len(document[key]):
            problem = f"{len(document[type_key])} entries for {len(document[key])} of {key}"
            raise LoopFileError(source, type_key, problem)
        for kind in document[type_key]:
            if kind not in valid:
                raise LoopFileError(source, type_key, f"unknown {kind!r:.200}; {choices(kind, valid)}")
    if len(set(document["joint_name"])) < len(document["joint_name"]):
        raise LoopFileError(source, "joint_name", "names a joint twice")
    document["coupled"] = [_coupling(entry, source) for entry in document["coupled"]]
    document["closed_loop"] = [tuple(pair) for pair in document["closed_loop"]]
    return Loops(source, **{key: tuple(document[key]) for key in LOOP_FILE_KEYS})


def _coupling(entry: Any, source: str) -> dict[str, tuple[float, ...]]:
    """Return an entry of `coupled` in the form of `Loops.coupled`; raises `LoopFileError`.

    In the file, a single number instead of a list is the coefficient of the first power.
    """
    try:
        lists = {name: given if isinstance(given, list) else [given] for name, given in entry.items()}
        polynomials = {name: tuple(map(float, given)) for name, given in lists.items()}
    except (AttributeError, TypeError, ValueError):
        polynomials = {"": (math.nan,)}  # refused below, as NaN is not <= `MAX_MODEL_NUMBER`
    if not polynomials or not all(
        1 <= len(coefficients) <= MAX_DEGREE and all(abs(c) <= MAX_MODEL_NUMBER for c in coefficients)
        for coefficients in polynomials.values()
    ):
        needed = (
            f"is not a mapping from joints to numbers of at most {MAX_MODEL_NUMBER:g} in magnitude, "
            f"or to lists of 1 to {MAX_DEGREE} of them"
        )
        raise LoopFileError(source, "coupled", f"{entry!r:.200} {needed}")
    return polynomials


def loop_files_beside(path: Path) -> Iterator[Path]:
    """Yield the loop files that are next to a URDF and have its name."""
    for loop_file in (path.with_suffix(".loops.yaml"), path.with_suffix(".yaml")):
        with suppress(SourceError):
            if loop_file.is_file() and "closed_loop" in read_text(str(loop_file), "scene_size", SourceError):
                yield loop_file
