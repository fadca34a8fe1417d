"""Control laws in continuous time that are declared by numbers: PD, state feedback and computed torque.

Every engine evaluates these laws at each state and time. A control law acts on one coordinate of an actuated
joint, a hinge angle or a slide; a key (name of a joint, index) identifies a coordinate. Some laws use a model
of the mechanism: gravity compensation and computed torque. Controllers that are Python functions, and laws in
discrete time, are in `newton_euler.model.digital_control`.
"""

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
from newton_euler.scalars import Array, Scalar

# Declarations of attributes: the unit at a slide, the unit about a hinge, and as `strength` the effect (if
# any) that is proportional to the attribute. For shape=None the constructor checks the values
TARGET = NumberField("m", unit_about="rad", may_be_function=True)
FEEDFORWARD = NumberField("N", unit_about="N m", may_be_function=True, strength="actuator")

NO_FORCES: Mapping[Key, Scalar] = {}
"""Forces by joint coordinate that a model of the mechanism demands, if no law uses a model."""

Readings = Mapping[Key, Sequence[Any]]
"""Measured values by joint coordinate: a sequence whose first two values are the coordinate, m or rad, and
its rate."""


class Reference(NamedTuple):
    """Set-point of a joint coordinate, m or rad, with its first and second derivative by time."""

    value: Scalar
    rate: Scalar
    acceleration: Scalar


def reference(target: float | TimeFunction, time: Scalar) -> Reference:
    """Evaluate a target (a number, m or rad, or a function of time) at a time in s."""
    if isinstance(target, TimeFunction):
        return Reference(target.value(time), target.rate(time), target.acceleration(time))
    return Reference(target, 0.0, 0.0)


class ControlLaw(CoordinateForce):
    """Base class of all control laws; a law drives one coordinate of an actuated joint."""

    noun = "control"

    def check(self, mechanism: Mechanism) -> None:
        """Raise `MechanismError` unless the mechanism has the joint coordinate and the joint is actuated."""
        super().check(mechanism)
        if not mechanism.joint(self.joint).actuated:
            raise MechanismError(self.element, "the joint is not actuated", "an actuated joint")

    @property
    def reads(self) -> tuple[Key, ...]:
        """Joint coordinates on which the law depends."""
        return (self.key,)


class DeclaredLaw(ControlLaw):
    """Base class of control laws that are a declared function of joint coordinates, their rates and time.

    Attributes:
        target: set-point of the driven coordinate, m or rad from the initial pose, a number or a function of
            time.
        feedforward: force u_0 that is added, N or N m, a number or a function of time.
    """

    target: float | TimeFunction
    feedforward: float | TimeFunction

    number_fields: ClassVar = {
        "stiffness": NumberField("N/m", unit_about="N m/rad", strength="actuator"),
        "damping": NumberField("N s/m", unit_about="N m s/rad", strength="actuator"),
        "target": TARGET,
        "feedforward": FEEDFORWARD,
    }

    @property
    def feedback(self) -> Mapping[Key, tuple[float, float]]:
        """Feedback gains (K_p, K_d), SI units, by the joint coordinate that they multiply."""
        raise NotImplementedError

    @property
    def reads(self) -> tuple[Key, ...]:
        return tuple(self.feedback)

    def references(self, time: Scalar) -> dict[Key, Reference]:
        """Return the set-points at a time in s, by joint coordinate that the law reads."""
        return {self.key: reference(self.target, time)}

    def feedforward_at(self, time: Scalar) -> Scalar:
        """Return the feedforward u_0 (N or N m) at a time in s."""
        u_0 = self.feedforward
        return u_0.value(time) if isinstance(u_0, TimeFunction) else u_0

    @property
    def uses_model(self) -> bool:
        """True if a model of the mechanism computes the force or a part of it."""
        return False

    def towards(
        self,
        references: Mapping[Key, Reference],
        readings: Readings,
        time: Scalar,
        model: Mapping[Key, Scalar] = NO_FORCES,
    ) -> Scalar:
        """Compute the force (N or N m) that drives the readings towards the set-points.

        Args:
            references: set-points by joint coordinate, see `references`. A law in discrete time
                (`digital_control.Digital`) limits them to the stroke of the joint.
            readings: measured coordinates and rates by joint coordinate.
            time: s.
            model: force by joint coordinate, N or N m, that a model of the mechanism demands; it is added if
                the law uses a model.
        """
        force = self.feedforward_at(time)
        for key, (k_p, k_d) in self.feedback.items():
            r, (x, x_rate) = references[key], readings[key][:2]
            force = force - (k_p * (x - r.value) + k_d * (x_rate - r.rate))
        return force + model.get(self.key, 0.0) if self.uses_model else force

    def at_joint(self, at: Surroundings) -> Scalar:
        """Compute the force (N or N m) from the time and joint coordinates of a state.

        `at.model` computes the forces that the model demands.
        """
        model = at.model() if self.uses_model else NO_FORCES
        return self.towards(self.references(at.time), at.measured, at.time, model)


@dataclass(frozen=True)
class PD(DeclaredLaw):
    """PD controller for one joint coordinate: u = u_0 + K_p (r - x) + K_d (dr/dt - dx/dt).

    This is eq. (23) of S. Srang, S. Ath and M. Yamakita, Advances in Science, Technology and Engineering
    Systems Journal 5(5), 2020, doi:10.25046/aj050587, with the sign that makes the loop stable.

    Attributes:
        joint: name of the driven joint.
        stiffness: K_p in N/m or N m/rad.
        damping: K_d in N s/m or N m s/rad.
        target: set-point r of the joint coordinate, m or rad from the initial pose, a number or a function of
            time.
        coordinate: index of the driven joint coordinate, from 0.
        feedforward: u_0 in N or N m, a number or a function of time.
        gravity_compensation: True adds the force that holds the mechanism at rest against gravity, springs
            and wrenches, but not against wind. All laws of a scene with gravity compensation hold it
            together.

    Raises:
        MechanismError: naming the joint and the invalid value.

    Examples:
        >>> first, second = (PD(slide, 200.0, 20.0, target=0.01) for slide in ("slide_12", "slide_13"))
        >>> run = simulate(replace(load("tracker"), control=[first, second]))
        >>> print(run.joint("slide_12").coordinates[-1].round(4))  # m
        [0.01]
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
    def depends_on_time(self) -> bool:
        """True if the target or the feedforward is a function of time."""
        return isinstance(self.target, TimeFunction) or isinstance(self.feedforward, TimeFunction)

    @property
    def has_jumps(self) -> bool:
        """True if the value of the target or of the feedforward jumps at some time."""
        return any(f.jumps for f in (self.target, self.feedforward) if isinstance(f, TimeFunction))

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
    """State feedback from several joint coordinates x_j to one driven coordinate.

    The force is u = u_0 - sum_j (K_pj (x_j - r_j) + K_dj (dx_j/dt - dr_j/dt)).

    Attributes:
        joint: name of the driven joint.
        gains: (K_pj, K_dj), SI units, of each coordinate that the law reads, by the name of its joint, or by
            (name, index) for another coordinate than the first of a joint.
        target: set-point r of the driven coordinate, m or rad from the initial pose, a number or a function
            of time.
        coordinate: index of the driven joint coordinate, from 0.
        feedforward: u_0 in N or N m, a number or a function of time.
        targets: set-points r_j of the other coordinates, by the same names as `gains`; 0 if not given.

    Raises:
        MechanismError: naming the joint and the invalid value.

    Examples:
        >>> first = StateFeedback("slide_12", {"slide_12": (200.0, 20.0)}, target=0.01)
        >>> second = StateFeedback("slide_13", {"slide_13": (200.0, 20.0), "slide_12": (-100.0, 0.0)})
        >>> run = simulate(replace(load("tracker"), control=[first, second]))
        >>> print(*(run.joint(law.joint).coordinates[-1].round(4) for law in (first, second)))  # m
        [0.01] [0.005]
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
        """Return an attribute whose keys are joint names as a mapping from joint coordinates, with checked
        values.

        Args:
            name: name of the attribute, "gains" or "targets".
            shape: shape of each value; () also allows functions of time.
        """
        given: Any = getattr(self, name)
        given = {} if isinstance(given, tuple) and not given else given
        if not isinstance(given, Mapping):
            raise MechanismError(self.element, f"{name} is {quoted(given)}", "a mapping from names of joints")
        values: dict[Key, Any] = {}
        for label, value in given.items():
            key = label if isinstance(label, tuple) and len(label) == 2 else (label, 0)
            check_key(f"{name} of {self.element}", *key)
            if shape or not isinstance(value, TimeFunction):
                value = finite_array(self.element, f"{name} of joint {quoted(key[0])}", value, shape).tolist()
            values[key] = value
        return values

    def check(self, mechanism: Mechanism) -> None:
        super().check(mechanism)
        for joint, coordinate in self.reads:
            if joint not in mechanism.joint_names:
                needed = f"names out of {listed(mechanism.joint_names)}"
                raise MechanismError(self.element, f"gains has {quoted(joint)}", needed)
            check_coordinate(self.element, mechanism.joint(joint), coordinate)

    @property
    def feedback(self) -> Mapping[Key, tuple[float, float]]:
        gains: Any = self.gains  # the constructor has replaced joint names by keys (name, index)
        return gains

    def references(self, time: Scalar) -> dict[Key, Reference]:
        targets = {**self.targets, self.key: self.target}
        return {key: reference(targets.get(key, 0.0), time) for key in self.reads}


@dataclass(frozen=True)
class ComputedTorque(DeclaredLaw):
    """Computed-torque control: inverse dynamics for the acceleration d2r/dt2 - d (dx/dt - dr/dt) - k (x - r).

    All computed-torque laws of a scene act together: their forces cause the commanded accelerations in the
    controller's model of the mechanism. The model includes gravity, springs, dampers, wrenches, armatures and
    prescribed motions, but neither wind nor other control laws.

    Attributes:
        joint: name of the driven joint.
        stiffness: k in 1/s^2, the square of the natural angular frequency of the control error.
        damping: d in 1/s; 2 sqrt(k) is critical damping.
        target: set-point r of the joint coordinate, m or rad from the initial pose, a number or a function of
            time.
        coordinate: index of the driven joint coordinate, from 0.
        feedforward: u_0 in N or N m, added to the force, a number or a function of time.
        model: values of parameters for which the controller's model differs from the scene, by parameter
            name, such as `{"panel.mass": 0.9}`; the same for all computed-torque laws of a scene.

    Raises:
        MechanismError: naming the joint and the invalid value.

    Examples:
        >>> wave = Sine(0.003, 2.0)  # m, rad/s
        >>> laws = [ComputedTorque(slide, 100.0, 20.0, target=wave) for slide in ("slide_12", "slide_13")]
        >>> run = simulate(replace(load("tracker_gravity"), control=laws))
        >>> error = run.joint("slide_12").coordinates[-1] - 0.003 * np.sin(2.0 * run.time[-1])
        >>> print(bool(abs(error) < 1e-6))  # m, after 5 s
        True
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
    # why an attribute cannot vary in parameter studies, by its name
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
        return {}  # the gains act on the acceleration, see `command`, instead of the force

    @property
    def reads(self) -> tuple[Key, ...]:
        return (self.key,)

    def command(self, references: Mapping[Key, Reference], readings: Readings) -> Scalar:
        """Compute the commanded acceleration, m/s^2 or rad/s^2, from set-points and readings by joint
        coordinate."""
        r, (x, x_rate) = references[self.key], readings[self.key][:2]
        return r.acceleration - self.damping * (x_rate - r.rate) - self.stiffness * (x - r.value)


def commands(laws: Sequence[object], readings: Readings, time: float) -> list[float]:
    """Compute the commanded accelerations (m/s^2 or rad/s^2) of the computed-torque laws among other laws.

    Args:
        laws: control laws of a scene; other laws than `ComputedTorque` are skipped.
        readings: measured coordinates and rates by joint coordinate.
        time: s.
    """
    torque_laws = (law for law in laws if isinstance(law, ComputedTorque))
    return [float(law.command(law.references(time), readings)) for law in torque_laws]


def sensed(laws: Sequence[ControlLaw]) -> tuple[Key, ...]:
    """List the joint coordinates that a controller measures.

    The coordinates on which laws act come first, in the order of the laws; other coordinates that laws read
    follow.
    """
    driven, read = [law.key for law in laws], [key for law in laws for key in law.reads]
    return tuple(dict.fromkeys([*driven, *read]))


class TimeDependentPD:
    """Fast evaluation of the PD laws of a scene whose target or feedforward depends on time.

    Engines whose control laws are evaluated in Python (MuJoCo and Pinocchio) use it: the sines of all laws
    are evaluated in one NumPy call. Only the part w of the force is evaluated that depends on time. It is the
    force at x = 0 and dx/dt = 0: w = u_0 + K_p r + K_d dr/dt.

    Attributes:
        law_indices: (n,) indices of the n time-dependent PD laws among all laws.
    """

    def __init__(self, laws: Sequence[object]) -> None:
        """Sort the terms of all functions of time: constants, sines, and other functions; and collect the
        laws with functions whose value jumps.

        Args:
            laws: all control laws of a scene.
        """
        chosen = [(k, law) for k, law in enumerate(laws) if isinstance(law, PD) and law.depends_on_time]
        self.law_indices = np.array([k for k, _ in chosen], dtype=int)
        self._constant = np.zeros(len(chosen))  # constant part of w of each law
        # (row of the law in w, gain of the value, gain of the rate, function)
        sines: list[tuple[int, float, float, Sine]] = []
        self._others: list[tuple[int, float, float, TimeFunction]] = []
        self._jumping: list[tuple[int, int]] = []  # (row of the law in w, index of the law)
        for n, (k, law) in enumerate(chosen):
            if law.has_jumps:
                self._jumping.append((n, k))
                continue
            for given, gain, rate_gain in (  # gains with which the value and its rate are in w
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

        # Factors of each sine in w, and of each cosine, which comes from the rate of the sine
        self._sine_factors, self._cosine_factors = np.zeros((2, len(chosen), len(sines)))
        for column, (n, gain, rate_gain, sine) in enumerate(sines):
            self._constant[n] += gain * sine.offset
            self._sine_factors[n, column] = gain * sine.amplitude
            self._cosine_factors[n, column] = rate_gain * sine.amplitude * sine.angular_frequency
        self._frequency = np.array([sine.angular_frequency for *_, sine in sines])
        self._phase = np.array([sine.phase for *_, sine in sines])

    def forces_at(self, laws: Sequence[object], time: float) -> Array:
        """Compute the time-dependent part w (n,), N or N m, of the laws `law_indices` at a time in s.

        Args:
            laws: all control laws of the scene. In place of each function that jumps, the caller passes its
                smooth piece around the time (`newton_euler.model.variable.Function.on_piece`).
            time: s.
        """
        angle = self._frequency * time + self._phase
        w = self._constant + self._sine_factors @ np.sin(angle) + self._cosine_factors @ np.cos(angle)
        for n, gain, rate_gain, function in self._others:
            w[n] += gain * function.value(time) + rate_gain * function.rate(time)
        for n, k in self._jumping:
            law = laws[k]
            assert isinstance(law, PD)
            w[n] = law.force(0.0, 0.0, time)
        return np.asarray(w)
