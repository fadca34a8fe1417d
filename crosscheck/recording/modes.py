"""The vibration modes of a scene: a table, and a Rerun recording with an animation of each mode.

A mode is an eigenvector of the equations of motion, linearized about a state, usually an equilibrium.

Entities of the recording, with K for the number of a mode and BODY for a name:

    /ground                 shapes of the fixed body
    /mode_K/BODY            shapes, and the body's pose over one period
    /modes                  the table of modes, as text
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from crosscheck.recording.blueprint import make_layout, scene_view, send_layout
from crosscheck.recording.log import log_bodies, log_ground, log_text
from crosscheck.recording.shapes import Style
from crosscheck.report.render import markdown_table
from crosscheck.report.table import Cell, Column, Part, Report, Rows, Table, number_columns, text_columns
from crosscheck.support.palette import palette, rgb
from newton_euler.analysis.linear.linear_model import LinearModel, Modes, label
from newton_euler.model.euler_parameters import from_rotation_vector, product
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.runs.assemble import measured_coordinate
from newton_euler.scalars import Array

AMPLITUDE = 0.15
"""Largest movement in the animation of a mode: rad, or multiples of the mechanism's size."""

PERIOD = 2.0
"""Duration of a period in the animation, s, whatever the frequency of the mode."""

FRAMES = 60
"""Number of poses in a period of the animation."""

MAX_ANIMATED = 12
"""Largest number of modes that are animated; modes are sorted by frequency, the slowest first."""

DAMPING_ROUND_OFF = 1e-9
"""Damping ratio below which a mode counts as undamped; smaller ratios are round-off."""

MODE_COLUMNS = [
    Column("mode", numeric=True),
    Column("frequency", "Hz", numeric=True),
    Column("damping ratio", numeric=True),
    Column("time constant", "s", numeric=True),
    Column("moves most"),
]
"""Columns of the table of modes."""

RIGID = "rigid"
"""Text in place of the frequency of a rigid-body mode: a motion without a restoring force."""

MAX_COORDINATES = 4
"""Largest number of joint coordinates in the sentence about the pose."""


def report(scene: Scene, model: LinearModel, modes: Modes) -> Report:
    """Make the report of a modal analysis: pose, stability, eigenvalues and the table of modes."""
    about = "an equilibrium" if model.is_equilibrium else "a state that is no equilibrium"
    count = len(model.coordinates)
    title = f"{scene.name} about {about}: {count} degree{'s' * (count != 1)} of freedom"
    rows = pose(scene, model)
    at = ", ".join(f"{name} {value} {unit}" for name, value, unit in rows[:MAX_COORDINATES])
    more = f" and {len(rows) - MAX_COORDINATES} more" if len(rows) > MAX_COORDINATES else ""
    verdict = f"{stability(modes)}; at {at}{more}" if rows else stability(modes)
    parts: list[Part] = [
        Table(
            "pose, from the initial one",
            text_columns("coordinate", "value", "unit"),
            [list(row) for row in rows],
        ),
        _eigenvalues(modes),
    ]
    return Report(title, verdict, Cell(""), parts, summary=[table(scene.mechanism, modes)])


def pose(scene: Scene, model: LinearModel) -> list[tuple[str, str, str]]:
    """List the independent joint coordinates: name, displacement from the initial pose, and unit.

    Ball joints are left out, since an orientation is not a coordinate.
    """
    mechanism, found = scene.mechanism, []
    for name in model.coordinates:
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
    """Tabulate modes, the slowest first: frequency, damping ratio, time constant and largest movement."""
    rows: Rows = []
    figures = zip(modes.frequencies, modes.damping_ratios, modes.eigenvalues.real, modes.twists, strict=True)
    for number, (frequency, damping, rate, twist) in enumerate(figures, start=1):
        oscillates, is_damped = frequency > 0.0, abs(damping) > DAMPING_ROUND_OFF
        frequency_text = f"{frequency:.6g}"
        if not oscillates:
            frequency_text = "-" if is_damped else RIGID
        rows.append(
            [
                str(number),
                frequency_text,
                f"{damping:.3g}" if is_damped else "0",
                f"{abs(1.0 / rate):.4g}{', grows' if rate > 0.0 else ''}" if is_damped else "-",
                largest_movement(mechanism, twist),
            ]
        )
    return Table("", MODE_COLUMNS, rows)


def largest_movement(mechanism: Mechanism, twist: Array) -> str:
    """Name the body that moves most in a mode, and the direction of its largest movement.

    Args:
        mechanism: the mechanism, with b bodies.
        twist: (b, 6) translation, m, and rotation, rad, of each body, world frame; complex amplitudes.
    """
    moves = np.abs(twist) / np.repeat([mechanism.size, 1.0], 3)
    # rounded, so that round-off does not decide between equal movements
    body, k = np.unravel_index(np.argmax(moves.round(6)), moves.shape)
    kind = "shift along" if k < 3 else "rotation about"
    return f"{mechanism.body_names[body]}: {kind} {'xyz'[k % 3]}"


def log_modes(recording: rr.RecordingStream, scene: Scene, model: LinearModel, modes: Modes) -> None:
    """Record an animation of each of the slowest `MAX_ANIMATED` modes, the table and the layout."""
    mechanism = scene.mechanism
    text = "\n".join([f"# Modes of {scene.name}", "", *markdown_table(table(mechanism, modes))])
    log_text(recording, "/modes", text)
    log_ground(recording, mechanism, animate_mode(mechanism, model, np.zeros((len(mechanism.bodies), 6))))
    names = [f"mode_{number}" for number in range(1, len(modes.twists) + 1)][:MAX_ANIMATED]
    views = []
    for k, (name, color) in enumerate(palette(names).items()):
        run = animate_mode(mechanism, model, modes.twists[k])
        log_bodies(recording, [name], mechanism, run, Style(rgb(color)))
        heading = f"mode {k + 1}" + f", {modes.frequencies[k]:.4g} Hz" * bool(modes.frequencies[k])
        views.append(scene_view(mechanism, run, heading, ["+ /ground/**", f"+ /{name}/**"]))
    table_view = rrb.TextDocumentView(origin="/modes", name="Modes")
    send_layout(recording, make_layout(rrb.Vertical(rrb.Grid(*views), table_view, row_shares=[2.0, 1.0])))
    recording.send_recording_name(f"modes of {scene.name}")


def animate_mode(mechanism: Mechanism, model: LinearModel, twist: Array) -> Trajectory:
    """Animate one period of a mode.

    Args:
        mechanism: the mechanism, with b bodies.
        model: linear model, whose state is the center of the motion.
        twist: (b, 6) translation, m, and rotation, rad, of each body, world frame; complex amplitudes.

    Returns:
        A trajectory of `FRAMES` + 1 poses; the movements are scaled by `AMPLITUDE`.
    """
    time = np.linspace(0.0, PERIOD, FRAMES + 1)
    moves = AMPLITUDE * (twist * np.exp(2j * np.pi * time / PERIOD)[:, None, None]).real
    quaternion = [
        [
            product(from_rotation_vector(turn), p)
            for turn, p in zip(turns, model.state.quaternion, strict=True)
        ]
        for turns in moves[:, :, 3:]
    ]
    names = mechanism.body_names, mechanism.joint_names
    position = model.state.position + moves[:, :, :3]
    return Trajectory("", {}, 0.0, time, *names, position, np.array(quaternion))
