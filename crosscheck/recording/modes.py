"""Modes of a scene as a table, and as a Rerun recording in which each swings in a view of its own.

Entities:
    /ground                 shapes of the fixed body
    /mode_K/BODY            shapes, and the body's pose over one period
    /modes                  the table, as text
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from crosscheck.recording.blueprint import laid_out, scene_view, send_layout
from crosscheck.recording.log import log_bodies, log_ground, log_text
from crosscheck.recording.shapes import Style
from crosscheck.report.render import markdown_table
from crosscheck.report.table import Cell, Column, Part, Report, Rows, Table, figures, texts
from crosscheck.support.palette import palette, rgb
from newton_euler.analysis.linear.linear_model import LinearModel, Modes, label
from newton_euler.model.euler_parameters import from_rotation_vector, product
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.runs.assemble import measured_coordinate
from newton_euler.scalars import Array

AMPLITUDE = 0.15
"""rad, or sizes of the mechanism, of the largest movement that is drawn."""

PERIOD, FRAMES = 2.0, 60
"""s of one period in the viewer, whatever the frequency, and poses in it."""

MOST_SHOWN = 12
"""Modes that are drawn, the slowest."""

STEADY = 1e-9
"""Damping ratio below which a mode is undamped: round-off."""

COLUMNS = [
    Column("mode", numeric=True),
    Column("frequency", "Hz", numeric=True),
    Column("damping ratio", numeric=True),
    Column("time constant", "s", numeric=True),
    Column("moves most"),
]


RIGID = "rigid"
"""Instead of the frequency of a mode that nothing drives back."""

MOST_NAMED = 4
"""Coordinates of a pose in one sentence."""


def report(scene: Scene, model: LinearModel, modes: Modes) -> Report:
    """Report on modes: the pose that they are about, whether it is stable, and a table."""
    about = "an equilibrium" if model.is_equilibrium else "a state that is no equilibrium"
    count = len(model.coordinates)
    title = f"{scene.name} about {about}: {count} degree{'s' * (count != 1)} of freedom"
    rows = pose(scene, model)
    at = ", ".join(f"{name} {value} {unit}" for name, value, unit in rows[:MOST_NAMED])
    more = f" and {len(rows) - MOST_NAMED} more" if len(rows) > MOST_NAMED else ""
    verdict = f"{stability(modes)}; at {at}{more}" if rows else stability(modes)
    parts: list[Part] = [
        Table(
            "pose, from the initial one", texts("coordinate", "value", "unit"), [list(row) for row in rows]
        ),
        _eigenvalues(modes),
    ]
    return Report(title, verdict, Cell(""), parts, summary=[table(scene.mechanism, modes)])


def pose(scene: Scene, model: LinearModel) -> list[tuple[str, str, str]]:
    """List the independent coordinates of a linear model with values, from the initial pose, and units.

    Without those of balls, whose orientation has none.
    """
    mechanism, found = scene.mechanism, []
    for name in model.coordinates:
        if isinstance(name, str) and name not in mechanism.joint_names:
            continue
        key = mechanism.coordinate(name)
        x, _ = measured_coordinate(scene, model.state, key)
        unit = "m" if mechanism.is_slide(*key) else "rad"
        found.append((label(name), f"{x if abs(x) > STEADY else 0.0:.4g}", unit))
    return found


def stability(modes: Modes) -> str:
    """Say if motions die out, grow, or do neither; damping below `STEADY` is none."""
    growing = [k for k, ratio in enumerate(modes.damping_ratios, start=1) if ratio < -STEADY]
    if growing:
        return f"unstable: {_listed(growing)} grow{'s' * (len(growing) == 1)}"
    rigid = [k for k, value in enumerate(modes.eigenvalues, start=1) if value == 0.0]
    if rigid:
        verb, them = ("is", "it") if len(rigid) == 1 else ("are", "them")
        return f"neutral: {_listed(rigid)} {verb} {RIGID}, nothing drives {them} back"
    if np.all(modes.damping_ratios > STEADY):
        return "stable: all motions die out"
    return "neutral: undamped motions neither die out nor grow"


def _listed(numbers: Sequence[int]) -> str:
    return f"mode{'s' * (len(numbers) > 1)} {', '.join(map(str, numbers))}"


def _eigenvalues(modes: Modes) -> Table:
    """Tabulate eigenvalues, 1/s, of a pair the one with the positive imaginary part."""
    columns = figures("mode", "real, 1/s", "imaginary, rad/s")
    rows: Rows = [
        [str(k), f"{value.real:.9g}", f"{value.imag:.9g}"]
        for k, value in enumerate(modes.eigenvalues, start=1)
    ]
    return Table("eigenvalues", columns, rows)


def table(mechanism: Mechanism, modes: Modes) -> Table:
    """Tabulate modes, the slowest first: frequency, damping, time in which they die out, largest movement."""
    rows: Rows = []
    figures = zip(modes.frequencies, modes.damping_ratios, modes.eigenvalues.real, modes.twists, strict=True)
    for number, (frequency, damping, rate, twist) in enumerate(figures, start=1):
        swings, fades = frequency > 0.0, abs(damping) > STEADY
        rows.append(
            [
                str(number),
                f"{frequency:.6g}" if swings else "-" if fades else RIGID,
                f"{damping:.3g}" if fades else "0",
                f"{abs(1.0 / rate):.4g}{', grows' if rate > 0.0 else ''}" if fades else "-",
                largest_movement(mechanism, twist),
            ]
        )
    return Table("", COLUMNS, rows)


def largest_movement(mechanism: Mechanism, twist: Array) -> str:
    """Name the body with the largest movement (b, 6) of a mode, and the direction that is largest of it."""
    moves = np.abs(twist) / np.repeat([mechanism.size, 1.0], 3)
    # the first of those that are alike, whatever the last digits
    body, k = np.unravel_index(np.argmax(moves.round(6)), moves.shape)
    kind = "shift along" if k < 3 else "rotation about"
    return f"{mechanism.body_names[body]}: {kind} {'xyz'[k % 3]}"


def log_modes(recording: rr.RecordingStream, scene: Scene, model: LinearModel, modes: Modes) -> None:
    """Log one view per mode, of the slowest `MOST_SHOWN`, and how the viewer lays them out."""
    mechanism = scene.mechanism
    text = "\n".join([f"# Modes of {scene.name}", "", *markdown_table(table(mechanism, modes))])
    log_text(recording, "/modes", text)
    log_ground(recording, mechanism, swinging(mechanism, model, np.zeros((len(mechanism.bodies), 6))))
    names = [f"mode_{number}" for number in range(1, len(modes.twists) + 1)][:MOST_SHOWN]
    views = []
    for k, (name, color) in enumerate(palette(names).items()):
        run = swinging(mechanism, model, modes.twists[k])
        log_bodies(recording, [name], mechanism, run, Style(rgb(color)))
        heading = f"mode {k + 1}" + f", {modes.frequencies[k]:.4g} Hz" * bool(modes.frequencies[k])
        views.append(scene_view(mechanism, run, heading, ["+ /ground/**", f"+ /{name}/**"]))
    told = rrb.TextDocumentView(origin="/modes", name="Modes")
    send_layout(recording, laid_out(rrb.Vertical(rrb.Grid(*views), told, row_shares=[2.0, 1.0])))
    recording.send_recording_name(f"modes of {scene.name}")


def swinging(mechanism: Mechanism, model: LinearModel, twist: Array) -> Trajectory:
    """Move bodies by a mode's twists (b, 6) through one period, straight on, as a linear model has it."""
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
