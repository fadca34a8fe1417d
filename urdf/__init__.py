"""URDF with loop closures: Mechanism -> URDF and loop file, and its dynamics by Pinocchio."""

from typing import TYPE_CHECKING, Any

from urdf.errors import UrdfError
from urdf.simulate import simulate
from urdf.write import to_loops, to_urdf, write

if TYPE_CHECKING:
    from urdf.reader import read
else:

    def __getattr__(name: str) -> Any:
        """Import the reader when it is asked for: it needs Pinocchio."""
        if name != "read":
            raise AttributeError(f"module 'urdf' has no attribute {name!r}")
        from urdf.reader import read

        return read


__all__ = ["UrdfError", "read", "simulate", "to_loops", "to_urdf", "write"]
