"""Draw the runs of a crosscheck: differences from the first engine, drift and energies.

A crosscheck simulates one model in several engines (simulators). In: the arrays of the runs that
`crosscheck run` stored, by engine. Out: pictures (PNG) with captions.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from crosscheck.compare.check import CONSTRAINT_VIOLATION, POSES
from crosscheck.engines.engine import OTHER_LINE
from crosscheck.engines.palette import line_of, palette
from crosscheck.own_run.allowed import OWN_RUN, REDUCED_RUN
from newton_euler.model.euler_parameters import angle_between
from newton_euler.scalars import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LOG = "log"
"""Label of the curves of a log; the caption has its name."""

SOLID = ("-", 1.6)
"""Dash pattern and width (points) of the curves of logs and of files' own runs."""

MIN_LOG_VALUE = 1e-18
"""Smallest value on logarithmic axes; smaller values, also zero, are replaced by this one."""

Runs = Mapping[str, Mapping[str, Array]]
"""Arrays of `Trajectory.arrays`, by engine and by name; other engines are compared with the first."""

Tolerances = Mapping[tuple[str, ...], float | None]
"""Tolerances by the name of a quantity and the names of one or two engines."""


class Curve(NamedTuple):
    """A curve of a plot over time.

    Attributes:
        label: the quantity with its unit, which is the label of the axis.
        engine: name of the engine.
        time: (n,) s.
        values: (n,) values, in the unit of the label.
    """

    label: str
    engine: str
    time: Array
    values: Array


@contextmanager
def own_style() -> Iterator[None]:
    """Within a block or function, use matplotlib's default style instead of the user's `matplotlibrc`."""
    from matplotlib import style

    with style.context("default"):
        yield


def pictures(runs: Runs, tolerances: Tolerances) -> Iterator[tuple[bytes, str]]:
    """Draw differences, drift and energies over time; quantities that were not stored are left out.

    Args:
        runs: arrays of each engine's run.
        tolerances: tolerances, which are drawn as thin lines.

    Yields:
        Pictures (PNG) with their captions.
    """
    yield from _differences(runs, tolerances)
    yield from _drift(runs, tolerances)
    yield from _energy(runs)


def run_errors(
    time: Sequence[float], position: Sequence[float], rotation: Sequence[float], name: str
) -> Iterator[tuple[bytes, str]]:
    """Draw the errors of the run with the settings of a model file, or of a log, largest over the bodies.

    Errors are deviations from the accurate reference run of newton_euler.

    Args:
        time: output times (n,), s.
        position: errors of the centers of mass (n,), m.
        rotation: errors of the orientations (n,), rad.
        name: `OWN_RUN`, `REDUCED_RUN`, or the name of the log.

    Yields:
        Pictures (PNG) with their captions.
    """
    label, what = (OWN_RUN, f"run with {name}") if name in (OWN_RUN, REDUCED_RUN) else (LOG, f"log {name}")
    errors = (("error of position, m", position), ("error of orientation, rad", rotation))
    curves = [Curve(quantity, label, np.array(time), np.array(values)) for quantity, values in errors]
    yield from _draw(curves, palette([label]), f"{what}, largest over the bodies")


@own_style()
def png(figure: Figure, dpi: int = 100) -> bytes:
    """Convert a figure of matplotlib to the content of a PNG; `dpi` is in pixels per inch."""
    content = io.BytesIO()
    figure.savefig(content, dpi=dpi, format="png")
    return content.getvalue()


def draw_curve(ax: Axes, engine: str, color: str, time: Array, values: Array) -> None:
    """Draw values (n,) over times (n,), s, in the style of an engine."""
    dash, width = SOLID if engine in (OWN_RUN, LOG) else line_of(engine) or OTHER_LINE
    ax.plot(time, values, color=color, linestyle=dash, linewidth=width, label=engine)


def _arrays_over_time(runs: Runs, name: str) -> Iterator[tuple[str, Array, Array]]:
    """Yield engine, times (n,), s, and the array (n, ...) of a name, unless all its values are zero.

    Args:
        runs: arrays of each engine's run; runs without the array are left out.
        name: name of the array.
    """
    having = [(engine, run) for engine, run in runs.items() if name in run]
    if any(np.any(run[name]) for _, run in having):
        for engine, run in having:
            yield engine, run["time"], run[name]


def _draw(
    curves: list[Curve],
    colors: Mapping[str, str],
    caption: str,
    logarithmic: bool = False,
    tolerances: Mapping[tuple[str, str], float | None] | None = None,
) -> Iterator[tuple[bytes, str]]:
    """Draw a picture over time for each label of the curves.

    Args:
        curves: the curves.
        colors: color of each engine.
        caption: caption, after the label.
        logarithmic: whether the axis of values is logarithmic.
        tolerances: tolerances by label and engine.

    Yields:
        Pictures (PNG) with their captions.
    """
    for label in dict.fromkeys(each.label for each in curves):
        of_label = [each for each in curves if each.label == label]
        figure = _plot_quantity(label, of_label, colors, tolerances or {}, "log" if logarithmic else "linear")
        yield png(figure), f"{label}: {caption}"


@own_style()
def _plot_quantity(
    label: str,
    curves: Sequence[Curve],
    colors: Mapping[str, str],
    tolerances: Mapping[tuple[str, str], float | None],
    scale: str,
) -> Figure:
    """Draw a quantity over time: a curve and the tolerance of each engine; `scale` is "log" or "linear"."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.8, 3.2), layout="constrained")
    ax = figure.add_subplot()
    for _, engine, time, values in curves:
        draw_curve(ax, engine, colors[engine], time, values)
        if tolerance := tolerances.get((label, engine)):
            ax.axhline(tolerance, color=colors[engine], linewidth=0.8)
    ax.set_yscale(scale)
    ax.set(xlabel="time, s", ylabel=label)
    ax.grid(alpha=0.3)
    ax.legend(loc="best", fontsize="small")
    return figure


def _differences(runs: Runs, tolerances: Tolerances) -> Iterator[tuple[bytes, str]]:
    """Draw the largest distance and angle of any body between each run and the first run."""
    (first_engine, first), *others = runs.items()
    curves, of_engines = [], {}
    for engine, run in others:
        n = min(len(run["time"]), len(first["time"]))  # a run may have ended early
        distance = np.linalg.norm(run["position"][:n] - first["position"][:n], axis=2).max(axis=1)
        angle = angle_between(first["quaternion"][:n], run["quaternion"][:n]).max(axis=1)
        for quantity, values in zip(POSES, (distance, angle), strict=True):  # positions, orientations
            curves.append(Curve(quantity, engine, run["time"][:n], np.maximum(values, MIN_LOG_VALUE)))
            of_engines[quantity, engine] = tolerances.get((quantity, first_engine, engine))
    caption = f"difference from {first_engine}, largest over the bodies; thin lines are tolerances"
    yield from _draw(curves, palette(list(runs)), caption, logarithmic=True, tolerances=of_engines)


def _drift(runs: Runs, tolerances: Tolerances) -> Iterator[tuple[bytes, str]]:
    """Draw the constraint violation (drift) of each run, largest over the joints."""
    label = CONSTRAINT_VIOLATION
    curves = []
    for engine, time, violation in _arrays_over_time(runs, "constraint_violation"):
        largest = violation.max(axis=1, initial=0.0)  # of all joints, (n,)
        curves.append(Curve(label, engine, time, np.maximum(largest, MIN_LOG_VALUE)))
    of_engines = {(label, engine): tolerances.get((label, engine)) for engine in runs}
    caption = "drift, largest over the joints; thin lines are tolerances"
    yield from _draw(curves, palette(list(runs)), caption, logarithmic=True, tolerances=of_engines)


def _energy(runs: Runs) -> Iterator[tuple[bytes, str]]:
    """Draw the kinetic and the potential energy of each run, and the work of forces without a potential."""
    labels = {
        "kinetic_energy": "kinetic, J",
        "potential_energy": "potential, J",
        "work": "work done by what has no potential, J",
    }
    curves = [
        Curve(label, engine, time, values)
        for name, label in labels.items()
        for engine, time, values in _arrays_over_time(runs, name)
    ]
    yield from _draw(curves, palette(list(runs)), "energy")
