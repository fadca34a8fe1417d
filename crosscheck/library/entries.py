"""Schema of scene files: a pydantic model for each kind of element, which checks the input and builds the
element.

Elements of a scene (bodies, joints, forces, controllers) are objects of dataclasses of `newton_euler`. The
model of an element, its entry, is derived from the dataclass: same names of attributes and same defaults.
Entries check names and types of the input. The constructors of `newton_euler` check the mechanics. `SCENE` is
the entry of a whole file; `crosscheck.library.scene_file` reads and writes files with it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import MISSING, fields, replace
from typing import Annotated, Any, ClassVar, ForwardRef, Literal, Union, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    create_model,
)
from pydantic_core import PydanticCustomError

from crosscheck.library.size import check_counts, check_functions, check_mechanism
from crosscheck.support.errors import CrosscheckError
from newton_euler.errors import NewtonEulerError, UnknownNameError
from newton_euler.model.armatures import Armature, BallArmature
from newton_euler.model.control import PD, ComputedTorque, StateFeedback
from newton_euler.model.couplings import Gear, LinearCoupling, PolynomialCoupling
from newton_euler.model.digital_control import Digital
from newton_euler.model.forces import Force
from newton_euler.model.geometry import Box, Capsule, Cylinder, Sphere
from newton_euler.model.joint_kinds import JOINT_KINDS
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.motions import PrescribedMotion, Sum
from newton_euler.model.scene import OUTPUTS, REDUNDANCY_TOLERANCE, Scene
from newton_euler.model.smooth_functions import Polynomial, Sine
from newton_euler.model.splines import Moves, Spline, Steps
from newton_euler.model.state import State

MAX_MAGNITUDE = 1e100
"""Largest magnitude of a number in a scene, so that squares and triple products stay finite."""


def _check_is_number(value: object) -> object:
    """Return a number or a text unchanged; refuse truth values, and digits with underscores or not in
    ASCII."""
    if isinstance(value, bool):
        raise PydanticCustomError("truth_value", "Input should be a number, not a truth value")
    if isinstance(value, str) and ("_" in value or not value.isascii()):
        raise PydanticCustomError("plain_number", "Input should be a valid number")
    return value


def _check_magnitude(value: float) -> float:
    """Return a number unchanged; refuse one that exceeds `MAX_MAGNITUDE`."""
    if abs(value) > MAX_MAGNITUDE:
        raise PydanticCustomError("too_large", f"Input should be at most {MAX_MAGNITUDE:g} in magnitude")
    return value


Number = Annotated[
    float,
    Field(allow_inf_nan=False),
    BeforeValidator(_check_is_number),
    AfterValidator(_check_magnitude),
]
"""Type of a finite number."""

Index = Annotated[int, BeforeValidator(_check_is_number)]
"""Type of a whole number."""

Vector = tuple[Number, Number, Number]
"""Type of a vector (3,)."""

Quaternion = tuple[Number, Number, Number, Number]
"""Type of a unit quaternion (w, x, y, z)."""

FIELD_TYPES: dict[str, Any] = {
    "str": str,
    "bool": bool,
    "int": Index,
    "float": Number,
    "ArrayField": Vector,
    "DefaultArrayField": Vector | None,
    "tuple[float, ...]": list[Number],
    "tuple[tuple[str, int, float], ...]": list[tuple[str, Index, Number]],
    "Literal['world', 'body']": Literal["world", "body"],
    "Literal['low', 'high']": Literal["low", "high"],
}
"""Types of the fields of entries, by annotation of the attribute in `newton_euler`."""


class Entry(BaseModel):
    """Base of all entries: the part of a scene file from which one element is built.

    Attributes:
        element_class: class of the element.
        kind_name: value of the key `kind` in files; empty if entries of the class have no such key.
    """

    model_config = ConfigDict(extra="forbid", defer_build=True)  # schemas are compiled when first used
    element_class: ClassVar[type]
    kind_name: ClassVar[str]

    def build(self) -> Any:
        """Build the element.

        Raises:
            CrosscheckError: for an impossible element inside this one, such as the shape of a body; the
                message has the name of this element.
            NewtonEulerError: if this element itself is impossible.
        """
        given = {name: getattr(self, name) for name in type(self).model_fields if name != "kind"}
        try:
            given = {name: _built(value) for name, value in given.items()}
        except NewtonEulerError as error:
            name = f"{self.element_class.__name__.lower()} {given['name']!r}: " if "name" in given else ""
            raise CrosscheckError(f"{name}{error}") from error
        return self.element_class(**given)


def _built(value: Any) -> Any:
    """Build all entries in a value, also inside lists and dictionaries; lists become tuples."""
    if isinstance(value, list):
        return tuple(map(_built, value))
    if isinstance(value, dict):
        return {name: _built(each) for name, each in value.items()}
    return value.build() if isinstance(value, Entry) else value


ENTRIES: dict[type, type[Entry]] = {}
"""Entries by the class of their elements."""


def _declare_entry(element_class: type, kind: str = "", **field_types: Any) -> Any:
    """Create the entry of a dataclass and add it to `ENTRIES`.

    Args:
        element_class: the dataclass.
        kind: value of the key `kind`, which distinguishes several entries at one place of a file.
        field_types: types of fields by name, for annotations that `FIELD_TYPES` does not have; None for an
            attribute that files do not have.
    """
    declared: dict[str, Any] = {"kind": (Literal[kind], ...)} if kind else {}
    for field in fields(element_class):
        field_type = field_types[field.name] if field.name in field_types else FIELD_TYPES[str(field.type)]
        if field_type is not None:
            declared[field.name] = field_type, ... if field.default is MISSING else field.default
    entry = create_model(element_class.__name__, __base__=Entry, **declared)
    entry.element_class, entry.kind_name = element_class, kind
    ENTRIES[element_class] = entry
    return entry


def _list_of(entry: Any) -> Any:
    """Return the type of a list of entries; a function, as static type checkers do not know the entries."""
    return list[entry]


def _one_of(entries: Iterable[Any]) -> Any:
    """Return the type of one of several entries, which the key `kind` distinguishes."""
    return Annotated[Union[tuple(entries)], Field(discriminator="kind")]  # noqa: UP007 (of any number)


# Entries of all elements, from simple shapes to control laws. Names in capitals are types of fields that hold
# such an entry, and (`..._FIELDS`) types of fields by name.
QUATERNION_FIELDS: dict[str, Any] = {"quaternion": Quaternion}
SHAPE = _one_of(
    [
        _declare_entry(Box, "box", **QUATERNION_FIELDS),
        _declare_entry(Capsule, "capsule"),
        _declare_entry(Cylinder, "cylinder"),
        _declare_entry(Sphere, "sphere"),
    ]
)
INERTIA_MATRIX = tuple[Vector, Vector, Vector]
BODY = _declare_entry(Body, inertia=INERTIA_MATRIX, shapes=_list_of(SHAPE), meshes=None, **QUATERNION_FIELDS)
# fields of a joint with several slides and hinges: axes of both, and offsets from each hinge to the next, m
CHAIN_FIELDS: dict[str, Any] = dict.fromkeys(("slides", "hinges", "offsets"), list[Vector])
JOINT = _one_of(
    _declare_entry(joint_class, kind, **CHAIN_FIELDS) for kind, joint_class in JOINT_KINDS.items()
)
COUPLING = _one_of(
    [
        _declare_entry(Gear, "gear"),
        _declare_entry(PolynomialCoupling, "polynomial"),
        _declare_entry(LinearCoupling, "linear"),
    ]
)
# a sum has functions as its terms, which may be sums: its entry is completed once FUNCTION is defined
SUM = _declare_entry(Sum, "sum", terms=_list_of(ForwardRef("FUNCTION")))
SAMPLES_FIELDS: dict[str, Any] = dict.fromkeys(("times", "values"), list[Number])
FUNCTION = _one_of(
    [
        _declare_entry(Polynomial, "polynomial"),
        _declare_entry(Sine, "sine"),
        _declare_entry(Moves, "moves", ramps=list[Number], **SAMPLES_FIELDS),
        _declare_entry(Spline, "spline", **SAMPLES_FIELDS),
        _declare_entry(Steps, "steps", **SAMPLES_FIELDS),
        SUM,
    ]
)
SUM.model_rebuild(_types_namespace={"FUNCTION": FUNCTION})
VALUE: Any = Union[Number, FUNCTION]  # noqa: UP007 (a number, or a function of time)
FIELD_TYPES["float | TimeFunction"] = VALUE
FORCE = _one_of(_declare_entry(force_class, force_class.kind) for force_class in get_args(Force))
# gains K_p and K_d by joint; values of parameters of the mechanism in a controller's model, by name
GAINS: Any = dict[str, tuple[Number, Number]]
MODEL: Any = dict[str, Union[Number, list[Number], list[list[Number]]]]  # noqa: UP007
CONTINUOUS_LAWS = {
    "pd": _declare_entry(PD),
    "state_feedback": _declare_entry(StateFeedback, "state_feedback", gains=GAINS, targets=dict[str, VALUE]),
    "computed_torque": _declare_entry(ComputedTorque, "computed_torque", model=MODEL),
}
"""Entries of control laws in continuous time, by kind."""


def _one_of_laws(entries: Mapping[str, Any]) -> Any:
    """Return the type of one of several control laws by kind; a law without a kind is a PD law."""
    tagged = [Annotated[entry, Tag(kind)] for kind, entry in entries.items()]
    return Annotated[Union[tuple(tagged)], Discriminator(_kind_of_law)]  # noqa: UP007


def _kind_of_law(given: Any) -> str:
    """Return the kind of a control law in a file."""
    return str(given.get("kind", "pd")) if isinstance(given, dict) else "pd"


Limit = Union[Number, Literal["inf", "-inf"]]  # noqa: UP007
"""Type of a limit that may be infinite."""


class DigitalEntry(Entry):
    """Entry of a digital controller: a control law that is sampled, with limits and delay.

    The delay is a number of sampling periods, the resolution is that of the encoder, and the stroke limits
    the set-point; see `newton_euler.model.digital_control.Digital`. Files write infinite limits as the texts
    "inf" and "-inf".
    """

    kind: Literal["digital"]
    law: _one_of_laws(CONTINUOUS_LAWS)  # type: ignore[valid-type]
    period: Number
    delay: Index = 0
    resolution: Number = 0.0
    force_limit: Limit = "inf"
    slew_limit: Limit = "inf"
    stroke: tuple[Limit, Limit] = ("-inf", "inf")

    def build(self) -> Digital:
        """Build the digital controller."""
        law: Entry = self.law
        low, high = map(float, self.stroke)
        return Digital(
            law.build(),
            self.period,
            self.delay,
            self.resolution,
            force_limit=float(self.force_limit),
            slew_limit=float(self.slew_limit),
            stroke=(low, high),
        )


CONTROL = _one_of_laws(CONTINUOUS_LAWS | {"digital": DigitalEntry})
MOTION = _declare_entry(PrescribedMotion, function=FUNCTION)


class ArmatureEntry(Entry):
    """Entry of an armature: the inertia of a motor's rotor, on a coordinate of a joint or on a ball joint."""

    joint: str
    inertia: Number
    coordinate: Index | None = None
    ball: bool = False

    def build(self) -> Armature | BallArmature:
        """Build the armature.

        Raises:
            CrosscheckError: for an armature that has both a ball and a coordinate.
        """
        if not self.ball:
            return Armature(self.joint, self.inertia, self.coordinate or 0)
        if self.coordinate is not None:
            raise CrosscheckError(
                f"armature of joint {self.joint!r}: has a ball and a coordinate; needed: one or the other"
            )
        return BallArmature(self.joint, self.inertia)


class StateEntry(Entry):
    """Entry of the initial state of one body, world frame, SI.

    The initial pose is the pose in which bodies and joints are defined. Fields that a file does not give have
    the values of the initial pose at rest.
    """

    position: Vector | None = None
    quaternion: Quaternion | None = None
    linear_velocity: Vector | None = None
    angular_velocity: Vector | None = None


class _Scene(Entry):
    """Base of `SCENE`, the entry of a whole scene file."""

    def build(self) -> Scene:
        """Build the scene; check its size against the limits of `crosscheck.library.size` at each step.

        Raises:
            CrosscheckError: for a scene that is too large, and an impossible part of an element.
            NewtonEulerError: for an impossible element or mechanism.
        """
        given: Any = self
        # each joint beyond one per body closes a loop, and a coupling counts as a loop
        loops = len(given.joints) - len(given.bodies) + len(given.couplings)
        forces = len(given.control) + len(given.forces) + len(given.armatures)
        check_counts("file", {"bodies": len(given.bodies), "closures": loops, "forces": forces})
        bodies = [Body.ground(given.ground), *_built(given.bodies)]
        mechanism = Mechanism(bodies, _built(given.joints), _built(given.couplings))
        check_mechanism("file", mechanism)
        motions, control, acting = _built(given.motions), _built(given.control), _built(given.forces)
        check_functions("file", mechanism, motions, (*control, *acting), given.duration)
        return Scene(
            given.name,
            mechanism,
            given.duration,
            given.output_period,
            gravity=given.gravity,
            control=control,
            initial_state=_state(mechanism, given.initial_state, given.initial_angles),
            outputs=frozenset(given.outputs),
            forces=acting,
            motions=motions,
            armatures=_built(given.armatures),
            description=" ".join(given.description.split()),
            redundancy_tolerance=given.redundancy_tolerance,
        )


SCENE = create_model(
    "Scene",
    __base__=_Scene,
    name=(str, ...),
    description=(str, ""),
    gravity=(Vector, (0.0, 0.0, 0.0)),
    duration=(Number, ...),
    output_period=(Number, ...),
    ground=(str, "ground"),
    bodies=(_list_of(BODY), ...),
    joints=(_list_of(JOINT), ...),
    couplings=(_list_of(COUPLING), []),
    control=(_list_of(CONTROL), []),
    forces=(_list_of(FORCE), []),
    motions=(_list_of(MOTION), []),
    armatures=(list[ArmatureEntry], []),
    redundancy_tolerance=(float, REDUNDANCY_TOLERANCE),
    initial_state=(dict[str, StateEntry], {}),
    initial_angles=(dict[str, Number], {}),
    outputs=(list[str], list(OUTPUTS)),
)
"""Entry of a whole scene file."""


def _state(mechanism: Mechanism, entries: dict[str, StateEntry], angles: dict[str, float]) -> State | None:
    """Build the initial state of a scene.

    Args:
        mechanism: the mechanism.
        entries: states by name of the body; other bodies are in the initial pose, at rest.
        angles: angles of hinges with their full revolutions, rad, by label of the joint coordinate.

    Returns:
        The state; None if both dictionaries are empty.
    """
    if not entries and not angles:
        return None
    # (joint, index of the coordinate) by label: JOINT, or JOINT.0, JOINT.1, ... if a joint has several
    keys = {label: key for key, label in mechanism.coordinate_labels.items()}
    for label in angles:
        if label not in keys:
            raise UnknownNameError("joint coordinate in initial_angles", label, tuple(keys))
    state = replace(State.initial(mechanism), angles={keys[label]: x for label, x in angles.items()})
    for name, entry in entries.items():
        body = mechanism.body_index(name)
        for quantity, value in entry.model_dump(exclude_none=True).items():
            getattr(state, quantity)[body] = value
    return state
