"""Measurements that advice is made from: the runs of a crosscheck and their errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from crosscheck.comparison.levels import Figure
from crosscheck.engines import Engine
from newton_euler.errors import NewtonEulerError
from newton_euler.model.euler_parameters import angle_between
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.verification.import_report import ImportReport

WANTED = 1e-6
"""m and rad, the error that advice is for."""


@dataclass(frozen=True)
class Advice:
    """One piece of advice.

    Attributes:
        topic: "model", "mujoco", "softness", "baumgarte", "redundancy" or "cost".
        text: a sentence or two with the numbers that it is made of.
    """

    topic: str
    text: str

    def __str__(self) -> str:
        return f"{self.topic}: {self.text}"


@dataclass(frozen=True, eq=False)
class Found:
    """Runs and figures of a crosscheck.

    Attributes:
        scene: what was run.
        source: the name or the file that it was loaded from.
        engines: that ran.
        runs: by engine.
        rows: the compared figures.
        mapping: what became of the elements of a model file; None for a scene of this package's own.
    """

    scene: Scene
    source: str
    engines: Sequence[Engine]
    runs: Mapping[str, Trajectory]
    rows: Sequence[Figure]
    mapping: ImportReport | None = None

    def engine(self, name: str) -> Engine:
        return next(engine for engine in self.engines if engine.name == name)

    def wall_time(self, name: str) -> float:
        """s, of an engine's run."""
        return self.runs[name].wall_time

    @cached_property
    def errors(self) -> dict[str, float]:
        """For each engine how far its run is off, m and rad; empty for a run of one engine.

        How far from the nearest other run, or for newton_euler from a finer run of its own, which costs
        little: what it is off at most, unless both err alike.
        """
        if len(self.runs) < 2:
            return {}
        errors = {}
        for name, run in self.runs.items():
            others = [other for key, other in self.runs.items() if key != name]
            if name == "newton_euler":
                with suppress(NewtonEulerError):
                    others.append(self.engine(name).refined(self.scene))
            errors[name] = min(distance(run, other) for other in others)
        return errors

    @property
    def models_agree(self) -> bool:
        """True if all that was compared of the engines before their runs agrees."""
        runs = ("trajectories", "drift", "energy")
        before = [row for row in self.rows if not row.level.startswith(runs)]
        return bool(before) and all(row.agrees for row in before)


def distance(one: Trajectory, two: Trajectory, at: int | slice = slice(None)) -> float:
    """The largest difference of positions, m, and orientations, rad, of two runs at all or some outputs."""
    angles = angle_between(one.quaternion[at], two.quaternion[at])
    return float(max(np.max(np.linalg.norm(one.position[at] - two.position[at], axis=-1)), np.max(angles)))
