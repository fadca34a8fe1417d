"""Drives of actuators: compare a catalog with the motion of a scene or of a CSV, and write the results."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from crosscheck.compare.activity import reduced_model_text, watched
from crosscheck.design.drive_plots import drive_figure
from crosscheck.design.drive_report import DriveResults, Requirements, drive_report
from crosscheck.report.plots import png
from crosscheck.report.render import as_json
from crosscheck.report.table import Report
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.files import write_files
from crosscheck.support.time_limits import limited
from newton_euler.analysis.loads.actuator_motions import ActuatorMotion, actuator_motions
from newton_euler.analysis.loads.drives import Drive, Sized, size
from newton_euler.analysis.loads.motion_files import motions_csv, read_motions
from newton_euler.model.armatures import Armature
from newton_euler.model.scene import Scene
from newton_euler.model.switched_forces import ElasticGear, JointFriction
from newton_euler.model.wind import WindLoad
from newton_euler.reading.import_report import ImportReport
from newton_euler.runs.simulate import simulate

DRIVE_FILES = ("drives.json", "drives.csv", "limits.csv", "demand.csv", "motion.csv", "drives.png")
"""Names of the result files."""


class Motions(NamedTuple):
    """Motions of actuators, from a run or a CSV.

    Attributes:
        name: name of the scene, or of the CSV without suffix.
        actuators: force and motion of each actuator.
        conditions: sentences on what the motion and its forces are.
        notes: sentences for the report.
        is_reduced: True if elements of the model file would have acted that are not simulated.
    """

    name: str
    actuators: tuple[ActuatorMotion, ...]
    conditions: tuple[str, ...]
    notes: tuple[str, ...] = ()
    is_reduced: bool = False


def motions_of_file(path: str) -> Motions:
    """Read the motions of actuators from a CSV; raises `SourceError`."""
    condition = f"forces and motion of {path}: loads, wind and friction are those of the tool that wrote it"
    return Motions(Path(path).stem, read_motions(path), (condition,))


def motions_of_scene(
    scene: Scene,
    options: Mapping[str, str],
    import_report: ImportReport | None,
    progress: Callable[[str], None],
) -> Motions:
    """Simulate a scene, and return the motions of its actuators.

    Args:
        scene: scene with control laws.
        options: options of the scene that were given.
        import_report: how the model file was imported; None if the scene is not from a model file.
        progress: called with the name of the stage.

    Raises:
        CrosscheckError: for a scene without actuators.
        NewtonEulerError: for a scene that cannot be simulated.
    """
    if not scene.control:
        raise CrosscheckError(f"scene {scene.name!r} has no actuators; needed: a control law at a joint")
    with limited("run", "a shorter duration", progress):
        run = simulate(replace(scene, outputs=frozenset({"velocities", "actuation"})))
    actuators = actuator_motions(scene, run)
    notes = list(_rotor_notes(scene))
    acting = watched(scene, import_report, run).acting if import_report else []
    if acting:
        notes.insert(0, f"REDUCED MODEL: {reduced_model_text(acting)}")
    return Motions(scene.name, actuators, tuple(_conditions(scene, options)), tuple(notes), bool(acting))


def _conditions(scene: Scene, options: Mapping[str, str]) -> Iterator[str]:
    """Yield sentences on the motion of a scene and on the forces that the actuators work against."""
    given = ", ".join(f"{name}={value}" for name, value in options.items())
    yield f"motion: a run of {scene.duration:g} s, {given if given else 'default options of the scene'}"
    weight = "weight" if np.any(scene.gravity) else "no weight"
    winds = [force.element for force in scene.forces if isinstance(force, WindLoad)]
    others = [force.element for force in scene.forces if not isinstance(force, WindLoad)]
    friction = [each for each in scene.forces if isinstance(each, JointFriction | ElasticGear)]
    parts = [weight, *(winds or ["no wind"]), *others, *([] if friction else ["no friction of joints"])]
    yield f"forces in the run: {', '.join(parts)}"


def _rotor_notes(scene: Scene) -> list[str]:
    """Name the actuators whose force accelerates a rotor of the scene: it must not count twice."""
    driven = {law.key for law in scene.control}
    rotors = [each for each in scene.armatures if isinstance(each, Armature) and each.key in driven]
    names = ", ".join(scene.mechanism.coordinate_labels[each.key] for each in rotors)
    note = f"the forces accelerate rotor inertias of the scene at {names}: leave those out of the catalog"
    return [note] if rotors else []


def size_all(
    motions: Motions, catalog: str, drives: Sequence[Drive], requirements: Requirements
) -> DriveResults:
    """Compare each drive of a catalog with the motion of each actuator."""
    sized = {
        (drive.name, motion.name): size(drive, motion) for motion in motions.actuators for drive in drives
    }
    return DriveResults(
        motions.name,
        catalog,
        motions.actuators,
        drives,
        sized,
        requirements,
        motions.conditions,
        motions.notes,
    )


def write_drives(
    found: DriveResults, folder: Path, source: str, options: Mapping[str, str]
) -> tuple[Report, list[Path]]:
    """Write the results to a folder, and return the report and the paths.

    Args:
        found: the results.
        folder: where `DRIVE_FILES` are written.
        source: name or file of the model, or the CSV of the motion.
        options: options of the scene.
    """
    report = drive_report(found)
    rows = [_row(found, each) for motion in found.motions for each in _of_actuator(found, motion.name)]
    demands = [
        {
            "actuator": motion.name,
            "unit": "N" if motion.is_slide else "N m",
            **found.demands[motion.name]._asdict(),
        }
        for motion in found.motions
    ]
    limits = [
        {
            "drive": each.drive.name,
            "actuator": each.actuator,
            **limit._asdict(),
            "margin": limit.margin,
        }
        for motion in found.motions
        for each in _of_actuator(found, motion.name)
        for limit in each.limits
    ]
    data = {
        "source": source,
        "options": dict(options),
        "catalog": found.catalog,
        "requirements": found.requirements._asdict(),
        "demand": demands,
        "drives": rows,
        "limits": limits,
        "catalog_rows": [asdict(drive) for drive in found.drives],
        "conditions": list(found.conditions),
        "notes": list(found.notes),
    }
    results, table, limit_table, demand_table, motion_table, plot = (folder / name for name in DRIVE_FILES)
    pictures = {plot: png(drive_figure(found))}
    contents = {
        results: as_json(data, report, pictures),
        table: _csv(rows),
        limit_table: _csv(limits),
        demand_table: _csv(demands),
        motion_table: motions_csv(found.motions).encode(),
        **pictures,
    }
    write_files(contents)
    return report, list(contents)


def _of_actuator(found: DriveResults, actuator: str) -> list[Sized]:
    """Return all drives, compared with the motion of an actuator."""
    return [found.sized[drive.name, actuator] for drive in found.drives]


def _row(found: DriveResults, sized: Sized) -> dict[str, Any]:
    """Make the row of a drive and an actuator in `drives.csv`."""
    failing, tightest = found.requirements.failing(sized), sized.tightest
    is_sized = not sized.mismatch
    return {
        "drive": sized.drive.name,
        "actuator": sized.actuator,
        "suits": int(not failing),
        "fails": failing,
        "tightest": tightest.name if tightest else None,
        "margin": tightest.margin if tightest else None,
        "energy": sized.energy,
        "holds": int(sized.holds) if is_sized else None,
        "self_locking": int(sized.drive.is_self_locking) if is_sized else None,
        "holding_torque": sized.holding_torque if is_sized else None,
    }


def _csv(rows: Sequence[Mapping[str, Any]]) -> bytes:
    """Return rows as CSV; the columns are the keys of the rows, and None is an empty cell."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    if rows:
        writer.writerow(rows[0])
        writer.writerows(row.values() for row in rows)
    return text.getvalue().encode()
