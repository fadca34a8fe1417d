"""Models, whatever they are, with the options that commands give them."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, TypeAlias

from crosscheck.library import load
from crosscheck.loading.model_files import is_model, read_model
from crosscheck.loading.size import check_scene
from crosscheck.support.errors import CrosscheckError
from newton_euler.model.scene import Scene
from newton_euler.reading.import_report import ImportReport

if TYPE_CHECKING:
    from mjcf.reader import MujocoModel
    from urdf.reading.given import PinocchioModel

    Model: TypeAlias = str | os.PathLike[str] | Scene | MujocoModel | PinocchioModel

EXCITED = {"excitation": "on"}
"""Options of models of other tools that crosschecks take by default."""


def told_options(options: Mapping[str, str]) -> dict[str, str]:
    """Return the options that a title names: all but those that crosschecks take by default."""
    return {name: value for name, value in options.items() if EXCITED.get(name) != value}


def is_own(model: Model) -> bool:
    """Return True for scenes: those of the library by name, scene files, and a `Scene`."""
    return isinstance(model, Scene) or (
        isinstance(model, str | os.PathLike) and not is_model(os.fspath(model))
    )


def excited(model: Model, options: dict[str, str]) -> dict[str, str]:
    """Return the options with which models of other tools are excited unless the options say otherwise."""
    return options if is_own(model) else EXCITED | options


def load_scene(
    model: Model, options: dict[str, str], verified: bool = True
) -> tuple[Scene, ImportReport | None]:
    """Load a scene, with what became of the elements of a model of another tool.

    Args:
        model: a scene of the library by name, a scene file, an MJCF, a URDF, a `Scene`, or a model that
            MuJoCo or Pinocchio has in memory.
        options: of the scene, the file or the model.
        verified: whether to verify what was read; if not, what it is verified against comes with it.

    Raises:
        CrosscheckError, NewtonEulerError: for a name, a file, a model or an option that cannot be read, and
            for models that are too large.
    """
    if isinstance(model, Scene):
        if options:
            raise CrosscheckError(f"options are of names and files, not of a Scene: {', '.join(options)}")
        check_scene(model)
        return model, None
    source = os.fspath(model) if isinstance(model, str | os.PathLike) else ""
    if not is_own(model):
        scene, report = read_model(source or model, options, verified)
        check_scene(scene, source)
        return scene, report
    scene = load(source, **options)
    check_scene(scene)
    return scene, None
