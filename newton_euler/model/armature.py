"""Armature: the inertia of a rotor that a joint coordinate turns through a gear, reflected to the joint.

The rotor itself is no body of the mechanism: of its motion only the spin about its axis is taken into
account, which is what a large gear ratio makes large (Featherstone, Rigid Body Dynamics Algorithms, 2008,
chapter 9, on gears). It adds a to the diagonal of the mass matrix in joint coordinates. MuJoCo's models have
such inertias on balls as well, the same about all axes.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from newton_euler.errors import MechanismError, check_key, check_texts, is_finite_number
from newton_euler.model.forces import check_ball, check_known
from newton_euler.model.joints import Key
from newton_euler.model.mechanism import Mechanism, check_coordinate


@dataclass(frozen=True)
class Armature:
    """A generalized force -a d2x/dt2 on a joint's hinge or slide x, and kinetic energy 1/2 a (dx/dt)^2.

    Attributes:
        joint: name of the joint.
        inertia: a in kg m^2 or kg, positive.
        coordinate: which of the joint's coordinates, from 0.

    Raises:
        MechanismError: naming the joint and the value at fault.
    """

    joint: str
    inertia: float
    coordinate: int = 0

    parameters: ClassVar[tuple[str, ...]] = ("inertia",)

    def __post_init__(self) -> None:
        _set_inertia(self)
        check_key(self.element, self.joint, self.coordinate)

    @property
    def element(self) -> str:
        """What errors call it."""
        return f"armature of joint {self.joint!r}"

    @property
    def key(self) -> Key:
        """The joint coordinate that it is on."""
        return self.joint, self.coordinate


@dataclass(frozen=True)
class BallArmature:
    """A rotor inertia on a joint's ball, the same about all axes: kinetic energy 1/2 a |omega|^2.

    omega is the angular velocity of the joint's second body against the first. The torque on the second
    body is -a times the rate of omega as either body sees it, alpha_2 - alpha_1 + omega_2 x omega_1.

    Attributes:
        joint: name of the joint.
        inertia: a in kg m^2, positive.

    Raises:
        MechanismError: naming the joint and the value at fault.
    """

    joint: str
    inertia: float

    parameters: ClassVar[tuple[str, ...]] = ("inertia",)

    def __post_init__(self) -> None:
        _set_inertia(self)
        check_texts(self.element, self, "joint")

    @property
    def element(self) -> str:
        """What errors call it."""
        return f"armature of the ball of joint {self.joint!r}"


def _set_inertia(armature: Armature | BallArmature) -> None:
    inertia = armature.inertia
    if not is_finite_number(inertia) or inertia <= 0.0:
        raise MechanismError(armature.element, f"inertia is {inertia!r:.100}", "a positive finite number")
    object.__setattr__(armature, "inertia", float(inertia))


def check_armatures(armatures: Sequence[Armature | BallArmature], mechanism: Mechanism) -> None:
    """Raise `MechanismError` unless the mechanism has the joint coordinates and balls, each once."""
    for armature in armatures:
        if isinstance(armature, BallArmature):
            check_ball(armature.element, armature.joint, mechanism)
        else:
            check_known(armature.element, "is on an unknown joint", armature.joint, mechanism.joint_names)
            joint = mechanism.joints[mechanism.joint_index(armature.joint)]
            check_coordinate(armature.element, joint, armature.coordinate)
    for element, count in Counter(map(_identity, armatures)).items():
        if count > 1:
            raise MechanismError(element, f"{count} for one coordinate", "one a coordinate or ball")


def _identity(armature: Armature | BallArmature) -> str:
    """What no two armatures of a scene may have in common."""
    if isinstance(armature, BallArmature):
        return armature.element
    return f"armature of coordinate {armature.coordinate} of joint {armature.joint!r}"
