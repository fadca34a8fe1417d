"""Set-points of a solar tracker: moves of the actuators that its PD controllers follow."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from crosscheck.solar.geared import Geared
from crosscheck.solar.moves import Plan, plan_moves
from crosscheck.solar.tracking import Tracking
from crosscheck.support.errors import CrosscheckError
from newton_euler import Loads, Poses, statics
from newton_euler.model.control import PD
from newton_euler.model.scene import Scene


class Followed(NamedTuple):
    """A tracker with set-points.

    Attributes:
        scene: the tracker, whose controllers follow the moves between set-points.
        loads: static loads at the poses of the set-points, without wind.
        plan: moves between the set-points.
    """

    scene: Scene
    loads: Loads
    plan: Plan


def pd_laws(scene: Scene) -> list[PD]:
    """Return the controllers of a tracker.

    Raises:
        CrosscheckError: if the scene has none, or others than PD controllers.
    """
    laws = [law for law in scene.control if isinstance(law, PD)]
    if not laws or len(laws) < len(scene.control):
        raise CrosscheckError(
            f"scene {scene.name!r}: set-points need PD controllers, such as position actuators of MJCF; "
            "found none, or other controllers too"
        )
    return laws


def check_tracker(scene: Scene) -> None:
    """Check that a scene can be simulated for a day.

    Raises:
        CrosscheckError: for other controllers than `PD`, and for forces or motions that vary with time: they
            would keep the scene from coming to rest between set-points.
    """
    pd_laws(scene)
    for field, index, attribute in scene.functions:
        if field != "control":
            element = getattr(scene, field)[index].element
            raise CrosscheckError(
                f"scene {scene.name!r}: {element} has a function of time ({attribute}); needed: forces and "
                "motions that do not vary, so that the tracker rests between set-points"
            )


def following(geared: Geared, poses: Poses, period: float, tracking: Tracking) -> Followed:
    """Give a tracker set-points.

    The feedforward of each PD controller is the static force of its set-point (`newton_euler.statics`), so
    that weight causes no steady-state error. In a move it changes in proportion to the position.

    Args:
        geared: the tracker, with the gears of its motors; all its controllers are `PD`.
        poses: poses of the n set-points, with the coordinates `geared.keys` measured.
        period: time between set-points, s.
        tracking: gives the largest speed and acceleration of the set-points.

    Raises:
        CrosscheckError: if a controller of the scene is not `PD`.
    """
    scene = geared.scene
    laws = pd_laws(scene)
    loads = statics(geared.planned, poses, geared.keys)
    # moves from set-point to set-point
    times = period * np.arange(len(poses))
    positions = np.stack([poses.coordinates[key] for key in geared.keys], axis=1)
    plan = plan_moves(times, positions, tracking.speed, tracking.acceleration)
    control = tuple(
        replace(
            law,
            target=plan.function(position / ratio),
            feedforward=plan.function(force * ratio),
            gravity_compensation=False,  # the feedforward holds the weight
        )
        for law, ratio, position, force in zip(
            laws, geared.ratios, positions.T, loads.actuator_force.T, strict=True
        )
    )
    start, end = geared.start(poses), float(times[-1])
    driven = replace(scene, control=control, initial_state=start, duration=end, output_period=period)
    return Followed(driven, loads, plan)


def check_period(period: float) -> None:
    """Raise `CrosscheckError` unless the time between set-points is from 1 s to 12 h."""
    if not 1.0 <= period <= 43200.0:
        raise CrosscheckError(f"period is {period:g} s; needed: 1 to 43200 s (12 h)")
