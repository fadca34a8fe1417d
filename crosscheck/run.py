"""One crosscheck: a scene through several engines, compared, written to a folder."""

from __future__ import annotations

import json
import platform
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from crosscheck.compare import Row, compare
from crosscheck.engines import Engine
from crosscheck.errors import CrosscheckError
from newton_euler.scene import Scene
from newton_euler.trajectory import Trajectory, atomic_file

RANDOM_STATES = 20
"""Random consistent states at which the engines' equations are compared in a run."""

Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Crosscheck:
    """What a crosscheck found: the runs by engine, and the compared figures."""

    scene: Scene
    engines: tuple[Engine, ...]
    runs: dict[str, Trajectory]
    rows: tuple[Row, ...]
    wall_time: float

    @property
    def agrees(self) -> bool:
        return all(row.agrees for row in self.rows)

    @property
    def verdict(self) -> str:
        """One line: whether they agree, or the first level that does not, and where."""
        names = ", ".join(engine.name for engine in self.engines)
        if self.agrees:
            return f"AGREE: {names} agree on {self.scene.name} in all {len(self.rows)} figures"
        row = next(row for row in self.rows if not row.agrees)
        failed = sum(not row.agrees for row in self.rows)
        return (
            f"DISAGREE: {' and '.join(row.between)} part at level '{row.level}': {row.quantity}: "
            f"{row.value:.3g} > {row.tolerance:.3g}, worst at {row.where} "
            f"({failed} of {len(self.rows)} figures fail)"
        )

    def summary(self) -> dict[str, Any]:
        """All figures, versions, settings and wall times, for JSON."""
        packages = ["numpy", "scipy", "mujoco", "pin", "rerun-sdk"]
        return {
            "scene": self.scene.name,
            "agrees": self.agrees,
            "verdict": self.verdict,
            "wall_time": self.wall_time,
            "versions": {"python": platform.python_version()} | {p: version(p) for p in packages},
            "engines": {
                name: {"settings": run.settings, "wall_time": run.wall_time}
                for name, run in self.runs.items()
            },
            "figures": [asdict(row) | {"agrees": row.agrees} for row in self.rows],
        }


def crosscheck(scene: Scene, engines: Sequence[Engine], progress: Progress) -> Crosscheck:
    """Run a scene through the engines and compare them; `progress` is told each stage."""
    if not all(output in scene.outputs for output in ("velocities", "reactions", "violation")):
        raise CrosscheckError(f"scene {scene.name!r} must ask for velocities, reactions and violation")
    start = time.perf_counter()
    runs = {}
    for engine in engines:
        progress(f"{engine.name}: {scene.duration:g} s of {scene.name}")
        runs[engine.name] = engine.simulate(scene)
    progress("comparing equations and runs")
    rows = compare(scene, engines, runs, RANDOM_STATES)
    return Crosscheck(scene, tuple(engines), runs, tuple(rows), time.perf_counter() - start)


def check_writable(folder: Path, recording: Path) -> None:
    """Raise `CrosscheckError` before a run whose results could not be written after it."""
    for path in (folder / "summary.json", recording):
        try:
            if path.is_dir():
                raise CrosscheckError(f"cannot write {path}: it is a directory")
            path.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=path.parent):
                pass
        except OSError as error:
            raise CrosscheckError(f"cannot write {path}: {error.strerror}") from error


def write(result: Crosscheck, folder: Path, recording: Path, verdict: str) -> list[Path]:
    """Write the runs, the summary and the Rerun recording, each whole or not at all.

    Raises:
        CrosscheckError: naming the path that cannot be written.
    """
    from crosscheck.rerun_log import write_recording

    written = []
    path = folder
    try:
        for name, run in result.runs.items():
            path = folder / f"{name}.npz"
            run.save(path)
            written.append(path)
        path = folder / "summary.json"
        with atomic_file(path) as temporary:
            temporary.write_text(json.dumps(result.summary(), indent=1) + "\n", encoding="utf-8")
        written.append(path)
        path = recording
        write_recording(path, result.scene, result.runs, verdict)
        written.append(path)
    except OSError as error:
        raise CrosscheckError(f"cannot write {path}: {error.strerror}") from error
    return written
