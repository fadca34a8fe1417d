"""`crosscheck regress` is quiet while nothing changes, also under load, and notices small breaks."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

import pytest
from mistakes import BREAKS
from test_mutations import copy_source

SCENES = ("pendulum", "free_top")
"""Quick ones; one has constraints and gravity, the other turns about all axes."""

RUNS = 10


def regress(folder, *arguments):
    # the copy comes first on the path, before an installed project
    environment = os.environ | {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "crosscheck", "regress", *arguments]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory):
    """A copy of the source with baselines made from it."""
    folder = copy_source(tmp_path_factory.mktemp("unbroken") / "project")
    done = regress(folder, *SCENES, "--update", "test")
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("broken", BREAKS)
def test_a_break_is_noticed(tmp_path, unbroken, broken):
    source, right, wrong, scene = BREAKS[broken]
    folder = tmp_path / "project"
    shutil.copytree(unbroken, folder)
    text = (folder / source).read_text()
    assert text.count(right) == 1, "the line to break has changed"
    (folder / source).write_text(text.replace(right, wrong))
    done = regress(folder, scene)
    assert done.returncode == 1, done.stdout + done.stderr
    assert f"{scene}: MOVED" in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("busy", [0, 2 * (os.cpu_count() or 1)])
def test_repeated_runs_are_quiet(unbroken, busy):
    load = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(busy)]
    try:
        for _ in range(RUNS):
            done = regress(unbroken, *SCENES)
            assert done.returncode == 0, done.stdout + done.stderr
    finally:
        for process in load:
            process.kill()
            process.wait()


@pytest.mark.slow
def test_the_library_is_as_its_baselines_say(tmp_path):
    done = regress(copy_source(tmp_path / "project"))
    assert done.returncode == 0, done.stdout + done.stderr
