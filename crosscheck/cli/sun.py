"""`crosscheck sun`: simulate days of a solar tracker at given places and dates."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import click

from crosscheck.cli.shared import AGREE, cli, folder_option, progress_shown, say, show, verbose_option
from crosscheck.support.errors import CrosscheckError


@cli.command("sun")
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
@click.option(
    "--deadband",
    type=float,
    default=0.0,
    show_default=True,
    help="Pointing error that makes the tracker move, degrees.",
)
@click.option(
    "--most-tilt",
    type=float,
    default=30.0,
    show_default=True,
    help="Largest tilt from the horizontal, degrees.",
)
@click.option(
    "--pitch",
    type=float,
    default=float("inf"),
    help="Distance between rows in panel lengths, for backtracking.",
)
@click.option("--stow", type=float, help="Wind speed from which the panel is stowed flat, m/s; needs --wind.")
@click.option(
    "--wind",
    metavar="SPEED|CSV",
    help="Wind speed, m/s, or a CSV file of time (s) and speed, for the load on the panel.",
)
@click.option(
    "--wind-from",
    type=click.FloatRange(0.0, 360.0),
    metavar="DEGREES",
    help="Direction that the wind comes from, from north to the east; needs --wind.  [default: 0]",
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
    "--clearance",
    type=float,
    default=0.001,
    show_default=True,
    help="Smallest distance between bodies that no joint connects, m.",
)
@click.option(
    "--to-singular",
    type=float,
    default=0.05,
    show_default=True,
    help="Smallest distance from singular configurations, as in workspace.",
)
@folder_option("output/sun")
@verbose_option
def sun_command(
    latitudes: tuple[float, ...],
    dates: tuple[str, ...],
    zone: str | None,
    period: float,
    stow: float | None,
    wind: str | None,
    wind_from: float | None,
    output: Path,
    **numbers: float,
) -> int:
    """Simulate a day of solar tracking: set-points, motion, pointing error and irradiance.

    With several latitudes or dates, a table compares the days.
    """
    from crosscheck.library.tracker_sun import PANEL_NORMAL, sun_tracker
    from crosscheck.solar.day import check_period, tracker_day
    from crosscheck.solar.place import SUN, Place, seconds_of_day
    from crosscheck.solar.report import day_report, files_of, survey_report, write, write_survey
    from crosscheck.solar.tracking import Tracking
    from crosscheck.solar.wind import wind_over_day
    from crosscheck.support.files import check_writable
    from crosscheck.support.time_limits import with_progress
    from newton_euler.optional_packages import optional_package

    for name, value in (("--stow", stow), ("--wind-from", wind_from)):
        if value is not None and wind is None:
            raise CrosscheckError(f"{name} has no effect without --wind SPEED|CSV; give both or none")
    stow_speed = float("inf") if stow is None else stow  # without --stow, no wind is too fast
    longitude, altitude = numbers.pop("longitude"), numbers.pop("altitude")
    tracking = Tracking(stow=stow_speed, **numbers)  # the other options are rules of tracking
    check_period(period)
    speeds = None if wind is None else wind_over_day(wind, seconds_of_day(period))
    places = [Place(latitude, longitude, altitude) for latitude in latitudes]
    pairs = list(product(places, dates))
    # raises if pvlib, one of the optional dependencies `SUN`, is missing, before folders are created
    optional_package("pvlib", SUN)
    check_writable(*files_of(output, several=len(pairs) > 1))
    scene, days = sun_tracker(), []
    with progress_shown() as progress:
        for place, date in with_progress(pairs, progress, "day"):
            days.append(
                tracker_day(
                    scene, PANEL_NORMAL, place, date, zone, tracking, period, speeds, wind_from or 0.0
                )
            )
        # the report compares the irradiation with that of other panels, such as a fixed one
        progress("sunlight on other panels, plots and recording")
        if len(days) > 1:
            report = survey_report(days)
            written = write_survey(report, output)
        else:
            report = day_report(days[0])
            written = write(days[0], report, output)
    show(report)
    for path in written:
        say(f"wrote {path}")
    return AGREE  # exit status 0
