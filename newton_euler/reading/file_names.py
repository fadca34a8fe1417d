"""Names and zeros of a model file for joints, bodies and inputs, to read runs of the file by other tools.

A scene counts joint coordinates from its initial pose, puts body frames at centers of mass, and merges bodies
that are fixed to each other. Logs of other simulators use the joints, body frames and actuators of the file.
The reader of a file format records here how the two correspond.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from newton_euler.model.joint import Key
from newton_euler.scalars import Array


class FileCoordinate(NamedTuple):
    """Hinge or slide of a model file.

    Attributes:
        key: joint coordinate of the scene: name of the joint, index of the coordinate.
        start: coordinate in the file, m or rad, at which the scene's coordinate is zero.
    """

    key: Key
    start: float


class FileFrame(NamedTuple):
    """Frame of a body of a model file.

    Attributes:
        body: body of the scene that carries the frame.
        point: (3,) from the center of mass of the scene's body to the origin of the frame, m, body frame.
        center: (3,) from there to the center of mass of the file's body, m, body frame. It is zero unless the
            scene merges bodies.
        quaternion: (4,) orientation of the frame in the frame of the scene's body, (w, x, y, z).
    """

    body: str
    point: Array
    center: Array
    quaternion: Array


class FileInput(NamedTuple):
    """Actuator of a model file whose force depends on the present control by constant gains.

    Actuators with activation dynamics, whose force depends on earlier controls, have no such record. Control
    laws of the scene exert the actuator's force.

    Attributes:
        start: control input at the start, in the unit of the file.
        gain: force of the actuator per unit of the control input.
        gains: force on joint coordinates of the scene per unit of the control input, N or N m.
        limits: smallest and largest control with an effect; the engine clips others, or their force.
    """

    start: float
    gain: float
    gains: Mapping[Key, float]
    limits: tuple[float, float]


@dataclass
class FileNames:
    """Correspondence of a model file and its scene, by names in the file.

    Attributes:
        coordinates: hinges and slides.
        frames: frames of bodies.
        inputs: actuators that can follow controls from a log.
        activated: names of actuators with activation dynamics, which cannot.
    """

    coordinates: dict[str, FileCoordinate] = field(default_factory=dict)
    frames: dict[str, FileFrame] = field(default_factory=dict)
    inputs: dict[str, FileInput] = field(default_factory=dict)
    activated: list[str] = field(default_factory=list)
