"""Compare a scene with its baseline: which stored quantities changed, by how much, and from which time on.

A baseline is a JSON file with measured quantities of a scene and their tolerances. `compare` measures all
quantities of a baseline again and makes one check for each. A check fails if the quantity changed by more
than its stored tolerance; the quantity then "moved", and a scene without such quantities is "quiet".

The groups of engines that are not installed are not measured, and have no checks.

Two kinds of quantities fail only if they grow: costs (counts of operations, steps and evaluations), and the
errors of the run that a model file's engine makes with the settings of the file. If one of them falls by more
than its tolerance, the check is an improvement.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Any

import numpy as np

from crosscheck.compare.activity import acted, watched_in_new_run, what_acted
from crosscheck.compare.check import Check
from crosscheck.compare.outcome import Outcome
from crosscheck.engines.engine import Engine
from crosscheck.engines.registry import EngineError, choose, names
from crosscheck.engines.versions import versions
from crosscheck.regress.baseline import Baseline, StoredQuantity, UpdateRecord
from crosscheck.regress.measure import measure_group
from crosscheck.regress.plan import MAIN_FORMULATION, regress_scene
from crosscheck.support.name_lists import first_names
from newton_euler.model.scene import Scene
from newton_euler.reading.import_report import ImportedElement, ImportReport
from newton_euler.scalars import Array

MODEL_FILE = "model file"
"""Level (group of checks) of the elements of a model file that are not simulated; other levels are names of
groups of quantities."""

LABELED_BY = {"mass": "bodies", "joint point": "joints", "position over time": "output times"}
"""Quantities whose rows are all bodies, joints or output times of a scene, with the kind of the rows."""

MAX_LABELS = 5
"""Largest number of bodies, joints or times that one check names."""

ACTS = "acts, and is not simulated"
"""Beginning of the line of an element that acts, in the list of elements that are not simulated."""

BETWEEN = ("baseline", "now")
"""Names of the two compared results in each check: the stored and the present one."""


@dataclass(frozen=True)
class BaselineCheck(Check):
    """Check of one stored quantity against its present value, at the number that changed most.

    Of the inherited attributes, `level` is the group of the quantity, `value` the absolute change, and
    `agrees` is True if the change is within `tolerance`. The value is infinite if the quantity cannot be
    compared.

    Attributes:
        unit: unit of the quantity.
        was, now: stored and present number, in `unit`; None if there are no numbers to compare.
        problem: why the quantity cannot be compared; empty if it can.
        is_cost: whether the quantity counts operations, steps or evaluations.
        is_error: whether the quantity is an error of the run with the settings of the model file.
        reason: where the tolerance comes from; empty for round-off and integration errors.
    """

    unit: str = ""
    was: float | None = None
    now: float | None = None
    problem: str = ""
    is_cost: bool = False
    is_error: bool = False
    reason: str = ""

    @property
    def fell(self) -> bool:
        """True for a quantity that fell by more than its tolerance."""
        if self.was is None or self.now is None:
            return False
        return math.isfinite(self.now) and self.now < self.was - self.tolerance

    @property
    def cheaper(self) -> bool:
        """True for a cost that fell by more than its tolerance."""
        return self.is_cost and self.fell

    @property
    def more_accurate(self) -> bool:
        """True for an error of the run with the file's settings that fell by more than its tolerance."""
        return self.is_error and self.fell

    @property
    def moved(self) -> bool:
        """True if the check fails: the change exceeds the tolerance and is no improvement."""
        return not (self.agrees or self.cheaper or self.more_accurate)


@dataclass(frozen=True)
class Comparison:
    """Result of the comparison of one scene with its baseline.

    Attributes:
        scene: name of the scene.
        checks: checks of the elements of the model file that are not simulated, then those of all quantities,
            in the order of the baseline.
        last_update: date, reason and versions of the baseline's last update.
        versions: installed versions of Python and of the packages, by name.
        diverges: s, first output time at which the pose of a body is out of its tolerance; None if all poses
            are within their tolerances.
        wall_time: s, duration of the comparison.
        acting: elements of the model file that act during the run and are not simulated.
        not_measured: reasons by name of the engines of the baseline that cannot be used.
    """

    scene: str
    checks: tuple[BaselineCheck, ...]
    last_update: UpdateRecord
    versions: dict[str, str]
    diverges: float | None
    wall_time: float
    acting: tuple[ImportedElement, ...] = ()
    not_measured: Mapping[str, str] = field(default_factory=dict)

    @property
    def outcome(self) -> Outcome:
        """Outcome of the comparison; if several apply, the most severe one."""
        if self.moved:
            return Outcome.MOVED
        if self.not_measured:
            return Outcome.QUIET_OF_SOME_ENGINES
        return Outcome.QUIET_ON_A_REDUCED_MODEL if self.acting else Outcome.QUIET

    @property
    def moved(self) -> list[BaselineCheck]:
        """Checks that fail."""
        return [check for check in self.checks if check.moved]

    @property
    def cheaper(self) -> list[BaselineCheck]:
        """Checks of costs that fell by more than their tolerance."""
        return [check for check in self.checks if check.cheaper]

    @property
    def more_accurate(self) -> list[BaselineCheck]:
        """Checks of errors of the run with the file's settings that fell by more than their tolerance."""
        return [check for check in self.checks if check.more_accurate]

    @property
    def _improvements(self) -> str:
        """Numbers of checks that are cheaper or more accurate, as text; empty if there are none."""
        kinds = (("cheaper", self.cheaper), ("more accurate", self.more_accurate))
        return "".join(f"; {len(checks)} {word}" for word, checks in kinds if checks)

    @property
    def changed_versions(self) -> dict[str, tuple[str, str]]:
        """Packages whose version changed since the last update: the versions before and now, by name."""
        stored = self.last_update.versions
        names = dict.fromkeys([*stored, *self.versions])
        pairs = {name: (stored.get(name, "none"), self.versions.get(name, "none")) for name in names}
        return {name: (was, now) for name, (was, now) in pairs.items() if was != now}

    @property
    def verdict(self) -> str:
        """One line: the outcome and the number of checks; if it moved, versions and time of divergence."""
        baseline = f"the baseline of {self.last_update.date}"
        count = len(self.checks)
        not_measured = "".join(f"; not measured: {reason}" for reason in self.not_measured.values())
        if not self.moved:
            left_out = "".join(f"; not simulated: {acted(entry)}" for entry in self.acting) + not_measured
            if better := self._improvements:
                return (
                    f"{self.scene}: quiet: none of {count} checks fails against {baseline}{better}{left_out}"
                )
            return f"{self.scene}: quiet: all {count} checks match {baseline}{left_out}"
        versions = [f"{name} {was} -> {now}" for name, (was, now) in self.changed_versions.items()]
        since = ", ".join(versions) or "no package version changed"
        when = "" if self.diverges is None else f"; poses differ from {self.diverges:.6g} s on"
        moved = f"{len(self.moved)} of {count} checks fail against {baseline} ({self.last_update.reason})"
        settings = ""
        if any(check.is_error for check in self.moved):
            settings = "; the run with your settings has a larger error: crosscheck run names cause and fix"
        return f"{self.scene}: MOVED: {moved}: {since}{when}{settings}{self._improvements}{not_measured}"

    def summary(self) -> dict[str, Any]:
        """Return the result of the comparison as an entry of `scenes` in regress.json."""
        return {
            "scene": self.scene,
            "quiet": not self.moved,
            "outcome": self.outcome.value,
            "not_simulated": [asdict(entry) for entry in self.acting],
            "not_measured": dict(self.not_measured),
            "verdict": self.verdict,
            "baseline": self.last_update.model_dump(),
            "versions": self.versions,
            "diverges": self.diverges,
            "wall_time": self.wall_time,
            "checks": [
                asdict(check)
                | {"moved": check.moved, "cheaper": check.cheaper, "more_accurate": check.more_accurate}
                for check in self.checks
            ],
        }


def compare(
    scene: Scene,
    baseline: Baseline,
    progress: Callable[[str], None],
    import_report: ImportReport | None = None,
) -> Comparison:
    """Measure the quantities of a baseline again and compare them.

    Args:
        scene: the scene as it was loaded.
        baseline: stored quantities, and the settings with which to measure them.
        progress: function that receives the name of the scene and of each group before its measurement.
        import_report: how each element of the model file was imported; None for a scene that was not
            read from a model file.
    """
    start = time.perf_counter()
    measured_scene = regress_scene(scene)  # with the outputs that the quantities need
    # the import report after a run of newton_euler, which shows the elements that act and are not simulated
    watched = watched_in_new_run(scene, import_report) if import_report else None
    checks = check_unsimulated(baseline.unsimulated or [], unsimulated(import_report, watched) or [])
    diverges = None
    simulation = import_report.simulation if import_report else None  # the model file in its own engine
    engines, not_measured = _engines_of(baseline)
    reported = set[str]()  # bodies, joints and times that only the baseline or only the model has
    for group in baseline.groups:
        if group in not_measured:
            continue
        progress(f"{scene.name}: {group}")
        measured = measure_group(group, measured_scene, baseline.plan, simulation)
        stored = [quantity for quantity in baseline.quantities if quantity.group == group]
        for check, labels in check_labels(stored, [] if isinstance(measured, str) else measured):
            checks.append(check)
            reported |= labels
        if isinstance(measured, str) and reported:  # the states of the baseline do not fit the model
            measured = "not compared, as bodies or joints differ"
        checks.extend(check_group(stored, measured, reported))
        if group == MAIN_FORMULATION and not isinstance(measured, str):  # the group with poses over time
            diverges = divergence_time(stored, measured, measured_scene.times)
    return Comparison(
        scene=scene.name,
        checks=tuple(checks),
        last_update=baseline.last_update,
        versions=versions(engines),
        diverges=diverges,
        wall_time=time.perf_counter() - start,
        acting=tuple(watched.acting) if watched else (),
        not_measured={name: why for name, why in not_measured.items() if name in baseline.groups},
    )


def _engines_of(baseline: Baseline) -> tuple[list[Engine], dict[str, str]]:
    """Return the engines of a baseline, and by name the reason why each of the others cannot be used."""
    found, reasons = list[Engine](), dict[str, str]()
    for name in baseline.engines:
        if name not in names():
            reasons[name] = f"engine {name!r} is not installed"
            continue
        try:
            found += choose([name])
        except EngineError as error:
            reasons[name] = str(error)
    return found, reasons


def unsimulated(import_report: ImportReport | None, watched: ImportReport | None) -> list[str] | None:
    """List the elements of a model file that can move bodies and are not simulated exactly, one line each.

    Args:
        import_report: how each element of the file was imported; None without a model file.
        watched: the same report after a run, which shows which of the elements act.

    Returns:
        A line for each element that is not imported exactly, then a line for each element that acts; None
        without a model file.
    """
    if import_report is None or watched is None:
        return None
    lines = [
        str(entry) for entry in import_report.entries if entry.fate != "exactly" and not entry.moves_nothing
    ]
    return lines + [f"{ACTS}: {what_acted(entry)}" for entry in watched.acting]


def check_unsimulated(stored: Sequence[str], present: Sequence[str]) -> list[BaselineCheck]:
    """Check that the elements that are not simulated are the same as in the baseline: one check per line.

    Args:
        stored: lines of `unsimulated` in the baseline.
        present: lines of `unsimulated` of the present model file.
    """
    make_check = partial(BaselineCheck, MODEL_FILE, between=BETWEEN, tolerance=0.0, where="")
    gone, new = Counter(stored) - Counter(present), Counter(present) - Counter(stored)
    same = [make_check(quantity=line, value=0.0) for line in stored if line not in gone]
    return same + [
        make_check(quantity=line, value=np.inf, problem=problem)
        for lines, problem in ((gone, "no longer so"), (new, "new"))
        for line in lines.elements()
    ]


def check_labels(
    stored: Iterable[StoredQuantity], present: Iterable[StoredQuantity]
) -> Iterator[tuple[BaselineCheck, set[str]]]:
    """Check that the bodies, joints and output times are those of the baseline.

    Args:
        stored: quantities of the baseline.
        present: present quantities of the same group.

    Yields:
        A failed check for each kind of labels that changed, and the labels that only one side has.
    """
    now = {quantity.name: quantity for quantity in present}
    for quantity in stored:
        if quantity.name not in LABELED_BY or quantity.name not in now:
            continue
        before, after = dict.fromkeys(quantity.rows), dict.fromkeys(now[quantity.name].rows)
        gone = [label for label in before if label not in after]
        new = [label for label in after if label not in before]
        sides = (("only in the baseline", gone), ("only in the model", new))
        if problem := "; ".join(
            f"{side}: {first_names(labels, MAX_LABELS)}" for side, labels in sides if labels
        ):
            yield (
                BaselineCheck(
                    level=quantity.group,
                    quantity=LABELED_BY[quantity.name],
                    between=BETWEEN,
                    value=np.inf,
                    tolerance=0.0,
                    where="",
                    problem=problem,
                ),
                {*gone, *new},
            )


def check_group(
    stored: Iterable[StoredQuantity], present: list[StoredQuantity] | str, reported: Collection[str] = ()
) -> list[BaselineCheck]:
    """Check all quantities of a group.

    Args:
        stored: quantities of the baseline.
        present: present quantities, or the error message of the measurement.
        reported: bodies, joints and times that only one side has, and that `check_labels` reports.
    """
    now = {} if isinstance(present, str) else {quantity.name: quantity for quantity in present}
    problem = present if isinstance(present, str) else "no longer measured"
    return [_check(quantity, now.get(quantity.name), problem, reported) for quantity in stored]


def _check(
    stored: StoredQuantity, now: StoredQuantity | None, problem: str, reported: Collection[str]
) -> BaselineCheck:
    """Check one quantity at the number whose change is the largest multiple of its tolerance.

    Args:
        stored: quantity of the baseline.
        now: present quantity; None if it could not be measured.
        problem: why it could not be measured.
        reported: as of `check_group`. Without these labels, both tables must have the same labels.
    """
    make_check = partial(
        BaselineCheck,
        level=stored.group,
        quantity=stored.name,
        between=BETWEEN,
        unit=stored.unit,
        is_cost=stored.is_cost,
        is_error=stored.is_error,
        reason=stored.reason,
    )
    if now is not None and reported:
        stored, now = _without(stored, reported), _without(now, reported)
    if now is not None and (stored.rows, stored.columns) != (now.rows, now.columns):
        now, problem = None, "has other coordinates or components than the baseline"
    if now is None:
        return make_check(value=np.inf, tolerance=0.0, where="", problem=problem)
    if stored.array.size == 0:
        return make_check(value=0.0, tolerance=0.0, where="")
    row, column = np.unravel_index(int(np.argmax(_change_ratios(stored, now))), stored.array.shape)
    old, new = float(stored.array[row, column]), float(now.array[row, column])
    where = ", ".join(filter(None, (stored.rows[row], stored.columns[column])))
    return make_check(value=abs(new - old), tolerance=stored.tolerance[row], where=where, was=old, now=new)


def _without(quantity: StoredQuantity, labels: Collection[str]) -> StoredQuantity:
    """Return a quantity without the rows and columns of some bodies, joints and times.

    A column may be a component of a body's pose, such as "rod x".
    """
    rows = [k for k, label in enumerate(quantity.rows) if label not in labels]
    columns = [
        k
        for k, label in enumerate(quantity.columns)
        if label not in labels and label.rpartition(" ")[0] not in labels
    ]
    return quantity.model_copy(
        update={
            "rows": [quantity.rows[k] for k in rows],
            "columns": [quantity.columns[k] for k in columns],
            "value": [[quantity.value[row][column] for column in columns] for row in rows],
            "tolerance": [quantity.tolerance[row] for row in rows],
        }
    )


def _change_ratios(stored: StoredQuantity, now: StoredQuantity) -> Array:
    """Return the change of each number divided by its tolerance, (rows, columns).

    The ratio is infinite if the present number is not finite.
    """
    difference = np.abs(now.array - stored.array)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(difference == 0.0, 0.0, difference / np.array(stored.tolerance)[:, None])
    return np.where(np.isfinite(now.array), ratio, np.inf)


def divergence_time(
    stored: Iterable[StoredQuantity], present: Iterable[StoredQuantity], times: Array
) -> float | None:
    """Return the first output time, s, at which a quantity over time (a pose) is out of its tolerance.

    Args:
        stored, present: quantities of the baseline, and present quantities.
        times: (n,) s, output times; the rows of quantities over time.

    Returns:
        The time; None if all quantities stay within their tolerances.
    """
    now = {quantity.name: quantity for quantity in present if quantity.over_time}
    is_out = np.zeros(len(times), dtype=bool)
    for quantity in stored:
        if quantity.name in now and len(quantity.rows) == len(times):
            is_out |= (_change_ratios(quantity, now[quantity.name]) > 1.0).any(axis=1)
    return float(times[np.argmax(is_out)]) if is_out.any() else None
