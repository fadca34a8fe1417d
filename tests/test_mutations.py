"""The tests notice mistakes: each is made on purpose in a copy of the source, and a test must fail."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from mistakes import BREAKS, MISTAKES

ROOT = Path(__file__).parents[1]
PINNED = MISTAKES | BREAKS
PACKAGES = ("newton_euler", "mjcf", "urdf", "crosscheck")


def copy_source(folder):
    for name in (*PACKAGES, "tests", "examples", "docs"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", folder)
    return folder


def run_tests(folder, *tests):
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider"]
    command += [f"tests/{each}" for each in tests]
    # the copy comes first on the path, before an installed project
    environment = os.environ | {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


@pytest.mark.parametrize(("source", "right", "wrong", "_"), PINNED.values(), ids=PINNED)
def test_a_pinned_line_stands_in_the_source_once(source, right, wrong, _):
    text = (ROOT / source).read_text()
    assert text.count(right) == 1, "the source has changed: pin its new line"
    assert text.replace(right, wrong) != text


@pytest.mark.parametrize("tests", sorted({mistake[3] for mistake in MISTAKES.values()}))
def test_the_tests_of_a_mistake_exist(tests):
    path, _, name = tests.partition("::")
    source = ROOT / "tests" / path
    assert source.exists()
    assert not name or f"def {name.partition('[')[0]}(" in source.read_text()


@pytest.mark.slow
@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_noticed(tmp_path, mistake):
    source, right, wrong, tests = MISTAKES[mistake]
    folder = copy_source(tmp_path / "project")
    text = (folder / source).read_text()
    assert text.count(right) == 1, "the line to break has changed"
    (folder / source).write_text(text.replace(right, wrong))
    done = run_tests(folder, tests)
    assert done.returncode == 1 or done.returncode < 0, done.stdout[-2000:]  # failed, or broke down


@pytest.mark.slow
def test_the_copy_passes_when_nothing_is_broken(tmp_path):
    done = run_tests(
        copy_source(tmp_path / "project"), *sorted({mistake[3] for mistake in MISTAKES.values()})
    )
    assert done.returncode == 0, done.stdout[-2000:]
