"""Read a model file by one importer, in a process of its own: importers crash.

Usage: `python -m crosscheck.loading.importer_process IMPORTER FILE RESULT ENGINE`. ENGINE is the name of the
engine of the importer; other engines are not loaded. The process writes a `Reading` to RESULT. The operating
system limits its processor time and its memory, since a file may be hostile.
"""

from __future__ import annotations

import os
import pickle
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from crosscheck.engines.registry import choose
from crosscheck.library.model_files import SUFFIXES
from crosscheck.loading.importers import MAX_PROCESSOR_S, OWN, Failure, Reading
from newton_euler.limits import size_in_bytes
from newton_euler.model.source_file import SourceError
from newton_euler.reading.robot import RobotFile


def _describe(name: str) -> Callable[[str], RobotFile]:
    """Return the function that describes the robot of a file as the importer of an engine reads it.

    Args:
        name: name of the engine, or `OWN`.
    """
    if name == OWN:
        from crosscheck.library.model_files import is_urdf_file
        from crosscheck.loading.robots import describe_model

        # as the other importers, this one follows references to any folder
        any_folder = {"root": os.path.abspath(os.sep)}
        return lambda path: describe_model(path, {} if is_urdf_file(path) else any_folder)
    (engine,) = choose([name])
    assert engine.importer is not None
    return engine.importer.describe


def main() -> None:
    """Read a file by one importer in this process, and write its `Reading` to another file."""
    importer, path, result, engine = sys.argv[1:5]
    with suppress(ImportError):  # Windows has no limits of resources
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (MAX_PROCESSOR_S, MAX_PROCESSOR_S))
        memory = size_in_bytes("memory")
        resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        # all importers read the same text, so that its digits leave nothing open
        reading = Reading(importer, replace(_describe(engine)(path), variants=()))
    except SourceError as error:
        # an error of a file that the file includes has the path of that file
        is_refused = Path(error.path).suffix.lower() in SUFFIXES
        failure = Failure.REFUSED if is_refused else Failure.NOT_DESCRIBED
        reading = Reading(importer, None, failure, error.problem)
    except ModuleNotFoundError as error:
        reading = Reading(importer, None, Failure.NOT_INSTALLED, f"the package {error.name} is not installed")
    Path(result).write_bytes(pickle.dumps(reading))


if __name__ == "__main__":
    main()
