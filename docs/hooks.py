"""Hooks of the site, called by MkDocs: version, tables of commands and names, formulas, copied code, folding.

Formulas are written in LaTeX between dollar signs. They become MathML when the site is built, which browsers
render without scripts, fonts or a network. `latex2mathml` converts them.
"""

from __future__ import annotations

import html
import importlib
import inspect
import posixpath
import re
import subprocess
from collections.abc import Iterable, Iterator
from functools import cache, partial
from importlib import metadata
from inspect import cleandoc
from pathlib import Path
from typing import TYPE_CHECKING

from latex2mathml.converter import convert

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

DOCS = Path(__file__).parent

BOOSTS = {
    "tutorial": 1.5,
    "how_to": 1.5,
    "explanation": 1.3,
    "reference": 1.3,
    "reference/python": 0.5,
    "results": 0.5,
}
"""Factors on the score of the pages of a folder in the search; 1 for others."""

FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
NUMBER = re.compile(r"\\tag\{([^}]*)\}")

BAR = re.compile(r"<mo>(&#x0007C;|&#x02016;)</mo>")
"""Bars of absolute values and norms, of the height of the text."""
FUNCTION = re.compile(r"(<mi>(?:cos|sin|tan)</mi>)(?!<mo stretchy=\"false\">&#x00028;)")
"""Functions whose argument has no parentheses."""

CODE = re.compile(r'<div class="highlight">(.*?)</div>', re.DOTALL)
OUTPUT = re.compile(r'<span class="go">.*?</span>', re.DOTALL)
PROMPT = '<span class="gp">'

LINK_OF_NOTEBOOK = re.compile(r'href="([^":#]+\.(?:md|ipynb))(#[^"]*)?"')
"""A link to a page by its file, as Jupyter follows it. MkDocs converts links of Markdown pages only."""

TABLE = re.compile(r"<table>(.*?)</table>(?:(?:\s*<!--[^>]*-->)?(\s*<p>Table: .*?</p>))?", re.DOTALL)
"""A table and its caption. A comment may stand between both, such as the end mark of a generated table."""
MAX_OPEN_ROWS = 16
"""Rows of the longest table of results that is shown unfolded."""

COMMANDS = re.compile("<!-- commands: (.+) -->")
"""Place in a page that takes the help of the commands of a task."""

TABLE_OF_COMMANDS = "<!-- table of commands -->"
"""Place in a page that takes tables of all commands with links, one for each task."""

EXPLANATIONS = re.compile("<!-- explanations: (.+) -->")
"""Place in a page that takes the texts of `crosscheck explain` on a topic."""

INDEX_OF_NAMES = re.compile("<!-- names: (.+) -->")
"""Place in a page that takes a table of the public names on some pages of the Python reference."""

INDEX_OF_RESULTS = "<!-- names of results -->"
"""Place in a page that takes a table of the classes that are documented but not public."""

NAME = re.compile(r"^::: (\S+)\n(?: +options:\n(?: +(?:heading: (.+)|.*)\n)*)?", re.MULTILINE)
"""A name that mkdocstrings documents, and its heading if it is not the name."""

MEMBERS = re.compile(r"^ +members: \[(.+)\]", re.MULTILINE)
"""Members of a name that mkdocstrings documents, too."""

NAMES_FOLDER = "reference/python/"
"""Folder of the pages of Python names."""

PAGES_OF_IMPORTS = ("engine", "errors")
"""Pages of Python names of which all are imported by users, whatever their module."""

MENTIONED = re.compile(r"<(a|autoref|pre|h[1-6])\b.*?</\1>|<code>([\w.]+)</code>", re.DOTALL)
"""A name in a sentence, or an element in which names are not linked."""

OPTION = re.compile(r"(?<=--)[\w-]+")
"""The name of an option in its term, such as "verbose" in "-v, --verbose"."""

HELP_WIDTH = 80
"""Width of the help of commands, characters, as terminals have it."""


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Set the version of the footer."""
    config.copyright = version_note()
    return config


def version_note() -> str:
    """Return the version that the site describes: tag or commit with its date, or the installed version."""
    describe = "describe", "--tags", "--always", "--dirty=, with local changes"
    try:
        version, date = (git(*command) for command in (describe, ("log", "-1", "--format=%cs")))
    except (OSError, subprocess.CalledProcessError):  # no git, or sources without a repository
        return f"crosscheck {metadata.version('crosscheck-dynamics')}"
    return f"crosscheck, version {html.escape(version)} of {date}"


def git(*command: str) -> str:
    """Return the output of a git command in the repository of the documentation."""
    return subprocess.run(
        ["git", "-C", str(DOCS), *command], capture_output=True, text=True, check=True
    ).stdout.strip()


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, **_: object) -> str:
    """Insert the help and tables of commands, explanations and names; rank pages for the search."""
    folder = page.file.src_uri.rpartition("/")[0]
    page.meta.setdefault("search", {})["boost"] = BOOSTS.get(folder, 1.0)
    if TABLE_OF_COMMANDS in markdown:
        markdown = markdown.replace(TABLE_OF_COMMANDS, "\n".join(table_of_commands()))
    if INDEX_OF_RESULTS in markdown:
        markdown = markdown.replace(INDEX_OF_RESULTS, "\n".join(index_of_results(config)))
    markdown = INDEX_OF_NAMES.sub(lambda place: "\n".join(index_of_names(place[1].split())), markdown)
    markdown = EXPLANATIONS.sub(lambda place: "\n".join(explanations(place[1])), markdown)
    return COMMANDS.sub(lambda place: "\n".join(commands(place[1])), markdown)


def explanations(topic: str) -> Iterator[str]:
    """Yield the texts of `crosscheck explain` on a topic, in lines of Markdown."""
    from crosscheck.report.explain import explanation_markdown

    return explanation_markdown(topic)


def table_of_commands() -> Iterator[str]:
    """Yield the lines of a table of the commands of each task, with links to the page of the task."""
    from crosscheck.cli.help import TASKS
    from crosscheck.cli.shared import cli

    pages = {
        task: page.name
        for page in (DOCS / "reference" / "commands").glob("*.md")
        for task in COMMANDS.findall(page.read_text())
    }
    for task, names in TASKS.items():
        yield f"### {task}\n\n| command | what the command does |\n|---|---|"
        for name in names:
            what = cli.commands[name].get_short_help_str(limit=200)
            yield f"| [`{name}`](commands/{pages[task]}#crosscheck-{name}) | {what} |"
        yield ""


def commands(task: str) -> Iterator[str]:
    """Yield the help of the commands of a task, in lines of Markdown."""
    from crosscheck.cli.help import TASKS, Command
    from crosscheck.cli.shared import cli

    context = cli.make_context(
        "crosscheck", ["list"], max_content_width=HELP_WIDTH, terminal_width=HELP_WIDTH
    )
    for name in TASKS[task]:
        command = cli.commands[name]
        assert isinstance(command, Command)
        yield f"## crosscheck {name}\n\n{cleandoc(command.help or '')}\n"
        with context.scope():
            inner = command.context_class(command, info_name=name, parent=context)
            formatter = inner.make_formatter()
            command.format_usage(inner, formatter)
            sections = command.sections(inner)
        yield f"```text\n{formatter.getvalue()}```\n"
        for heading, rows in sections.items():
            yield f"**{heading}**\n"
            for term, text in rows:
                words = OPTION.findall(term) or re.findall(r"\w+", term)[:1]
                anchor = f"{name}-{words[-1]}"
                yield f"- [`{term}`](#{anchor}){{ #{anchor} }}: {markdown_text(text)}"
            yield ""
        lines = [f"# {what}\n$ {line}\n" for what, line in command.examples.items()]
        yield f"```console\n{''.join(lines)}```\n"


def markdown_text(text: str) -> str:
    """Return a text of a help page as Markdown, in which `*`, `<` and `[` have no meaning."""
    parts = text.split("`")
    parts[::2] = [re.sub(r"([*\[\]])", r"\\\1", html.escape(part, quote=False)) for part in parts[::2]]
    return "`".join(parts)


def index_of_names(pages: Iterable[str]) -> Iterator[str]:
    """Yield the lines of a table of public names: path for imports, link, and what the name is.

    Args:
        pages: pages of the Python reference, such as "simulate", whose names the table has.
    """
    yield "| name | what it is |\n|---|---|"
    for page in pages:
        for name, heading in NAME.findall((DOCS / NAMES_FOLDER / f"{page}.md").read_text()):
            if is_public(page, name, heading):
                label = f'<a id="{name}"></a>[`{heading or name}`](python/{page}.md#{name})'
                yield f"| {label} | {description(name)} |"


def index_of_results(config: MkDocsConfig) -> Iterator[str]:
    """Yield the lines of a table of the documented classes that are not public, in the order of the site."""
    yield "| class | module | what it is |\n|---|---|---|"
    for path in pages_of(config.nav, NAMES_FOLDER):
        page = Path(path).stem
        for name, heading in NAME.findall((DOCS / path).read_text()):
            if not is_public(page, name, heading):
                module, _, last = name.rpartition(".")
                label = f'<a id="{name}"></a>[`{last}`](python/{page}.md#{name})'
                yield f"| {label} | `{module}` | {description(name)} |"


def is_public(page: str, name: str, heading: str) -> bool:
    """Return whether you import a name: functions, modules, exported classes, errors, and parts of engines.

    Args:
        page: page of the Python reference with the name.
        name: path of the name.
        heading: path for imports if it is shorter; "" otherwise.
    """
    if page in PAGES_OF_IMPORTS or name.rpartition(".")[2][0].islower():
        return True
    package, _, exported = (heading or name).rpartition(".")
    return "." not in package and exported in importlib.import_module(package).__all__


def description(name: str) -> str:
    """Return the first paragraph of the docstring of a Python name, as Markdown for a cell of a table."""
    module, _, attribute = name.rpartition(".")
    documented = importlib.import_module(module)
    try:
        documented = getattr(documented, attribute)
    except AttributeError:  # a module
        documented = importlib.import_module(name)
    first = (inspect.getdoc(documented) or "").partition("\n\n")[0]
    return markdown_text(" ".join(first.split())).replace("|", r"\|")


def pages_of(nav: object, folder: str) -> Iterator[str]:
    """Yield the paths of the pages in a folder, in the order of the navigation."""
    if isinstance(nav, str):
        if nav.startswith(folder):
            yield nav
        return
    for entry in nav.values() if isinstance(nav, dict) else nav if isinstance(nav, list) else ():
        yield from pages_of(entry, folder)


def on_page_content(content: str, page: Page, files: Files, **_: object) -> str:
    """Convert formulas and links of notebooks, mark commands, link Python names, fold long tables."""
    if page.file.src_uri.endswith(".ipynb"):
        content = LINK_OF_NOTEBOOK.sub(
            lambda link: f'href="{address(link[1], page, files)}{link[2] or ""}"', content
        )
    content = FORMULA.sub(mathematics, content)
    content = CODE.sub(copied, content)
    if page.file.src_uri.startswith("results/"):
        content = TABLE.sub(folded, content)
    if page.file.src_uri.startswith(NAMES_FOLDER):
        content = MENTIONED.sub(partial(linked, places_of_names(), page, files), content)
    return content


@cache
def places_of_names() -> dict[str, tuple[str, str]]:
    """Return the page and the anchor of each documented Python name and its members, by their spellings.

    A name is spelled with its module, with its package, and, if it is a class, alone. A name that several
    packages have is spelled alone nowhere.
    """
    places: dict[str, tuple[str, str]] = {}
    spelled_alone: dict[str, list[tuple[str, str]]] = {}
    for path in sorted((DOCS / NAMES_FOLDER).glob("*.md")):
        uri, text = path.relative_to(DOCS).as_posix(), path.read_text()
        for entry in NAME.finditer(text):
            full = entry[1]
            members = [name.strip() for found in MEMBERS.findall(entry[0]) for name in found.split(",")]
            package, last = full.partition(".")[0], full.rpartition(".")[2]
            for suffix in ("", *(f".{member}" for member in members)):
                place = uri, full + suffix
                places[full + suffix] = places[f"{package}.{last}{suffix}"] = place
                if last[0].isupper():
                    spelled_alone.setdefault(last + suffix, []).append(place)
    return places | {name: found[0] for name, found in spelled_alone.items() if len(found) == 1}


def linked(places: dict[str, tuple[str, str]], page: Page, files: Files, mention: re.Match[str]) -> str:
    """Return a mentioned Python name with a link to its description.

    Args:
        places: page and anchor by name.
        page: page with the name.
        files: all files of the site.
        mention: the name, or an element that stays as it is.
    """
    uri, anchor = places.get(mention[2] or "", ("", ""))
    file = files.get_file_from_path(uri) if uri else None
    if file is None:
        return mention[0]
    return f'<a href="{file.url_relative_to(page.file)}#{anchor}">{mention[0]}</a>'


def address(path: str, page: Page, files: Files) -> str:
    """Return the relative address of a page that another page names by the path of its file."""
    source = posixpath.normpath(posixpath.join(posixpath.dirname(page.file.src_uri), path))
    target = files.get_file_from_path(source)
    if target is None:
        raise ValueError(
            f"{page.file.src_uri}: the link '{path}' leads to no page; write a path relative to the file"
        )
    return target.url_relative_to(page.file)


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
