"""Hooks of the site, called by MkDocs: commands, mathematics as MathML, code to copy, folded tables.

Formulas are written in LaTeX between dollar signs. They become MathML when the site is built, which browsers
render without scripts, fonts or a network. `latex2mathml` converts them.
"""

from __future__ import annotations

import html
import re
from collections.abc import Iterator
from inspect import cleandoc
from typing import TYPE_CHECKING

from latex2mathml.converter import convert

if TYPE_CHECKING:
    from mkdocs.structure.pages import Page

FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
NUMBER = re.compile(r"\\tag\{([^}]*)\}")

BAR = re.compile(r"<mo>(&#x0007C;|&#x02016;)</mo>")
"""Bars of absolute values and norms, of the height of the text."""
FUNCTION = re.compile(r"(<mi>(?:cos|sin|tan)</mi>)(?!<mo stretchy=\"false\">&#x00028;)")
"""Functions whose argument has no parentheses."""

CODE = re.compile(r'<div class="highlight">(.*?)</div>', re.DOTALL)
OUTPUT = re.compile(r'<span class="go">.*?</span>', re.DOTALL)
PROMPT = '<span class="gp">'

TABLE = re.compile(r"<table>(.*?)</table>(\s*<p>Table: .*?</p>)?", re.DOTALL)
MAX_OPEN_ROWS = 16
"""Rows of the longest table of results that is shown unfolded."""


COMMANDS = "<!-- commands -->"
"""Place in a page that takes the help of all commands."""

EXPLANATIONS = "<!-- explanations -->"
"""Place in a page that takes the texts of `crosscheck explain`."""

HELP_WIDTH = 100
"""Width of the options of commands, characters."""


def on_page_markdown(markdown: str, **_: object) -> str:
    """Insert the help of all commands, and the texts of `crosscheck explain`."""
    if COMMANDS in markdown:
        markdown = markdown.replace(COMMANDS, "\n".join(commands()))
    if EXPLANATIONS in markdown:
        from crosscheck.report.explain import explanation_markdown

        markdown = markdown.replace(EXPLANATIONS, "\n".join(explanation_markdown()))
    return markdown


def commands() -> Iterator[str]:
    """Yield the help of all commands by task, in lines of Markdown."""
    from crosscheck.cli.help import TASKS, Command
    from crosscheck.cli.shared import cli

    context = cli.make_context(
        "crosscheck", ["list"], max_content_width=HELP_WIDTH, terminal_width=HELP_WIDTH
    )
    for task, names in TASKS.items():
        yield f"## {task}\n"
        for name in names:
            command = cli.commands[name]
            assert isinstance(command, Command)
            yield f"### crosscheck {name}\n\n{cleandoc(command.help or '')}\n"
            with context.scope():
                inner = command.context_class(command, info_name=name, parent=context)
                formatter = inner.make_formatter()
                command.format_usage(inner, formatter)
                command.format_options(inner, formatter)
            yield f"```text\n{formatter.getvalue()}```\n"
            lines = [f"# {what}\n$ {line}\n" for what, line in command.examples.items()]
            yield f"```console\n{''.join(lines)}```\n"


def on_page_content(content: str, page: Page, **_: object) -> str:
    """Convert formulas, mark the commands of console blocks, and fold long tables of results."""
    content = FORMULA.sub(mathematics, content)
    content = CODE.sub(copied, content)
    if page.file.src_uri.startswith("results/"):
        content = TABLE.sub(folded, content)
    return content


def mathematics(formula: re.Match[str]) -> str:
    """Return the MathML of a formula, with its number (`\\tag`) at the right margin."""
    latex = html.unescape(formula[2])
    number = NUMBER.search(latex)
    block = formula[1] == "div"
    mathml = convert(NUMBER.sub("", latex).strip(), display="block" if block else "inline")
    if "\\" in mathml:
        raise ValueError(f"latex2mathml cannot convert a command of the formula {latex.strip()}")
    # browsers stretch bars, and set no space between a function and its argument
    mathml = BAR.sub(r'<mo stretchy="false">\1</mo>', mathml)
    mathml = FUNCTION.sub(r'\1<mspace width="0.17em"></mspace>', mathml)
    mathml = mathml.replace("<math ", f'<math aria-label="{html.escape(latex.strip())}" ', 1)
    if not block:
        return mathml
    label = f'<span class="number">({number[1]})</span>' if number else ""
    return f'<div class="formula">{mathml}{label}</div>'


def copied(block: re.Match[str]) -> str:
    """Give the copy button of a block with prompts its commands, without prompts and output.

    The theme copies the attribute `data-copy` if a block has one.
    """
    if PROMPT not in block[1]:
        return block[0]
    lines = []
    for line in OUTPUT.sub("", block[1]).split("\n"):
        _, prompt, command = line.partition(PROMPT)
        if prompt:
            lines.append(html.unescape(re.sub(r"<[^>]*>", "", command.partition("</span>")[2])))
    return f'<div class="highlight" data-copy="{html.escape(chr(10).join(lines))}">{block[1]}</div>'


def folded(table: re.Match[str]) -> str:
    """Fold a table with more than `MAX_OPEN_ROWS` rows below a line with its caption."""
    rows = table[1].count("<tr>") - 1
    if rows <= MAX_OPEN_ROWS:
        return table[0]
    heads = re.findall(r"<th[^>]*>(.*?)</th>", table[1], re.DOTALL)
    caption = table[2] or f"Table: {', '.join(filter(None, heads))}"
    caption = re.sub(r"<[^>]*>", "", caption).strip().removeprefix("Table: ").rstrip(".")
    return (
        f'<details class="table"><summary>{rows} rows: {caption}</summary><table>{table[1]}</table></details>'
    )
