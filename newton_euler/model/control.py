"""Control laws that are declared: every engine evaluates them at each state and time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from newton_euler.errors import (
    MechanismError,
    check_flag,
    check_key,
    finite_array,
    listed,
    quoted,
    real_array,
)
from newton_euler.model.elements import CoordinateForce, Surroundings
from newton_euler.model.fields import NumberField
from newton_euler.model.joint import Key
from newton_euler.model.mechanism import Mechanism, check_coordinate
from newton_euler.model.motions import TimeFunction, terms
from newton_euler.model.smooth_functions import Sine
from newton_euler.model.variable import functions_of
from newton_euler.scalars import Array, Scalar

DRIVEN = ("target", "feedforward")  # attributes of laws that may be functions of time
TARGET = NumberField("m", "rad", may_be_function=True)
FEEDFORWARD = NumberField("N", "N m", may_be_function=True, strength="actuator")
NO_FORCES: Mapping[Key, Scalar] = {}

Readings = Mapping[Key, Sequence[Any]]
"""Joint coordinates (m or rad), their rates, and further values that are not used here."""


class Reference(NamedTuple):
    """The wanted value of a joint coordinate, m or rad, and its first and second derivatives by time."""

    value: Scalar
    rate: Scalar
    acceleration: Scalar


def reference(target: float | TimeFunction, time: Scalar) -> Reference:
    """Evaluate a target at a time in s: value, rate and acceleration."""
    if isinstance(target, TimeFunction):
        return Reference(target.value(time), target.rate(time), target.acceleration(time))
    return Reference(target, 0.0, 0.0)


class ControlLaw(CoordinateForce):
    """A control law of an actuated joint."""

    noun = "control"

    def check(self, mechanism: Mechanism) -> None:
        """Raise `MechanismError` unless the mechanism has the joint coordinate and the joint is actuated."""
        super().check(mechanism)
        if not mechanism.joint(self.joint).actuated:
            raise MechanismError(self.element, "the joint is not actuated", "an actuated joint")

    @property
    def reads(self) -> tuple[Key, ...]:
        """The joint coordinates that the law depends on."""
        return (self.key,)


class DeclaredLaw(ControlLaw):
    """A control law that is a function of joint coordinates, their rates and time.

    Attributes:
        target: set-point of the law's own coordinate, m or rad from the initial pose.
        feedforward: u_0, N or N m, a number or a function of time.
    """

    target: float | TimeFunction
    feedforward: float | TimeFunction

    number_fields: ClassVar = {
        "stiffness": NumberField("N/m", "N m/rad", strength="actuator"),
        "damping": NumberField("N s/m", "N m s/rad", strength="actuator"),
        "target": TARGET,
        "feedforward": FEEDFORWARD,
    }

    @property
    def is_driven(self) -> bool:
        """True if the law depends on time."""
        return any(isinstance(getattr(self, name), TimeFunction) for name in DRIVEN)

    @property
    def jumps(self) -> bool:
        """True if a function of time of the law jumps."""
        return any(f.jumps for name in self.functions for f in functions_of(getattr(self, name)))

    @property
    def feedback(self) -> Mapping[Key, tuple[float, float]]:
        """Gains (K_p, K_d), SI, by the coordinates that the law reads."""
        raise NotImplementedError

    @property
    def reads(self) -> tuple[Key, ...]:
        return tuple(self.feedback)

    def references(self, time: Scalar) -> dict[Key, Reference]:
        """Return the set-points of the coordinates that the law reads, at a time in s."""
        return {self.key: reference(self.target, time)}

    def feedforward_at(self, time: Scalar) -> Scalar:
        """Return u_0 (N or N m) at a time in s."""
        u_0 = self.feedforward
        return u_0.value(time) if isinstance(u_0, TimeFunction) else u_0

    @property
    def uses_model(self) -> bool:
        """True if a part of the force comes from a model of the mechanism."""
        return False

    def towards(
        self,
        references: Mapping[Key, Reference],
        readings: Readings,
        time: Scalar,
        model: Mapping[Key, Scalar] = NO_FORCES,
    ) -> Scalar:
        """Compute the force (N or N m) for given set-points and readings.

        Args:
            references: set-points by coordinate, which may differ from the law's own targets.
            readings: coordinates (m or rad) and rates.
            time: s.
            model: forces from a model of the mechanism, N or N m, by coordinate.
        """
        force = self.feedforward_at(time)
        for key, (k_p, k_d) in self.feedback.items():
            r, (x, x_rate) = references[key], readings[key][:2]
            force = force - (k_p * (x - r.value) + k_d * (x_rate - r.rate))
        return force + model.get(self.key, 0.0) if self.uses_model else force

    def at_joint(self, at: Surroundings) -> Scalar:
        model = at.model() if self.uses_model else NO_FORCES
        return self.towards(self.references(at.time), at.measured, at.time, model)


@dataclass(frozen=True)
class PD(DeclaredLaw):
    """PD controller for one joint coordinate: u = u_0 + K_p (r - x) + K_d (dr/dt - dx/dt).

    The equation is eq. (23) with the sign that makes the loop stable.

    Attributes:
        joint: name of the driven joint.
        stiffness: K_p in N/m or N m/rad.
        damping: K_d in N s/m or N m s/rad.
        target: set-point r of the joint coordinate, m or rad from the initial pose, or a function of time.
        coordinate: which of the joint's coordinates, from 0.
        feedforward: u_0 in N or N m, a number or a function of time.
        gravity_compensation: True adds the force that holds the coordinate at rest against gravity, springs
            and wrenches, but not the wind. All such laws of a scene hold their coordinates together.

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
    gravity_compensation: bool = False

    def __post_init__(self) -> None:
        self.set_numbers(self.element)
        check_key(self.element, self.joint, self.coordinate)
        check_flag(self.element, self, "gravity_compensation")

    @property
    def uses_model(self) -> bool:
        return self.gravity_compensation

    @property
    def feedback(self) -> Mapping[Key, tuple[float, float]]:
        return {self.key: (self.stiffness, self.damping)}

    def force(self, x: Scalar, x_rate: Scalar, time: Scalar) -> Scalar:
        """Compute the force (N or N m) without gravity compensation."""
        return self.towards(self.references(time), {self.key: (x, x_rate)}, time)


@dataclass(frozen=True)
class StateFeedback(DeclaredLaw):
    """u = u_0 - sum_j (K_pj (x_j - r_j) + K_dj (dx_j/dt - dr_j/dt)) over several joint coordinates.

    Attributes:
        joint: name of the driven joint.
        gains: (K_pj, K_dj) of each coordinate that it reads, by the name of the joint, or by (name, number)
            for another one than the joint's first; SI.
        target: r of its own coordinate, m or rad from the initial pose, or a function of time for that.
        coordinate: which of the joint's coordinates it drives, from 0.
        feedforward: u_0 in N or N m, a number or a function of time.
        targets: r_j of other coordinates, by the same names; 0 if not given.

    Raises:
        MechanismError: naming the joint and the value at fault.

    Examples:
        >>> law = StateFeedback("rail", {"rail": (10.0, 2.0), "pole": (-50.0, -8.0)})
        >>> readings = {("rail", 0): (0.1, 0.0), ("pole", 0): (0.02, 0.0)}
        >>> law.towards(law.references(0.0), readings, 0.0)  # N
        0.0
    """

    joint: str
    gains: Mapping[str | Key, tuple[float, float]]
    target: float | TimeFunction = 0.0
    coordinate: int = 0
    feedforward: float | TimeFunction = 0.0
    targets: Mapping[str | Key, float | TimeFunction] = ()  # type: ignore[assignment]

    number_fields: ClassVar = {
        "gains": NumberField(shape=None, strength="actuator"),
        "target": TARGET,
        "feedforward": FEEDFORWARD,
        "targets": NumberField(shape=None, may_be_function=True),
    }

    def __post_init__(self) -> None:
        where = self.element
        self.set_numbers(where)
        check_key(where, self.joint, self.coordinate)
        gains = {key: (float(k_p), float(k_d)) for key, (k_p, k_d) in self._by_key("gains", (2,)).items()}
        targets = self._by_key("targets", ())
        for key in targets:
            if key not in gains or key == self.key:
                needed = "targets of other coordinates that have gains; its own is target"
                raise MechanismError(where, f"targets has {quoted(key[0])}", needed)
        object.__setattr__(self, "gains", gains)
        object.__setattr__(self, "targets", targets)

    def _by_key(self, name: str, shape: tuple[int, ...]) -> dict[Key, Any]:
        """Return an attribute by joint coordinates, checked."""
        given: Any = getattr(self, name)
        given = {} if isinstance(given, tuple) and not given else given
        if not isinstance(given, Mapping):
            raise MechanismError(self.element, f"{name} is {quoted(given)}", "a mapping from names of joints")
        found: dict[Key, Any] = {}
        for place, value in given.items():
            key = place if isinstance(place, tuple) and len(place) == 2 else (place, 0)
            check_key(f"{name} of {self.element}", *key)
            if shape or not isinstance(value, TimeFunction):
                value = finite_array(self.element, f"{name} of joint {quoted(key[0])}", value, shape).tolist()
            found[key] = value
        return found

    def check(self, mechanism: Mechanism) -> None:
        super().check(mechanism)
        for joint, coordinate in self.reads:
            if joint not in mechanism.joint_names:
                needed = f"names out of {listed(mechanism.joint_names)}"
                raise MechanismError(self.element, f"gains has {quoted(joint)}", needed)
            check_coordinate(self.element, mechanism.joint(joint), coordinate)

    @property
    def feedback(self) -> Mapping[Key, tuple[float, float]]:
        gains: Any = self.gains  # names are keys by now
        return gains

    def references(self, time: Scalar) -> dict[Key, Reference]:
        targets = {**self.targets, self.key: self.target}
        return {key: reference(targets.get(key, 0.0), time) for key in self.reads}


@dataclass(frozen=True)
class ComputedTorque(DeclaredLaw):
    """Inverse dynamics for the acceleration d2r/dt2 - d (dx/dt - dr/dt) - k (x - r).

    All laws of computed torque of a scene act together: their forces cause the commanded accelerations in
    the controller's model. The model has the poses and velocities, gravity, springs, dampers, wrenches,
    rotors and prescribed motions, but neither the wind nor other control laws.

    Attributes:
        joint: name of the driven joint.
        stiffness: k in 1/s^2, the square of the angular frequency with which errors vanish.
        damping: d in 1/s; 2 sqrt(k) is critical.
        target: set-point r of the joint coordinate, m or rad from the initial pose, or a function of time.
        coordinate: which of the joint's coordinates, from 0.
        feedforward: u_0 in N or N m, added to the force, a number or a function of time.
        model: parameter values of the controller's model that differ from the scene, by name, such as
            `{"panel.mass": 0.9}`; the same for all laws of computed torque of a scene.

    Raises:
        MechanismError: naming the joint and the value at fault.

    Examples:
        >>> law = ComputedTorque("hinge", stiffness=100.0, damping=20.0, target=Sine(0.1, 2.0))
        >>> float(law.command(law.references(0.0), {("hinge", 0): (0.0, 0.0)}))  # rad/s^2
        4.0
    """

    joint: str
    stiffness: float
    damping: float
    target: float | TimeFunction
    coordinate: int = 0
    feedforward: float | TimeFunction = 0.0
    model: Mapping[str, Any] = ()  # type: ignore[assignment]

    number_fields: ClassVar = DeclaredLaw.number_fields | {
        "stiffness": NumberField("1/s^2", strength="actuator"),
        "damping": NumberField("1/s", strength="actuator"),
    }
    constant: ClassVar = DeclaredLaw.constant | {"model": "what a controller knows, the same in all runs"}
    uses_model = True

    def __post_init__(self) -> None:
        self.set_numbers(self.element)
        check_key(self.element, self.joint, self.coordinate)
        given: Any = {} if isinstance(self.model, tuple) and not self.model else self.model
        try:
            model = {name: real_array(value).tolist() for name, value in given.items()}
        except (AttributeError, TypeError, ValueError, OverflowError) as error:
            needed = "a mapping from names of parameters to their values"
            raise MechanismError(self.element, f"model is {quoted(given)}", needed) from error
        object.__setattr__(self, "model", model)

    @property
    def feedback(self) -> Mapping[Key, tuple[float, float]]:
        return {}

    @property
    def reads(self) -> tuple[Key, ...]:
        return (self.key,)

    def command(self, references: Mapping[Key, Reference], readings: Readings) -> Scalar:
        """Compute the acceleration that it asks for, m/s^2 or rad/s^2."""
        r, (x, x_rate) = references[self.key], readings[self.key][:2]
        return r.acceleration - self.damping * (x_rate - r.rate) - self.stiffness * (x - r.value)


def commands(laws: Sequence[object], readings: Readings, time: float) -> list[float]:
    """Compute the accelerations (m/s^2 or rad/s^2) that the laws of computed torque among others ask for."""
    torque = (law for law in laws if isinstance(law, ComputedTorque))
    return [float(law.command(law.references(time), readings)) for law in torque]


def sensed(laws: Sequence[ControlLaw]) -> tuple[Key, ...]:
    """List the joint coordinates that laws act on, in their order, then others that they read."""
    own, others = [law.key for law in laws], [key for law in laws for key in law.reads]
    return tuple(dict.fromkeys([*own, *others]))


class DrivenLaws:
    """The PD laws that depend on time among others, all sines at once, for engines that Python evaluates.

    Without feedback, at x = 0 and dx/dt = 0, their force is w = u_0 + K_p r + K_d dr/dt.

    Attributes:
        places: (n,) numbers of these laws among all.
    """

    def __init__(self, laws: Sequence[object]) -> None:
        driven = [(k, law) for k, law in enumerate(laws) if isinstance(law, PD) and law.is_driven]
        self.places = np.array([k for k, _ in driven], dtype=int)
        self._constant = np.zeros(len(driven))
        sines: list[tuple[int, float, float, Sine]] = []
        self._others: list[tuple[int, float, float, TimeFunction]] = []
        self._jumping: list[tuple[int, int]] = []
        for n, (k, law) in enumerate(driven):
            if law.jumps:
                self._jumping.append((n, k))
                continue
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
                        self._others.append((n, gain, rate_gain, term))
        # a law's share of each sine, and of each cosine, which is of the sine's rate
        self._of_sine, self._of_cosine = np.zeros((2, len(driven), len(sines)))
        for column, (n, gain, rate_gain, sine) in enumerate(sines):
            self._constant[n] += gain * sine.offset
            self._of_sine[n, column] = gain * sine.amplitude
            self._of_cosine[n, column] = rate_gain * sine.amplitude * sine.angular_frequency
        self._frequency = np.array([sine.angular_frequency for *_, sine in sines])
        self._phase = np.array([sine.phase for *_, sine in sines])

    def at(self, laws: Sequence[object], time: float) -> Array:
        """Compute w (n,), N or N m, at a time in s, by laws whose functions are held between their jumps."""
        angle = self._frequency * time + self._phase
        found = self._constant + self._of_sine @ np.sin(angle) + self._of_cosine @ np.cos(angle)
        for n, k_p, k_d, function in self._others:
            found[n] += k_p * function.value(time) + k_d * function.rate(time)
        for n, k in self._jumping:
            law = laws[k]
            assert isinstance(law, PD)
            found[n] = law.force(0.0, 0.0, time)
        return np.asarray(found)
