"""Which package may import which, and what an import costs."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

ALLOWED = {
    "newton_euler": {"newton_euler"},
    "mjcf": {"newton_euler", "mjcf", "mujoco"},
    "urdf": {"newton_euler", "urdf", "pinocchio"},
    "crosscheck": {"newton_euler", "mjcf", "urdf", "crosscheck", "rerun"},
}
WATCHED = {"newton_euler", "mjcf", "urdf", "crosscheck", "mujoco", "pinocchio", "rerun"}


@pytest.mark.parametrize("package", ALLOWED)
def test_imports_point_one_way(package):
    sources = sorted((ROOT / package).rglob("*.py"))
    assert sources
    for source in sources:
        found = set()
        for node in ast.walk(ast.parse(source.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{source}: relative import"
                found.add(str(node.module).split(".")[0])
        assert found & WATCHED <= ALLOWED[package], source


@pytest.mark.parametrize("package", ["newton_euler", "mjcf", "urdf", "crosscheck.scenes", "crosscheck.cli"])
def test_importing_a_package_loads_nothing_heavy(package):
    heavy = "{'scipy', 'mujoco', 'pinocchio', 'rerun', 'matplotlib', 'pydantic', 'numba', 'llvmlite'}"
    code = f"import sys, {package}; print(*sorted({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
    assert done.stdout.strip() == ""
