"""Modes of a scene as a table, and as a Rerun recording in which each swings in a view of its own.

Entities:
    /ground                 shapes of the fixed body
    /mode_K/BODY            shapes, and the body's pose over one period
    /modes                  the table, as text
"""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from crosscheck.palette import palette, rgb
from crosscheck.recording.blueprint import laid_out, sight
from crosscheck.recording.log import GROUND_COLOR, new_recording, send_pose
from crosscheck.recording.shapes import Style, log_shapes
from crosscheck.report.render import markdown_table
from crosscheck.report.table import Column, Rows, Table
from newton_euler.analysis.linear_model import LinearModel, Modes
from newton_euler.model.euler_parameters import from_rotation_vector, product
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
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


def table(mechanism: Mechanism, modes: Modes) -> Table:
    """Tabulate modes, the slowest first: frequency, damping, time in which they die out, largest movement."""
    rows: Rows = []
    figures = zip(modes.frequencies, modes.damping_ratios, modes.eigenvalues.real, modes.twists, strict=True)
    for number, (frequency, damping, rate, twist) in enumerate(figures, start=1):
        swings, fades = frequency > 0.0, abs(damping) > STEADY
        rows.append(
            [
                str(number),
                f"{frequency:.6g}" if swings else "-",
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


def recorded(scene: Scene, model: LinearModel, modes: Modes) -> bytes:
    """The content of an .rrd with one view per mode, of the slowest `MOST_SHOWN`."""
    recording, mechanism = new_recording(scene), scene.mechanism
    memory = recording.memory_recording()
    text = "\n".join([f"# Modes of {scene.name}", "", *markdown_table(table(mechanism, modes))])
    recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    recording.log("/modes", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)
    log_shapes(recording, "/ground", mechanism, 0, Style(GROUND_COLOR))
    ground = model.state.position[:1, :], model.state.quaternion[:1, :]
    send_pose(recording, "/ground", np.zeros(1), *ground)
    names = [f"mode_{number}" for number in range(1, len(modes.twists) + 1)][:MOST_SHOWN]
    views = []
    for k, (name, color) in enumerate(palette(names).items()):
        run = swinging(mechanism, model, modes.twists[k])
        for body in range(1, len(mechanism.bodies)):
            path = rr.new_entity_path([name, mechanism.body_names[body]])
            log_shapes(recording, path, mechanism, body, Style(rgb(color)))
            send_pose(recording, path, run.time, run.position[:, body], run.quaternion[:, body])
        eye, grid = sight(mechanism, run)
        view = rrb.Spatial3DView(
            origin="/",
            contents=["+ /ground/**", f"+ /{name}/**"],
            name=f"mode {k + 1}" + f", {modes.frequencies[k]:.4g} Hz" * bool(modes.frequencies[k]),
            eye_controls=eye,
            line_grid=grid,
        )
        views.append(view)
    told = rrb.TextDocumentView(origin="/modes", name="Modes")
    recording.send_blueprint(laid_out(rrb.Vertical(rrb.Grid(*views), told, row_shares=[2.0, 1.0])))
    recording.send_recording_name(f"modes of {scene.name}")
    return bytes(memory.drain_as_bytes())


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
