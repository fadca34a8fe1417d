"""Compare a scene's figures with its baseline: what moved, by how many tolerances, and from when on.

A cost (operations, steps, evaluations) moves only if it grows. A cost that falls by more than its tolerance
is an improvement.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from crosscheck.compare.activity import acted, watched_in_own_run, what_acted
from crosscheck.compare.check import Check
from crosscheck.regress.baseline import Baseline, Record, StoredFigure
from crosscheck.regress.measure import MAIN, measure_group, regress_scene
from crosscheck.report.outcome import Outcome
from crosscheck.support.versions import versions
from newton_euler.model.scene import Scene
from newton_euler.reading.import_report import ImportedElement, ImportReport
from newton_euler.scalars import Array

MODEL_FILE = "model file"
"""Name that stands for a group: contents of a model file that a scene does not have."""

BETWEEN = ("baseline", "now")


@dataclass(frozen=True)
class Checked(Check):
    """One stored figure against what it is now, where it moved most.

    Its level is the group of figures, its value the difference; infinite where there is nothing to compare.

    Attributes:
        unit: of the quantity.
        was, now: SI; None where there is nothing to compare.
        problem: why it could not be compared.
        is_cost: whether the number counts operations, steps or evaluations.
    """

    unit: str = ""
    was: float | None = None
    now: float | None = None
    problem: str = ""
    is_cost: bool = False

    @property
    def cheaper(self) -> bool:
        """True for a cost that fell by more than its tolerance."""
        if not self.is_cost or self.was is None or self.now is None:
            return False
        return math.isfinite(self.now) and self.now < self.was - self.tolerance

    @property
    def moved(self) -> bool:
        return not (self.agrees or self.cheaper)


@dataclass(frozen=True)
class Comparison:
    """A scene against its baseline.

    Attributes:
        scene: its name.
        checked: what of a model file is in no figure, then all figures in the baseline's order.
        made: when, why and with which versions the baseline was made.
        now: versions of this run.
        acting: elements of a model file that acted and were not simulated as the file has them.
        diverges: s, first output time at which a pose is out of its tolerance; None if none is.
        wall_time: s.
    """

    scene: str
    checked: tuple[Checked, ...]
    made: Record
    now: dict[str, str]
    diverges: float | None
    wall_time: float
    acting: tuple[ImportedElement, ...] = ()

    @property
    def outcome(self) -> Outcome:
        """The outcome of the comparison."""
        if self.moved:
            return Outcome.MOVED
        return Outcome.QUIET_ON_A_REDUCED_MODEL if self.acting else Outcome.QUIET

    @property
    def moved(self) -> list[Checked]:
        return [figure for figure in self.checked if figure.moved]

    @property
    def cheaper(self) -> list[Checked]:
        """Costs that fell by more than their tolerance."""
        return [figure for figure in self.checked if figure.cheaper]

    @property
    def changed_versions(self) -> list[str]:
        """Such as "numpy 2.1.0 -> 2.2.0"."""
        names = dict.fromkeys([*self.made.versions, *self.now])
        pairs = ((name, self.made.versions.get(name, "none"), self.now.get(name, "none")) for name in names)
        return [f"{name} {was} -> {now}" for name, was, now in pairs if was != now]

    @property
    def verdict(self) -> str:
        """One line."""
        made = f"the baseline of {self.made.date}"
        if not self.moved:
            left_out = "".join(f"; not simulated: {acted(entry)}" for entry in self.acting)
            if self.cheaper:
                count = f"{len(self.cheaper)} of {len(self.checked)} figures"
                return f"{self.scene}: quiet: nothing moved since {made}; {count} are cheaper{left_out}"
            return f"{self.scene}: quiet: all {len(self.checked)} figures are as in {made}{left_out}"
        made += f" ({self.made.reason})"
        since = ", ".join(self.changed_versions) or "no version changed"
        when = "" if self.diverges is None else f"; poses part at {self.diverges:.6g} s"
        moved = f"{len(self.moved)} of {len(self.checked)} figures"
        cheaper = f"; {len(self.cheaper)} cheaper" if self.cheaper else ""
        return f"{self.scene}: MOVED: {moved} since {made}: {since}{when}{cheaper}"

    def summary(self) -> dict[str, Any]:
        """Result of the comparison, for JSON."""
        return {
            "scene": self.scene,
            "quiet": not self.moved,
            "outcome": self.outcome.value,
            "not_simulated": [asdict(entry) for entry in self.acting],
            "verdict": self.verdict,
            "baseline": self.made.model_dump(),
            "versions": self.now,
            "diverges": self.diverges,
            "wall_time": self.wall_time,
            "figures": [
                asdict(figure) | {"moved": figure.moved, "cheaper": figure.cheaper} for figure in self.checked
            ],
        }


def compare(
    scene: Scene, baseline: Baseline, progress: Callable[[str], None], mapping: ImportReport | None = None
) -> Comparison:
    """Measure a scene's figures as its baseline says and compare them.

    Args:
        scene: as loaded.
        progress: is told each stage.
        mapping: what became of the elements of a model file; None for a scene of this package's own.
    """
    start = time.perf_counter()
    measured = regress_scene(scene)
    watched = watched_in_own_run(scene, mapping) if mapping else None
    checked = check_unsimulated(baseline.unsimulated or [], unsimulated(mapping, watched) or [])
    diverges = None
    for group in baseline.groups:
        progress(f"{scene.name}: {group}")
        found = measure_group(group, measured, baseline.plan)
        figures = [figure for figure in baseline.figures if figure.group == group]
        checked.extend(check(figures, found))
        if group == MAIN and not isinstance(found, str):
            diverges = divergence(figures, found, measured.times)
    wall_time = time.perf_counter() - start
    acting = tuple(watched.acting) if watched else ()
    return Comparison(scene.name, tuple(checked), baseline.made, versions(), diverges, wall_time, acting)


def unsimulated(mapping: ImportReport | None, watched: ImportReport | None) -> list[str] | None:
    """Lines on what of a model file is in no figure and can move something, and which of it acts.

    Args:
        mapping: what became of the elements of the file; None for a scene of this package's own.
        watched: the same with what a run shows.
    """
    if mapping is None or watched is None:
        return None
    lines = [str(entry) for entry in mapping.entries if entry.fate != "exactly" and not entry.inert]
    return lines + [f"acts, and is not simulated: {what_acted(entry)}" for entry in watched.acting]


def check_unsimulated(stored: Sequence[str], found: Sequence[str]) -> list[Checked]:
    """Lines on what of a model file is in no figure, against those of the baseline."""
    gone, new = Counter(stored) - Counter(found), Counter(found) - Counter(stored)
    same = [Checked(MODEL_FILE, line, BETWEEN, 0.0, 0.0, "") for line in stored if line not in gone]
    return same + [
        Checked(MODEL_FILE, line, BETWEEN, np.inf, 0.0, "", problem=problem)
        for lines, problem in ((gone, "no longer so"), (new, "new"))
        for line in lines.elements()
    ]


def check(figures: Iterable[StoredFigure], found: list[StoredFigure] | str) -> list[Checked]:
    """A group's figures against what was measured, or against why nothing was."""
    now = {} if isinstance(found, str) else {figure.name: figure for figure in found}
    problem = found if isinstance(found, str) else "no longer measured"
    return [_check(figure, now.get(figure.name), problem) for figure in figures]


def _check(stored: StoredFigure, now: StoredFigure | None, problem: str) -> Checked:
    checked = partial(Checked, stored.group, stored.name, BETWEEN, unit=stored.unit, is_cost=stored.is_cost)
    if now is not None and (stored.rows, stored.columns) != (now.rows, now.columns):
        now, problem = None, "is of other bodies, joints or times"
    if now is None:
        return checked(value=np.inf, tolerance=0.0, where="", problem=problem)
    if stored.array.size == 0:
        return checked(value=0.0, tolerance=0.0, where="")
    row, column = np.unravel_index(int(np.argmax(_tolerances(stored, now))), stored.array.shape)
    was, found = float(stored.array[row, column]), float(now.array[row, column])
    where = ", ".join(filter(None, (stored.rows[row], stored.columns[column])))
    return checked(value=abs(found - was), tolerance=stored.tolerance[row], where=where, was=was, now=found)


def _tolerances(stored: StoredFigure, now: StoredFigure) -> Array:
    """(rows, columns): by how many tolerances each number moved; infinite for what is not finite."""
    difference = np.abs(now.array - stored.array)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(difference == 0.0, 0.0, difference / np.array(stored.tolerance)[:, None])
    return np.where(np.isfinite(now.array), ratio, np.inf)


def divergence(figures: Iterable[StoredFigure], found: Iterable[StoredFigure], times: Array) -> float | None:
    """s: the first output time at which a figure over time is out of its tolerance."""
    now = {figure.name: figure for figure in found if figure.over_time}
    out = np.zeros(len(times), dtype=bool)
    for figure in figures:
        if figure.name in now and len(figure.rows) == len(times):
            out |= (_tolerances(figure, now[figure.name]) > 1.0).any(axis=1)
    return float(times[np.argmax(out)]) if out.any() else None
