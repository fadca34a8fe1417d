"""Scenes as MJCF, and MuJoCo as an engine for them. MuJoCo is imported only when it has to run."""

from mjcf.errors import MjcfError
from mjcf.simulate import simulate
from mjcf.write import to_xml, write

__all__ = ["MjcfError", "simulate", "to_xml", "write"]
