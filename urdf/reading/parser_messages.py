"""Collect the messages that Pinocchio's URDF parser writes on standard error, and report them.

The errors that Pinocchio raises name no element of the file. The messages on standard error name elements.
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from newton_euler.reading.import_report import Finding, ImportReport, Mistake


def report_complaints(messages: Sequence[str], report: ImportReport) -> None:
    """Add one finding (a likely mistake in the file) for all messages of the parser, except about colors.

    Args:
        messages: lines that the parser has printed.
        report: report that receives the finding.
    """
    complaints = [line for line in messages if not re.search("material|visual|color|texture", line, re.I)]
    if complaints:
        report.findings.append(
            Finding(
                name=Mistake.PARSER_MESSAGE,
                element="the file",
                what=f"Pinocchio's parser prints {len(complaints)} messages, the first is "
                f"{complaints[0]!r:.200}",
                consequence="the parser may read the file differently from your intention",
                remedy="correct the element that the message names",
            )
        )


@contextmanager
def collected_messages(messages: list[str]) -> Iterator[None]:
    """Return a context in which errors and warnings of the parser are appended to `messages`, not printed.

    File descriptor 2, standard error, is redirected to a temporary file: the parser is written in C++.
    """
    sys.stderr.flush()
    saved_stderr = os.dup(2)
    with tempfile.TemporaryFile() as captured:
        os.dup2(captured.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(saved_stderr, 2)
            os.close(saved_stderr)
            captured.seek(0)
            lines = captured.read().decode(errors="replace").splitlines()
            messages += [line.strip() for line in lines if line.startswith(("Error:", "Warning:"))]
