"""The loop file: what closes the loops of a URDF, and which of its joints are something else.

Its keys are those of Gepetto's example-parallel-robots (`robot.yaml`), and `coupled`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import yaml

from newton_euler.control import is_finite_number
from urdf.errors import LoopFileError

CLOSURE_TYPES = ("3d", "6d", "rod")
JOINT_TYPES = ("SPHERICAL",)


@dataclass(frozen=True)
class Loops:
    """A loop file.

    Attributes:
        source: the file's name, for messages.
        closed_loop: pairs of frames that coincide.
        type: for each pair one of `CLOSURE_TYPES`: the origins coincide, or the frames do, or the origins
            keep their distance.
        name_mot: joints with a motor.
        joint_name: joints whose type is not the one in the URDF.
        joint_type: for each of them one of `JOINT_TYPES`.
        coupled: for each coupling, names of joints and factors; the products with their coordinates add
            up to zero. The only key that may be missing.
    """

    source: str
    closed_loop: tuple[tuple[str, str], ...]
    type: tuple[str, ...]
    name_mot: tuple[str, ...]
    joint_name: tuple[str, ...]
    joint_type: tuple[str, ...]
    coupled: tuple[dict[str, float], ...]


def parse_loops(text: str, source: str) -> Loops:
    """Read the text of a loop file named `source`.

    Raises:
        LoopFileError: for text that is not YAML and for keys that are missing, of the wrong form,
            of different lengths or with a type that is not known.
    """
    try:
        document = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise LoopFileError(source, "document", f"not YAML: {error}") from error
    except RecursionError as error:
        raise LoopFileError(source, "document", "nested too deeply") from error
    if not isinstance(document, dict):
        raise LoopFileError(source, "document", "not a mapping from keys to lists")
    pairs = _entry(document, source, "closed_loop")
    for pair in pairs:
        if not isinstance(pair, list) or len(pair) != 2 or not all(isinstance(n, str) for n in pair):
            raise LoopFileError(source, "closed_loop", f"{pair!r} is not a pair of frame names")
    names = {key: _names(document, source, key) for key in ("type", "name_mot", "joint_name", "joint_type")}
    _check_types(source, "type", names["type"], CLOSURE_TYPES, "closed_loop", len(pairs))
    _check_types(
        source,
        "joint_type",
        names["joint_type"],
        JOINT_TYPES,
        "joint_name",
        len(names["joint_name"]),
    )
    coupled = _entry({"coupled": [], **document}, source, "coupled")
    for coupling in coupled:
        if not isinstance(coupling, dict) or not all(
            isinstance(name, str) and is_finite_number(factor) for name, factor in coupling.items()
        ):
            raise LoopFileError(source, "coupled", f"{coupling!r} is not a mapping from joints to numbers")
    return Loops(source, tuple((first, second) for first, second in pairs), **names, coupled=tuple(coupled))


def _entry(document: dict[str, Any], source: str, key: str) -> list[Any]:
    if key not in document:
        raise LoopFileError(source, key, "missing")
    if not isinstance(document[key], list):
        raise LoopFileError(source, key, f"{document[key]!r} is not a list")
    return document[key]


def _names(document: dict[str, Any], source: str, key: str) -> tuple[str, ...]:
    entries = _entry(document, source, key)
    for entry in entries:
        if not isinstance(entry, str):
            raise LoopFileError(source, key, f"{entry!r} is not a name")
    return tuple(entries)


def _check_types(
    source: str, key: str, types: tuple[str, ...], valid: tuple[str, ...], of: str, count: int
) -> None:
    if len(types) != count:
        raise LoopFileError(source, key, f"{len(types)} entries for {count} of {of}")
    for entry in types:
        if entry not in valid:
            raise LoopFileError(source, key, f"unknown {entry!r}; choose from: {', '.join(valid)}")
