"""Controls that swing: sines of time for all actuators that a file lets drive its joints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from mjcf.reading.laws import Drive
from newton_euler.exercise import swings
from newton_euler.model.motions import Sine
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array


class Exercise(NamedTuple):
    """Controls of actuators.

    Attributes:
        control: (nu,) of the start.
        swings: what they swing by about those, by the actuators' numbers.
        moved: actuators whose controls of the start are not those of the file.
    """

    control: Array
    swings: dict[int, Sine]
    moved: list[int]

    def at(self, time: float, model: Any, activation: Array) -> tuple[Array, Array]:
        """Controls (nu,) and activations (na,) of a compiled model at a time, s, from those at the start."""
        control, activation = self.control.copy(), activation.copy()
        for k, swing in self.swings.items():
            if (place := int(model.actuator_actadr[k])) < 0:
                control[model.actuator_ctrladr[k]] += swing.value(time)
            else:
                activation[place] += swing.value(time)
        return control, activation


def exercise(scene: Scene, drives: Mapping[int, Drive], control: Array, places: Array) -> Exercise:
    """Choose sines within half of the room that the ranges leave about the start.

    Controls of the start are moved into their ranges if they lie at an end.

    Args:
        scene: with the controls of the file.
        drives: its actuators that can be driven.
        control: (nu,) of the file.
        places: (nactuator,) where each actuator has its control.
    """
    control, found, moved = control.copy(), dict[int, Sine](), []
    wanted = swings(scene, [drive.gains for drive in drives.values()])
    for (actuator, drive), swing in zip(drives.items(), wanted, strict=True):
        least = min(drive.control - drive.low, drive.high - drive.control)
        room = min(2.0 * swing.amplitude, least if drive.rests else 0.25 * (drive.high - drive.low))
        if not room > 0.0:
            continue
        if not drive.rests and room > least:
            control[places[actuator]] = np.clip(drive.control, drive.low + room, drive.high - room)
            moved.append(actuator)
        found[actuator] = Sine(0.5 * room, swing.angular_frequency)
    return Exercise(control, found, moved)
