"""Plot of drives: the motor's torque over time, and the actuator's force over its speed within the limits."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from crosscheck.design.drive_report import DriveResults
from crosscheck.design.load_plots import DASHES
from crosscheck.engines.palette import palette
from crosscheck.report.plots import own_style
from newton_euler.analysis.loads.actuator_motions import ActuatorMotion
from newton_euler.analysis.loads.drives import Drive, motor_motion
from newton_euler.scalars import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAX_PLOTTED_DRIVES = 5
"""Largest number of drives in the plots of an actuator: those that suit and need the least energy."""

MAX_DRAWN_TIMES, BINS = 3000, 120
"""Number of times of a motion above which only its envelope is drawn, and number of its bins over time. An
envelope is the smallest and the largest value in each bin. A day of a tracker has a move a minute, whose
lines would fill the plot."""

SPEED_BINS = 30
"""Number of bins of the envelope over speed, some of which have few values."""

LEAST_SHOWN = 0.01
"""Lower limits of the plot of force over speed, as a fraction of the largest force and speed."""


@own_style()
def drive_figure(found: DriveResults) -> Figure:
    """Plot two diagrams for each actuator, with the drives that suit it.

    The left one has the torque of the motor over time, in percent of its peak torque. The right one has the
    magnitudes of force and speed of the actuator; both axes are logarithmic. A drive that moves a load
    steadily can reach each point below and to the left of its lines: the rated speed, and the force of its
    peak torque. A motion with more than `MAX_DRAWN_TIMES` times has envelopes in place of lines, with steps
    between bins, so that the largest speed and torque are on them.
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter

    figure = Figure(figsize=(9.0, 3.0 * len(found.motions)), layout="constrained")
    axes = figure.subplots(len(found.motions), 2, squeeze=False)
    best = {motion.name: found.suitable(motion.name)[:MAX_PLOTTED_DRIVES] for motion in found.motions}
    colors = palette(list(dict.fromkeys(each.drive.name for suits in best.values() for each in suits)))
    for motion, (torque_plot, force_plot) in zip(found.motions, axes, strict=True):
        force, length = ("N", "m") if motion.is_slide else ("N m", "rad")
        magnitudes = (np.abs(motion.speed), np.abs(motion.force))
        least_speed, least_force = (LEAST_SHOWN * float(values.max()) or 1e-9 for values in magnitudes)
        is_long = len(motion.time) > MAX_DRAWN_TIMES
        if is_long:
            speed = np.maximum(magnitudes[0], least_speed)  # slower than shown, such as at rest: first bin
            edges = np.geomspace(least_speed, speed.max(), SPEED_BINS + 1)
            drawn = {"color": "black", "label": "motion, envelope"}
            _draw_envelope(force_plot, edges, speed, magnitudes[1], drawn)
        else:
            force_plot.plot(*magnitudes, color="black", linewidth=1.0, label="motion")
        for sized, dash in zip(best[motion.name], DASHES, strict=False):
            name = sized.drive.name
            style = {"color": colors[name], "linestyle": dash, "linewidth": 1.6, "label": name}
            _draw_torque(torque_plot, sized.drive, motion, style)
            _draw_limits(force_plot, sized.drive, least_speed, least_force, style)
        torque_plot.set_title(motion.name, fontsize="medium")
        torque_plot.set_xlabel("time, s")
        torque_plot.set_ylabel("torque, % of peak torque" + (", envelope" if is_long else ""))
        force_plot.set_xlabel(f"speed, {length}/s")
        force_plot.set_ylabel(f"force, {force}")
        force_plot.set_xscale("log")
        force_plot.set_yscale("log")
        for axis in (force_plot.xaxis, force_plot.yaxis):
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter(NullFormatter())
        force_plot.set_xlim(left=least_speed)
        force_plot.set_ylim(bottom=least_force)
        force_plot.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
        for ax in (torque_plot, force_plot):
            ax.grid(alpha=0.3)
    return figure


def _draw_torque(ax: Axes, drive: Drive, motion: ActuatorMotion, style: dict[str, Any]) -> None:
    """Draw the torque of a motor over time."""
    motor = motor_motion(drive, motion)
    times = np.stack([motor.time[:-1], motor.time[1:]], axis=1).ravel()
    torque = 100.0 * motor.torque.T.ravel() / drive.peak_torque
    if len(motor.time) > MAX_DRAWN_TIMES:
        _draw_envelope(ax, np.linspace(times[0], times[-1], BINS + 1), times, torque, style)
    else:
        ax.plot(times, torque, **style)


def envelope(edges: Array, x: Array, values: Array) -> tuple[Array, Array, Array]:
    """Find the smallest and the largest value in each bin of x, for lines with steps.

    Args:
        edges: (b + 1,) borders of the bins, ascending.
        x: (n,) places of the values, from the first border to the last one.
        values: (n,).

    Returns:
        Both borders of each of the m bins with values, one bin after the other (2 m,), and the smallest and
        largest values of the bins there (2 m,).
    """
    bins = np.minimum(np.searchsorted(edges, x, side="right") - 1, len(edges) - 2)
    low, high = np.full(len(edges) - 1, np.inf), np.full(len(edges) - 1, -np.inf)
    np.minimum.at(low, bins, values)
    np.maximum.at(high, bins, values)
    filled = low <= high
    borders = np.stack([edges[:-1], edges[1:]], axis=1)[filled].ravel()
    return borders, np.repeat(low[filled], 2), np.repeat(high[filled], 2)


def _draw_envelope(ax: Axes, edges: Array, x: Array, values: Array, style: dict[str, Any]) -> None:
    """Draw the smallest and the largest value in each bin of x; one of both lines has the label."""
    borders, low, high = envelope(edges, x, values)
    ax.plot(borders, high, **style)
    ax.plot(borders, low, **(style | {"label": None}))


def _draw_limits(
    ax: Axes, drive: Drive, least_speed: float, least_force: float, style: dict[str, Any]
) -> None:
    """Draw the limits of an actuator's speed and force, m/s and N or rad/s and N m, that a drive moves
    steadily."""
    speed = drive.rated_speed / drive.gear_ratio * drive.travel
    efficiency = drive.gear_efficiency * (drive.screw.efficiency if drive.screw else 1.0)
    torque = max(drive.peak_torque - drive.friction_torque, 0.0)
    force = torque * drive.gear_ratio * efficiency / drive.travel
    ax.plot([least_speed, speed, speed], [force, force, least_force], **style)
