"""Control laws in discrete time, whose force is held from one sampling instant to the next."""

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
"""Function of time (s), coordinates (a,) and rates (a,) that returns a force, N or N m.

The coordinates of all laws of the scene come first, in order, then other coordinates that laws read."""


Model = Callable[[Readings, Sequence[float], float], Mapping[Key, float]]
"""Function of readings, commanded accelerations of the laws of computed torque, in order, and time (s) that
returns the forces of laws with a model of the mechanism, N or N m."""


SHORTEST_PERIOD = 1e-6  # s; no digital controller is quicker, and Python is called a million times a second
LONGEST_DELAY = 1_000_000  # samples: a second of the shortest period, and some megabytes of forces under way


class HeldLaw(ControlLaw):
    """A control law that is evaluated once a period; the force is held in between.

    Attributes:
        period: s between its calls, at least `SHORTEST_PERIOD`; the first is at time 0.
        held: N or N m, the force at present.
    """

    period: float
    held: float

    number_fields: ClassVar = {"held": NumberField("N", "N m"), "period": NumberField("s", shape=None)}

    @property
    def parameters(self) -> tuple[str, ...]:
        return ()  # comparisons of models change no number of a controller

    @property
    def variables(self) -> tuple[str, ...]:
        return tuple(self.number_fields)

    def _check_period(self) -> None:
        if not is_finite_number(self.period) or self.period < SHORTEST_PERIOD:
            needed = f"a number of seconds, at least {SHORTEST_PERIOD:g}"
            raise MechanismError(self.element, f"period is {quoted(self.period)}", needed)
        object.__setattr__(self, "period", float(self.period))

    def rebuilt(self, values: Mapping[str, Any]) -> Self:
        if "held" in values:
            raise MechanismError(self.element, "held is the force at present", "numbers of the controller")
        return super().rebuilt(values)

    def force(self, x: Scalar, x_rate: Scalar, time: Scalar) -> Scalar:
        """Return the held force, N or N m."""
        return self.held

    def controller_of(self, laws: Sequence[ControlLaw], model: Model | None = None) -> Controller:
        """Return the controller for one run of a scene with these laws, in its state at time 0.

        `model` is for laws that know the mechanism.
        """
        raise NotImplementedError


@dataclass(frozen=True)
class Sampled(HeldLaw):
    """A controller in Python, called once a period; the force is held in between.

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
    """A declared law as a computer executes it, with the limits of its encoder and its actuator.

    At each of its instants t_k it reads the coordinates, computes the law's force for set-points within the
    stroke, limits it, and then its change since the instant before; `delay` samples later the actuator has
    it. Before its first force arrives the actuator's is 0, and so is the one that the first change counts
    from. An encoder reads the nearest multiple of its resolution, and rates are differences of its readings
    over the period, 0 at the first instant; without an encoder's resolution both are read as they are. Where
    a law reads coordinates of others, their encoders and strokes are those of the laws there.

    Attributes:
        law: the declared law.
        period: s between its calls, at least `SHORTEST_PERIOD`; the first is at time 0.
        delay: whole samples from reading to acting, at most `LONGEST_DELAY`.
        resolution: of the encoder, m or rad; 0 for exact readings.
        force_limit: N or N m, the largest magnitude.
        slew_limit: N/s or N m/s, the largest rate of the force.
        stroke: least and largest set-point, m or rad from the initial pose; at either end its rate is 0.
        held: N or N m, the force at present.
        joint, coordinate: those of the law.

    Raises:
        MechanismError: naming the joint and the value at fault.

    Examples:
        >>> law = Digital(PD("hinge", 10.0, 1.0, target=1.0), period=0.01, force_limit=2.0)
        >>> law.controller_of([law])(0.0, np.zeros(1), np.zeros(1))  # N m, of the 10 that the law asks for
        2.0
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
        "resolution": NumberField("m", "rad", least=0.0),
        "force_limit": NumberField("N", "N m", shape=None),
        "slew_limit": NumberField("N/s", "N m/s", shape=None),
        "stroke": NumberField(shape=None, allowed="joint"),
    }
    constant: ClassVar = HeldLaw.constant | {"delay": "a whole number of samples"}

    def __post_init__(self) -> None:
        if not isinstance(self.law, DeclaredLaw):
            raise MechanismError(
                "digital control", f"law is {quoted(self.law)}", "a declared law, such as PD"
            )
        object.__setattr__(self, "joint", self.law.joint)
        object.__setattr__(self, "coordinate", self.law.coordinate)
        where = self.element
        self._check_period()
        if not is_whole(self.delay) or not 0 <= int(self.delay) <= LONGEST_DELAY:
            needed = f"a number of samples, 0 to {LONGEST_DELAY}"
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
        return (*self.number_fields, *self.law.variables)

    def field_of(self, name: str) -> NumberField:
        return self.law.field_of(name) if name in self.law.variables else super().field_of(name)

    @property
    def constants(self) -> dict[str, str]:
        return self.law.constants | super().constants

    def number(self, name: str) -> Array:
        return self.law.number(name) if name in self.law.variables else super().number(name)

    def fields_with(self, values: Mapping[str, Any], change: Change) -> dict[str, Any]:
        of_law = {name: value for name, value in values.items() if name in self.law.variables}
        own = {name: value for name, value in values.items() if name not in of_law}
        fields = super().fields_with(own, change)
        return fields | {"law": change(self.law, **self.law.fields_with(of_law, change))}

    @property
    def reads(self) -> tuple[Key, ...]:
        return self.law.reads

    def controller_of(self, laws: Sequence[ControlLaw], model: Model | None = None) -> Controller:
        return Computer(self, laws, model)

    def within_stroke(self, wanted: Reference) -> Reference:
        """Move a set-point into the stroke."""
        low, high = self.stroke
        if low <= wanted.value <= high:
            return wanted
        return Reference(low if wanted.value < low else high, 0.0, 0.0)


class Computer:
    """State of the computer of a `Digital` law during one run: readings and commands."""

    def __init__(self, law: Digital, laws: Sequence[ControlLaw], model: Model | None) -> None:
        self._law, self._keys, self._model = law, sensed(laws), model
        self._others = {each.key: each for each in laws if isinstance(each, Digital)}
        self._resolution = np.array(
            [self._others[key].resolution if key in self._others else 0.0 for key in self._keys]
        )
        self._before: Array | None = None
        self._force = 0.0
        self._under_way = deque([0.0] * law.delay)

    def __call__(self, time: float, x: Array, x_rate: Array) -> float:
        law = self._law
        readings = dict(zip(self._keys, zip(*self._read(x, x_rate), strict=True), strict=True))
        known = NO_FORCES
        if law.law.uses_model:
            assert self._model is not None
            others = [each.law for each in self._others.values()]
            torque = [each for each in others if isinstance(each, ComputedTorque)]
            commands = [float(each.command(self._references(each, time), readings)) for each in torque]
            known = self._model(readings, commands, time)
        force = float(law.law.towards(self._references(law.law, time), readings, time, known))
        force = float(np.clip(force, -law.force_limit, law.force_limit))
        change = law.slew_limit * law.period
        self._force = float(np.clip(force, self._force - change, self._force + change))
        self._under_way.append(self._force)
        return self._under_way.popleft()

    def _references(self, law: DeclaredLaw, time: float) -> dict[Key, Reference]:
        """Return the set-points of the coordinates that a law reads, within their strokes."""
        return {
            key: self._others[key].within_stroke(wanted) if key in self._others else wanted
            for key, wanted in law.references(time).items()
        }

    def _read(self, x: Array, x_rate: Array) -> tuple[Array, Array]:
        """Quantize coordinates (a,) and rates (a,) as encoders do."""
        coarse = self._resolution > 0.0
        steps = np.where(coarse, self._resolution, 1.0)
        x = np.where(coarse, steps * np.round(x / steps), x)
        before = x if self._before is None else self._before
        self._before = x
        return x, np.where(coarse, (x - before) / self._law.period, x_rate)


def _is_limit(value: object) -> bool:
    """Return True for a finite number and for infinity of either sign."""
    return is_finite_number(value) or (isinstance(value, float) and bool(np.isinf(value)))


Law = PD | StateFeedback | ComputedTorque | Sampled | Digital
