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


@cli.command("faults")
@click.argument("scene", default="tracker")
@setting_options
@click.option(
    "--output", type=click.Path(path_type=Path), default=None, help="Folder.  [default: output/faults/SCENE]"
)
def faults_command(scene: str, settings: tuple[str, ...], loops: str | None, output: Path | None) -> int:
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
        faults = find_faults(loaded, progress)
    wall_time = time.perf_counter() - start
    write(path, as_json(loaded, options, faults, wall_time))
    click.echo(rendered(tables(loaded, faults)), nl=False)
    for line in lines(loaded, faults):
        click.echo(line)
    click.echo(f"wrote {path}; {len(faults)} faults in {wall_time:.0f} s")
    click.echo(click.style(verdict(loaded, faults), bold=True))
    return AGREE if holds(faults) else DISAGREE
