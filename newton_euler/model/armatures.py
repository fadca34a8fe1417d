"""Armatures: rotor inertias of geared motors on joints.

The rotors are not bodies of the mechanism. Each kind of armature computes its momentum and its kinetic energy
from the state (`Surroundings`: the time, the present frames of all bodies, their poses at the initial pose,
and the joint coordinates). The numbers may be floats or generic scalars such as expressions of the code
generator (`newton_euler.scalars`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from newton_euler.errors import check_key, check_texts
from newton_euler.model.elements import OnBall, OnCoordinate, Surroundings
from newton_euler.model.fields import NumberField
from newton_euler.scalars import Array, Scalar

ROTOR_INERTIA = NumberField("kg", unit_about="kg m^2", positive=True, strength="rotor")


@dataclass(frozen=True)
class Armature(OnCoordinate):
    """Rotor inertia of a geared motor, reflected to a joint coordinate (called armature in MuJoCo).

    The armature adds a to the diagonal of the mass matrix in joint coordinates: the generalized force -a
    d2x/dt2 on the hinge or slide x, and the kinetic energy 1/2 a (dx/dt)^2. The rotor is not a body of the
    mechanism. Only the spin of the rotor about its axis is modeled, which dominates for large gear ratios
    (Featherstone, Rigid Body Dynamics Algorithms, 2008, chapter 9, on gears).

    Attributes:
        joint: name of the joint.
        inertia: a in kg m^2 at a hinge, kg at a slide, positive.
        coordinate: index of the joint coordinate, from 0.

    Raises:
        MechanismError: naming the joint and the invalid value.

    Examples:
        >>> geared = replace(load("pendulum"), armatures=[Armature("pivot", inertia=0.5)])
        >>> angle = simulate(geared).joint("pivot").coordinates
        >>> print((2.0 * angle[1] / 0.01**2).round(2))  # rad/s^2 at the start; 9.81 without the rotor
        [6.54]
    """

    joint: str
    inertia: float
    coordinate: int = 0

    noun = "armature"
    number_fields: ClassVar = {"inertia": ROTOR_INERTIA}
    kind_of_parameters = ".rotor"  # names of parameters in studies: `hinge.rotor.inertia`

    def __post_init__(self) -> None:
        self.set_numbers(self.element)
        check_key(self.element, self.joint, self.coordinate)

    def at_joint(self, at: Surroundings) -> Scalar:
        """Compute the momentum of the rotor, kg m/s or kg m^2/s."""
        return self.inertia * self.measure(at)[1]

    def energy(self, at: Surroundings) -> Scalar:
        """Compute the kinetic energy, J."""
        _, rate = self.measure(at)
        square = rate * rate
        return 0.5 * self.inertia * square


@dataclass(frozen=True)
class BallArmature(OnBall):
    """Isotropic rotor inertia on the ball of a joint, with the kinetic energy 1/2 a |omega|^2.

    omega is the angular velocity of the joint's second body relative to the first body. The torque on the
    second body is -a (alpha_2 - alpha_1 + omega_2 x omega_1), where alpha is the angular acceleration of a
    body: -a times the rate of omega as seen from either body.

    Attributes:
        joint: name of the joint.
        inertia: a in kg m^2, positive.

    Raises:
        MechanismError: naming the joint and the invalid value.

    Examples:
        >>> geared = replace(load("tracker"), armatures=[BallArmature("ball_67", inertia=0.02)])
        >>> for scene in (load("tracker"), geared):
        ...     print(np.asarray(simulate(scene).kinetic_energy).max().round(4))  # J
        0.0018
        0.0053
    """

    joint: str
    inertia: float

    noun = "armature"
    number_fields: ClassVar = {"inertia": ROTOR_INERTIA}
    kind_of_parameters = ".rotor"

    def __post_init__(self) -> None:
        self.set_numbers(self.element)
        check_texts(self.element, self, "joint")

    def at_joint(self, at: Surroundings) -> Array:
        """Compute the angular momentum (3,) of the rotor, kg m^2/s, in the sense of the second body, world
        frame."""
        return np.asarray(self.inertia * self.spin(at))

    def energy(self, at: Surroundings) -> Scalar:
        """Compute the kinetic energy, J."""
        omega = self.spin(at)
        square = omega @ omega
        return 0.5 * self.inertia * square
