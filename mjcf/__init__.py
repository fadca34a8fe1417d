"""Scenes as MJCF, and MuJoCo as an engine for them. MuJoCo is imported only when it has to run."""

from typing import TYPE_CHECKING, Any

from mjcf.errors import MjcfError
from mjcf.simulate import simulate
from mjcf.write import to_xml, write

if TYPE_CHECKING:
    from mjcf.reader import read
else:

    def __getattr__(name: str) -> Any:
        """Import the reader when it is asked for: it needs MuJoCo."""
        if name != "read":
            raise AttributeError(f"module 'mjcf' has no attribute {name!r}")
        from mjcf.reader import read

        return read


__all__ = ["MjcfError", "read", "simulate", "to_xml", "write"]
