"""Processes that a command starts: none outlives it, however it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

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
        assert (process.returncode, complaint) == (2, "crosscheck: error: interrupted\n")
        assert not [path for path in (tmp_path / "out").rglob("*") if path.name.startswith(".")]
