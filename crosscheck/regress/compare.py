"""A scene's figures against its baseline: which moved, by how many bands, and from when on."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from crosscheck.regress.baseline import Baseline, Figure, Record, versions
from crosscheck.regress.measure import MAIN, measure_group, regress_scene
from crosscheck.regress.values import Value
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array
from newton_euler.verification.import_report import ImportReport

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
    mapping: ImportReport | None = None,
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
    now = [] if mapping is None else unsimulated(mapping)
    checked = check_unsimulated(baseline.unsimulated or [], now)
    diverges = None
    for group in baseline.groups:
        progress(f"{scene.name}: {group}")
        found = measure_group(group, measured, baseline.plan)
        figures = [figure for figure in baseline.figures if figure.group == group]
        checked.extend(check(figures, found))
        if group == MAIN and not isinstance(found, str):
            diverges = divergence(figures, found, measured.times)
    return Comparison(scene.name, tuple(checked), baseline.made, versions(), diverges, clock() - start)


def unsimulated(mapping: ImportReport) -> list[str]:
    """What of a model file is in no figure and moves something, a line each, as the report words it."""
    return [str(entry) for entry in mapping.entries if entry.fate != "exactly" and not entry.inert]


def check_unsimulated(stored: Sequence[str], found: Sequence[str]) -> list[Checked]:
    """Lines on what of a model file is in no figure, against those of the baseline."""
    gone, new = Counter(stored) - Counter(found), Counter(found) - Counter(stored)
    return [
        *(Checked(MODEL_FILE, line, "", "", 0.0, 0.0, 0.0) for line in stored if line not in gone),
        *(Checked(MODEL_FILE, line, "", "", None, None, 0.0, "no longer so") for line in gone.elements()),
        *(Checked(MODEL_FILE, line, "", "", None, None, 0.0, "new") for line in new.elements()),
    ]


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
