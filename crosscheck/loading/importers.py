"""Read one model file by the importer of each engine, each in a process of its own, since importers crash."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from tempfile import TemporaryDirectory

from crosscheck.engines.engine import Engine
from crosscheck.engines.registry import may_import_files
from crosscheck.support.errors import CrosscheckError
from newton_euler.model.source_file import SourceError, path_text, read_text
from newton_euler.reading.robot import RobotFile

PROCESS = "crosscheck.loading.importer_process"
"""Module that reads a file by one importer."""

MAX_PROCESSOR_S = 120
"""Processor time of an importer, s. MuJoCo needs 20 s for the largest public models, with all meshes."""

MAX_WAIT_S = 300
"""Largest waiting time for an importer, s; the machine may be busy."""


OWN = "crosscheck"
"""Name of crosscheck's importer, with which the others are compared."""


def importers() -> dict[str, Engine]:
    """Return the installed engines that have an importer, by its name in texts."""
    found: dict[str, Engine] = {}
    for engine in may_import_files():
        if engine.importer is not None:
            is_free = engine.label and engine.label not in (OWN, *found)
            found[engine.label if is_free else engine.name] = engine
    return found


class Failure(StrEnum):
    """Failure of an importer."""

    REFUSED = "REFUSED"
    """The importer reports an error of the file."""
    NOT_DESCRIBED = "NOT DESCRIBED"
    """crosscheck cannot describe the model that the importer makes: it has numbers that are not finite, or
    unknown joints."""
    CRASHED = "CRASHED"
    """The importer's process ends, by a segmentation fault, for example, or needs too much time."""
    NOT_INSTALLED = "NOT INSTALLED"
    """A package that the importer needs is not installed."""


@dataclass(frozen=True, eq=False)
class Reading:
    """Robot that an importer reads in a file, or its failure.

    Attributes:
        importer: "crosscheck", or the name of the engine in texts, such as "MuJoCo".
        file: description of the robot for the comparison; None after a failure.
        failure: its failure; None without one.
        message: the importer's own message, or how its process ended; "" without a failure.
    """

    importer: str
    file: RobotFile | None
    failure: Failure | None = None
    message: str = ""


def read_by_all(source: str | os.PathLike[str]) -> list[Reading]:
    """Read an MJCF or URDF file by all importers, at the same time.

    Raises:
        CrosscheckError, SourceError: for something that is no readable file with the suffix of such a file.
    """
    from crosscheck.library.model_files import SUFFIXES, is_model_file

    path = path_text(source)
    if not is_model_file(path):
        raise CrosscheckError(f"{path}: no model file; needed: a name that ends in {', '.join(SUFFIXES)}")
    read_text(path, limit="file_size", error=SourceError)
    with TemporaryDirectory() as folder:
        names = {OWN: OWN} | {label: engine.name for label, engine in importers().items()}
        processes = [
            (importer, _start(importer, engine, path, Path(folder))) for importer, engine in names.items()
        ]
        try:
            return [
                _reading(importer, names[importer], process, Path(folder)) for importer, process in processes
            ]
        finally:
            for _, process in processes:
                process.kill()
                process.wait()


def _start(importer: str, engine: str, path: str, folder: Path) -> subprocess.Popen[bytes]:
    """Start the process of an importer; its reading and its standard error become files in a folder.

    The files have the name of the engine; `OWN` for crosscheck's importer.
    """
    # -P and the search path of this process without "", the current folder, whose modules may be a stranger's
    command = [sys.executable, "-P", "-m", PROCESS, importer, path, str(folder / engine), engine]
    search_path = os.pathsep.join([str(Path(__file__).parents[2]), *filter(None, sys.path)])
    environment = os.environ | {"PYTHONPATH": search_path, "OPENBLAS_NUM_THREADS": "1"}
    with open(folder / f"{engine}.txt", "wb") as log:
        return subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=environment)


def _reading(importer: str, engine: str, process: subprocess.Popen[bytes], folder: Path) -> Reading:
    """Wait for the process of an importer, and return its reading."""
    try:
        status = process.wait(MAX_WAIT_S)
    except subprocess.TimeoutExpired:
        return Reading(importer, None, Failure.CRASHED, f"not done after {MAX_WAIT_S} s")
    result = folder / engine
    if status == 0:
        found: Reading = pickle.loads(result.read_bytes())
        return found
    if status == -signal.SIGXCPU:
        end = f"not done after {MAX_PROCESSOR_S} s of processor time"
    elif status < 0:
        end = f"{signal.strsignal(-status)} ({signal.Signals(-status).name})"
    else:
        end = f"its process ends with exit status {status}"
    lines = (folder / f"{engine}.txt").read_text(errors="replace").split("\n")
    last = next((line.strip() for line in reversed(lines) if line.strip()), "")
    return Reading(importer, None, Failure.CRASHED, f"{end}: {last:.300}" if last else end)
