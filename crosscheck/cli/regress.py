"""`crosscheck regress`: compare the results of newton_euler with stored baselines, or store new baselines."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from crosscheck.cli.help import SCENE
from crosscheck.cli.shared import (
    AGREE,
    DEFAULT_ENGINES,
    allow_reduced_option,
    cli,
    engines_option,
    progress_shown,
    say,
    scene_options,
    setting_options,
    verbose_option,
    verbose_parts,
    warn_about_import,
)
from crosscheck.report.render import terminal
from crosscheck.support.errors import CrosscheckError

if TYPE_CHECKING:
    from crosscheck.regress.run import GuardedScene

_path = click.Path(path_type=Path)

FOLDER = Path("output/regress")
"""Parent of the default folders for reports."""

ENGINES_OF_BASELINES = (
    f"Engines of new baselines, with --update.  [default: those of the old baseline, or {DEFAULT_ENGINES}]"
)
"""Help of the option `--engines`."""


@cli.command(
    "regress",
    arguments={"[SCENE]...": f"{SCENE}  [default: all library scenes that can be loaded]"},
    examples={
        "store the baseline of a file next to it": 'crosscheck regress robot.xml --update "first baseline"',
        "compare with the baseline, as in CI": "crosscheck regress robot.xml",
    },
)
@click.argument("sources", nargs=-1, metavar="[SCENE]...")
@setting_options
@click.option(
    "--baseline",
    type=_path,
    help="File of the baseline of one SCENE.  [default: next to the file]",
)
@click.option(
    "--update", "reason", metavar="REASON", help="Write new baselines, with the reason for the change."
)
@partial(engines_option, text=ENGINES_OF_BASELINES)
@click.option(
    "--output",
    type=_path,
    help="Folder for reports (JSON, JUnit XML, Markdown) and recordings.  "
    "[default: output/regress/NAME for one SCENE, output/regress for several]",
)
@allow_reduced_option
@verbose_option
def regress_command(
    sources: tuple[str, ...],
    settings: tuple[str, ...],
    baseline: Path | None,
    reason: str | None,
    engines: list[str] | None,
    output: Path | None,
    allow_reduced: bool,
) -> int:
    """Regression test: compare results with stored baselines.

    A baseline has masses, accelerations, reactions and runs of a model, and what they cost: operations, steps
    and evaluations. A lower cost is an improvement and never fails. `crosscheck report OUTPUT` writes a page
    of the results.

    The exit status is 0 if no value moved by more than its tolerance, else 1. It is 3 if an engine of a
    baseline is not installed, and 4 if elements of a file act that are not simulated.
    """
    from crosscheck.regress.compare import ACTS
    from crosscheck.regress.report import next_steps, outcome, quiet_versions, report, tables, verdict
    from crosscheck.regress.run import check_baselines, update_baselines

    if len(sources) != 1 and (settings or baseline):
        raise CrosscheckError("--set and --baseline are of one SCENE; name it")
    if engines and reason is None:
        raise CrosscheckError("--engines chooses the engines of new baselines; it needs --update REASON")
    guarded, left_out = _load_guarded(sources, scene_options(settings), baseline)
    if reason is not None:
        if left_out:
            raise CrosscheckError(f"--update: {'; '.join(f'{n}: {why}' for n, why in left_out.items())}")
        with progress_shown() as progress:
            baselines = update_baselines(guarded, reason, progress, engines or ())
        for each, found in zip(guarded, baselines, strict=True):
            unsimulated = found.unsimulated or []
            acting = [line for line in unsimulated if line.startswith(ACTS)]
            elements = len(unsimulated) - len(acting)
            more = f" and {elements} elements not simulated" if elements else ""
            say(f"wrote {each.path}: {len(found.quantities)} quantities{more}")
            for group, why in found.left_out.items():
                say(f"  {group} left out: {why}")
            for line in acting:
                say(f"  {line}; comparisons have exit status 4 without --allow-reduced")
        return AGREE  # exit status 0
    folder = output or _usual_folder(sources)
    # `recordings`: files that show a scene and its baseline side by side, by name of each scene that moved
    with progress_shown() as progress:
        compared, recordings, written = check_baselines(guarded, folder, progress, left_out, allow_reduced)
    # with --verbose all parts of the report, except for the first, the verdicts, which follow; else tables of
    # the changes
    parts = verbose_parts(report(compared, recordings, left_out))[1:]
    click.echo(terminal(parts or tables(compared)), nl=False)
    for comparison in compared:
        say(comparison.verdict)
        if comparison.scene in recordings:
            say(f"  recording: {recordings[comparison.scene]}")
    if versions := quiet_versions(compared):
        say(versions)
    for name, why in left_out.items():
        say(f"{name}: left out: {why}")
    say("wrote " + ", ".join(str(path) for path in written))
    say(verdict(compared, left_out), bold=True)
    if not (result := outcome(compared)).passes(allow_reduced):
        for step in next_steps(compared):
            say(f"next  {step.replace('`', '')}")
    return result.exit_status(allow_reduced)


def _usual_folder(sources: tuple[str, ...]) -> Path:
    """Return the default folder for reports: one for each model, so that no call replaces another model's."""
    from crosscheck.report.output import usual_folder

    if len(sources) != 1:
        return FOLDER
    return usual_folder(FOLDER, sources[0], "regression test")


def _load_guarded(
    sources: tuple[str, ...], options: dict[str, str], baseline: Path | None
) -> tuple[list[GuardedScene], dict[str, str]]:
    """Load the scenes with the paths of their baselines.

    Args:
        sources: names of library scenes or model files; all library scenes if empty.
        options: options of the scene, if there is only one.
        baseline: path of its baseline; None for the default path.

    Returns:
        The scenes, and the library scenes whose optional packages are not installed, with the reason.
    """
    from crosscheck.library import SCENES
    from crosscheck.regress.run import guard_scene
    from newton_euler.errors import MissingPackageError

    found: list[GuardedScene] = []
    left_out: dict[str, str] = {}
    for source in sources or tuple(SCENES):
        if source in SCENES and options and baseline is None:
            raise CrosscheckError(
                f"the baseline of {source!r} is of its defaults; --set needs --baseline FILE"
            )
        try:
            one = guard_scene(source, options, baseline)
        except MissingPackageError as error:
            if sources:
                raise
            left_out[source] = str(error)
            continue
        warn_about_import(source, one.import_report, one.scene)
        for other in found:
            if other.scene.name == one.scene.name:
                raise CrosscheckError(f"{other.source} and {source} are both named {one.scene.name!r}")
        found.append(one)
    return found, left_out
