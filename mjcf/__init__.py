"""MuJoCo as a simulation engine for scenes, and import and export of MJCF files.

A scene is a mechanism with its forces, control laws and initial state, as newton_euler defines it. `simulate`
runs a scene by MuJoCo's time stepping. `write` writes a scene as MJCF. `read` imports an MJCF file as a scene
with an import report. `mjcf.rigid` solves MuJoCo's equations of motion with rigid constraints, `mjcf.soft`
with MuJoCo's own soft constraints. MuJoCo is imported at its first use. Start reading at `write` and
`reader`.
"""

from typing import TYPE_CHECKING, Any

from mjcf.errors import MjcfError
from mjcf.simulate import simulate
from mjcf.write import to_xml, write

if TYPE_CHECKING:
    from mjcf.reader import read
else:

    def __getattr__(name: str) -> Any:
        """Import the reader, which needs MuJoCo, at its first use."""
        if name != "read":
            raise AttributeError(f"module 'mjcf' has no attribute {name!r}")
        from mjcf.reader import read

        return read


__all__ = ["MjcfError", "read", "simulate", "to_xml", "write"]
