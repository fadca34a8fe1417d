"""Joints as each engine's own model has them at the initial pose."""

from __future__ import annotations

from newton_euler.equations.system import System
from newton_euler.model.joint_geometry import JointGeometry, stated


def joint_geometry(system: System) -> dict[str, JointGeometry]:
    """The joints of a system's model, by name; those of its own for bodies that only rods hold left out."""
    match system.name:
        case "mujoco_rigid":
            from mjcf import inspect as mjcf

            return mjcf.joint_geometry(system)  # type: ignore[arg-type]
        case "pinocchio":
            from urdf import inspect as urdf

            return urdf.joint_geometry(system)  # type: ignore[arg-type]
    return stated(system.mechanism)  # both formulations have the mechanism's own joints
