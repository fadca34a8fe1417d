"""What a crosscheck leaves in its folder: the runs, a summary and a recording, all of them or none."""

from __future__ import annotations

import json
import tempfile
from contextlib import ExitStack
from pathlib import Path

from crosscheck.engines import ENGINES
from crosscheck.errors import CrosscheckError
from crosscheck.run import Crosscheck
from newton_euler.trajectory import atomic_file


def check_writable(*paths: Path) -> None:
    """Raise `CrosscheckError` before a run whose files could not be written after it."""
    for path in paths:
        try:
            if path.is_dir():
                raise CrosscheckError(f"cannot write {path}: it is a directory")
            path.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=path.parent):
                pass
        except OSError as error:
            raise CrosscheckError(f"cannot write {path}: {error.strerror}") from error


def write(result: Crosscheck, folder: Path, recording: Path, verdict: str) -> list[Path]:
    """Write the runs, the summary and the Rerun recording, all of them or none.

    Runs of other engines that an earlier crosscheck left in the folder are removed.

    Raises:
        CrosscheckError: naming the path that cannot be written.
    """
    from crosscheck.recording.log import write_recording

    written = []
    path = folder
    try:
        with ExitStack() as stack:

            def temporary(target: Path) -> Path:
                nonlocal path
                path = target
                written.append(target)
                return stack.enter_context(atomic_file(target))

            for name, run in result.runs.items():
                run.save(temporary(folder / f"{name}.npz"))
            summary = json.dumps(result.summary(), indent=1, allow_nan=False)
            temporary(folder / "summary.json").write_text(summary + "\n", encoding="utf-8")
            write_recording(temporary(recording), result.scene, result.runs, verdict)
        for name in ENGINES.keys() - result.runs.keys():
            path = folder / f"{name}.npz"
            path.unlink(missing_ok=True)
    except OSError as error:
        raise CrosscheckError(f"cannot write {path}: {error.strerror}") from error
    return written
