"""Design loads: run the load cases of a scene, and write the largest loads of joints and actuators.

A load is a force or torque at a joint or of an actuator. A load case is a run of the scene with certain
settings, or the scene held at rest. The results are tables, a CSV, a plot and a recording.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from crosscheck.compare.activity import reduced_model_text, watched
from crosscheck.compare.runs import nothing_moves
from crosscheck.report.plots import own_style, png
from crosscheck.report.render import as_json, markdown
from crosscheck.report.run import undetermined_lines
from crosscheck.report.table import (
    Cell,
    Column,
    Lines,
    Part,
    Report,
    Rows,
    Table,
    number_columns,
    text_columns,
)
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.files import check_writable, write_files
from crosscheck.support.palette import palette
from crosscheck.support.time_limits import limited
from newton_euler.analysis.loads.envelope import (
    Load,
    LoadEnvelope,
    LoadRange,
    joint_loads,
    load_envelope,
    rest_case,
)
from newton_euler.model.scene import OUTPUTS, Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.reading.import_report import ImportedElement, ImportReport
from newton_euler.runs.simulate import simulate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CASE_NAME = re.compile(r"[A-Za-z0-9_.\-]+")
"""Allowed names of load cases."""

UNNAMED_CASE = "run"
"""Name of the only case if the user names no case."""

MAX_PLOTTED_JOINTS = 12
"""Largest number of joints in the plot: the joints with the largest forces."""

LOAD_ROUND_OFF = 1e-9
"""Loads below this fraction of the largest load and of the weight on Earth are printed as 0."""

STANDARD_GRAVITY = 9.81
"""m/s^2, rounded acceleration of gravity on Earth, for the weight that scales `LOAD_ROUND_OFF`."""

NOT_UNIQUE = "stiffness decides how these joints share loads: the tables show one solution of many"
"""Note on joints whose reactions redundant constraints leave undetermined."""

EXCITE = "; --set excitation=on moves joints of model files and drives their actuators"
"""Advice to the user if nothing moves."""

GOVERNED_BY = Column("governed by", below=True)
"""Column of tables with the load case and time of the largest load; below the others on narrow screens."""

LOAD_COMPONENTS = {"force": ("axial force", "shear force"), "torque": ("axial torque", "bending torque")}
"""Components of forces and torques along and across the axis, for joints with one axis, by quantity."""


def parse_cases(given: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Parse texts `NAME:OPTION=VALUE,OPTION=VALUE` of load cases.

    Returns:
        The settings (`OPTION=VALUE`, ...) of each case, by the name of the case. Without texts there is one
        case, `UNNAMED_CASE`, without settings.

    Raises:
        CrosscheckError: naming the case at fault.
    """
    cases: dict[str, tuple[str, ...]] = {}
    for case in given:
        name, _, settings = case.partition(":")
        if not CASE_NAME.fullmatch(name):
            needed = "letters, digits, _, . and - before the colon"
            raise CrosscheckError(f"--case {case!r} is not of the form NAME:OPTION=VALUE; needed: {needed}")
        if name in cases:
            raise CrosscheckError(f"--case {name} is given twice")
        cases[name] = tuple(filter(None, settings.split(",")))
    return cases or {UNNAMED_CASE: ()}


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
    models: Mapping[str, tuple[Scene, ImportReport | None]],
    at_rest: bool,
    folder: Path,
    progress: Callable[[str], None],
) -> Loads:
    """Run load cases and write their loads to a folder.

    Args:
        source: name or file of the model.
        models: by case, the scene and its import report (None if the scene is not from a model file). All
            scenes have the same mechanism.
        at_rest: True to hold the mechanism at rest in its initial pose, False to simulate the scene.
        folder: where `loads.csv`, `loads.json`, `loads.png` and `loads.rrd` are written.
        progress: called with the name of each stage.

    Raises:
        CrosscheckError: naming the path that cannot be written, or the case that takes too long.
        NewtonEulerError: for a scene that cannot be simulated.
    """
    from crosscheck.recording.log import log_run
    from crosscheck.recording.stream import recorded

    table, results, plot, recording = (folder / f"loads.{suffix}" for suffix in ("csv", "json", "png", "rrd"))
    check_writable(table, results, plot, recording)
    runs, acting = dict[str, Trajectory](), dict[str, list[ImportedElement]]()
    for name, (scene, import_report) in models.items():
        with limited(f"case {name}", "a shorter duration, or fewer cases", progress):
            complete = replace(scene, outputs=frozenset(OUTPUTS))  # with all kinds of outputs
            runs[name] = rest_case(scene) if at_rest else simulate(complete)
            # elements of the model file, such as contacts, that would have acted in the run
            if import_report and (found := watched(scene, import_report, runs[name]).acting):
                acting[name] = found
    # The envelope takes axes of joints from the mechanism, which is the same in all cases
    first_scene, _ = next(iter(models.values()))
    envelope = load_envelope(first_scene, runs)
    motionless = []
    if not at_rest:
        motionless = [name for name, run in runs.items() if nothing_moves({name: run}, first_scene)]
    report = _report(first_scene, envelope, at_rest, motionless, acting)
    progress("plot and recording")
    recorded_runs = recorded(log_run, first_scene, runs, markdown(report), report.title)
    shown = {plot: png(_figure(first_scene, runs)), recording: recorded_runs}
    data = {
        "scene": first_scene.name,
        "source": source,
        "at_rest": at_rest,
        "cases": list(models),
        "not_simulated": {name: [asdict(entry) for entry in entries] for name, entries in acting.items()},
    }
    write_files({table: envelope.to_csv().encode(), results: as_json(data, report, shown), **shown})
    return Loads(report, [table, results, plot, recording], acting)


def _report(
    scene: Scene,
    envelope: LoadEnvelope,
    at_rest: bool,
    motionless: list[str],
    acting: Mapping[str, Sequence[ImportedElement]],
) -> Report:
    """Make the report on design loads.

    Args:
        scene: scene of the first case.
        envelope: largest loads over all cases.
        at_rest: True if the mechanism is held at rest.
        motionless: names of cases in which nothing moves.
        acting: by case, elements that would have acted and are not simulated.
    """
    # Title, and verdict with the largest force
    named = envelope.cases != (UNNAMED_CASE,)
    cases = f"cases {', '.join(envelope.cases)}" if named else "initial pose" if at_rest else "its run"
    title = f"{scene.name}: loads {'at rest,' if at_rest else 'over'} {cases}"
    largest = max(_loads_of(envelope, "force"), key=lambda each: each.peak)
    negligible = _negligible_force(scene, envelope)
    verdict = f"largest force {largest.peak:.3g} N at joint {largest.element!r}, {_when(largest)}"
    if largest.peak <= negligible:
        verdict = "no joint carries a force"
    for case, entries in acting.items():
        verdict += f"; {f'case {case}: ' if named else ''}{reduced_model_text(entries)}"
    if acting:
        verdict = f"REDUCED MODEL: {verdict}"
    # Tables and notes
    parts: list[Part] = [
        _joint_table(envelope, "force", "N", negligible),
        _joint_table(envelope, "torque", "N m", negligible * scene.mechanism.size),
    ]
    if envelope.actuators:
        parts.append(_actuator_table(envelope))
    if motionless:
        where = f"cases {', '.join(motionless)}" if named else "the run"
        parts.append(Lines("", [f"nothing moves in {where}: these are loads at rest{EXCITE}"]))
    parts.extend(Lines("", [line, NOT_UNIQUE]) for line in undetermined_lines(scene))
    judged = Cell(text="", verdict="doubtful" if acting else "")  # the color of the verdict
    return Report(title, verdict, judged, parts, summary=parts)


def _loads_of(envelope: LoadEnvelope, quantity: str) -> list[LoadRange]:
    """Return the load ranges of a quantity, such as "force", for all joints and actuators that have it."""
    return [each for each in (*envelope.joints, *envelope.actuators) if each.quantity == quantity]


def _when(load: LoadRange) -> str:
    """Format the load case and the time of the largest load."""
    case, time = load.governing
    return f"{case} at {time:.4g} s"


def _negligible_force(scene: Scene, envelope: LoadEnvelope) -> float:
    """Compute the force, N, below which a force is round-off."""
    size = scene.mechanism.size
    weight = STANDARD_GRAVITY * sum(body.mass for body in scene.mechanism.bodies[1:])
    peaks = [each.peak for each in _loads_of(envelope, "force")]
    peaks += [each.peak / size for each in _loads_of(envelope, "torque")]
    return LOAD_ROUND_OFF * max(weight, *peaks)


def _joint_table(envelope: LoadEnvelope, quantity: str, unit: str, negligible: float) -> Table:
    """Tabulate peak forces or torques of joints, and the peaks of their components along and across the axis.

    Args:
        envelope: largest loads over all cases.
        quantity: "force" or "torque".
        unit: unit of the quantity.
        negligible: values up to this limit are printed as 0.
    """
    names = [part.removesuffix(f" {quantity}") for part in LOAD_COMPONENTS[quantity]]
    columns = [*text_columns("joint"), *number_columns(f"{quantity}, {unit}", *names, "rms"), GOVERNED_BY]
    known = {(each.element, each.quantity): each for each in envelope.joints}
    rows: Rows = []
    for load in _loads_of(envelope, quantity):
        components = [known.get((load.element, name)) for name in LOAD_COMPONENTS[quantity]]
        values = [load.peak, *(each.peak if each else None for each in components), load.rms]
        cells = ["" if value is None else f"{value if value > negligible else 0.0:.3g}" for value in values]
        rows.append([load.element, *cells, _when(load) if load.peak > negligible else ""])
    return Table("", columns, rows)


def _actuator_table(envelope: LoadEnvelope) -> Table:
    """Tabulate peak and rms forces of actuators, their peak speeds and powers, and their energies."""
    columns = [
        *text_columns("actuator"),
        *number_columns("force", "rms", "speed", "power, W", "energy, J"),
        GOVERNED_BY,
    ]
    rows: Rows = []
    for load in _loads_of(envelope, "actuator force"):
        speed, power, energy = (envelope.of(load.element, what) for what in ("speed", "power", "energy"))
        forces = [f"{value:.3g} {load.unit}" for value in (load.peak, load.rms)]
        motion = [f"{speed.peak:.3g} {speed.unit}", f"{power.peak:.3g}", f"{energy.peak:.3g}"]
        rows.append([load.element, *forces, *motion, _when(load)])
    return Table("", columns, rows)


@own_style()
def _figure(scene: Scene, runs: Mapping[str, Trajectory]) -> Figure:
    """Plot forces and torques of joints over time, one line per case.

    A case at rest has a single time, and is plotted as a dot.
    """
    from matplotlib.figure import Figure

    # The joints with the largest forces, in the order of the mechanism
    loads_of_cases = {case: joint_loads(scene, run) for case, run in runs.items()}
    largest_forces = {
        joint: max(float(loads[Load(joint, "force", "N")].max()) for loads in loads_of_cases.values())
        for joint in scene.mechanism.joint_names
    }
    chosen = sorted(largest_forces, key=lambda joint: -largest_forces[joint])[:MAX_PLOTTED_JOINTS]
    joints = [joint for joint in largest_forces if joint in chosen]
    # One row of plots per joint: force and torque
    figure = Figure(figsize=(9.0, 0.8 + 1.3 * len(joints)), layout="constrained")
    axes = figure.subplots(len(joints), 2, sharex=True, squeeze=False)
    colors = palette(list(runs))
    for row, joint in zip(axes, joints, strict=True):
        for ax, quantity, unit in zip(row, ("force", "torque"), ("N", "N m"), strict=True):
            for case, loads in loads_of_cases.items():
                mark = "." if len(runs[case].time) == 1 else ""
                values = loads[Load(joint, quantity, unit)]
                ax.plot(runs[case].time, values, color=colors[case], marker=mark, label=case)
            ax.set_ylim(bottom=0.0)
            ax.grid(alpha=0.3)
        row[0].set_ylabel(joint, fontsize="small")
    for ax, label in zip(axes[0], ("force, N", "torque, N m"), strict=True):
        ax.set_title(label, fontsize="medium")
    for ax in axes[-1]:
        ax.set_xlabel("time, s")
    axes[0, 0].legend(loc="best", fontsize="small")
    return figure
