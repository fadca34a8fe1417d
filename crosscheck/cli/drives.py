"""`crosscheck drives`: choose motors, gearboxes and lead screws for the actuators of a scene."""

from __future__ import annotations

from pathlib import Path

import click

from crosscheck.cli.help import SCENE
from crosscheck.cli.shared import (
    AGREE,
    INACCURATE,
    REDUCED,
    allow_reduced_option,
    cli,
    folder_option,
    fraction,
    next_step,
    progress_shown,
    refuse_excitation,
    result_paths,
    scene_options,
    setting_options,
    show,
    verbose_option,
    warn_about_import,
)
from crosscheck.support.errors import CrosscheckError


@cli.command(
    "drives",
    arguments={"SCENE": f"{SCENE} Or a CSV of forces and positions of actuators.  [default: tracker_wind]"},
    examples={
        "choose drives with a margin of 20 %": "crosscheck drives --catalog examples/drives.csv --margin 20%"
    },
)
@click.argument("scene", default="tracker_wind")
@setting_options
@click.option(
    "--catalog",
    type=click.Path(path_type=Path),
    required=True,
    metavar="FILE",
    help="CSV file with a row for each combination of motor, gearbox and screw.",
)
@click.option(
    "--margin",
    type=fraction,
    default=0.0,
    metavar="FRACTION",
    help="Smallest margin to each limit of a drive, such as 20%.  [default: 0]",
)
@click.option("--must-hold", is_flag=True, help="Reject drives that do not hold the load with the motor off.")
@allow_reduced_option
@folder_option("output/drives/SCENE")
@verbose_option
def drives_command(
    scene: str,
    settings: tuple[str, ...],
    catalog: Path,
    margin: float,
    must_hold: bool,
    allow_reduced: bool,
    output: Path | None,
) -> int:
    """Choose motors, gearboxes and screws for the actuators.

    The size of a drive follows from the motion: each drive of the catalog is compared with the force, speed
    and power that its actuator needs.

    The exit status is 5 if no drive suits an actuator, and 4 if elements of the file act that are not
    simulated.
    """
    from crosscheck.design.drive_catalog import read_catalog
    from crosscheck.design.drive_report import Requirements
    from crosscheck.design.drives import (
        DRIVE_FILES,
        motions_of_file,
        motions_of_scene,
        size_all,
        write_drives,
    )
    from crosscheck.loading.load import load_scene
    from newton_euler.analysis.loads.motion_files import is_motion_file

    options = refuse_excitation(scene_options(settings), why="drives are for an intended motion")
    if options and is_motion_file(scene):
        raise CrosscheckError(f"--set {next(iter(options))} has no effect on the CSV {scene}; leave it out")
    paths = result_paths(
        output, "output/drives", kind="drive table", names=DRIVE_FILES, sources=[scene, catalog]
    )
    drives = read_catalog(str(catalog))
    with progress_shown() as progress:
        if is_motion_file(scene):
            motions = motions_of_file(scene)
        else:
            loaded, import_report = load_scene(scene, options)
            warn_about_import(scene, import_report, loaded)
            motions = motions_of_scene(loaded, options, import_report, progress)
        progress("drives")
        found = size_all(motions, str(catalog), drives, Requirements(margin, must_hold))
        report, written = write_drives(found, paths[0].parent, scene, options)
    more = f"more  -v; {next_step('report', paths[0].parent)}"
    show(report, "wrote " + ", ".join(map(str, written)), more)
    if found.unserved:
        return INACCURATE  # no drive of the catalog suits these actuators
    return REDUCED if motions.is_reduced and not allow_reduced else AGREE
