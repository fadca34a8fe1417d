"""Free memory for this process: the minimum of what the machine and the Linux control groups (containers)
leave.

`newton_euler.limits` derives the memory limit of processes that read untrusted files from it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path, PurePosixPath

DEFAULT_FREE_BYTES = 2_000_000_000
"""Free memory, bytes, that is assumed on systems other than Linux; most machines have more."""


def free_memory(root: Path = Path("/")) -> int:
    """Compute the bytes of memory that this process can still allocate.

    The result is the minimum of the available memory of the machine and of the memory left in each control
    group of the process.

    Args:
        root: folder that contains `proc` and `sys`; tests pass another folder.
    """
    candidates = [*_machine_bytes(root / "proc" / "meminfo"), *_control_group_bytes(root)]
    return max(0, min(candidates, default=DEFAULT_FREE_BYTES))


def _machine_bytes(file: Path) -> Iterator[int]:
    """Yield the available memory of the machine, bytes, from a line such as `MemAvailable:  123 kB` in
    `meminfo`.

    Nothing is yielded if the file does not exist.
    """
    with suppress(OSError, ValueError):
        for line in file.read_text().splitlines():
            name, _, amount = line.partition(":")
            if name == "MemAvailable":
                yield 1024 * int(amount.split()[0])


def _control_group_bytes(root: Path) -> Iterator[int]:
    """Yield the memory left in each control group of this process, bytes: the limit of the group minus its
    usage.

    Lines of `/proc/self/cgroup` are ID:CONTROLLERS:PATH. The list of controllers is empty for version 2 of
    control groups, and contains `memory` for version 1. In a container, PATH may not exist below
    `/sys/fs/cgroup`; the group at the root of that folder is then the group of the container.
    """
    lines: list[str] = []
    with suppress(OSError):
        lines = (root / "proc" / "self" / "cgroup").read_text().splitlines()
    mount = root / "sys" / "fs" / "cgroup"
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if controllers == "":  # version 2
            folder, limit_file, usage_file = mount, "memory.max", "memory.current"
        elif "memory" in controllers.split(","):  # version 1
            folder = mount / "memory"
            limit_file, usage_file = "memory.limit_in_bytes", "memory.usage_in_bytes"
        else:
            continue
        process_group = PurePosixPath(path.lstrip("/"))
        for group in (process_group, *process_group.parents):
            with suppress(OSError, ValueError):  # no such group, or the word "max" for no limit
                limit = int((folder / group / limit_file).read_text())
                yield limit - int((folder / group / usage_file).read_text())
