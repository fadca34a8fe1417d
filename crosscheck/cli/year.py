"""`crosscheck year`: energy of a solar tracker over a year, from a weather file or a clear sky."""

from __future__ import annotations

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
    "year",
    arguments={"SCENE": f"{SCENE}  [default: tracker_sun]"},
    groups={
        "Weather and place": ["--weather", "--latitude", "--longitude", "--altitude", "--year", "--zone"],
        "Tracker": ["--set", "--axis", "--base", "--stroke"],
        "Tracking": [
            "--max-tilt",
            "--deadband",
            "--pitch",
            "--clearance",
            "--to-singular",
            "--stow",
        ],
        "Photovoltaic module": ["--area", "--efficiency", "--temperature-coefficient"],
        "Results": ["--output"],
    },
    examples={"compute a year of clear sky": "crosscheck year --latitude 11.6 --longitude 104.9 --year 2026"},
)
@click.argument("scene", required=False)
@setting_options
@click.option(
    "--weather",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Weather file: TMY3, EPW, NSRDB or PVGIS.",
)
@click.option("--latitude", type=float, help="Latitude, degrees north; that of --weather is checked.")
@click.option("--longitude", type=float, help="Longitude, degrees east; that of --weather is checked.")
@click.option("--altitude", type=float, help="Altitude above sea level, m; not with --weather.")
@click.option("--year", type=int, help="Year of the clear sky, or of a weather file with several.")
@click.option(
    "--zone",
    metavar="ZONE",
    help="Time zone, such as UTC+07:00.  [default: that of the file, or whole hours from the longitude]",
)
@tracker_options
@click.option(
    "--stow",
    type=float,
    default=float("inf"),
    help="Wind speed of the weather file above which the panel lies flat, m/s.",
)
@click.option(
    "--stroke",
    "strokes",
    multiple=True,
    metavar="JOINT=LOW:HIGH",
    help="Stroke of an actuated joint from the initial pose, m or rad. Repeatable.",
)
@click.option(
    "--base",
    metavar="NAME=DEGREES,...",
    help="Orientation of the base at rest: heading of its x axis, roll and pitch.",
)
@click.option("--area", type=float, help="Area of a photovoltaic module, m^2; needs --efficiency.")
@click.option("--efficiency", type=float, help="Efficiency of the module at 25 degrees Celsius, such as 0.2.")
@click.option(
    "--temperature-coefficient",
    type=float,
    help="Relative change of the power, 1/K, such as -0.0035.  [default: 0]",
)
@folder_option("output/year/SCENE")
@verbose_option
def year_command(
    scene: str | None,
    settings: tuple[str, ...],
    axis: str | None,
    weather: Path | None,
    latitude: float | None,
    longitude: float | None,
    altitude: float | None,
    year: int | None,
    zone: str | None,
    max_tilt: float | None,
    strokes: tuple[str, ...],
    base: str | None,
    area: float | None,
    efficiency: float | None,
    temperature_coefficient: float | None,
    output: Path | None,
    **numbers: float,
) -> int:
    """Compute the energy of a solar tracker over a year.

    The command reports the irradiation by month, the lost energy, and the electric energy of a module. The
    scene has x to the east, y to the north and z up. Poses are static, one for each hour.

    The exit status is 0, or 2 if an input is invalid.
    """
    from crosscheck.library import SUN_TRACKER
    from crosscheck.solar.base import base_of
    from crosscheck.solar.place import SUN, Place
    from crosscheck.solar.tracking import Tracking
    from crosscheck.solar.weather import check_place, clear_sky
    from crosscheck.solar.weather_files import read_weather
    from crosscheck.solar.year import Module, stroke_of, tracker_year
    from crosscheck.solar.year_report import YEAR_FILES, write_year, year_report
    from newton_euler.optional_packages import optional_package

    source = scene or SUN_TRACKER
    # the rules of tracking
    options = tracker_settings(settings, why="poses are at rest")
    # the other options are rules of tracking
    tracking = Tracking(max_tilt=largest_tilt(source, max_tilt), **numbers)
    orientation = None if base is None else base_of(base)
    ends = dict(map(stroke_of, strokes))
    # the module
    module = None
    if area is not None and efficiency is not None:
        module = Module(area, efficiency, temperature_coefficient or 0.0)
    elif not (area is efficiency is temperature_coefficient is None):
        raise CrosscheckError(
            "--area, --efficiency and --temperature-coefficient: give the first two or none"
        )
    # the place; raises if pvlib, one of the optional dependencies `SUN`, is missing
    place = None
    if weather is None:
        if latitude is None or year is None:
            raise CrosscheckError(
                "needed: --weather FILE, or --latitude, --longitude and --year for a clear sky"
            )
        place = Place(latitude, longitude or 0.0, altitude or 0.0)
    elif altitude is not None:
        raise CrosscheckError("--weather has the altitude; leave out --altitude")
    elif (latitude is None) != (longitude is None):
        raise CrosscheckError("--latitude and --longitude check the place of --weather; give both or none")
    elif latitude is not None and longitude is not None:
        place = Place(latitude, longitude)
    optional_package("pvlib", SUN)
    sources: list[str | Path] = [source, *([] if weather is None else [weather])]
    paths = result_paths(output, "output/year", kind="solar year", names=YEAR_FILES, sources=sources)
    loaded, normal = load_tracker(source, options, axis)
    with progress_shown() as progress:
        progress("reading the weather" if weather else "light of the sky")
        if weather is not None:
            sky = read_weather(str(weather), year, zone)
            if place is not None:
                check_place(sky, place)
        else:
            assert place is not None
            assert year is not None
            sky = clear_sky(place, year, zone)
        progress("poses")
        found = tracker_year(loaded, normal, sky, tracking, orientation, module, ends)
        progress("irradiation")
        report = year_report(found)
        written = write_year(found, report, paths[0].parent, source, options)
    more = f"more  -v; {next_step('report', paths[0].parent)}"
    show(report, "wrote " + ", ".join(str(path) for path in written), more)
    return AGREE
