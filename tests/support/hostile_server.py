"""Command lines run one after the other, each in a process of its own that need not import anything.

Reads requests from standard input, a line of JSON each, and answers each with a line: see `Outcome` in
`test_hostile`. `python hostile_server.py` says in its first line what the imports cost.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time

import mujoco  # noqa: F401
import pinocchio  # noqa: F401
import scipy.integrate  # noqa: F401

from crosscheck.cli import main
from crosscheck.compare import crosscheck  # noqa: F401
from crosscheck.engines import registry  # noqa: F401
from crosscheck.library import scene_file  # noqa: F401

WALL_TIME = 300.0
"""s, after which a command hangs; other processes may take most of the machine."""


def child(folder: str, arguments: list[str]) -> None:
    """Run a command line in a folder; its output goes into files beside that."""
    os.setsid()
    os.chdir(folder)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    for number, stream in ((1, "stdout"), (2, "stderr")):
        os.dup2(os.open(f"{folder}.{stream}", os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
    sys.stdout, sys.stderr = (os.fdopen(k, "w", encoding="utf-8", closefd=False) for k in (1, 2))
    status = 99
    try:
        main(arguments)
    except SystemExit as finished:
        status = int(finished.code or 0)
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def answer(folder: str, arguments: list[str]) -> dict[str, float | int | bool]:
    start = time.perf_counter()
    pid = os.fork()
    if pid == 0:
        child(folder, arguments)
    hangs = False
    while True:
        done, status, usage = os.wait4(pid, os.WNOHANG)
        if done:
            break
        time.sleep(0.005)
        if time.perf_counter() - start > WALL_TIME:
            os.killpg(pid, signal.SIGKILL)
            hangs = True
    return {
        "status": os.waitstatus_to_exitcode(status),
        "hangs": hangs,
        "processor_time": usage.ru_utime + usage.ru_stime,
        "memory": usage.ru_maxrss * 1024,
    }


if __name__ == "__main__":
    print(json.dumps({"processor_time": time.process_time()}), flush=True)
    for line in sys.stdin:
        print(json.dumps(answer(**json.loads(line))), flush=True)
