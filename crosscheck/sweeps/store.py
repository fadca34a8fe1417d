"""Results of sweeps on disk or in memory, in Zarr's format: written by chunks, read as an xarray Dataset.

A chunk counts when the status of its runs is there, which is written after all else; Zarr writes each file
beside its place. So a sweep may be killed anywhere, and what is not there is made again.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from crosscheck.errors import CrosscheckError, short_of_memory
from crosscheck.files import remove_abandoned
from crosscheck.sweeps.plan import CONDITIONS, DONE, STOPPED, Chunk, Plan, make_runs
from crosscheck.sweeps.sampling import EXTENDED, UNEXTENDED
from newton_euler.variation import units_of

NAME = "sweep.zarr"

STATUS, ERROR = "status", "error"
"""Variables beside those that vary and those that are kept."""

UNFINISHED = "*.partial"
"""Files of Zarr that were never ended, where a process was killed."""

BLOCK = 2**20
"""Runs whose status is read at a time."""

OF_TASKS = "tasks"
"""Attribute by which tasks know the store that they are for: one of a worker that outlives its client does
not write into another store that has taken the place, nor into one to which runs were added."""

FREE = ("chunk", "versions", "numbers", OF_TASKS)
"""Attributes that are not compared: of packages samples are, and of scenes fingerprints."""

ELSEWHERE = "name another folder (--output), or remove this one"

GOES_ON = "the same command goes on from there"

KEPT_GOES_ON = f"what is stored is kept, {GOES_ON}"


def libraries() -> tuple[Any, Any]:
    """Import xarray and zarr, which are in the optional group `sweep`.

    Raises:
        CrosscheckError: if they are not installed.
    """
    try:
        import xarray
        import zarr
    except ImportError as error:
        raise not_installed(error) from error
    return xarray, zarr


def not_installed(error: ImportError) -> CrosscheckError:
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
            if "runs" not in group.attrs or STATUS not in group:
                raise ValueError("it has no number of runs or no status")
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
        remove_abandoned(path.parent.glob(f".{path.stem}-????????{path.suffix}"))
        made = path.parent / f".{path.stem}-{os.urandom(4).hex()}{path.suffix}"
        try:
            with told(path):
                path.parent.mkdir(parents=True, exist_ok=True)
                cls(zarr.create_group(made), made)._create(plan, record | {OF_TASKS: os.urandom(8).hex()})
                made.rename(path)
        finally:
            shutil.rmtree(made, ignore_errors=True)
        return cls.at(path)

    def _create(self, plan: Plan, attributes: Mapping[str, Any]) -> None:
        """Make all variables, without values, and the names along their dimensions."""
        self.group.update_attributes(dict(attributes))
        of_runs = {"run": plan.samples.runs}

        def make(name: str, kind: Any, sizes: Mapping[str, int], unit: str = "", about: str = "") -> Any:
            said = {"units": unit, "long_name": about}
            return self.group.create_array(
                name,
                shape=tuple(sizes.values()),
                chunks=tuple(plan.chunk if each == "run" else n for each, n in sizes.items()),
                dtype=kind,
                dimension_names=tuple(sizes),
                attributes={key: text for key, text in said.items() if text},
                fill_value=np.nan if kind == "f8" else None,
            )

        for name, unit in units_of(plan.scene, plan.samples.names).items():
            make(name, "f8", of_runs, unit, name)
        for each in plan.kept:
            sizes = {name: len(along) for name, along in each.dimensions.items()}
            make(each.name, "f8", of_runs | sizes, each.unit, each.text)
        coordinates = {name: along for each in plan.kept for name, along in each.dimensions.items()}
        for dimension, values in coordinates.items():
            kind, unit = ("f8", "s") if values.dtype.kind == "f" else (str, "")
            array = make(dimension, kind, {dimension: len(values)}, unit)
            array[:] = values if unit else values.astype(object)
        make(ERROR, str, of_runs, about="why a run could not go on")
        about = f"{DONE}: to its end, {STOPPED}: could not go on, 0: not made yet"
        make(STATUS, "u1", of_runs, about=about)

    def resumed(self, plan: Plan) -> Plan:
        """Return the plan with the chunks of the store, to which runs are added if the plan has more.

        Raises:
            CrosscheckError: if the store is of another scene or plan.
        """
        own, record, runs = dict(self.group.attrs), plan.record(), plan.samples.runs
        if (more := own["runs"] < runs) and plan.samples.sampling in EXTENDED:
            record |= {"runs": own["runs"], "samples": plan.samples.digest(own["runs"])}
        if what := _difference(own, record):
            raise CrosscheckError(f"{self.path} holds a sweep of {what}; {ELSEWHERE}")
        with intact(self.path), told(self.path):
            remove_abandoned(self.path.rglob(UNFINISHED) if self.path else ())
            if more:
                new = {"runs": runs, "samples": plan.samples.digest(runs), OF_TASKS: os.urandom(8).hex()}
                self.group.update_attributes(new)
            # after that, and looked at each time: a process that is killed here is called with as many again
            for _, array in self.group.arrays():
                if array.metadata.dimension_names[0] == "run" and array.shape[0] < runs:
                    array.resize((runs, *array.shape[1:]))
            of_kept = [name for each in plan.kept for name in (each.name, *each.dimensions)]
            for name in (*plan.samples.names, *of_kept, ERROR):
                if name not in self.group:
                    raise ValueError(f"{name} is missing")
        return replace(plan, chunk=int(own["chunk"]))

    def missing(self, plan: Plan) -> list[tuple[int, int]]:
        """Return the runs that are not there: of each chunk the first of them and the first after them.

        They are at its end, of the last chunk of a sweep to which runs were added.

        Raises:
            CrosscheckError: for files that are damaged.
        """
        runs, left = plan.samples.runs, list[tuple[int, int]]()
        step = max(1, BLOCK // plan.chunk) * plan.chunk
        with intact(self.path, STATUS):
            for start in range(0, runs, step):
                there = (self.group[STATUS][start : start + step] != 0).astype(int)
                chunks = np.arange(0, len(there), plan.chunk)
                firsts = start + chunks + np.add.reduceat(there, chunks)
                lasts = np.minimum(start + chunks + plan.chunk, runs)
                some = firsts < lasts
                left += zip(firsts[some].tolist(), lasts[some].tolist(), strict=True)
        return left

    def progress(self) -> str:
        """Word how many of all runs are there.

        Raises:
            CrosscheckError: for files that are damaged.
        """
        with intact(self.path, STATUS):
            status = self.group[STATUS]
            starts = range(0, status.shape[0], BLOCK)
            there = sum(int(np.count_nonzero(status[start : start + BLOCK])) for start in starts)
        return f"{there:,} of {status.shape[0]:,} runs"

    def write(self, first: int, chunk: Chunk) -> None:
        """Write consecutive runs, their status last.

        Raises:
            CrosscheckError: naming the path that cannot be written.
        """
        last, stopped = first + len(chunk.errors), chunk.errors != ""
        with intact(self.path), told(self.path):
            for name, values in chunk.values.items():
                self.group[name][first:last] = values
            if stopped.any():
                self.group[ERROR][first:last] = chunk.errors
            self.group[STATUS][first:last] = np.where(stopped, STOPPED, DONE).astype("u1")

    def dataset(self) -> Any:
        """Return an xarray Dataset of all that is there; variables are read when they are used."""
        xarray, _ = libraries()
        with intact(self.path):
            return xarray.open_zarr(self.group.store, consolidated=False, chunks=None)


def _difference(own: Mapping[str, Any], record: Mapping[str, Any]) -> str:
    """Word the first difference of a store's attributes from the record of a plan; empty without one."""
    follows = {*record} - {*CONDITIONS} | {"samples"}  # other versions have other fingerprints and plans
    for name in sorted(_changed(own, record), key=follows.__contains__):
        if name in CONDITIONS:
            return CONDITIONS[name].rstrip(",")
        if name == "fingerprint":
            old, new = (json.loads(each.get("numbers", "{}")) for each in (own, record))
            changes = [_change(number, old, new) for number in _changed(old, new)]
            return f"another scene: {next(iter(changes), 'its start or structure differs')}"
        if name not in FREE:
            why = UNEXTENDED.get((record["sampling"], name.partition(" ")[0]), "")
            return f"another plan: {_change(name, own, record)}{why}"
    return ""


def _changed(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    return [name for name in {**new, **old} if old.get(name) != new.get(name)]


def _change(name: str, old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    """Word a part of a plan or a scene that differs: its name, what it was and what it is."""
    was, is_ = (
        f"{value:g}" if isinstance(value, float) else f"{value!s:.200}"
        for value in (old.get(name, "not given"), new.get(name, "not given"))
    )
    return f"{name} was {was}, is {is_}"


@contextmanager
def intact(path: Path | None, name: str = "") -> Iterator[None]:
    """A block in which files of a store that are damaged are one line; `name` is the variable's."""
    try:
        yield
    except (OSError, RuntimeError, ValueError, KeyError) as error:
        if short_of_memory(error):
            raise
        problem = f"{path} is damaged: {name and f'{name}: '}{error}"
        raise CrosscheckError(f"{problem:.300}; {ELSEWHERE}") from error


@contextmanager
def told(path: Path | None) -> Iterator[None]:
    """A block in which a disk that is full, or cannot be written, is one line."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise CrosscheckError(f"cannot write {path}: {reason}; {KEPT_GOES_ON}") from error


@contextmanager
def interruptible(path: Path) -> Iterator[None]:
    """A block whose interrupt says how many runs are in the store at a path, if it is there."""
    try:
        yield
    except KeyboardInterrupt:
        if not path.exists():
            raise
        raise KeyboardInterrupt(f"{Store.at(path).progress()} are stored, {GOES_ON}") from None


def check_finished(folder: Path) -> None:
    """Raise `CrosscheckError` for a folder with a sweep alone that did not come to its tables."""
    if (folder / NAME).is_dir() and not any(folder.glob("*.json")):
        there = Store.at(folder / NAME).progress()
        raise CrosscheckError(f"{folder} holds an unfinished sweep, {there}; {GOES_ON}")


@contextmanager
def locked(path: Path | None) -> Iterator[None]:
    """A block in which no other process works at a store; the lock ends with the process, if it is killed.

    Two with other numbers of runs would write the chunk at the end of one of them over each other.

    Raises:
        CrosscheckError: if one does, and naming the path that cannot be written.
    """
    if path is None:
        yield
        return
    try:
        import locket
    except ImportError as error:
        raise not_installed(error) from error
    with ExitStack() as stack:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            lock = path.parent.absolute() / f".{path.stem}.lock"
            stack.enter_context(locket.lock_file(str(lock), timeout=0.0))
        except OSError as error:
            raise CrosscheckError(f"cannot write {path}: {error.strerror or error}") from error
        except locket.LockError as error:
            what_to_do = "wait for its end, or name another folder (--output)"
            raise CrosscheckError(f"another process works at {path}; {what_to_do}") from error
        yield


def store_runs(plan: Plan, path: Path, tasks: str | None, runs: tuple[int, int]) -> None:
    """Make the runs from the first to before the second number, and write them where they are made.

    If the store there is that of the tasks by then.

    Raises:
        CrosscheckError: naming the path that cannot be written, and for a scene that cannot be run.
    """
    chunk = make_runs(plan, runs)
    store = Store.at(path)
    if store.group.attrs.get(OF_TASKS) == tasks:
        store.write(runs[0], chunk)
