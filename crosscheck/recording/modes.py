"""Rerun recording of the vibration modes of a scene: an animation of each mode, and a table.

A mode is an eigenvector of the equations of motion, linearized about a state, usually an equilibrium.

Entities of the recording, with K for the number of a mode and BODY for a name:

    /ground                 shapes of the fixed body
    /mode_K/BODY            shapes, and the body's pose over one period
    /modes                  the table of modes, as text
"""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from crosscheck.engines.palette import palette
from crosscheck.recording.blueprint import make_layout, scene_view, send_layout
from crosscheck.recording.entities import log_bodies, log_ground
from crosscheck.recording.shapes import Style
from crosscheck.recording.stream import log_text
from crosscheck.support.colors import rgb
from newton_euler.analysis.linear.linear_model import LinearModel, Modes
from newton_euler.model.euler_parameters import from_rotation_vector, product
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

AMPLITUDE = 0.15
"""Largest movement in the animation of a mode: rad, or multiples of the mechanism's size."""

PERIOD_S = 2.0
"""Duration of a period in the animation, s, whatever the frequency of the mode."""

POSES_PER_PERIOD = 60
"""Number of poses in a period of the animation."""

MAX_ANIMATED = 12
"""Largest number of modes that are animated; modes are sorted by frequency, the slowest first."""


def log_modes(
    recording: rr.RecordingStream, scene: Scene, model: LinearModel, modes: Modes, table: str
) -> None:
    """Record animations of the slowest modes, a table of all modes, and the layout of the viewer.

    Args:
        recording: recording to write to.
        scene: the scene.
        model: linear model of the scene.
        modes: the modes of the model, the slowest first; at most `MAX_ANIMATED` are animated.
        table: table of the modes, Markdown.
    """
    mechanism = scene.mechanism
    log_text(recording, "/modes", f"# Modes of {scene.name}\n\n{table}")
    at_rest = animate_mode(mechanism, model, np.zeros((len(mechanism.bodies), 6)))
    log_ground(recording, mechanism, at_rest)
    names = [f"mode_{number}" for number in range(1, len(modes.twists) + 1)][:MAX_ANIMATED]
    views = []
    for k, (name, color) in enumerate(palette(names).items()):
        run = animate_mode(mechanism, model, modes.twists[k])
        log_bodies(recording, [name], mechanism, run, Style(rgb(color)))
        frequency = modes.frequencies[k]  # 0 for a mode that does not oscillate
        heading = f"mode {k + 1}, {frequency:.4g} Hz" if frequency else f"mode {k + 1}"
        views.append(scene_view(mechanism, run, heading, ["+ /ground/**", f"+ /{name}/**"]))
    table_view = rrb.TextDocumentView(origin="/modes", name="Modes")
    send_layout(recording, make_layout(rrb.Vertical(rrb.Grid(*views), table_view, row_shares=[2.0, 1.0])))
    recording.send_recording_name(f"modes of {scene.name}")


def animate_mode(mechanism: Mechanism, model: LinearModel, twist: Array) -> Trajectory:
    """Animate one period of a mode.

    Args:
        mechanism: the mechanism, with b bodies.
        model: linear model, whose state is the center of the motion.
        twist: (b, 6) complex amplitudes of translation, m, and rotation vector, rad, of each body, world
            frame; the largest one is 1 rad or one size of the mechanism.

    Returns:
        A trajectory of `POSES_PER_PERIOD` + 1 poses; the movements are `AMPLITUDE` times the amplitudes.
    """
    time = np.linspace(0.0, PERIOD_S, POSES_PER_PERIOD + 1)
    moves = AMPLITUDE * (twist * np.exp(2j * np.pi * time / PERIOD_S)[:, None, None]).real
    quaternion = [
        [
            product(from_rotation_vector(rotation), p)
            for rotation, p in zip(rotations, model.state.quaternion, strict=True)
        ]
        for rotations in moves[:, :, 3:]
    ]
    return Trajectory(
        engine="",
        settings={},
        wall_time=0.0,
        time=time,
        body_names=mechanism.body_names,
        joint_names=mechanism.joint_names,
        position=model.state.position + moves[:, :, :3],
        quaternion=np.array(quaternion),
    )
