"""`crosscheck sun`: simulate days of a solar tracker at given places and dates."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import click

from crosscheck.cli.help import SCENE
from crosscheck.cli.shared import (
    AGREE,
    cli,
    folder_option,
    next_step,
    progress_shown,
    result_paths,
    setting_options,
    show,
    verbose_option,
)
from crosscheck.cli.trackers import (
    largest_tilt,
    load_tracker,
    tracker_options,
    tracker_settings,
)
from crosscheck.support.errors import CrosscheckError


@cli.command(
    "sun",
    arguments={"SCENE": f"{SCENE}  [default: tracker_sun]"},
    groups={
        "Place and time": ["--latitude", "--longitude", "--altitude", "--date", "--zone", "--period"],
        "Tracker": ["--set", "--axis", "--base", "--speed", "--acceleration"],
        "Tracking": ["--max-tilt", "--deadband", "--pitch", "--clearance", "--to-singular"],
        "Wind": ["--wind", "--wind-from", "--wind-up", "--stow"],
        "Results": ["--reach", "--output"],
    },
    examples={
        "simulate a day in Phnom Penh": "crosscheck sun --latitude 11.6 --longitude 104.9 --date 2026-03-21"
    },
)
@click.argument("scene", required=False)
@setting_options
@click.option(
    "--latitude",
    "latitudes",
    type=float,
    multiple=True,
    required=True,
    help="Latitude, degrees north. Repeatable.",
)
@click.option("--longitude", type=float, default=0.0, show_default=True, help="Longitude, degrees east.")
@click.option("--altitude", type=float, default=0.0, show_default=True, help="Altitude above sea level, m.")
@click.option(
    "--date", "dates", multiple=True, required=True, metavar="YYYY-MM-DD", help="Local date. Repeatable."
)
@click.option(
    "--zone",
    metavar="ZONE",
    help="Time zone, such as Asia/Phnom_Penh.  [default: whole hours from the longitude]",
)
@click.option("--period", type=float, default=60.0, show_default=True, help="Time between set-points, s.")
@tracker_options
@click.option("--stow", type=float, help="Wind speed from which the panel lies flat, m/s; needs --wind.")
@click.option(
    "--wind",
    metavar="SPEED|CSV",
    help="Wind speed, m/s, or a CSV file of time (s) and speed, for the load on the panel.",
)
@click.option(
    "--wind-from",
    type=click.FloatRange(0.0, 360.0),
    metavar="DEGREES",
    help="Direction that the wind comes from, degrees clockwise from north; needs --wind.  [default: 0]",
)
@click.option(
    "--wind-up",
    type=click.FloatRange(-1.0, 1.0),
    metavar="FRACTION",
    help="Upward speed of the wind divided by its speed, such as 0.25 or -0.25 for gusts on a flat panel; "
    "needs --wind.  [default: 0]",
)
@click.option(
    "--base",
    metavar="NAME=DEGREES,...",
    help="Orientation of the base at rest: heading of its x axis from north to the east, roll and pitch, "
    "such as heading=80,pitch=5.",
)
@click.option(
    "--speed",
    type=float,
    default=0.01,
    show_default=True,
    help="Largest speed of the set-points, m/s at slides, rad/s at hinges.",
)
@click.option(
    "--acceleration",
    type=float,
    default=0.02,
    show_default=True,
    help="Largest acceleration of the set-points, m/s^2 or rad/s^2.",
)
@click.option(
    "--reach", "with_reach", is_flag=True, help="Map which directions of the sun the tracker can face."
)
@folder_option("output/sun/SCENE")
@verbose_option
def sun_command(
    scene: str | None,
    settings: tuple[str, ...],
    axis: str | None,
    latitudes: tuple[float, ...],
    dates: tuple[str, ...],
    zone: str | None,
    period: float,
    max_tilt: float | None,
    stow: float | None,
    wind: str | None,
    wind_from: float | None,
    wind_up: float | None,
    base: str | None,
    with_reach: bool,
    output: Path | None,
    **numbers: float,
) -> int:
    """Simulate days of solar tracking.

    The command reports set-points, motion, pointing error and irradiance. With several latitudes or dates, a
    table compares the days. The scene has PD controllers or position actuators, with x to the east, y to the
    north and z up. A tracker that cannot face the sun comes as near as it can.

    The exit status is 0, or 2 if an input is invalid or the motion cannot be simulated.
    """
    from crosscheck.library import SUN_TRACKER
    from crosscheck.solar.base import Base, base_of
    from crosscheck.solar.day import tracker_day
    from crosscheck.solar.place import SUN, Place, seconds_of_day
    from crosscheck.solar.reach import reach_over_year
    from crosscheck.solar.report import DAY_FILES, REACH_FILES, SURVEY_FILES, day_report, survey_report
    from crosscheck.solar.results import write_day, write_survey
    from crosscheck.solar.set_points import check_period
    from crosscheck.solar.tracking import Tracking
    from crosscheck.solar.wind import wind_over_day
    from crosscheck.support.time_limits import with_progress
    from newton_euler.optional_packages import optional_package

    source = scene or SUN_TRACKER
    # the rules of tracking and the wind
    for name, value in (("--stow", stow), ("--wind-from", wind_from), ("--wind-up", wind_up)):
        if value is not None and wind is None:
            raise CrosscheckError(f"{name} has no effect without --wind SPEED|CSV; give both or none")
    options = tracker_settings(settings, why="controllers follow the sun")
    longitude, altitude = numbers.pop("longitude"), numbers.pop("altitude")
    tracking = Tracking(
        stow=float("inf") if stow is None else stow,  # without --stow, no wind is too fast
        max_tilt=largest_tilt(source, max_tilt),
        **numbers,  # the other options are rules of tracking
    )
    check_period(period)
    orientation = Base() if base is None else base_of(base)
    if with_reach and base is not None:
        raise CrosscheckError("--reach is for a level base; leave out --base")
    speeds = None if wind is None else wind_over_day(wind, seconds_of_day(period))
    places = [Place(latitude, longitude, altitude) for latitude in latitudes]
    pairs = list(product(places, dates))
    if with_reach and len(pairs) > 1:
        raise CrosscheckError("--reach is for one place and one date")
    # raises if pvlib, one of the optional dependencies `SUN`, is missing, before folders are created
    optional_package("pvlib", SUN)
    files: tuple[str, ...] = SURVEY_FILES if len(pairs) > 1 else DAY_FILES
    files += REACH_FILES if with_reach else ()
    sources = [source, *([wind] if wind and Path(wind).is_file() else [])]
    paths = result_paths(output, "output/sun", kind="solar day", names=files, sources=sources)
    loaded, normal = load_tracker(source, options, axis)
    days = []
    with progress_shown() as progress:
        for place, date in with_progress(pairs, progress, "day"):
            days.append(
                tracker_day(
                    loaded,
                    normal,
                    place,
                    date,
                    zone,
                    tracking,
                    period,
                    speeds,
                    wind_from or 0.0,
                    wind_up or 0.0,
                    orientation,
                )
            )
        # the report compares the irradiation with that of other panels, such as a fixed one
        progress("sunlight on other panels, plots and recording")
        if len(days) > 1:
            report = survey_report(days)
            written = write_survey(days, report, paths, source, options)
        else:
            year, reach = days[0].sun.times[0].year, None
            if with_reach:
                progress(f"the sun over {year}")
                reach = reach_over_year(loaded, normal, places[0], year, tracking)
            report = day_report(days[0], reach)
            written = write_day(days[0], report, paths, source, options, reach)
    more = f"more  -v; {next_step('report', paths[0].parent)}"
    show(report, "wrote " + ", ".join(str(path) for path in written), more)
    return AGREE  # exit status 0
