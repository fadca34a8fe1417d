"""Maps of the code: every file, folder and function that a page for developers names exists."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

MAPS = (
    "CONTRIBUTING.md",
    "docs/explanation/architecture.md",
    "docs/explanation/solver.md",
    "docs/explanation/integrators.md",
    "docs/explanation/native_code.md",
)

CODE = re.compile(r"`([^`\n]+)`")
PATH = re.compile(r"(?:newton_euler|mjcf|urdf|crosscheck|tests|docs|examples)/[\w/.\-]*[\w/]")
STEP = re.compile(r"^\| *\d+ *\|.*?\| *`(?P<path>[\w/]+\.py)` *\| *(?P<names>.*?) *\|$", re.MULTILINE)
"""A step of a walk: number, what happens, file, functions and classes."""


@cache
def definitions(path: Path) -> set[str]:
    """Names of functions, classes and methods of a module."""
    tree = ast.parse(path.read_text())
    kinds = ast.FunctionDef | ast.ClassDef
    return {node.name for node in ast.walk(tree) if isinstance(node, kinds)}


@pytest.mark.parametrize("page", MAPS)
def test_files_of_maps_exist(page: str) -> None:
    text = (ROOT / page).read_text()
    paths = {path for code in CODE.findall(text) for path in PATH.findall(code) if "NAME" not in code}
    assert paths
    assert [path for path in sorted(paths) if not (ROOT / path).exists()] == []


def test_functions_of_walks_exist() -> None:
    steps = list(STEP.finditer((ROOT / "docs/explanation/architecture.md").read_text()))
    assert len(steps) > 25
    missing = [
        f"{step['path']}: {name}"
        for step in steps
        for name in CODE.findall(step["names"])
        if name not in definitions(ROOT / step["path"])
    ]
    assert missing == []
