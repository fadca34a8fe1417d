"""Control laws from the forces of MuJoCo's actuators, and sines of the controls that excite a mechanism.

A run of a model at rest with zero controls tests few of its elements. `choose_excitation` therefore adds a
sine to the control of each actuator, within all limits. `JointActuation` adds up the forces of several
actuators on one joint coordinate and makes the control law of the scene.
"""

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
    """Controls that excite a model.

    Attributes:
        control: (nu,) controls at the start.
        sines: sines about these controls, by number of the actuator. The sine of an actuator with activation
            dynamics is that of the activation.
        moved: control in the file and at the start, by number of the actuator, if they differ.
    """

    control: Array
    sines: dict[int, Sine]
    moved: dict[int, tuple[float, float]]


def choose_excitation(
    scene: Scene, drives: Mapping[int, Drive], control: Array, control_index: Array, bounds: Iterable[Bounds]
) -> Excitation:
    """Choose the sines of controls. An amplitude is at most half of the distance from the nearest limit.

    If the sine does not fit between a control of the file and the limits, the control is moved, so that the
    sine fits.

    Args:
        scene: scene with the controls of the file.
        drives: actuators whose controls can vary, by number.
        control: (nu,) controls of the file.
        control_index: (nactuator,) index of each actuator's first control (`actuator_ctrladr`); actuators of
            MuJoCo 4 may have several controls.
        bounds: limits of joint coordinates.
    """
    control, sines, moved = control.copy(), dict[int, Sine](), dict[int, tuple[float, float]]()
    # sines that move joints by a useful amount: `amplitude` disregards the limits of joints,
    # `amplitude_within_limits` does not
    useful_sines = swings(scene, [drive.gains for drive in drives.values()], bounds)
    for (actuator, drive), swing in zip(drives.items(), useful_sines, strict=True):
        # distance that the mean control keeps from its limits, twice the amplitude of the sine: at most the
        # present distance, or a quarter of the range if the mean control may be moved
        to_limit = min(drive.control - drive.low, drive.high - drive.control)
        room = min(2.0 * swing.amplitude, to_limit if drive.has_dynamics else 0.25 * (drive.high - drive.low))
        if not room > 0.0:
            continue
        if not drive.has_dynamics and room > to_limit:
            inside = float(np.clip(drive.control, drive.low + room, drive.high - room))
            moved[actuator] = float(control[control_index[actuator]]), inside
            control[control_index[actuator]] = inside
        else:  # a control that keeps its mean value also keeps joints within their limits
            room = min(room, 2.0 * swing.amplitude_within_limits)
        sines[actuator] = Sine(0.5 * room, swing.angular_frequency)
    return Excitation(control, sines, moved)


class Affine(NamedTuple):
    """Coefficients of the force constant + by_length l + by_rate dl/dt on a transmission of length l.

    The force is in N if l is a length in m, and in N m if l is an angle in rad.
    """

    constant: float
    by_length: float
    by_rate: float


class JointActuation(NamedTuple):
    """Sum of the actuator forces on one joint coordinate: constant + sines - sum_j (k_j x_j + d_j dx_j/dt).

    Coordinates x_j are zero at the start. A key (joint name, number) names a coordinate.

    Attributes:
        feedback: stiffness k_j and damping d_j, SI, by joint coordinate x_j.
        constant: N or N m.
        sines: N or N m.
    """

    feedback: Mapping[Key, tuple[float, float]] = {}
    constant: float = 0.0
    sines: tuple[Sine, ...] = ()

    def with_feedback(self, key: Key, stiffness: float, damping: float) -> JointActuation:
        """Return the sum with additional stiffness and damping on joint coordinate `key`."""
        k, d = self.feedback.get(key, (0.0, 0.0))
        return self._replace(feedback={**self.feedback, key: (k + stiffness, d + damping)})

    def law(self, key: Key) -> PD | StateFeedback:
        """Return the control law that applies this sum to joint coordinate `key`.

        If the sum has a stiffness k on coordinate `key` itself, the constant force c is written as the target
        c / k. The law is a PD law if the sum depends on no other coordinate.
        """
        joint, coordinate = key
        stiffness, damping = self.feedback.get(key, (0.0, 0.0))
        target = self.constant / stiffness if stiffness else 0.0
        feedforward = constant_plus_sines(0.0 if stiffness else self.constant, self.sines)
        if self.feedback.keys() <= {key}:
            return PD(joint, stiffness, damping, target, coordinate, feedforward)
        gains: dict[str | Key, tuple[float, float]] = dict(self.feedback.items())
        return StateFeedback(joint, gains, target, coordinate, feedforward)


def constant_plus_sines(constant: float, sines: tuple[Sine, ...]) -> float | Sine | Sum:
    """Return the function of time constant + sum of the sines; without sines, the constant itself."""
    if not sines:
        return constant
    first = replace(sines[0], offset=constant)  # constant + first sine
    return Sum((first, *sines[1:])) if sines[1:] else first


class Drive(NamedTuple):
    """Actuator with fixed gain whose control excitation can vary.

    Attributes:
        control: control at the start, or activation of an actuator with dynamics.
        gains: force on joint coordinates per unit of `control`, N or N m.
        low: smallest value within the ranges of control, activation and force; may be -infinity.
        high: largest value within the ranges of control, activation and force; may be infinity.
        has_dynamics: True for an actuator with activation dynamics. The mean of its control must stay at the
            value of the file, which keeps the mean activation constant.
    """

    control: float
    gains: dict[Key, float]
    low: float
    high: float
    has_dynamics: bool


def control_per_activation(model: Any, actuator: int) -> float:
    """Return the largest amplitude of the control per unit amplitude of the activation.

    For act = A sin(w t), an integrator needs the control A w cos(w t). A filter needs
    A sin(w t) + A w tau cos(w t) (MuJoCo's documentation, Modeling, Actuator, attribute dyntype). The result
    is 1 without dynamics.
    """
    max_omega = 2.0 * np.pi * MAX_FREQUENCY  # rad/s, largest w of the sines of `choose_excitation`
    kind = mujoco.mjtDyn(model.actuator_dyntype[actuator])
    if kind == mujoco.mjtDyn.mjDYN_NONE:
        return 1.0
    if kind == mujoco.mjtDyn.mjDYN_INTEGRATOR:
        return max_omega
    return float(np.hypot(1.0, max_omega * float(model.actuator_dynprm[actuator, 0])))
