"""Read mesh files in a process of its own, which may not use much time or memory.

`python load_meshes.py FOLDER BYTES FILE...` gets so much memory and writes the k-th file's vertices and
triangles to FOLDER/k.npz; a file that cannot be read has none. Parsers of mesh formats are large, and what
they are given may be hostile.
"""

from __future__ import annotations

import sys
from contextlib import suppress
from pathlib import Path

MAX_CPU_S = 3
"""s"""


def main() -> None:
    folder, memory, *files = sys.argv[1:]
    with suppress(ImportError):  # not everywhere
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
            triangles = [(row[0], row[1], row[2]) for row in rows]  # they cannot be iterated over
            partial = Path(folder) / "partial.npz"  # the limits may end this process while it writes
            np.savez(partial, vertices=mesh.vertices(), triangles=triangles)
            partial.replace(Path(folder) / f"{number}.npz")


if __name__ == "__main__":
    main()
