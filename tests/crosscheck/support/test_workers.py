"""Processes that a command starts: none outlives it, however it ends, or imports from the current folder."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from importlib.metadata import version
from pathlib import Path

import pytest

from crosscheck.support.processes import run_in_processes
from crosscheck.sweeps.execute import workers

PATIENCE = 60.0
"""s that processes may take to start and to end: half a second each, unless others have the processors."""

PARENT, TRACKER, WORKERS = 1, 1, 2
"""Processes of a command: itself, the one that multiprocessing keeps, those that work."""


def session(leader: int) -> list[int]:
    """Numbers of the processes of a session that have not ended, as /proc has them (man 5 proc)."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                state, _, _, number = (entry / "stat").read_text().rpartition(")")[2].split()[:4]
            except OSError:  # it has ended meanwhile
                continue
            if int(number) == leader and state != "Z":
                found.append(int(entry.name))
    return found


def wait_until(condition, seconds: float) -> bool:
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.02)
    return True


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="no /proc to count processes in")
@pytest.mark.parametrize(
    ("command", "number"),
    [("run --all", signal.SIGTERM), ("stress --ci", signal.SIGINT), ("run --all", signal.SIGKILL)],
)
def test_no_process_outlives_its_command(tmp_path, command, number):
    process = subprocess.Popen(
        [sys.executable, "-m", "crosscheck", *command.split(), "--output", "out"],
        cwd=tmp_path,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        all_of_it = PARENT + TRACKER + min(WORKERS, os.cpu_count() or 1)
        assert wait_until(lambda: len(session(process.pid)) >= all_of_it, PATIENCE)
        time.sleep(0.5)  # they are at work
        process.send_signal(number)
        assert wait_until(lambda: process.poll() is not None and not session(process.pid), PATIENCE)
    finally:
        for left in session(process.pid):
            os.kill(left, signal.SIGKILL)
    _, complaint = process.communicate()
    if number != signal.SIGKILL:
        assert (process.returncode, complaint) == (130, "crosscheck: error: interrupted\n")
        assert not [path for path in (tmp_path / "out").rglob("*") if path.name.startswith(".")]


IN_THE_WAY = ("socket", "signal", "selectors", "random", "json", "numpy", "click", "rerun_cli")
"""Modules that children import, of Python and of others."""


@pytest.fixture
def foreign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, with modules that leave a file when they are imported; the path of that file."""
    for name in IN_THE_WAY:
        (tmp_path / f"{name}.py").write_text("from pathlib import Path\nPath('imported').touch()\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    return tmp_path / "imported"


def test_processes_of_a_pool_import_nothing_from_the_current_folder(foreign: Path) -> None:
    assert run_in_processes(abs, [-3], 1, lambda *_: None) == [3]
    assert "PYTHONSAFEPATH" not in os.environ
    assert not foreign.exists()


def test_an_executor_of_a_sweep_imports_nothing_from_the_current_folder(foreign: Path) -> None:
    with (
        ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as executor,
        workers(executor=executor) as at,
    ):
        assert at.executor.submit(abs, -3).result() == 3
    assert not foreign.exists()


def test_the_module_imports_nothing_from_the_current_folder(foreign: Path) -> None:
    command = [sys.executable, "-m", "crosscheck", "--version"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert version("crosscheck-dynamics") in done.stdout
    assert not foreign.exists()


def test_every_python_process_is_started_without_the_current_folder() -> None:
    started = [
        line
        for package in ("crosscheck", "mjcf", "newton_euler", "urdf")
        for path in Path(__file__).parents[3].glob(f"{package}/**/*.py")
        for line in path.read_text().splitlines()
        if "[sys.executable" in line
    ]
    assert len(started) >= 5
    assert [line for line in started if '[sys.executable, "-P", ' not in line] == []
