"""Pictures of the runs of a crosscheck, from the arrays that it saved."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from crosscheck.comparison.figure import OPEN, POSES
from crosscheck.palette import palette
from newton_euler.model.euler_parameters import angle_between
from newton_euler.scalars import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DASHES = {"newton_euler": ("-", 2.6), "mujoco": ("--", 1.6), "pinocchio": (":", 1.8)}
"""Dash and width of each engine's curves; thick under thin, so that equal curves all show."""

SMALLEST = 1e-18
"""Where logarithms are cut off, so that zero can be drawn."""

OTHER_DASH = ("-.", 1.6)
"""Of curves that `DASHES` does not know."""

Runs = Mapping[str, Mapping[str, Array]]
"""Arrays of `Trajectory.arrays` by name, by engine; the first engine is what others are compared with."""

Bounds = Mapping[tuple[str, ...], float | None]
"""Tolerances by quantity and names of one or two engines."""

Line = tuple[str, str, Array, Array]
"""Label of its panel, engine, times and values."""


def speed(costs: Mapping[str, tuple[float | None, float | None]]) -> Iterator[tuple[bytes, str]]:
    """Draw error, m and rad, over run time, s, of each engine that has both."""
    from matplotlib.figure import Figure

    known = {name: (time, error) for name, (time, error) in costs.items() if time and error}
    if not known:
        return
    figure = Figure(figsize=(4.6, 3.2), layout="constrained")
    ax = figure.add_subplot()
    colors = palette(list(costs))
    for name, (time, error) in known.items():
        ax.loglog(time, error, "o", color=colors[name], markersize=10, label=name)
    ax.set_xlabel("run time, s")
    ax.set_ylabel("error, m or rad")
    ax.grid(alpha=0.3)
    ax.margins(0.3)
    ax.legend(loc="best", fontsize="small")
    yield png(figure), "Run time and error of each engine at its defaults; best is at the lower left"


def pictures(runs: Runs, bounds: Bounds) -> Iterator[tuple[bytes, str]]:
    """Draw differences, drift and energies, as PNG with captions; what was not saved is left out."""
    yield from _differences(runs, bounds)
    yield from _drift(runs, bounds)
    yield from _energy(runs)


def png(figure: Figure, dpi: int = 100) -> bytes:
    """A figure as a PNG."""
    content = io.BytesIO()
    figure.savefig(content, dpi=dpi, format="png")
    return content.getvalue()


def _axes(labels: list[str]) -> tuple[Figure, list[Axes]]:
    """Panels side by side, over time."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.6 * max(len(labels), 2), 3.2), layout="constrained")
    axes = [figure.add_subplot(1, len(labels), k + 1) for k in range(len(labels))]
    for ax, label in zip(axes, labels, strict=True):
        ax.set_title(label, fontsize="medium")
        ax.set_xlabel("time, s")
        ax.grid(alpha=0.3)
    return figure, axes


def curve(ax: Axes, engine: str, color: str, time: Array, values: Array) -> None:
    """Draw a quantity over time in the engine's style."""
    dash, width = DASHES.get(engine, OTHER_DASH)
    ax.plot(time, values, color=color, linestyle=dash, linewidth=width, label=engine)


def _over_time(runs: Runs, name: str, label: str) -> Iterator[Line]:
    """Of those runs that have an array."""
    for engine, run in runs.items():
        if name in run:
            yield label, engine, run["time"], run[name]


def _drawn(
    lines: list[Line],
    colors: Mapping[str, str],
    caption: str,
    logarithmic: bool = False,
    tolerances: Mapping[tuple[str, str], float | None] | None = None,
) -> Iterator[tuple[bytes, str]]:
    """One picture, a panel for each label, with tolerances by label and engine; none without lines."""
    labels = list(dict.fromkeys(label for label, *_ in lines))
    if not labels:
        return
    figure, axes = _axes(labels)
    for label, engine, time, values in lines:
        curve(axes[labels.index(label)], engine, colors[engine], time, values)
        if bound := (tolerances or {}).get((label, engine)):
            axes[labels.index(label)].axhline(bound, color=colors[engine], linewidth=0.8)
    for ax in axes:
        if logarithmic:
            ax.set_yscale("log")
    axes[0].legend(loc="best", fontsize="small")
    yield png(figure), caption


def _differences(runs: Runs, bounds: Bounds) -> Iterator[tuple[bytes, str]]:
    reference, *others = runs.items()
    lines, tolerances = [], {}
    for engine, run in others:
        n = min(len(run["time"]), len(reference[1]["time"]))  # a run may have ended early
        first, other, time = reference[1], run, run["time"][:n]
        distance = np.linalg.norm(other["position"][:n] - first["position"][:n], axis=2).max(axis=1)
        angle = angle_between(first["quaternion"][:n], other["quaternion"][:n]).max(axis=1)
        for quantity, values in zip(POSES, (distance, angle), strict=True):
            lines.append((quantity, engine, time, np.maximum(values, SMALLEST)))
            tolerances[quantity, engine] = bounds.get((quantity, reference[0], engine))
    caption = f"Difference from {reference[0]}, largest over the bodies; thin lines are tolerances"
    yield from _drawn(lines, palette(list(runs)), caption, True, tolerances)


def _drift(runs: Runs, bounds: Bounds) -> Iterator[tuple[bytes, str]]:
    lines = [
        (label, engine, time, np.maximum(violation.max(axis=1, initial=0.0), SMALLEST))
        for label, engine, time, violation in _over_time(runs, "constraint_violation", OPEN)
    ]
    tolerances = {(OPEN, engine): bounds.get((OPEN, engine)) for engine in runs}
    caption = "Drift: how far joints are open, largest over the joints; thin lines are tolerances"
    yield from _drawn(lines, palette(list(runs)), caption, True, tolerances)


def _energy(runs: Runs) -> Iterator[tuple[bytes, str]]:
    lines = [*_over_time(runs, "kinetic_energy", "kinetic, J")]
    lines += _over_time(runs, "potential_energy", "potential, J")
    lines += _over_time(runs, "work", "work done by what has no potential, J")
    yield from _drawn(lines, palette(list(runs)), "Energy")
