"""Modal analysis: choose the pose, linearize, and write pose, stability, eigenvalues and vibration modes.

A mode is an eigenvector of the equations of motion, linearized about a state, usually an equilibrium. A mode
with eigenvalue s = a + i w moves like exp(a t) cos(w t). Its damped frequency is w / (2 pi), its undamped
natural frequency |s| / (2 pi), its damping ratio -a / |s|, or 0 if s is 0. `crosscheck.recording.modes`
animates the modes.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from crosscheck.design.coordinates import coordinate_of
from crosscheck.report.chart import Measure, linear_chart
from crosscheck.report.render import as_json, markdown_table
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
from crosscheck.support.files import write_files
from crosscheck.support.name_lists import first_names
from newton_euler.analysis.kinematics.crossings import Passage, passage
from newton_euler.analysis.kinematics.poses import solve_poses
from newton_euler.analysis.linear.linear_model import LinearModel, Modes, label
from newton_euler.analysis.linear.linearization import linearize
from newton_euler.analysis.loads.equilibrium import at_rest, settle
from newton_euler.analysis.loads.holding import hold
from newton_euler.errors import MechanismError, NoEquilibriumError, listed, plain_number
from newton_euler.model.joint import Key
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.runs.assemble import initial_state, measured_coordinate
from newton_euler.scalars import Array

MODES_FILES = "modes.json", "modes.csv", "modes.rrd"
"""Names of the result files."""

DAMPING_ROUND_OFF = 1e-9
"""Damping ratio below which a mode counts as undamped; smaller ratios are round-off."""

MODE_COLUMNS = [
    Column("mode", numeric=True),
    Column("frequency", "Hz", numeric=True),
    Column("undamped", "Hz", numeric=True),
    Column("damping ratio", numeric=True),
    Column("time constant", "s", numeric=True),
    Column("moves most"),
]
"""Columns of the table of modes."""

RIGID = "rigid"
"""Text in place of the frequency of a rigid-body mode: a motion without a restoring force."""

MAX_COORDINATES = 4
"""Largest number of joint coordinates in the sentence about the pose."""


class ModalAnalysis(NamedTuple):
    """Modes of a scene about a pose.

    Attributes:
        scene: the scene that is linearized.
        model: linear model about the pose, whose outputs are all joint coordinates.
        modes: the modes of the model.
        about: how the pose was chosen: "start" (the initial state), "pose" (as the user asked), "run" (where
            the run comes to rest) or "slow motion" (where motion without inertia ends).
        passage: singular configurations between the initial pose and this pose.
        passing_times: times of the run, s, at which they have just been passed; NaN in slow motion.
        time: s, at which functions of time are held; None if the scene has none.
    """

    scene: Scene
    model: LinearModel
    modes: Modes
    about: str
    passage: Passage
    passing_times: tuple[float, ...]
    time: float | None


def pose_of(scene: Scene, given: Sequence[str]) -> dict[str | Key, float]:
    """Parse texts JOINT=VALUE of a pose, m or rad from the initial pose; JOINT.K is coordinate K of a joint.

    Raises:
        CrosscheckError: for a text of another form, and for a coordinate that is given twice.
    """
    found: dict[str | Key, float] = {}
    for text in given:
        name, _, value = text.partition("=")
        coordinate = coordinate_of(scene.mechanism, name)
        try:
            x = plain_number(value)
        except ValueError:
            raise CrosscheckError(f"--pose {text!r} is not of the form JOINT=VALUE, in m or rad") from None
        if coordinate in found:
            raise CrosscheckError(f"--pose {name} is given twice")
        found[coordinate] = x
    return found


def analyze(
    scene: Scene,
    *,
    at_start: bool = False,
    pose: Mapping[str | Key, float] | None = None,
    time: float | None = None,
    open_loop: bool = False,
) -> ModalAnalysis:
    """Compute the modes of a scene about the pose in which its run comes to rest, or about another pose.

    Args:
        scene: the scene.
        at_start: True for the initial state, moving or not.
        pose: joint coordinates of a pose, m or rad; the control laws hold the mechanism there.
        time: s, at which functions of time are held; see `newton_euler.analysis.loads.equilibrium.settle`.
        open_loop: True to keep the forces of control laws constant.

    Raises:
        CrosscheckError: if the mechanism does not come to rest, or does not reach the pose on the branch of
            the initial pose.
        NewtonEulerError: see `linearize`.
    """
    functions = any(scene.functions.values())
    start = initial_state(scene)
    passing_times: tuple[float, ...] = ()
    if at_start:
        state, about, passed, held_at = start, "start", Passage((), ()), 0.0
    elif pose:
        poses = solve_poses(at_rest(scene), pose)
        if not poses.reached[0]:
            raise CrosscheckError(f"--pose: {poses.report()[0]}; crosscheck workspace maps what it reaches")
        state, about, held_at = poses.state(0), "pose", 0.0
        try:
            scene = hold(scene, state)
        except MechanismError:  # nothing holds the mechanism there, as the title reports
            scene = replace(at_rest(scene), initial_state=state)
        passed = passage(scene, [state])  # of one pose: coordinates alone
    else:
        try:
            rest = settle(scene, time)
        except NoEquilibriumError as error:
            raise CrosscheckError(f"{error}, or another pose: --pose JOINT=VALUE or --at-start") from None
        scene, state, held_at = rest.scene, rest.state, rest.time
        about, passed, passing_times = (
            "run" if rest.settles else "slow motion",
            rest.passage,
            rest.passing_times,
        )
    names = list(map(scene.mechanism.coordinate_name, scene.mechanism.coordinate_labels))
    model = linearize(scene, state, outputs=names, closed_loop=not open_loop)
    return ModalAnalysis(
        scene, model, model.modes(), about, passed, passing_times, held_at if functions else None
    )


def write(found: ModalAnalysis, paths: Sequence[Path], source: str, options: Mapping[str, str]) -> Report:
    """Write the results of a modal analysis, and return the report.

    Args:
        found: the modal analysis.
        paths: paths of `MODES_FILES`, in their order.
        source: name or file of the model.
        options: options of the model.
    """
    from crosscheck.recording.modes import log_modes
    from crosscheck.recording.stream import recorded

    results, table_path, recording = paths
    made = report(found)
    rows = "\n".join(markdown_table(table(found.scene.mechanism, found.modes)))
    recorded_modes = recorded(log_modes, found.scene, found.model, found.modes, rows)
    content = data(found) | {"source": source, "options": dict(options)}
    write_files(
        {
            results: as_json(content, made, {recording: recorded_modes}),
            table_path: to_csv(found).encode(),
            recording: recorded_modes,
        }
    )
    return made


def joint_shapes(found: ModalAnalysis) -> dict[str, Array]:
    """Return the amplitudes (m,) of all joint coordinates in the m modes, complex, by name.

    Independent coordinates that are no joint coordinates, such as rotations of a ball joint, come last. The
    scale is that of `Modes.twists`: the largest movement of a body is 1 rad or one size of the mechanism.
    """
    model, shapes = found.model, found.modes.shapes
    by_name = {
        label(name): shapes @ row
        for name, row in zip(model.outputs, model.C[:, : shapes.shape[1]], strict=True)
    }
    others = {label(name): column for name, column in zip(model.coordinates, shapes.T, strict=True)}
    return by_name | {name: column for name, column in others.items() if name not in by_name}


def data(found: ModalAnalysis) -> dict[str, object]:
    """Return all numbers of a modal analysis for the result file."""
    scene, model, modes = found.scene, found.model, found.modes
    shapes = joint_shapes(found)
    return {
        "scene": scene.name,
        "about": found.about,
        "is_equilibrium": model.is_equilibrium,
        "time": found.time,
        "branch": {
            "coordinates": list(map(label, found.passage.coordinates)),
            "passed": len(found.passage.rows),
            "passing_times": list(found.passing_times),
            "beyond": found.passage.beyond,
        },
        "pose": {
            "coordinates": {
                label(scene.mechanism.coordinate_name(key)): measured_coordinate(scene, model.state, key)[0]
                for key in scene.mechanism.coordinate_labels
            },
            "bodies": list(scene.mechanism.body_names),
            "position": model.state.position.tolist(),
            "quaternion": model.state.quaternion.tolist(),
        },
        "coordinates": list(map(label, model.coordinates)),
        "size": model.size,
        "modes": [
            {
                "frequency": float(modes.frequencies[k]),
                "undamped_frequency": float(undamped_frequencies(modes)[k]),
                "damping_ratio": float(modes.damping_ratios[k]),
                "eigenvalue": [float(value.real), float(value.imag)],
                "shape": {name: [float(x[k].real), float(x[k].imag)] for name, x in shapes.items()},
                "moves_most": largest_movement(scene.mechanism, modes.twists[k]),
            }
            for k, value in enumerate(modes.eigenvalues)
        ],
    }


def to_csv(found: ModalAnalysis) -> str:
    """Return the CSV: one row for each mode, with the amplitude and phase of each joint coordinate."""
    modes, shapes = found.modes, joint_shapes(found)
    units = {label(name): unit for name, unit in _units(found.scene.mechanism).items()}
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    columns = [
        "mode",
        "frequency, Hz",
        "undamped frequency, Hz",
        "damping ratio",
        "eigenvalue real, 1/s",
        "eigenvalue imaginary, rad/s",
    ]
    for name in shapes:
        columns += [f"{name} amplitude, {units.get(name, 'rad')}", f"{name} phase, rad"]
    writer.writerow(columns)
    for k, value in enumerate(modes.eigenvalues):
        frequencies = modes.frequencies[k], undamped_frequencies(modes)[k]
        numbers = [*frequencies, modes.damping_ratios[k], value.real, value.imag]
        for x in shapes.values():
            numbers += [np.abs(x[k]), np.angle(x[k])]
        writer.writerow([k + 1, *(f"{number + 0.0:.9g}" for number in numbers)])
    return text.getvalue()


def undamped_frequencies(modes: Modes) -> Array:
    """Return the undamped natural frequencies (m,) of the modes, Hz; 0 for modes that do not oscillate."""
    return np.where(modes.frequencies > 0.0, np.abs(modes.eigenvalues) / (2.0 * np.pi), 0.0)


def _units(mechanism: Mechanism) -> dict[str | Key, str]:
    """Return the units of all joint coordinates."""
    keys = mechanism.coordinate_labels
    return {mechanism.coordinate_name(key): "m" if mechanism.is_slide(*key) else "rad" for key in keys}


def report(found: ModalAnalysis) -> Report:
    """Make the report of a modal analysis: pose, stability, eigenvalues and the table of modes."""
    scene, model, modes = found.scene, found.model, found.modes
    about = "an equilibrium" if model.is_equilibrium else "a state that is no equilibrium"
    count = len(model.coordinates)
    title = f"{scene.name} about {about}: {count} degree{'s' * (count != 1)} of freedom"
    rows = pose(scene, model)
    at = first_names([f"{name} {value} {unit}" for name, value, unit in rows], MAX_COORDINATES)
    verdict = f"{stability(modes)}; at {at}" if rows else stability(modes)
    columns = text_columns("coordinate", "value", "unit")
    pose_table = Table("pose, from the initial one", columns, [list(row) for row in rows])
    parts: list[Part] = [pose_table, _eigenvalues(modes)]
    no_judgment = Cell("")  # other reports have a colored word here, such as AGREE
    # the terminal shows `parts` with --verbose only, and always the summary
    is_doubtful = found.passage.beyond or (found.about == "pose" and not model.is_equilibrium)
    lines = Lines("", pose_lines(found), verdict="doubtful" if is_doubtful else "")
    summary: list[Part] = [table(scene.mechanism, modes), lines]
    frequencies = [
        Measure(f"mode {k + 1}", float(value), f"{value:.3g} Hz") for k, value in enumerate(modes.frequencies)
    ]
    caption = "Damped natural frequency of each mode; a mode that does not oscillate has none"
    return Report(
        title,
        verdict,
        no_judgment,
        parts,
        summary=summary,
        charts=linear_chart("Frequencies", caption, frequencies),
        next_steps=[
            "Keep the frequencies of wind, motors and control away from those of the modes.",
            *([] if model.is_equilibrium else ["Use them with care: the pose is no equilibrium."]),
        ],
    )


def pose_lines(found: ModalAnalysis) -> list[str]:
    """Report in sentences how the pose was chosen, and on which assembly branch it lies."""
    text = {
        "start": "the pose is the initial one",
        "pose": "the control laws hold the pose that was asked for",
        "run": "the run comes to rest in this pose",
        "slow motion": "the run does not come to rest; a motion without inertia ends in this pose",
    }[found.about]
    if found.about == "pose" and not found.model.is_equilibrium:
        text = "nothing holds the pose that was asked for"
    if found.passage.coordinates and found.about != "start":
        names = listed(map(label, found.passage.coordinates))
        if found.passage.beyond:
            times = [f"{time:.3g} s" for time in found.passing_times if np.isfinite(time)]
            when = f", passed at {', '.join(times)}" if times else ""
            text += f", beyond a singular configuration of {names}{when}"
        else:
            text += ", on the branch of the initial pose"
    lines = [text]
    if found.time is not None:
        lines.append(f"set-points and other functions of time have their values at {found.time:.4g} s")
    return lines


def pose(scene: Scene, model: LinearModel) -> list[tuple[str, str, str]]:
    """List the independent joint coordinates of the model's state: name, displacement from the initial pose,
    and unit.

    Ball joints are left out, since an orientation is not a coordinate, and bodies that only rods hold.
    """
    mechanism, found = scene.mechanism, []
    for name in model.coordinates:
        # A name is a pair (joint, index) for a joint with several coordinates, else a string: the name of a
        # joint, or of another velocity, such as a component of the rotation of a ball joint
        if isinstance(name, str) and name not in mechanism.joint_names:
            continue
        key = mechanism.coordinate(name)
        x, _ = measured_coordinate(scene, model.state, key)
        unit = "m" if mechanism.is_slide(*key) else "rad"
        displacement = x if abs(x) > 1e-9 else 0.0  # less, m or rad, is round-off
        found.append((label(name), f"{displacement:.4g}", unit))
    return found


def stability(modes: Modes) -> str:
    """Report in a sentence whether small motions decay (stable), grow (unstable) or do neither (neutral)."""
    growing = [k for k, ratio in enumerate(modes.damping_ratios, start=1) if ratio < -DAMPING_ROUND_OFF]
    if growing:
        return f"unstable: {_listed(growing)} grow{'s' * (len(growing) == 1)}"
    # the modal analysis sets the eigenvalues of rigid-body modes to exactly 0
    rigid = [k for k, value in enumerate(modes.eigenvalues, start=1) if value == 0.0]
    if rigid:
        verb, them = ("is", "it") if len(rigid) == 1 else ("are", "them")
        return f"neutral: {_listed(rigid)} {verb} {RIGID}, nothing drives {them} back"
    if np.all(modes.damping_ratios > DAMPING_ROUND_OFF):
        return "stable: all motions die out"
    return "neutral: undamped motions neither die out nor grow"


def _listed(numbers: Sequence[int]) -> str:
    """List numbers of modes: "mode 1" or "modes 1, 2"."""
    return f"mode{'s' * (len(numbers) > 1)} {', '.join(map(str, numbers))}"


def _eigenvalues(modes: Modes) -> Table:
    """Tabulate the eigenvalues; of a complex pair, the one with the positive imaginary part."""
    columns = number_columns("mode", "real, 1/s", "imaginary, rad/s")
    rows: Rows = [
        [str(k), f"{value.real:.9g}", f"{value.imag:.9g}"]
        for k, value in enumerate(modes.eigenvalues, start=1)
    ]
    return Table("eigenvalues", columns, rows)


def table(mechanism: Mechanism, modes: Modes) -> Table:
    """Tabulate modes in the order of `Modes`, the slowest first: frequencies, damping ratio, time constant
    and largest movement."""
    rows: Rows = []
    frequencies = modes.frequencies, undamped_frequencies(modes)
    columns = zip(*frequencies, modes.damping_ratios, modes.eigenvalues.real, modes.twists, strict=True)
    for number, (frequency, undamped, damping, rate, displacement) in enumerate(columns, start=1):
        # the time constant is 1 / |rate|: the rate is that of growth or decay, 1/s
        oscillates, is_damped = frequency > 0.0, abs(damping) > DAMPING_ROUND_OFF
        frequency_text = f"{frequency:.6g}"
        if not oscillates:
            frequency_text = "-" if is_damped else RIGID
        rows.append(
            [
                str(number),
                frequency_text,
                f"{undamped:.6g}" if oscillates else "-",
                f"{damping:.3g}" if is_damped else "0",
                f"{abs(1.0 / rate):.4g}{', grows' if rate > 0.0 else ''}" if is_damped else "-",
                largest_movement(mechanism, displacement),
            ]
        )
    return Table("", MODE_COLUMNS, rows)


def largest_movement(mechanism: Mechanism, displacement: Array) -> str:
    """Name the body that moves most in a mode, and the direction of its largest movement.

    Args:
        mechanism: the mechanism, with b bodies.
        displacement: (b, 6) translation of the center of mass, m, and rotation, rad, of each body along and
            about the axes of the world; complex amplitudes.
    """
    # translations in units of the mechanism's size, and rotations in rad; rounded, so that round-off does not
    # decide between equal movements
    movements = np.abs(displacement) / np.repeat([mechanism.size, 1.0], 3)
    body, k = np.unravel_index(np.argmax(movements.round(6)), movements.shape)
    kind = "shift along" if k < 3 else "rotation about"
    return f"{mechanism.body_names[body]}: {kind} {'xyz'[k % 3]}"
