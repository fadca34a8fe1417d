"""`crosscheck faults`."""

from __future__ import annotations

from pathlib import Path

import click

from crosscheck.cli.shared import (
    AGREE,
    DISAGREE,
    cli,
    load_and_tell,
    load_scene,
    progress_shown,
    say,
    scene_options,
    setting_options,
    without_exercise,
)
from crosscheck.errors import CrosscheckError
from crosscheck.report.render import as_json, terminal
from crosscheck.studies.faults import PLANTED_IN


@cli.command("faults")
@click.argument("scene", default="tracker")
@setting_options
@click.option(
    "--engine",
    "names",
    type=click.Choice(PLANTED_IN),
    multiple=True,
    default=PLANTED_IN,
    help="Whose model the faults are planted in; repeatable.  [default: all, in turns]",
)
@click.option("--reading", is_flag=True, help="Plant them in what was read from the model file SCENE.")
@click.option(
    "--output", type=click.Path(path_type=Path), default=None, help="Folder.  [default: output/faults/SCENE]"
)
def faults_command(
    scene: str,
    settings: tuple[str, ...],
    names: tuple[str, ...],
    reading: bool,
    output: Path | None,
) -> int:
    """Plant one fault at a time in an engine's model of SCENE; say which are found and blamed right."""
    if reading:
        options = scene_options(settings)
        return _in_reading(scene, without_exercise(options, "what is read is verified as the file stands"))
    import time

    from crosscheck.files import check_no_source, check_writable, write_files
    from crosscheck.studies.faults.find import find_faults
    from crosscheck.studies.faults.report import data, holds, report

    options = scene_options(settings)
    loaded = load_and_tell(scene, options)
    path = (output or Path("output/faults") / loaded.name) / "faults.json"
    check_no_source([path], [scene])
    check_writable(path)
    start = time.perf_counter()
    with progress_shown() as progress:
        search = find_faults(loaded, progress, names=tuple(dict.fromkeys(names)))
    wall_time = time.perf_counter() - start
    found = report(loaded, options, search, wall_time)
    write_files({path: as_json(data(loaded, options, search), found)})
    click.echo(terminal(found.parts), nl=False)
    planted = " and ".join(search.engines)
    say(f"wrote {path}; {len(search.found)} faults in {planted} in {wall_time:.0f} s")
    say(found.verdict, bold=True)
    return AGREE if holds(search.found) else DISAGREE


def _in_reading(path: str, options: dict[str, str]) -> int:
    """Plant faults between the reading of a model file and its verification."""
    from crosscheck.studies.faults.reading import find_in_reading, reading_lines

    _, report = load_scene(path, options)
    if report is None:
        raise CrosscheckError(f"{path} is read from no model file; --reading needs an MJCF or a URDF")
    with progress_shown() as progress:
        found = find_in_reading(report, progress)
    *lines, verdict = reading_lines(path, found)
    for line in lines:
        say(line)
    say(verdict, bold=True)
    return DISAGREE if any(outcome.missed for outcome in found) else AGREE
