"""`load_scene`: load a library scene, a scene file, a model file or a model in memory as a `Scene`.

A scene is a mechanism with its forces, inputs, initial state and duration. A library scene is built in Python
by a module of `crosscheck.library`, a scene file describes one in YAML or JSON. A model file is an MJCF or a
URDF.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from crosscheck.library import load
from crosscheck.library.model_files import is_model_file, read_model
from crosscheck.library.size import check_scene
from crosscheck.support.errors import CrosscheckError
from newton_euler.errors import items_of
from newton_euler.model.scene import Scene
from newton_euler.reading.import_report import ImportReport
from newton_euler.scalars import Floats

if TYPE_CHECKING:
    from mjcf.reader import MjcfInMemory
    from urdf.reading.given import UrdfInMemory

    Model: TypeAlias = str | os.PathLike[str] | Scene | MjcfInMemory | UrdfInMemory

DEFAULT_OPTIONS = {"excitation": "on"}
"""Options by which the excitation of MJCF, URDF and in-memory models is on by default.

Most models are at rest at their start. The excitation drives their actuators and gives their joints a start
velocity, so that a run tests more than equilibrium.
"""


OptionValue: TypeAlias = str | float | Sequence[float] | Floats | Mapping[str, str | float]
"""Value of an option in Python."""


def option_texts(options: Mapping[str, OptionValue]) -> dict[str, str]:
    """Return options as texts by name, as on the command line.

    Numbers have all digits and are separated by commas. A mapping is YAML in braces.
    """

    def text(value: OptionValue) -> str:
        if isinstance(value, Mapping):
            return str(dict(value))
        numbers = items_of(value)
        return str(value) if numbers is None else ",".join(map(str, np.asarray(numbers).tolist()))

    return {name: text(value) for name, value in options.items()}


def non_default_options(options: Mapping[str, str]) -> dict[str, str]:
    """Return the options that differ from `DEFAULT_OPTIONS`, for a title or a command line."""
    return {name: value for name, value in options.items() if DEFAULT_OPTIONS.get(name) != value}


def is_scene(model: Model) -> bool:
    """Return True for a `Scene`, a name of a library scene or a path of a scene file; False for a model of
    another tool (MJCF, URDF, or in memory)."""
    return isinstance(model, Scene) or (
        isinstance(model, str | os.PathLike) and not is_model_file(os.fspath(model))
    )


def with_excitation(model: Model, options: dict[str, str]) -> dict[str, str]:
    """Return options that excite a model of another tool, unless its `excitation` option is given."""
    return options if is_scene(model) else DEFAULT_OPTIONS | options


def load_scene(
    model: Model, options: dict[str, str], verified: bool = True
) -> tuple[Scene, ImportReport | None]:
    """Load a scene, and check its size.

    Args:
        model: name of a library scene, path of a scene file, an MJCF or a URDF, a `Scene`, or a model that
            MuJoCo or Pinocchio has in memory.
        options: options of the scene, the file or the model, by name.
        verified: whether to compare the scene with the model as MuJoCo or Pinocchio compiles it. If False,
            the report has the compiled models as `references`, for a later comparison.

    Returns:
        The scene, and the import report, which tells how every element of the model was imported; None in
        place of a report for a scene of crosscheck's own.

    Raises:
        CrosscheckError, NewtonEulerError: for a name, a file, a model or an option that cannot be read, and
            for models that are too large.
    """
    if isinstance(model, Scene):
        if options:
            raise CrosscheckError(f"options are of names and files, not of a Scene: {', '.join(options)}")
        check_scene(model)
        return model, None
    source = os.fspath(model) if isinstance(model, str | os.PathLike) else ""  # "" for a model in memory
    if not is_scene(model):
        scene, report = read_model(source or model, options, verified)
        check_scene(scene, source)
        return scene, report
    scene = load(source, **options)
    check_scene(scene)
    return scene, None
