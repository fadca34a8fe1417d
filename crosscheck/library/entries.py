"""Entries of scene files: what a file says of each element, and how it is made of that.

Each class of `newton_euler` has an entry with the names and defaults of its attributes: a pydantic model,
which checks the form of what a file says and builds the element. The mechanism checks the mechanics.
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

from crosscheck.loading.size import check_counts, check_functions, check_mechanism
from crosscheck.support.errors import CrosscheckError
from newton_euler.errors import NewtonEulerError, UnknownNameError
from newton_euler.model.control import PD, ComputedTorque, StateFeedback
from newton_euler.model.couplings import Gear, LinearCoupling, PolynomialCoupling
from newton_euler.model.digital_control import Digital
from newton_euler.model.forces import Armature, BallArmature, Force
from newton_euler.model.geometry import Box, Capsule, Cylinder, Sphere
from newton_euler.model.joint_kinds import JOINT_KINDS
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.motions import PrescribedMotion, Sum
from newton_euler.model.scene import OUTPUTS, REDUNDANCY_TOLERANCE, Scene
from newton_euler.model.smooth_functions import Polynomial, Sine
from newton_euler.model.splines import Spline, Steps
from newton_euler.model.state import State

LARGEST = 1e100
"""Largest magnitude of a number in a scene, so that squares and triple products stay finite."""


def _plain(value: object) -> object:
    """A number, or the text of one in YAML, as it is; no truth value and no digits with underscores."""
    if isinstance(value, bool):
        raise PydanticCustomError("truth_value", "Input should be a number, not a truth value")
    if isinstance(value, str) and ("_" in value or not value.isascii()):
        raise PydanticCustomError("plain_number", "Input should be a valid number")
    return value


def _not_too_large(value: float) -> float:
    if abs(value) > LARGEST:
        raise PydanticCustomError("too_large", f"Input should be at most {LARGEST:g} in magnitude")
    return value


Number = Annotated[
    float,
    Field(allow_inf_nan=False),
    BeforeValidator(_plain),
    AfterValidator(_not_too_large),
]
Index = Annotated[int, BeforeValidator(_plain)]
Vector = tuple[Number, Number, Number]
Quaternion = tuple[Number, Number, Number, Number]

FORMS: dict[str, Any] = {
    "str": str,
    "bool": bool,
    "int": Index,
    "float": Number,
    "ArrayField": Vector,
    "DefaultArrayField": Vector | None,
    "tuple[float, ...]": list[Number],
    "tuple[tuple[str, int, float], ...]": list[tuple[str, Index, Number]],
    "Literal['world', 'body']": Literal["world", "body"],
}
"""Forms of attributes by their annotations."""


class Entry(BaseModel):
    """The part of a scene file that makes an object of one class."""

    model_config = ConfigDict(extra="forbid", defer_build=True)
    made: ClassVar[type]
    named: ClassVar[str]

    def build(self) -> Any:
        """Build the object; raises `NewtonEulerError` for one that cannot be."""
        given = {name: getattr(self, name) for name in type(self).model_fields if name != "kind"}
        try:
            given = {name: _built(value) for name, value in given.items()}
        except NewtonEulerError as error:
            name = f"{self.made.__name__.lower()} {given['name']!r}: " if "name" in given else ""
            raise CrosscheckError(f"{name}{error}") from error
        return self.made(**given)


def _built(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(map(_built, value))
    if isinstance(value, dict):
        return {name: _built(each) for name, each in value.items()}
    return value.build() if isinstance(value, Entry) else value


ENTRIES: dict[type, type[Entry]] = {}
"""Entries by what they make."""


def _entry(made: type, kind: str = "", **forms: Any) -> Any:
    """Declare the entry of a class.

    Args:
        made: a dataclass.
        kind: of the entry, in a list of several kinds.
        forms: of attributes whose annotations do not say them; None for one that files do not have.
    """
    declared: dict[str, Any] = {"kind": (Literal[kind], ...)} if kind else {}
    for field in fields(made):
        form = forms[field.name] if field.name in forms else FORMS[str(field.type)]
        if form is not None:
            declared[field.name] = form, ... if field.default is MISSING else field.default
    ENTRIES[made] = create_model(made.__name__, __base__=Entry, **declared)
    ENTRIES[made].made, ENTRIES[made].named = made, kind
    return ENTRIES[made]


def _several(form: Any) -> Any:
    """A list of one form, for lack of static types."""
    return list[form]


def _one_of(entries: Iterable[Any]) -> Any:
    return Annotated[Union[tuple(entries)], Field(discriminator="kind")]  # noqa: UP007 (of any number)


QUATERNION: dict[str, Any] = {"quaternion": Quaternion}
BARS = [_entry(Capsule, "capsule"), _entry(Cylinder, "cylinder"), _entry(Sphere, "sphere")]
SHAPE = _one_of([_entry(Box, "box", **QUATERNION), *BARS])
BODY = _entry(Body, inertia=tuple[Vector, Vector, Vector], shapes=_several(SHAPE), meshes=None, **QUATERNION)
ROWS: dict[str, Any] = dict.fromkeys(("slides", "hinges", "offsets"), list[Vector])
JOINT = _one_of(_entry(made, kind, **ROWS) for kind, made in JOINT_KINDS.items())
COUPLINGS = {"gear": Gear, "polynomial": PolynomialCoupling, "linear": LinearCoupling}
COUPLING = _one_of(_entry(made, kind) for kind, made in COUPLINGS.items())
SUM = _entry(Sum, "sum", terms=_several(ForwardRef("FUNCTION")))
FUNCTIONS = {"polynomial": Polynomial, "sine": Sine}
SAMPLES: dict[str, Any] = dict.fromkeys(("times", "values"), list[Number])
SAMPLED = [_entry(made, kind, **SAMPLES) for kind, made in (("spline", Spline), ("steps", Steps))]
FUNCTION = _one_of([*(_entry(made, kind) for kind, made in FUNCTIONS.items()), *SAMPLED, SUM])
SUM.model_rebuild(_types_namespace={"FUNCTION": FUNCTION})
VALUE: Any = Union[Number, FUNCTION]  # noqa: UP007
FORMS["float | TimeFunction"] = VALUE
FORCE = _one_of(_entry(made, made.kind) for made in get_args(Force))
GAINS: Any = dict[str, tuple[Number, Number]]
MODEL: Any = dict[str, Union[Number, list[Number], list[list[Number]]]]  # noqa: UP007
DECLARED = {
    "pd": _entry(PD),
    "state_feedback": _entry(StateFeedback, "state_feedback", gains=GAINS, targets=dict[str, VALUE]),
    "computed_torque": _entry(ComputedTorque, "computed_torque", model=MODEL),
}


def _laws(entries: Mapping[str, Any]) -> Any:
    """Return one of several laws by their kinds; one without a kind is a PD law."""
    tagged = [Annotated[entry, Tag(kind)] for kind, entry in entries.items()]
    return Annotated[Union[tuple(tagged)], Discriminator(_kind_of_law)]  # noqa: UP007


def _kind_of_law(given: Any) -> str:
    return str(given.get("kind", "pd")) if isinstance(given, dict) else "pd"


Limit = Union[Number, Literal["inf", "-inf"]]  # noqa: UP007


class DigitalEntry(Entry):
    """A declared law on a computer."""

    kind: Literal["digital"]
    law: _laws(DECLARED)  # type: ignore[valid-type]
    period: Number
    delay: Index = 0
    resolution: Number = 0.0
    force_limit: Limit = "inf"
    slew_limit: Limit = "inf"
    stroke: tuple[Limit, Limit] = ("-inf", "inf")

    def build(self) -> Digital:
        law: Entry = self.law
        force, slew, low, high = map(float, (self.force_limit, self.slew_limit, *self.stroke))
        return Digital(law.build(), self.period, self.delay, self.resolution, force, slew, (low, high))


CONTROL = _laws(DECLARED | {"digital": DigitalEntry})
MOTION = _entry(PrescribedMotion, function=FUNCTION)


class ArmatureEntry(Entry):
    """A rotor inertia on a joint coordinate, or on a joint's ball."""

    joint: str
    inertia: Number
    coordinate: Index | None = None
    ball: bool = False

    def build(self) -> Armature | BallArmature:
        if not self.ball:
            return Armature(self.joint, self.inertia, self.coordinate or 0)
        if self.coordinate is not None:
            raise CrosscheckError(
                f"armature of joint {self.joint!r}: has a ball and a coordinate; needed: one or the other"
            )
        return BallArmature(self.joint, self.inertia)


class StateEntry(Entry):
    """The initial state of one body, world frame, SI; what is left out is as in the initial pose, at rest."""

    position: Vector | None = None
    quaternion: Quaternion | None = None
    linear_velocity: Vector | None = None
    angular_velocity: Vector | None = None


class _Scene(Entry):
    """A scene file."""

    def build(self) -> Scene:
        given: Any = self
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
    bodies=(_several(BODY), ...),
    joints=(_several(JOINT), ...),
    couplings=(_several(COUPLING), []),
    control=(_several(CONTROL), []),
    forces=(_several(FORCE), []),
    motions=(_several(MOTION), []),
    armatures=(list[ArmatureEntry], []),
    redundancy_tolerance=(float, REDUNDANCY_TOLERANCE),
    initial_state=(dict[str, StateEntry], {}),
    initial_angles=(dict[str, Number], {}),
    outputs=(list[str], list(OUTPUTS)),
)


def _state(mechanism: Mechanism, entries: dict[str, StateEntry], angles: dict[str, float]) -> State | None:
    """Build the initial state; None if a file gives neither states of bodies nor angles."""
    if not entries and not angles:
        return None
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
