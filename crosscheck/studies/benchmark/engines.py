"""The engines of a benchmark, and the whole of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from crosscheck.errors import CrosscheckError
from crosscheck.scenes.options import titled
from crosscheck.studies.benchmark.reference import Reference, reference
from crosscheck.studies.benchmark.work_precision import Measured, Models, Progress, machine, measure
from newton_euler.model.scene import Scene


def _newton_euler(scene: Scene) -> Models:
    from crosscheck.studies.benchmark.newton_euler import models

    return models(scene)


def _mujoco(scene: Scene) -> Models:
    from crosscheck.studies.benchmark.mujoco import models

    return models(scene)


def _pinocchio(scene: Scene) -> Models:
    from crosscheck.studies.benchmark.pinocchio import models

    return models(scene)


ENGINES: dict[str, Callable[[Scene], Models]] = {
    "newton_euler": _newton_euler,
    "mujoco": _mujoco,
    "pinocchio": _pinocchio,
}

JUDGED = "newton_euler"
"""The engine that the others are compared with."""


@dataclass(frozen=True, eq=False)
class Benchmark:
    """What a benchmark found.

    Attributes:
        source: the name or the file that the scene was loaded from.
        options: of the scene, as they were set.
        scene: what was run.
        machine: what it ran on, see `crosscheck.studies.benchmark.machine`.
        reference: what errors are taken against.
        measured: all settings.
    """

    source: str
    options: Mapping[str, str]
    scene: Scene
    machine: dict[str, Any]
    reference: Reference
    measured: Measured

    @property
    def title(self) -> str:
        return titled(self.scene.name, self.options)


def poses_only(scene: Scene) -> Scene:
    """A scene that asks for nothing but the poses of its bodies.

    Raises:
        CrosscheckError: for a scene with a sampled controller, whose Python all engines would wait for.
    """
    if scene.sampled:
        raise CrosscheckError(
            f"scene {scene.name!r} has a sampled controller; bench needs native control laws"
        )
    return dataclasses.replace(scene, outputs=frozenset())


def benchmark(
    scene: Scene, source: str, options: Mapping[str, str], repeats: int, progress: Progress
) -> Benchmark:
    """Run every engine and setting over a scene; `progress` is told each stage.

    Raises:
        CrosscheckError: for a scene that cannot be benchmarked.
    """
    scene = poses_only(scene)
    where = machine()
    motion = reference(scene, progress)
    models = {name: engine(scene) for name, engine in ENGINES.items()}
    return Benchmark(source, options, scene, where, motion, measure(models, motion.poses, repeats, progress))
