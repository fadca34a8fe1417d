"""Results of Python functions that show their report as text and in notebooks."""

from __future__ import annotations

from abc import ABC, abstractmethod

from crosscheck.report.render import terminal, wrapped
from crosscheck.report.table import Report
from crosscheck.report.template import rendered


class Shown(ABC):
    """Result with a report: its verdict is the representation, its summary the text and the HTML."""

    @property
    @abstractmethod
    def report(self) -> Report:
        """Tables and sentences on the result."""

    def __repr__(self) -> str:
        return f"<{self.report.verdict}>"

    def __str__(self) -> str:
        head = f"{wrapped(self.report.title)}\n{wrapped(self.report.verdict)}"
        return f"{head}\n\n{terminal(self.report.summary)}"

    def _repr_html_(self) -> str:
        return rendered("summary.html", report=self.report)
