"""All ways to run a scene, by name."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import mjcf
import newton_euler
import urdf
from mjcf.rigid import RigidMuJoCo
from newton_euler.equations.relative import Relative
from newton_euler.integrators.options import Options
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.runs.simulate import run

SIMULATIONS: dict[str, Callable[[Scene], Trajectory]] = {
    "relative": newton_euler.simulate,
    "cartesian": partial(newton_euler.simulate, formulation="cartesian"),
    "relative in floats": lambda scene: run(Relative(scene), "newton_euler", Options(), {}),
    "pinocchio": urdf.simulate,
    "mujoco_rigid": lambda scene: run(RigidMuJoCo(scene), "mujoco_rigid", Options(), {}),
    "mujoco": mjcf.simulate,
}
