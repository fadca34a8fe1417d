"""Plots that commands of how-to pages write: each is known by its command alone."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

HOW_TO = Path(__file__).parents[2] / "docs" / "how_to"


class Plot(NamedTuple):
    """A plot or a page that a command of a how-to page writes.

    Attributes:
        page: file of the how-to page.
        start: beginning of the command in the page.
        file: the plot or page, in the folder `output`.
        before: commands that run first.
        after: commands that run later, such as that of the page.
        window: width and height, pixels, of the picture of a page; None for a plot.
    """

    page: str
    start: str
    file: str
    before: tuple[str, ...] = ()
    after: tuple[str, ...] = ()
    window: tuple[int, int] | None = None


REACH_PLACE = "--latitude 11.56 --longitude 104.92 --date 2026-03-21"
"""Place and date of the plot of the sun's positions that can be reached."""

PLOTS = {
    "workspace": Plot("workspace.md", "crosscheck workspace tracker ", "workspace/tracker/workspace.png"),
    "excavator_workspace": Plot(
        "workspace.md", "crosscheck workspace excavator ", "workspace/excavator/workspace.png"
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
    "diff_page": Plot(
        "diff.md",
        "crosscheck diff examples/linkage.xml linkage.urdf ",
        "diff/linkage_linkage/report.html",
        before=("crosscheck convert examples/linkage.xml linkage.urdf --set key=go",),
        window=(1000, 890),
    ),
    "importers_page": Plot(
        "importers.md",
        "crosscheck importers mjcf/tracker.xml",
        "importers/tracker.xml/report.html",
        after=("crosscheck report output/importers/tracker.xml",),
        window=(1000, 300),
    ),
    "regress_page": Plot(
        "guard.md",
        "crosscheck regress robot.xml --output output/heavier",
        "heavier/report.html",
        before=(
            "cp examples/linkage.xml robot.xml",
            'crosscheck regress robot.xml --update "as delivered"',
            'sed -i \'s/density="2700"/density="2800"/\' robot.xml',
        ),
        after=("crosscheck report output/heavier",),
        window=(1000, 700),
    ),
    "loads": Plot("loads.md", "crosscheck loads tracker_wind", "loads/tracker_wind/loads.png"),
    "drives": Plot("drives.md", "crosscheck drives tracker_wind ", "drives/tracker_wind/drives.png"),
    "sun_day": Plot(
        "sun.md",
        "crosscheck sun --latitude 11.56 --longitude 104.92 --date 2026-03-21",
        "sun/tracker_sun/day.png",
    ),
    "sun_seville": Plot("place_to_tracker.md", "crosscheck sun --latitude 37.39 ", "sun/tracker_sun/day.png"),
    "sun_gimbal": Plot("sun_own_tracker.md", "crosscheck sun gimbal.xml ", "sun/gimbal/day.png"),
    "sun_year": Plot(
        "sun_year.md", "crosscheck year --latitude 37.4 --longitude -6 ", "year/tracker_sun/year.png"
    ),
    "sun_reach": Plot("sun_reach.md", f"crosscheck sun {REACH_PLACE} --reach", "sun/tracker_sun/reach.png"),
}
"""Plots of commands, by the name of the picture."""


def plot_command(plot: Plot) -> str:
    """Command of a plot, as its page has it."""
    page = (HOW_TO / plot.page).read_text()
    return plot.start + page.partition(plot.start)[2].partition("\n")[0]


def page_files(page: str) -> dict[str, str]:
    """Return the files that a page contains, which its commands read, by name."""
    return dict(re.findall(r'^```\w+ title="([^"]+)"\n(.*?)^```$', (HOW_TO / page).read_text(), re.M | re.S))
