"""`crosscheck engine-check`: check whether an engine follows the contract that comparisons rely on."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from crosscheck.cli.shared import AGREE, DISAGREE, cli, folder_option, progress_shown, show, verbose_option
from crosscheck.report.render import as_json


@cli.command("engine-check")
@click.argument("engine")
@folder_option("output/engine_check/ENGINE")
@verbose_option
def engine_check_command(engine: str, output: Path | None) -> int:
    """Check the conventions of an engine: start, quaternions, reactions, outputs, energies and equations.

    ENGINE is the name of an engine: a default one, or one that another package registers. Each point of the
    contract is checked on a small scene. A point is REFUSED if the engine refuses its scene with a reason.

    The exit status is 0 if no point fails.
    """
    from crosscheck.engines.registry import choose
    from crosscheck.studies.conformance import Result, check_engine, report
    from crosscheck.support.files import check_writable, write_files

    (chosen,) = choose([engine])
    path = (output or Path("output/engine_check") / engine) / "engine_check.json"
    check_writable(path)
    with progress_shown() as progress:
        findings = check_engine(chosen, progress)
    found = report(chosen, findings)
    write_files({path: as_json({"engine": engine, "points": [asdict(each) for each in findings]}, found)})
    show(found, f"wrote {path}")
    return DISAGREE if any(each.result is Result.FAILS for each in findings) else AGREE
