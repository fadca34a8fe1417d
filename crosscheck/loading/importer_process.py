"""Read a model file by one importer, in a process of its own: importers crash.

Usage: `python -m crosscheck.loading.importer_process IMPORTER FILE RESULT`. The process writes a `Reading`
to RESULT. The operating system limits its processor time and its memory, since a file may be hostile.
"""

from __future__ import annotations

import os
import pickle
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from crosscheck.library.model_files import SUFFIXES
from crosscheck.loading.importers import MAX_PROCESSOR_S, OWN, Failure, Reading, importers
from newton_euler.limits import size_in_bytes
from newton_euler.model.source_file import SourceError
from newton_euler.reading.robot import RobotFile


def _describe(importer: str) -> Callable[[str], RobotFile]:
    """Return the function that describes the robot of a file as an importer reads it."""
    if importer == OWN:
        from crosscheck.library.model_files import is_urdf_file
        from crosscheck.loading.robots import describe_model

        # as the other importers, this one follows references to any folder
        any_folder = {"root": os.path.abspath(os.sep)}
        return lambda path: describe_model(path, {} if is_urdf_file(path) else any_folder)
    found = importers()[importer].importer
    assert found is not None
    return found.describe


def main() -> None:
    """Read a file by one importer in this process, and write its `Reading` to another file."""
    importer, path, result = sys.argv[1], sys.argv[2], sys.argv[3]
    with suppress(ImportError):  # Windows has no limits of resources
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (MAX_PROCESSOR_S, MAX_PROCESSOR_S))
        memory = size_in_bytes("memory")
        resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        # all importers read the same text, so that its digits leave nothing open
        reading = Reading(importer, replace(_describe(importer)(path), variants=()))
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
