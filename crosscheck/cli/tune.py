"""`crosscheck tune`: the cheapest settings with which the engine of a model file reaches an error.

The engine of an MJCF file is MuJoCo. The engine of a URDF is a loop of time steps that calls Pinocchio.
"""

from __future__ import annotations

from pathlib import Path

import click

from crosscheck.cli.shared import (
    AGREE,
    INACCURATE,
    cli,
    folder_option,
    next_step,
    progress_shown,
    result_paths,
    scene_options,
    setting_options,
    show,
    verbose_option,
    warn_about_import,
)
from crosscheck.report.render import as_json


@cli.command(
    "tune",
    arguments={"FILE": "MJCF or URDF file."},
    examples={
        "find settings with an error of at most 1 % of the motion": "crosscheck tune robot.xml --error 1%",
        "find settings with an error of at most 1 mm": "crosscheck tune robot.xml --error position=1mm",
    },
)
@click.argument("file")
@setting_options
@click.option(
    "--error",
    metavar="[NAME=]NUMBER",
    default="0.1%",
    show_default=True,
    help="Largest error: 1e-3 or 0.1% of the motion, position=1mm, rotation=0.1deg, or another error of "
    "`crosscheck run --max-error`.",
)
@folder_option("output/tune/FILE")
@verbose_option
def tune_command(file: str, settings: tuple[str, ...], error: str, output: Path | None) -> int:
    """Find the fastest settings of a model file for a given error.

    For an MJCF file, the settings are MuJoCo's timestep, integrator, solref, solimp and solver. For a URDF
    file, they are the time step, integrator and Baumgarte gains of a loop that calls Pinocchio.

    The error is that of `crosscheck run`. Without a name, it is the largest error of a position or an
    orientation, relative to the motion. The exit status is 5 if no settings reach the error.
    """
    from crosscheck.compare.tuning import target_of, tune_model, with_engine
    from crosscheck.loading.load import load_scene, with_excitation
    from crosscheck.report.tuning import report
    from crosscheck.support.files import write_files

    target = target_of(error, "--error")
    # by default, the model starts in motion, with driven actuators: at rest, all settings are accurate
    options = with_excitation(file, scene_options(settings))
    scene, read = load_scene(file, options)
    import_report = with_engine(file, read)
    warn_about_import(file, import_report, scene)
    [path] = result_paths(output, parent="output/tune", kind="tuning", names=["tune.json"], sources=[file])
    with progress_shown() as progress:
        tuning = tune_model(scene, import_report, target, progress)
    found = report(scene.name, tuning)
    write_files({path: as_json({"source": file, "options": options, **tuning.summary()}, found)})
    show(found, f"wrote {path}", f"more  {next_step('report', path.parent)}")
    return AGREE if tuning.found else INACCURATE
