"""Result folders: write the files of a crosscheck, and protect the results of another model.

A crosscheck simulates one model in several engines (simulators) and compares them. Its folder has the run of
each engine (ENGINE.npz), a summary with all checks (summary.json), test cases for CI servers (junit.xml), and
a 3-D recording (NAME.rrd). Results in a folder are protected: the results of another model may only overwrite
them if the user names the folder.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from crosscheck.compare.check import LEVELS_OF_RUNS, Check
from crosscheck.compare.result import EngineComparison
from crosscheck.engines.registry import NAME, names
from crosscheck.report.render import as_json, markdown
from crosscheck.report.run import junit
from crosscheck.report.table import Report
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.files import write_files
from newton_euler.model.source_file import SourceError, read_content

LINKABLE = re.compile(r"[\w:/.-]+", re.ASCII)
"""Pattern of addresses in a recording that a link can contain without escapes."""

SUMMARY, TEST_CASES = "summary.json", "junit.xml"
"""Files of a crosscheck with all numbers, and with the test cases that CI servers show."""

PLACE_AND_TIME = re.compile(r"(?:(?P<place>.*) at )?(?P<time>\S+) s")
"""Pattern of `Check.where` in checks of runs: an optional body or joint, and a time ("rocker at 0.5 s")."""

MODEL_RECORDS = {
    "crosscheck": (SUMMARY,),
    "benchmark": ("bench.json", "rhs.json", "batch.json", "sensitivities.json"),
    "load table": ("loads.json",),
    "drive table": ("drives.json",),
    "modal analysis": ("modes.json",),
    "comparison of controllers": ("controllers.json",),
    "workspace": ("workspace.json",),
    "solar day": ("sun.json",),
    "solar year": ("year.json",),
    "fault search": ("faults.json",),
    "fit": ("identify.json",),
    "tuning": ("tune.json",),
    "regression test": ("regress.json",),
    "comparison of files": ("diff.json",),
    "comparison of importers": ("importers.json",),
}
"""Files in a result folder that contain the name of the model, by the kind of the results."""


def write(
    result: EngineComparison,
    report: Report,
    folder: Path,
    recording: Path,
    name: str,
    allow_reduced: bool = False,
) -> list[Path]:
    """Write runs, summary, test cases and the Rerun recording of a crosscheck, all of them or none.

    An earlier summary is removed first, and the new one is written last. A folder with a summary is therefore
    complete, even if a process that wrote to the folder was killed. Runs of other engines, which an earlier
    crosscheck wrote to the folder, are removed, and its recording if the new one has another path.

    Args:
        result: result of the crosscheck.
        report: report on the result.
        folder: folder for the files.
        recording: path of the recording.
        name: name of the results; the default path of the recording is `folder`/NAME.rrd.
        allow_reduced: whether agreement on a reduced model counts as agreement.

    Returns:
        The paths of the runs, the summary, the test cases and the recording.

    Raises:
        CrosscheckError: if a file cannot be written; the message names the path.
    """
    from crosscheck.recording.log import log_run
    from crosscheck.recording.stream import recorded

    contents = {folder / f"{engine}.npz": run.archive() for engine, run in result.trajectories.items()}
    contents[recording] = recorded(log_run, *to_record(result, report))
    in_folder = {path: content for path, content in contents.items() if path.parent == folder}
    summary, test_cases = folder / SUMMARY, folder / TEST_CASES
    # Files of earlier results
    without_run = {*names(), *_earlier_runs(summary)} - result.trajectories.keys()
    stale = [summary, *(folder / f"{engine}.npz" for engine in without_run)]
    default_recording = folder / f"{name}.rrd"
    if recording != default_recording:
        stale.append(default_recording)
    # The first of the files, the summary, is written last
    texts = {
        summary: as_json(result.summary(), report, in_folder),
        test_cases: junit(result, report, name, allow_reduced).encode(),
    }
    write_files(texts | contents, stale)
    runs = [path for path in contents if path != recording]
    return [*runs, summary, test_cases, recording]


def to_record(result: EngineComparison, report: Report) -> tuple[Any, ...]:
    """Return the arguments of `crosscheck.recording.log.log_run` for a crosscheck and the report on it.

    In the text, names of bodies and joints are links to the first engine's body or joint in the 3-D view.
    """
    mechanism, first_engine = result.scene.mechanism, next(iter(result.trajectories), "")
    links = {name: f"recording://joints/{first_engine}/{name}" for name in mechanism.joint_names}
    links |= {name: f"recording://mechanism/{first_engine}/{name}" for name in mechanism.body_names[1:]}
    links = {name: address for name, address in links.items() if LINKABLE.fullmatch(address)}
    outcome, verdict = report.headline  # "AGREE" and the rest of the line
    text = f"# {outcome}\n\n" if outcome else ""
    text += markdown(replace(report, title="", verdict=verdict, parts=report.summary), links=links)
    tolerances = {(check.quantity, *check.between): check.tolerance for check in result.checks}
    moments = list(_worst_moments(result.checks))
    directions = None  # no further unit vectors to draw, such as the direction of the sun
    return (
        result.scene,
        result.trajectories,
        text,
        result.title,
        tolerances,
        moments,
        directions,
        # judgements of the model file's run with its own settings, and of logs
        result.own_run,
        result.logs,
    )


def _worst_moments(checks: Sequence[Check]) -> Iterator[tuple[float, str]]:
    """Yield the time, s, and a text of the check closest to failing, for each level of checks of runs."""
    for level in LEVELS_OF_RUNS:
        at_level = [check for check in checks if check.level == level and check.judged]
        worst = max(at_level, key=lambda check: check.tolerance_ratio, default=None)
        if worst and (where := PLACE_AND_TIME.fullmatch(worst.where)):
            place = ", ".join(filter(None, [where["place"], worst.quantity]))
            text = f"{level}: {place}: {worst.value:.1e}, allowed {worst.tolerance:.0e}"
            yield float(where["time"]), text


def results_name(source: str) -> str:
    """Return the name of a model's results: the name of the scene, or of its file without the suffix."""
    return Path(source).stem.strip(".") or "scene"


def usual_folder(parent: Path, source: str, results: str) -> Path:
    """Return the default folder for the results of a model.

    Args:
        parent: parent of the folder.
        source: name or file of the model; the folder gets this name, without the suffix of the file.
        results: kind of the results, a key of `MODEL_RECORDS`.

    Raises:
        CrosscheckError: if the folder has results of another model.
    """
    folder = parent / results_name(source)
    check_no_other_results(folder, [source], results)
    return folder


def record(source: str, options: Mapping[str, str]) -> bytes:
    """Make the content of a JSON file with the name of the model, and its options, of results in a folder."""
    return (json.dumps({"source": source, "options": dict(options)}, indent=1) + "\n").encode()


def check_no_other_results(folder: Path, sources: Sequence[str], results: str = "crosscheck") -> None:
    """Raise `CrosscheckError` if a folder has results of other models, or runs without a record of the model.

    Args:
        folder: the folder.
        sources: names or files of the models, in their order; paths are relative to the current folder.
        results: kind of the results, a key of `MODEL_RECORDS`.
    """
    elsewhere = "name another folder (--output), or this one to overwrite it"
    earlier = [models for name in MODEL_RECORDS[results] if (models := _sources(folder / name))]
    # files whose names begin with a dot are unfinished
    runs = [path for path in folder.glob("*.npz") if not path.name.startswith(".")]
    if results == "crosscheck" and runs and not earlier:
        raise CrosscheckError(f"{folder} holds trajectories of an unknown model; {elsewhere}")
    for models in earlier:
        if list(map(os.path.realpath, models)) != list(map(os.path.realpath, sources)):
            raise CrosscheckError(
                f"{folder} holds a {results} of {' against '.join(models)}, not of "
                f"{' against '.join(sources)}; {elsewhere}"
            )


def _sources(path: Path) -> list[str]:
    """Read the names or files of the models that a result file is about; empty if it is no result file."""
    content = _content(path)
    if content is None:
        return []
    # The file is about one model, or about two that are compared
    models = [content]
    if isinstance(content.get("models"), list):
        models = [model for model in content["models"] if isinstance(model, dict)]
    return [str(model.get("source") or "an unknown model") for model in models]


def _earlier_runs(path: Path) -> set[str]:
    """Read the names of the engines of a summary, also of engines that are no longer installed."""
    engines = (_content(path) or {}).get("engines")
    return {name for name in engines if NAME.fullmatch(name)} if isinstance(engines, dict) else set()


def _content(path: Path) -> dict[str, Any] | None:
    """Read a result file; None if there is none, or if it is no JSON of a result."""
    try:
        content = json.loads(read_content(path, "result_size"))  # at most as large as the limit of this name
    except (SourceError, ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) else None
