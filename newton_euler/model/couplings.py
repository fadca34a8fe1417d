"""Couplings between joint coordinates: gears, polynomial relations such as cams, and differentials.

Each coupling is one constraint equation: a sum of polynomials of joint coordinates is zero. The constructor
of `Mechanism` takes couplings besides bodies and joints, and `newton_euler.equations.couplings` evaluates
them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from newton_euler.errors import MechanismError, check_key, check_texts, is_finite_number, items_of, quoted
from newton_euler.model.fields import NumberField
from newton_euler.model.joint import Key
from newton_euler.model.variable import INDEX_REASON, Change, Variable
from newton_euler.scalars import Array


class JointCoupling(Variable):
    """Base class of couplings: the sum of one polynomial per joint coordinate is zero.

    The polynomials have no constant terms, because the coupling holds at the initial pose, where all
    coordinates are 0. Joint coordinates are hinge angles, rad, and displacements of slides, m. A key (name of
    a joint, index from 0) identifies a coordinate.

    Attributes:
        name: unique among the joints and couplings of a mechanism.
        kind: name of the kind of coupling in error messages.
    """

    name: str
    kind: ClassVar[str]

    def factors(self) -> dict[tuple[str, int], float]:
        """Return the factor of the first power of each coordinate, by coordinate.

        The order matters: the sum of the coupling has the unit (m or rad) of the first coordinate.
        """
        raise NotImplementedError

    def powers(self) -> dict[tuple[str, int], tuple[float, ...]]:
        """Return the factors of the second, third, ... power of the coordinates that have such powers."""
        return {}

    def counted_from(self, zeros: Mapping[Key, float]) -> JointCoupling:
        """Return the same coupling for joint coordinates that are counted from another pose.

        Args:
            zeros: coordinates of the other pose, m or rad; they satisfy the coupling.
        """
        raise NotImplementedError


@dataclass(frozen=True)
class Gear(JointCoupling):
    """Two joint coordinates in a constant ratio: x_follower = ratio * x_driver.

    Two hinges make a pair of gears; a hinge and a slide make a rack and pinion.

    Attributes:
        name: unique among the joints and couplings of a mechanism.
        driver, follower: names of the two joints.
        ratio: ratio of the follower's coordinate (m or rad from the initial pose) to the driver's coordinate;
            negative if the two move in opposite senses.
        driver_coordinate, follower_coordinate: index of the coordinate of each joint, from 0.

    Raises:
        MechanismError: naming the gear and the invalid value.

    Examples:
        >>> tracker = load("tracker")  # two slides; the gear moves the second half as far as the first
        >>> pair = Gear("pair", "slide_12", "slide_13", ratio=0.5)
        >>> bodies, joints = tracker.mechanism.bodies, tracker.mechanism.joints
        >>> run = simulate(replace(tracker, mechanism=Mechanism(bodies, joints, couplings=[pair])))
        >>> print(*(run.joint(name).coordinates[-1].round(4) for name in ("slide_12", "slide_13")))  # m
        [0.0257] [0.0128]
    """

    name: str
    driver: str
    follower: str
    ratio: float
    driver_coordinate: int = 0
    follower_coordinate: int = 0
    kind: ClassVar[str] = "gear"
    # Numbers that may vary from run to run. `shape` None: the constructor checks the value; `moves_loops`: a
    # change moves the poses in which loops are closed. `constant`: reasons why other attributes cannot vary
    number_fields: ClassVar = {"ratio": NumberField(shape=None, allowed="nonzero", moves_loops=True)}
    constant: ClassVar = {"driver_coordinate": INDEX_REASON, "follower_coordinate": INDEX_REASON}

    def factors(self) -> dict[tuple[str, int], float]:
        follower = self.follower, self.follower_coordinate
        return {follower: 1.0, (self.driver, self.driver_coordinate): -self.ratio}

    def counted_from(self, zeros: Mapping[Key, float]) -> Gear:
        return self

    def __post_init__(self) -> None:
        where = f"gear {quoted(self.name)}"
        check_texts(where, self, "name")
        if not is_finite_number(self.ratio) or self.ratio == 0.0:
            raise MechanismError(where, f"ratio is {quoted(self.ratio)}", "a finite number, not 0")
        object.__setattr__(self, "ratio", float(self.ratio))
        check_key(where, self.driver, self.driver_coordinate)
        check_key(where, self.follower, self.follower_coordinate)
        if (self.driver, self.driver_coordinate) == (self.follower, self.follower_coordinate):
            raise MechanismError(
                where, f"couples joint {quoted(self.driver)} to itself", "two joint coordinates"
            )


MAX_DEGREE = 4
"""Highest power of a polynomial coupling; the same as in MuJoCo's attribute `polycoef` of joint
equalities."""


@dataclass(frozen=True)
class PolynomialCoupling(JointCoupling):
    """One joint coordinate that is a polynomial of another: x_follower = c_1 x_driver + c_2 x_driver^2 + ...

    Examples are a cam with its follower, and a bead on a curve (a slide along z as a polynomial of a slide
    along x).

    Attributes:
        name: unique among the joints and couplings of a mechanism.
        driver, follower: names of the two joints.
        coefficients: c_1, c_2, ..., at most 4 of them, not all 0. Both coordinates are in m or rad
            from the initial pose. For a curve y = p(x) with the initial pose at x_0, c_k is the k-th
            derivative of p at x_0, divided by k!.
        driver_coordinate, follower_coordinate: index of the coordinate of each joint, from 0.

    Raises:
        MechanismError: naming the coupling and the invalid value.

    Examples:
        >>> tracker = load("tracker")  # slide_13 = 20 / m times the square of slide_12
        >>> cam = PolynomialCoupling("cam", "slide_12", "slide_13", (0.0, 20.0))
        >>> bodies, joints = tracker.mechanism.bodies, tracker.mechanism.joints
        >>> run = simulate(replace(tracker, mechanism=Mechanism(bodies, joints, couplings=[cam])))
        >>> print(*(run.joint(name).coordinates[-1].round(4) for name in ("slide_12", "slide_13")))  # m
        [0.0279] [0.0156]
    """

    name: str
    driver: str
    follower: str
    coefficients: tuple[float, ...]
    driver_coordinate: int = 0
    follower_coordinate: int = 0
    kind: ClassVar[str] = "polynomial coupling"
    number_fields: ClassVar = {"coefficients": NumberField(shape=None, moves_loops=True)}
    constant: ClassVar = {"driver_coordinate": INDEX_REASON, "follower_coordinate": INDEX_REASON}

    def fields_with(self, values: Mapping[str, Any], change: Change) -> dict[str, Any]:
        """Return the new coefficients, the only numbers that may vary; `change` is for functions of time."""
        return {name: tuple(value) for name, value in values.items()}

    def factors(self) -> dict[tuple[str, int], float]:
        follower = self.follower, self.follower_coordinate
        return {follower: 1.0, (self.driver, self.driver_coordinate): -self.coefficients[0]}

    def powers(self) -> dict[tuple[str, int], tuple[float, ...]]:
        higher = tuple(-c for c in self.coefficients[1:])
        return {(self.driver, self.driver_coordinate): higher} if higher else {}

    def counted_from(self, zeros: Mapping[Key, float]) -> PolynomialCoupling:
        return self.from_zero(zeros[self.driver, self.driver_coordinate])

    def from_zero(self, zero: float) -> PolynomialCoupling:
        """Return the coupling for the same curve with both coordinates counted from another point of the
        curve.

        Args:
            zero: the driver's coordinate at the other point, m or rad.
        """
        polynomial = np.polynomial.Polynomial((0.0, *self.coefficients))
        shifted = polynomial(np.polynomial.Polynomial((zero, 1.0)))
        # Drop the constant term, because both coordinates are 0 at the other point; restore zeros that NumPy
        # trims from the highest powers
        count = len(self.coefficients)
        coefficients = np.concatenate([shifted.coef, np.zeros(count)])[1 : count + 1]
        return replace(self, coefficients=tuple(coefficients.tolist()))

    def __post_init__(self) -> None:
        where = f"polynomial coupling {quoted(self.name)}"
        check_texts(where, self, "name")
        given: Any = self.coefficients
        coefficients = items_of(given) or ()
        finite = all(is_finite_number(c) for c in coefficients)
        if not (finite and 1 <= len(coefficients) <= MAX_DEGREE and any(c != 0.0 for c in coefficients)):
            needed = f"1 to {MAX_DEGREE} finite numbers, not all 0, for the powers 1, 2, ..."
            raise MechanismError(where, f"coefficients is {quoted(given)}", needed)
        object.__setattr__(self, "coefficients", tuple(map(float, coefficients)))
        check_key(where, self.driver, self.driver_coordinate)
        check_key(where, self.follower, self.follower_coordinate)
        if (self.driver, self.driver_coordinate) == (self.follower, self.follower_coordinate):
            raise MechanismError(
                where, f"couples joint {quoted(self.driver)} to itself", "two joint coordinates"
            )


@dataclass(frozen=True)
class LinearCoupling(JointCoupling):
    """A weighted sum of joint coordinates is zero, such as the three shafts of a differential.

    Attributes:
        name: unique among the joints and couplings of a mechanism.
        terms: (name of a joint, index of its coordinate, factor) of each coordinate in the sum; at least two.

    Raises:
        MechanismError: naming the coupling and the invalid value.

    Examples:
        >>> tracker = load("tracker")  # slide_12 + 2 slide_13 stays 0
        >>> balance = LinearCoupling("balance", (("slide_12", 0, 1.0), ("slide_13", 0, 2.0)))
        >>> bodies, joints = tracker.mechanism.bodies, tracker.mechanism.joints
        >>> run = simulate(replace(tracker, mechanism=Mechanism(bodies, joints, couplings=[balance])))
        >>> print(*(run.joint(name).coordinates[-1].round(4) for name in ("slide_12", "slide_13")))  # m
        [0.0086] [-0.0043]
    """

    name: str
    terms: tuple[tuple[str, int, float], ...]
    kind: ClassVar[str] = "coupling"
    number_fields: ClassVar = {"terms": NumberField(shape=None, allowed="nonzero", moves_loops=True)}

    def number(self, name: str) -> Array:
        """Return the factors of the terms, which are the numbers that may vary."""
        return np.array([factor for _, _, factor in self.terms])

    def fields_with(self, values: Mapping[str, Any], change: Change) -> dict[str, Any]:
        """Return the terms with new factors; `change` is for functions of time."""
        terms = zip(self.terms, values["terms"], strict=True)
        return {"terms": tuple((joint, k, factor) for (joint, k, _), factor in terms)}

    def factors(self) -> dict[tuple[str, int], float]:
        return {(joint, coordinate): factor for joint, coordinate, factor in self.terms}

    def counted_from(self, zeros: Mapping[Key, float]) -> LinearCoupling:
        return self

    def __post_init__(self) -> None:
        where = f"coupling {quoted(self.name)}"
        check_texts(where, self, "name")
        try:
            terms = tuple((joint, coordinate, factor) for joint, coordinate, factor in self.terms)
        except (TypeError, ValueError) as error:
            needed = "(joint, coordinate, factor) of each term"
            raise MechanismError(where, f"terms is {quoted(self.terms)}", needed) from error
        for joint, coordinate, factor in terms:
            check_key(where, joint, coordinate)
            if not is_finite_number(factor) or factor == 0.0:
                problem = f"factor of {quoted(joint)} is {quoted(factor)}"
                raise MechanismError(where, problem, "a finite number, not 0")
        if len(terms) < 2 or len({term[:2] for term in terms}) < len(terms):
            raise MechanismError(where, f"has the terms {quoted(terms)}", "two joint coordinates or more")
        object.__setattr__(self, "terms", tuple((joint, k, float(factor)) for joint, k, factor in terms))
