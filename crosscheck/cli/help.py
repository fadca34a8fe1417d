"""Help of the commands: commands by task, arguments and options in sections, examples.

`Commands` is the class of the group `crosscheck`, and `Command` is the class of each command. Their help has
at most 80 columns, and its lines break at spaces only.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import click

MAX_TERM_WIDTH = 28
"""Width, characters, of the column of options and arguments; a longer one has its text on the next line."""

SCENE = "Library scene (`crosscheck list`), scene file (YAML, JSON), MJCF or URDF file."
"""Help of the argument SCENE."""


TASKS = {
    "Check a model": ("run", "explain", "tune", "importers"),
    "Compare models and versions": ("diff", "regress"),
    "Vary and fit parameters": ("sweep", "identify"),
    "Design a mechanism": ("workspace", "modes", "loads", "drives", "controllers"),
    "Design a solar tracker": ("sun", "year"),
    "Test engines": ("bench", "stress", "engine-check", "faults", "figures"),
    "Models and results": ("list", "convert", "view", "report"),
}
"""Commands by task of the user, which is a heading in `crosscheck --help`."""


class Formatter(click.HelpFormatter):
    """Writes help with lines that break at spaces only; Click also breaks at hyphens and in long words."""

    def write_text(self, text: str) -> None:
        """Write indented paragraphs, which blank lines separate."""
        indent = " " * self.current_indent
        paragraphs = [" ".join(paragraph.split()) for paragraph in text.split("\n\n")]
        filled = (_fill(paragraph, self.width, indent, indent) for paragraph in paragraphs)
        self.write("\n\n".join(filled) + "\n")

    def write_dl(
        self, rows: Iterable[tuple[str, str]], col_max: int = MAX_TERM_WIDTH, col_spacing: int = 2
    ) -> None:
        """Write terms, such as options, with their texts in a second column."""
        rows, margin = list(rows), " " * self.current_indent
        column = min(max(len(term) for term, _ in rows), col_max) + col_spacing
        indent = margin + " " * column
        for term, text in rows:
            if len(term) <= column - col_spacing:
                first = f"{margin}{term:{column}}"
            else:
                self.write(f"{margin}{term}\n")
                first = indent
            self.write(_fill(text, self.width, first, indent) + "\n")


class Context(click.Context):
    """Context of a command whose help `Formatter` writes."""

    formatter_class = Formatter


class Command(click.Command):
    """Command whose help has sections for its arguments, groups of its options, and its examples.

    Args:
        examples: command lines, by what they do. They can be run in this order.
        arguments: help of each argument, by its name in the usage line.
        groups: options, such as "--set", by the heading of their group. Other options are below "Options".
        arguments_of_click: arguments of `click.Command`.
    """

    context_class = Context

    def __init__(
        self,
        *,
        examples: Mapping[str, str],
        arguments: Mapping[str, str] | None = None,
        groups: Mapping[str, Sequence[str]] | None = None,
        **arguments_of_click: Any,
    ) -> None:
        super().__init__(**arguments_of_click)
        self.examples, self.arguments, self.groups = examples, arguments or {}, groups or {}

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write arguments, and options by group."""
        for heading, rows in self.sections(ctx).items():
            with formatter.section(heading):
                formatter.write_dl(rows)

    def sections(self, ctx: click.Context) -> dict[str, list[tuple[str, str]]]:
        """Return terms and texts of the arguments, and of the options by group, by heading."""
        options = [each for each in self.get_params(ctx) if isinstance(each, click.Option)]
        rows = {each.opts[-1]: row for each in options if (row := each.get_help_record(ctx))}
        sections = {"Arguments": list(self.arguments.items())} if self.arguments else {}
        for heading, names in self.groups.items():
            sections[heading] = [rows.pop(name) for name in names]
        sections["Options"] = list(rows.values())
        return sections

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the examples."""
        with formatter.section("Examples"):
            margin = " " * formatter.current_indent
            examples = [
                f"{margin}# {what}\n{_command_lines(line, formatter.width, margin)}\n"
                for what, line in self.examples.items()
            ]
            formatter.write("\n".join(examples))


class Commands(click.Group):
    """Group of commands whose help lists the commands by task, each with its first sentence."""

    context_class = Context
    command_class = Command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands below the headings of their tasks."""
        width = max(map(len, self.commands))
        for task, names in TASKS.items():
            with formatter.section(task):
                formatter.write_dl(
                    [(f"{name:{width}}", self.commands[name].get_short_help_str(limit=200)) for name in names]
                )
        formatter.write("\n")
        formatter.write_text("`crosscheck COMMAND --help` prints the options and examples of a command.")


def _command_lines(line: str, width: int, margin: str) -> str:
    """Wrap a command line for a shell: lines that continue end with a backslash.

    Args:
        line: the command line, without spaces in its arguments.
        width: width of lines, characters.
        margin: beginning of the first line; the others have four more spaces.
    """
    filled = _fill(line, width - 2, margin, f"{margin}    ")
    return filled.replace("\n", " \\\n")


def _fill(text: str, width: int, first: str, indent: str) -> str:
    """Wrap a text at spaces.

    Args:
        text: the text.
        width: width of lines, characters.
        first: beginning of the first line.
        indent: beginning of the other lines.
    """
    return textwrap.fill(
        text,
        width,
        initial_indent=first,
        subsequent_indent=indent,
        break_long_words=False,
        break_on_hyphens=False,
    )
