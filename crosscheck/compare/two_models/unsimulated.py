"""Differences between two model files in elements that are not simulated.

Examples are contacts, joint limits, ranges of actuators, and dry friction. In: two models with their import
reports, and their alignment. Out: one sentence for each element that only one file has, or that has different
numbers in the two files.

In an import report, the fate of an element is "exactly" (imported without change) or "left out" (not
simulated). It is "inactive" if a run shows that a left-out element would not have acted. An entry
`moves_nothing` if its element cannot move anything, such as a camera or an element that the file itself
switches off (`is_off`).
"""

from __future__ import annotations

import re
from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from crosscheck.compare.activity import what_acted
from crosscheck.compare.two_models.align import Aligned
from crosscheck.library.model_files import is_model_file, is_urdf_file
from crosscheck.library.options import titled
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

FILE_ROUND_OFF = 1e-5
"""Relative difference of two numbers below which they are equal: files that MuJoCo saves have six digits."""

NEVER_COMPARED = "contact and softness parameters (friction of geoms, solref, solimp) are not compared"
"""Note on parameters that a comparison of two MJCF files does not compare."""


@dataclass(frozen=True)
class Model:
    """One of the two models.

    Attributes:
        name: name in tables and files.
        source: name or file that the model was loaded from.
        options: options of the scene or file that the user set.
        scene: the imported scene.
        mapping: import report of a model file: how each element was imported. None for other scenes.
    """

    name: str
    source: str
    options: Mapping[str, str]
    scene: Scene
    mapping: ImportReport | None

    @property
    def title(self) -> str:
        """Name or file of the model, with the options that the user set."""
        return titled(self.source, self.options)


class Unsimulated(NamedTuple):
    """Difference between two files in an element that is not simulated as the file has it.

    Attributes:
        text: sentence on the element and the difference.
        moves: True if the element can affect the motion of the mechanism; False for settings of tools.
    """

    text: str
    moves: bool


def unsimulated(first: Model, second: Model, aligned: Aligned) -> Iterator[Unsimulated]:
    """Yield differences between two files in elements that were not imported exactly.

    An element differs if only one file has it, or if its numbers differ. If one file is an MJCF and the other
    a URDF, only elements that can affect the motion are compared; for contacts, only whether the file has
    any. Limits that only the URDF has are no difference, since a URDF must have them.

    Args:
        first, second: the two models.
        aligned: their alignment, with the names of paired bodies and joints.
    """
    # Elements that only one file has
    kinds = [_format(model) for model in (first, second)]
    same_format, others = kinds[0] == kinds[1], {**aligned.names, **aligned.joint_names}
    named: tuple[tuple[Model, Mapping[str, str]], ...] = ((first, {}), (second, others))
    of_first, of_second = (_unsimulated_entries(model, names, same_format) for model, names in named)
    for where, own_entries, other_entries, kind in (
        ("here", of_first, of_second, kinds[0]),
        ("there", of_second, of_first, kinds[1]),
    ):
        for key, entry in own_entries.items():
            required = kind == "URDF" and not same_format and entry.topic in (LIMITS, VELOCITY_LIMITS)
            if key not in other_entries and not required:
                yield Unsimulated(f"only {where}: {entry}", not entry.moves_nothing)
    # Elements with different numbers, and numbers that only one file gives
    given = [_numbers(model, names, same_format) for model, names in named]
    yield from _differing_numbers(first, second, aligned, *given)
    if same_format:
        elements = [_element_names(model, names) for model, names in named]
        yield from _only_in_one("here", given[0], given[1], elements[1])
        yield from _only_in_one("there", given[1], given[0], elements[0])


class FileNumbers(NamedTuple):
    """Numbers of one element of a file that are not simulated, such as the limits of a joint.

    Attributes:
        number: number of the element's entry in the import report.
        entry: the entry.
        what: quantity, such as `LIMITS`.
        values: the numbers, in SI units.
    """

    number: int
    entry: ImportedElement
    what: str
    values: tuple[float, ...]

    @property
    def name(self) -> str:
        """Quantity and element, such as "limits of joint 'pivot'"."""
        named = self.entry.topic == self.what
        return what_acted(self.entry) if named else f"{self.what} of {self.entry.element}"

    def text(self, digits: int) -> str:
        """Format the numbers with some significant digits."""
        return " to ".join(f"{value:.{digits}g}" for value in self.values)


def _numbers(model: Model, names: Mapping[str, str], same_format: bool) -> dict[tuple[str, str], FileNumbers]:
    """Return the numbers in a model's import report that are not simulated, by element and quantity.

    Args:
        model: the model.
        names: names of the first model by names of this model, for bodies and joints.
        same_format: True if both files have the same format. Otherwise only elements that can affect the
            motion are included.
    """
    found: dict[tuple[str, str], FileNumbers] = {}
    for number, entry in enumerate(model.mapping.entries if model.mapping else ()):
        for what, values in entry.numbers if same_format or not entry.moves_nothing else ():
            key = (_renamed(entry.element, names), what)
            found.setdefault(key, FileNumbers(number, entry, what, values))
    return found


def _differing_numbers(
    first: Model,
    second: Model,
    aligned: Aligned,
    here: Mapping[tuple[str, str], FileNumbers],
    there: Mapping[tuple[str, str], FileNumbers],
) -> Iterator[Unsimulated]:
    """Yield elements to which both files give numbers, but not the same ones.

    Args:
        first, second: the two models.
        aligned: their alignment.
        here, there: numbers of the first and of the second file, see `_numbers`.
    """
    for key, one in here.items():
        two = there.get(key)
        if two is None or one.entry.is_off != two.entry.is_off:
            continue
        a, b = np.array(one.values), _in_first_convention(first, second, aligned, one, two)
        finite = [abs(x) for x in (*one.values, *two.values) if np.isfinite(x)]
        if a.shape == b.shape and np.allclose(a, b, rtol=0.0, atol=FILE_ROUND_OFF * max(finite, default=0.0)):
            continue
        digits = next((n for n in range(4, 17) if one.text(n) != two.text(n)), 4)
        text = f"{one.name}: {one.text(digits)} in {first.title}, {two.text(digits)} in {second.title}"
        yield Unsimulated(text, not one.entry.is_off)


def _in_first_convention(
    first: Model, second: Model, aligned: Aligned, one: FileNumbers, two: FileNumbers
) -> Array:
    """Convert numbers of the second file to the convention of the first file.

    Limits of a joint coordinate are converted to the sign and the zero pose of the first file's coordinate.
    All other numbers are returned unchanged.

    Args:
        first, second: the models.
        aligned: their alignment.
        one, two: numbers of the same element in the first and in the second file.
    """
    values = np.array(two.values)
    bounds = _bounds(first, one), _bounds(second, two)
    if one.what != LIMITS or bounds[0] is None or bounds[1] is None:
        return values
    # The limits are those of one joint coordinate in each model
    (key, _), (other, _) = bounds[0].terms[0], bounds[1].terms[0]
    partner = aligned.coordinates.get(key)
    if partner is None or partner.key != other:
        return values
    # the coordinate in both models at the start of the first model; `sense` is -1 for opposite signs
    here, there = aligned.at_start[key]
    converted = here + partner.sense * (values - _zero(bounds[1], two) - there)
    return np.sort(converted + _zero(bounds[0], one))


def _bounds(model: Model, given: FileNumbers) -> Bounds | None:
    """Return the limits of a joint coordinate as they are monitored in runs; None for other numbers."""
    watches = model.mapping.watches.get(given.number, ()) if model.mapping else ()
    for watch in watches if len(watches) == 1 else ():
        if isinstance(watch, Bounds) and [factor for _, factor in watch.terms] == [1.0]:
            return watch
    return None


def _zero(bounds: Bounds, given: FileNumbers) -> float:
    """Return the value of a coordinate in the initial pose, as the file counts it, m or rad.

    The scene's coordinate x is zero in the initial pose, and `bounds` are low <= constant + x <= high. The
    midpoints of both pairs of limits correspond, so that the file's value is constant plus their difference.

    Args:
        bounds: limits that are monitored in runs, in the coordinate of the scene. They may be narrower than
            those of the file by the same margin at both ends.
        given: limits in the file.
    """
    low, high = given.values
    if not np.all(np.isfinite([low, high])) or not isinstance(bounds.constant, float):
        return 0.0
    return 0.5 * (low + high - bounds.low - bounds.high) + bounds.constant


def _only_in_one(
    where: str,
    own_numbers: Mapping[tuple[str, str], FileNumbers],
    other_numbers: Mapping[tuple[str, str], FileNumbers],
    elements: Container[str],
) -> Iterator[Unsimulated]:
    """Yield numbers of simulated elements that only one file gives, such as the range of an actuator.

    Elements that are not simulated at all, or that only one file has, are reported elsewhere.

    Args:
        where: "here" for the first file, "there" for the second: the file that has `own_numbers`.
        own_numbers: numbers of one file.
        other_numbers: numbers of the other file.
        elements: all elements of the other file.
    """
    for key, given in own_numbers.items():
        if given.entry.fate == "exactly" and key not in other_numbers and key[0] in elements:
            text = f"only {where}: {given.name}: {given.text(4)}"
            yield Unsimulated(text, not given.entry.is_off)


def _format(model: Model) -> str:
    """Return the format of a model's file: "MJCF", "URDF" or "scene"."""
    if not is_model_file(model.source):
        return "scene"
    return "URDF" if is_urdf_file(model.source) else "MJCF"


def is_mjcf(model: Model) -> bool:
    """Return True for a model that was read from an MJCF."""
    return _format(model) == "MJCF"


def _unsimulated_entries(
    model: Model, names: Mapping[str, str], same_format: bool
) -> dict[tuple[str, ...], ImportedElement]:
    """Return the entries of a model's import report that were not imported exactly.

    Args:
        model, names, same_format: see `_numbers`.

    Returns:
        Entries by element, topic, and how the element was imported.
    """
    found: dict[tuple[str, ...], ImportedElement] = {}
    for entry in model.mapping.entries if model.mapping else ():
        element = _renamed(entry.element, names)
        if not same_format and entry.topic == CONTACTS:
            element = ""
        if (entry.fate != "exactly" or entry.moves_nothing) and (same_format or not entry.moves_nothing):
            # without a leading number of elements, as in "12 geoms that can touch"
            key = (re.sub(r"^\d+ ", "", element), entry.topic, entry.fate, str(entry.moves_nothing))
            found.setdefault(key, entry)
    return found


def _element_names(model: Model, names: Mapping[str, str]) -> set[str]:
    """Return all elements of a model's import report; `names` as in `_numbers`."""
    return {_renamed(entry.element, names) for entry in (model.mapping.entries if model.mapping else ())}


def _renamed(element: str, names: Mapping[str, str]) -> str:
    """Replace quoted names of bodies and joints in the text of an element by other `names`."""
    return re.sub(r"'(.*?)'", lambda name: repr(names.get(name[1], name[1])), element)
