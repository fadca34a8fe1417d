"""What scene files hold: the form of each entry, and what is made of it.

Names are those of the classes and their attributes in `newton_euler`; SI, world frame at the initial pose.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field
from pydantic_core import PydanticCustomError

from crosscheck.errors import CrosscheckError
from crosscheck.scenes.size import check_counts, check_functions, check_mechanism
from newton_euler.errors import NewtonEulerError
from newton_euler.model.compound_joint import Compound
from newton_euler.model.control import PD
from newton_euler.model.couplings import Gear, LinearCoupling
from newton_euler.model.forces import Armature, BallArmature, BallSpring, JointSpring, PointSpring, Wrench
from newton_euler.model.geometry import Box, Capsule
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import JOINT_KINDS, Screw
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.motions import Polynomial, PrescribedMotion, Sine, Sum, TimeFunction
from newton_euler.model.scene import OUTPUTS, REDUNDANCY_TOLERANCE, Scene
from newton_euler.model.state import State

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
Index = Annotated[int, BeforeValidator(_no_truth_value)]
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
    pitch: Number | None = None
    slides: list[Vector] | None = None
    hinges: list[Vector] | None = None
    offsets: list[Vector] | None = None
    ball: bool | None = None
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
            for name in ("axis", "axis_on_first", "axis_on_second", "pitch")
            if getattr(self, name) is not None
        }
        needed = (*kind.axis_names, "pitch") if kind is Screw else kind.axis_names
        for name in ("slides", "hinges", "offsets", "ball"):
            value = getattr(self, name)
            if value is not None and kind is not Compound:
                raise CrosscheckError(f"{where}: {name} are of compound joints only")
        if set(given) != set(needed):
            raise CrosscheckError(
                f"{where}: a {self.kind} joint needs {' and '.join(needed) or 'no axis'}, "
                f"got {' and '.join(given) or 'none'}"
            )
        if kind is Compound:
            given |= {"slides": self.slides or (), "hinges": self.hinges or (), "ball": self.ball or False}
            given |= {"offsets": self.offsets}
        arguments: dict[str, Any] = given | {
            "point_on_second": self.point_on_second,
            "actuated": self.actuated,
        }
        return kind(self.name, self.first, self.second, self.point, **arguments)  # type: ignore[arg-type]


class GearEntry(_Strict):
    """Two joint coordinates in a constant ratio."""

    kind: Literal["gear"]
    name: str
    driver: str
    follower: str
    ratio: Number
    driver_coordinate: Index = 0
    follower_coordinate: Index = 0

    def build(self) -> Gear:
        return Gear(**self.model_dump(exclude={"kind"}))


class LinearEntry(_Strict):
    """A sum of joint coordinates, each times a factor, that stays 0."""

    kind: Literal["linear"]
    name: str
    terms: list[tuple[str, Index, Number]]

    def build(self) -> LinearCoupling:
        return LinearCoupling(self.name, tuple(self.terms))


class JointSpringEntry(_Strict):
    """A spring and damper on a joint coordinate."""

    kind: Literal["joint_spring"]
    joint: str
    stiffness: Number = 0.0
    damping: Number = 0.0
    rest: Number = 0.0
    coordinate: Index = 0

    def build(self) -> JointSpring:
        return JointSpring(**self.model_dump(exclude={"kind"}))


class BallSpringEntry(_Strict):
    """A spring and damper on a joint's ball; `rest` is a rotation vector, rad."""

    kind: Literal["ball_spring"]
    joint: str
    stiffness: Number = 0.0
    damping: Number = 0.0
    rest: Vector = (0.0, 0.0, 0.0)

    def build(self) -> BallSpring:
        return BallSpring(**self.model_dump(exclude={"kind"}))


class ArmatureEntry(_Strict):
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


class PointSpringEntry(_Strict):
    """A spring and damper between points of two bodies."""

    kind: Literal["point_spring"]
    name: str
    first: str
    second: str
    point_on_first: Vector
    point_on_second: Vector
    stiffness: Number
    rest_length: Number
    damping: Number = 0.0

    def build(self) -> PointSpring:
        return PointSpring(**self.model_dump(exclude={"kind"}))


class WrenchEntry(_Strict):
    """A constant force at a point of a body, and a constant torque."""

    kind: Literal["wrench"]
    name: str
    body: str
    point: Vector
    force: Vector = (0.0, 0.0, 0.0)
    torque: Vector = (0.0, 0.0, 0.0)
    frame: Literal["world", "body"] = "world"

    def build(self) -> Wrench:
        return Wrench(**self.model_dump(exclude={"kind"}))


ForceEntry = Annotated[
    JointSpringEntry | BallSpringEntry | PointSpringEntry | WrenchEntry, Field(discriminator="kind")
]


class PolynomialEntry(_Strict):
    """c_0 + c_1 t + c_2 t^2 + ..."""

    kind: Literal["polynomial"]
    coefficients: list[Number]

    def build(self) -> Polynomial:
        return Polynomial(tuple(self.coefficients))


class SineEntry(_Strict):
    """offset + amplitude sin(angular_frequency t + phase)."""

    kind: Literal["sine"]
    amplitude: Number
    angular_frequency: Number
    phase: Number = 0.0
    offset: Number = 0.0

    def build(self) -> Sine:
        return Sine(**self.model_dump(exclude={"kind"}))


class SumEntry(_Strict):
    """The sum of functions of time."""

    kind: Literal["sum"]
    terms: list[FunctionEntry]

    def build(self) -> Sum:
        return Sum(tuple(term.build() for term in self.terms))


FunctionEntry = Annotated[PolynomialEntry | SineEntry | SumEntry, Field(discriminator="kind")]


class ControlEntry(_Strict):
    """A PD law; `target` is a joint coordinate, zero at the initial pose."""

    joint: str
    stiffness: Number
    damping: Number
    target: Number
    coordinate: Index = 0
    feedforward: Number | FunctionEntry = 0.0

    def build(self) -> PD:
        given = self.feedforward
        u_0: float | TimeFunction = given if isinstance(given, int | float) else given.build()
        return PD(self.joint, self.stiffness, self.damping, self.target, self.coordinate, u_0)


class MotionEntry(_Strict):
    """A joint coordinate that follows a function of time."""

    joint: str
    function: FunctionEntry
    coordinate: Index = 0

    def build(self) -> PrescribedMotion:
        function: TimeFunction = self.function.build()
        return PrescribedMotion(self.joint, function, self.coordinate)


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
    couplings: list[Annotated[GearEntry | LinearEntry, Field(discriminator="kind")]] = []
    control: list[ControlEntry] = []
    forces: list[ForceEntry] = []
    motions: list[MotionEntry] = []
    armatures: list[ArmatureEntry] = []
    redundancy_tolerance: float = REDUNDANCY_TOLERANCE
    initial_state: dict[str, StateEntry] = {}
    outputs: list[str] = list(OUTPUTS)

    def build(self) -> Scene:
        loops = len(self.joints) - len(self.bodies) + len(self.couplings)
        forces = len(self.control) + len(self.forces) + len(self.armatures)
        check_counts("file", {"bodies": len(self.bodies), "closures": loops, "forces": forces})
        bodies = [Body.ground(self.ground), *(body.build() for body in self.bodies)]
        joints = [joint.build() for joint in self.joints]
        mechanism = Mechanism(bodies, joints, [gear.build() for gear in self.couplings])
        check_mechanism("file", mechanism)
        motions = tuple(motion.build() for motion in self.motions)
        control = tuple(law.build() for law in self.control)
        check_functions("file", mechanism, motions, control, self.duration)
        return Scene(
            self.name,
            mechanism,
            self.duration,
            self.output_period,
            gravity=self.gravity,  # type: ignore[arg-type]
            control=control,
            initial_state=self._state(mechanism) if self.initial_state else None,
            outputs=frozenset(self.outputs),
            forces=tuple(force.build() for force in self.forces),
            motions=motions,
            armatures=tuple(armature.build() for armature in self.armatures),
            description=" ".join(self.description.split()),
            redundancy_tolerance=self.redundancy_tolerance,
        )

    def _state(self, mechanism: Mechanism) -> State:
        state = State.initial(mechanism)
        for name, entry in self.initial_state.items():
            body = mechanism.body_index(name)
            for quantity, value in entry.model_dump(exclude_none=True).items():
                getattr(state, quantity)[body] = value
        return state
