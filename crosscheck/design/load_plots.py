"""Plot of design loads: forces and torques of joints and actuators, one color and dash pattern per case.

Runs are curves over time. Cases at rest are bars. Loads that are round-off have no plot.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from crosscheck.engines.palette import palette
from crosscheck.report.plots import own_style
from newton_euler.analysis.loads.envelope import Load, actuator_loads, joint_loads
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAX_PLOTTED_JOINTS = 20
"""Largest number of joints in the plot: the joints with the largest forces."""

DASHES = ("-", "--", "-.", ":", (0, (6, 1, 1, 1, 1, 1)))
"""Dash patterns of load cases or drives, in their order; they tell curves apart without color."""

HATCHES = ("", "//", "..", "xx", "\\\\")
"""Patterns of the bars of load cases, in their order."""

LINE_WIDTHS = (2.4, 1.8, 1.6, 1.6, 1.4)
"""Widths of curves, points, by order of the cases: thick ones are drawn first, so that equal curves are all
visible."""

MARGIN = 0.06
"""Space above and below the curves, as a fraction of the largest value, so that no curve is clipped."""

MAX_TIME_TICKS = 6
"""Largest number of intervals between the labels of the time axis."""

LEGEND_COLUMNS = 4
"""Largest number of load cases in a row of the legend."""


class _Row(NamedTuple):
    """One row of the figure: a joint or an actuator, with the loads of its plots for forces and torques.

    Attributes:
        label: name of the joint or actuator.
        force, torque: the load in the left and in the right plot; None for no plot.
    """

    label: str
    force: Load | None
    torque: Load | None


@own_style()
def load_figure(scene: Scene, runs: Mapping[str, Trajectory], negligible_force: float) -> Figure:
    """Plot the loads of all cases.

    Args:
        scene: scene of the first case, for the axes of joints and for the actuators.
        runs: runs of the cases, or their states at rest (one time).
        negligible_force: force up to which forces are round-off, N; torques are round-off up to this force
            at a lever of the mechanism's size.
    """
    from matplotlib.figure import Figure

    loads_of_cases = {
        case: joint_loads(scene, run) | actuator_loads(scene, run) for case, run in runs.items()
    }
    # curves of joints are magnitudes, those of actuators have signs
    peaks = {
        load: max(float(np.max(np.abs(loads[load]))) for loads in loads_of_cases.values())
        for load in next(iter(loads_of_cases.values()))
    }
    limits = {"N": negligible_force, "N m": negligible_force * scene.mechanism.size}
    rows = _rows({load: peak for load, peak in peaks.items() if peak > limits.get(load.unit, 0.0)})
    figure = Figure(figsize=(9.0, 1.2 + 1.3 * max(1, len(rows))), layout="constrained")
    if not rows:
        figure.text(0.5, 0.5, "all loads are zero", horizontalalignment="center")
        return figure
    at_rest = all(len(run.time) == 1 for run in runs.values())
    axes = figure.subplots(len(rows), 2, sharex=True, squeeze=False)
    for column, title in enumerate(("force, N", "torque, N m")):
        loads_of_column = [(row.force, row.torque)[column] for row in rows]
        drawn = [ax for ax, load in zip(axes[:, column], loads_of_column, strict=True) if load]
        for ax, load in zip(axes[:, column], loads_of_column, strict=True):
            if load is None:
                ax.set_axis_off()
                continue
            values = {case: loads[load] for case, loads in loads_of_cases.items()}
            if at_rest:
                _draw_bars(ax, values)
            else:
                _draw_curves(ax, {case: run.time for case, run in runs.items()}, values)
            ax.grid(alpha=0.3)
        if not drawn:
            continue
        drawn[0].set_title(title, fontsize="medium")
        if not at_rest:
            drawn[-1].locator_params(axis="x", nbins=MAX_TIME_TICKS)  # long labels do not touch
        drawn[-1].tick_params(labelbottom=True)  # which shared axes hide in all rows but the last one
        if not at_rest:
            drawn[-1].set_xlabel("time, s")
    for row, pair in zip(rows, axes, strict=True):
        label = pair[0] if row.force else pair[1]
        label.set_ylabel(row.label, fontsize="small")
    handles, labels = axes[0, 0 if rows[0].force else 1].get_legend_handles_labels()
    columns = min(LEGEND_COLUMNS, len(labels))
    figure.legend(handles, labels, loc="outside upper center", ncols=columns, handlelength=4.0)
    return figure


def _rows(peaks: Mapping[Load, float]) -> list[_Row]:
    """Choose the joints with the largest forces, in the order of the mechanism, and all actuators.

    Args:
        peaks: largest magnitudes over all cases of the loads that are not round-off.
    """
    forces = {load.element: peak for load, peak in peaks.items() if load.quantity == "force"}
    torques = {load.element: peak for load, peak in peaks.items() if load.quantity == "torque"}
    # joints without a force, such as those of a motor that turns a wheel, come after all others
    joints = list(dict.fromkeys((*forces, *torques)))
    chosen = sorted(joints, key=lambda joint: (-forces.get(joint, 0.0), -torques.get(joint, 0.0)))
    rows = [
        _Row(
            joint,
            Load(joint, "force", "N") if joint in forces else None,
            Load(joint, "torque", "N m") if joint in torques else None,
        )
        for joint in joints
        if joint in chosen[:MAX_PLOTTED_JOINTS]
    ]
    for load in peaks:
        if load.quantity == "actuator force":
            label = f"{load.element}\nactuator"
            rows.append(_Row(label, load, None) if load.unit == "N" else _Row(label, None, load))
    return rows


def _draw_curves(ax: Axes, times: Mapping[str, Array], values: Mapping[str, Array]) -> None:
    """Draw the values (n,) of each case over its times (n,), s."""
    for k, (case, color) in enumerate(palette(list(values)).items()):
        dash, width = DASHES[k % len(DASHES)], LINE_WIDTHS[k % len(LINE_WIDTHS)]
        ax.plot(times[case], values[case], color=color, linestyle=dash, linewidth=width, label=case)
    _set_limits(ax, values)


def _draw_bars(ax: Axes, values: Mapping[str, Array]) -> None:
    """Draw the value (1,) of each case as a bar."""
    for k, (case, color) in enumerate(palette(list(values)).items()):
        hatch = HATCHES[k % len(HATCHES)]
        ax.bar(k, float(values[case][0]), color=color, hatch=hatch, edgecolor="black", label=case)
    ax.set_xticks(range(len(values)), list(values), rotation=20, fontsize="small")
    _set_limits(ax, values)


def _set_limits(ax: Axes, values: Mapping[str, Array]) -> None:
    """Set the vertical limits: from 0 or the smallest value to the largest one, with a margin."""
    least = min(0.0, *(float(np.min(each)) for each in values.values()))
    most = max(0.0, *(float(np.max(each)) for each in values.values()))
    margin = MARGIN * (most - least) or 1.0
    ax.set_ylim(least - margin, most + margin)
