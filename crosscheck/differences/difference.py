"""One row of the table of differences of two model files, and the quantities that such a row can be about."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import assert_never

from newton_euler.reading.file_shapes import Role
from newton_euler.scalars import Array

Value = float | tuple[float, ...] | str | None
"""A number, several numbers or a word of a model file; None if the file has no such number."""


class Quantity(StrEnum):
    """Number or property that differs between two model files."""

    MASS = "mass"
    CENTER = "center of mass"
    INERTIA = "inertia"
    INERTIA_AXES = "axes of inertia"
    FRAME = "frame"
    BASE = "base"
    PARENT = "parent"
    PRESENCE = "presence"
    NAME = "name"
    GRAVITY = "gravity"
    KIND = "kind"
    JOINT_ORIGIN = "joint origin"
    JOINT_AXIS = "joint axis"
    JOINT_ORIENTATION = "joint orientation"
    ZERO = "zero"
    SIGN = "sign"
    DAMPING = "damping"
    ARMATURE = "armature"
    FRICTION = "dry friction"
    STIFFNESS = "stiffness"
    REST = "rest"
    LIMITS = "limits"
    EFFORT = "effort"
    SPEED = "speed"
    GAIN = "gain"
    GEAR = "gear"
    KP = "kp"
    KV = "kv"
    CONSTANT = "constant force"
    CONTROL_LIMITS = "control limits"
    FORCE_LIMITS = "force limits"
    SETTING = "setting"
    TRANSMISSION = "joint of the drive"
    TRANSMISSION_JOINTS = "joints"
    TRANSMISSION_OFFSET = "offset of the transmission"
    REDUCTION = "mechanical reduction"
    HARDWARE_INTERFACE = "hardware interface"
    ACTUATOR = "actuator"
    TIME_STEP = "time step"
    INTEGRATOR = "integrator"
    COUPLING = "coupling"
    LOOP_POINT = "loop point"
    LOOP_AXIS = "loop axis"
    LOOP_LENGTH = "loop length"
    LOOP_CUT = "loop cut"
    SPRING_POINT = "point"
    START = "start"
    START_SPEED = "speed at the start"
    SIZE = "size"
    PLACE = "place"
    ORIENTATION = "orientation"
    SHAPE = "shape"
    MESH_SCALE = "mesh scale"
    CONTYPE = "contype"
    CONAFFINITY = "conaffinity"
    CONDIM = "condim"
    CONTACT_FRICTION = "friction"
    MARGIN = "margin"
    GAP = "gap"


class Standing(StrEnum):
    """Meaning of a row: a true difference, rounding or a convention."""

    DIFFERENT = "different"
    """The numbers differ by more than the digits of the files leave open."""
    ROUNDING = "rounding"
    """The numbers differ by no more than the digits of the files leave open."""
    CONVENTION = "convention"
    """The files describe the same robot in other terms, such as another frame of a link, or differ in what
    does not change its motion, such as the mass of a fixed base."""


class Side(StrEnum):
    """File that evidence speaks for."""

    FIRST = "first"
    SECOND = "second"
    NEITHER = "neither"
    """Both values are wrong by the same evidence."""


@dataclass(frozen=True)
class Evidence:
    """Observation that helps to decide which of two values is right. It proves nothing.

    Attributes:
        speaks_for: the file whose value fits to the observation.
        text: the observation.
    """

    speaks_for: Side
    text: str


@dataclass(frozen=True)
class Difference:
    """One difference of two model files.

    Attributes:
        element: name in the first file, or in the second if only the second has the element.
        element_kind: "body", "joint", "drive", "loop", "coupling", "spring", "transmission", "keyframe" or
            "model"; of a shape "collision box", "visual mesh" and so on, where the element is its body.
        quantity: what differs.
        first, second: value in each file, in the frame, zero and sign of the first file; None if the
            element or the number is missing there.
        unit: of the values; "" for words and pure numbers.
        size: relative difference, 0.01 for 1 %; in rad or m for directions, positions, zeros and limits;
            1.0 if one of the files has no such number, and for words and elements. Sizes of different
            quantities have different units: sort rows by `effect`, not by `size`.
        uncertainty: part of `size` that the digits of both files leave open.
        elements: names of all elements with the same cause; `element` is the one with the largest size.
        effect: relative change of the first robot's accelerations if it gets the numbers of this row, and
            nothing else, from the second file; None for what is no part of the equations of motion, such as
            limits. `Motion.change` is the change by all rows together, and not the sum of their effects.
        cause: explanation in words; "" for a number that merely differs.
        convention: whether the row only says that the files use other terms for the same robot, or differ in
            what does not change its motion.
        evidence: which of the values may be right.
        consequences: names of loops and springs with a number that follows from this difference.
    """

    element: str
    element_kind: str
    quantity: Quantity
    first: Value
    second: Value
    unit: str
    size: float
    uncertainty: float = 0.0
    elements: tuple[str, ...] = ()
    effect: float | None = None
    cause: str = ""
    convention: bool = False
    evidence: tuple[Evidence, ...] = ()
    consequences: tuple[str, ...] = ()

    @property
    def is_geometry(self) -> bool:
        """True if the row is about shapes of bodies, which the compared motion does not depend on."""
        return self.element_kind.startswith(tuple(f"{role} " for role in Role))

    @property
    def is_of_body(self) -> bool:
        """True if `element` is the name of a body."""
        return self.is_geometry or self.element_kind == "body"

    @property
    def standing(self) -> Standing:
        """Return whether the row is a true difference, rounding or a convention."""
        if self.convention:
            return Standing.CONVENTION
        return Standing.ROUNDING if self.size <= self.uncertainty else Standing.DIFFERENT


def unit(quantity: Quantity, slide: bool = False) -> str:
    """Return the unit of a quantity; of a joint that slides or of one that turns."""
    length, force = ("m", "N") if slide else ("rad", "N m")
    match quantity:
        case Quantity.MASS:
            return "kg"
        case Quantity.CENTER | Quantity.JOINT_ORIGIN | Quantity.LOOP_POINT | Quantity.SPRING_POINT:
            return "m"
        case Quantity.LOOP_LENGTH | Quantity.SIZE | Quantity.PLACE | Quantity.MARGIN | Quantity.GAP:
            return "m"
        case Quantity.INERTIA:
            return "kg m^2"
        case Quantity.ARMATURE:
            return "kg" if slide else "kg m^2"
        case Quantity.GRAVITY:
            return "m/s^2"
        case Quantity.INERTIA_AXES | Quantity.JOINT_ORIENTATION | Quantity.FRAME | Quantity.LOOP_AXIS:
            return "rad"
        case Quantity.ORIENTATION:
            return "rad"
        case Quantity.ZERO | Quantity.REST | Quantity.LIMITS | Quantity.START | Quantity.TRANSMISSION_OFFSET:
            return length
        case Quantity.FRICTION | Quantity.EFFORT | Quantity.CONSTANT | Quantity.GAIN | Quantity.FORCE_LIMITS:
            return force
        case Quantity.DAMPING | Quantity.KV:
            return f"{force} s/{length}"
        case Quantity.STIFFNESS | Quantity.KP:
            return f"{force}/{length}"
        case Quantity.SPEED | Quantity.START_SPEED:
            return f"{length}/s"
        case Quantity.TIME_STEP:
            return "s"
        case (
            Quantity.BASE
            | Quantity.PARENT
            | Quantity.PRESENCE
            | Quantity.NAME
            | Quantity.KIND
            | Quantity.JOINT_AXIS
            | Quantity.SIGN
            | Quantity.GEAR
            | Quantity.CONTROL_LIMITS
            | Quantity.SETTING
            | Quantity.COUPLING
            | Quantity.LOOP_CUT
            | Quantity.TRANSMISSION
            | Quantity.TRANSMISSION_JOINTS
            | Quantity.REDUCTION
            | Quantity.HARDWARE_INTERFACE
            | Quantity.ACTUATOR
            | Quantity.INTEGRATOR
            | Quantity.SHAPE
            | Quantity.MESH_SCALE
            | Quantity.CONTYPE
            | Quantity.CONAFFINITY
            | Quantity.CONDIM
            | Quantity.CONTACT_FRICTION
        ):
            return ""
        case _:
            assert_never(quantity)


def difference(
    element: str,
    kind: str,
    quantity: Quantity,
    values: tuple[Value, Value],
    sizes: tuple[float, float],
    cause: str = "",
    slide: bool = False,
    convention: bool = False,
) -> Difference:
    """Return a row about one element.

    Args:
        element, kind: name and kind of the element.
        quantity: what differs.
        values: in the first and in the second file.
        sizes: of the difference, and uncertainty.
        cause: explanation in words.
        slide: whether the element is a joint that slides, or acts on one.
        convention: whether the robot is the same.
    """
    effect = 0.0 if convention else None
    where = unit(quantity, slide)
    return Difference(element, kind, quantity, *values, where, *sizes, (element,), effect, cause, convention)


def numbers(values: Array) -> tuple[float, ...]:
    """Return an array (n,) as a value of a row."""
    return tuple(float(value) + 0.0 for value in values)
