"""Plots that commands of how-to pages write: each is known by its command alone."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

HOW_TO = Path(__file__).parents[2] / "docs" / "how_to"


class Plot(NamedTuple):
    """A plot that a command of a page writes."""

    page: str
    start: str
    """Beginning of the command in the page."""
    file: str
    """The plot, in the folder of the command."""


REACH_PLACE = "--latitude 11.56 --longitude 104.92 --date 2026-03-21"
"""Place and date of the plot of the sun's positions that can be reached."""

PLOTS = {
    "workspace": Plot("kinematics.md", "crosscheck workspace tracker ", "workspace/tracker/workspace.png"),
    "excavator_workspace": Plot(
        "kinematics.md", "crosscheck workspace excavator ", "workspace/excavator/workspace.png"
    ),
    "sweep_scatter": Plot("sweeps.md", "crosscheck sweep tracker --vary ", "sweep/tracker/scatter.png"),
    "sweep_tornado": Plot(
        "sweep_sensitivities.md", "crosscheck sweep tracker --sampling saltelli ", "sweep/tilt/tornado.png"
    ),
    "sweep_histogram": Plot(
        "sweep_tolerances.md", "crosscheck sweep slider_crank ", "sweep/slider_crank/histograms.png"
    ),
    "sweep_response": Plot(
        "sweep_tolerances.md", "crosscheck sweep tracker --vary ", "sweep/damping/scatter.png"
    ),
    "sweep_period": Plot(
        "sweep_digital.md", "crosscheck sweep tracker_computed_torque ", "sweep/period/scatter.png"
    ),
    "sweep_extended": Plot(
        "sweep_large.md",
        'crosscheck sweep pendulum --vary "dumbbell.mass=normal(2, 0.1)" --sampling sobol --runs 1024 ',
        "sweep/pendulum/histograms.png",
    ),
    "sun_reach": Plot("sun.md", f"crosscheck sun {REACH_PLACE} --reach", "sun/tracker_sun/reach.png"),
}
"""Plots of commands, by the name of the picture."""


def plot_command(plot: Plot) -> str:
    """Command of a plot, as its page has it."""
    page = (HOW_TO / plot.page).read_text()
    return plot.start + page.partition(plot.start)[2].partition("\n")[0]
