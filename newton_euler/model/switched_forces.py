"""Dry friction, end stops and elastic gears: forces on joint coordinates whose formulas change at certain
states.

Such a *switched force* is continuous, but a derivative jumps where one of its *switching functions* changes
its sign. The formula depends on a switching function g only through its positive part max(g, 0). Integrators
end a step where g changes its sign, so that the force is smooth within each step. For this purpose they hold
a flag for each g during a step, 1 where g is positive and 0 elsewhere, and replace the positive part by
flag * g, which is smooth (`newton_euler.integrators.switches`). Without flags the state decides.

Forces are in N or N m, coordinates in m or rad from the initial pose.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, Self

from newton_euler.errors import MechanismError, check_key, check_texts, quoted
from newton_euler.model.elements import (
    AppliedForce,
    CoordinateForce,
    Named,
    PoseChange,
    Surroundings,
    check_known,
)
from newton_euler.model.fields import NumberField
from newton_euler.model.joint import Key
from newton_euler.model.mechanism import Mechanism, check_coordinate, check_name
from newton_euler.model.variable import INDEX_REASON
from newton_euler.scalars import Scalar, positive_part


class SwitchedForce(AppliedForce):
    """Base class of forces whose formula depends on the positive parts of switching functions.

    Attributes:
        switch_count: number of the switching functions.
    """

    switch_count: ClassVar[int]

    def switching(self, at: Surroundings) -> tuple[Scalar, ...]:
        """Compute the switching functions (switch_count,), SI, at a state."""
        raise NotImplementedError

    def positive_parts(self, at: Surroundings) -> list[Scalar]:
        """Compute the positive parts of the switching functions, by flags if `at` has flags of this force."""
        values = self.switching(at)
        flags = at.branches.get(self.identity)
        if flags is None:
            return [positive_part(value) for value in values]
        return [flag * value for flag, value in zip(flags, values, strict=True)]


def beyond_unity(ratio: Scalar) -> tuple[Scalar, Scalar]:
    """Return how much a ratio is above 1 and below -1; their positive parts saturate the ratio."""
    return ratio - 1.0, -1.0 - ratio


@dataclass(frozen=True)
class JointFriction(CoordinateForce, SwitchedForce):
    """Dry friction on a hinge or slide of a joint: Coulomb friction with the Stribeck effect, regularized.

    At the rate v the force is -(F_c + F_s / (1 + (v / v_s)^2)) sat(v / v_t), where sat limits its argument to
    -1 to 1. Below the transition speed v_t the friction is viscous, so that a joint that should stick creeps
    by less than v_t: the smaller v_t, the better the approximation and the stiffer the equations. Viscous
    friction at all speeds is the damping of a `JointSpring`.

    Friction of a loaded bearing or slide grows with the reaction force R of the joint: c |R| sat(v / v_t) is
    added, where the load coefficient c is the coefficient of friction of a slide, and this coefficient times
    the radius of the bearing at a hinge. Torques of the reaction are not counted. The reaction is that of
    the same instant, and must not be left undetermined by redundant constraints.

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
        load_coefficient: c, dimensionless for a slide, m about a hinge, 0 or more.
        coordinate: index of the joint coordinate, from 0.

    Raises:
        MechanismError: naming the joint and the invalid value.

    Examples:
        >>> rubbing = replace(load("pendulum"), forces=[JointFriction("pivot", coulomb=1.0)])
        >>> angle = simulate(rubbing).joint("pivot").coordinates[:, 0]
        >>> print(angle.max().round(2), angle[-1].round(2))  # rad: first swing, and where it stops
        2.85 1.51
    """

    joint: str
    coulomb: float
    stribeck: float = 0.0
    stribeck_speed: float = 0.01
    transition_speed: float = 1e-3
    load_coefficient: float = 0.0
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
        "load_coefficient": NumberField(unit_about="m", least=0.0, strength="friction"),
    }

    def __post_init__(self) -> None:
        self.set_numbers(self.element)
        check_key(self.element, self.joint, self.coordinate)

    def described_after(self, change: PoseChange) -> Self:
        return self  # friction does not depend on the coordinate

    def switching(self, at: Surroundings) -> tuple[Scalar, ...]:
        _, rate = self.measure(at)
        return beyond_unity(rate / self.transition_speed)

    @property
    def is_loaded(self) -> bool:
        """True if the friction grows with the reaction of the joint."""
        return not isinstance(self.load_coefficient, float) or self.load_coefficient > 0.0

    def saturated_speed(self, at: Surroundings) -> Scalar:
        """Compute the rate in units of the transition speed, limited to -1 to 1."""
        _, rate = self.measure(at)
        above, below = self.positive_parts(at)
        return rate / self.transition_speed - above + below

    def at_joint(self, at: Surroundings) -> Scalar:
        _, rate = self.measure(at)
        ratio = rate / self.stribeck_speed
        force = -(self.coulomb + self.stribeck / (1.0 + ratio * ratio)) * self.saturated_speed(at)
        return force + at.friction()[self.identity] if self.is_loaded else force


@dataclass(frozen=True)
class JointStop(CoordinateForce, SwitchedForce):
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
        >>> JointStop("rail", "high", limit=0.2, stiffness=1e5).prefix  # of its parameters in studies
        'rail.high_stop'
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
    def where(self) -> str:
        return f"at the {self.side} limit {super().where}"

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

    def switching(self, at: Surroundings) -> tuple[Scalar, ...]:
        # depth beyond the limit, m or rad; ratio of the force to that of the spring alone
        x, rate = self.measure(at)
        return self.sign * (x - self.limit), 1.0 + self.dissipation * self.sign * rate

    def at_joint(self, at: Surroundings) -> Scalar:
        depth, ratio = self.positive_parts(at)
        return -self.sign * self.stiffness * depth * ratio

    def energy(self, at: Surroundings) -> Scalar:
        depth, _ = self.positive_parts(at)
        return 0.5 * self.stiffness * (depth * depth)

    def powers(self, at: Surroundings) -> Iterator[Scalar]:
        """Compute the power of the damping, W: that of the force without its spring."""
        depth, ratio = self.positive_parts(at)
        _, rate = self.measure(at)
        yield -self.sign * self.stiffness * depth * (ratio - 1.0) * rate


@dataclass(frozen=True)
class ElasticGear(Named, SwitchedForce):
    """A gear, belt or lead screw with stiffness, play and friction between two joint coordinates.

    The gear turns a driver, such as the shaft of a motor, into the motion of a follower, such as a slide. Its
    deflection is y = ratio * x_driver - x_follower - rest. Within the play, |y| < play / 2, it transmits
    nothing. Beyond it by d > 0, a spring with the damping of Hunt and Crossley pushes the follower with the
    force F = k d (1 + c dd/dt), which never pulls (see `JointStop`).

    Friction in the gear grows with the transmitted force. A driver that moves the follower against the force
    needs the torque ratio * F / forward_efficiency; if the force drives it, its own torque is ratio * F *
    backward_efficiency. A gear that the force cannot drive, such as a lead screw of small lead, has a
    negative backward efficiency: it is self-locking. The friction is regularized: it falls to zero below the
    transition speed, so that a self-locking gear creeps. Friction that does not depend on the
    force, of bearings and seals, is a `JointFriction` of the driver.

    Sources: torques of a lead screw, R. G. Budynas and J. K. Nisbett, Shigley's Mechanical Engineering
    Design, section "The mechanics of power screws"; friction between both directions is interpolated by a
    parabola in the ratio of the speed to the transition speed.

    Attributes:
        name: unique among the forces of a scene; letters, digits, `_`, `.` and `-`.
        driver, follower: names of the two joints.
        ratio: motion of the follower for a unit of the driver, m/rad for a lead screw: lead / (2 pi).
        stiffness: k, N/m or N m/rad at the follower, 0 or more.
        play: free travel of the follower, m or rad, 0 or more.
        dissipation: c, s/m or s/rad, 0 or more.
        forward_efficiency: of the driver that moves the follower, above 0, at most 1.
        backward_efficiency: of the follower that moves the driver, at most 1; 0 or less if self-locking.
        transition_speed: of the driver, seen at the follower: ratio * driver rate, m/s or rad/s, positive.
        rest: ratio * x_driver - x_follower in the middle of the play, m or rad.
        driver_coordinate, follower_coordinate: index of the coordinate of each joint, from 0.

    Raises:
        MechanismError: naming the gear and the invalid value.

    Examples:
        >>> screw = ElasticGear("screw", "shaft", "rail", ratio=0.005 / 6.283, stiffness=1e7, play=2e-5)
        >>> screw.keys
        (('shaft', 0), ('rail', 0))
    """

    name: str
    driver: str
    follower: str
    ratio: float
    stiffness: float
    play: float = 0.0
    dissipation: float = 0.0
    forward_efficiency: float = 1.0
    backward_efficiency: float = 1.0
    transition_speed: float = 1e-5
    rest: float = 0.0
    driver_coordinate: int = 0
    follower_coordinate: int = 0

    noun = "elastic gear"
    kind = "elastic_gear"  # the name in scene files
    switch_count: ClassVar = 6
    number_fields: ClassVar = {
        "ratio": NumberField(allowed="nonzero"),
        "stiffness": NumberField("N/m", unit_about="N m/rad", least=0.0, strength="gear"),
        "play": NumberField("m", unit_about="rad", least=0.0),
        "dissipation": NumberField("s/m", unit_about="s/rad", least=0.0),
        "forward_efficiency": NumberField(positive=True),
        "backward_efficiency": NumberField(),
        "transition_speed": NumberField("m/s", unit_about="rad/s", positive=True),
        "rest": NumberField("m", unit_about="rad"),
    }
    constant: ClassVar = {"driver_coordinate": INDEX_REASON, "follower_coordinate": INDEX_REASON}

    def __post_init__(self) -> None:
        check_name("elastic gear", self.name)
        check_texts(self.element, self, "driver", "follower")
        self.set_numbers(self.element)
        if self.ratio == 0.0:
            raise MechanismError(self.element, "ratio is 0", "a finite number, not 0")
        for field in ("forward_efficiency", "backward_efficiency"):
            if not getattr(self, field) <= 1.0:
                raise MechanismError(self.element, f"{field} is {getattr(self, field):g}", "at most 1")
        for key in self.keys:
            check_key(self.element, *key)
        if self.keys[0] == self.keys[1]:
            raise MechanismError(
                self.element, f"connects joint {quoted(self.driver)} to itself", "two joint coordinates"
            )

    @property
    def keys(self) -> tuple[Key, ...]:
        return (self.driver, self.driver_coordinate), (self.follower, self.follower_coordinate)

    @property
    def unit_key(self) -> Key:
        return self.keys[1]

    def check(self, mechanism: Mechanism) -> None:
        """Raise `MechanismError` unless the mechanism has both joint coordinates."""
        for joint, coordinate in self.keys:
            check_known(self.element, "is on an unknown joint", joint, mechanism.joint_names)
            check_coordinate(self.element, mechanism.joint(joint), coordinate)

    def described_after(self, change: PoseChange) -> Self:
        driver, follower = (change.zeros[key] for key in self.keys)
        return replace(self, rest=self.rest - self.ratio * driver + follower)

    def deflection(self, at: Surroundings) -> tuple[Scalar, Scalar]:
        """Compute the deflection y, m or rad, and its rate."""
        (driver, driver_rate), (follower, follower_rate) = (at.measured[key][:2] for key in self.keys)
        return self.ratio * driver - follower - self.rest, self.ratio * driver_rate - follower_rate

    def speed_ratio(self, at: Surroundings) -> Scalar:
        """Compute the speed of the driver, seen at the follower, in units of the transition speed."""
        return self.ratio * at.measured[self.keys[0]][1] / self.transition_speed

    def switching(self, at: Surroundings) -> tuple[Scalar, ...]:
        y, rate = self.deflection(at)
        damping = self.dissipation * rate
        # depths beyond the play, ratios of the forces to those of the spring alone, limits of the speed
        depths = y - 0.5 * self.play, -y - 0.5 * self.play
        return *depths, 1.0 + damping, 1.0 - damping, *beyond_unity(self.speed_ratio(at))

    def along_coordinates(self, at: Surroundings) -> tuple[Scalar, ...]:
        up, down, up_ratio, down_ratio, above, below = self.positive_parts(at)
        pushes, pulls = self.stiffness * up * up_ratio, self.stiffness * down * down_ratio
        speed = self.speed_ratio(at) - above + below  # saturated
        torque = pushes * self.load_factor(speed) - pulls * self.load_factor(-speed)
        return -self.ratio * torque, pushes - pulls

    def load_factor(self, speed: Scalar) -> Scalar:
        """Compute the driver's torque in units of that without friction, by the saturated speed ratio."""
        forward = 1.0 / self.forward_efficiency
        slope, bend = 0.5 * (forward - self.backward_efficiency), 0.5 * (forward + self.backward_efficiency)
        return 1.0 + slope * speed + (bend - 1.0) * (speed * speed)

    def energy(self, at: Surroundings) -> Scalar:
        up, down, *_ = self.positive_parts(at)
        return 0.5 * self.stiffness * (up * up + down * down)

    def powers(self, at: Surroundings) -> Iterator[Scalar]:
        """Compute the power of friction and damping, W: that of the forces without the spring."""
        up, down, *_ = self.positive_parts(at)
        _, rate = self.deflection(at)
        for key, force in zip(self.keys, self.along_coordinates(at), strict=True):
            yield force * at.measured[key][1]
        yield self.stiffness * (up - down) * rate

    def magnitude(self, at: Surroundings) -> float:
        force = float(abs(self.along_coordinates(at)[1]))
        return force if at.mechanism.is_slide(*self.keys[1]) else force / at.mechanism.size


SwitchedElement = JointFriction | JointStop | ElasticGear
"""Every kind of switched force."""


def acting_stops(forces: Iterable[SwitchedElement]) -> dict[Key, list[JointStop]]:
    """Return the stops by joint coordinate, without those of stiffness 0, which exert nothing."""
    found: dict[Key, list[JointStop]] = {}
    for force in forces:
        if isinstance(force, JointStop) and force.stiffness:
            found.setdefault(force.key, []).append(force)
    return found
