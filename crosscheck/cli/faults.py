"""`crosscheck faults`."""

from __future__ import annotations

from pathlib import Path

import click

from crosscheck.cli.shared import (
    AGREE,
    DISAGREE,
    cli,
    load_and_tell,
    progress_shown,
    rendered,
    scene_options,
    setting_options,
)
from crosscheck.faults import PLANTED_IN


@cli.command("faults")
@click.argument("scene", default="tracker")
@setting_options
@click.option(
    "--engine",
    "names",
    type=click.Choice(PLANTED_IN),
    multiple=True,
    default=PLANTED_IN,
    help="Whose model the faults are planted in; repeatable.  [default: both, in turns]",
)
@click.option(
    "--output", type=click.Path(path_type=Path), default=None, help="Folder.  [default: output/faults/SCENE]"
)
def faults_command(
    scene: str, settings: tuple[str, ...], loops: str | None, names: tuple[str, ...], output: Path | None
) -> int:
    """Plant one fault at a time in an engine's model of SCENE; say which are found and blamed right."""
    import time

    from crosscheck.faults.find import find_faults
    from crosscheck.faults.report import as_json, holds, lines, tables, verdict, write
    from crosscheck.files import check_writable

    options = scene_options(scene, settings, loops)
    loaded = load_and_tell(scene, options)
    path = (output or Path("output/faults") / loaded.name) / "faults.json"
    check_writable(path)
    start = time.perf_counter()
    with progress_shown() as progress:
        search = find_faults(loaded, progress, names=tuple(dict.fromkeys(names)))
    wall_time = time.perf_counter() - start
    write(path, as_json(loaded, options, search, wall_time))
    faults = search.found
    click.echo(rendered(tables(loaded, faults)), nl=False)
    for engine, why in search.left_out.items():
        click.echo(f"no fault planted in {engine}, which cannot express the scene: {why}")
    for line in lines(loaded, faults):
        click.echo(line)
    planted = " and ".join(search.engines)
    click.echo(f"wrote {path}; {len(faults)} faults in {planted} in {wall_time:.0f} s")
    click.echo(click.style(verdict(loaded, faults), bold=True))
    return AGREE if holds(faults) else DISAGREE
