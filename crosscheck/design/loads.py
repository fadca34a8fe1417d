"""Design loads: run the load cases of a scene, and write the loads of joints and actuators of every case.

A load is a force or torque at a joint or of an actuator. A load case is a run of the scene with certain
options, or the scene held at rest. The envelope has the largest load over all cases. The results are tables,
two CSVs, a plot and a recording.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from crosscheck.compare.activity import watched
from crosscheck.compare.runs import nothing_moves
from crosscheck.compare.singularity import SingularConfigurations, find_singular_configurations
from crosscheck.design.load_plots import load_figure
from crosscheck.design.load_report import CaseNotes, CoarsePeak, load_report, negligible_force
from crosscheck.design.wind_validity import wind_ranges
from crosscheck.engines.engine_runs import Stop, collecting_errors, stops_text
from crosscheck.library import option_values
from crosscheck.report.plots import png
from crosscheck.report.render import as_json, markdown
from crosscheck.report.table import Report
from crosscheck.support.files import check_writable, write_files
from crosscheck.support.time_limits import limited
from newton_euler.analysis.linear.linear_model import label
from newton_euler.analysis.loads.envelope import LoadEnvelope, LoadRange, joint_loads, load_envelope
from newton_euler.analysis.loads.rest import HeldWind, rest_case, wind_at_peak
from newton_euler.model.scene import OUTPUTS, Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.reading.import_report import ImportedElement, ImportReport
from newton_euler.runs.assemble import initial_state, measured_coordinate
from newton_euler.runs.simulate import simulate

MAX_PEAK_EXCESS = 0.005
"""Relative excess of a peak force between outputs over the outputs, above which the output period counts as
long: the tables print forces to three digits."""

MIN_JUDGED_FORCE = 0.01
"""Peak force of a joint, relative to the largest one, below which its peak is not judged."""


class LoadCase(NamedTuple):
    """One load case.

    Attributes:
        options: options of the scene as the user set them, by name.
        scene: the scene with these options.
        import_report: how the model file was imported; None if the scene is not from a model file.
    """

    options: Mapping[str, str]
    scene: Scene
    import_report: ImportReport | None


class Loads(NamedTuple):
    """Results of load cases.

    Attributes:
        report: tables of loads.
        written: the files; the recording is the last one.
        acting: by case, elements of the model file that would have acted and are not simulated.
    """

    report: Report
    written: list[Path]
    acting: Mapping[str, Sequence[ImportedElement]]


def loads(
    source: str,
    cases: Mapping[str, LoadCase],
    at_rest: bool,
    folder: Path,
    progress: Callable[[str], None],
) -> Loads:
    """Run load cases and write their loads to a folder.

    Args:
        source: name or file of the model.
        cases: load cases by name. All scenes have the same mechanism.
        at_rest: True to hold the mechanism at rest in its initial pose, False to simulate the scene.
        folder: where `loads.csv`, `cases.csv`, `loads.json`, `loads.png` and `loads.rrd` are written.
        progress: called with the name of each stage.

    Raises:
        CrosscheckError: naming the path that cannot be written, or the case that takes too long.
        NewtonEulerError: for a scene that cannot be simulated.
    """
    from crosscheck.recording.log import log_run
    from crosscheck.recording.stream import recorded

    names = ("loads.csv", "cases.csv", "loads.json", "loads.png", "loads.rrd")
    table, case_table, results, plot, recording = (folder / name for name in names)
    check_writable(table, case_table, results, plot, recording)
    # Runs, and elements of the model file, such as contacts, that would have acted in them
    runs, acting = dict[str, Trajectory](), dict[str, list[ImportedElement]]()
    singular = dict[str, str]()  # singular configurations of the runs, in words
    at_peak = dict[str, tuple[Scene, list[HeldWind]]]()  # of rest: constant winds, and what they stand for
    for name, (_, scene, import_report) in cases.items():
        with limited(f"case {name}", "a shorter duration, or fewer cases", progress):
            complete = replace(scene, outputs=frozenset(OUTPUTS))  # with all kinds of outputs
            if at_rest:
                at_peak[name] = wind_at_peak(scene)
                runs[name] = rest_case(at_peak[name][0])
            else:
                runs[name] = simulate(complete)
            if import_report and (found := watched(scene, import_report, runs[name]).acting):
                acting[name] = found
        if not at_rest and (text := _singular_text(scene, runs[name], progress)):
            singular[name] = text
    # The envelope takes axes of joints from the mechanism, which is the same in all cases
    first_scene = next(iter(cases.values())).scene
    envelope = load_envelope(first_scene, runs)
    envelopes = {name: load_envelope(first_scene, {name: run}) for name, run in runs.items()}
    # Notes and the report
    notes = CaseNotes(
        options={name: option_values(source, case.options) for name, case in cases.items()},
        starts={name: _start(case.scene) for name, case in cases.items()},
        motionless=[] if at_rest else [n for n, run in runs.items() if nothing_moves({n: run}, first_scene)],
        held_winds={name: held for name, (_, held) in at_peak.items()},
        winds={
            name: wind_ranges(at_peak[name][0] if at_rest else case.scene, runs[name])
            for name, case in cases.items()
        },
        acting=acting,
        coarse={name: peak for name, run in runs.items() if (peak := coarse_peak(first_scene, run))},
        singular=singular,
        from_model_file=any(case.import_report is not None for case in cases.values()),
    )
    report = load_report(first_scene, envelope, envelopes, at_rest, notes)
    progress("plot and recording")
    recorded_runs = recorded(log_run, first_scene, runs, markdown(report), report.title)
    shown = {
        plot: png(load_figure(first_scene, runs, negligible_force(first_scene, envelope))),
        recording: recorded_runs,
    }
    data = {
        "scene": first_scene.name,
        "source": source,
        "at_rest": at_rest,
        "cases": list(cases),
        "options": {name: dict(case.options) for name, case in cases.items()},
        "option_values": notes.options,
        "starts": {name: {at: x for at, (x, _) in each.items()} for name, each in notes.starts.items()},
        "envelope": [asdict(each) for each in _ranges(envelope)],
        "loads_of_cases": {name: [_of_case(each) for each in _ranges(envelopes[name])] for name in cases},
        "winds": {name: [each._asdict() for each in found] for name, found in notes.winds.items()},
        "held_winds": {name: [held._asdict() for held in each] for name, each in notes.held_winds.items()},
        "singular": singular,
        "not_simulated": {name: [asdict(entry) for entry in entries] for name, entries in acting.items()},
    }
    texts = {
        table: envelope.to_csv().encode(),
        case_table: _cases_csv(envelope, envelopes).encode(),
        results: as_json(data, report, shown),
    }
    write_files({**texts, **shown})
    return Loads(report, [table, case_table, results, plot, recording], acting)


def _singular_text(scene: Scene, run: Trajectory, progress: Callable[[str], None]) -> str:
    """Describe the singular configurations that a run starts in or passes, or why they are not known.

    The text is "" if there are none.
    """
    what, stops = "searching singular configurations", list[Stop]()
    found: SingularConfigurations | None = None
    with collecting_errors(what, stops), limited(what, "a shorter duration", progress):
        found = find_singular_configurations(scene, run)
    if found:
        return f"{found}; the loads from then on are those of one branch of several"
    return stops_text(stops)


def coarse_peak(scene: Scene, run: Trajectory) -> CoarsePeak | None:
    """Find the joint whose largest force exceeds its outputs most; None if the output period is short enough.

    The force between outputs is estimated by the vertex of the parabola through an output and its neighbors.
    """
    found = []
    for load, values in joint_loads(scene, run).items():
        if load.quantity == "force":
            before, peak, after = values[:-2], values[1:-1], values[2:]
            # a neighbor below half of the peak is a jump, as at a step of an input, which has no vertex
            is_peak = (peak > np.maximum(before, after)) & (np.minimum(before, after) > 0.5 * peak)
            rise = (before - after)[is_peak] ** 2 / (8.0 * (2.0 * peak - before - after)[is_peak])
            vertex = float(np.max(peak[is_peak] + rise, initial=0.0))
            found.append((vertex - float(values.max()), vertex, load.element))
    largest = max((vertex for _, vertex, _ in found), default=0.0)
    excess, vertex, joint = max(found, default=(0.0, 0.0, ""))
    is_coarse = excess > MAX_PEAK_EXCESS * vertex and vertex > MIN_JUDGED_FORCE * largest
    return CoarsePeak(joint, excess / (vertex - excess)) if is_coarse else None


def _start(scene: Scene) -> dict[str, tuple[float, str]]:
    """Return the coordinates of the initial pose that control laws act on, m or rad, with their units."""
    mechanism, state = scene.mechanism, initial_state(scene)
    return {
        label(mechanism.coordinate_name(law.key)): (
            measured_coordinate(scene, state, law.key)[0],
            "m" if mechanism.is_slide(*law.key) else "rad",
        )
        for law in scene.control
    }


def _ranges(envelope: LoadEnvelope) -> tuple[LoadRange, ...]:
    """Return the load ranges of all joints and actuators."""
    return (*envelope.joints, *envelope.actuators)


CASE_COLUMNS = tuple(field.name for field in fields(LoadRange) if not field.name.endswith("_case"))
"""Attributes of a load range of one case: all of `LoadRange` but the names of cases."""


def _of_case(load: LoadRange) -> dict[str, str | float]:
    """Return the attributes `CASE_COLUMNS` of a load range of one case."""
    return {name: getattr(load, name) for name in CASE_COLUMNS}


def _cases_csv(envelope: LoadEnvelope, envelopes: Mapping[str, LoadEnvelope]) -> str:
    """Return the loads of every case as CSV.

    A row is one load of one case. The column `governs` is 1 in the case that has the largest magnitude of
    the load over all cases, and 0 in the others.

    Args:
        envelope: loads over all cases.
        envelopes: loads of each case.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["case", *CASE_COLUMNS, "governs"])
    for name, each in envelopes.items():
        for load, over_all in zip(_ranges(each), _ranges(envelope), strict=True):
            writer.writerow([name, *_of_case(load).values(), int(over_all.governing[0] == name)])
    return text.getvalue()
