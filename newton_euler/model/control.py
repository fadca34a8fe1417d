"""Control laws: declared ones, which every engine takes into its own equations, and sampled ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from newton_euler.errors import MechanismError, check_key, is_finite_number, set_numbers
from newton_euler.model.elements import CoordinateForce
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.motions import Sine, TimeFunction
from newton_euler.scalars import Array, Scalar


class ControlLaw(CoordinateForce):
    """A control law of an actuated joint."""

    noun = "control"

    def check(self, mechanism: Mechanism) -> None:
        """Raise `MechanismError` unless the mechanism has its joint coordinate, an actuated one."""
        super().check(mechanism)
        if not mechanism.joint(self.joint).actuated:
            raise MechanismError(self.element, "the joint is not actuated", "an actuated joint")


@dataclass(frozen=True)
class PD(ControlLaw):
    """u = u_0 - (K_p e + K_d de/dt) with e = x - target, eq. (23) with the sign that makes it stable.

    Attributes:
        joint: name of the joint it drives.
        stiffness: K_p in N/m or N m/rad.
        damping: K_d in N s/m or N m s/rad.
        target: wanted joint coordinate, m or rad from the initial pose.
        coordinate: which of the joint's coordinates, from 0.
        feedforward: u_0 in N or N m, a number or a function of time.

    Raises:
        MechanismError: naming the joint and the value at fault.

    Examples:
        >>> law = PD("hinge", stiffness=10.0, damping=1.0, target=1.0)
        >>> law.force(x=0.5, x_rate=0.0, time=0.0)  # N m towards the target
        5.0
    """

    joint: str
    stiffness: float
    damping: float
    target: float
    coordinate: int = 0
    feedforward: float | TimeFunction = 0.0

    parameters = ("stiffness", "damping", "target", "feedforward")
    strengths: ClassVar = {"actuator": ("stiffness", "damping", "feedforward")}

    def __post_init__(self) -> None:
        where = self.element
        set_numbers(self, where, self.parameters[: 3 if self.is_driven else 4])
        check_key(where, self.joint, self.coordinate)

    @property
    def is_driven(self) -> bool:
        """True if the law depends on time."""
        return isinstance(self.feedforward, TimeFunction)

    def feedforward_at(self, time: Scalar) -> Scalar:
        """u_0 (N or N m) at a time in s."""
        u_0 = self.feedforward
        return u_0.value(time) if isinstance(u_0, TimeFunction) else u_0

    def force(self, x: Scalar, x_rate: Scalar, time: Scalar) -> Scalar:
        return self.feedforward_at(time) - (self.stiffness * (x - self.target) + self.damping * x_rate)


Controller = Callable[[float, Array, Array], float]
"""time (s), coordinates (a,) and their rates (a,) of all laws of the scene, in order -> force, N or N m."""


SHORTEST_PERIOD = 1e-6
"""s; no digital controller is quicker, and Python would be called a million times a second."""


@dataclass(frozen=True)
class Sampled(ControlLaw):
    """A controller in discrete time: called at its period, its force held in between.

    Attributes:
        joint: name of the joint it drives.
        controller: a `Controller`; one with a state of its own has to begin anew at time 0, because a
            scene may be run several times.
        period: s between its calls, at least `SHORTEST_PERIOD`; the first is at time 0.
        coordinate: which of the joint's coordinates, from 0.
        held: N or N m, the force at present.

    Raises:
        MechanismError: naming the joint and the value at fault.

    Examples:
        >>> law = Sampled("hinge", lambda time, x, x_rate: -2.0 * x[0], period=0.01)
        >>> law.period
        0.01
    """

    joint: str
    controller: Controller
    period: float
    coordinate: int = 0
    held: float = 0.0

    parameters = ()
    strengths: ClassVar = {}

    def __post_init__(self) -> None:
        where = self.element
        if not callable(self.controller):
            raise MechanismError(where, f"controller is {self.controller!r}", "something to call")
        if not is_finite_number(self.period) or self.period < SHORTEST_PERIOD:
            needed = f"a number of seconds, at least {SHORTEST_PERIOD:g}"
            raise MechanismError(where, f"period is {self.period!r}", needed)
        object.__setattr__(self, "period", float(self.period))
        check_key(where, self.joint, self.coordinate)

    def force(self, x: Scalar, x_rate: Scalar, time: Scalar) -> Scalar:
        """Return the force (N or N m) that is held."""
        return self.held


Law = PD | Sampled


class Feedforwards:
    """u_0 of those laws that depend on time, all sines at once, for engines that Python evaluates.

    Attributes:
        places: (n,) numbers of these laws among all.
    """

    def __init__(self, laws: Sequence[object]) -> None:
        driven = [
            (k, law.feedforward)
            for k, law in enumerate(laws)
            if isinstance(law, PD) and isinstance(law.feedforward, TimeFunction)
        ]
        self.places = np.array([k for k, _ in driven], dtype=int)
        sines = [(n, u_0) for n, (_, u_0) in enumerate(driven) if isinstance(u_0, Sine)]
        self._others = [(n, u_0) for n, (_, u_0) in enumerate(driven) if not isinstance(u_0, Sine)]
        self._on_sines = np.array([n for n, _ in sines], dtype=int)
        numbers = [(u_0.offset, u_0.amplitude, u_0.angular_frequency, u_0.phase) for _, u_0 in sines]
        self._offset, self._amplitude, self._angular_frequency, self._phase = np.reshape(numbers, (-1, 4)).T

    def at(self, time: float) -> Array:
        """Compute u_0 (n,), N or N m, at a time in s."""
        found = np.empty(len(self.places))
        angle = self._angular_frequency * time + self._phase
        found[self._on_sines] = self._offset + self._amplitude * np.sin(angle)
        for n, u_0 in self._others:
            found[n] = u_0.value(time)
        return found
