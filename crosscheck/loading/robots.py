"""Describe the robot of a model of any kind in the terms of its file, for a comparison of two models."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from crosscheck.library.model_files import URDF_IN_MEMORY_OPTIONS, URDF_OPTIONS, name_and_options
from crosscheck.loading.load import is_scene, load_scene
from crosscheck.support.errors import CrosscheckError
from newton_euler.reading.file_shapes import FileShapes
from newton_euler.reading.robot import RobotFile

if TYPE_CHECKING:
    from crosscheck.loading.load import Model


def describe_shapes(model: Model, options: Mapping[str, str]) -> FileShapes:
    """Describe the shapes of a model file, or of a model that MuJoCo has in memory.

    Args:
        model: the model, see `describe_model`.
        options: options of the model, see `describe_model`.

    Raises:
        CrosscheckError: for a scene and a model of Pinocchio.
        NewtonEulerError: for a file that cannot be read.
    """
    import mjcf.errors

    source: Any = os.fspath(model) if isinstance(model, os.PathLike) else model
    name, known = ("a scene", {}) if is_scene(model) else name_and_options(source)
    if is_scene(model) or known is URDF_IN_MEMORY_OPTIONS:
        needed = f"an MJCF or URDF file, or {mjcf.errors.MODELS_IN_MEMORY}"
        raise CrosscheckError(f"shapes of {name} cannot be compared; needed: {needed}")
    if known is URDF_OPTIONS:
        from urdf.file_shapes import file_shapes as of_urdf

        return of_urdf(source)
    from mjcf.file_shapes import file_shapes as of_mjcf

    return of_mjcf(source, **options)


def describe_model(model: Model, options: Mapping[str, str]) -> RobotFile:
    """Describe the robot of a model file, or of a model that MuJoCo or Pinocchio has in memory.

    Args:
        model: path of an MJCF or URDF file, an `MjSpec` or `MjModel`, a `pinocchio.Model`, alone or paired
            with its constraints, or a scene: its name, file or `Scene`.
        options: of a URDF, `loops`, its loop file, and `base`, "fixed" or "free"; of an MJCF file, `root`,
            the folder that holds all files that it refers to; the options of a scene.

    Raises:
        CrosscheckError: for an option that the model does not have.
        NewtonEulerError: for a file that cannot be read.
    """
    if is_scene(model):
        from newton_euler.reading.scene_robot import describe as describe_scene

        scene, _ = load_scene(model, dict(options))
        return describe_scene(scene)
    source: Any = os.fspath(model) if isinstance(model, os.PathLike) else model
    name, known = name_and_options(source)
    is_urdf = known is URDF_OPTIONS
    # options of the model that place its links and name its files
    usable = [option for option in ("loops", "base", "root") if option in known]
    for option in options:
        if option not in usable:
            has = f"; it has {' and '.join(usable)}" if usable else ""
            raise CrosscheckError(f"{name} has no option {option!r} in a comparison of files{has}")
    if is_urdf or known is URDF_IN_MEMORY_OPTIONS:
        from urdf.robot import describe as describe_urdf

        texts: dict[str, Any] = dict(options)
        return describe_urdf(source, **texts)
    from mjcf.robot import describe

    return describe(source, **options)
