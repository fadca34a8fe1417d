"""The scene library: scenes by name, and scenes from files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from crosscheck.errors import CrosscheckError
from crosscheck.scenes.chain import chain
from crosscheck.scenes.four_bar import four_bar
from crosscheck.scenes.options import options_of
from crosscheck.scenes.tracker import tracker
from newton_euler.scene import Scene

SCENES: dict[str, Callable[..., Scene]] = {"tracker": tracker, "four_bar": four_bar, "chain": chain}
"""Functions that make a scene, by the scene's name. Their arguments are the scene's options."""


def load(name: str, /, **options: str | int) -> Scene:
    """The scene of that name, or of that scene file (.yaml, .yml or .json).

    Args:
        name: a name out of `SCENES`, or the path of a file.
        options: the scene's own, for example `leg_inertia="aligned"` of the tracker; whole numbers
            as such or in digits.

    Raises:
        CrosscheckError: for an unknown scene or option, and for a file that cannot be read.
        newton_euler.NewtonEulerError: for a file whose mechanism cannot be.
    """
    if name in SCENES:
        return SCENES[name](**_read(name, options))
    if Path(name).suffix not in (".yaml", ".yml", ".json"):
        raise CrosscheckError(
            f"unknown scene {name!r}; choose from: {', '.join(SCENES)}, or give a .yaml or .json file"
        )
    if options:
        raise CrosscheckError(f"scene file {name!r} takes no options, got {', '.join(options)}")
    from crosscheck.scenes.scene_file import read_scene

    return read_scene(name)


def _read(name: str, given: dict[str, str | int]) -> dict[str, str | int]:
    """The options that a scene takes, as it takes them."""
    known = options_of(SCENES[name])
    options = {}
    for option, value in given.items():
        if option not in known:
            raise CrosscheckError(
                f"unknown option {option!r} of scene {name!r}; choose from: {', '.join(known)}"
            )
        read = known[option].values.read(value)
        if read is None:
            raise CrosscheckError(f"{option} of scene {name!r} is {value!r}; {known[option].values.wanted}")
        options[option] = read
    return options
