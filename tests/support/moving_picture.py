"""Moving picture of the README: a run of MuJoCo with the settings of its file, over the reference solution.

`python tests/support/pictures.py motion` makes the picture. The model is `examples/rocker.xml`.
"""

from __future__ import annotations

import io
from pathlib import Path

import matplotlib as mpl
import numpy as np
from PIL import Image

import crosscheck
from crosscheck.compare.run_differences import positions_apart
from crosscheck.own_run.judge import Judgement
from crosscheck.support.colors import BLUE, VERMILION
from newton_euler.model.euler_parameters import rotation
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

MODEL = Path(__file__).parents[2] / "examples" / "rocker.xml"

BARS = {"crank": (0.3, 0.0, 0.0), "rod": (0.7, 0.0, -0.2), "rocker": (0.0, 0.0, -0.7)}
"""Vector from one end of each bar to the other in the file, m; centers of mass are in the middle."""

DURATION, FRAMES = 3.0, 34
"""Duration, s, and number of frames; one second of motion takes about two seconds in the picture."""

SIZE, DPI = (6.0, 2.6), 100
"""Size, inches, and pixels per inch."""

COLORS = 8
"""Number of colors of a frame."""

MILLISECONDS = 170
"""Duration of a frame."""

FILE = "own_run.gif"
"""Name of the picture."""


def content() -> str:
    """What the picture is made from: the model, and this module."""
    return MODEL.read_text() + Path(__file__).read_text()


def save(folder: Path, comment: str) -> None:
    """Write the picture with a comment."""
    first, *others = (each.quantize(COLORS, dither=Image.Dither.NONE) for each in frames(own_run()))
    options = {
        "save_all": True,
        "append_images": others,
        "duration": MILLISECONDS,
        "loop": 0,
        "optimize": True,
    }
    first.save(folder / FILE, comment=comment.encode(), **options)


def own_run() -> Judgement:
    """Judgement of the run with the settings of the file."""
    engines = ["newton_euler", "mujoco"]
    found = crosscheck.check(str(MODEL), engines, key="go", duration=DURATION, output_period=0.01).own_run
    assert found is not None
    return found


def frames(judged: Judgement) -> list[Image.Image]:
    """Draw the frames: both mechanisms at one time, and the distance of the bars up to this time."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    run, reference = judged.run, judged.reference
    distance = 1e3 * np.max(positions_apart(run, reference), axis=1)
    found = []
    for row in np.linspace(0, len(run.time) - 1, FRAMES).round().astype(int):
        figure, (left, right) = plt.subplots(1, 2, figsize=SIZE, dpi=DPI, width_ratios=[1.3, 1.0])
        for trajectory, color, width, label in (
            (reference, BLUE, 7.0, "reference solution"),
            (run, VERMILION, 3.0, "MuJoCo, settings of the file"),
        ):
            for k, (start, end) in enumerate(bar_ends(trajectory, row)):
                ends = {"color": color, "lw": width, "solid_capstyle": "round", "label": "" if k else label}
                left.plot([start[0], end[0]], [start[2], end[2]], **ends)
        left.plot([0.0, 1.0], [0.0, 0.5], "k^", ms=8, zorder=0)
        left.set(xlim=(-0.4, 1.5), ylim=(-0.35, 0.85), aspect="equal")
        left.axis("off")
        left.legend(loc="upper left", frameon=False, fontsize=9)
        right.plot(run.time, distance, color="0.85", lw=2)
        right.plot(run.time[: row + 1], distance[: row + 1], color=VERMILION, lw=2)
        right.set(xlabel="time, s", xlim=(0, DURATION), ylim=(0, None))
        right.set_title("distance, mm", fontsize=10)
        right.spines[["top", "right"]].set_visible(False)
        figure.tight_layout()
        stream = io.BytesIO()
        figure.savefig(stream, format="png")
        plt.close(figure)
        found.append(Image.open(stream).convert("RGB"))
    return found


def bar_ends(run: Trajectory, row: int) -> list[tuple[Array, Array]]:
    """Both ends of each bar at an output time, m, world frame."""
    found = []
    for name, along in BARS.items():
        body = run.body_names.index(name)
        half = (
            0.5 * rotation(run.quaternion[row, body]) @ rotation(run.quaternion[0, body]).T @ np.array(along)
        )
        center = run.position[row, body]
        found.append((center - half, center + half))
    return found
