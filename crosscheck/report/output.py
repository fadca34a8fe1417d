"""What a crosscheck leaves in its folder: the runs, a summary and a recording, all of them or none."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from pydantic import BaseModel

from crosscheck.engines import ENGINES
from crosscheck.errors import CrosscheckError
from crosscheck.results import digest, read_json
from crosscheck.run import Crosscheck
from newton_euler.model.trajectory import atomic_file

TOLD = {
    "crosscheck": ("summary.json",),
    "benchmark": ("bench.json", "rhs.json", "batch.json", "scaling.json"),
}
"""Files that tell whose results a folder has."""


@contextmanager
def tidied_up() -> Iterator[None]:
    """A block that a request to end interrupts as Ctrl-C does, so that it tidies up behind itself.

    Elsewhere there is nothing to tidy up, and Python would hear of the request only after what runs in
    native code.
    """
    if threading.current_thread() is not threading.main_thread():  # the only one that hears of signals
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def write(result: Crosscheck, folder: Path, recording: Path | None, verdict: str) -> list[Path]:
    """Write the runs, the summary and the Rerun recording, all of them or none.

    The summary is removed first and comes back last, so that a folder that has one is complete wherever
    a process that wrote to it was killed. Nothing is removed before all that comes in its place is written
    beside it; then what an earlier crosscheck left in the folder of other engines is, or a recording if this
    one goes elsewhere.

    Args:
        recording: file that the recording goes to; no file if None.
        verdict: Markdown.

    Raises:
        CrosscheckError: naming the path that cannot be written.
    """
    summary = folder / "summary.json"
    usual = recording_path(result, folder)
    path = folder
    try:
        content = b""
        if recording is not None:
            from crosscheck.recording.log import recorded

            content = recorded(result.scene, result.runs, verdict, result.title)
        with tidied_up(), ExitStack() as stack:

            def temporary(target: Path) -> Path:
                nonlocal path
                path = target
                return stack.enter_context(atomic_file(target))

            # the stack is left from its top: what is entered first is in its place last
            last = temporary(summary)
            runs = [folder / f"{name}.npz" for name in result.runs]
            made: dict[str, str] = {}
            for target, run in zip(runs, result.runs.values(), strict=True):
                written = temporary(target)
                run.save(written)
                made[target.name] = digest(written)
            if recording is not None:
                temporary(recording).write_bytes(content)
                made[recording.name] = hashlib.sha256(content).hexdigest()
            path = summary
            text = json.dumps(result.summary() | {"files": made}, indent=1, allow_nan=False)
            last.write_text(text + "\n", encoding="utf-8")
            summary.unlink(missing_ok=True)
            for name in {*ENGINES, *(engine.name for engine in result.engines)} - result.runs.keys():
                path = folder / f"{name}.npz"
                path.unlink(missing_ok=True)
            if recording != usual:
                path = usual
                usual.unlink(missing_ok=True)
    except OSError as error:
        raise CrosscheckError(f"cannot write {path}: {error.strerror}") from error
    return [*runs, summary, *([] if recording is None else [recording])]


def check_own(folder: Path, sources: Sequence[str], results: str = "crosscheck") -> None:
    """Raise `CrosscheckError` if a folder has results of others than these models, in this order.

    Paths of earlier results are taken as seen from here. Trajectories beside nothing that says whose they
    are may be anybody's.

    Args:
        results: a key of `TOLD`.
    """
    elsewhere = "name another folder (--output), or this one to overwrite it"
    told = [found for name in TOLD[results] if (found := _sources(folder / name))]
    # what begins with a dot was never ended
    runs = [path for path in folder.glob("*.npz") if not path.name.startswith(".")]
    if results == "crosscheck" and runs and not told:
        raise CrosscheckError(f"{folder} holds trajectories of an unknown model; {elsewhere}")
    for earlier in told:
        if list(map(os.path.realpath, earlier)) != list(map(os.path.realpath, sources)):
            raise CrosscheckError(
                f"{folder} holds a {results} of {' against '.join(earlier)}, not of "
                f"{' against '.join(sources)}; {elsewhere}"
            )


class _Source(BaseModel):
    source: str = ""


class _Told(_Source):
    models: list[_Source] | None = None


def _sources(path: Path) -> list[str]:
    """The models that results are of; none if the file is none of results, or is too large to be."""
    try:
        found = read_json(path, _Told)
    except CrosscheckError:
        return []
    return [model.source for model in found.models or [found]]


def recording_path(result: Crosscheck, folder: Path) -> Path:
    """Where a crosscheck's recording is if it was not sent anywhere else."""
    return folder / f"{result.scene.name}.rrd"
