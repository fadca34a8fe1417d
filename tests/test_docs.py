"""Code of README and docs: Python runs, commands exist, and what they print is what the page says."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from crosscheck.cli.shared import cli
from crosscheck.engines.registry import NotInstalledError
from crosscheck.verdict import Verdict

ROOT = Path(__file__).parents[1]

PAGES = sorted(str(page.relative_to(ROOT)) for page in (ROOT / "README.md", *ROOT.glob("docs/**/*.md")))

FENCE = re.compile(r'^```(\w*)(?: title="([^"]+)")?\n(.*?)^```$', re.MULTILINE | re.DOTALL)

VERDICT = re.compile(
    r"^(AGREE|DISAGREE|SAME|DIFFERENT|QUIET|MOVED|INACCURATE|CONFORMS: \w+: \d+ of \d+ points)\b",
    re.MULTILINE,
)

STATUSES = {"DISAGREE": 1, "DIFFERENT": 1, "MOVED": 1, "INACCURATE": 5}
"""Exit status of verdicts, if not 0."""


class Block(NamedTuple):
    """A fenced block of a page: its language, the file that its title names, and its text."""

    language: str
    title: str
    text: str


def blocks(page: str, language: str) -> list[Block]:
    """All blocks of a page in a language."""
    found = (Block(*groups) for groups in FENCE.findall((ROOT / page).read_text()))
    return [block for block in found if block.language == language]


def having(*languages: str) -> list[str]:
    """Pages with a block in one of some languages."""
    return [page for page in PAGES if any(blocks(page, language) for language in languages)]


def commands(page: str) -> Iterator[tuple[str, str]]:
    """Each command of a page's console blocks, without the environment's path, and what is shown below it."""
    for block in blocks(page, "console"):
        for part in re.split(r"^\$ ", block.text, flags=re.MULTILINE)[1:]:
            command, _, shown = part.partition("\n")
            yield command.replace(".venv/bin/", "").replace("make run", "crosscheck run tracker"), shown


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The working folder of a test, with the files that pages name; no window opens."""
    for name in ("examples", "mjcf"):
        shutil.copytree(ROOT / name, tmp_path / name)
    shutil.copy(ROOT / "examples" / "linkage.xml", tmp_path / "robot.xml")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Verdict, "show", lambda verdict: None)
    return tmp_path


def write_files(page: str, folder: Path) -> None:
    """Write the files of a page into a folder."""
    for language in ("xml", "yaml", "python", "toml", "csv"):
        for _, title, text in blocks(page, language):
            if title:
                (folder / title).write_text(text)
            if title == "pyproject.toml":
                install(tomllib.loads(text)["project"], folder)


def execute(page: str, folder: Path) -> dict[str, object]:
    """Write the files of a page into a folder and execute its Python blocks; returns their namespace."""
    write_files(page, folder)
    names: dict[str, object] = {}
    for block in blocks(page, "python"):
        exec(compile(block.text, page, "exec"), names)
    return names


def install(project: dict[str, Any], folder: Path) -> None:
    """Make the entry points of a package in a folder known, as its installation does."""
    info = folder / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Name: {name}\nVersion: {version}\n".format(**project))
    groups = project["entry-points"].items()
    lines = [f"[{group}]\n" + "".join(f"{k} = {v}\n" for k, v in points.items()) for group, points in groups]
    (info / "entry_points.txt").write_text("".join(lines))


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md", "CHANGELOG.md"])
def test_links_to_files_lead_to_files(page):
    targets = re.findall(r"\]\((?!https?:)([^)#]+)", (ROOT / page).read_text())
    assert [target for target in targets if not (ROOT / target).exists()] == []


LONG = (
    "docs/how_to/identification.md",
    "docs/how_to/identification_friction.md",
    "docs/how_to/logs.md",
    "docs/how_to/moving_base.md",
    "docs/how_to/place_to_tracker.md",
    "docs/how_to/sun.md",
    "docs/how_to/sweep_tolerances.md",
    "docs/how_to/wind.md",
    "docs/reference/python.md",
    "docs/reference/python/control.md",
    "docs/reference/python/engine.md",
    "docs/reference/python/engines.md",
    "docs/reference/python/files.md",
    "docs/reference/python/identification.md",
    "docs/reference/python/importers.md",
    "docs/reference/python/judgement.md",
    "docs/reference/python/kinematics.md",
    "docs/reference/python/linear.md",
    "docs/reference/python/own_run.md",
    "docs/reference/python/sensitivities.md",
    "docs/reference/python/simulate.md",
    "docs/reference/python/sweep.md",
    "docs/reference/python/verdict.md",
    "docs/results/tolerances.md",
)
"""Pages whose code takes 3 to 17 s. Tests of their subjects and of docstrings do the same in shorter runs."""


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, marks=pytest.mark.slow) if page in LONG else page for page in having("python")],
)
def test_python_runs(page, folder):
    assert execute(page, folder).keys() - {"__builtins__"}, "no block of the page defines anything"


@pytest.mark.parametrize("page", having("console"))
def test_commands_and_their_options_exist(page, folder, monkeypatch):
    monkeypatch.syspath_prepend(folder)
    write_files(page, folder)
    for command, _ in commands(page):
        program, name, *rest = shlex.split(command)
        if program == "crosscheck":
            # within the group's context: Click keeps the help option that a command was first given; an
            # optional engine that the page names may not be installed
            with (
                suppress(NotInstalledError),
                cli.make_context("crosscheck", [name, *rest]) as group,
                cli.commands[name].make_context(name, rest, parent=group),
            ):
                pass


@pytest.mark.slow
@pytest.mark.parametrize("page", having("console"))
def test_commands_come_to_the_verdict_that_the_page_shows(page, folder):
    execute(page, folder)
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "PYTHONPATH": os.pathsep.join([str(folder), *sys.path])}
    for command, shown in commands(page):
        program, name, *_ = shlex.split(command)
        if program not in ("crosscheck", "sed") or name == "view":
            continue
        done = subprocess.run(
            command, shell=True, env=environment, capture_output=True, text=True, check=False
        )
        said, wanted = f"{command}\n{done.stdout}{done.stderr}", set(VERDICT.findall(shown))
        assert wanted <= set(VERDICT.findall(done.stdout)), said
        assert done.returncode == max((STATUSES.get(verdict, 0) for verdict in wanted), default=0), said
