"""`crosscheck identify`: fit parameters of a scene to measured motion."""

from __future__ import annotations

from pathlib import Path

import click

from crosscheck.cli.help import SCENE
from crosscheck.cli.shared import (
    AGREE,
    UNFINISHED,
    cli,
    folder_option,
    load_with_warnings,
    next_step,
    progress_shown,
    refuse_excitation,
    result_paths,
    scene_options,
    setting_options,
    show,
)
from crosscheck.report.render import as_json


@cli.command(
    "identify",
    arguments={
        "SCENE": SCENE,
        "CSV...": "Measured runs: time, and joint coordinates, rates, poses or forces, in SI units.",
    },
    examples={"fit the mass of a body": "crosscheck identify robot.xml run_1.csv --fit coupler.mass"},
)
@click.argument("scene")
@click.argument(
    "measured", metavar="CSV...", nargs=-1, required=True, type=click.Path(path_type=Path, dir_okay=False)
)
@setting_options
@click.option(
    "--fit",
    "names",
    multiple=True,
    required=True,
    metavar="NAME",
    help="Parameter to fit, such as panel_7.mass, ball_57.point.z or start.slide_12. Repeatable.",
)
@click.option(
    "--rtol", type=float, default=1e-10, show_default=True, help="Relative tolerance of the integrator."
)
@folder_option("output/identify/SCENE")
def identify_command(
    scene: str,
    measured: tuple[Path, ...],
    settings: tuple[str, ...],
    names: tuple[str, ...],
    rtol: float,
    output: Path | None,
) -> int:
    """System identification: fit parameters to measured motion.

    The command reports each parameter with its uncertainty, and parameters that the motion does not
    identify. `crosscheck list SCENE` prints the names of parameters.

    The exit status is 3 if there is a reason not to trust the fit, such as a parameter that is not
    identifiable.
    """
    from crosscheck.design.identification import data, report
    from crosscheck.support.files import write_files
    from newton_euler.analysis.identification.identify import identify

    # The option `excitation` adds motion to models at rest; for a measured motion it is refused
    why = "measured is the scene as it stands"
    options = refuse_excitation(scene_options(settings), why)
    loaded = load_with_warnings(scene, options)
    [path] = result_paths(
        output, parent="output/identify", kind="fit", names=["identify.json"], sources=[scene, *measured]
    )
    with progress_shown() as progress:
        progress("fitting")
        found = identify(loaded, names, measured, rtol=rtol)
    made = report(found)
    write_files({path: as_json({"source": scene, **data(found)}, made)})
    show(made, f"wrote {path}", f"more  {next_step('report', path.parent)}")
    # `doubts` are reasons not to trust the fit, such as parameters that are not identifiable
    return UNFINISHED if found.doubts else AGREE
