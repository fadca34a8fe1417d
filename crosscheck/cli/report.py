"""`crosscheck report`."""

from __future__ import annotations

from pathlib import Path

import click

from crosscheck.cli.shared import AGREE, cli, progress_shown, say


@cli.command("report")
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
def report_command(folder: Path) -> int:
    """Write DIR/report.html, one page about what other commands wrote to DIR.

    DIR is the folder of run, run --all, regress, faults, stress or bench, with whatever options, or one
    that holds such folders, as output does.
    """
    from crosscheck.report.page import write_report

    with progress_shown() as progress:
        path = write_report(folder, progress)
    say(f"wrote {path}")
    return AGREE
