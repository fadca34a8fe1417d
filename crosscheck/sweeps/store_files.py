"""Check the files of a sweep's store before Zarr opens them, and lock a store against other processes.

A store is a folder in the format of Zarr. It has one array for each varied parameter and each output of the
runs of a sweep, divided into chunks of consecutive runs, one file per chunk. Other arrays label the further
dimensions of outputs, such as times. A store may come from an untrusted source. Zarr would wait forever for a
named pipe, and would read a link to a device until the memory is full.
"""

from __future__ import annotations

import fcntl
import math
import os
import stat
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, StrictInt, StringConstraints

from crosscheck.support.errors import CrosscheckError
from crosscheck.support.results import read_json
from newton_euler.folders import make_folder
from newton_euler.limits import size_in_bytes

METADATA = "zarr.json"
"""Name of the file with the metadata of a group or an array."""

CHUNKS = "c"
"""Name of the folder with the numbered chunks of an array."""

CODECS = {
    "float64": ["bytes", "crc32c"],
    "uint8": ["bytes", "crc32c"],
    "string": ["vlen-utf8", "crc32c"],
}
"""Names of the codecs of a sweep's arrays, by data type. The last codec is a checksum, which detects every
error within 32 adjacent bits."""

CHECKSUM_BYTES = 4
"""Bytes of the checksum at the end of a chunk."""

NUMBER_BYTES = {"float64": 8, "uint8": 1}
"""Bytes of a number by data type. Files are not compressed, so that their sizes are known."""

MAX_RUNS, MAX_CHUNK = 2**32, 2**16
"""Largest number of runs of a sweep, and of a chunk."""

PARTIAL = ".partial"
"""Ending of incomplete files that Zarr leaves if a process is killed."""

Name = Annotated[str, StringConstraints(max_length=1000)]
"""Name in metadata, as text of limited length."""


class _Strict(BaseModel):
    """Base of all parts of the metadata: a field that the class does not know is an error."""

    model_config = ConfigDict(extra="forbid")


class _Attributes(BaseModel):
    """Attributes of a store: the plan of the sweep as texts and numbers, of which two are checked.

    Attributes:
        runs: number of runs of the sweep.
        chunk: number of runs of a chunk.
    """

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, str | int | float]
    runs: StrictInt = Field(ge=1, le=MAX_RUNS)
    chunk: StrictInt = Field(ge=1, le=MAX_CHUNK)


class _Group(_Strict):
    """Metadata of the store, a group of arrays, in version 3 of Zarr's format."""

    zarr_format: Literal[3]
    node_type: Literal["group"]
    attributes: _Attributes


class _ChunkShape(_Strict):
    """Shape of the chunks of an array."""

    chunk_shape: list[Annotated[StrictInt, Field(ge=1, le=2**32)]] = Field(min_length=1, max_length=8)


class _Grid(_Strict):
    """Division of an array into chunks of equal shape."""

    name: Literal["regular"]
    configuration: _ChunkShape


class _Separator(_Strict):
    """Separator of chunk indices in paths: each index is a folder or file."""

    separator: Literal["/"]


class _Encoding(_Strict):
    """Names of the files of chunks."""

    name: Literal["default"]
    configuration: _Separator


class _Codec(_Strict):
    """Codec: a step of the conversion between arrays and bytes."""

    name: str
    configuration: dict[str, str] = {}


class _Array(_Strict):
    """Metadata of a variable of the sweep, an array."""

    zarr_format: Literal[3]
    node_type: Literal["array"]
    shape: list[Annotated[StrictInt, Field(ge=0, le=MAX_RUNS)]] = Field(min_length=1, max_length=8)
    data_type: Literal["float64", "uint8", "string"]
    chunk_grid: _Grid
    chunk_key_encoding: _Encoding
    fill_value: Literal["NaN", "", 0] | float
    codecs: list[_Codec]
    attributes: dict[Name, str]
    dimension_names: list[Name]
    storage_transformers: list[str] = Field(max_length=0)


def check_files(path: Path) -> None:
    """Check that the folder of a store has only regular files, with the metadata and sizes of a sweep.

    Raises:
        CrosscheckError: naming the first file that fails a check.
    """
    _check_entry(path)
    group = read_json(path / METADATA, _Group)
    for folder in _entries(path):
        if not folder.is_dir():
            continue
        file = folder / METADATA
        if not os.path.lexists(file):
            raise CrosscheckError(f"{folder}: no {METADATA}; needed: a variable of a sweep")
        _check_entry(file)
        array = read_json(file, _Array)
        _check_array(file, array, group.attributes)
        most_bytes = _most_bytes(array)
        for chunk in _files_below(folder):
            is_chunk = chunk.suffix != PARTIAL and chunk.name != METADATA
            if is_chunk and (size := chunk.lstat().st_size) > most_bytes:
                raise CrosscheckError(f"{chunk}: {size} bytes; needed: {most_bytes} at most")


def _check_array(file: Path, array: _Array, sweep: _Attributes) -> None:
    """Check that the fields of an array's metadata are consistent with each other and with the sweep.

    Args:
        file: file of the metadata, for error messages.
        array: metadata of the array.
        sweep: attributes of the store.

    Raises:
        CrosscheckError: naming the file and the field.
    """
    codecs, needed_codecs = [codec.name for codec in array.codecs], CODECS[array.data_type]
    if codecs != needed_codecs:
        names, needed = ", ".join(codecs), ", ".join(needed_codecs)
        raise CrosscheckError(f"{file}: codecs are {names:.100}; needed: {needed}, with a checksum")
    chunk, of_runs = array.chunk_grid.configuration.chunk_shape, array.dimension_names[:1] == ["run"]
    if not len(array.shape) == len(chunk) == len(array.dimension_names):
        raise CrosscheckError(f"{file}: shape, chunk_shape and dimension_names differ in length")
    # an array has fewer runs than the sweep if a process was killed while it extended the sweep
    if of_runs and (chunk[0] != sweep.chunk or array.shape[0] > sweep.runs):
        needed = f"chunks of {sweep.chunk} and at most {sweep.runs} runs, as the sweep has"
        raise CrosscheckError(f"{file}: chunks of {chunk[0]} of {array.shape[0]} runs; needed: {needed}")


def _most_bytes(array: _Array) -> int:
    """Return the largest size of a chunk in bytes; for numbers this is the exact size."""
    if array.data_type not in NUMBER_BYTES:
        return size_in_bytes("array_size")  # texts: the general limit of the size of arrays in files
    numbers = math.prod(array.chunk_grid.configuration.chunk_shape)
    return numbers * NUMBER_BYTES[array.data_type] + CHECKSUM_BYTES


def _entries(folder: Path) -> list[Path]:
    """Return the entries of a folder, and check that each is a regular file or a folder."""
    try:
        entries = sorted(folder.iterdir())
    except OSError as error:
        raise CrosscheckError(f"{folder}: cannot be read: {error.strerror}") from error
    for entry in entries:
        _check_entry(entry)
    return entries


def _files_below(folder: Path) -> Iterator[Path]:
    """Yield all files in a folder and its subfolders, each checked by `_check_entry`."""
    for entry in _entries(folder):
        if entry.is_dir():
            yield from _files_below(entry)
        else:
            yield entry


def _check_entry(path: Path) -> None:
    """Raise `CrosscheckError` for a link, a pipe or a device."""
    try:
        mode = path.lstat().st_mode
    except OSError as error:
        raise CrosscheckError(f"{path}: cannot be read: {error.strerror}") from error
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        kind = "a link" if stat.S_ISLNK(mode) else "a pipe or a device"
        raise CrosscheckError(f"{path}: {kind}; needed: a regular file or a folder")


def chunk_file(folder: Path, number: int, dimensions: int) -> Path:
    """Return the file of a chunk of runs, such as FOLDER/c/12/0; arrays are divided along the runs only.

    Args:
        folder: folder of the array.
        number: index of the chunk.
        dimensions: number of dimensions of the array.
    """
    return folder.joinpath(CHUNKS, str(number), *["0"] * (dimensions - 1))


def stored_chunks(folder: Path, dimensions: int) -> set[int]:
    """Return the indices of the chunks that have a file, of an array with a number of dimensions."""
    try:
        names = os.listdir(folder / CHUNKS)
    except FileNotFoundError:
        return set()
    numbers = {int(name) for name in names if name.isascii() and name.isdigit()}
    return {number for number in numbers if chunk_file(folder, number, dimensions).is_file()}


@contextmanager
def locked(path: Path | None) -> Iterator[None]:
    """Lock a store at a path against other processes; without a path do nothing.

    The operating system removes the lock if the process is killed. Without a lock, two processes that extend
    a sweep to different numbers of runs would overwrite each other's last chunk.

    Raises:
        CrosscheckError: if another process has the lock, and naming a path that cannot be written or is a
            link.
    """
    if path is None:
        yield
        return
    with ExitStack() as stack:
        lock = path.parent.absolute() / f".{path.stem}.lock"
        try:
            make_folder(path.parent)
            handle = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o600)
            stack.callback(os.close, handle)
            if not stat.S_ISREG(os.fstat(handle).st_mode):
                raise CrosscheckError(f"cannot write {lock}: not a regular file")
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            what_to_do = "wait until it has finished, or name another folder (--output)"
            raise CrosscheckError(f"another process uses {path}; {what_to_do}") from error
        except OSError as error:
            is_link = os.path.islink(lock)
            reason = "a link, remove it" if is_link else error.strerror or error
            raise CrosscheckError(f"cannot write {lock if is_link else path}: {reason}") from error
        yield
