"""`crosscheck regress`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from crosscheck.cli.shared import (
    AGREE,
    cli,
    everything,
    progress_shown,
    say,
    scene_options,
    setting_options,
    tell,
    verbose_option,
)
from crosscheck.errors import CrosscheckError
from crosscheck.report.render import terminal

if TYPE_CHECKING:
    from crosscheck.regress.run import Guarded

_file = click.Path(path_type=Path)


@cli.command("regress")
@click.argument("sources", nargs=-1, metavar="[SCENE]...")
@setting_options
@click.option("--baseline", type=_file, help="Baseline of one SCENE.  [default: of a file, beside it]")
@click.option("--update", "reason", metavar="REASON", help="Make the baselines anew and keep why with them.")
@click.option(
    "--output",
    type=_file,
    default=Path("output/regress"),
    show_default=True,
    help="Folder for reports (JSON, JUnit XML, markdown) and recordings.",
)
@click.option(
    "--allow-reduced",
    is_flag=True,
    help="Exit with 0 although elements of a file act that are not simulated.",
)
@verbose_option
def regress_command(
    sources: tuple[str, ...],
    settings: tuple[str, ...],
    baseline: Path | None,
    reason: str | None,
    output: Path,
    allow_reduced: bool,
) -> int:
    """Compare figures with stored baselines.

    SCENEs are names or model files, the library if none is given. Exit status 1 if a figure moved by more
    than its tolerance, 4 if elements of a file act that are not simulated. A cost (operations, steps,
    evaluations) that fell is an improvement and never fails. What `crosscheck report` makes a page of is in
    OUTPUT.
    """
    from crosscheck.regress.report import outcome, report, tables, verdict
    from crosscheck.regress.run import check, update

    if len(sources) != 1 and (settings or baseline):
        raise CrosscheckError("--set and --baseline are of one SCENE; name it")
    guarded = _guarded(sources, scene_options(settings), baseline)
    if reason is not None:
        with progress_shown() as progress:
            made = update(guarded, reason, progress)
        for each, found in zip(guarded, made, strict=True):
            beside = f", {len(found.unsimulated)} lines on the file beside them" if found.unsimulated else ""
            say(f"wrote {each.path}: {len(found.figures)} figures{beside}")
            for group, why in found.left_out.items():
                say(f"  {group} left out: {why}")
        return AGREE
    with progress_shown() as progress:
        compared, recordings, written = check(guarded, output, progress, allow_reduced)
    parts = everything(report(compared, recordings))[1:]  # the first are the verdicts, which follow
    click.echo(terminal(parts or tables(compared)), nl=False)
    for comparison in compared:
        say(comparison.verdict)
        if comparison.scene in recordings:
            say(f"  recording: {recordings[comparison.scene]}")
    say("wrote " + ", ".join(str(path) for path in written))
    say(verdict(compared), bold=True)
    return outcome(compared).exit_status(allow_reduced)


def _guarded(sources: tuple[str, ...], options: dict[str, str], baseline: Path | None) -> list[Guarded]:
    from crosscheck.regress.run import guard
    from crosscheck.scenes import SCENES

    found: list[Guarded] = []
    for source in sources or tuple(SCENES):
        if source in SCENES and options and baseline is None:
            raise CrosscheckError(
                f"the baseline of {source!r} is of its defaults; --set needs --baseline FILE"
            )
        one = guard(source, options, baseline)
        tell(source, one.mapping)
        for other in found:
            if other.scene.name == one.scene.name:
                raise CrosscheckError(f"{other.source} and {source} are both named {one.scene.name!r}")
        found.append(one)
    return found
