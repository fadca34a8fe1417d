"""The state of a mechanism in a form that belongs to no engine: body poses and velocities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import Any

import numpy as np

from newton_euler.arguments import checked
from newton_euler.model.constraints import Frame
from newton_euler.model.description import description
from newton_euler.model.euler_parameters import rotation
from newton_euler.model.joint import Key
from newton_euler.model.mechanism import Mechanism
from newton_euler.scalars import Array, Floats, Scalar, Stack, objects


@description
class State:
    """Poses and velocities of all b bodies, ground first; world frame, SI.

    Attributes:
        position: (b, 3) centers of mass, m.
        quaternion: (b, 4) w-x-y-z.
        linear_velocity: (b, 3) of the centers of mass, m/s.
        angular_velocity: (b, 3) rad/s.
        angles: rad from the initial pose with revolutions, by joint coordinate (name of the joint, number).
            Poses determine an angle within one revolution only; the torque of a wound spring depends on all
            revolutions. States of runs and of `newton_euler.assemble` have the angles that forces, control
            laws or couplings of the scene depend on. An angle that is not given has the revolutions that
            couplings and prescribed motions ask for, else it is within half a revolution.

    Examples:
        >>> State.initial(load("pendulum").mechanism).position.shape
        (2, 3)
    """

    position: Floats
    quaternion: Floats
    linear_velocity: Floats
    angular_velocity: Floats
    angles: Mapping[Key, float] = field(default_factory=dict, kw_only=True)

    def __post_init__(self) -> None:
        if isinstance(self.angles, Mapping):  # scenes refuse all else
            object.__setattr__(self, "angles", dict(self.angles))

    @classmethod
    @checked
    def initial(cls, mechanism: Mechanism) -> State:
        """The mechanism's initial pose, at rest."""
        return cls(
            np.array([body.center_of_mass for body in mechanism.bodies]),
            np.array([body.quaternion for body in mechanism.bodies]),
            np.zeros((len(mechanism.bodies), 3)),
            np.zeros((len(mechanism.bodies), 3)),
        )

    @property
    def arrays(self) -> tuple[Array, ...]:
        """The four arrays, in their order."""
        return self.position, self.quaternion, self.linear_velocity, self.angular_velocity

    def revolutions(self, key: Key, x: Scalar) -> Scalar:
        """Return the revolutions, rad, of `angles` beyond an angle x of the poses, rad; 0 if unknown."""
        return whole_revolutions(self.angles[key] - x) if key in self.angles else 0.0

    def frames(self) -> list[Frame]:
        """One `Frame` for each body."""
        return [Frame(r, rotation(p), v, w) for r, p, v, w in zip(*self.arrays, strict=True)]


def whole_revolutions(angle: Any) -> Any:
    """Return the multiples of 2 pi next to angles, rad; 0 for those that are not finite."""
    return 2.0 * np.pi * np.round(np.nan_to_num(angle, posinf=0.0, neginf=0.0) / (2.0 * np.pi))


def stacked(states: Sequence[State]) -> State:
    """Return one state whose numbers are stacks of those of n states, without `State.angles`."""
    columns = zip(*(state.arrays for state in states), strict=True)
    return State(*(_stacks(np.array(column)) for column in columns))


def stacked_frames(*arrays: Array) -> list[Frame]:
    """One `Frame` for each of b bodies at n times at once: its numbers are stacks of n.

    The arrays are those of a `State`, (n, b, 3) and quaternions (n, b, 4).
    """
    return State(*map(_stacks, arrays)).frames()


def _stacks(array: Array) -> Array:
    """Return stacks (b, k) of the numbers of an array (n, b, k)."""
    count, *shape = array.shape
    columns = np.ascontiguousarray(array.reshape(count, -1).T)
    return objects([Stack(column) for column in columns]).reshape(shape)
