"""Files of a sweep's findings: JSON, plots and a recording for the Rerun viewer.

A sweep simulates a scene many times with varied parameters. The recording shows the nominal run, the extreme
runs, and envelopes over time; these runs are simulated again, since a sweep does not keep whole runs.
"""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from crosscheck.report.render import as_json, markdown
from crosscheck.report.table import Report
from crosscheck.support.files import check_writable, write_files
from crosscheck.sweeps.expressions import Outputs
from crosscheck.sweeps.findings import Findings
from crosscheck.sweeps.kept_numbers import QUANTILE_LEVELS, analyzed, sample_blocks
from crosscheck.sweeps.pictures import MAX_SCATTER_POINTS, pictures
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.runs.variation import own_values, units_of
from newton_euler.scalars import Array

if TYPE_CHECKING:
    from crosscheck.sweeps.recording import Envelope

FINDINGS_FILE = "sweep.json"
"""Name of the file with all findings."""

RECORDING_FILE = "sweep.rrd"
"""Name of the file with the Rerun recording."""

SWEEP_FILES = (FINDINGS_FILE, RECORDING_FILE, "tornado.png", "histograms.png", "scatter.png")
"""Names of the files that `write` can write: all findings, the recording, and plots."""

ENVELOPE_RUNS = 100
"""Number of runs in the envelopes over time."""

MAX_RECORDED_EXTREMES = 4
"""Largest number of extreme runs in a recording."""


def write(found: Findings, made: Report, folder: Path) -> list[Path]:
    """Write the findings next to the Zarr store: JSON, plots and a recording, all files or none.

    Args:
        found: the findings.
        made: their report, which the JSON file contains.
        folder: folder of the files. Files of an earlier sweep that are not written again are removed.

    Returns:
        Paths of the written files.

    Raises:
        CrosscheckError: naming the path that cannot be written.
    """
    from crosscheck.recording.stream import recorded
    from crosscheck.sweeps.recording import log_sweep

    paths = [folder / name for name in SWEEP_FILES]
    check_writable(*paths)
    runs = analyzed(found.swept)
    points = sample_blocks(len(runs), MAX_SCATTER_POINTS)
    inputs, plan = found.swept.inputs(runs[points]), found.swept.plan
    units = units_of(plan.scene, plan.samples.names)
    drawn = pictures(found.effects, points, inputs, units, found.nominal)
    files = {folder / name: content for name, content in drawn.items()}
    to_log = to_record(found, made)
    if to_log.runs:
        files[folder / RECORDING_FILE] = recorded(log_sweep, *to_log)
    whole = {folder / FINDINGS_FILE: as_json(_data(found), made, files), **files}
    write_files(whole, [path for path in paths if path not in whole])
    return list(whole)


class RecordingContent(NamedTuple):
    """Arguments of `crosscheck.sweeps.recording.log_sweep` after the recording.

    Attributes:
        scene: scene with nominal values.
        runs: the nominal run and the extreme runs by name, except failed ones.
        envelopes: for each kept output, the time series of the number that varies most, over many runs.
        text: summary of the report, Markdown.
        title: title of the report.
    """

    scene: Scene
    runs: dict[str, Trajectory]
    envelopes: list[Envelope]
    text: str
    title: str


def to_record(found: Findings, made: Report) -> RecordingContent:
    """Return what `crosscheck.sweeps.recording.log_sweep` logs of the findings and their report."""
    runs, envelopes = _repeated_runs(found)
    text = markdown(replace(made, parts=made.summary))
    return RecordingContent(found.swept.plan.scene, runs, envelopes, text, made.title)


def _data(found: Findings) -> dict[str, object]:
    """Return all findings, for JSON."""
    plan = found.swept.plan
    return {
        "scene": plan.scene.name,
        "source": plan.scene.name,  # the model, by the key that all result files have
        "options": dict(found.options),
        "vary": {", ".join(names): str(each) for names, each in plan.samples.groups},
        "sampling": plan.samples.sampling,
        "runs": plan.samples.runs,
        "seed": plan.samples.seed,
        "keep": list(plan.keep),
        "control": dict(plan.control),
        "errors": len(found.swept.failed_runs),
        "known": {each.label: int(np.isfinite(each.values).sum()) for each in found.scalars},
        "quantiles": {
            each.label: dict(
                zip(map("{:g}".format, QUANTILE_LEVELS.values()), each.quantiles.tolist(), strict=True)
            )
            for each in found.scalars
        },
        "effects": {scalar.label: [asdict(each) for each in effects] for scalar, effects in found.effects},
        "checked": [asdict(each) for each in found.checked],
        "notes": found.notes,
    }


def _repeated_runs(found: Findings) -> tuple[dict[str, Trajectory], list[Envelope]]:
    """Repeat the nominal run, the extreme runs and a sample of runs, with all output times.

    Returns:
        The attributes `runs` and `envelopes` of `RecordingContent`.
    """
    from crosscheck.sweeps.recording import Envelope

    # Parameters of all repeated runs: first the nominal run and the extreme runs, which have names
    plan = found.swept.plan
    extremes = list(
        dict.fromkeys(scalar.extreme(largest) for scalar, _ in found.effects for largest in (True, False))
    )[:MAX_RECORDED_EXTREMES]
    names = ["nominal", *(f"run {run}" for run in extremes)]
    nominal_values = own_values(plan.scene, plan.samples.names)
    inputs = found.swept.inputs(np.array([*extremes, *sample_blocks(plan.samples.runs, ENVELOPE_RUNS)]))
    values = {name: np.append(nominal_values[name], of_runs) for name, of_runs in inputs.items()}
    # Simulate as many runs at a time as fit into memory; the first batch contains all runs with names.
    # The pruned scene saves only the outputs, such as velocities, that the kept numbers need
    scene = replace(plan.pruned_scene, output_period=plan.scene.output_period)
    kept = {each.name: each for each in plan.kept}
    runs: dict[str, Trajectory] = {}
    parts: list[list[Array]] = []  # time series (runs of the batch, n) by batch and kept number
    size = max(len(names), plan.runs_per_batch(scene))
    for first in range(0, len(next(iter(values.values()))), size):
        part = {name: of_runs[first : first + size] for name, of_runs in values.items()}
        batch = plan.batch(part, scene, threads=None)
        if not first:
            runs = {name: batch[k] for k, name in enumerate(names) if k not in batch.errors}
        outputs = Outputs.of_batch(plan.scene, batch)
        # copies, since a view would keep the whole batch in memory
        parts.append(
            [kept[each.variable].time_series_of(outputs, each.index).copy() for each, _ in found.effects]
        )
    # Time series of the sample and of the runs with names
    envelopes = []
    for k, (scalar, _) in enumerate(found.effects):
        time_series = np.concatenate([part[k] for part in parts])
        lines = {name: line for name, line in zip(names, time_series, strict=False) if name in runs}
        envelopes.append(Envelope(scalar.heading, scene.times, time_series[len(names) :], lines))
    return runs, envelopes
