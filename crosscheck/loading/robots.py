"""Describe the robot of a model of any kind in the terms of its file, for a comparison of two models."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, cast

from crosscheck.library.model_files import is_urdf_file
from crosscheck.loading.load import is_scene, load_scene
from crosscheck.support.errors import CrosscheckError
from newton_euler.reading.robot import RobotFile

if TYPE_CHECKING:
    from crosscheck.loading.load import Model


def describe_model(model: Model, options: Mapping[str, str]) -> RobotFile:
    """Describe the robot of a model file, or of a model that MuJoCo or Pinocchio has in memory.

    Args:
        model: path of an MJCF or URDF file, an `MjSpec` or `MjModel`, a `pinocchio.Model`, alone or paired
            with its constraints, or a scene: its name, file or `Scene`.
        options: `loops`, the loop file of a URDF; the options of a scene.

    Raises:
        CrosscheckError: for an option that the model does not have.
        NewtonEulerError: for a file that cannot be read.
    """
    if is_scene(model):
        from newton_euler.reading.scene_robot import describe as describe_scene

        scene, _ = load_scene(model, dict(options))
        return describe_scene(scene)
    of_mujoco = type(model).__module__.startswith("mujoco")
    if of_mujoco or (isinstance(model, str | os.PathLike) and not is_urdf_file(os.fspath(model))):
        if options:
            raise CrosscheckError(f"an MJCF has no option {next(iter(options))!r} in a comparison of files")
        from mjcf.robot import describe

        return describe(cast("Any", model))
    from urdf.robot import describe as describe_urdf

    return describe_urdf(cast("Any", model), **options)
