"""Dry friction and limits of a reference model, as forces, for the verification of an imported scene.

The reader of a file replaces dry friction by regularized friction and limits by stops, see
`newton_euler.reading.approximations`. `FrictionAndStops` evaluates the same forces for the model that the
format's own parser compiles. Friction and limits are numbers of the file, and have to be equal in the scene.
The other numbers of the forces are choices of the reader. A reference model computes them on another way; if
the scene has a number that differs by at most `CHOICE_TOLERANCE`, both models use the number of the scene.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from newton_euler.model.scene import Scene
from newton_euler.model.switched_forces import JointFriction, JointStop
from newton_euler.scalars import Array

CHOICE_TOLERANCE = 1e-2
"""Largest relative difference of a number that the reader has chosen, such as a transition speed. Where
rounded digits of a file decide which motions are free, inertias at the start are not more accurate."""

STICK_TIME, STOP_RATE, STOP_DISSIPATION = 1e-3, 5e4, 40.0
"""Numbers of dry friction and limits as forces in files without softness: time, s, in which friction takes
the transition speed; stiffness of stops per inertia, 1/s^2; and dissipation of stops, s/m or s/rad. They
repeat the reader's `DEFAULT_SOFTNESS`, which the reference models verify."""


@dataclass(frozen=True, eq=False)
class FrictionAndStops:
    """Dry friction and stops of the nv velocities of a reference model; N or N m, m or rad.

    Attributes:
        friction: (nv,) dry friction; 0 for velocities without friction.
        speed: (nv,) transition speeds of friction.
        low, high: (nv,) limits of the coordinates; infinite without a limit.
        stiffness, dissipation: (nv,) of the stops at both limits.
    """

    friction: Array
    speed: Array
    low: Array
    high: Array
    stiffness: Array
    dissipation: Array

    @classmethod
    def none(cls, count: int) -> FrictionAndStops:
        """Return no friction and no stops for a number of velocities."""
        friction, stiffness, dissipation = np.zeros((3, count))
        low, high = np.full((2, count), [[-np.inf], [np.inf]])
        return cls(friction, np.ones(count), low, high, stiffness, dissipation)

    def with_choices_of(self, scene: Scene) -> FrictionAndStops:
        """Return the same friction and limits with the numbers that the reader of a scene has chosen."""
        frictions = [force for force in scene.switched_forces if isinstance(force, JointFriction)]
        stops = [force for force in scene.switched_forces if isinstance(force, JointStop)]
        return replace(
            self,
            speed=_nearest(self.speed, [force.transition_speed for force in frictions]),
            stiffness=_nearest(self.stiffness, [force.stiffness for force in stops]),
            dissipation=_nearest(self.dissipation, [force.dissipation for force in stops]),
        )

    def forces(self, x: Array, v: Array) -> Array:
        """Return the generalized forces (nv,) at coordinates x (nv,) and velocities v (nv,)."""
        force = -self.friction * np.clip(v / self.speed, -1.0, 1.0)
        for depth, depth_rate, inwards in ((self.low - x, -v, 1.0), (x - self.high, v, -1.0)):
            damped = np.maximum(0.0, 1.0 + self.dissipation * depth_rate)
            force = force + inwards * self.stiffness * np.maximum(0.0, depth) * damped
        return force

    def energy(self, x: Array) -> float:
        """Return the potential energy of the stops, J, at coordinates x (nv,)."""
        depths = np.maximum(0.0, self.low - x), np.maximum(0.0, x - self.high)
        return float(sum(0.5 * self.stiffness @ depth**2 for depth in depths))

    def elements(self, names: Sequence[str]) -> Iterator[tuple[str, FrictionAndStops]]:
        """Yield the friction, and the limits, of each velocity alone.

        Args:
            names: (nv,) name of the joint of each velocity.
        """
        none = FrictionAndStops.none(len(names))
        for k in np.flatnonzero(self.friction).tolist():
            alone = np.where(np.arange(len(names)) == k, self.friction, 0.0)
            yield f"{names[k]}: dry friction", replace(none, friction=alone, speed=self.speed)
        for k in np.flatnonzero(np.isfinite(self.low) | np.isfinite(self.high)).tolist():
            alone = np.where(np.arange(len(names)) == k, self.stiffness, 0.0)
            yield f"{names[k]}: limits", replace(self, friction=none.friction, stiffness=alone)


def _nearest(own: Array, chosen: Sequence[float]) -> Array:
    """Replace each number by the nearest chosen number, if this differs by at most `CHOICE_TOLERANCE`."""
    if not chosen:
        return own
    candidates = np.array(chosen)
    nearest = candidates[np.argmin(np.abs(own[:, None] - candidates), axis=1)]
    return np.where(np.abs(nearest - own) <= CHOICE_TOLERANCE * np.abs(own), nearest, own)
