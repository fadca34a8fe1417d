"""Free memory: of the machine, and of control groups of both versions around the process."""

from __future__ import annotations

from pathlib import Path

import pytest

from newton_euler.free_memory import DEFAULT_FREE_BYTES, free_memory
from newton_euler.limits import MAX_MEMORY_MB, changed, limit

MACHINE = "MemTotal:  9000 kB\nMemAvailable:    8000 kB\nBuffers: 1 kB\n"


def write(root: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


@pytest.mark.parametrize(
    ("files", "wanted"),
    [
        ({}, DEFAULT_FREE_BYTES),
        ({"proc/meminfo": MACHINE}, 8_192_000),
        (  # the group around the process's own has the limit
            {
                "proc/meminfo": MACHINE,
                "proc/self/cgroup": "0::/jobs/one\n",
                "sys/fs/cgroup/jobs/one/memory.max": "max",
                "sys/fs/cgroup/jobs/one/memory.current": "100",
                "sys/fs/cgroup/jobs/memory.max": "5000000",
                "sys/fs/cgroup/jobs/memory.current": "2000000",
            },
            3_000_000,
        ),
        (  # in a container the path is the host's
            {
                "proc/meminfo": MACHINE,
                "proc/self/cgroup": "5:cpu:/\n4:memory,hugetlb:/of/the/host\n",
                "sys/fs/cgroup/memory/memory.limit_in_bytes": "4000000",
                "sys/fs/cgroup/memory/memory.usage_in_bytes": "4500000",
            },
            0,
        ),
    ],
)
def test_the_tightest_of_machine_and_groups_counts(
    tmp_path: Path, files: dict[str, str], wanted: int
) -> None:
    assert free_memory(write(tmp_path, files)) == wanted


def test_the_limit_is_half_of_what_is_free_unless_it_is_set(monkeypatch: pytest.MonkeyPatch) -> None:
    for free, wanted in ((3_000_000_000, 1500), (10**12, MAX_MEMORY_MB)):
        monkeypatch.setattr("newton_euler.limits.free_memory", lambda free=free: free)
        assert limit("memory") == wanted
    with changed({"memory": 700}):
        assert limit("memory") == 700
