"""Results of sweeps on disk or in memory, in Zarr's format: written by chunks, read as an xarray Dataset.

A chunk counts when the status of its runs is there, which is written after all else; Zarr writes each file
beside its place. So a sweep may be killed anywhere, and what is not there is made again.
"""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from crosscheck.errors import CrosscheckError
from crosscheck.sweeps.expressions import labels
from crosscheck.sweeps.plan import DONE, STOPPED, Chunk, Plan, run_chunk
from newton_euler.scalars import Array
from newton_euler.variation import unit_of

NAME = "sweep.zarr"

STATUS, ERROR = "status", "error"
"""Variables beside those that vary and those that are kept."""

UNFINISHED = "*.partial"
"""Files of Zarr that were never ended."""

ABANDONED = 60.0
"""s after which these are those of a process that was killed."""

FREE = ("chunk", "versions")
"""Parts of a plan's record that results do not depend on: of packages, samples do, which are compared."""

KEPT_GOES_ON = "what is stored is kept, the same command goes on from there"


def libraries() -> tuple[Any, Any]:
    """Import xarray and zarr, which are in the optional group `sweep`.

    Raises:
        CrosscheckError: if they are not installed.
    """
    try:
        import xarray
        import zarr
    except ImportError as error:
        raise missing(error) from error
    return xarray, zarr


def missing(error: ImportError) -> CrosscheckError:
    """Return the error about a package of the optional group."""
    return CrosscheckError(f'{error.name} is not installed; pip install "crosscheck[sweep]"')


class Store:
    """Results of a sweep.

    Attributes:
        group: of Zarr.
        path: of its folder; None in memory.
    """

    def __init__(self, group: Any, path: Path | None) -> None:
        self.group, self.path = group, path

    @classmethod
    def in_memory(cls, plan: Plan) -> Store:
        """Make a store that is lost with the process."""
        _, zarr = libraries()
        store = cls(zarr.create_group(zarr.storage.MemoryStore()), None)
        store._create(plan, {})
        return store

    @classmethod
    def at(cls, path: Path) -> Store:
        """Open a store that is there.

        Raises:
            CrosscheckError: for a folder that holds no sweep.
        """
        _, zarr = libraries()
        try:
            group = zarr.open_group(path, mode="r+", use_consolidated=False)
            if "seed" not in group.attrs or STATUS not in group:
                raise ValueError("it has no seed or no status")
        except (OSError, ValueError, KeyError) as error:
            raise CrosscheckError(f"{path} holds no sweep: {error}"[:300]) from error
        return cls(group, path)

    @classmethod
    def make(cls, plan: Plan, path: Path) -> Store:
        """Make a store on disk; it appears whole or not at all.

        Raises:
            CrosscheckError: naming the path that cannot be written.
        """
        _, zarr = libraries()
        record = plan.record()
        for abandoned in path.parent.glob(f".{path.stem}-????????{path.suffix}"):
            if _is_abandoned(abandoned):
                shutil.rmtree(abandoned, ignore_errors=True)
        made = path.parent / f".{path.stem}-{os.urandom(4).hex()}{path.suffix}"
        try:
            with told(path):
                path.parent.mkdir(parents=True, exist_ok=True)
                cls(zarr.create_group(made), made)._create(plan, record)
                made.rename(path)
        finally:
            shutil.rmtree(made, ignore_errors=True)
        return cls.at(path)

    def _create(self, plan: Plan, attributes: Mapping[str, Any]) -> None:
        """Make all variables, without values, and the names along their dimensions."""
        # texts and numbers, as netCDF has them
        self.group.attrs.update(
            {
                name: json.dumps(each) if isinstance(each, list | dict) else each
                for name, each in attributes.items()
            }
        )
        runs, names = plan.samples.runs, labels(plan.scene)
        coordinates: dict[str, Array] = {}
        for name in plan.samples.names:
            self._variable(name, (runs,), plan.chunk, ("run",), "f8", unit_of(plan.scene, name), name)
        for each in plan.kept:
            dimensions, sizes = [], []
            for dimension in each.dimensions:
                values: Any = names.get(dimension)
                if dimension == "time":
                    values = plan.lean.times[list(each.places)]
                    alike = (f"time{k}" if k else "time" for k in range(len(plan.kept)))
                    dimension = next(
                        n for n in alike if n not in coordinates or np.array_equal(coordinates[n], values)
                    )
                coordinates[dimension] = np.array(values)
                dimensions.append(dimension)
                sizes.append(len(values))
            self._variable(
                each.name, (runs, *sizes), plan.chunk, ("run", *dimensions), "f8", each.unit, each.text
            )
        for dimension, values in coordinates.items():
            kind = "f8" if values.dtype.kind == "f" else str
            unit = "s" if kind == "f8" else ""
            array = self._variable(dimension, values.shape, len(values), (dimension,), kind, unit, "")
            array[:] = values if kind == "f8" else values.astype(object)
        self._variable(ERROR, (runs,), plan.chunk, ("run",), str, "", "why a run could not go on")
        about = f"{DONE}: to its end, {STOPPED}: could not go on, 0: not made yet"
        self._variable(STATUS, (runs,), plan.chunk, ("run",), "u1", "", about)

    def _variable(
        self,
        name: str,
        shape: tuple[int, ...],
        chunk: int,
        dimensions: tuple[str, ...],
        kind: Any,
        unit: str,
        about: str,
    ) -> Any:
        attributes = {"units": unit} if unit else {}
        attributes |= {"long_name": about} if about else {}
        return self.group.create_array(
            name,
            shape=shape,
            chunks=(min(chunk, shape[0]), *shape[1:]),
            dtype=kind,
            dimension_names=dimensions,
            attributes=attributes,
            fill_value=np.nan if kind == "f8" else None,
        )

    def check_same(self, plan: Plan) -> Plan:
        """Return the plan with the chunks of the store.

        Raises:
            CrosscheckError: if the store is of another scene or plan.
        """
        record = plan.record()
        own = {name: _restored(value, record.get(name)) for name, value in self.group.attrs.items()}
        for name, value in record.items():
            if name in FREE or own.get(name) == value:
                continue
            if name in ("fingerprint", "scene"):
                what = f"another scene, or another version of {own.get('scene')!r:.100}"
                if own.get("solver") != record["solver"]:
                    continue  # which is in the fingerprint, too
            elif name == "samples":
                what = "other samples by the same seed, of other versions of packages"
            elif name == "processor":
                what = f"other processors, {own.get(name)!r:.100}, not {value}"
            elif name == "solver":
                what = "another version of newton_euler"
            else:
                what = f"another plan: {_difference(name, own.get(name), value)}"
            elsewhere = "name another folder (--output), or remove this one"
            raise CrosscheckError(f"{self.path} holds a sweep of {what}; {elsewhere}")
        return Plan(plan.scene, plan.samples, plan.keep, plan.control, int(own["chunk"]))

    def missing(self, plan: Plan) -> list[int]:
        """Return the chunks that are not there.

        Raises:
            CrosscheckError: for files that are damaged.
        """
        status = self.group[STATUS]
        try:
            return [k for k in range(plan.chunks) if not status[plan.bounds(k)[0]]]
        except (OSError, RuntimeError, ValueError) as error:
            problem = f"{self.path} is damaged: {STATUS}: {error}"[:300]
            raise CrosscheckError(f"{problem}; name another folder (--output), or remove this one") from error

    def tidy(self) -> None:
        """Remove files that a process which was killed has not ended."""
        for path in self.path.rglob(UNFINISHED) if self.path else ():
            if _is_abandoned(path):
                with suppress(OSError):
                    path.unlink()

    def write(self, plan: Plan, k: int, chunk: Chunk) -> None:
        """Write a chunk, its status last.

        Raises:
            CrosscheckError: naming the path that cannot be written.
        """
        first, last = plan.bounds(k)
        stopped = chunk.errors != ""
        with told(self.path):
            for name, values in chunk.values.items():
                self.group[name][first:last] = values
            if stopped.any():
                self.group[ERROR][first:last] = chunk.errors
            self.group[STATUS][first:last] = np.where(stopped, STOPPED, DONE).astype("u1")

    def dataset(self) -> Any:
        """Return an xarray Dataset of all that is there; variables are read when they are used."""
        xarray, _ = libraries()
        return xarray.open_zarr(self.group.store, consolidated=False, chunks=None)


def _restored(value: Any, like: Any) -> Any:
    """Return a list or a dictionary that was written as JSON, anything else as it is."""
    with suppress(ValueError):
        return json.loads(value) if isinstance(like, list | dict) and isinstance(value, str) else value
    return value


def _difference(name: str, old: Any, new: Any) -> str:
    """Word the first part of a plan that differs: its name, what it was and what it is."""
    if name == "vary":
        old, new = ({", ".join(names): text for *names, text in each} for each in (old, new))
    if isinstance(new, list | dict) and sorted(old) == sorted(new) and list(old) != list(new):
        name, old, new = f"order of {name}", ", ".join(old), ", ".join(new)
    elif isinstance(new, dict):
        part = next(key for key in [*old, *new] if old.get(key) != new.get(key))
        name, old, new = (f"vary {part}" if name == "vary" else part), old.get(part), new.get(part)
    elif isinstance(new, list):
        gone, come = (", ".join(x for x in one if x not in two) for one, two in ((old, new), (new, old)))
        old, new = gone or "without it", come or "without it"
    words = [
        f"{value:g}" if isinstance(value, float) else "not given" if value is None else str(value)
        for value in (old, new)
    ]
    return f"{name} was {words[0]:.80}, is {words[1]:.80}"


def _is_abandoned(path: Path) -> bool:
    try:
        return time.time() - path.stat().st_mtime > ABANDONED
    except OSError:  # another process has been quicker
        return False


@contextmanager
def told(path: Path | None) -> Iterator[None]:
    """A block in which a disk that is full, or cannot be written, is one line."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise CrosscheckError(f"cannot write {path}: {reason}; {KEPT_GOES_ON}") from error


def store_chunk(plan: Plan, path: Path, k: int) -> int:
    """Make the runs of a chunk and write them where they are made; returns how many there are.

    Raises:
        CrosscheckError: naming the path that cannot be written, and for a scene that cannot be run.
    """
    chunk = run_chunk(plan, k)
    Store.at(path).write(plan, k, chunk)
    return len(chunk.errors)
