"""Plots of the pages on theory: branches of a parallelogram, noise in files, and coverage."""

from __future__ import annotations

import inspect
import re

import numpy as np
from matplotlib.figure import Figure
from page_tables import RESULTS

from crosscheck.compare.changes import elements
from crosscheck.library import load
from newton_euler import simulate

NOISE_PAGE = RESULTS / "stress.md"

CRANK, GROUND = 0.5, 1.0
"""Lengths of a parallelogram, m: crank and rocker, ground and coupler."""

SLIDER = "inertia of body 'slider'"
"""Element of the slider-crank that its motion does not excite: the slider does not rotate."""

TOLERANCE = 2e-9
"""Tolerance of positions of the slider-crank in newton_euler and Pinocchio, m."""

MIN_DISTANCE = 1e-16
"""Smallest distance on the logarithmic axis, m; smaller ones are drawn there."""


def bifurcation() -> Figure:
    """Plot the poses of a parallelogram and of linkages with another coupler, and how singular they are.

    Crank and rocker turn by the angles x and y. The joints between them are apart by the coupler's length c:
    f(x, y) = |A(x) - B(y)|^2 - c^2 = 0. A pose is singular where both derivatives of f are zero.
    """
    angle = np.radians(np.linspace(-90.0, 270.0, 721))
    x, y = np.meshgrid(angle, angle)
    distance = np.hypot(
        GROUND + CRANK * (np.cos(y) - np.cos(x)), CRANK * (np.sin(y) - np.sin(x))
    )  # of the joints at the ends of the coupler
    figure = Figure(figsize=(8.0, 3.6), layout="constrained")
    poses, gradient = figure.subplots(1, 2)
    lines = ((0.99, "C1", "--"), (1.0, "C0", "-"), (1.01, "C2", ":"))
    for ratio, color, style in lines:
        label = f"coupler = {ratio:g} x ground"
        poses.contour(
            np.degrees(angle),
            np.degrees(angle),
            distance - ratio * GROUND,
            [0.0],
            colors=color,
            linestyles=style,
        )
        poses.plot([], [], color=color, linestyle=style, label=label)
    poses.plot([0, 180], [0, 180], "ko", label="singular")
    poses.set(xlabel="crank, degrees", ylabel="rocker, degrees", title="poses that close the loop")
    poses.legend(fontsize="small", loc="lower right")
    # on the branch x = y: df/dx = 2 c CRANK sin(x) and df/dy = -2 c CRANK sin(x)
    slope = 2.0 * GROUND * CRANK * np.sqrt(2.0) * np.abs(np.sin(angle))
    gradient.plot(np.degrees(angle), slope / slope.max())
    gradient.plot([0, 180], [0, 0], "ko")
    gradient.set(
        xlabel="crank, degrees", title="singular value of the constraint", ylabel="relative to its maximum"
    )
    for ax in (poses, gradient):
        ax.grid(alpha=0.3)
    return figure


def measured() -> dict[str, tuple[list[str], np.ndarray]]:
    """Read the tables of the page: by mechanism the engines, and rows of noise and deviations, m."""
    found = {}
    for name, head, rows in re.findall(
        r"^`(\w+)`\n\n\| noise \|(.*)\|\n\|[-|]*\|\n((?:\|.*\n)+)", NOISE_PAGE.read_text(), re.MULTILINE
    ):
        engines = [each.strip() for each in head.split("|")]
        values = [[float(x) for x in row.strip("|").split("|")] for row in rows.splitlines()]
        found[name] = engines, np.array(values)
    return found


def redundancy() -> Figure:
    """Plot the deviation of runs from the design over the noise of the file, for each mechanism."""
    figure = Figure(figsize=(8.0, 5.6), layout="constrained")
    chosen = {
        "newton_euler, relative, projection": "newton_euler",
        "mujoco": "mujoco",
        "pinocchio": "pinocchio",
    }
    for k, (name, (engines, rows)) in enumerate(measured().items()):
        ax = figure.add_subplot(2, 2, k + 1)
        for (column, label), style in zip(chosen.items(), ("o-", "s--", "^:"), strict=True):
            ax.loglog(rows[:, 0], rows[:, 1 + engines.index(column)], style, label=label, markersize=4)
        ax.set(title=name, xlabel="noise, m or rad", ylabel="deviation, m", ylim=(1e-13, 2.0))
        ax.grid(alpha=0.3)
    figure.axes[0].legend(fontsize="small")
    return figure


def coverage() -> Figure:
    """Plot how far changed elements move the bodies of a slider-crank, and the tolerance of the engines."""
    scene, tight = load("slider_crank"), {"rtol": 1e-12, "atol": 1e-14}
    original = simulate(scene, **tight).position
    figure = Figure(figsize=(8.0, 3.6), layout="constrained")
    ax = figure.subplots()
    lines = {"joint 'pivot'": "-", "mass of body 'rod'": "--", "inertia of body 'crank'": "-.", SLIDER: ":"}
    for element in elements(scene):
        if element.name in lines:
            run = simulate(element.changed(scene), **tight)
            distance = np.linalg.norm(run.position - original, axis=2).max(axis=1)
            ax.semilogy(run.time, np.maximum(distance, MIN_DISTANCE), lines[element.name], label=element.name)
    ax.axhline(TOLERANCE, color="k", label="tolerance of the engines")
    ax.set(xlabel="time, s", ylabel="largest distance of a body, m", ylim=(1e-17, 10.0))
    ax.legend(fontsize="small", loc="lower right", bbox_to_anchor=(1.0, 0.12))
    ax.grid(alpha=0.3)
    return figure


THEORY_PLOTS = {"plot_bifurcation": bifurcation, "plot_redundancy": redundancy, "plot_coverage": coverage}
"""Functions that draw plots, by the name of the picture."""


def theory_content(name: str) -> str:
    """What a plot is made from: the code that draws it, and the values of tables."""
    return inspect.getsource(THEORY_PLOTS[name]) + repr(
        [(engines, rows.tolist()) for engines, rows in measured().values()]
    )
