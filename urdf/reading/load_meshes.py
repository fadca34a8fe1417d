"""Read mesh files in a separate process with limits of time and memory.

Usage: `python load_meshes.py FOLDER BYTES FILE...`. The memory of the process is limited to BYTES. The
vertices and triangles of file k = 0, 1, ... are written to FOLDER/k.npz; a file that cannot be read has no
output. The limits are needed because parsers of mesh formats are large, and a file may be hostile.
"""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path

MAX_CPU_S = 3
"""Limit of the CPU time of the process, s, for all files together."""


def main() -> None:
    """Read the mesh files that the command line names, and write their vertices and triangles."""
    folder, memory, *files = sys.argv[1:]
    with suppress(ImportError):  # Windows has no limits of resources
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (MAX_CPU_S, MAX_CPU_S))
        resource.setrlimit(resource.RLIMIT_DATA, (int(memory), int(memory)))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    import coal
    import numpy as np

    loader = coal.MeshLoader(coal.NODE_TYPE.BV_AABB)
    for number, file in enumerate(files):
        with suppress(ValueError, RuntimeError, MemoryError):
            mesh = loader.load(file, np.ones(3))
            rows = (mesh.tri_indices(k) for k in range(mesh.num_tris))
            triangles = [(row[0], row[1], row[2]) for row in rows]  # coal's triangles are not iterable
            partial = Path(folder) / "partial.npz"  # a limit may end the process during writing
            np.savez(partial, vertices=mesh.vertices(), triangles=triangles)
            partial.replace(Path(folder) / f"{number}.npz")


if __name__ == "__main__":
    main()
