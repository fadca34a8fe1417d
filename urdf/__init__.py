"""Pinocchio as a simulation engine for scenes, and import and export of URDF files.

A scene is a mechanism with its forces, control laws and initial state, as newton_euler defines it. A URDF
cannot describe closed loops; they are in a second file, the loop file (`urdf.loops`). `simulate` runs a scene
with Pinocchio's accelerations. `write` writes a scene as URDF and loop file. `read` imports a URDF or a
Pinocchio model as a scene with an import report. `urdf.dynamics` has the equations of motion. Pinocchio is
imported at its first use. Start reading at `write`, `model` and `reader`.
"""

from typing import TYPE_CHECKING, Any

from urdf.errors import UrdfError
from urdf.simulate import simulate
from urdf.write import to_loops, to_urdf, write

if TYPE_CHECKING:
    from urdf.reader import read
else:

    def __getattr__(name: str) -> Any:
        """Import the reader, which needs Pinocchio, at its first use."""
        if name != "read":
            raise AttributeError(f"module 'urdf' has no attribute {name!r}")
        from urdf.reader import read

        return read


__all__ = ["UrdfError", "read", "simulate", "to_loops", "to_urdf", "write"]
