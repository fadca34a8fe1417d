"""The scene library: scenes by name, and scenes from files."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import get_args, get_type_hints

from crosscheck.errors import CrosscheckError
from crosscheck.scenes.tracker import tracker
from newton_euler.scene import Scene

SCENES: dict[str, Callable[..., Scene]] = {"tracker": tracker}
"""Functions that make a scene, by the scene's name. Their arguments are the scene's options."""


def load(name: str, /, **options: str) -> Scene:
    """The scene of that name, or of that scene file (.yaml, .yml or .json).

    Args:
        name: a name out of `SCENES`, or the path of a file.
        options: the scene's own, for example `leg_inertia="aligned"` of the tracker.

    Raises:
        CrosscheckError: for an unknown scene or option, and for a file that cannot be read.
        newton_euler.NewtonEulerError: for a file whose mechanism cannot be.
    """
    if name in SCENES:
        _check_options(name, options)
        return SCENES[name](**options)
    if Path(name).suffix not in (".yaml", ".yml", ".json"):
        raise CrosscheckError(
            f"unknown scene {name!r}; choose from: {', '.join(SCENES)}, or give a .yaml or .json file"
        )
    if options:
        raise CrosscheckError(f"scene file {name!r} takes no options, got {', '.join(options)}")
    from crosscheck.scenes.scene_file import read_scene

    return read_scene(name)


def option_values(name: str) -> dict[str, tuple[str, ...]]:
    """The options of a scene and the values each of them can take, the default first."""
    hints = get_type_hints(SCENES[name])
    return {option: get_args(hints[option]) for option in inspect.signature(SCENES[name]).parameters}


def _check_options(name: str, options: dict[str, str]) -> None:
    valid = option_values(name)
    for option, value in options.items():
        if option not in valid:
            raise CrosscheckError(
                f"unknown option {option!r} of scene {name!r}; choose from: {', '.join(valid)}"
            )
        if value not in valid[option]:
            raise CrosscheckError(
                f"{option} of scene {name!r} is {value!r}; choose from: {', '.join(valid[option])}"
            )
