"""Control laws: declared ones, which every engine takes into its own equations, and sampled ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from newton_euler.errors import MechanismError, check_key, is_finite_number, set_numbers
from newton_euler.model.elements import CoordinateForce
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.motions import Polynomial, Sine, TimeFunction, terms
from newton_euler.scalars import Array, Floats, Scalar

DRIVEN = ("target", "feedforward")
"""Attributes of laws that may be functions of time."""


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
    """u = u_0 - (K_p e + K_d de/dt) with e = x - r, eq. (23) with the sign that makes it stable.

    Attributes:
        joint: name of the joint it drives.
        stiffness: K_p in N/m or N m/rad.
        damping: K_d in N s/m or N m s/rad.
        target: r, the wanted joint coordinate, m or rad from the initial pose, or a function of time for
            that.
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
    target: float | TimeFunction
    coordinate: int = 0
    feedforward: float | TimeFunction = 0.0

    parameters = ("stiffness", "damping", "target", "feedforward")
    strengths: ClassVar = {"actuator": ("stiffness", "damping", "feedforward")}

    def __post_init__(self) -> None:
        where = self.element
        functions = [name for name in DRIVEN if isinstance(getattr(self, name), TimeFunction)]
        set_numbers(self, where, [name for name in self.parameters if name not in functions])
        check_key(where, self.joint, self.coordinate)

    @property
    def is_driven(self) -> bool:
        """True if the law depends on time."""
        return any(isinstance(getattr(self, name), TimeFunction) for name in DRIVEN)

    def target_at(self, time: Scalar) -> tuple[Scalar, Scalar]:
        """Return r (m or rad) and its rate at a time in s."""
        r = self.target
        return (r.value(time), r.rate(time)) if isinstance(r, TimeFunction) else (r, 0.0)

    def feedforward_at(self, time: Scalar) -> Scalar:
        """Return u_0 (N or N m) at a time in s."""
        u_0 = self.feedforward
        return u_0.value(time) if isinstance(u_0, TimeFunction) else u_0

    def force(self, x: Scalar, x_rate: Scalar, time: Scalar) -> Scalar:
        r, r_rate = self.target_at(time)
        return self.feedforward_at(time) - (self.stiffness * (x - r) + self.damping * (x_rate - r_rate))


Controller = Callable[[float, Floats, Floats], float]
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


class DrivenLaws:
    """The laws that depend on time among others, all sines at once, for engines that Python evaluates.

    Without feedback, at x = 0 and dx/dt = 0, their force is w = u_0 + K_p r + K_d dr/dt.

    Attributes:
        places: (n,) numbers of these laws among all.
    """

    def __init__(self, laws: Sequence[object]) -> None:
        driven = [(k, law) for k, law in enumerate(laws) if isinstance(law, PD) and law.is_driven]
        self.places = np.array([k for k, _ in driven], dtype=int)
        self._constant = np.zeros(len(driven))
        sines: list[tuple[int, float, float, Sine]] = []
        self._polynomials: list[tuple[int, float, float, Polynomial]] = []
        for n, (_, law) in enumerate(driven):
            for given, gain, rate_gain in (
                (law.feedforward, 1.0, 0.0),
                (law.target, law.stiffness, law.damping),
            ):
                if not isinstance(given, TimeFunction):
                    self._constant[n] += gain * given
                    continue
                for term in terms(given):
                    if isinstance(term, Sine):
                        sines.append((n, gain, rate_gain, term))
                    else:
                        self._polynomials.append((n, gain, rate_gain, term))
        self._on_sines = np.array([n for n, *_ in sines], dtype=int)
        numbers = [
            (gain, rate_gain, sine.offset, sine.amplitude, sine.angular_frequency, sine.phase)
            for _, gain, rate_gain, sine in sines
        ]
        self._sines = np.reshape(numbers, (-1, 6)).T

    def at(self, time: float) -> Array:
        """Compute w (n,), N or N m, at a time in s."""
        found = self._constant.copy()
        gain, rate_gain, offset, amplitude, w, phase = self._sines
        angle = w * time + phase
        value, rate = offset + amplitude * np.sin(angle), amplitude * w * np.cos(angle)
        np.add.at(found, self._on_sines, gain * value + rate_gain * rate)
        for n, k_p, k_d, polynomial in self._polynomials:
            found[n] += k_p * polynomial.value(time) + k_d * polynomial.rate(time)
        return found
