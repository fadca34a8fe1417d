"""What a crosscheck leaves that could not be ended: every engine's run as far as it came."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from crosscheck.engines import ENGINES
from crosscheck.errors import CrosscheckError
from crosscheck.files import check_writable
from newton_euler.errors import StoppedError
from newton_euler.trajectory import Trajectory


class StoppedRunError(CrosscheckError):
    """An engine's run ended before its time.

    Attributes:
        runs: by engine: its own as far as it came, if it came anywhere, and those that ended before it began.
    """

    def __init__(self, engine: str, error: StoppedError, runs: Mapping[str, Trajectory]) -> None:
        self.runs = dict(runs) | ({engine: error.partial} if error.partial else {})
        super().__init__(f"{engine}: {error}")


@contextmanager
def partial_runs_saved(folder: Path) -> Iterator[None]:
    """Save the runs of a `StoppedRunError` to a folder, as ENGINE.partial.npz, and remove earlier ones.

    Raises:
        CrosscheckError: with the error and the files that were written.
    """
    paths = [_path(folder, name) for name in ENGINES]
    check_writable(*paths)
    for path in paths:
        path.unlink(missing_ok=True)
    try:
        yield
    except StoppedRunError as stopped:
        message = str(stopped)
        (folder / "summary.json").unlink(missing_ok=True)  # of an earlier run, which did not stop
        for name, run in stopped.runs.items():
            path = _path(folder, name)
            try:
                run.save(path)
            except OSError as error:
                raise CrosscheckError(f"{message}; cannot write {path}: {error.strerror}") from error
            message += f"; wrote {path}, up to t = {run.time[-1]:.6g} s"
        raise CrosscheckError(message) from stopped


def _path(folder: Path, engine: str) -> Path:
    return folder / f"{engine}.partial.npz"
