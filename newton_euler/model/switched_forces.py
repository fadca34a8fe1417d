"""Dry friction and end stops: forces on joint coordinates whose formulas change at certain states.

Such a *switched force* is continuous, but a derivative jumps where one of its *switching functions* changes
its sign. The formula depends on a switching function g only through its positive part max(g, 0). Integrators
end a step where g changes its sign, so that the force is smooth within each step. For this purpose they hold
a flag for each g during a step, 1 where g is positive and 0 elsewhere, and replace the positive part by
flag * g, which is smooth (`newton_euler.integrators.switches`). Without flags the state decides.

Forces are in N or N m, coordinates in m or rad from the initial pose.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, Self

from newton_euler.errors import MechanismError, check_key, quoted
from newton_euler.model.elements import CoordinateForce, PoseChange, Surroundings
from newton_euler.model.fields import NumberField
from newton_euler.scalars import Scalar, positive_part


class SwitchedForce(CoordinateForce):
    """Base class of forces whose formula depends on the positive parts of switching functions.

    Attributes:
        switch_count: number of the switching functions.
    """

    switch_count: ClassVar[int]

    def switching(self, x: Scalar, x_rate: Scalar) -> tuple[Scalar, ...]:
        """Compute the switching functions (switch_count,) from the coordinate and its rate, SI."""
        raise NotImplementedError

    def positive_parts(self, at: Surroundings) -> list[Scalar]:
        """Compute the positive parts of the switching functions, by flags if `at` has flags of this force."""
        values = self.switching(*self.measure(at))
        flags = at.branches.get(self.identity)
        if flags is None:
            return [positive_part(value) for value in values]
        return [flag * value for flag, value in zip(flags, values, strict=True)]


@dataclass(frozen=True)
class JointFriction(SwitchedForce):
    """Dry friction on a hinge or slide of a joint: Coulomb friction with the Stribeck effect, regularized.

    At the rate v the force is -(F_c + F_s / (1 + (v / v_s)^2)) sat(v / v_t), where sat limits its argument to
    -1 to 1. F_c is the Coulomb friction, and F_s the additional friction of slow motion, which falls with the
    Stribeck speed v_s. Below the transition speed v_t the friction is viscous, so that a joint that should
    stick creeps by less than v_t: the smaller v_t, the better the approximation and the stiffer the
    equations. Viscous friction at all speeds is the damping of a `JointSpring`.

    Sources: the Stribeck curve is that of D. P. Hess and A. Soom, Journal of Tribology 112 (1990), pp.
    147-152, as in the survey of B. Armstrong-Helouvry, P. Dupont and C. Canudas de Wit, Automatica 30 (1994),
    pp. 1083-1138. The saturation is that of S. Andersson, A. Soderberg and S. Bjorklund, Tribology
    International 40 (2007), pp. 580-587.

    Attributes:
        joint: name of the joint.
        coulomb: F_c, N or N m, 0 or more.
        stribeck: F_s, N or N m, 0 or more: the difference between static and Coulomb friction.
        stribeck_speed: v_s, m/s or rad/s, positive.
        transition_speed: v_t, m/s or rad/s, positive; well below `stribeck_speed`.
        coordinate: index of the joint coordinate, from 0.

    Raises:
        MechanismError: naming the joint and the invalid value.

    Examples:
        >>> friction = JointFriction("rail", coulomb=2.0)
        >>> friction.force(x=0.0, x_rate=0.5, time=0.0)  # N, against the motion
        -2.0
    """

    joint: str
    coulomb: float
    stribeck: float = 0.0
    stribeck_speed: float = 0.01
    transition_speed: float = 1e-3
    coordinate: int = 0

    noun = "friction"
    kind = "joint_friction"  # the name in scene files
    kind_of_parameters = ".friction"
    switch_count: ClassVar = 2
    number_fields: ClassVar = {
        "coulomb": NumberField("N", unit_about="N m", least=0.0, strength="friction"),
        "stribeck": NumberField("N", unit_about="N m", least=0.0, strength="friction"),
        "stribeck_speed": NumberField("m/s", unit_about="rad/s", positive=True),
        "transition_speed": NumberField("m/s", unit_about="rad/s", positive=True),
    }

    def __post_init__(self) -> None:
        self.set_numbers(self.element)
        check_key(self.element, self.joint, self.coordinate)

    def described_after(self, change: PoseChange) -> Self:
        return self  # friction does not depend on the coordinate

    def switching(self, x: Scalar, x_rate: Scalar) -> tuple[Scalar, ...]:
        ratio = x_rate / self.transition_speed
        return ratio - 1.0, -1.0 - ratio

    def at_joint(self, at: Surroundings) -> Scalar:
        _, rate = self.measure(at)
        return self._force(rate, *self.positive_parts(at))

    def force(self, x: Scalar, x_rate: Scalar, time: Scalar) -> Scalar:
        return self._force(x_rate, *map(positive_part, self.switching(x, x_rate)))

    def _force(self, rate: Scalar, above: Scalar, below: Scalar) -> Scalar:
        """Compute the force at a rate, m/s or rad/s, from the positive parts of both switching functions."""
        saturated = rate / self.transition_speed - above + below
        ratio = rate / self.stribeck_speed
        return -(self.coulomb + self.stribeck / (1.0 + ratio * ratio)) * saturated


@dataclass(frozen=True)
class JointStop(SwitchedForce):
    """An end stop of a hinge or slide: a spring and damper that act beyond a limit of the coordinate.

    The stop pushes back with k d (1 + c dd/dt) while the coordinate is beyond the limit by d > 0, and never
    pulls. The damping grows with the depth d, so that the force does not jump at the first touch. A mass that
    hits the stop with the speed v and meets no other force leaves with the speed w, where

        v - ln(1 + c v) / c = -w - ln(1 - c w) / c,

    so that w = (1 - 2 c v / 3) v for small c v. Two stops with a gap between them are a spring with play.
    Source: K. H. Hunt and F. R. E. Crossley, Journal of Applied Mechanics 42 (1975), pp. 440-445, with the
    exponent 1.

    Attributes:
        joint: name of the joint.
        side: "high" for a stop that acts above the limit, "low" for one that acts below it.
        limit: coordinate at which the stop begins to act, m or rad from the initial pose.
        stiffness: k, N/m or N m/rad, 0 or more.
        dissipation: c, s/m or s/rad, 0 or more.
        coordinate: index of the joint coordinate, from 0.

    Raises:
        MechanismError: naming the joint and the invalid value.

    Examples:
        >>> stop = JointStop("rail", "high", limit=0.2, stiffness=1e5)
        >>> round(stop.force(x=0.201, x_rate=0.0, time=0.0), 6)  # N, back into the range
        -100.0
    """

    joint: str
    side: Literal["low", "high"]
    limit: float
    stiffness: float
    dissipation: float = 0.0
    coordinate: int = 0

    noun = "stop"
    kind = "joint_stop"  # the name in scene files
    switch_count: ClassVar = 2
    number_fields: ClassVar = {
        "limit": NumberField("m", unit_about="rad"),
        "stiffness": NumberField("N/m", unit_about="N m/rad", least=0.0, strength="stop"),
        "dissipation": NumberField("s/m", unit_about="s/rad", least=0.0),
    }

    def __post_init__(self) -> None:
        if not isinstance(self.side, str) or self.side not in ("low", "high"):
            raise MechanismError(
                f"stop of joint {quoted(self.joint)}", f"side is {quoted(self.side)}", "'low' or 'high'"
            )
        self.set_numbers(self.element)
        check_key(self.element, self.joint, self.coordinate)

    @property
    def element(self) -> str:
        return f"{self.side} {super().element}"

    @property
    def identity(self) -> str:
        return f"{self.side} {super().identity}"

    @property
    def prefix(self) -> str:
        return f"{super().prefix}.{self.side}_stop"

    @property
    def sign(self) -> float:
        """1 for a stop above the limit, -1 for one below it."""
        return 1.0 if self.side == "high" else -1.0

    def described_after(self, change: PoseChange) -> Self:
        return replace(self, limit=self.limit - change.zeros[self.key])

    def switching(self, x: Scalar, x_rate: Scalar) -> tuple[Scalar, ...]:
        # depth beyond the limit, m or rad; ratio of the force to that of the spring alone
        return self.sign * (x - self.limit), 1.0 + self.dissipation * self.sign * x_rate

    def at_joint(self, at: Surroundings) -> Scalar:
        return self._force(*self.positive_parts(at))

    def force(self, x: Scalar, x_rate: Scalar, time: Scalar) -> Scalar:
        return self._force(*map(positive_part, self.switching(x, x_rate)))

    def _force(self, depth: Scalar, ratio: Scalar) -> Scalar:
        """Compute the force from the positive parts of both switching functions."""
        return -self.sign * self.stiffness * depth * ratio

    def energy(self, at: Surroundings) -> Scalar:
        depth, _ = self.positive_parts(at)
        return 0.5 * self.stiffness * (depth * depth)

    def powers(self, at: Surroundings) -> Iterator[Scalar]:
        """Compute the power of the damping, W: that of the force without its spring."""
        depth, ratio = self.positive_parts(at)
        _, rate = self.measure(at)
        yield -self.sign * self.stiffness * depth * (ratio - 1.0) * rate


SwitchedElement = JointFriction | JointStop
"""Every kind of switched force."""
