"""Compile an MJCF file in a process of its own, which may not use much time or memory.

`python compile.py FILE RESULT SECONDS BYTES` writes the compiled model to RESULT (.mjb), or one line on
standard error and exits with status 1; after so many seconds of processor time it is killed, and it gets so
much memory. MuJoCo's compiler expands macros without limit, and what it is given may be hostile.
"""

from __future__ import annotations

import sys
from contextlib import suppress
from typing import Any

ARENA = 50_000_000
"""Bytes that MuJoCo sets aside for constraints."""


def compile_spec(spec: Any) -> Any:
    """Compile an `MjSpec`, whose memory is set, to an `MjModel`."""
    spec.memory = ARENA  # room for contacts, which are not looked at
    spec.njmax = spec.nconmax = spec.nstack = -1
    return spec.compile()


def main() -> int:
    """Compile; the exit status."""
    path, result, seconds, memory = sys.argv[1:]
    with suppress(ImportError):  # not everywhere
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
