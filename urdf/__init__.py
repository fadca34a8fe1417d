"""URDF with loop closures: Mechanism -> URDF and loop file, and its dynamics by Pinocchio."""

from urdf.errors import UrdfError
from urdf.simulate import simulate
from urdf.write import to_loops, to_urdf, write

__all__ = ["UrdfError", "simulate", "to_loops", "to_urdf", "write"]
