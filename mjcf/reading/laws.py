"""Forces of an actuator and of all on a joint coordinate, and controls that excite mechanisms."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import mujoco
import numpy as np

from newton_euler.model.control import PD, StateFeedback
from newton_euler.model.joint import Key
from newton_euler.model.motions import Sum
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Sine
from newton_euler.reading.activity import Bounds
from newton_euler.reading.excitation import MAX_FREQUENCY, swings
from newton_euler.scalars import Array


class Excitation(NamedTuple):
    """Controls of actuators.

    Attributes:
        control: (nu,) of the start.
        swings: what they swing by about those, by the actuators' numbers.
        moved: control of the file and of the start, by the numbers of actuators where these differ.
    """

    control: Array
    swings: dict[int, Sine]
    moved: dict[int, tuple[float, float]]


def excite(
    scene: Scene, drives: Mapping[int, Drive], control: Array, places: Array, bounds: Iterable[Bounds]
) -> Excitation:
    """Choose sines within half of the room that the ranges leave about the start.

    Controls of the start are moved into their ranges if they lie at an end.

    Args:
        scene: with the controls of the file.
        drives: its actuators that can be driven.
        control: (nu,) of the file.
        places: (nactuator,) where each actuator has its control.
        bounds: limits of joint coordinates.
    """
    control, found, moved = control.copy(), dict[int, Sine](), dict[int, tuple[float, float]]()
    wanted = swings(scene, [drive.gains for drive in drives.values()], bounds)
    for (actuator, drive), swing in zip(drives.items(), wanted, strict=True):
        least = min(drive.control - drive.low, drive.high - drive.control)
        room = min(2.0 * swing.amplitude, least if drive.rests else 0.25 * (drive.high - drive.low))
        if not room > 0.0:
            continue
        if not drive.rests and room > least:
            inside = float(np.clip(drive.control, drive.low + room, drive.high - room))
            moved[actuator] = float(control[places[actuator]]), inside
            control[places[actuator]] = inside
        else:  # controls that move take joints elsewhere, too
            room = min(room, 2.0 * swing.within)
        found[actuator] = Sine(0.5 * room, swing.angular_frequency)
    return Excitation(control, found, moved)


class Affine(NamedTuple):
    """constant + by_length l + by_rate dl/dt, N or N m."""

    constant: float
    by_length: float
    by_rate: float


class Acting(NamedTuple):
    """Forces of all actuators on a joint coordinate: constant + swings - sum_j (k_j x_j + d_j dx_j/dt).

    Attributes:
        feedback: (k_j, d_j) by the joint coordinate x_j that the force depends on, SI.
        constant: N or N m.
        swings: added to the constant.
    """

    feedback: Mapping[Key, tuple[float, float]] = {}
    constant: float = 0.0
    swings: tuple[Sine, ...] = ()

    def with_feedback(self, key: Key, stiffness: float, damping: float) -> Acting:
        """Add gains on a joint coordinate."""
        k, d = self.feedback.get(key, (0.0, 0.0))
        return self._replace(feedback={**self.feedback, key: (k + stiffness, d + damping)})

    def law(self, key: Key) -> PD | StateFeedback:
        """Make the control law of joint coordinate `key`.

        If the coordinate has a stiffness of its own, the constant force becomes the target.
        """
        joint, coordinate = key
        stiffness, damping = self.feedback.get(key, (0.0, 0.0))
        target = self.constant / stiffness if stiffness else 0.0
        feedforward = swinging(0.0 if stiffness else self.constant, self.swings)
        if self.feedback.keys() <= {key}:
            return PD(joint, stiffness, damping, target, coordinate, feedforward)
        gains: dict[str | Key, tuple[float, float]] = dict(self.feedback.items())
        return StateFeedback(joint, gains, target, coordinate, feedforward)


def swinging(constant: float, swings: tuple[Sine, ...]) -> float | Sine | Sum:
    """A constant with sines, if there are any, about it."""
    if not swings:
        return constant
    first = replace(swings[0], offset=constant)
    return Sum((first, *swings[1:])) if swings[1:] else first


class Drive(NamedTuple):
    """An actuator of fixed gain that is part of control laws.

    Attributes:
        control: of the start; the activation of an actuator that has one.
        gains: N or N m on joint coordinates for each unit of it.
        low, high: how far it may swing by the ranges of control, activation and force, infinite if there are
            none, and by what control that takes where it has dynamics.
        rests: whether its dynamics rest at the start, so that no other control will do there.
    """

    control: float
    gains: dict[Key, float]
    low: float
    high: float
    rests: bool


def control_for(model: Any, actuator: int) -> float:
    """Largest amplitude of control for each unit of what an actuator's activation swings by.

    act = A sin(w t) takes A w cos(w t) of an integrator, and A sin(w t) + A w tau cos(w t) of a filter
    (MuJoCo's documentation, Modeling, Actuator, attribute dyntype). 1 without dynamics.
    """
    fastest, kind = 2.0 * np.pi * MAX_FREQUENCY, mujoco.mjtDyn(model.actuator_dyntype[actuator])
    if kind == mujoco.mjtDyn.mjDYN_NONE:
        return 1.0
    if kind == mujoco.mjtDyn.mjDYN_INTEGRATOR:
        return fastest
    return float(np.hypot(1.0, fastest * float(model.actuator_dynprm[actuator, 0])))
