"""The folder of a crosscheck: the runs, a summary and a recording, all of them or none."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from crosscheck.compare.check import OF_RUNS, Check
from crosscheck.compare.crosscheck import Crosscheck
from crosscheck.engines.engine import ENGINES
from crosscheck.report.render import as_json, markdown
from crosscheck.report.table import Report
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.files import write_files
from newton_euler.model.source_file import SourceError, read_content

PLAIN = re.compile(r"[\w:/.-]+", re.ASCII)
"""Addresses of entities whose names need no escapes."""

MOMENT = re.compile(r"(?:(.*) at )?(\S+) s")
"""Pattern of the place of a check of runs: a body or joint, and a time."""

RECORDS = {
    "crosscheck": ("summary.json",),
    "benchmark": ("bench.json", "rhs.json", "batch.json", "sensitivities.json"),
    "load table": ("loads.json",),
    "modal analysis": ("modes.json",),
    "workspace": ("workspace.json",),
    "fault search": ("faults.json",),
    "fit": ("identify.json",),
}
"""Files that record of which model the results in a folder are, by the kind of the results."""


def write(result: Crosscheck, report: Report, folder: Path, recording: Path, name: str) -> list[Path]:
    """Write the runs, the summary and the Rerun recording, all of them or none.

    The summary is removed first and comes back last, so that a folder that has one is complete wherever
    a process that wrote to it was killed. What an earlier crosscheck left in the folder of other engines is
    removed, and a recording if this one goes elsewhere.

    Args:
        report: on the result.
        recording: file that the recording goes to.
        name: of the recording where nothing else is asked for.

    Raises:
        CrosscheckError: naming the path that cannot be written.
    """
    from crosscheck.recording.log import log_run, recorded

    made = {folder / f"{name}.npz": run.archive() for name, run in result.trajectories.items()}
    made[recording] = recorded(log_run, *to_record(result, report))
    beside = {path: content for path, content in made.items() if path.parent == folder}
    summary = folder / "summary.json"
    others = {*ENGINES, *(engine.name for engine in result.engines)} - result.trajectories.keys()
    stale = [summary, *(folder / f"{name}.npz" for name in others)]
    if recording != (usual := folder / f"{name}.rrd"):
        stale.append(usual)
    write_files({summary: as_json(result.summary(), report, beside), **made}, stale)
    runs = [path for path in made if path != recording]
    return [*runs, summary, recording]


def to_record(result: Crosscheck, report: Report) -> tuple[Any, ...]:
    """Return the arguments of `crosscheck.recording.log.log_run` for a crosscheck and the report on it.

    Bodies and joints that tables name are links to what is drawn of the first engine.
    """
    mechanism, first = result.scene.mechanism, next(iter(result.trajectories), "")
    links = {name: f"recording://joints/{first}/{name}" for name in mechanism.joint_names}
    links |= {name: f"recording://mechanism/{first}/{name}" for name in mechanism.body_names[1:]}
    links = {name: address for name, address in links.items() if PLAIN.fullmatch(address)}
    word, found = report.headline
    text = f"# {word}\n\n" if word else ""
    text += markdown(replace(report, title="", verdict=found, parts=report.summary), links=links)
    tolerances = {(row.quantity, *row.between): row.tolerance for row in result.checks}
    return result.scene, result.trajectories, text, result.title, tolerances, list(_moments(result.checks))


def _moments(rows: Sequence[Check]) -> Iterator[tuple[float, str]]:
    """Times, s, at which levels of the runs are worst, and what is worst there."""
    for level in OF_RUNS:
        at_level = [row for row in rows if row.level == level and row.judged]
        worst = max(at_level, key=lambda row: row.tolerance_ratio, default=None)
        if worst and (found := MOMENT.fullmatch(worst.where)):
            place = ", ".join(filter(None, [found[1], worst.quantity]))
            text = f"{level}: {place}: {worst.value:.1e}, allowed {worst.tolerance:.0e}"
            yield float(found[2]), text


def own_name(source: str) -> str:
    """Name of the folder and of the recording of a scene: its own, or its file's without suffix."""
    return Path(source).stem.strip(".") or "scene"


def usual_folder(parent: Path, source: str, results: str) -> Path:
    """Return the folder in `parent` for results of a model, by its name or its file's without suffix.

    Raises:
        CrosscheckError: if the folder has results of another model.
    """
    folder = parent / own_name(source)
    check_own(folder, [source], results)
    return folder


def record(source: str, options: Mapping[str, str]) -> bytes:
    """JSON that records of which model the results in a folder are."""
    return (json.dumps({"source": source, "options": dict(options)}, indent=1) + "\n").encode()


def check_own(folder: Path, sources: Sequence[str], results: str = "crosscheck") -> None:
    """Raise `CrosscheckError` if a folder has results of others than these models, in this order.

    Paths of earlier results are taken as seen from here. Trajectories beside nothing that says whose they
    are may be anybody's.

    Args:
        results: a key of `RECORDS`.
    """
    option = "--save" if results == "modal analysis" else "--output"
    elsewhere = f"name another folder ({option}), or this one to overwrite it"
    earlier = [found for name in RECORDS[results] if (found := _sources(folder / name))]
    # what begins with a dot was never ended
    runs = [path for path in folder.glob("*.npz") if not path.name.startswith(".")]
    if results == "crosscheck" and runs and not earlier:
        raise CrosscheckError(f"{folder} holds trajectories of an unknown model; {elsewhere}")
    for known in earlier:
        if list(map(os.path.realpath, known)) != list(map(os.path.realpath, sources)):
            raise CrosscheckError(
                f"{folder} holds a {results} of {' against '.join(known)}, not of "
                f"{' against '.join(sources)}; {elsewhere}"
            )


def _sources(path: Path) -> list[str]:
    """The models that results are of; none if the file is none of results, or is too large to be."""
    try:
        found = json.loads(read_content(path, "result_size"))
    except (SourceError, ValueError, RecursionError):
        return []
    models = [found] if isinstance(found, dict) else []
    if models and isinstance(found.get("models"), list):
        models = [model for model in found["models"] if isinstance(model, dict)]
    return [str(model.get("source") or "an unknown model") for model in models]
