"""Mass matrix and force of the equations of motion, as each engine works them out itself."""

from __future__ import annotations

from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.relative import Relative
from newton_euler.equations.system import System
from newton_euler.scalars import Array


def mass_and_force(system: System, q: Array, v: Array) -> tuple[Array, Array]:
    """M and f of M vdot = f + reactions, f with gravity, velocity terms and all that acts on purpose.

    (nv, nv) and (nv,) for coordinates of a tree; (6 n, 7 n) and (6 n,) for the Cartesian form of n moving
    bodies, whose rows are forces in the world and torques in the body.
    """
    if isinstance(system, Relative):
        return system.mass_and_force(q, v)
    if isinstance(system, Cartesian):
        rows = 6 * len(system.bodies)
        matrix, right = system.equation_21(q, v)
        return matrix[:rows, : system.nv], right[:rows]
    if system.name == "mujoco_rigid":
        from mjcf import inspect as mjcf

        return mjcf.mass_and_force(system, q, v)  # type: ignore[arg-type]
    from urdf import inspect as urdf

    return urdf.mass_and_force(system, q, v)  # type: ignore[arg-type]
