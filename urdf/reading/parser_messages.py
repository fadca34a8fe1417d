"""Collect messages that Pinocchio's URDF parser writes on standard error."""

from __future__ import annotations

import os
import re
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from newton_euler.reading.import_report import Finding, ImportReport


def report_complaints(words: Sequence[str], report: ImportReport) -> None:
    """Add one finding for all messages of the parser, except messages about colors."""
    complaints = [line for line in words if not re.search("material|visual|color|texture", line, re.I)]
    if complaints:
        report.findings.append(
            Finding(
                "parser-message",
                "the file",
                f"Pinocchio's parser prints {len(complaints)} messages, the first is {complaints[0]!r:.200}",
                "the parser may read the file differently from your intention",
                "correct the element that the message names",
            )
        )


@contextmanager
def overheard(words: list[str]) -> Iterator[None]:
    """Collect the lines that the parser writes on standard error, instead of printing them.

    Errors of the parser name no element; its lines do.
    """
    sys.stderr.flush()
    before = os.dup(2)
    with tempfile.TemporaryFile() as said:
        os.dup2(said.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(before, 2)
            os.close(before)
            said.seek(0)
            lines = said.read().decode(errors="replace").splitlines()
            words += [line.strip() for line in lines if line.startswith(("Error:", "Warning:"))]
