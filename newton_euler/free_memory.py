"""Memory that a process may still take: what the machine and the control groups of Linux leave."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path, PurePosixPath

UNKNOWN = 2_000_000_000
"""Bytes where the system does not tell, as on systems other than Linux: what most machines have."""


def free_memory(root: Path = Path("/")) -> int:
    """Compute the bytes of memory that this process may still take.

    The least of what the machine has available and of what each control group around the process leaves.

    Args:
        root: folder with `proc` and `sys`, another one in tests.
    """
    found = [*_of_machine(root / "proc" / "meminfo"), *_of_groups(root)]
    return max(0, min(found, default=UNKNOWN))


def _of_machine(file: Path) -> Iterator[int]:
    """Yield the machine's available bytes, from a line such as `MemAvailable:  123 kB`."""
    with suppress(OSError, ValueError):
        for line in file.read_text().splitlines():
            name, _, amount = line.partition(":")
            if name == "MemAvailable":
                yield 1024 * int(amount.split()[0])


def _of_groups(root: Path) -> Iterator[int]:
    """Yield what each control group leaves: its limit less its use.

    Groups of version 2 have an empty list of controllers in `/proc/self/cgroup`, those of version 1 the
    controller `memory`. In a container the path may be that of the host, whose group is then the root's.
    """
    lines: list[str] = []
    with suppress(OSError):
        lines = (root / "proc" / "self" / "cgroup").read_text().splitlines()
    mount = root / "sys" / "fs" / "cgroup"
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if controllers == "":
            files = mount, "memory.max", "memory.current"
        elif "memory" in controllers.split(","):
            files = mount / "memory", "memory.limit_in_bytes", "memory.usage_in_bytes"
        else:
            continue
        folder, most, used = files
        own = PurePosixPath(path.lstrip("/"))
        for group in (own, *own.parents):
            with suppress(OSError, ValueError):  # `max` is no limit
                yield int((folder / group / most).read_text()) - int((folder / group / used).read_text())
