"""What two files say that is in no figure: what was approximated or left out, MuJoCo's softness and steps."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from crosscheck.against.align import Aligned
from crosscheck.model_files.read import is_model, is_urdf
from newton_euler.mapping import Mapped
from newton_euler.scalars import Array

if TYPE_CHECKING:
    from crosscheck.against.compare import Model

INERT = re.compile(
    r"^options of solver |^other keyframes|^visual |they move nothing|no part of a URDF's mechanics"
    r"|is not active|moves no mass|does no work|both (its (ends|bodies)|frames) are "
)
"""How reports tell of what moves nothing in this model, or of what is told elsewhere."""

DEMANDED = re.compile(r"^joint '[^']*': left out: its limits: ")
"""Limits of a URDF, which demands them of hinges and slides that have none elsewhere."""

CONTACTS, LIMITS = "contacts are no bilateral constraints", "limits are no bilateral constraints"

NOT_COMPARED = "not compared, and not the same"

RUNNING = "differs in softness or stepping only"

AT_START = re.compile(r"; the start is outside of them, at [^:]*")

NAMED = re.compile(r"\b(joint|body|link) '([^']*)'")


class Uncompared(NamedTuple):
    """Something that differs and that no figure is about."""

    how: str
    text: str
    moves: bool
    """Whether it makes the mechanism itself move otherwise; else it is how a tool runs or shows it."""

    def __str__(self) -> str:
        return f"{self.how}: {self.text}"


def uncompared(first: Model, second: Model, aligned: Aligned) -> Iterator[Uncompared]:
    """What only one of the reports has and was not carried over exactly; of two MJCFs what they set too.

    Between formats only what moves the mechanism, and of contacts only whether there are any.
    """
    alike = _format(first) == _format(second)
    joints = {other: name for name, other in aligned.joints.items()}
    here, there = _entries(first, alike, {}, {}), _entries(second, alike, joints, aligned.bodies)
    for where, one, two in (("here", here, there), ("there", there, here)):
        for entry in (entry for told, entry in one.items() if told not in two):
            inert = bool(INERT.search(str(entry)))
            if alike or not (inert or DEMANDED.search(str(entry))):
                yield Uncompared(NOT_COMPARED, f"only {where}: {entry}", not inert)
    if _format(first) == _format(second) == "MJCF":
        yield from _mujoco_apart(first, second)


def _format(model: Model) -> str:
    if not is_model(model.source):
        return "scene"
    return "URDF" if is_urdf(model.source) else "MJCF"


def _entries(
    model: Model, alike: bool, joints: Mapping[str, str], bodies: Mapping[str, str]
) -> dict[str, Mapped]:
    """What was not carried over exactly, with other names of joints and bodies; by what tells it apart."""

    def renamed(found: re.Match[str]) -> str:
        names = joints if found[1] == "joint" else bodies
        return f"{found[1]} {names.get(found[2], found[2])!r}"

    entries: dict[str, Mapped] = {}
    for entry in model.mapping.entries if model.mapping else ():
        if entry.fate != "exactly":
            own = Mapped(NAMED.sub(renamed, entry.element), entry.fate, NAMED.sub(renamed, entry.how))
            told = AT_START.sub("", str(own))
            if not alike and told.endswith(CONTACTS):
                told = CONTACTS
            elif not alike and told.endswith(LIMITS):
                told = f"{own.element}: {LIMITS}"
            entries[told] = own
    return entries


def _mujoco_apart(first: Model, second: Model) -> Iterator[Uncompared]:
    """Polynomials of equalities, of which the scenes have the slopes; softness of equalities and stepping."""
    from mjcf.reading.running import polynomials, running
    from mjcf.reading.source import compiled

    here, there = (compiled(model.source, model.options.get("root")) for model in (first, second))
    one, two = polynomials(here), polynomials(there)
    for name in one.keys() & two.keys():
        if not np.array_equal(one[name], two[name]):
            told = f"polynomial of equality {name!r} {_numbers(one[name])} here, {_numbers(two[name])} there"
            yield Uncompared(NOT_COMPARED, told, moves=True)
    one, two = running(here), running(there)
    for what in one:
        if what in two and not np.array_equal(one[what], two[what]):
            told = f"{what} {_numbers(one[what])} here, {_numbers(two[what])} there"
            yield Uncompared(RUNNING, told, moves=False)


def _numbers(values: Array) -> str:
    return " ".join(f"{value:g}" for value in values)
