"""State of a mechanism, common to all engines: poses and velocities of all bodies.

A run starts from a `State`, and `Trajectory.state` returns one. The module also converts states to `Frame`
records (pose and velocity of one body), for one time or for many times at once.
"""

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
from newton_euler.scalars import Array, Floats, Scalar, stacked_rows


@description  # a frozen dataclass, compared by identity
class State:
    """Poses and velocities of all b bodies, ground first; world frame, SI.

    Attributes:
        position: (b, 3) centers of mass, m.
        quaternion: (b, 4) orientations of the body frames, (w, x, y, z).
        linear_velocity: (b, 3) velocities of the centers of mass, m/s.
        angular_velocity: (b, 3) rad/s.
        angles: hinge angles including full revolutions, rad from the initial pose, by joint coordinate (name
            of the joint, index of the coordinate). Poses determine an angle only within one revolution, but
            the torque of a wound spring depends on all revolutions. States from runs and from
            `newton_euler.assemble` contain the angles on which forces, control laws or couplings of the scene
            depend. The revolutions of an angle that is not listed follow from couplings and prescribed
            motions; without these the angle is within half a revolution.

    Examples:
        >>> still = State.initial(load("pendulum").mechanism)
        >>> print(still.position[1] + 0.0)  # m, of the dumbbell
        [-0.5  0.   0. ]
    """

    position: Floats
    quaternion: Floats
    linear_velocity: Floats
    angular_velocity: Floats
    angles: Mapping[Key, float] = field(default_factory=dict, kw_only=True)

    def __post_init__(self) -> None:
        if isinstance(self.angles, Mapping):  # `Scene.check_angles` rejects anything else
            object.__setattr__(self, "angles", dict(self.angles))

    @classmethod
    @checked  # the types of the arguments
    def initial(cls, mechanism: Mechanism) -> State:
        """Return the state of a mechanism at its initial pose, at rest."""
        return cls(
            np.array([body.center_of_mass for body in mechanism.bodies]),
            np.array([body.quaternion for body in mechanism.bodies]),
            np.zeros((len(mechanism.bodies), 3)),
            np.zeros((len(mechanism.bodies), 3)),
        )

    @property
    def arrays(self) -> tuple[Array, ...]:
        """Position, quaternion, linear velocity and angular velocity, in this order."""
        return self.position, self.quaternion, self.linear_velocity, self.angular_velocity

    def revolutions(self, key: Key, x: Scalar) -> Scalar:
        """Return the full revolutions of a hinge angle, a multiple of 2 pi, rad.

        Args:
            key: joint coordinate (name of the joint, index of the coordinate).
            x: the angle, rad, as the poses determine it, within one revolution.

        Returns:
            The multiple of 2 pi nearest to `angles[key]` - x; 0 if `angles` does not contain the key.
        """
        return whole_revolutions(self.angles[key] - x) if key in self.angles else 0.0

    def frames(self) -> list[Frame]:
        """Return b records, one for each body.

        Each has `position` (3,), `rotation` (3, 3) from the body frame to the world, `velocity` (3,) and
        `angular_velocity` (3,).
        """
        return [Frame(r, rotation(p), v, w) for r, p, v, w in zip(*self.arrays, strict=True)]


def whole_revolutions(angle: Any) -> Any:
    """Round angles, rad, a number or an array, to the nearest multiples of 2 pi; 0 for angles not finite."""
    return 2.0 * np.pi * np.round(np.nan_to_num(angle, posinf=0.0, neginf=0.0) / (2.0 * np.pi))


def stacked(states: Sequence[State]) -> State:
    """Combine n states into one state whose numbers are `Stack` scalars.

    A `Stack` (`newton_euler.scalars`) holds n numbers with which the equations compute at once. The `angles`
    of the states are not combined.
    """
    columns = zip(*(state.arrays for state in states), strict=True)
    return State(*(_stacks(np.array(column)) for column in columns))


def stacked_frames(*arrays: Array) -> list[Frame]:
    """Return one `Frame` per body whose numbers are `Stack` scalars over n times.

    Args:
        arrays: position (n, b, 3), quaternion (n, b, 4), linear velocity (n, b, 3) and angular
            velocity (n, b, 3) of b bodies, as in `State`.
    """
    return State(*map(_stacks, arrays)).frames()


def _stacks(array: Array) -> Array:
    """Convert an array (n, b, k) of floats to an array (b, k) of `Stack` scalars with n numbers each."""
    count, *shape = array.shape
    return stacked_rows(array.reshape(count, -1)).reshape(shape)
