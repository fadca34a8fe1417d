"""What two files say that is in no figure: what was approximated or left out, MuJoCo's softness and steps."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from crosscheck.against.align import Aligned
from crosscheck.against.pairs import pair_parts
from crosscheck.against.rigid import rigid
from crosscheck.model_files.read import is_model, is_urdf
from newton_euler.model.mapping import CONTACTS, LIMITS, RANGE, Mapped, Part, Value, differing, value

if TYPE_CHECKING:
    from crosscheck.against.compare import Model

NOT_COMPARED = "not compared, and not the same"

RUNNING = "differs in softness or stepping only"

DIGITS = 1e-5
"""Relative: what files of six digits hold, where one of them has degrees and the other radians."""


class Uncompared(NamedTuple):
    """Something that differs and that no figure is about."""

    how: str
    text: str
    moves: bool
    """Whether it makes the mechanism itself move otherwise; else it is how a tool runs or shows it."""

    def __str__(self) -> str:
        return f"{self.how}: {self.text}"


@dataclass(frozen=True, eq=False)
class _Told:
    """A part of a report's entry, in the first model's names of joints and bodies."""

    entry: Mapped
    part: Part

    @cached_property
    def place(self) -> tuple[object, ...]:
        """What it is on."""
        return sorted(self.part.joints), sorted(self.part.bodies)


def uncompared(first: Model, second: Model, aligned: Aligned) -> Iterator[Uncompared]:
    """What was not carried over exactly and is not the same in both files; of two MJCFs what they set too.

    Between formats only what moves the mechanism; of contacts only whether there are any, and of all else
    the values that both formats have.
    """
    alike = _format(first) == _format(second)
    yield from _texts_apart(_entries(first), _entries(second), alike)
    here, there = _told(first, aligned, False), _told(second, aligned, True)
    if not alike:
        here, there = _between_formats(first, here, there), _between_formats(second, there, here)
    for topic in dict.fromkeys(told.entry.topic for told in (*here, *there)):
        one, two = ([told for told in side if told.entry.topic == topic] for side in (here, there))
        yield from _apart(one, two, alike)
    if _format(first) == _format(second) == "MJCF":
        yield from _mujoco_apart(first, second)


def _format(model: Model) -> str:
    if not is_model(model.source):
        return "scene"
    return "URDF" if is_urdf(model.source) else "MJCF"


def _entries(model: Model) -> list[Mapped]:
    """What was not carried over exactly, or moves nothing as the file has it."""
    entries = model.mapping.entries if model.mapping else ()
    return [entry for entry in entries if entry.fate != "exactly" or entry.parts]


def _texts_apart(here: list[Mapped], there: list[Mapped], alike: bool) -> Iterator[Uncompared]:
    """Entries without parts that only one of the reports has."""
    one, two = ({str(entry): entry for entry in side if not entry.parts} for side in (here, there))
    for where, mine, others in (("here", one, two), ("there", two, one)):
        for text, entry in mine.items():
            if text not in others and (alike or not entry.inert):
                yield Uncompared(NOT_COMPARED, f"only {where}: {text}", not entry.inert)


def _told(model: Model, aligned: Aligned, is_second: bool) -> list[_Told]:
    """The parts of a model's report with the first's names of joints and bodies."""
    owner = {body: name for name, members in rigid(model.scene)[1].items() for body in members}
    bodies = aligned.bodies if is_second else {}
    joints = {other: name for name, other in aligned.joints.items()} if is_second else {}
    keys = {other.key: (key, other.sense) for key, other in aligned.coordinates.items()} if is_second else {}

    def named(part: Part) -> Part:
        found = [keys.get((name, k), ((joints.get(name, name), k), 1.0)) for name, k in part.joints]
        values = dict(part.values)
        if RANGE in values and found and found[0][1] < 0.0:  # a joint that moves no mass has none
            low, high = (float(x) for x in values[RANGE])
            values[RANGE] = value([-high, -low])
        own = (owner.get(name, name) for name in part.bodies)
        return replace(
            part,
            values=values,
            joints=tuple(key for key, _ in found),
            bodies=tuple(bodies.get(name, name) for name in own),
        )

    return [_Told(entry, named(part)) for entry in _entries(model) for part in entry.parts]


def _between_formats(model: Model, told: list[_Told], others: list[_Told]) -> list[_Told]:
    """What can be held against a file of another format.

    Limits that only a URDF has are no difference: it demands them of hinges and slides.
    """
    moving = [each for each in told if not each.entry.inert]
    contacts = [each for each in moving if each.entry.topic == CONTACTS][:1]
    limited = [each.place for each in others if each.entry.topic == LIMITS]
    demanded = _format(model) == "URDF"
    return [replace(each, part=Part(CONTACTS, {})) for each in contacts] + [
        each
        for each in moving
        if each.entry.topic != CONTACTS
        and not (demanded and each.entry.topic == LIMITS and each.place not in limited)
    ]


def _apart(here: list[_Told], there: list[_Told], alike: bool) -> Iterator[Uncompared]:
    """Parts on one topic that differ; those that are the same are, whatever they are called."""

    def values(one: _Told, two: _Told) -> list[str]:
        names = differing(one.part.values, two.part.values, DIGITS)
        return [n for n in names if alike or (n in one.part.values and n in two.part.values)]

    def same(one: _Told, two: _Told) -> bool:
        judged = one.entry.fate == two.entry.fate and one.entry.inert == two.entry.inert
        return one.place == two.place and judged and not values(one, two)

    pairs: list[tuple[_Told, _Told]] = []
    # what one format says of all of an element another says in other words
    if alike or any(told.entry.topic for told in here):
        pairs += pair_parts(here, there, same, lambda told: told.part.element, lambda told: told.place)
    for one, two in pairs:
        if not same(one, two):
            moves = not (one.entry.inert and two.entry.inert)
            yield Uncompared(NOT_COMPARED, _difference(one, two, values(one, two)), moves)
    paired = {id(told.entry) for pair in pairs for told in pair}
    for where, alone in (("here", here), ("there", there)):
        for text, entry in {_alone(told, id(told.entry) in paired): told.entry for told in alone}.items():
            yield Uncompared(NOT_COMPARED, f"only {where}: {text}", not entry.inert)


def _difference(one: _Told, two: _Told, names: Sequence[str]) -> str:
    """What is not the same of a pair: values, or else what it is on, or what became of it."""
    about = f"{one.part.element}{f', {one.entry.topic}' if one.entry.topic else ''}"
    if names:
        told = [_values(name, one.part.values.get(name), two.part.values.get(name)) for name in names]
        return f"{about}: {'; '.join(told)}"
    if one.place != two.place:
        here, there = (
            " and ".join((*(joint for joint, _ in told.part.joints), *told.part.bodies)) or "nothing"
            for told in (one, two)
        )
        return f"{about}: on {here} here, on {there} there"
    return f"{about}: {one.entry.fate} here, {one.entry.how}; {two.entry.fate} there, {two.entry.how}"


def _values(name: str, here: Value | None, there: Value | None) -> str:
    """Without the zeros that two long ones end in."""
    one, two = (list(side or ("none",)) for side in (here, there))
    while len(one) == len(two) > 3 and one[-1] == two[-1] == 0.0:
        one.pop()
        two.pop()
    return f"{name} {_numbers(one)} here, {_numbers(two)} there"


def _alone(told: _Told, partly: bool) -> str:
    """A part that the other report has none for; of an entry that it has other parts of by itself."""
    whole = str(told.entry)
    return f"{told.part.element}: {told.entry.fate}: {told.entry.how}" if partly else whole


def _mujoco_apart(first: Model, second: Model) -> Iterator[Uncompared]:
    """Softness of equalities and stepping."""
    from mjcf.reading.running import running
    from mjcf.reading.source import compiled

    here, there = (running(compiled(model.source, model.options.get("root"))) for model in (first, second))
    for what in here:
        if what in there and not np.array_equal(here[what], there[what]):
            told = f"{what} {_numbers(here[what])} here, {_numbers(there[what])} there"
            yield Uncompared(RUNNING, told, moves=False)


def _numbers(values: Iterable[float | str]) -> str:
    return " ".join(x if isinstance(x, str) else f"{x:.9g}" for x in values)
