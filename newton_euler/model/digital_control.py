"""Control laws in discrete time: the force is computed at sampling instants and held constant in between.

`Sampled` calls a Python function of the user. `Digital` executes a declared law, such as `PD`, as an embedded
computer does: with a sampling period, delay, encoder resolution, and limits of force, slew rate and
set-point. A run creates the controllers of all laws with `HeldLaw.controller_of` and calls them once a
period.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

import numpy as np

from newton_euler.errors import (
    MechanismError,
    check_key,
    is_finite_number,
    is_whole,
    items_of,
    quoted,
)
from newton_euler.model.control import (
    NO_FORCES,
    PD,
    ComputedTorque,
    ControlLaw,
    DeclaredLaw,
    Readings,
    Reference,
    StateFeedback,
    sensed,
)
from newton_euler.model.fields import NumberField
from newton_euler.model.joint import Key
from newton_euler.model.variable import Change
from newton_euler.scalars import Array, Floats, Scalar

Controller = Callable[[float, Floats, Floats], float]
"""Function of time (s), coordinates (a,) in m or rad, and their rates (a,), that returns a force, N or N m.

The coordinates on which the control laws of the scene act come first, in the order of the laws. Other
coordinates that laws read follow.
"""


Model = Callable[[Readings, Sequence[float], float], Mapping[Key, float]]
"""Function that computes forces, N or N m, from a model of the mechanism: gravity compensation and computed
torque.

Its arguments are the readings of joint coordinates, the commanded accelerations of all `ComputedTorque` laws
in the order of the laws, and the time in s. It returns the forces by joint coordinate.
"""


MIN_PERIOD = 1e-6
"""Shortest sampling period, s. Each simulated second then takes a million calls of Python; real controllers
are slower."""

MAX_DELAY_SAMPLES = 1_000_000
"""Longest delay from reading to acting, in samples; the delayed forces then take some megabytes of memory."""


class HeldLaw(ControlLaw):
    """Base class of control laws that are evaluated once a period; the force is held constant in between.

    Attributes:
        period: sampling period, s, at least `MIN_PERIOD`; the first sample is at time 0.
        held: force that is held at present, N or N m: a parameter that a run changes at each sampling
            instant.
    """

    period: float
    held: float

    # Attributes that may differ between runs or sampling instants: the unit, and the unit at a hinge
    # (`unit_about`). The constructor checks attributes without a shape.
    number_fields: ClassVar = {
        "held": NumberField("N", unit_about="N m"),
        "period": NumberField("s", shape=None),
    }

    @property
    def parameters(self) -> tuple[str, ...]:
        """No names: comparisons of engines do not vary the numbers of a controller."""
        return ()

    @property
    def variables(self) -> tuple[str, ...]:
        return tuple(self.number_fields)

    def _check_period(self) -> None:
        """Convert the period to a float; raises `MechanismError` if it is too short or not finite."""
        if not is_finite_number(self.period) or self.period < MIN_PERIOD:
            needed = f"a number of seconds, at least {MIN_PERIOD:g}"
            raise MechanismError(self.element, f"period is {quoted(self.period)}", needed)
        object.__setattr__(self, "period", float(self.period))

    def rebuilt(self, values: Mapping[str, Any]) -> Self:
        if "held" in values:
            raise MechanismError(self.element, "held is the force at present", "numbers of the controller")
        return super().rebuilt(values)

    def force(self, x: Scalar, x_rate: Scalar, time: Scalar) -> Scalar:
        """Return the held force, N or N m, whatever the coordinate, its rate and the time are."""
        return self.held

    def controller_of(self, laws: Sequence[ControlLaw], model: Model | None = None) -> Controller:
        """Create the controller of this law for one run, in its state at time 0.

        Args:
            laws: all control laws of the scene.
            model: computes the forces of laws that use a model of the mechanism; None if no law uses one.
        """
        raise NotImplementedError


@dataclass(frozen=True)
class Sampled(HeldLaw):
    """A controller that is a Python function, called once a period; the force is held constant in between.

    Attributes:
        joint: name of the driven joint.
        controller: function `controller(time, x, x_rate)` that returns the force on the driven coordinate, N
            or N m. `time` is in s. `x` (a,) and `x_rate` (a,) are all coordinates, m or rad from the initial
            pose, on which control laws of the scene act, in the order of `Scene.control`, and their rates;
            other coordinates that laws read follow. If the function has a state, it must reset the state when
            it is called with time 0, because a scene may be run several times.
        period: sampling period, s, at least 1e-6; the first call is at time 0.
        coordinate: index of the driven joint coordinate, from 0.
        held: force that is held at present, N or N m; runs set it at each call.

    Raises:
        MechanismError: naming the joint and the invalid value.

    Examples:
        >>> first = Sampled("slide_12", lambda time, x, v: 50.0 * (0.01 - x[0]) - 5.0 * v[0], period=0.01)
        >>> second = Sampled("slide_13", lambda time, x, v: -50.0 * x[1] - 5.0 * v[1], period=0.01)
        >>> run = simulate(replace(load("tracker"), control=[first, second]))
        >>> print(*(run.joint(law.joint).coordinates[-1].round(3) for law in (first, second)))  # m
        [0.01] [0.]
    """

    joint: str
    controller: Controller
    period: float
    coordinate: int = 0
    held: float = 0.0

    def __post_init__(self) -> None:
        where = self.element
        if not callable(self.controller):
            raise MechanismError(where, f"controller is {quoted(self.controller)}", "something to call")
        self._check_period()
        check_key(where, self.joint, self.coordinate)

    def controller_of(self, laws: Sequence[ControlLaw], model: Model | None = None) -> Controller:
        return self.controller


@dataclass(frozen=True)
class Digital(HeldLaw):
    """A declared law as an embedded computer executes it, with the limits of its encoder and its actuator.

    At each sampling instant the computer reads the coordinates and limits the set-points to the stroke. It
    computes the force of the law, limits the force, and limits the change of the force since the previous
    instant. The actuator applies the force `delay` samples later. Before the first force arrives, the
    actuator applies 0. The first change is limited relative to a force of 0.

    An encoder with a resolution reads the nearest multiple of it. Rates are then differences of the last two
    readings, divided by the period, and 0 at the first instant. With resolution 0, coordinates and rates are
    exact. If the law reads coordinates that other `Digital` laws drive, the encoders and strokes of those
    laws apply to them.

    Attributes:
        law: the law that the computer executes: `PD`, `StateFeedback` or `ComputedTorque`.
        period: sampling period, s, at least 1e-6; the first sample is at time 0.
        delay: number of samples from reading to acting, at most 1,000,000.
        resolution: encoder resolution, m or rad; 0 for exact readings.
        force_limit: largest magnitude of the force, N or N m.
        slew_limit: largest rate of the force, N/s or N m/s.
        stroke: smallest and largest set-point, m or rad from the initial pose. A set-point beyond is moved to
            the nearest end, with rate and acceleration 0.
        joint, coordinate: joint coordinate of the law; no arguments.
        held: force that the actuator holds at present, N or N m; no argument, as runs change it.

    Raises:
        MechanismError: naming the joint and the invalid value.

    Examples:
        >>> first, second = (PD(name, 50.0, 5.0, target=0.02) for name in ("slide_12", "slide_13"))
        >>> laws = [Digital(law, period=0.01, force_limit=0.5) for law in (first, second)]
        >>> run = simulate(replace(load("tracker"), control=laws))
        >>> print(np.abs(np.asarray(run.actuator_force)).max())  # N; the laws ask for 1 N at the start
        0.5
    """

    law: DeclaredLaw
    period: float
    delay: int = 0
    resolution: float = 0.0
    force_limit: float = np.inf
    slew_limit: float = np.inf
    stroke: tuple[float, float] = (-np.inf, np.inf)
    held: float = field(init=False, default=0.0)
    joint: str = field(init=False)
    coordinate: int = field(init=False)

    number_fields: ClassVar = HeldLaw.number_fields | {
        "resolution": NumberField("m", unit_about="rad", least=0.0),
        "force_limit": NumberField("N", unit_about="N m", shape=None),
        "slew_limit": NumberField("N/s", unit_about="N m/s", shape=None),
        "stroke": NumberField(shape=None, allowed="constructor"),  # it checks both ends
    }
    constant: ClassVar = HeldLaw.constant | {"delay": "a whole number of samples"}  # why it cannot vary

    def __post_init__(self) -> None:
        if not isinstance(self.law, DeclaredLaw):
            raise MechanismError(
                "digital control", f"law is {quoted(self.law)}", "a declared law, such as PD"
            )
        object.__setattr__(self, "joint", self.law.joint)
        object.__setattr__(self, "coordinate", self.law.coordinate)
        where = self.element
        self._check_period()
        if not is_whole(self.delay) or not 0 <= int(self.delay) <= MAX_DELAY_SAMPLES:
            needed = f"a number of samples, 0 to {MAX_DELAY_SAMPLES}"
            raise MechanismError(where, f"delay is {quoted(self.delay)}", needed)
        self.set_numbers(where)
        for name in ("force_limit", "slew_limit"):
            value = getattr(self, name)
            if not _is_limit(value) or not value > 0.0:
                raise MechanismError(where, f"{name} is {quoted(value)}", "a positive number, or infinity")
        ends = items_of(self.stroke) or ()
        if len(ends) != 2 or not all(map(_is_limit, ends)) or not ends[0] <= ends[1]:
            raise MechanismError(where, f"stroke is {quoted(self.stroke)}", "the lower end and the upper one")
        object.__setattr__(self, "stroke", tuple(map(float, ends)))

    @property
    def variables(self) -> tuple[str, ...]:
        """Names of all numbers that may vary: those of this class, then those of the declared law."""
        return (*self.number_fields, *self.law.variables)

    def field_of(self, name: str) -> NumberField:
        return self.law.field_of(name) if name in self.law.variables else super().field_of(name)

    @property
    def constants(self) -> dict[str, str]:
        return self.law.constants | super().constants

    def number(self, name: str) -> Array:
        return self.law.number(name) if name in self.law.variables else super().number(name)

    def fields_with(self, values: Mapping[str, Any], change: Change) -> dict[str, Any]:
        # numbers of the declared law go to a copy of the law, which `change` makes
        of_law = {name: value for name, value in values.items() if name in self.law.variables}
        of_digital = {name: value for name, value in values.items() if name not in of_law}
        fields = super().fields_with(of_digital, change)
        return fields | {"law": change(self.law, **self.law.fields_with(of_law, change))}

    @property
    def reads(self) -> tuple[Key, ...]:
        return self.law.reads

    def controller_of(self, laws: Sequence[ControlLaw], model: Model | None = None) -> Controller:
        return DigitalController(self, laws, model)

    def within_stroke(self, reference: Reference) -> Reference:
        """Move a set-point to the nearest value within the stroke; its rate and acceleration are 0 if it is
        moved."""
        low, high = self.stroke
        if low <= reference.value <= high:
            return reference
        return Reference(low if reference.value < low else high, 0.0, 0.0)


class DigitalController:
    """Controller of a `Digital` law during one run, with its state: last reading, last force, and delayed
    forces.

    The instance is called once a period, see `Controller`.
    """

    def __init__(self, law: Digital, laws: Sequence[ControlLaw], model: Model | None) -> None:
        """Start in the state at time 0; arguments are those of `HeldLaw.controller_of`."""
        # `_keys`: joint coordinates of the readings. `_digital_laws`: digital laws by driven coordinate
        self._law, self._keys, self._model = law, sensed(laws), model
        self._digital_laws = {each.key: each for each in laws if isinstance(each, Digital)}
        self._resolution = np.array(
            [self._digital_laws[key].resolution if key in self._digital_laws else 0.0 for key in self._keys]
        )
        self._last_reading: Array | None = None
        self._last_force = 0.0
        self._delayed_forces = deque([0.0] * law.delay)

    def __call__(self, time: float, x: Array, x_rate: Array) -> float:
        """Return the force, N or N m, that the actuator applies from a sampling instant on, see
        `Controller`."""
        digital, law = self._law, self._law.law
        # Read the encoders
        pairs = zip(*self._read(x, x_rate), strict=True)  # (coordinate, rate)
        readings = dict(zip(self._keys, pairs, strict=True))

        # Compute the forces that the model of the mechanism demands, for the commanded accelerations of all
        # computed-torque laws
        model_forces = NO_FORCES
        if law.uses_model:
            assert self._model is not None
            laws = [each.law for each in self._digital_laws.values()]
            torque_laws = [each for each in laws if isinstance(each, ComputedTorque)]
            commands = [float(each.command(self._references(each, time), readings)) for each in torque_laws]
            model_forces = self._model(readings, commands, time)

        # Compute the force towards the set-points, limit it and its change, and delay it
        force = float(law.towards(self._references(law, time), readings, time, model_forces))
        force = float(np.clip(force, -digital.force_limit, digital.force_limit))
        max_change = digital.slew_limit * digital.period
        self._last_force = float(np.clip(force, self._last_force - max_change, self._last_force + max_change))
        self._delayed_forces.append(self._last_force)
        return self._delayed_forces.popleft()

    def _references(self, law: DeclaredLaw, time: float) -> dict[Key, Reference]:
        """Return the set-points, at a time in s, of the coordinates that a law reads, limited to their
        strokes."""
        return {
            key: self._digital_laws[key].within_stroke(reference) if key in self._digital_laws else reference
            for key, reference in law.references(time).items()
        }

    def _read(self, x: Array, x_rate: Array) -> tuple[Array, Array]:
        """Return coordinates (a,) and rates (a,) as the encoders read them, and store the reading.

        A coordinate whose encoder has no resolution is read exactly.
        """
        quantized = self._resolution > 0.0
        steps = np.where(quantized, self._resolution, 1.0)
        x = np.where(quantized, steps * np.round(x / steps), x)
        previous = x if self._last_reading is None else self._last_reading
        self._last_reading = x
        return x, np.where(quantized, (x - previous) / self._law.period, x_rate)


def _is_limit(value: object) -> bool:
    """Return True for a finite number and for infinity of either sign."""
    return is_finite_number(value) or (isinstance(value, float) and bool(np.isinf(value)))


Law = PD | StateFeedback | ComputedTorque | Sampled | Digital
"""Every kind of control law that a scene can have."""
