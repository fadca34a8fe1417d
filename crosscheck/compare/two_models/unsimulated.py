"""Elements of two model files that no engine simulates: in one file only, or with other numbers."""

from __future__ import annotations

import re
from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from crosscheck.compare.activity import what_acted
from crosscheck.compare.two_models.align import Aligned
from crosscheck.library.options import titled
from crosscheck.loading.model_files import is_model_file, is_urdf_file
from newton_euler.model.scene import Scene
from newton_euler.reading.activity import Bounds
from newton_euler.reading.import_report import (
    CONTACTS,
    LIMITS,
    VELOCITY_LIMITS,
    ImportedElement,
    ImportReport,
)
from newton_euler.scalars import Array

ROUND_OFF = 1e-5
"""Relative difference of two numbers below which they are equal: files that MuJoCo saves have six digits."""

NEVER_COMPARED = "contact and softness parameters (friction of geoms, solref, solimp) are not compared"
"""Note on parameters that a comparison of two MJCF files ignores."""


@dataclass(frozen=True)
class Model:
    """One of the two.

    Attributes:
        name: as in tables and files.
        source: the name or the file that it was loaded from.
        options: of the scene, as they were set.
        scene: what was read.
        mapping: what became of the elements of a model file; None for a scene of this package's own.
    """

    name: str
    source: str
    options: Mapping[str, str]
    scene: Scene
    mapping: ImportReport | None

    @property
    def title(self) -> str:
        return titled(self.source, self.options)


class Unsimulated(NamedTuple):
    """An element that is not simulated as it is and that the files do not have alike."""

    text: str
    moves: bool
    """True if it makes the mechanism itself move otherwise; else it is how a tool runs or shows it."""


def unsimulated(first: Model, second: Model, aligned: Aligned) -> Iterator[Unsimulated]:
    """Elements that were not carried over exactly and that the files do not have alike.

    An element differs if only one file has it, or if the files give it other numbers. Of two formats, only
    what moves the mechanism is compared, and of contacts only whether there are any. Limits that only a URDF
    has are no difference: the format demands them of hinges and slides.
    """
    kinds = [_format(model) for model in (first, second)]
    alike, others = kinds[0] == kinds[1], {**aligned.names, **aligned.joint_names}
    named: tuple[tuple[Model, Mapping[str, str]], ...] = ((first, {}), (second, others))
    here, there = (_unsimulated(model, names, alike) for model, names in named)
    for where, mine, theirs, kind in (("here", here, there, kinds[0]), ("there", there, here, kinds[1])):
        for key, entry in mine.items():
            demanded = kind == "URDF" and not alike and entry.topic in (LIMITS, VELOCITY_LIMITS)
            if key not in theirs and not demanded:
                yield Unsimulated(f"only {where}: {entry}", not entry.inert)
    given = [_numbers(model, names, alike) for model, names in named]
    yield from _of_other_values(first, second, aligned, *given)
    if alike:
        elements = [_elements(model, names) for model, names in named]
        yield from _only_in_one("here", given[0], given[1], elements[1])
        yield from _only_in_one("there", given[1], given[0], elements[0])


class Given(NamedTuple):
    """Numbers of a file that are not simulated.

    Attributes:
        number: of the entry in the report.
        entry: the element that has the numbers.
        what: what they are, such as `LIMITS`.
        values: in SI units.
    """

    number: int
    entry: ImportedElement
    what: str
    values: tuple[float, ...]

    @property
    def name(self) -> str:
        """The quantity and its element, such as "limits of joint 'pivot'"."""
        named = self.entry.topic == self.what
        return what_acted(self.entry) if named else f"{self.what} of {self.entry.element}"

    def text(self, digits: int) -> str:
        """The values with some significant digits."""
        return " to ".join(f"{value:.{digits}g}" for value in self.values)


def _numbers(model: Model, names: Mapping[str, str], alike: bool) -> dict[tuple[str, str], Given]:
    """Numbers of a model's report that are not simulated, by element and quantity.

    Args:
        model: whose report.
        names: other names of bodies and joints.
        alike: True if the other model's file has the same format; else what moves nothing is left out.
    """
    found: dict[tuple[str, str], Given] = {}
    for number, entry in enumerate(model.mapping.entries if model.mapping else ()):
        for what, values in entry.numbers if alike or not entry.inert else ():
            key = (_renamed(entry.element, names), what)
            found.setdefault(key, Given(number, entry, what, values))
    return found


def _of_other_values(
    first: Model,
    second: Model,
    aligned: Aligned,
    here: Mapping[tuple[str, str], Given],
    there: Mapping[tuple[str, str], Given],
) -> Iterator[Unsimulated]:
    """Yield elements to which both files give numbers, but not the same ones."""
    for key, one in here.items():
        two = there.get(key)
        if two is None or one.entry.is_off != two.entry.is_off:
            continue
        a, b = np.array(one.values), _in_first(first, second, aligned, one, two)
        finite = [abs(x) for x in (*one.values, *two.values) if np.isfinite(x)]
        if a.shape == b.shape and np.allclose(a, b, rtol=0.0, atol=ROUND_OFF * max(finite, default=0.0)):
            continue
        digits = next((n for n in range(4, 17) if one.text(n) != two.text(n)), 4)
        text = f"{one.name}: {one.text(digits)} in {first.title}, {two.text(digits)} in {second.title}"
        yield Unsimulated(text, not one.entry.is_off)


def _in_first(first: Model, second: Model, aligned: Aligned, one: Given, two: Given) -> Array:
    """The second file's numbers as the first file counts them.

    Limits of a joint coordinate change sign with the coordinate, and move with the pose that it is counted
    from. All other numbers are the same in both.
    """
    values = np.array(two.values)
    bounds = _bounds(first, one), _bounds(second, two)
    if one.what != LIMITS or bounds[0] is None or bounds[1] is None:
        return values
    (key, _), (other, _) = bounds[0].terms[0], bounds[1].terms[0]
    partner = aligned.coordinates.get(key)
    if partner is None or partner.key != other:
        return values
    here, there = aligned.at_start[key]
    turned = here + partner.sense * (values - _zero(bounds[1], two) - there)
    return np.sort(turned + _zero(bounds[0], one))


def _bounds(model: Model, given: Given) -> Bounds | None:
    """Watch of the limits of one joint coordinate in a run; None for anything else."""
    watches = model.mapping.watches.get(given.number, ()) if model.mapping else ()
    for watch in watches if len(watches) == 1 else ():
        if isinstance(watch, Bounds) and [factor for _, factor in watch.terms] == [1.0]:
            return watch
    return None


def _zero(bounds: Bounds, given: Given) -> float:
    """Value of a coordinate, as the file counts it, in the initial pose; margins at both ends cancel."""
    low, high = given.values
    if not np.all(np.isfinite([low, high])) or not isinstance(bounds.constant, float):
        return 0.0
    return 0.5 * (low + high - bounds.low - bounds.high) + bounds.constant


def _only_in_one(
    where: str,
    mine: Mapping[tuple[str, str], Given],
    theirs: Mapping[tuple[str, str], Given],
    elements: Container[str],
) -> Iterator[Unsimulated]:
    """Yield numbers of simulated elements that only one file gives, such as a range of a control.

    Elements that are left out, or that only one file has, are compared as a whole.

    Args:
        where: name of the file that has `mine`.
        mine: numbers of one file.
        theirs: numbers of the other file.
        elements: all elements of the other file.
    """
    for key, given in mine.items():
        if given.entry.fate == "exactly" and key not in theirs and key[0] in elements:
            text = f"only {where}: {given.name}: {given.text(4)}"
            yield Unsimulated(text, not given.entry.is_off)


def _format(model: Model) -> str:
    if not is_model_file(model.source):
        return "scene"
    return "URDF" if is_urdf_file(model.source) else "MJCF"


def is_mjcf(model: Model) -> bool:
    """Return True for a model that was read from an MJCF."""
    return _format(model) == "MJCF"


def _unsimulated(
    model: Model, names: Mapping[str, str], alike: bool
) -> dict[tuple[str, ...], ImportedElement]:
    """Entries of a model's report by what they are about, with other `names` of bodies and joints."""
    found: dict[tuple[str, ...], ImportedElement] = {}
    for entry in model.mapping.entries if model.mapping else ():
        element = _renamed(entry.element, names)
        if not alike and entry.topic == CONTACTS:
            element = ""
        if (entry.fate != "exactly" or entry.inert) and (alike or not entry.inert):
            key = (re.sub(r"^\d+ ", "", element), entry.topic, entry.fate, str(entry.inert))
            found.setdefault(key, entry)
    return found


def _elements(model: Model, names: Mapping[str, str]) -> set[str]:
    """All elements of a model's report, with other `names` of bodies and joints."""
    return {_renamed(entry.element, names) for entry in (model.mapping.entries if model.mapping else ())}


def _renamed(element: str, names: Mapping[str, str]) -> str:
    """The words of an element with other `names` of bodies and joints."""
    return re.sub(r"'(.*?)'", lambda name: repr(names.get(name[1], name[1])), element)
