"""A scene's figures against its baseline: which moved, by how many bands, and from when on."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from crosscheck.against.pairs import pair_parts
from crosscheck.regress.baseline import Baseline, Carried, Figure, Record, versions
from crosscheck.regress.measure import MAIN, measure_group, regress_scene
from crosscheck.regress.values import Value
from newton_euler.model.mapping import Mapping, differing, room
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array

MODEL_FILE = "model file"
"""In place of the group of a figure: what a file holds and no scene does."""

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Checked:
    """One figure against its baseline, where it moved most.

    Attributes:
        group, name, unit: of the figure.
        where: the row and column, for example body and axis; empty for a single number.
        was, now: SI; None where there is nothing to compare, see `problem`.
        band: how far it may move.
        problem: why it could not be compared.
    """

    group: str
    name: str
    unit: str
    where: str
    was: float | None
    now: float | None
    band: float
    problem: str = ""

    @property
    def bands(self) -> float:
        """By how much it moved, in bands; infinite if it is not there or not finite any more."""
        if self.was is None or self.now is None or not np.isfinite(self.now):
            return float("inf")
        difference = abs(self.now - self.was)
        return difference / self.band if self.band > 0.0 else (0.0 if difference == 0.0 else float("inf"))

    @property
    def moved(self) -> bool:
        return self.bands > 1.0

    def summary(self) -> dict[str, Any]:
        """For JSON, which has no infinities."""
        now = self.now if self.now is not None and np.isfinite(self.now) else None
        return {
            "group": self.group,
            "name": self.name,
            "unit": self.unit,
            "where": self.where,
            "was": self.was,
            "now": now,
            "band": self.band,
            "bands": self.bands if np.isfinite(self.bands) else None,
            "moved": self.moved,
            "problem": self.problem,
        }


@dataclass(frozen=True)
class Comparison:
    """A scene against its baseline.

    Attributes:
        scene: its name.
        checked: what of a model file is in no figure, then all figures in the baseline's order.
        made: when, why and with which versions the baseline was made.
        now: versions of this run.
        diverges: s, first output time at which a pose is out of its band; None if none is.
        wall_time: s.
    """

    scene: str
    checked: tuple[Checked, ...]
    made: Record
    now: dict[str, str]
    diverges: float | None
    wall_time: float

    @property
    def moved(self) -> list[Checked]:
        return [figure for figure in self.checked if figure.moved]

    @property
    def changed_versions(self) -> list[str]:
        """Such as "numpy 2.1.0 -> 2.2.0"."""
        names = dict.fromkeys([*self.made.versions, *self.now])
        pairs = ((name, self.made.versions.get(name, "none"), self.now.get(name, "none")) for name in names)
        return [f"{name} {was} -> {now}" for name, was, now in pairs if was != now]

    @property
    def verdict(self) -> str:
        """One line."""
        made = f"the baseline of {self.made.date} ({self.made.reason})"
        if not self.moved:
            return f"{self.scene}: quiet: all {len(self.checked)} figures are as in {made}"
        since = ", ".join(self.changed_versions) or "no version changed"
        when = "" if self.diverges is None else f"; poses part at {self.diverges:.6g} s"
        moved = f"{len(self.moved)} of {len(self.checked)} figures"
        return f"{self.scene}: MOVED: {moved} since {made}: {since}{when}"

    def summary(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "scene": self.scene,
            "quiet": not self.moved,
            "verdict": self.verdict,
            "baseline": self.made.model_dump(),
            "versions": self.now,
            "diverges": self.diverges,
            "wall_time": self.wall_time,
            "figures": [figure.summary() for figure in self.checked],
        }


def compare(
    scene: Scene,
    baseline: Baseline,
    progress: Progress,
    clock: Callable[[], float],
    mapping: Mapping | None = None,
) -> Comparison:
    """Measure a scene's figures as its baseline says and compare them.

    Args:
        scene: as loaded.
        progress: is told each stage.
        clock: s, for the wall time.
        mapping: what became of the elements of a model file; None for a scene of this package's own.
    """
    start = clock()
    measured = regress_scene(scene)
    now = [] if mapping is None else Carried.of(mapping)
    checked = check_carried(baseline.carried or [], now)
    diverges = None
    for group in baseline.groups:
        progress(f"{scene.name}: {group}")
        found = measure_group(group, measured, baseline.plan)
        figures = [figure for figure in baseline.figures if figure.group == group]
        checked.extend(check(figures, found))
        if group == MAIN and not isinstance(found, str):
            diverges = divergence(figures, found, measured.times)
    return Comparison(scene.name, tuple(checked), baseline.made, versions(), diverges, clock() - start)


def check_carried(stored: Sequence[Carried], found: Sequence[Carried]) -> list[Checked]:
    """What of a model file is in no figure, against what the baseline has of it."""
    pairs: list[tuple[Carried, Carried]] = []
    gone, new = list[Carried](), list[Carried]()
    for topic in dict.fromkeys(each.topic for each in (*stored, *found)):
        before, now = ([each for each in side if each.topic == topic] for side in (stored, found))
        pairs += pair_parts(before, now, _same_carried, lambda each: each.element, lambda each: each.place)
        gone, new = [*gone, *before], [*new, *now]
    return [
        *(_check_carried(one, two) for one, two in pairs),
        *(_missing_carried(each, f"no longer {each.fate}: {each.how}") for each in gone),
        *(_missing_carried(each, f"{each.fate} now: {each.how}") for each in new),
    ]


def _same_carried(one: Carried, two: Carried) -> bool:
    return one.fate == two.fate and not any(differing(_values(one), _values(two)))


def _values(carried: Carried) -> dict[str, tuple[float | str, ...]]:
    return {name: tuple(value) for name, value in carried.values.items()}


def _missing_carried(carried: Carried, problem: str) -> Checked:
    return Checked(MODEL_FILE, carried.name, "", "", None, None, 0.0, problem)


def _check_carried(stored: Carried, found: Carried) -> Checked:
    """The first value that is not the same."""
    if stored.fate != found.fate:
        return _missing_carried(stored, f"{found.fate} now: {found.how}; was {stored.fate}: {stored.how}")
    one, two = _values(stored), _values(found)
    name = next(differing(one, two), None)
    if name is None:
        return Checked(MODEL_FILE, stored.name, "", "", 0.0, 0.0, 0.0)
    was, now = one.get(name, ()), two.get(name, ())
    for k, (x, y) in enumerate(zip(was, now, strict=False)):
        allowed = room(was, now)
        if isinstance(x, float) and isinstance(y, float) and abs(x - y) > allowed and len(was) == len(now):
            where = f"{name}, number {k + 1}" if len(was) > 1 else name
            return Checked(MODEL_FILE, stored.name, "", where, x, y, allowed)
    told = (" ".join(map(str, value)) or "nothing" for value in (was, now))
    return _missing_carried(stored, "{}: was {}, is {}".format(name, *told))


def check(figures: Iterable[Figure], found: list[Value] | str) -> list[Checked]:
    """A group's figures against what was measured, or against why nothing was."""
    if isinstance(found, str):
        return [_missing(figure, found) for figure in figures]
    values = {value.name: value for value in found}
    return [
        _check(figure, values[figure.name])
        if figure.name in values
        else _missing(figure, "no longer measured")
        for figure in figures
    ]


def _missing(figure: Figure, problem: str) -> Checked:
    return Checked(figure.group, figure.name, figure.unit, "", None, None, 0.0, problem)


def _check(figure: Figure, value: Value) -> Checked:
    if tuple(figure.rows) != value.rows or tuple(figure.columns) != value.columns:
        return _missing(figure, "is of other bodies, joints or times")
    if value.array.size == 0:
        return Checked(figure.group, figure.name, figure.unit, "", 0.0, 0.0, 0.0)
    row, column = np.unravel_index(int(np.argmax(_bands(figure, value))), value.array.shape)
    names = (figure.rows[row], figure.columns[column])
    return Checked(
        figure.group,
        figure.name,
        figure.unit,
        ", ".join(name for name in names if name),
        float(figure.array[row, column]),
        float(value.array[row, column]),
        figure.band[row],
    )


def _bands(figure: Figure, value: Value) -> Array:
    """(rows, columns): by how many bands each number moved; infinite for what is not finite."""
    difference = np.abs(value.array - figure.array)
    band = np.array(figure.band)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(difference == 0.0, 0.0, difference / band)
    return np.where(np.isfinite(value.array), ratio, np.inf)


def divergence(figures: Iterable[Figure], found: list[Value], times: Array) -> float | None:
    """s: the first output time at which a figure over time is out of its band."""
    values = {value.name: value for value in found if value.over_time}
    first = [
        int(np.argmax(out))
        for figure in figures
        if figure.name in values
        and len(figure.rows) == len(times)
        and (out := (_bands(figure, values[figure.name]) > 1.0).any(axis=1)).any()
    ]
    return float(times[min(first)]) if first else None
