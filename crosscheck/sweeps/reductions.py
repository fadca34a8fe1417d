"""Reductions: the numbers or arrays that a sweep keeps of each run, computed for many runs at once.

A sweep simulates one scene many times with varied parameters. A reduction evaluates an expression over the
outputs of a run (see `crosscheck.sweeps.expressions`) at all output times, and reduces the time series, for
example to its maximum.

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

SECOND_KIND_PATTERN = re.compile(r"\w+(\([^()]*\))?:")
"""A kind within an expression, such as `minimum:`, which is an error."""

REDUCTION_FORM = "[NAME=]KIND:OUTPUT, as peak:reaction_force"
"""Form of the text and an example, for error messages."""

OUTPUT_TIME_TOLERANCE = 1e-9
"""Largest difference between a requested time and an output time, divided by the output period."""


def _magnitude(value: Value) -> Value:
    """Return the norms of vectors, or the absolute values of numbers.

    Raises:
        CrosscheckError: for quaternions.
    """
    # the second dimension is "axis" for vectors (x, y, z), "component" for quaternions, "" for numbers
    if value.dimensions[1] == "axis":
        return norm(value)
    if value.dimensions[1] == "component":
        raise CrosscheckError("a quaternion has no magnitude; name a component of it")
    return replace(value, array=np.abs(value.array))


def _mean(array: Array, times: Array) -> Array:
    """Average values (runs, n, ...) over times (n,) by the trapezoidal rule."""
    total = np.zeros(array[:, 0].shape)
    # a loop: the order of summation of NumPy's integrals depends on the number of runs
    for k, step in enumerate(np.diff(times)):
        total += 0.5 * step * (array[:, k] + array[:, k + 1])
    return total / (times[-1] - times[0])


def _first_above(excess: Array, times: Array) -> Array:
    """Return the first time (runs,), s, at which a time series (runs, n) is positive; NaN if it never is."""
    # interpolate linearly between the first positive output and the output before it
    above = excess > 0.0
    k = np.argmax(above, axis=1)
    runs = np.arange(len(excess))
    before = np.maximum(k - 1, 0)
    low, high = excess[runs, before], excess[runs, k]
    fraction = np.where(k > 0, -low / (high - low), 1.0)
    crossing_times = times[before] + fraction * (times[k] - times[before])
    return np.where(above.any(axis=1), crossing_times, np.nan)


AT = "at"
"""Kind of reduction that keeps values at given times: `at(0.5; 1)` at 0.5 s and 1 s, `at()` at all times."""

WHEN = "when"
"""Kind of reduction that finds an event: `when:a > b` is the first time, s, at which a exceeds b.

The time is interpolated linearly between outputs; it is NaN if a never exceeds b.
"""

REDUCTIONS: dict[str, Callable[[Array, Array], Array]] = {
    "final": lambda values, times: values[:, -1],
    "peak": lambda values, times: values.max(axis=1),
    "rms": lambda values, times: np.sqrt(_mean(values * values, times)),
    "mean": _mean,
    "minimum": lambda values, times: values.min(axis=1),
    "maximum": lambda values, times: values.max(axis=1),
    "range": lambda values, times: values.max(axis=1) - values.min(axis=1),
    WHEN: _first_above,
}
"""Functions of values (runs, n, ...) and times (n,), s, by kind of reduction. The result has the shape
(runs, ...)."""

MAGNITUDE_REDUCTIONS = ("peak", "rms")
"""Kinds of reductions whose values are the norms of vectors or the absolute values of numbers."""

REACTIONS = ("reaction_force", "reaction_torque")
"""Quantities that depend on constraint forces."""


@dataclass(frozen=True, eq=False)
class Reduction:
    """One kept output of each run.

    Attributes:
        name: name of the variable.
        text: text of the reduction, without the name.
        kind: a key of `REDUCTIONS`, or `AT`.
        output_indices: for `AT`, indices of the output times that are kept; else empty.
        expression: expression over the outputs; for `WHEN` the difference of both sides.
        dimensions: labels along each dimension of the results after the runs, by name of the dimension. The
            labels are names of bodies, joints, actuators or components, or times, s.
        unit: unit of the results.
    """

    name: str
    text: str
    kind: str
    output_indices: tuple[int, ...]
    expression: Expression
    dimensions: dict[str, Array]
    unit: str

    @property
    def depends_on_reactions(self) -> bool:
        """True if the output depends on constraint forces, which soft constraints do not determine
        exactly."""
        return not self.expression.quantities.isdisjoint(REACTIONS)

    def reaction_joints(self, index: tuple[int, ...]) -> set[str]:
        """Return the names of the joints whose reactions affect the number at an index of the results."""
        joints = set[str]().union(*(self.expression.elements.get(name, ()) for name in REACTIONS))
        if "" not in joints:
            return joints
        # the empty name stands for all joints; the number belongs to one of them
        k = dict(zip(self.dimensions, index, strict=True))["joint"]
        return joints - {""} | {str(self.dimensions["joint"][k])}

    @property
    def needs_all_times(self) -> bool:
        """False if the outputs at the end of a run suffice.

        Values that depend on signs of quaternions or on revolutions of joints need all earlier outputs.
        """
        return self.kind != "final" or self.expression.signed

    @np.errstate(all="ignore")
    def of(self, outputs: Outputs) -> Array:
        """Reduce the outputs of runs to an array (runs, *dimensions); NaN where the outputs are NaN."""
        values = self.time_series(outputs)
        if self.kind == AT:
            found = values[:, list(self.output_indices)]
        else:
            found = REDUCTIONS[self.kind](values, outputs.times)
        return np.array(found, order="C")  # a copy, since a view would keep all outputs in memory

    @np.errstate(all="ignore")
    def time_series(self, outputs: Outputs) -> Array:
        """Return the values (runs, times, ...) that are reduced; magnitudes for peak and rms."""
        value = self.expression.evaluate(outputs)
        array = (_magnitude(value) if self.kind in MAGNITUDE_REDUCTIONS else value).array
        # a constant expression has one run and one time; positions, which every run has, give their number
        runs, times = max(len(array), len(outputs.stacked("position"))), len(outputs.times)
        sizes = [len(names) for name, names in self.dimensions.items() if not name.startswith("time")]
        return np.broadcast_to(array, (runs, times, *array.shape[2:])).reshape(runs, times, *sizes)

    @np.errstate(all="ignore")
    def time_series_of(self, outputs: Outputs, index: tuple[int, ...]) -> Array:
        """Return the time series (runs, times) from which the number at an index of the results follows."""
        # the first dimension of the results of `AT` is the time
        index_after_time: tuple[Any, ...] = index[1:] if self.kind == AT else index
        return self.time_series(outputs)[:, :, *index_after_time]


Keep = str | Iterable[str] | Mapping[str, str]
"""Texts of reductions, several in one text separated by commas; or a mapping from names to texts."""


def reductions(keep: Keep, scene: Scene) -> tuple[Reduction, ...]:
    """Parse the texts of the outputs that are kept of each run of a scene.

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
    # Reductions at the same times share one dimension of time; the dimensions are time, time1, and so on
    different_times = list(dict.fromkeys(each.output_indices for each in found if each.kind == AT))
    for k, each in enumerate(found):
        if each.kind == AT:
            number = different_times.index(each.output_indices)
            times = {f"time{number or ''}": scene.times[list(each.output_indices)]}
            found[k] = replace(each, dimensions=times | each.dimensions)
    return tuple(found)


def _split(text: str) -> list[str]:
    """Split a text at commas outside of brackets and quotes."""
    parts, depth, in_quotes = [""], 0, False
    for character in text:
        in_quotes ^= character == "'"
        depth += (character in "([") - (character in ")]")
        if character == "," and depth == 0 and not in_quotes:
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
    kind, expression_text, times = parts["kind"], parts["of"].strip(), parts["times"]
    if kind not in (*REDUCTIONS, AT) or (times is None) != (kind != AT):
        raise ValueError(f"unknown kind of output; {choices(kind, [*REDUCTIONS, 'at(TIME; ...)'])}")
    if ";" not in expression_text and (second := SECOND_KIND_PATTERN.search(expression_text)):
        raise ValueError(
            f"{second.group()!r} in the expression; needed: one kind in front of the whole expression; a "
            "stroke, maximum minus minimum, is stroke=range:slider.position.x"
        )
    if kind == WHEN:  # a > b becomes a - b, which is positive after the event
        left, sign, right = expression_text.partition(">" if ">" in expression_text else "<")
        if not sign or not left.strip() or not right.strip():
            raise ValueError("when needs a comparison, as when:a > b")
        higher, lower = (left, right) if sign == ">" else (right, left)
        expression_text = f"({higher.strip()}) - ({lower.strip()})"
    expression = Expression(expression_text, scene)
    if not expression.plain and not parts["name"]:
        raise ValueError(f"it is an expression; give it a name (--keep NAME={text:.100})")
    # the example is the value for outputs that are all zero; every value has its dimensions and unit
    example = _magnitude(expression.example) if kind in MAGNITUDE_REDUCTIONS else expression.example
    if kind == WHEN and example.named:
        raise ValueError(f"when compares numbers, not {example}")
    labels_along = labels(scene)
    text_without_name = text if parts["name"] is None else text.partition("=")[2].strip()
    return Reduction(
        name=parts["name"] or text_without_name,
        text=text_without_name,
        kind=kind,
        output_indices=_output_indices(times, scene) if kind == AT else (),
        expression=expression,
        dimensions={name: np.array(labels_along[name]) for name in example.named},
        unit="s" if kind == WHEN else example.unit,
    )


def _output_indices(given: str, scene: Scene) -> tuple[int, ...]:
    """Return the indices of the outputs at given times; raises `ValueError` for a time without output.

    Args:
        given: times, s, separated by semicolons; empty for all outputs.
        scene: the scene.
    """
    if not given.strip():
        return tuple(range(len(scene.times)))
    if "," in given:
        raise ValueError("separate times by semicolons, as in at(0.5; 1)")
    times = [plain_number(part.strip()) for part in given.split(";")]
    indices = [int(np.argmin(np.abs(scene.times - time))) for time in times]
    for time, index in zip(times, indices, strict=True):
        if abs(scene.times[index] - time) > OUTPUT_TIME_TOLERANCE * scene.output_period:
            period = f"outputs are every {scene.output_period:g} s up to {scene.duration:g} s"
            raise ValueError(f"there is no output at {time:.9g} s; {period}")
    return tuple(indices)


def pruned(scene: Scene, kept: Iterable[Reduction], integrator: str) -> Scene:
    """Return the scene with only those outputs that the reductions need.

    If outputs at the start and the end of a run suffice, the scene has no others. Integrators with fixed
    steps keep all output times, since their steps divide the output period.
    """
    needed = {QUANTITY_OUTPUTS[name] for each in kept for name in each.expression.quantities}
    outputs = frozenset(name for name in needed if name)
    end_suffices = integrator not in FIXED and not any(each.needs_all_times for each in kept)
    period = scene.duration if end_suffices else scene.output_period
    return replace(scene, outputs=outputs, output_period=period)
