"""Report of a modal analysis: pose, stability, eigenvalues and the table of vibration modes.

A mode is an eigenvector of the equations of motion, linearized about a state, usually an equilibrium. A mode
with eigenvalue s = a + i w moves like exp(a t) cos(w t). Its frequency is w / (2 pi), its damping ratio
-a / |s|, or 0 if s is 0. `crosscheck.recording.modes` animates the modes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from crosscheck.report.table import Cell, Column, Part, Report, Rows, Table, number_columns, text_columns
from newton_euler.analysis.linear.linear_model import LinearModel, Modes, label
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.runs.assemble import measured_coordinate
from newton_euler.scalars import Array

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
    columns = text_columns("coordinate", "value", "unit")
    pose_table = Table("pose, from the initial one", columns, [list(row) for row in rows])
    parts: list[Part] = [pose_table, _eigenvalues(modes)]
    no_judgment = Cell("")  # other reports have a colored word here, such as AGREE
    # the terminal shows `parts` with --verbose only, and always the summary
    return Report(title, verdict, no_judgment, parts, summary=[table(scene.mechanism, modes)])


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
    """Tabulate modes in the order of `Modes`, the slowest first: frequency, damping ratio, time constant and
    largest movement."""
    rows: Rows = []
    columns = zip(modes.frequencies, modes.damping_ratios, modes.eigenvalues.real, modes.twists, strict=True)
    for number, (frequency, damping, rate, displacement) in enumerate(columns, start=1):
        # the time constant is 1 / |rate|: the rate is that of growth or decay, 1/s
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
