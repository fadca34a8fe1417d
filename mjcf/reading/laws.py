"""Control laws from forces of actuators, and sines of controls that choose_excitation a mechanism."""

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
    """Excitation of a model by its controls.

    Attributes:
        control: (nu,) controls at the start.
        sines: sines about these controls, by number of the actuator.
        moved: control in the file and at the start, by number of the actuator, if they differ.
    """

    control: Array
    sines: dict[int, Sine]
    moved: dict[int, tuple[float, float]]


def choose_excitation(
    scene: Scene, drives: Mapping[int, Drive], control: Array, places: Array, bounds: Iterable[Bounds]
) -> Excitation:
    """Choose sines that use at most half of the distance of controls from their limits.

    Controls at an end of their range are moved inside the range.

    Args:
        scene: scene with the controls of the file.
        drives: actuators that can be driven, by number.
        control: (nu,) controls of the file.
        places: (nactuator,) index of each actuator's control.
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
        else:  # a control that stays also keeps joints within their limits
            room = min(room, 2.0 * swing.within)
        found[actuator] = Sine(0.5 * room, swing.angular_frequency)
    return Excitation(control, found, moved)


class Affine(NamedTuple):
    """Force constant + by_length l + by_rate dl/dt, N or N m, on a length l."""

    constant: float
    by_length: float
    by_rate: float


class JointActuation(NamedTuple):
    """Sum of actuator forces on a joint coordinate: constant + swings - sum_j (k_j x_j + d_j dx_j/dt).

    Attributes:
        feedback: gains (k_j, d_j), SI, by joint coordinate x_j.
        constant: N or N m.
        swings: sines, N or N m.
    """

    feedback: Mapping[Key, tuple[float, float]] = {}
    constant: float = 0.0
    swings: tuple[Sine, ...] = ()

    def with_feedback(self, key: Key, stiffness: float, damping: float) -> JointActuation:
        """Add gains on a joint coordinate."""
        k, d = self.feedback.get(key, (0.0, 0.0))
        return self._replace(feedback={**self.feedback, key: (k + stiffness, d + damping)})

    def law(self, key: Key) -> PD | StateFeedback:
        """Make the control law of joint coordinate `key`.

        If the law has a stiffness at its own coordinate, the constant force becomes the target.
        """
        joint, coordinate = key
        stiffness, damping = self.feedback.get(key, (0.0, 0.0))
        target = self.constant / stiffness if stiffness else 0.0
        feedforward = constant_plus_sines(0.0 if stiffness else self.constant, self.swings)
        if self.feedback.keys() <= {key}:
            return PD(joint, stiffness, damping, target, coordinate, feedforward)
        gains: dict[str | Key, tuple[float, float]] = dict(self.feedback.items())
        return StateFeedback(joint, gains, target, coordinate, feedforward)


def constant_plus_sines(constant: float, swings: tuple[Sine, ...]) -> float | Sine | Sum:
    """Return a constant, or the sum of a constant and sines."""
    if not swings:
        return constant
    first = replace(swings[0], offset=constant)
    return Sum((first, *swings[1:])) if swings[1:] else first


class Drive(NamedTuple):
    """Actuator with fixed gain that is part of control laws.

    Attributes:
        control: control at the start, or activation of an actuator with dynamics.
        gains: force on joint coordinates per unit of `control`, N or N m.
        low: smallest value within the ranges of control, activation and force; may be -infinity.
        high: largest value within the ranges of control, activation and force; may be infinity.
        rests: True for an actuator with dynamics, which must start with the control that keeps it at rest.
    """

    control: float
    gains: dict[Key, float]
    low: float
    high: float
    rests: bool


def control_per_activation(model: Any, actuator: int) -> float:
    """Return the largest amplitude of the control per unit amplitude of the activation.

    For act = A sin(w t), an integrator needs the control A w cos(w t). A filter needs
    A sin(w t) + A w tau cos(w t) (MuJoCo's documentation, Modeling, Actuator, attribute dyntype). The result
    is 1 without dynamics.
    """
    fastest, kind = 2.0 * np.pi * MAX_FREQUENCY, mujoco.mjtDyn(model.actuator_dyntype[actuator])
    if kind == mujoco.mjtDyn.mjDYN_NONE:
        return 1.0
    if kind == mujoco.mjtDyn.mjDYN_INTEGRATOR:
        return fastest
    return float(np.hypot(1.0, fastest * float(model.actuator_dynprm[actuator, 0])))
