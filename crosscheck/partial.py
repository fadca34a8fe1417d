"""What a crosscheck leaves that could not be ended: every engine's run as far as it came."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from pydantic import BaseModel

from crosscheck.engines import ENGINES
from crosscheck.errors import CrosscheckError, reason_of
from crosscheck.files import check_writable
from crosscheck.results import read_json
from newton_euler.trajectory import Trajectory, atomic_file

PARTIAL_SUMMARY = "summary.partial.json"
"""Tells whose runs a folder has that is none of a complete crosscheck."""


class UnfinishedError(CrosscheckError):
    """A crosscheck that could not be ended, after at least one engine was tried.

    Attributes:
        runs: by engine, those that came to their end.
        partial: by engine, those that stopped, as far as they came if they came anywhere.
    """

    def __init__(
        self, reason: str, runs: Mapping[str, Trajectory], partial: Mapping[str, Trajectory] | None = None
    ) -> None:
        self.runs, self.partial = dict(runs), dict(partial or {})
        super().__init__(reason)


@contextmanager
def partial_runs_saved(folder: Path, sources: Sequence[str], names: Collection[str] = ()) -> Iterator[None]:
    """Where a block ends by an error, save the runs of an `UnfinishedError` to a folder.

    Runs that came to their end are ENGINE.npz, as of a crosscheck that did; others are ENGINE.partial.npz.
    What an earlier crosscheck left there is removed: without a summary the folder is none of a complete
    crosscheck. A recording that it sent elsewhere stays. `PARTIAL_SUMMARY` says of which models they are.

    Args:
        sources: of the models.
        names: of runs other than those of engines.

    Raises:
        CrosscheckError: with the error and the files that were written.
    """
    known = tuple(dict.fromkeys([*ENGINES, *names]))
    partial = [partial_path(folder, name) for name in known]
    check_writable(*partial)
    for path in partial:
        path.unlink(missing_ok=True)
    try:
        yield
    except Exception as error:  # the earlier verdict holds no more, whatever it was
        unfinished = error if isinstance(error, UnfinishedError) else UnfinishedError(reason_of(error), {})
        raise CrosscheckError(
            "; ".join([str(unfinished), *_saved(unfinished, folder, sources, known)])
        ) from error


def _saved(
    error: UnfinishedError, folder: Path, sources: Sequence[str], known: tuple[str, ...]
) -> Iterator[str]:
    """Write the runs and say so; of a path that cannot be written too, and then no more."""
    complete = {folder / f"{name}.npz": run for name, run in error.runs.items()}
    stopped = {partial_path(folder, name): run for name, run in error.partial.items()}
    summary = path = folder / "summary.json"
    told = folder / PARTIAL_SUMMARY
    earlier = [folder / f"{name}.npz" for name in known if name not in error.runs]
    try:
        for path in (summary, *_recording(summary), *earlier, told):
            path.unlink(missing_ok=True)
        if complete or stopped:
            content = {"models": [{"source": source} for source in sources], "reason": str(error)}
            with atomic_file(told) as temporary:
                temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
        for path, run in (complete | stopped).items():
            run.save(path)
            yield f"wrote {path}" + (f", up to t = {run.time[-1]:.6g} s" if path in stopped else "")
    except OSError as failure:
        yield f"cannot write {path}: {failure.strerror}"


class _Named(BaseModel):
    scene: str


def _recording(summary: Path) -> Iterator[Path]:
    """Where a summary's crosscheck leaves its recording if that goes nowhere else, beside the summary."""
    with suppress(CrosscheckError, ValueError):
        yield summary.with_name(f"{read_json(summary, _Named).scene}.rrd")


def partial_path(folder: Path, engine: str) -> Path:
    """Where a run that stopped is saved."""
    return folder / f"{engine}.partial.npz"
