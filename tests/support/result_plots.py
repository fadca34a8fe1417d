"""Plots of the pages on results, drawn from the numbers in the tables of these pages.

The tables are the stored numbers: a command writes most of them. A plot is therefore never newer or older
than the table on its page.
"""

from __future__ import annotations

import inspect
import math
import re
from collections import Counter
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from page_tables import RESULTS, TABLE, numbers, page_table
from speed_plots import batches, joints, sensitivities, solvers

from crosscheck.support.colors import BLUE, GREEN, OTHER_COLORS, VERMILION

GRAY, ORANGE = OTHER_COLORS[3], OTHER_COLORS[1]

ENGINE_COLORS = {"newton_euler": BLUE, "mujoco": VERMILION, "pinocchio": GREEN}


def horizontal(names: list[str], width: float = 8.0) -> tuple[Figure, Axes]:
    """Make an empty plot with one line for each name, the first one on top."""
    figure = Figure(figsize=(width, 0.9 + 0.27 * len(names)), layout="constrained")
    ax = figure.add_subplot()
    ax.set_yticks(range(len(names)), names, fontsize="small")
    ax.set_ylim(len(names) - 0.4, -0.6)
    ax.grid(axis="x", alpha=0.3)
    return figure, ax


def accuracy() -> Figure:
    """Plot the measured differences of the engines, and the bounds of the tests."""
    table = page_table("accuracy.md", "quantity", "measured")
    found = []
    for name, measured, bound in table.rows:
        values, bounds = numbers(measured.replace("m/s^2", "")), numbers(bound)
        if len(bounds) == 1 and max(values) < bounds[0]:
            found.append((name, max(values), bounds[0]))
    figure, ax = horizontal([name for name, _, _ in found])
    for row, (_, value, bound) in enumerate(found):
        ax.plot([value, bound], [row, row], color=GRAY, linewidth=1.0)
        ax.plot(value, row, "o", color=BLUE, label="" if row else "measured")
        ax.plot(bound, row, "|", color=VERMILION, markersize=12, label="" if row else "bound of the test")
    ax.set(xscale="log", xlabel="relative, m or rad")
    figure.legend(fontsize="small", ncols=2, loc="outside upper right")
    return figure


def stress() -> Figure:
    """Plot the fraction of passed stress cases of each engine and topic."""
    table = page_table("stress.md", "", "newton_euler")
    figure, ax = horizontal(table.column(""))
    ax.grid(visible=False)
    for k, (engine, color) in enumerate(ENGINE_COLORS.items()):
        for row, text in enumerate(table.column(engine)):
            if not text:
                continue
            passed, cases = numbers(text.replace("of", " "))
            place = row + 0.28 * (k - 1)
            ax.barh(place, 100.0, 0.24, left=0.0, color="#e8e8e8")
            ax.barh(place, 100.0 * passed / cases, 0.24, color=color, label="" if row else engine)
            ax.text(101.0, place, f"{passed:.0f} of {cases:.0f}", va="center", fontsize=6.5)
    ax.set(xlabel="passed cases, %", xlim=(0.0, 110.0))
    figure.set_figheight(5.6)
    figure.legend(fontsize="small", ncols=3, loc="outside upper center")
    return figure


def models() -> Figure:
    """Plot the verdicts of public models by repository, and what acts first in reduced models."""
    table = page_table("models.md", "robot", "verdict")
    verdicts: dict[str, Counter[str]] = {}
    for file, verdict in zip(table.column("file"), table.column("verdict"), strict=True):
        repository = file.partition(": ")[0].partition("/")[2]
        verdicts.setdefault(repository, Counter())[verdict] += 1
    verdicts = dict(sorted(verdicts.items(), key=lambda each: each[0].lower()))
    colors = {
        "AGREE": GREEN,
        "AGREE ON A REDUCED MODEL": OTHER_COLORS[2],
        "UNFINISHED": ORANGE,
        "refused": GRAY,
    }
    assert {verdict for counts in verdicts.values() for verdict in counts} <= colors.keys()
    figure = Figure(figsize=(8.0, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    done = np.zeros(len(verdicts))
    for verdict, color in colors.items():
        count = np.array([counts[verdict] for counts in verdicts.values()])
        left.barh(list(verdicts), count, left=done, color=color, label=verdict)
        done += count
    left.invert_yaxis()
    left.tick_params(axis="y", labelsize="small")
    left.set(xlabel="models", title="verdicts by repository")
    left.legend(fontsize="x-small")
    kinds = page_table("models.md", "kind of element", "models")
    right.barh(kinds.column("kind of element"), [float(n) for n in kinds.column("models")], color=BLUE)
    right.invert_yaxis()
    right.tick_params(axis="y", labelsize="small")
    right.set(xlabel="models", title="what acts first")
    return figure


LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9, "pm": 1e-12, "deg": 1.0, "rad": 57.29578}
"""Values of units of lengths, m, and of angles, degrees."""


def own_runs() -> Figure:
    """Plot the errors of runs of public models with their settings, and what the remedies change."""
    table = page_table("own_runs.md", "model", "accuracy")
    alone = page_table("own_runs.md", "model", "switched off in the run").column("error by the engine alone")
    colors = {"ACCURATE": GREEN, "OFF": ORANGE, "WRONG": VERMILION}
    errors, factors = [], []
    repository = ""
    for (model, word, error, _, _, remedies), repeated in zip(table.rows, alone, strict=True):
        if model.startswith("**"):
            repository = model.strip("*").partition(" ")[0].partition("/")[2]
        if word not in colors:
            continue
        (percent,) = re.findall(r"([\d.]+) %", error)
        *folders, file = model.removesuffix(".xml").split("/")
        name = " ".join(filter(None, [folders[0] if repository == "mujoco_menagerie" else repository, file]))
        errors.append((float(percent), word, name))
        costs = [
            1.0 if "same" in each else numbers(each)[-1] for each in remedies.split("; or ") if "time" in each
        ]
        sizes = [float(value) * LENGTHS[unit] for value, unit, *_ in map(str.split, repeated.split(";"))]
        if len(sizes) == len(costs) + 1 and "differs" not in repeated:
            factors += [(cost, sizes[0] / size, word) for cost, size in zip(costs, sizes[1:], strict=True)]
    errors.sort()
    figure = Figure(figsize=(8.0, 7.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    for row, (percent, word, _) in enumerate(errors):
        left.plot(percent, row, "o", color=colors[word], markersize=5)
    left.set_yticks(range(len(errors)), [name for _, _, name in errors], fontsize=6.5)
    left.set(xscale="log", xlabel="error, % of the motion", ylim=(-0.8, len(errors) - 0.2))
    left.set_title("with the settings of the file", fontsize="medium")
    for limit in (0.1, 1.0):
        left.axvline(limit, color="black", linewidth=0.8, linestyle=":")
    for word, color in colors.items():
        left.plot([], [], "o", color=color, label=word)
    left.legend(fontsize="small", loc="lower right")
    left.grid(axis="x", alpha=0.3)
    for cost, factor, word in factors:
        right.plot(cost, factor, "o", color=colors[word], markersize=5, alpha=0.7)
    right.set(xscale="log", yscale="log", xlabel="run time, relative to the file", ylabel="error divided by")
    right.set_title("with the remedies", fontsize="medium")
    right.axhline(1.0, color="black", linewidth=0.8, linestyle=":")
    right.grid(alpha=0.3)
    return figure


MOTION_BINS = ("equal", "rounding", "below 1 %", "1 to 10 %", "10 to 50 %", "50 to 100 %", "above 100 %")
"""Groups of pairs by their difference of motion."""


def pairs() -> Figure:
    """Plot how much the accelerations of pairs differ, and which quantities differ."""
    table = page_table("pairs.md", "pair: first and second file", "verdict")
    motion: Counter[str] = Counter()
    counts: Counter[str] = Counter()  # pairs by quantity
    for differences in table.column("differences"):
        found = {text.partition(" of ")[0] for text in re.split(r"\(\d\) ", differences)}
        counts.update(found & {*QUANTITIES})
    for text in table.column("accelerations"):
        if text in MOTION_BINS:
            motion[text] += 1
        elif text:
            limits = np.searchsorted([1.0, 10.0, 50.0, 100.0], numbers(text)[0])
            motion[MOTION_BINS[2 + int(limits)]] += 1
    figure = Figure(figsize=(8.0, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.barh(MOTION_BINS, [motion[each] for each in MOTION_BINS], color=BLUE)
    left.set(xlabel="pairs", title="difference of accelerations")
    names = [kind for kind, _ in counts.most_common(10)]
    right.barh(names, [counts[name] for name in names], color=VERMILION)
    right.set(xlabel="pairs", title="among the three largest differences")
    for ax in (left, right):
        ax.invert_yaxis()
        ax.grid(axis="x", alpha=0.3)
        ax.tick_params(axis="y", labelsize="small")
    return figure


QUANTITIES = (
    "armature",
    "damping",
    "dry friction",
    "mass",
    "center of mass",
    "inertia",
    "axes of inertia",
    "joint origin",
    "joint axis",
    "joint orientation",
    "stiffness",
    "base",
    "kp",
    "kv",
    "gear",
    "limits",
    "effort",
    "speed",
)
"""Quantities with which rows of `crosscheck diff` begin."""


def planted() -> Figure:
    """Plot the largest change of motion of each kind of injected change, and how many are identified."""
    table = page_table("planted.md", "change", "what is changed, by how much")
    files, identified = (
        np.array([float(text) for text in table.column(head)]) for head in ("files", "identified")
    )
    changes = np.array(
        [
            math.nan if text == "not computed" else float(text)
            for text in table.column("largest change of accelerations")
        ]
    )
    half = (len(files) + 1) // 2
    figure = Figure(figsize=(8.0, 0.18 * half + 0.9), layout="constrained")
    for ax, rows in zip(figure.subplots(1, 2), (slice(half), slice(half, None)), strict=True):
        names = [
            f"{name} ({right:.0f} of {count:.0f})"
            for name, right, count in zip(
                table.column("change")[rows], identified[rows], files[rows], strict=True
            )
        ]
        ax.set_yticks(range(len(names)), names, fontsize=7.0)
        ax.plot(np.maximum(changes[rows], 1e-16), range(len(names)), "o", color=BLUE, markersize=4)
        ax.set(xscale="log", xlim=(3e-17, 3e4), ylim=(half - 0.3, -0.7))
        ax.set_xlabel("change of accelerations, relative", fontsize="small")
        ax.axvline(1e-6, color="black", linewidth=0.8, linestyle=":")
        ax.tick_params(axis="x", labelsize="small")
        ax.grid(axis="x", alpha=0.3)
    return figure


def tolerances() -> Figure:
    """Plot the distribution of the pointing error, and the share of each joint."""
    found = page_table("tolerances.md", "fraction of the trackers", "error at most, mrad")
    figure = Figure(figsize=(8.0, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(2, 3))
    fractions = [100.0 if "all" in text else numbers(text)[0] for text in found.column(found.heads[0])]
    errors = [float(text) for text in found.column("error at most, mrad")]
    left.plot([0.0, *errors], [0.0, *fractions], "o-", color=BLUE)
    left.axvline(4.7, color=VERMILION, linestyle=":", label="radius of the sun")
    left.set(xlabel="error at most, mrad", ylabel="trackers, %", xlim=(0.0, None), ylim=(0.0, 105.0))
    left.legend(fontsize="small")
    left.grid(alpha=0.3)
    table = page_table("tolerances.md", "joint", "normal along x")
    joints = [name.partition(",")[0] for name in table.column("joint")]
    places = np.arange(len(joints))
    for k, (axis, color) in enumerate((("x", BLUE), ("y", ORANGE))):
        shares = [
            0.0 if "below" in text else numbers(text)[0] for text in table.column(f"normal along {axis}")
        ]
        right.barh(places + 0.4 * (k - 0.5), shares, 0.4, color=color, label=f"normal along {axis}")
    right.set_yticks(places, joints, fontsize="small")
    right.invert_yaxis()
    right.set(xlabel="share of the variance, %", xlim=(0.0, 26.0))
    right.legend(fontsize="small", loc="lower right")
    right.grid(axis="x", alpha=0.3)
    return figure


def library() -> Figure:
    """Plot the errors of newton_euler against known answers."""
    table = page_table("library.md", "scene", "what it tests")
    found = [
        (name, numbers(error)[0])
        for name, error in zip(table.column("scene"), table.column("error"), strict=True)
        if numbers(error) and name != "excavator"
    ]
    found.sort(key=lambda each: each[1])
    figure, ax = horizontal([name for name, _ in found])
    for row, (_, error) in enumerate(found):
        ax.plot([1e-16, error], [row, row], color=GRAY, linewidth=1.0)
        ax.plot(error, row, "o", color=BLUE)
    ax.axvline(2.2e-16, color="black", linewidth=0.8, linestyle=":")
    ax.text(2.5e-16, len(found) - 0.7, "machine epsilon", fontsize="small")
    ax.set(xscale="log", xlim=(1e-16, 1e-9), xlabel="largest relative difference from the known answer")
    return figure


EFFECT = re.compile(r"(?:change|differ)s?\b[^.]*? by ([\d.]+) %\s\(([\d.]+)\s?%")
"""Effect of an entry on accelerations: median and 95th percentile."""


def effects() -> list[tuple[float, float, str]]:
    """Effects of the faults of robots, %: median and 95th percentile, and the name of the robot."""
    rows = []
    for page in FOUND_PAGES:
        for entry in re.split(r"^### ", (RESULTS / page).read_text(), flags=re.MULTILINE)[1:]:
            title, _, text = entry.partition("\n")
            if effect := EFFECT.search(" ".join(text.split())):
                rows.append((float(effect[1]), float(effect[2]), title.replace("`", "")))
    return sorted(rows, reverse=True)


def found_effects() -> Figure:
    """Plot the effects of faults in public models on accelerations: median to 95th percentile."""
    rows = effects()
    figure, ax = horizontal([name for _, _, name in rows])
    figure.set_figheight(0.8 + 0.19 * len(rows))
    ax.tick_params(axis="y", labelsize=6.5)
    for row, (median, high, _) in enumerate(rows):
        ax.plot([median, high], [row, row], color=GRAY)
        ax.plot(median, row, "o", color=BLUE, markersize=4, label="" if row else "median")
        ax.plot(high, row, "|", color=VERMILION, label="" if row else "95th percentile")
    ax.set(xscale="log", xlabel="change of accelerations, %")
    ax.legend(fontsize="small", loc="lower right")
    return figure


FOUND_PAGES = ("found_humanoids.md", "found_quadrupeds.md", "found_arms.md")
"""Pages on faults in models of robots."""


class ResultPlot(NamedTuple):
    """A plot of a page: the function that draws it, and the pages whose tables it shows."""

    draw: Callable[[], Figure]
    pages: tuple[str, ...]


RESULT_PLOTS = {
    "plot_accuracy": ResultPlot(accuracy, ("accuracy.md",)),
    "plot_speed_joints": ResultPlot(joints, ("speed_equations.md",)),
    "plot_speed_batches": ResultPlot(batches, ("speed_batches.md",)),
    "plot_speed_sensitivities": ResultPlot(sensitivities, ("speed_sensitivities.md",)),
    "plot_speed_solvers": ResultPlot(solvers, ("speed.md",)),
    "plot_stress": ResultPlot(stress, ("stress.md",)),
    "plot_models": ResultPlot(models, ("models.md",)),
    "plot_own_runs": ResultPlot(own_runs, ("own_runs.md",)),
    "plot_pairs": ResultPlot(pairs, ("pairs.md",)),
    "plot_planted": ResultPlot(planted, ("planted.md",)),
    "plot_tolerances": ResultPlot(tolerances, ("tolerances.md",)),
    "plot_library": ResultPlot(library, ("library.md",)),
    "plot_found": ResultPlot(found_effects, FOUND_PAGES),
}
"""Plots of the pages on results, by the name of the picture."""


def result_content(name: str) -> str:
    """What a plot is made from: the code that draws it, and the tables of its pages."""
    plot = RESULT_PLOTS[name]
    pages = [(RESULTS / page).read_text() for page in plot.pages]
    values = [found[0] for page in pages for found in TABLE.finditer(page)]
    if plot.draw is found_effects:
        values = [repr(effects())]
    return "\n".join([inspect.getsource(plot.draw), *values])
