"""Load scenes: a mechanism with its forces, controllers, initial state and duration.

`load` takes the name of a scene of the library, a scene file (YAML or JSON), or a model file (MJCF or URDF).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from crosscheck.library import (
    andrews,
    bricard,
    chain,
    excavator,
    flyball_governor,
    four_bar,
    free_top,
    heavy_top,
    pendulum,
    slider_crank,
    stewart,
    tracker,
    tracker_control,
    tracker_drive,
    tracker_sun,
    tracker_wind,
)
from crosscheck.library.measure import Quantities
from crosscheck.library.model_files import CONVERSION_ADVICE, is_model_file, read_model
from crosscheck.library.options import OnlyWith, Option, options_of
from crosscheck.support.errors import CrosscheckError
from newton_euler.arguments import checked
from newton_euler.errors import choices, listed, quoted
from newton_euler.model.scene import Scene

SCENES: dict[str, Callable[..., Scene]] = {
    "tracker": tracker.tracker,
    "tracker_gravity": tracker.tracker_gravity,
    "tracker_aligned": tracker.tracker_aligned,
    "tracker_on_boat": tracker.tracker_on_boat,
    "tracker_wind": tracker_wind.tracker_wind,
    "tracker_drive": tracker_drive.tracker_drive,
    "tracker_computed_torque": tracker_control.tracker_computed_torque,
    "tracker_sun_day": tracker_sun.tracker_sun_day,
    "pendulum": pendulum.pendulum,
    "free_top": free_top.free_top,
    "heavy_top": heavy_top.heavy_top,
    "four_bar": four_bar.four_bar,
    "andrews": andrews.andrews,
    "slider_crank": slider_crank.slider_crank,
    "bricard": bricard.bricard,
    "flyball_governor": flyball_governor.flyball_governor,
    "stewart": stewart.stewart,
    "chain": chain.chain,
    "excavator": excavator.excavator,
}
"""Functions that make the scenes of the library, by name. Their arguments are the options of the scene."""

SUN_TRACKER = "tracker_sun"
"""Name of the tracker of `crosscheck sun`, `year` and `list`, see `load_sun_tracker`."""

LOAD_CASES: dict[str, Mapping[str, Mapping[str, str]]] = {"tracker_wind": tracker_wind.LOAD_CASES}
"""Load cases that `crosscheck loads` runs by default: options by the names of the scene and the case."""

REFERENCE_QUANTITIES: dict[str, Quantities] = {
    "pendulum": pendulum.REFERENCE_QUANTITIES,
    "free_top": free_top.REFERENCE_QUANTITIES,
    "heavy_top": heavy_top.REFERENCE_QUANTITIES,
    "four_bar": four_bar.REFERENCE_QUANTITIES,
    "andrews": andrews.REFERENCE_QUANTITIES,
    "slider_crank": slider_crank.REFERENCE_QUANTITIES,
    "bricard": bricard.REFERENCE_QUANTITIES,
    "flyball_governor": flyball_governor.REFERENCE_QUANTITIES,
    "stewart": stewart.REFERENCE_QUANTITIES,
}
"""Functions that measure quantities of a run for which reference values exist, by scene and quantity.

The reference values are in `crosscheck.library.references`; they do not come from simulations of the scene.
"""


@checked
def load(name: str, /, **options: str | float) -> Scene:
    """Load a scene of the library, a scene file (.yaml, .yml or .json) or a model file (.xml or .urdf).

    Args:
        name: a name of a scene, such as "tracker" (`crosscheck list` prints all), or the path of a file.
        options: options of the scene or model file, for example `panel_inertia="literal"` of the tracker.
            Numbers may be given as texts.

    Raises:
        CrosscheckError: for an unknown scene or option, and for a file that cannot be read.
        newton_euler.NewtonEulerError: for a file with an impossible mechanism.

    Examples:
        >>> load("chain", N=3).mechanism.joint_names
        ('hinge_0', 'hinge_1', 'hinge_2')
    """
    if name in SCENES:
        return SCENES[name](**_read_options(name, options))
    if name == SUN_TRACKER:
        raise CrosscheckError(
            f"{name!r} is the tracker of `crosscheck sun` and `year`, which stands still without the sun; "
            "the scene to run is 'tracker_sun_day'"
        )
    if is_model_file(name):
        return read_model(name, options)[0]
    if remedy := CONVERSION_ADVICE.get(Path(name).suffix.lower()):
        raise CrosscheckError(f"{name!r} is in a format that cannot be read; {remedy}")
    if Path(name).suffix not in (".yaml", ".yml", ".json"):
        endings = ".yaml, .json, .xml or .urdf"
        if os.path.exists(name):
            raise CrosscheckError(f"{name}: cannot be read; needed: a name that ends in {endings}")
        raise CrosscheckError(f"unknown scene {name!r}; {choices(name, SCENES)}, or give a {endings} file")
    if options:
        raise CrosscheckError(f"scene file {name!r} takes no options, got {listed(options)}; edit the file")
    from crosscheck.library.scene_file import read_scene

    return read_scene(name)


def option_values(name: str, given: Mapping[str, str | float]) -> dict[str, str | float]:
    """Return the values of all options of a model that have an effect, given or by default.

    Args:
        name: name of a library scene, or path of a file, whose options without a given value are left out.
        given: options as the user set them.

    Raises:
        CrosscheckError: for an invalid option of a library scene.
    """
    if name not in SCENES:
        return dict(given)
    known = options_of(SCENES[name])
    defaults = {option: each.default for option, each in known.items()}
    values = defaults | _read_options(name, dict(given))
    return {
        option: value
        for option, value in values.items()
        if (condition := known[option].only_with) is None or _is_met(condition, values, known)
    }


def _is_met(condition: OnlyWith, values: Mapping[str, str | float], known: Mapping[str, Option]) -> bool:
    """Return True if the condition of an option holds for the values of all options."""
    other = values[condition.option]
    if condition.value is None:
        return other != known[condition.option].default
    return other == condition.value


def load_sun_tracker(options: Mapping[str, str | float]) -> Scene:
    """Return the tracker of `crosscheck sun` and `year`, which is no scene of the library: it stands still.

    Args:
        options: options of `crosscheck.library.tracker_sun.sun_tracker`. Numbers may be given as texts.

    Raises:
        CrosscheckError: for an unknown option, and for a value that is not allowed.
    """
    make: Callable[..., Scene] = tracker_sun.sun_tracker
    return make(**_read_options(SUN_TRACKER, dict(options), make))


def _read_options(
    name: str, given: dict[str, str | float], make: Callable[..., Scene] | None = None
) -> dict[str, str | float]:
    """Convert options of a library scene to the types of its arguments.

    Args:
        name: name of the scene.
        given: options as the user set them.
        make: function that makes the scene; None for that of the name.

    Raises:
        CrosscheckError: for an unknown option, a value that is not allowed, and an option that has no effect
            because of the value of another option.
    """
    known = options_of(make or SCENES[name])
    options: dict[str, Any] = {}
    for option, value in given.items():
        if option not in known:
            valid = choices(option, known) if known else "it takes none"
            raise CrosscheckError(
                f"unknown option {option!r} of scene {name!r}; {valid}, and limits (crosscheck list)"
            )
        read = known[option].read(value)
        if read is None:
            raise CrosscheckError(f"{option} of scene {name!r} is {quoted(value)}; {known[option].wanted}")
        options[option] = read
    # conditions on the value of another option; None stands for any value but the default
    for option in options:
        if condition := known[option].only_with:
            other = options.get(condition.option, known[condition.option].default)
            if not _is_met(condition, {condition.option: other}, known):
                where = f"{option} of scene {name!r} has no effect with {condition.option}={other}"
                raise CrosscheckError(f"{where}; needed: {condition}")
    return options
