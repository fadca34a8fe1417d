"""A scene's figures against its baseline: what moved, by how many tolerances, and from when on."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from crosscheck.comparison.figure import Figure
from crosscheck.regress.baseline import Baseline, Record, StoredFigure, versions
from crosscheck.regress.measure import MAIN, measure_group, regress_scene
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array
from newton_euler.verification.import_report import ImportReport

MODEL_FILE = "model file"
"""In place of the group of a figure: what a file holds and no scene does."""

BETWEEN = ("baseline", "now")

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Checked(Figure):
    """One stored figure against what it is now, where it moved most.

    Its level is the group of figures, its value the difference; infinite where there is nothing to compare.

    Attributes:
        unit: of the quantity.
        was, now: SI; None where there is nothing to compare.
        problem: why it could not be compared.
    """

    unit: str = ""
    was: float | None = None
    now: float | None = None
    problem: str = ""

    @property
    def moved(self) -> bool:
        return not self.agrees

    @property
    def tolerances(self) -> float:
        """By how many tolerances it moved."""
        return self.value / self.tolerance if self.tolerance > 0.0 else (np.inf if self.moved else 0.0)

    def summary(self) -> dict[str, Any]:
        """For JSON, which has no infinities."""
        now = self.now if self.now is not None and np.isfinite(self.now) else None
        return {
            "group": self.level,
            "name": self.quantity,
            "unit": self.unit,
            "where": self.where,
            "was": self.was,
            "now": now,
            "tolerance": self.tolerance,
            "tolerances": self.tolerances if np.isfinite(self.tolerances) else None,
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
        diverges: s, first output time at which a pose is out of its tolerance; None if none is.
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
    checked = check_unsimulated(baseline.unsimulated or [], unsimulated(mapping) if mapping else [])
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
    """Lines on what of a model file is in no figure and moves something, as its report words them."""
    return [str(entry) for entry in mapping.entries if entry.fate != "exactly" and not entry.inert]


def check_unsimulated(stored: Sequence[str], found: Sequence[str]) -> list[Checked]:
    """Lines on what of a model file is in no figure, against those of the baseline."""
    gone, new = Counter(stored) - Counter(found), Counter(found) - Counter(stored)
    same = [_same(MODEL_FILE, line) for line in stored if line not in gone]
    moved = [
        Checked(MODEL_FILE, line, BETWEEN, np.inf, 0.0, "", problem=problem)
        for lines, problem in ((gone, "no longer so"), (new, "new"))
        for line in lines.elements()
    ]
    return same + moved


def check(figures: Iterable[StoredFigure], found: list[StoredFigure] | str) -> list[Checked]:
    """A group's figures against what was measured, or against why nothing was."""
    if isinstance(found, str):
        return [_missing(figure, found) for figure in figures]
    now = {figure.name: figure for figure in found}
    return [
        _check(figure, now[figure.name]) if figure.name in now else _missing(figure, "no longer measured")
        for figure in figures
    ]


def _same(group: str, name: str) -> Checked:
    """Of what holds no number."""
    return Checked(group, name, BETWEEN, 0.0, 0.0, "", was=0.0, now=0.0)


def _missing(figure: StoredFigure, problem: str) -> Checked:
    return Checked(figure.group, figure.name, BETWEEN, np.inf, 0.0, "", unit=figure.unit, problem=problem)


def _check(stored: StoredFigure, now: StoredFigure) -> Checked:
    if (stored.rows, stored.columns) != (now.rows, now.columns):
        return _missing(stored, "is of other bodies, joints or times")
    if stored.array.size == 0:
        return _same(stored.group, stored.name)
    row, column = np.unravel_index(int(np.argmax(_tolerances(stored, now))), stored.array.shape)
    was, found = float(stored.array[row, column]), float(now.array[row, column])
    return Checked(
        stored.group,
        stored.name,
        BETWEEN,
        abs(found - was),
        stored.tolerance[row],
        ", ".join(filter(None, (stored.rows[row], stored.columns[column]))),
        unit=stored.unit,
        was=was,
        now=found,
    )


def _tolerances(stored: StoredFigure, now: StoredFigure) -> Array:
    """(rows, columns): by how many tolerances each number moved; infinite for what is not finite."""
    difference = np.abs(now.array - stored.array)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(difference == 0.0, 0.0, difference / np.array(stored.tolerance)[:, None])
    return np.where(np.isfinite(now.array), ratio, np.inf)


def divergence(figures: Iterable[StoredFigure], found: Iterable[StoredFigure], times: Array) -> float | None:
    """s: the first output time at which a figure over time is out of its tolerance."""
    now = {figure.name: figure for figure in found if figure.over_time}
    first = [
        int(np.argmax(out))
        for figure in figures
        if figure.name in now
        and len(figure.rows) == len(times)
        and (out := (_tolerances(figure, now[figure.name]) > 1.0).any(axis=1)).any()
    ]
    return float(times[min(first)]) if first else None
