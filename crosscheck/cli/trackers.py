"""Options of the commands about solar trackers: scene, face that follows the sun, and rules of tracking."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import click

from crosscheck.cli.shared import load_with_warnings, refuse_excitation, scene_options
from crosscheck.support.errors import CrosscheckError

if TYPE_CHECKING:
    from newton_euler import Axis
    from newton_euler.model.scene import Scene

LIBRARY_TILT, ANY_TILT = 30.0, 90.0
"""Default of `--max-tilt`, degrees, for the tracker of the library and for other scenes."""


def tracker_options(command: Callable[..., int]) -> Callable[..., int]:
    """Add the option for the face of the tracker, and those for the rules of tracking, to a command."""
    options = [
        click.option(
            "--axis",
            metavar="BODY=X,Y,Z",
            help="Normal of the face, in the frame of its body.  "
            "[default: panel_7=0,0,1 if there is this body]",
        ),
        click.option(
            "--max-tilt",
            type=float,
            help="Largest tilt from the horizontal, degrees.  [default: 30 for the library's tracker, or 90]",
        ),
        click.option(
            "--deadband",
            type=float,
            default=0.0,
            show_default=True,
            help="Pointing error from which the tracker moves, degrees.",
        ),
        click.option(
            "--pitch",
            type=float,
            default=float("inf"),
            help="Distance to the next row in the direction of the shadow, panel lengths; for backtracking.  "
            "[default: a single row]",
        ),
        click.option(
            "--clearance",
            type=float,
            default=0.001,
            show_default=True,
            help="Smallest distance between bodies that no joint connects, m.",
        ),
        click.option(
            "--to-singular",
            type=float,
            default=0.05,
            show_default=True,
            help="Smallest distance from singular configurations; see `crosscheck workspace`.",
        ),
    ]
    for option in reversed(options):  # the last one added stands first in the help
        command = option(command)
    return command


def tracker_settings(settings: tuple[str, ...], why: str) -> dict[str, str]:
    """Return the options of the scene by name, from the values of `--set`.

    Args:
        settings: values of `--set`.
        why: reason why the scene must not have an excitation, for the message.

    Raises:
        CrosscheckError: for an excitation.
    """
    return refuse_excitation(scene_options(settings), why)


def largest_tilt(scene: str, given: float | None) -> float:
    """Return the largest tilt of the face, degrees: the given one, or the default of the scene."""
    from crosscheck.library import SUN_TRACKER

    if given is not None:
        return given
    return LIBRARY_TILT if scene == SUN_TRACKER else ANY_TILT


def load_scene_or_tracker(scene: str, options: dict[str, str]) -> Scene:
    """Load a scene, a model file or the tracker of the library, with warnings about imports."""
    from crosscheck.library import SUN_TRACKER, load_sun_tracker

    return load_sun_tracker(options) if scene == SUN_TRACKER else load_with_warnings(scene, options)


def load_tracker(scene: str, options: dict[str, str], axis: str | None) -> tuple[Scene, Axis]:
    """Load a tracker, and return it with the normal of its face.

    Args:
        scene: name of a library scene, or of the tracker of the library, or a model file.
        options: options of the scene by name.
        axis: the option `--axis`.

    Raises:
        CrosscheckError: if the scene has no body of the default axis, and `--axis` is not given.
    """
    from crosscheck.design.workspace import axis_of
    from crosscheck.library.tracker_sun import PANEL_NORMAL

    loaded = load_scene_or_tracker(scene, options)
    if axis is not None:
        return loaded, axis_of(axis)
    if PANEL_NORMAL.body not in loaded.mechanism.body_names:
        bodies = ", ".join(loaded.mechanism.body_names[1:])
        raise CrosscheckError(f"needed: --axis BODY=X,Y,Z, the normal of a face; bodies: {bodies:.500}")
    return loaded, PANEL_NORMAL
