"""`crosscheck list` and `crosscheck convert`: options and parameters of models, and other file formats."""

from __future__ import annotations

from pathlib import Path
from textwrap import TextWrapper
from typing import TYPE_CHECKING

import click

from crosscheck.cli.help import SCENE
from crosscheck.cli.shared import (
    AGREE,
    cli,
    is_verbose,
    refuse_excitation,
    say,
    scene_options,
    setting_options,
    verbose_option,
)
from crosscheck.cli.trackers import load_scene_or_tracker
from crosscheck.report.render import printable
from crosscheck.support.errors import CrosscheckError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from newton_euler.model.scene import Scene
    from newton_euler.scalars import Array

MAX_NUMBERS = 9
"""Largest number of components that are listed of one parameter; an inertia has 9."""

DIGITS = 12
"""Digits of listed values before round-off: significant digits relative to the largest number of an array of
parameters, and decimal places of initial coordinates."""

LINE_WIDTH = 80
"""Characters of a line of the list of parameters."""


@cli.command(
    "list",
    arguments={"SCENE": SCENE},
    examples={
        "list scenes, their options, and engines": "crosscheck list",
        "list the parameters of a file, for sweep and identify": "crosscheck list robot.xml",
    },
)
@click.argument("scene", required=False)
@setting_options
@verbose_option
def list_command(scene: str | None, settings: tuple[str, ...]) -> int:
    """List scenes, engines and options, or parameters of a model.

    With SCENE, the command lists parameters and initial coordinates with units and values. `crosscheck sweep`
    varies parameters by these names, and `crosscheck identify` fits them.
    """
    if scene is not None:
        for line in _parameter_lines(load_scene_or_tracker(scene, scene_options(settings))):
            click.echo(printable(line))
        return AGREE  # exit status 0
    if settings:
        raise CrosscheckError("--set has no effect here: it is of a scene")
    from crosscheck.engines.registry import names
    from crosscheck.library import SCENES, SUN_TRACKER
    from crosscheck.library.model_files import MJCF_OPTIONS, URDF_OPTIONS
    from crosscheck.library.options import options_of
    from crosscheck.library.tracker_sun import sun_tracker
    from newton_euler.errors import MissingPackageError
    from newton_euler.limits import LIMITS

    for name, make in (*SCENES.items(), (SUN_TRACKER, sun_tracker)):
        try:
            say(f"{name}: {make().description}")
        except MissingPackageError as error:
            say(f"{name}: not available: {error}")
        for key, option in options_of(make).items():
            default = f"{option.default:g}" if isinstance(option.default, float) else str(option.default)
            say(f"    --set {key}={option}  [default: {default or 'none'}]")
    for kind, options in (("MJCF, a .xml or .mjcf file", MJCF_OPTIONS), ("URDF, a .urdf file", URDF_OPTIONS)):
        say(f"{kind}:")
        for name, choice in options.items():
            say(f"    --set {name}={choice.values}  [default: {choice.default}]")
    say(f"limits of computations{':' if is_verbose() else ', such as time=600: `crosscheck list -v`'}")
    for name, limit in LIMITS.items() if is_verbose() else ():
        say(f"    --set {name}={limit.unit.upper()}, {limit.meaning}  [default: {limit}]")
    say("engines:")
    for name in names():
        say(f"    {name}: {_engine_text(name)}")
    return AGREE


def _engine_text(name: str) -> str:
    """Return package and version of an engine, or why it cannot be used."""
    from importlib.metadata import version

    from crosscheck.engines.registry import ENGINES, EngineError, choose

    try:
        (engine,) = choose([name])
    except EngineError as error:
        return f"cannot be used: {str(error).removeprefix(f'engine {name!r}').lstrip(':, ')}"
    default = ", runs by default" if name in ENGINES else ""
    return f"{engine.package} {version(engine.package)}{default}"


def _parameter_lines(scene: Scene) -> Iterator[str]:
    """Yield the lines of a table of a scene's parameters and initial coordinates: name, unit and value.

    A 3x3 matrix has a line for each row. A displacement from a reference point is followed by that point.
    """
    from newton_euler.equations.parameters import origins, parameter_values
    from newton_euler.runs.initial_coordinates import initial_names
    from newton_euler.runs.variation import own_values, units_of

    coordinates = own_values(scene, initial_names(scene))
    parameters = parameter_values(scene)
    reference_points = origins(scene, parameters)
    values = parameters | {name: value.round(DIGITS) for name, value in coordinates.items()}
    units = units_of(scene, values)
    name_width, unit_width = max(map(len, values)), max(map(len, units.values()))
    for name, value in values.items():
        before = f"{name:{name_width}}  {units[name]:{unit_width}}  "
        indent = " " * len(before)
        lines = TextWrapper(LINE_WIDTH, before, indent, break_long_words=False, break_on_hyphens=False)
        for row in value if value.shape == (3, 3) else [value]:
            text = _number_text(row, abs(value).max(initial=0.0))
            if name in reference_points:
                point = reference_points[name]
                text += f"  offset from {_number_text(point, abs(point).max())}"
            yield from lines.wrap(text)
            lines.initial_indent = indent


def _number_text(row: Array, largest: float) -> str:
    """Format numbers with six digits, and round-off as zero; of many numbers, the first and their count.

    Args:
        row: the numbers.
        largest: largest absolute value of the array that the numbers are part of.
    """
    shown = [number if abs(number) > 10.0**-DIGITS * largest else 0.0 for number in row.flat[:MAX_NUMBERS]]
    text = " ".join(f"{number:.6g}" for number in shown)
    return text if row.size <= MAX_NUMBERS else f"{text} ... ({row.size} numbers)"


@cli.command(
    "convert",
    arguments={
        "IN": SCENE,
        "OUT": "File to write; its suffix (.xml, .urdf, .yaml, .json) selects the format.",
    },
    examples={
        "convert an MJCF file to a URDF": "crosscheck convert robot.xml robot.urdf",
        "write a library scene as a scene file": "crosscheck convert four_bar four_bar.yaml",
    },
)
@click.argument("source", metavar="IN")
@click.argument("target", metavar="OUT", type=click.Path(path_type=Path))
@setting_options
@verbose_option
def convert_command(source: str, target: Path, settings: tuple[str, ...]) -> int:
    """Convert a model to MJCF, URDF or a scene file.

    The command lists elements that OUT approximates or does not have.
    """
    from crosscheck.library.model_files import report_lines
    from crosscheck.loading.convert import check_target, files_written, scene_report, write_as
    from crosscheck.loading.load import load_scene
    from crosscheck.support.files import check_no_source, check_writable

    check_target(target)
    options = scene_options(settings)
    if target.suffix == ".urdf":  # refuse the option excitation=on, which adds inputs and initial velocities
        refuse_excitation(options, why="a URDF holds no control and no start")
    loop_files = [options["loops"]] if "loops" in options else []  # the file of a URDF's loop closures
    check_no_source(files_written(target), [source, *loop_files])
    check_writable(target)
    # The report lists how each element was imported, and then the elements that the target cannot hold
    scene, report = load_scene(source, options)
    report = report or scene_report(scene)  # a source other than MJCF and URDF has no report
    written = write_as(scene, target, report)
    for line in (*map(str, report.findings), *report_lines(report, exact=is_verbose())):
        say(line)
    say("wrote " + ", ".join(str(path) for path in written))
    return AGREE
