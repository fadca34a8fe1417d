"""`crosscheck importers`: compare what each engine's own importer makes of one model file."""

from __future__ import annotations

from pathlib import Path

import click

from crosscheck.cli.shared import (
    cli,
    explanation_steps,
    folder_option,
    next_step,
    progress_shown,
    show,
    verbose_option,
)
from crosscheck.report.render import as_json


@cli.command(
    "importers",
    arguments={"FILE": "MJCF or URDF file."},
    examples={"compare the importers of all installed engines": "crosscheck importers robot.xml"},
)
@click.argument("file")
@folder_option("output/importers/FILE")
@verbose_option
def importers_command(file: str, output: Path | None) -> int:
    """Compare what the importer of each engine reads in one file.

    Each installed engine, such as MuJoCo and Pinocchio, reads the file with its own importer. Each result is
    compared with the robot that crosscheck reads, as in `crosscheck diff`. Elements that an importer ignores
    by its documentation, such as actuators, are listed separately.

    The exit status is 0 if all importers read the same robot up to rounding. It is 1 if an importer reads
    another robot, refuses the file or crashes.
    """
    from crosscheck.differences.importers import compare_importers
    from crosscheck.report.importers import report
    from crosscheck.report.output import check_no_other_results
    from crosscheck.support.files import check_no_source, check_writable, write_files

    # with its suffix, as one robot often has an MJCF and a URDF file of the same name
    folder = output or Path("output/importers") / Path(file).name
    if output is None:
        check_no_other_results(folder, [file], "comparison of importers")
    path = folder / "importers.json"
    check_no_source([path], [file])
    check_writable(path)
    with progress_shown() as progress:
        comparison = compare_importers(file, progress)
    found = report(comparison)
    write_files({path: as_json(comparison.summary(), found)})
    failures = [each.reading.failure for each in comparison.others if each.reading.failure]
    steps = explanation_steps(*(failure.value.lower() for failure in failures[:1]))
    show(found, *steps, f"wrote {path}", f"more  {next_step('report', path.parent)}")
    return comparison.outcome.exit_status()
