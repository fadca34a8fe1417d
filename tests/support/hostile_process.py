"""The process of `hostile_server`, and what one of its command lines may take."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

PROCESSOR_TIME = 5.0
"""s of a command with its imports, on one core; wall time would count what else the machine does."""

MEMORY = 1_000_000_000
"""Bytes, of the largest process of a command."""

LONGEST_LINE = 2000
"""Characters: two names of files, a message of at most 1000, and what is escaped in it."""


class Server:
    """A process of `hostile_server`."""

    def __init__(self) -> None:
        root = str(Path(__file__).parents[2])
        self._process = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("hostile_server.py"))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONPATH": root},
        )
        self._imports = self._line()["processor_time"]

    def _line(self) -> dict[str, Any]:
        assert self._process.stdout
        return json.loads(self._process.stdout.readline())

    def run(self, folder: Path, arguments: list[str]) -> dict[str, Any]:
        """Status, memory and processor time of a command line in a folder, the latter with its imports."""
        assert self._process.stdin
        print(
            json.dumps({"folder": str(folder), "arguments": arguments}), file=self._process.stdin, flush=True
        )
        outcome = self._line()
        outcome["processor_time"] += self._imports
        return outcome

    def close(self) -> None:
        assert self._process.stdin
        self._process.stdin.close()
        self._process.wait(timeout=60)
