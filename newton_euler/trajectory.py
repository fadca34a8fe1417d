"""Trajectory: what every engine returns."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from newton_euler.errors import IntegrationError, NewtonEulerError
from newton_euler.scalars import Array


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A run at n output times: b bodies (ground first), j joints, a actuators; world frame, SI.

    Arrays that the scene did not ask for are None and are left out of files.

    Attributes:
        engine: name of the engine that made it.
        settings: the options it ran with and what it counted (steps, evaluations).
        wall_time: s, of the run itself, without building the model.
    """

    engine: str
    settings: dict[str, Any]
    wall_time: float
    time: Array = field(metadata={"shape": "n", "unit": "s"})
    body_names: tuple[str, ...]
    joint_names: tuple[str, ...]
    position: Array
    """(n, b, 3) centres of mass, m."""
    quaternion: Array
    """(n, b, 4) w-x-y-z, continuous in sign."""
    linear_velocity: Array | None = None
    """(n, b, 3) of the centres of mass, m/s."""
    angular_velocity: Array | None = None
    """(n, b, 3) rad/s."""
    reaction_force: Array | None = None
    """(n, j, 3) constraint force on the second body, N; not unique where constraints are redundant, see
    `newton_euler.reactions`."""
    reaction_torque: Array | None = None
    """(n, j, 3) constraint torque on the second body about the joint point, N m; as unique as the force."""
    actuator_force: Array | None = None
    """(n, a) along the actuated coordinates, N or N m."""
    constraint_violation: Array | None = None
    """(n, j) largest residual of each joint's equations, m or rad."""
    kinetic_energy: Array | None = None
    """(n,) J."""
    potential_energy: Array | None = None
    """(n,) of gravity, zero at the world origin, and of springs, zero at rest, J."""
    work: Array | None = None
    """(n,) done since the start by control, dampers, wrenches and prescribed motions, J."""

    def arrays(self) -> dict[str, Array]:
        """The arrays of the run by name, names as arrays of text."""
        skipped = ("engine", "settings", "wall_time")
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in skipped}
        return {name: np.asarray(value) for name, value in values.items() if value is not None}

    def first(self, outputs: int) -> Trajectory:
        """The run at its first outputs; itself if it has no more."""
        if outputs >= len(self.time):
            return self
        cut: dict[str, Any] = {
            name: values[:outputs] for name, values in self.arrays().items() if values.dtype.kind == "f"
        }
        return replace(self, **cut)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the arrays to an .npz; the file appears whole or not at all."""
        content = io.BytesIO()  # a zip file on a full disk would fail once more on its way out
        arrays: dict[str, Any] = dict(self.arrays())
        np.savez_compressed(content, **arrays)
        with atomic_file(path) as temporary:
            temporary.write_bytes(content.getbuffer())


def check_finite(times: Array, arrays: Mapping[str, Array]) -> None:
    """Raise `IntegrationError` for the first time at which an array, a row for each, is not finite."""
    wrong = {name: np.argwhere(~np.isfinite(array)) for name, array in arrays.items()}
    first = [(int(rows[0, 0]), name) for name, rows in wrong.items() if len(rows)]
    if first:
        row, name = min(first)
        raise IntegrationError(float(times[row]), f"{name} is not finite")


def load_arrays(path: str | os.PathLike[str]) -> dict[str, Array]:
    """Read the arrays of a saved trajectory by name; raises `NewtonEulerError` for a bad file."""
    from zipfile import BadZipFile

    try:
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (OSError, EOFError, ValueError, KeyError, BadZipFile) as error:
        raise NewtonEulerError(f"cannot read a trajectory from {os.fspath(path)!r}: {error}") from error


@contextmanager
def atomic_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary path beside `path`, in a folder made if need be, that becomes `path` on success only.

    Whatever ends the block otherwise, an error or an interrupt, leaves what was at `path` before.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = target.parent / f".{target.stem}-{os.urandom(4).hex()}{target.suffix}"
    try:
        temporary.touch(exist_ok=False)
        yield temporary
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)
