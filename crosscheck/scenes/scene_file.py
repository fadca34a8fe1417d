"""Scenes from YAML or JSON files.

`read_text` and `parse` make plain lists, dictionaries and texts of a file, pydantic checks the form, and the
mechanism checks the mechanics. YAML's scalars stay texts until a field says what they are to be, so that
none of YAML's own ideas of dates, octal numbers or truth values has a say.
"""

from __future__ import annotations

import json
import reprlib
import stat
from pathlib import Path
from typing import Annotated, Any, Literal

import yaml
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError
from pydantic_core import PydanticCustomError

from crosscheck.errors import CrosscheckError
from newton_euler.control import PD
from newton_euler.errors import NewtonEulerError
from newton_euler.joints import JOINT_KINDS, Joint
from newton_euler.mechanism import Body, Mechanism
from newton_euler.scene import OUTPUTS, Scene
from newton_euler.shapes import Box, Capsule
from newton_euler.state import State

MAXIMUM_BYTES = 1_000_000
"""A few seconds of parsing, and some thousand bodies."""

LARGEST = 1e100
"""Of any number of a scene, so that squares and triple products stay finite."""


def _no_truth_value(value: object) -> object:
    if isinstance(value, bool):
        raise PydanticCustomError("truth_value", "Input should be a number, not a truth value")
    return value


def _not_too_large(value: float) -> float:
    if abs(value) > LARGEST:
        raise PydanticCustomError("too_large", f"Input should be at most {LARGEST:g} in magnitude")
    return value


Number = Annotated[
    float,
    Field(allow_inf_nan=False),
    BeforeValidator(_no_truth_value),
    AfterValidator(_not_too_large),
]
Vector = tuple[Number, Number, Number]
Quaternion = tuple[Number, Number, Number, Number]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid")


class BoxEntry(_Strict):
    """A box; world frame at the initial pose, m."""

    kind: Literal["box"]
    half_sizes: Vector
    center: Vector
    quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)

    def build(self) -> Box:
        return Box(**self.model_dump(exclude={"kind"}))


class CapsuleEntry(_Strict):
    """A round bar; world frame at the initial pose, m."""

    kind: Literal["capsule"]
    start: Vector
    end: Vector
    radius: Number

    def build(self) -> Capsule:
        return Capsule(**self.model_dump(exclude={"kind"}))


class BodyEntry(_Strict):
    """A body; world frame at the initial pose, SI."""

    name: str
    mass: Number
    center_of_mass: Vector
    inertia: tuple[Vector, Vector, Vector]
    quaternion: Quaternion = (1.0, 0.0, 0.0, 0.0)
    shapes: list[Annotated[BoxEntry | CapsuleEntry, Field(discriminator="kind")]] = []
    allow_unrealisable_inertia: bool = False

    def build(self) -> Body:
        try:
            shapes = tuple(shape.build() for shape in self.shapes)
        except NewtonEulerError as error:
            raise CrosscheckError(f"body {self.name!r}: {error}") from error
        return Body(**self.model_dump(exclude={"shapes"}), shapes=shapes)


class JointEntry(_Strict):
    """A joint; which axes it needs depends on its kind."""

    name: str
    kind: str
    first: str
    second: str
    point: Vector
    point_on_second: Vector | None = None
    axis: Vector | None = None
    axis_on_first: Vector | None = None
    axis_on_second: Vector | None = None
    actuated: bool = False

    def build(self) -> Joint:
        where = f"joint {self.name!r}"
        if self.kind not in JOINT_KINDS:
            raise CrosscheckError(
                f"{where}: unknown kind {self.kind!r}; choose from: {', '.join(JOINT_KINDS)}"
            )
        kind = JOINT_KINDS[self.kind]
        given = {
            name: getattr(self, name)
            for name in ("axis", "axis_on_first", "axis_on_second")
            if getattr(self, name) is not None
        }
        if set(given) != set(kind.axis_names):
            raise CrosscheckError(
                f"{where}: a {self.kind} joint needs {' and '.join(kind.axis_names) or 'no axis'}, "
                f"got {' and '.join(given) or 'none'}"
            )
        arguments: dict[str, Any] = given | {
            "point_on_second": self.point_on_second,
            "actuated": self.actuated,
        }
        return kind(self.name, self.first, self.second, self.point, **arguments)  # type: ignore[arg-type]


class ControlEntry(_Strict):
    """A PD law; `target` is a joint coordinate, zero at the initial pose."""

    joint: str
    stiffness: Number
    damping: Number
    target: Number
    coordinate: Annotated[int, BeforeValidator(_no_truth_value)] = 0


class StateEntry(_Strict):
    """The initial state of one body, world frame, SI; what is left out is as in the initial pose, at rest."""

    position: Vector | None = None
    quaternion: Quaternion | None = None
    linear_velocity: Vector | None = None
    angular_velocity: Vector | None = None


class SceneEntry(_Strict):
    """A scene file."""

    name: str
    description: str = ""
    gravity: Vector = (0.0, 0.0, 0.0)
    duration: Number
    output_period: Number
    ground: str = "ground"
    bodies: list[BodyEntry]
    joints: list[JointEntry]
    control: list[ControlEntry] = []
    initial_state: dict[str, StateEntry] = {}
    outputs: list[str] = list(OUTPUTS)

    def build(self) -> Scene:
        bodies = [Body.ground(self.ground), *(body.build() for body in self.bodies)]
        mechanism = Mechanism(bodies, [joint.build() for joint in self.joints])
        return Scene(
            self.name,
            mechanism,
            self.duration,
            self.output_period,
            self.gravity,  # type: ignore[arg-type]
            tuple(PD(**law.model_dump()) for law in self.control),
            self._state(mechanism),
            frozenset(self.outputs),
            " ".join(self.description.split()),
        )

    def _state(self, mechanism: Mechanism) -> State:
        state = State.initial(mechanism)
        for name, entry in self.initial_state.items():
            body = mechanism.body_index(name)
            for quantity, value in entry.model_dump(exclude_none=True).items():
                getattr(state, quantity)[body] = value
        return state


def read_scene(path: str) -> Scene:
    """Read a scene file.

    Raises:
        CrosscheckError: naming the file and the line or field at fault.
    """
    try:
        return SceneEntry.model_validate(_parse(path, _read_text(path))).build()
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(part) for part in first["loc"]) or "file"
        raise CrosscheckError(
            f"{path}: {field:.100}: {first['msg']} (got {reprlib.repr(first['input'])})"
        ) from error
    except (NewtonEulerError, CrosscheckError) as error:
        raise CrosscheckError(f"{path}: {error}") from error


def _read_text(path: str) -> str:
    try:
        status = Path(path).stat()
        if not stat.S_ISREG(status.st_mode):  # a pipe would keep its reader waiting
            raise CrosscheckError("not a regular file")
        if status.st_size > MAXIMUM_BYTES:
            raise CrosscheckError(f"larger than {MAXIMUM_BYTES} bytes")
        return Path(path).read_text(encoding="utf-8-sig")
    except OSError as error:
        raise CrosscheckError(f"cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise CrosscheckError("not a UTF-8 text file") from error


def _parse(path: str, text: str) -> Any:
    try:
        if Path(path).suffix == ".json":
            return json.loads(text, object_pairs_hook=_unique)
        return yaml.load(text, _PlainLoader)
    except json.JSONDecodeError as error:
        raise CrosscheckError(f"not JSON: line {error.lineno}: {error.msg}") from error
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"line {mark.line + 1}: " if mark else ""
        raise CrosscheckError(f"not YAML: {where}{error.problem or error.context}") from error
    except yaml.YAMLError as error:
        raise CrosscheckError(f"not YAML: {error}") from error
    except RecursionError as error:
        raise CrosscheckError("nested too deeply") from error
    except ValueError as error:  # an integer of thousands of digits
        raise CrosscheckError(f"not JSON: {error}") from error


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object; raises `CrosscheckError` for a key that comes twice."""
    found: dict[str, Any] = {}
    for key, value in pairs:
        if key in found:
            raise CrosscheckError(f"key {key!r:.100} is given twice in one object")
        found[key] = value
    return found


class _PlainLoader(yaml.BaseLoader):
    """YAML of mappings, sequences and texts alone.

    Aliases are refused because a few lines of them unfold to gigabytes, tags because nothing here
    would heed them, and a key that comes twice because one of its values would be lost.
    """

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        if isinstance(event, yaml.AliasEvent):
            raise _refusal("aliases are not allowed here", event)
        if event.tag is not None:
            raise _refusal("tags are not allowed here", event)
        return super().compose_node(parent, index)

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        node = super().compose_mapping_node(anchor)
        seen = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise _refusal("a key is not a text", key)
            if key.value in seen:
                raise _refusal(f"key {key.value!r:.100} is given twice in one mapping", key)
            seen.add(key.value)
        return node


def _refusal(problem: str, element: Any) -> yaml.MarkedYAMLError:
    """The error that names the line of an event or node."""
    return yaml.MarkedYAMLError(problem=problem, problem_mark=element.start_mark)
