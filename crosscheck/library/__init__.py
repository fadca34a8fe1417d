"""The scene library: scenes by name, and scenes from files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from crosscheck.library import (
    andrews,
    bricard,
    chain,
    flyball_governor,
    four_bar,
    free_top,
    heavy_top,
    pendulum,
    slider_crank,
    stewart,
    tracker,
    tracker_control,
    tracker_sun,
    tracker_wind,
)
from crosscheck.library.measure import Quantities
from crosscheck.library.options import options_of
from crosscheck.loading.model_files import CONVERSION_ADVICE, is_model_file, read_model
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
}
"""Functions that make a scene, by the scene's name. Their arguments are the scene's options."""

FIGURES: dict[str, Quantities] = {
    "pendulum": pendulum.FIGURES,
    "free_top": free_top.FIGURES,
    "heavy_top": heavy_top.FIGURES,
    "four_bar": four_bar.FIGURES,
    "andrews": andrews.FIGURES,
    "slider_crank": slider_crank.FIGURES,
    "bricard": bricard.FIGURES,
    "flyball_governor": flyball_governor.FIGURES,
    "stewart": stewart.FIGURES,
}
"""Quantities of a scene with reference values, see `crosscheck.library.references`."""


@checked
def load(name: str, /, **options: str | float) -> Scene:
    """The scene of that name, of that scene file (.yaml, .yml or .json) or of that model file.

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
    if is_model_file(name):
        return read_model(name, options)[0]
    if remedy := CONVERSION_ADVICE.get(Path(name).suffix.lower()):
        raise CrosscheckError(f"{name!r} is of a format that is not read; {remedy}")
    if Path(name).suffix not in (".yaml", ".yml", ".json"):
        raise CrosscheckError(
            f"unknown scene {name!r}; {choices(name, SCENES)}, or give a .yaml, .json, .xml or .urdf file"
        )
    if options:
        raise CrosscheckError(f"scene file {name!r} takes no options, got {listed(options)}")
    from crosscheck.library.scene_file import read_scene

    return read_scene(name)


def _read(name: str, given: dict[str, str | float]) -> dict[str, str | float]:
    """The options that a scene takes, as it takes them."""
    known = options_of(SCENES[name])
    options = {}
    for option, value in given.items():
        if option not in known:
            valid = choices(option, known) if known else "it takes none"
            raise CrosscheckError(
                f"unknown option {option!r} of scene {name!r}; {valid}, beside limits (crosscheck list)"
            )
        read = known[option].read(value)
        if read is None:
            raise CrosscheckError(f"{option} of scene {name!r} is {quoted(value)}; {known[option].wanted}")
        options[option] = read
    for option in options:
        if beside := known[option].beside:
            default = known[beside.option].default
            other = options.get(beside.option, default)
            if other == default if beside.value is None else other != beside.value:
                where = f"{option} of scene {name!r} has no effect with {beside.option}={other}"
                raise CrosscheckError(f"{where}; needed: {beside}")
    return options
