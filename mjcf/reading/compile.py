"""Compile an MJCF file in a separate process with limits of time and memory.

Usage: `python compile.py FILE RESULT SECONDS BYTES`. The process writes the compiled model to RESULT (.mjb).
On an error it prints one line on standard error and exits with status 1. The operating system ends the
process after SECONDS of CPU time, and limits its memory to BYTES. The limits are needed because MuJoCo's
compiler expands elements such as `replicate` without limit, and a file may be hostile.
"""

from __future__ import annotations

import sys
from contextlib import suppress
from typing import Any

ARENA_BYTES = 50_000_000
"""Memory that MuJoCo reserves for contacts and constraints, bytes."""


def compile_spec(spec: Any) -> Any:
    """Compile an `MjSpec` to an `MjModel` with a small arena, MuJoCo's memory for contacts and constraints.

    The reader simulates no contacts, which need most of the arena.
    """
    spec.memory = ARENA_BYTES
    spec.njmax = spec.nconmax = spec.nstack = -1  # -1 means not set; a file may set large values
    return spec.compile()


def main() -> int:
    """Compile the file that the command line names; return the exit status."""
    path, result, seconds, memory = sys.argv[1:]
    with suppress(ImportError):  # Windows has no limits of resources
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds)))
        resource.setrlimit(resource.RLIMIT_DATA, (int(memory), int(memory)))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    import mujoco

    mujoco.set_mju_user_warning(lambda message: None)
    try:
        model = compile_spec(mujoco.MjSpec.from_file(path))
        mujoco.mj_saveModel(model, result, None)
    except (ValueError, MemoryError, RuntimeError, mujoco.FatalError) as error:
        print(" ".join(str(error).split()) or type(error).__name__, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
