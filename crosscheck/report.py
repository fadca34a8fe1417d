"""The figures of a crosscheck as a table for the terminal and as markdown."""

from __future__ import annotations

from rich.table import Table

from crosscheck.compare import Row
from crosscheck.run import Crosscheck


def _cells(row: Row) -> tuple[str, str, str, str, str, str]:
    return (
        row.quantity,
        " | ".join(row.between),
        f"{row.value:.1e}",
        f"{row.tolerance:.0e}",
        "agree" if row.agrees else "DISAGREE",
        row.where,
    )


def terminal_table(result: Crosscheck) -> Table:
    """All figures, a section for each level."""
    table = Table(title=f"{result.scene.name}: {result.scene.description}", title_justify="left")
    for heading, justify in (
        ("figure", "left"),
        ("between", "left"),
        ("value", "right"),
        ("at most", "right"),
        ("verdict", "left"),
        ("worst at", "left"),
    ):
        table.add_column(heading, justify=justify)  # type: ignore[arg-type]
    level = ""
    for row in result.rows:
        if row.level != level:
            level = row.level
            table.add_section()
            table.add_row(f"[bold]{level}[/bold]")
        table.add_row(*_cells(row), style="" if row.agrees else "bold red")
    return table


def markdown(result: Crosscheck) -> str:
    """The verdict, the settings of the engines and all figures."""
    lines = [f"# {result.scene.name}", "", f"**{result.verdict}**", ""]
    for name, run in result.runs.items():
        settings = ", ".join(f"{key} {value}" for key, value in run.settings.items())
        lines.append(f"- {name}: {settings}; {run.wall_time:.2f} s")
    level = ""
    for row in result.rows:
        if row.level != level:
            level = row.level
            lines += [
                "",
                f"## {level}",
                "",
                "| figure | between | value | at most | verdict | worst at |",
                "|---|---|---|---|---|---|",
            ]
        lines.append("| " + " | ".join(cell.replace(" | ", ", ") for cell in _cells(row)) + " |")
    return "\n".join(lines) + "\n"
