"""Reductions: the numbers or arrays that a sweep keeps of each run, computed for many runs at once.

A reduction computes its result from an expression over the outputs of a run, see
`crosscheck.sweeps.expressions`.

Examples: `peak:reaction_force` is the largest reaction force of each joint, `final:panel_7.quaternion` the
last orientation of the panel, and `tilt=final:angle(direction(panel_7.quaternion, [0, 0, 1]), [0, 0, 1])` a
named expression.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from crosscheck.support.errors import CrosscheckError
from crosscheck.sweeps.expressions import QUANTITY_OUTPUTS, Expression, Outputs, Value, labels, norm
from newton_euler.errors import choices, plain_number, quoted
from newton_euler.integrators.options import FIXED
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array

REDUCTION_PATTERN = re.compile(
    r"(?:(?P<name>[A-Za-z_]\w*)\s*=)?\s*(?P<kind>\w+)(?:\((?P<times>[^()]*)\))?:(?P<of>.+)", re.DOTALL
)
"""Form of the text of a reduction: [NAME=]KIND[(TIMES)]:EXPRESSION."""

REDUCTION_FORM = "[NAME=]KIND:OUTPUT, as peak:reaction_force"
"""Form of the text of a reduction, for error messages."""

OUTPUT_TIME_TOLERANCE = 1e-9
"""Largest difference between a requested time and an output, in output periods."""


def _magnitude(value: Value) -> Value:
    """Return norms of vectors and absolute values of numbers."""
    if value.dimensions[1] == "axis":
        return norm(value)
    if value.dimensions[1] == "component":
        raise CrosscheckError("a quaternion has no magnitude; name a component of it")
    return replace(value, array=np.abs(value.array))


def _mean(array: Array, times: Array) -> Array:
    """Average over time by the trapezoidal rule, with an order of summation that does not depend on the
    runs."""
    total = np.zeros(array[:, 0].shape)
    for k, step in enumerate(np.diff(times)):
        total += 0.5 * step * (array[:, k] + array[:, k + 1])
    return total / (times[-1] - times[0])


def _first_above(excess: Array, times: Array) -> Array:
    """Return the first times (runs,), s, at which a function of time (runs, n) is positive."""
    # interpolate linearly between the first positive output and the one before
    above = excess > 0.0
    k = np.argmax(above, axis=1)
    runs = np.arange(len(excess))
    before = np.maximum(k - 1, 0)
    low, high = excess[runs, before], excess[runs, k]
    fraction = np.where(k > 0, -low / (high - low), 1.0)
    crossed = times[before] + fraction * (times[k] - times[before])
    return np.where(above.any(axis=1), crossed, np.nan)


AT, WHEN = "at", "when"
"""Reductions with a special form. `at(0.5; 1)` keeps the outputs at 0.5 s and 1 s, and `at()` at all times.
`when:a > b` is the first time, s, at which a exceeds b, interpolated linearly between outputs; NaN if a never
exceeds b."""

REDUCTIONS: dict[str, Callable[[Array, Array], Array]] = {
    "final": lambda course, times: course[:, -1],
    "peak": lambda course, times: course.max(axis=1),
    "rms": lambda course, times: np.sqrt(_mean(course * course, times)),
    "mean": _mean,
    "minimum": lambda course, times: course.min(axis=1),
    "maximum": lambda course, times: course.max(axis=1),
    WHEN: _first_above,
}
"""Functions of values (runs, n, ...) and times (n,) by reduction. Peak and rms apply to magnitudes."""

MAGNITUDE_REDUCTIONS = ("peak", "rms")
"""Reductions of the lengths of vectors and the magnitudes of numbers."""

REACTIONS = ("reaction_force", "reaction_torque")
"""Quantities that depend on constraint forces."""


@dataclass(frozen=True, eq=False)
class Reduction:
    """One kept output of each run.

    Attributes:
        name: name of the variable.
        text: text of the reduction, without the name.
        kind: one of `REDUCTIONS` or `AT`.
        places: numbers of the output times of `AT`.
        expression: expression over the outputs; for `WHEN` the difference of both sides.
        dimensions: by name of each dimension after the runs, its labels: names of elements, or times, s.
        unit: unit of the results.
    """

    name: str
    text: str
    kind: str
    places: tuple[int, ...]
    expression: Expression
    dimensions: dict[str, Array]
    unit: str

    @property
    def reacts(self) -> bool:
        """True if the output depends on constraint forces, which soft constraints do not determine
        exactly."""
        return not self.expression.quantities.isdisjoint(REACTIONS)

    def reacting(self, place: tuple[int, ...]) -> set[str]:
        """Return the names of joints whose reactions affect the number at a place of the results."""
        joints = set[str]().union(*(self.expression.elements.get(name, ()) for name in REACTIONS))
        if "" not in joints:
            return joints
        # the empty name stands for all joints: the place of the number is at one of them
        index = dict(zip(self.dimensions, place, strict=True))["joint"]
        return joints - {""} | {str(self.dimensions["joint"][index])}

    @property
    def needs_all_times(self) -> bool:
        """False if the end of a run suffices."""
        return self.kind != "final" or self.expression.signed

    @np.errstate(all="ignore")
    def of(self, outputs: Outputs) -> Array:
        """Reduce the outputs of runs to an array (runs, *dimensions); NaN where the outputs are NaN."""
        course = self.course(outputs)
        at = self.kind == AT
        found = course[:, list(self.places)] if at else REDUCTIONS[self.kind](course, outputs.times)
        return np.array(found, order="C")  # a copy, since a view would keep all outputs in memory

    @np.errstate(all="ignore")
    def course(self, outputs: Outputs) -> Array:
        """Return the values (runs, times, ...) that are reduced; magnitudes for peak and rms."""
        value = self.expression.evaluate(outputs)
        array = (_magnitude(value) if self.kind in MAGNITUDE_REDUCTIONS else value).array
        runs, times = max(len(array), len(outputs.stacked("position"))), len(outputs.times)
        sizes = [len(names) for name, names in self.dimensions.items() if not name.startswith("time")]
        return np.broadcast_to(array, (runs, times, *array.shape[2:])).reshape(runs, times, *sizes)

    @np.errstate(all="ignore")
    def line(self, outputs: Outputs, place: tuple[int, ...]) -> Array:
        """Return the time series (runs, times) from which the number at a place of the results is reduced."""
        of_time: tuple[Any, ...] = place[1:] if self.kind == AT else place
        return self.course(outputs)[:, :, *of_time]


Keep = str | Iterable[str] | Mapping[str, str]
"""Texts of reductions, several in one text separated by commas; or a mapping from names to texts."""


def reductions(keep: Keep, scene: Scene) -> tuple[Reduction, ...]:
    """Parse and check the kept outputs of each run of a scene.

    Raises:
        CrosscheckError: quoting the text at fault.
    """
    if isinstance(keep, Mapping):
        texts = [f"{name}={text}" for name, text in keep.items()]
    else:
        given = (keep,) if isinstance(keep, str) else tuple(keep)
        if wrong := [each for each in given if not isinstance(each, str)]:
            raise CrosscheckError(f"keep holds {quoted(wrong[0])}; needed: text of the form {REDUCTION_FORM}")
        texts = [part for each in given for part in _split(each)]
    found = [_reduction(text, scene) for text in texts]
    if not found:
        raise CrosscheckError(f"nothing is kept; name an output (--keep {REDUCTION_FORM})")
    names = [each.name for each in found]
    for name in names:
        if names.count(name) > 1:
            raise CrosscheckError(f"{name!r} is kept twice; keep it once, or give the second a name")
    times = list(dict.fromkeys(each.places for each in found if each.kind == AT))
    names_of = {places: f"time{number or ''}" for number, places in enumerate(times)}
    return tuple(
        replace(each, dimensions={names_of[each.places]: scene.times[list(each.places)]} | each.dimensions)
        if each.kind == AT
        else each
        for each in found
    )


def _split(text: str) -> list[str]:
    """Split a text at commas outside of brackets and quotes."""
    parts, depth, quoted = [""], 0, False
    for character in text:
        quoted ^= character == "'"
        depth += (character in "([") - (character in ")]")
        if character == "," and depth == 0 and not quoted:
            parts.append("")
        else:
            parts[-1] += character
    return [part.strip() for part in parts]


def _reduction(text: str, scene: Scene) -> Reduction:
    """Parse the text of one reduction; raises `CrosscheckError` that quotes the text."""
    parts = REDUCTION_PATTERN.fullmatch(text)
    if parts is None:
        raise CrosscheckError(f"--keep {text!r:.200} is not of the form {REDUCTION_FORM}")
    try:
        return _parsed(text, parts, scene)
    except (CrosscheckError, ValueError) as error:
        raise CrosscheckError(f"--keep {text!r:.200}: {error}"[:500]) from None


def _parsed(text: str, parts: re.Match[str], scene: Scene) -> Reduction:
    """Make the reduction of a matched text; raises `CrosscheckError` or `ValueError`."""
    kind, of, times = parts["kind"], parts["of"].strip(), parts["times"]
    if kind not in (*REDUCTIONS, AT) or (times is None) != (kind != AT):
        raise ValueError(f"unknown reduction; {choices(kind, [*REDUCTIONS, 'at(TIME; ...)'])}")
    if kind == WHEN:
        left, sign, right = of.partition(">" if ">" in of else "<")
        if not sign or not left.strip() or not right.strip():
            raise ValueError("when needs a comparison, as when:a > b")
        higher, lower = (left, right) if sign == ">" else (right, left)
        of = f"({higher.strip()}) - ({lower.strip()})"
    expression = Expression(of, scene)
    if not expression.plain and not parts["name"]:
        raise ValueError(f"it is an expression; give it a name (--keep NAME={text:.100})")
    example = _magnitude(expression.example) if kind in MAGNITUDE_REDUCTIONS else expression.example
    if kind == WHEN and example.named:
        raise ValueError(f"when compares numbers, not {example}")
    places = _places(times, scene) if kind == AT else ()
    names = labels(scene)
    dimensions = {name: np.array(names[name]) for name in example.named}
    own = text if parts["name"] is None else text.partition("=")[2].strip()
    unit = "s" if kind == WHEN else example.unit
    return Reduction(parts["name"] or own, own, kind, places, expression, dimensions, unit)


def _places(given: str, scene: Scene) -> tuple[int, ...]:
    """Return the numbers of the outputs at given times, s; of all outputs without times. Raises
    `ValueError`."""
    if not given.strip():
        return tuple(range(len(scene.times)))
    if "," in given:
        raise ValueError("separate times by semicolons, as in at(0.5; 1)")
    times = [plain_number(part.strip()) for part in given.split(";")]
    places = [int(np.argmin(np.abs(scene.times - time))) for time in times]
    for time, place in zip(times, places, strict=True):
        if abs(scene.times[place] - time) > OUTPUT_TIME_TOLERANCE * scene.output_period:
            period = f"outputs are every {scene.output_period:g} s up to {scene.duration:g} s"
            raise ValueError(f"there is no output at {time:.9g} s; {period}")
    return tuple(places)


def pruned(scene: Scene, kept: Iterable[Reduction], integrator: str) -> Scene:
    """Return the scene with only those outputs that the reductions need, and only the last time if that
    suffices.

    Integrators with fixed steps keep all output times, as their steps divide the output period.
    """
    asked = {QUANTITY_OUTPUTS[name] for each in kept for name in each.expression.quantities}
    outputs = frozenset(name for name in asked if name)
    alone = integrator not in FIXED and not any(each.needs_all_times for each in kept)
    return replace(scene, outputs=outputs, output_period=scene.duration if alone else scene.output_period)
