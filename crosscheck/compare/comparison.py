"""Result of a comparison: what a comparison of engines and a comparison of two models have in common.

A comparison simulates one scene (a mechanism with its forces, inputs and initial state) in several engines
(`crosscheck.compare.result`), or two models in one engine (`crosscheck.compare.two_models`). It makes checks:
values with tolerances, grouped in levels. `crosscheck.report` makes tables and pages of results.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

from crosscheck.compare.check import Check
from crosscheck.compare.outcome import Outcome
from crosscheck.compare.runs import nothing_moves_in_rigid_runs
from crosscheck.engines.engine import Engine
from crosscheck.engines.engine_runs import Stop
from crosscheck.support.versions import versions
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.reading.import_report import ImportReport


class ModelFile(NamedTuple):
    """A model file that was compared.

    Attributes:
        title: "the file", or "the file of NAME" if two models were compared.
        label: name of the model and a colon, if two models were compared; else empty.
        scene: scene that was imported from the file.
        mapping: import report: how each element of the file was imported.
    """

    title: str
    label: str
    scene: Scene
    mapping: ImportReport


@dataclass(frozen=True, eq=False, kw_only=True)
class ComparisonResult(ABC):
    """Result of a comparison of engines or of two models; then models take the place of engines.

    Attributes:
        source: name or file that the scene was loaded from; empty if it was made in Python.
        options: options of the scene or file that the user set.
        scene: scene that was simulated.
        engines: engines that were compared, in the requested order.
        trajectories: run of each engine; partial if the engine stopped, missing if it has no run at all.
        checks: all checks, except those against reference values.
        wall_time: total wall time, s.
        unfinished: engines that stopped, and parts of the comparison that did not complete.
        notes: one line for each additional analysis that did not complete.
    """

    source: str
    options: Mapping[str, str]
    scene: Scene
    engines: tuple[Engine, ...]
    trajectories: dict[str, Trajectory]
    checks: tuple[Check, ...]
    wall_time: float
    unfinished: tuple[Stop, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    @abstractmethod
    def title(self) -> str:
        """Name of what was compared, with the options that the user set."""

    @property
    @abstractmethod
    def files(self) -> tuple[ModelFile, ...]:
        """Model files that were compared; empty for scenes of the library or of Python."""

    @property
    @abstractmethod
    def outcome(self) -> Outcome:
        """Outcome of the comparison; if several apply, the most severe one."""

    @property
    @abstractmethod
    def verdict(self) -> str:
        """Verdict in one line."""

    @property
    def agrees(self) -> bool:
        """True if the comparison was completed, found no difference, and covers all elements that act."""
        return self.outcome in (Outcome.AGREE, Outcome.SAME)

    @property
    def differs(self) -> bool:
        """True if any check exceeds its tolerance."""
        return not all(check.agrees for check in self.checks)

    @property
    def judged(self) -> tuple[Check, ...]:
        """Checks that decide the outcome; the verdict states their number."""
        return tuple(check for check in self.checks if check.judged)

    @property
    def nothing_moves(self) -> bool:
        """True if nothing moves in the runs, so that checks of runs test nothing."""
        return nothing_moves_in_rigid_runs(self.scene, self.engines, self.trajectories)

    def summary(self) -> dict[str, Any]:
        """All checks, versions, settings and wall times, for JSON."""
        packages = sorted({"numpy", "scipy", "rerun-sdk", *(engine.package for engine in self.engines)})
        return {
            "scene": self.scene.name,
            "source": self.source,
            "options": dict(self.options),
            "agrees": self.agrees,
            "outcome": self.outcome.value,
            "verdict": self.verdict,
            "wall_time": self.wall_time,
            "versions": versions(packages),
            "unfinished": [asdict(stop) for stop in self.unfinished],
            "engines": {engine.name: self._run_summary(engine.name) for engine in self.engines},
            "checks": [asdict(check) | {"agrees": check.agrees} for check in self.checks],
            "notes": list(self.notes),
        }

    def _run_summary(self, name: str) -> dict[str, Any]:
        """Return settings and wall time of an engine's run, for JSON."""
        run = self.trajectories.get(name)
        return {"settings": run.settings if run else {}, "wall_time": run.wall_time if run else None}
