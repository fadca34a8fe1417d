"""`crosscheck engine-check`: check whether an engine follows the contract that comparisons rely on."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from crosscheck.cli.shared import (
    REFERENCE_ENGINE,
    cli,
    folder_option,
    progress_shown,
    setting_options,
    show,
    verbose_option,
)
from crosscheck.report.render import as_json


@cli.command(
    "engine-check",
    arguments={"ENGINE": "Name of an engine of `crosscheck list`."},
    examples={"check a default engine": f"crosscheck engine-check {REFERENCE_ENGINE}"},
)
@click.argument("engine")
@setting_options
@folder_option("output/engine_check/ENGINE")
@verbose_option
def engine_check_command(engine: str, settings: tuple[str, ...], output: Path | None) -> int:
    """Check whether an engine follows the conventions of crosscheck.

    Each convention (start, quaternions, reactions, joints, forces, control, energies, stops) is checked on a
    small scene. --verbose prints what each check asks and what a failure means. A check is REFUSED if the
    engine cannot represent its scene, or lacks the optional part that the check is about. Any other error of
    the engine fails the check, as does a run that exceeds the limit of processor time: --set time=60.

    The exit status is 0 if no check fails, else 1. It is 3 if no check fails, but the engine refuses a check
    that every engine can pass: start, quaternion_order, outputs or settings.
    """
    from crosscheck.engines.registry import ALL, choose, names
    from crosscheck.studies.conformance.check import check_engine, exit_status, report
    from crosscheck.support.errors import CrosscheckError
    from crosscheck.support.files import check_writable, write_files

    if engine == ALL:
        raise CrosscheckError(f"ENGINE is {ALL!r}; needed: one of {', '.join(names())}")
    if settings:
        raise CrosscheckError(f"--set {settings[0]!r}: engine-check takes limits only, such as time=60")
    (chosen,) = choose([engine])
    path = (output or Path("output/engine_check") / engine) / "engine_check.json"
    check_writable(path)
    with progress_shown() as progress:
        findings = check_engine(chosen, progress)
    found = report(chosen, findings)
    write_files({path: as_json({"engine": engine, "points": [asdict(each) for each in findings]}, found)})
    show(found, f"wrote {path}")
    return exit_status(findings)
