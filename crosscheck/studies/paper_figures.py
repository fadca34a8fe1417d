"""Plots of figures 5 to 9 of the paper on the solar tracker, with one curve for each engine.

The engines are MuJoCo, Pinocchio and this project's solver newton_euler. The paper is the source of the
library scene `tracker`, see `crosscheck.library.tracker`: two vertical sliders tilt a solar panel. In the
comparison of engines, newton_euler uses the method of the paper: Cartesian coordinates, Euler parameters
(quaternions), and Baumgarte stabilization with alpha = 10 1/s. Body k of the paper has index k - 1 in arrays.
Black marks are the values that the paper prints as numbers: the start (Tables 2 and 3) and the target
(sections 4 and 5). `crosscheck figures` calls `draw`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from crosscheck.engines.palette import palette
from crosscheck.engines.registry import ENGINES, SOLVER
from crosscheck.library import load
from crosscheck.library.tracker import CENTER_OF_MASS, EULER_PARAMETERS, TARGET_HEIGHT
from crosscheck.report.plots import draw_curve, own_style, png
from crosscheck.support.files import check_writable, write_files
from newton_euler import simulate
from newton_euler.integrators.options import STABILIZATIONS
from newton_euler.model.euler_parameters import rotations
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def draw(folder: Path, progress: Callable[[str], None]) -> list[Path]:
    """Simulate the scene `tracker` with all engines and write `figure_5.png` to `figure_9.png`.

    Args:
        folder: folder of the files.
        progress: called with the name of each engine before its run.

    Returns:
        The paths of the files.

    Raises:
        CrosscheckError: naming the path that cannot be written.
    """
    paths = {number: folder / f"figure_{number}.png" for number in FIGURES}
    check_writable(*paths.values())
    scene = load("tracker")
    runs = {}
    for name, engine in ENGINES.items():
        progress(name)
        runs[name] = (
            simulate(scene, formulation="cartesian", stabilization="baumgarte")
            if name == SOLVER.name
            else engine.simulate(scene)
        )
    with own_style():  # matplotlib's default style
        pictures = {path: png(FIGURES[number](scene, runs), dpi=120) for number, path in paths.items()}
    write_files(pictures)
    return list(paths.values())


def _figure_with_panels(title: str, labels: Sequence[str], columns: int = 1) -> tuple[Figure, list[Axes]]:
    """Return a figure with one panel for each label of a vertical axis, row by row."""
    from matplotlib.figure import Figure

    rows = -(-len(labels) // columns)
    figure = Figure(figsize=(7.0, 1.0 + 1.5 * rows), layout="constrained")  # inches
    axes = [figure.add_subplot(rows, columns, k + 1) for k in range(len(labels))]
    figure.suptitle(title)
    for ax, label in zip(axes, labels, strict=True):
        ax.set_ylabel(label)
        ax.grid(alpha=0.3)
    for ax in axes[-columns:]:
        ax.set_xlabel("time, s")
    return figure, axes


def _plot(axes: list[Axes], runs: dict[str, Trajectory], columns: Callable[[Trajectory], Array]) -> None:
    """Plot one curve per engine in each panel.

    Args:
        axes: the panels.
        runs: runs by engine.
        columns: returns the values (n, panels) of a run at its n output times, one column for each panel.
    """
    colors = palette(list(runs))
    for name, run in runs.items():
        for ax, values in zip(axes, columns(run).T, strict=True):
            draw_curve(ax, name, colors[name], run.time, values)
    axes[0].legend(loc="best", fontsize="small")


def _mark(axes: list[Axes], start: Array, target: Sequence[float | None]) -> None:
    """Mark the values that the paper prints: dots at the start, dashed lines at the target.

    Args:
        axes: the panels.
        start: value at the start, by panel.
        target: value at the end, by panel; None if the paper does not state one.
    """
    for ax, first, last in zip(axes, start, target, strict=True):
        ax.plot(0.0, first, "ko", markersize=5, zorder=3, label="paper, Tables 2 and 3")
        if last is not None:
            ax.axhline(last, color="k", linestyle=(0, (6, 4)), linewidth=0.8, label="paper, target")
    # One legend for all panels, as the first panel may have no target
    labeled = {
        label: line for ax in axes for line, label in zip(*ax.get_legend_handles_labels(), strict=True)
    }
    axes[0].legend(labeled.values(), labeled.keys(), loc="best", fontsize="small")


def _rotation_angles(quaternion: Array) -> Array:
    """Return angles (n, 3), deg, of orientations (n, 4): rotations about the fixed axes x, then y, then z."""
    r = rotations(quaternion)  # R_z R_y R_x
    x = np.arctan2(r[:, 2, 1], r[:, 2, 2])
    y = np.arctan2(-r[:, 2, 0], np.hypot(r[:, 2, 1], r[:, 2, 2]))
    z = np.arctan2(r[:, 1, 0], r[:, 0, 0])
    return np.degrees(np.stack([x, y, z], axis=1))


def sliders(scene: Scene, runs: dict[str, Trajectory]) -> Figure:
    """Plot figure 5: heights z2 and z3 of both sliders over time, m, and their target."""
    figure, axes = _figure_with_panels(
        "Figure 5: response of the actuators' displacement", ["z2, m", "z3, m"]
    )
    _plot(axes, runs, lambda run: run.position[:, 1:3, 2])  # the sliders are bodies 2 and 3
    _mark(axes, CENTER_OF_MASS[1:3, 2], [TARGET_HEIGHT, TARGET_HEIGHT])
    return figure


def violation(scene: Scene, runs: dict[str, Trajectory]) -> Figure:
    """Plot figure 6: constraint violation of each engine, and of newton_euler with coarse steps.

    With coarse steps, newton_euler uses joint coordinates, its default for this scene, and there is a curve
    for each method of stabilization.
    """
    labels = ["engines", f"{SOLVER.name}\nRK4 at 10 ms"]
    figure, axes = _figure_with_panels("Figure 6: kinematic constraints, largest |Phi|, m or rad", labels)

    def largest(run: Trajectory) -> Array:
        """Return the largest violation (n, 1) of all joints, at least 1e-18: a logarithmic axis has no 0."""
        assert run.constraint_violation is not None
        return np.maximum(run.constraint_violation.max(axis=1, keepdims=True), 1e-18)

    _plot(axes[:1], runs, largest)
    for stabilization in STABILIZATIONS:
        run = simulate(scene, integrator="RK4", step=0.01, stabilization=stabilization)
        axes[1].plot(run.time, largest(run), label=stabilization)
    axes[1].legend(loc="best", fontsize="small")
    for ax in axes:
        ax.set_yscale("log")
    return figure


def orientation(scene: Scene, runs: dict[str, Trajectory]) -> Figure:
    """Plot figure 7: orientation of the panel, as rotations about the fixed axes x, then y, then z, deg."""
    labels = ["about x, deg", "about y, deg", "about z, deg"]
    figure, axes = _figure_with_panels("Figure 7: orientation of the solar panel", labels)

    _plot(axes, runs, lambda run: _rotation_angles(run.quaternion[:, -1]))  # the panel is the last body, 7
    # The paper states that the panel ends parallel to the ground, and does not state the angle about z
    _mark(axes, _rotation_angles(EULER_PARAMETERS[-1:])[0], [0.0, 0.0, None])
    return figure


def euler_parameters(scene: Scene, runs: dict[str, Trajectory]) -> Figure:
    """Plot figure 8: Euler parameters of the panel, the components (w, x, y, z) of its quaternion."""
    title = "Figure 8: Euler parameters of the solar panel, dimensionless"
    figure, axes = _figure_with_panels(title, ["e0", "e1", "e2", "e3"], columns=2)
    _plot(axes, runs, lambda run: run.quaternion[:, -1])
    _mark(axes, EULER_PARAMETERS[-1], [None, 0.0, 0.0, None])
    return figure


def norm(scene: Scene, runs: dict[str, Trajectory]) -> Figure:
    """Plot figure 9: error p7^T p7 - 1 of the norm of the Euler parameters p7 of the panel, body 7."""
    title = "Figure 9: norm of the panel's Euler parameters, dimensionless"
    figure, axes = _figure_with_panels(title, ["p7^T p7 - 1"])
    _plot(axes, runs, lambda run: np.sum(run.quaternion[:, -1:] ** 2, axis=2) - 1.0)
    return figure


FIGURES: dict[int, Callable[[Scene, dict[str, Trajectory]], Figure]] = {
    5: sliders,
    6: violation,
    7: orientation,
    8: euler_parameters,
    9: norm,
}
"""Functions of the scene and the runs by engine that plot a figure, by its number in the paper."""
