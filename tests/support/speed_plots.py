"""Plots of the pages on speed, drawn from the numbers in the tables of these pages."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.figure import Figure
from page_tables import numbers, page_table

from crosscheck.support.colors import BLUE, GREEN, OTHER_COLORS, VERMILION


def joints() -> Figure:
    """Plot the time of one right-hand side over the number of velocities."""
    table = page_table("speed_equations.md", "model", "velocities")
    chains = [k for k, name in enumerate(table.column("model")) if name.startswith("chain")]
    velocities = np.array([float(text) for text in table.column("velocities")])
    figure = Figure(figsize=(8.0, 3.6), layout="constrained")
    ax = figure.add_subplot()
    styles = {
        "newton_euler": (BLUE, "o-"),
        "MuJoCo mj_forward": (VERMILION, "s--"),
        "Pinocchio aba": (GREEN, "^:"),
        "lcaba": (OTHER_COLORS[1], "v-."),
    }
    for head, (color, style) in styles.items():
        label = "Pinocchio lcaba" if head == "lcaba" else head
        times = np.array([float(text) for text in table.column(head)])
        ax.loglog(velocities[chains], times[chains], style, color=color, label=f"{label}, chains")
        others = np.setdiff1d(np.arange(len(times)), chains)
        ax.loglog(velocities[others], times[others], style[0], color=color, mfc="white")
    ax.set(xlabel="velocities", ylabel="time of one right-hand side, us")
    ax.set_xticks(velocities[chains], [f"{count:g}" for count in velocities[chains]])
    ax.minorticks_off()
    ax.legend(fontsize="small", title="hollow: humanoids", title_fontsize="small")
    ax.grid(which="both", alpha=0.3)
    return figure


def batches() -> Figure:
    """Plot the runs per second of the engines on one thread, at an error of 1e-6."""
    table = page_table("speed_batches.md", "scene, duration", "newton_euler, eight side by side")
    scenes = [name.partition(",")[0] for name in table.column("scene, duration")]
    variation = page_table("speed_batches.md", "scene", "elements")
    names = [name.partition(",")[0] for name in variation.column("scene")]
    milliseconds = dict(zip(names, variation.column("ms per run"), strict=True))
    values = {
        "newton_euler, eight side by side": [numbers(text)[0] for text in table.column(table.heads[1])],
        "newton_euler, one by one": [numbers(text)[0] for text in table.column("one by one")],
        "MuJoCo rollout": [
            np.nan if text.startswith("below") else numbers(text)[0]
            for text in table.column("MuJoCo rollout")
        ],
        "Exudyn ParameterVariation": [1e3 / numbers(milliseconds[scene])[0] for scene in scenes],
    }
    figure = Figure(figsize=(8.0, 3.4), layout="constrained")
    ax = figure.add_subplot()
    for k, ((label, runs), color) in enumerate(
        zip(values.items(), (BLUE, OTHER_COLORS[2], VERMILION, GREEN), strict=True)
    ):
        places = np.arange(len(scenes)) + 0.2 * (k - 1.5)
        ax.bar(places, runs, 0.2, color=color, label=label, zorder=2)
        for place, value in zip(places, runs, strict=True):
            if np.isnan(value):
                ax.text(place, 0.045, "below 1", rotation=90, ha="center", fontsize="x-small")
    ax.set(yscale="log", ylim=(0.03, 4e5), ylabel="runs per second on one thread")
    ax.set_xticks(range(len(scenes)), table.column("scene, duration"))
    ax.grid(axis="y", alpha=0.3)
    ax.legend(fontsize="small", ncols=2, loc="upper center")
    return figure


def sensitivities() -> Figure:
    """Plot the cost of a sensitivity over the number of parameters."""
    table = page_table("speed_sensitivities.md", "scene", "run, operations")
    figure = Figure(figsize=(8.0, 3.2), layout="constrained")
    ax = figure.add_subplot()
    for row, style in zip(table.rows, ("o-", "s-", "^-", "v-", "D-", "o--", "s--"), strict=True):
        texts = dict(zip(table.heads, row, strict=True))
        masses = {count: texts["1 mass" if count == 1 else f"{count} masses"] for count in (1, 2, 4, 8)}
        costs = [(count, math.nan if text == "-" else float(text)) for count, text in masses.items()]
        ax.plot(*np.transpose(costs), style, label=row[0], markersize=5)
    ax.axhline(1.0, color="black", linewidth=0.8, linestyle=":")
    ax.text(8.1, 1.0, "a second run", fontsize="small", va="bottom", ha="right")
    ax.set(
        xscale="log",
        xlabel="number of masses",
        ylabel="cost of each, in runs",
        ylim=(0.0, None),
        xlim=(0.95, 8.4),
    )
    ax.set_xticks([1, 2, 4, 8], ["1", "2", "4", "8"])
    ax.minorticks_off()
    ax.legend(fontsize="small", ncols=2)
    ax.grid(alpha=0.3)
    return figure


def solvers() -> Figure:
    """Plot errors over run times of MuJoCo's constraint solvers."""
    table = page_table("speed.md", "scene, duration", "step, ms")
    figure = Figure(figsize=(8.0, 3.2), layout="constrained")
    scenes = sorted(set(table.column("scene, duration")))
    for ax, scene in zip(figure.subplots(1, len(scenes)), scenes, strict=True):
        rows = [row for row in table.rows if row[0] == scene]
        for solver, style in (("Newton", "o-"), ("CG", "s--"), ("PGS", "^:")):
            points = [row[table.heads.index(solver)].rsplit(", ", 1) for row in rows]
            times, errors = zip(*((numbers(time)[0], float(error)) for time, error in points), strict=True)
            ax.loglog(times, errors, style, label=solver)
        ax.set(title=scene, xlabel="run time, ms", ylabel="largest error, m or rad")
        ax.legend(fontsize="small")
        ax.grid(alpha=0.3)
    return figure
