"""Armature: the inertia of a rotor that a joint coordinate turns through a gear, reflected to the joint.

The rotor itself is no body of the mechanism: of its motion only the spin about its axis is taken into
account, which is what a large gear ratio makes large (Featherstone, Rigid Body Dynamics Algorithms, 2008,
chapter 9, on gears). It adds a to the diagonal of the mass matrix in joint coordinates.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from newton_euler.control import check_key, is_finite_number
from newton_euler.errors import MechanismError
from newton_euler.mechanism import Mechanism

if TYPE_CHECKING:
    from newton_euler.measured import Key


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
        if not is_finite_number(self.inertia) or self.inertia <= 0.0:
            raise MechanismError(
                self.element, f"inertia is {self.inertia!r:.100}", "a positive finite number"
            )
        object.__setattr__(self, "inertia", float(self.inertia))
        check_key(self.element, self.joint, self.coordinate)

    @property
    def element(self) -> str:
        """What errors call it."""
        return f"armature of joint {self.joint!r}"

    @property
    def key(self) -> Key:
        """The joint coordinate that it is on."""
        return self.joint, self.coordinate


def check_armatures(armatures: Sequence[Armature], mechanism: Mechanism) -> None:
    """Raise `MechanismError` unless the mechanism has the joint coordinates, each once."""
    for armature in armatures:
        if armature.joint not in mechanism.joint_names:
            known = ", ".join(mechanism.joint_names)
            raise MechanismError(armature.element, "is on an unknown joint", f"one of {known}")
        count = len(mechanism.joints[mechanism.joint_index(armature.joint)].coordinate_kinds)
        if not 0 <= armature.coordinate < count:
            needed = f"an index below {count}" if count else "a joint with a hinge or a slide"
            raise MechanismError(armature.element, f"coordinate is {armature.coordinate}", needed)
    for key, count in Counter(armature.key for armature in armatures).items():
        if count > 1:
            where = f"armature of joint {key[0]!r}"
            raise MechanismError(where, f"{count} for one coordinate", "one a coordinate")
