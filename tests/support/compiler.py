"""MuJoCo's compiler for the tests' own process, in forks of one that has imported it.

`mjcf.reading.source` starts a process for each file, and imports take nearly all of its 0.3 s. Command lines
in processes of their own, those of `hostile_server` among them, compile as everybody does.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any


class Compiler:
    """In place of `subprocess` in `mjcf.reading.source`, for `python -P compile.py FILE RESULT SECONDS`."""

    TimeoutExpired = subprocess.TimeoutExpired
    DEVNULL, PIPE = subprocess.DEVNULL, subprocess.PIPE

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None

    def run(self, command: list[str], cwd: str, **streams: Any) -> subprocess.CompletedProcess[bytes]:
        if self._process is None:
            server = [sys.executable, __file__, command[2]]
            self._process = subprocess.Popen(server, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self._process.stdin
        assert self._process.stdout
        complaints = Path(cwd) / "complaints"
        print(json.dumps([cwd, str(complaints), *command[2:]]), file=self._process.stdin, flush=True)
        status = int(self._process.stdout.readline())
        return subprocess.CompletedProcess(command, status, stderr=complaints.read_bytes())

    def close(self) -> None:
        if self._process is not None:
            self._process.communicate()


def serve(script: str) -> None:
    """Answer each line of folder, file for standard error and command with the exit status of a fork."""
    sys.path.insert(0, str(Path(script).parent))
    import compile as compiler
    import mujoco  # noqa: F401

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal's, which ends the tests and with them this
    for line in sys.stdin:
        folder, complaints, *command = json.loads(line)
        pid = os.fork()
        if pid == 0:
            signal.signal(signal.SIGINT, signal.default_int_handler)
            os.chdir(folder)
            os.dup2(os.open(complaints, os.O_WRONLY | os.O_CREAT), 2)
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            sys.argv = command
            status = 1
            try:
                status = compiler.main()
                sys.stderr.flush()
            finally:
                os._exit(status)
        print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), flush=True)


if __name__ == "__main__":
    serve(sys.argv[1])
