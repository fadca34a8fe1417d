"""`crosscheck diff`: compare two model files of one robot."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import click

from crosscheck.cli.shared import (
    cli,
    explanation_steps,
    folder_option,
    fraction,
    progress_shown,
    scene_options,
    show,
    verbose_option,
)
from crosscheck.report.render import as_json, markdown
from crosscheck.support.errors import CrosscheckError


@cli.command(
    "diff",
    arguments={
        "FIRST": "MJCF, URDF or scene file, or library scene.",
        "SECOND": "The other file, as FIRST.",
    },
    examples={
        "compare two versions of a file": "crosscheck diff robot.xml robot_v2.xml",
        "compare the MJCF and the URDF of one robot": "crosscheck diff examples/arm.xml examples/arm.urdf",
    },
)
@click.argument("first")
@click.argument("second")
@click.option(
    "--set-first",
    multiple=True,
    metavar="OPTION=VALUE",
    help="Option of FIRST, such as loops=FILE or root=DIR. Repeatable.",
)
@click.option("--set-second", multiple=True, metavar="OPTION=VALUE", help="Option of SECOND. Repeatable.")
@click.option(
    "--names",
    type=click.Path(path_type=Path),
    help="YAML file with the names of SECOND by those of FIRST, for names that differ.",
)
@click.option(
    "--tolerance",
    type=fraction,
    metavar="NUMBER",
    help="Largest relative difference that is rounding.  [default: from the digits of the files]",
)
@click.option("--geometry", is_flag=True, help="Compare collision and visual shapes, too.")
@folder_option("output/diff/FIRST_SECOND")
@verbose_option
def diff_command(
    first: str,
    second: str,
    set_first: tuple[str, ...],
    set_second: tuple[str, ...],
    names: Path | None,
    tolerance: float | None,
    geometry: bool,
    output: Path | None,
) -> int:
    """Compare two model files of one robot.

    Bodies and joints are paired by name and by structure. Each difference has one row with its effect on the
    motion. Differences within the digits of the files are rounding. In GitHub Actions, differences become
    annotations at the lines of the files.

    The exit status is 0 if the robots are the same up to rounding, 1 if they differ, and 3 if the numbers are
    the same but the motions could not be compared.
    """
    options = scene_options(set_first, "--set-first"), scene_options(set_second, "--set-second")
    from crosscheck.differences.alignment import NamesError

    try:
        return _compare_and_show((first, second), options, output, _pairs(names), tolerance, geometry)
    except NamesError as error:
        raise CrosscheckError(f"{names}: {str(error).removeprefix('names: ')}") from error


def _compare_and_show(
    models: tuple[str, str],
    options: tuple[Mapping[str, str], Mapping[str, str]],
    output: Path | None,
    names: Mapping[str, str],
    tolerance: float | None,
    geometry: bool,
) -> int:
    """Compare two model files, write and print the results, and return the exit status.

    Args:
        models: names or files of the models.
        options: options of each model.
        output: folder for the results; None for the default.
        names: names of bodies or joints of the first file, and of their partners in the second.
        tolerance: relative difference that counts as rounding; None for the digits of the files.
        geometry: whether shapes of bodies are compared, too.
    """
    from crosscheck.differences.result import compare_models
    from crosscheck.report.annotations import sarif, workflow_commands
    from crosscheck.report.diff import report
    from crosscheck.report.output import check_no_other_results, results_name
    from crosscheck.report.page import PAGE, write_report
    from crosscheck.support.files import check_no_source, check_writable, write_files

    folder = output or Path("output/diff") / "_".join(map(results_name, models))
    paths = [folder / name for name in ("diff.json", "summary.md", "diff.sarif")]
    check_no_source(paths, models)
    if output is None:
        check_no_other_results(folder, models, "comparison of files")
    check_writable(*paths, folder / PAGE)
    with progress_shown() as progress:
        comparison = compare_models(models, options, names, tolerance, progress, geometry)
    found = report(comparison)
    summary = markdown(replace(found, parts=found.summary)).encode()
    numbers = comparison.summary()
    # the models as they were named: a scene has no file of its own, and the folder would belong to no model
    for described, name in zip(numbers["models"], models, strict=True):
        described["source"] = name
    contents = as_json(numbers, found), summary, sarif(comparison)
    write_files(dict(zip(paths, contents, strict=True)))
    page = write_report(folder, lambda _: None).path
    # the quantity of the first row, whose effect is the largest
    quantities = [row.quantity.value for row in comparison.differences[:1]]
    show(found, *explanation_steps(*quantities), f"wrote {', '.join(map(str, [page, *paths]))}")
    if os.environ.get("GITHUB_ACTIONS") == "true":
        for command in workflow_commands(comparison):
            click.echo(command)
    return comparison.outcome.exit_status()


def _pairs(path: Path | None) -> dict[str, str]:
    """Read pairs of names from a YAML file; none without a file."""
    from newton_euler.errors import quoted
    from newton_euler.model.source_file import SourceError, read_text
    from newton_euler.model.yaml_source import parse_yaml

    if path is None:
        return {}
    source = str(path)
    content = parse_yaml(source, read_text(source, limit="file_size", error=SourceError))
    needed = "needed: a line 'name in FIRST: name in SECOND' for each pair"
    if not isinstance(content, dict) or not content:
        given = f"{quoted(content, 60)}, no pairs of names" if content else "no names"
        raise CrosscheckError(f"{source}: {given}; {needed}")
    for name, partner in content.items():
        if not isinstance(partner, str):
            raise CrosscheckError(f"{source}: {name!r:.60} has the partner {quoted(partner, 60)}; {needed}")
    return content
