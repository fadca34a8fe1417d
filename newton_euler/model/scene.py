"""Scene: a mechanism with everything that one simulation of it needs.

A `Scene` holds the mechanism, gravity, control laws, forces, prescribed motions, rotor inertias, the initial
state, and the duration and outputs of the run. Its constructor checks all of them. Every engine simulates a
scene. The decorator `description` makes a class a frozen dataclass. Its fields of type `ArrayField` and
`TupleField` accept any sequence and hold an array or a tuple.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Set
from dataclasses import replace
from functools import cached_property
from typing import ClassVar, Literal, get_args

import numpy as np

from newton_euler.errors import (
    MechanismError,
    check_choices,
    elements_of,
    is_finite_number,
    items_of,
    listed,
    quoted,
    set_finite_arrays,
)
from newton_euler.model.armatures import Armature, BallArmature
from newton_euler.model.control import sensed
from newton_euler.model.couplings import Gear
from newton_euler.model.description import ArrayField, TupleField, description
from newton_euler.model.digital_control import Digital, HeldLaw, Law, Sampled
from newton_euler.model.elements import OnBall, check_elements
from newton_euler.model.fields import NumberField
from newton_euler.model.forces import Force, JointSpring
from newton_euler.model.geometry import UNIT_TOLERANCE
from newton_euler.model.joint import Key
from newton_euler.model.mechanism import CLOSURE_TOLERANCE, Mechanism
from newton_euler.model.motions import PrescribedMotion, TimeFunction, terms
from newton_euler.model.splines import TIME_ROUND_OFF, Spline
from newton_euler.model.state import State
from newton_euler.model.switched_forces import ElasticGear, JointFriction, SwitchedElement, SwitchedForce
from newton_euler.model.variable import Variable, functions_of
from newton_euler.scalars import Array

OutputName = Literal["velocities", "reactions", "actuation", "violation", "energy"]
"""Optional outputs of a run, in addition to body poses.

They are body velocities, joint reactions, forces of control laws, constraint violations of the joints, and
energies with the work of forces. `newton_euler.model.trajectory.QUANTITIES` lists the arrays of each output.
"""

OUTPUTS: tuple[OutputName, ...] = get_args(OutputName)
"""Names of all optional outputs."""

ELEMENT_KINDS: dict[str, tuple[type, ...]] = {
    "control": get_args(Law),
    "motions": (PrescribedMotion,),
    "forces": get_args(Force),
    "armatures": (Armature, BallArmature),
}
"""Allowed classes of the elements in each field of a scene, by field name."""

MAXIMUM_OUTPUTS = 1_000_000
"""Largest number of output times of a scene."""

MAXIMUM_DURATION = 1e7
"""Longest duration of a scene, s: four months. With steps of a millisecond such a run already takes a day."""

MAXIMUM_ANGLE = 1e9
"""Largest hinge angle in a state, rad. Neighboring floats of this size differ by 1e-7 rad; larger angles
would be less accurate than poses."""

REDUNDANCY_TOLERANCE = 1e-4
"""Default of `Scene.redundancy_tolerance`, dimensionless: the noise of model files whose points are rounded
to 1e-6 m, for a mechanism of a centimeter."""

_SCENE_NAME = re.compile(r"[A-Za-z0-9_.\-]{1,100}")


def _knots(functions: Iterable[TimeFunction]) -> tuple[float, ...]:
    """Return the knots, s, of several functions of time, ascending: times at which a derivative jumps.

    Knots that differ only by round-off count once.
    """
    knots: list[float] = []
    for knot in sorted({knot for function in functions for knot in function.knots}):
        if not knots or knot - knots[-1] > TIME_ROUND_OFF * abs(knot):
            knots.append(knot)
    return tuple(knots)


@description
class Scene(Variable):
    """A mechanism, the forces and control laws that act on it, its initial state, and the outputs of a run.

    Attributes:
        name: name of the scene and of its result files: letters, digits, `_`, `.` and `-`, at most 100, not
            `.` or `..`.
        mechanism: bodies, joints and couplings.
        duration: duration of the run, s, at most 1e7.
        output_period: time between outputs, s; the last output is at `duration`. A run has at most 1,000,000
            outputs.
        gravity: (3,) acceleration of gravity, m/s^2, world frame.
        control: control laws of actuated joints, in the order of `Trajectory.actuator_force`: `PD`,
            `StateFeedback`, `ComputedTorque`, `Digital` and `Sampled`.
        initial_state: state from which runs start. It must satisfy all joint constraints in position and
            velocity, as states from `newton_euler.assemble` do. None starts from the mechanism's initial pose
            at rest; prescribed motions that differ from this pose move the start.
            `newton_euler.initial_state` returns the state used.
        outputs: names of optional outputs: "velocities" of bodies, "reactions" of joints, "actuation" (forces
            of control laws), "violation" of constraints, and "energy" (energies and work). All by default;
            fewer make runs faster.
        forces: springs, dampers, friction, stops, wrenches and wind loads, in addition to gravity and control
            laws: `JointSpring`, `JointFriction`, `JointStop`, `ElasticGear`, `BallSpring`, `PointSpring`,
            `Wrench` and `WindLoad`.
        motions: prescribed motions of joint coordinates, `PrescribedMotion`.
        armatures: rotor inertias on joint coordinates and ball joints.
        description: one line of printable text for people.
        redundancy_tolerance: size, without unit, of the independent part of a constraint equation below which
            the equation counts as redundant. With 0 only equations
            that are dependent to round-off are redundant.

    Raises:
        MechanismError: naming the invalid field, body or joint.
        UnknownNameError: for an unknown output.

    Examples:
        >>> rod = Body("rod", 1.0, [0.5, 0.0, 0.0], np.diag([0.001, 0.1, 0.1]))
        >>> hinge = Revolute("hinge", "ground", "rod", [0.0, 0.0, 0.0], axis=[0.0, 1.0, 0.0])
        >>> Scene("swing", Mechanism([Body.ground(), rod], [hinge]), 1.0, 0.1, (0.0, 0.0, -9.81))
        <Scene 'swing': 11 outputs to 1 s, bodies: 2, joints: 1>
    """

    name: str
    mechanism: Mechanism
    duration: float
    output_period: float
    gravity: ArrayField = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    control: TupleField[Law] = ()  # type: ignore[assignment]
    initial_state: State | None = None
    outputs: Set[OutputName] = frozenset(OUTPUTS)
    forces: TupleField[Force] = ()  # type: ignore[assignment]
    motions: TupleField[PrescribedMotion] = ()  # type: ignore[assignment]
    armatures: TupleField[Armature | BallArmature] = ()  # type: ignore[assignment]
    description: str = ""
    redundancy_tolerance: float = REDUNDANCY_TOLERANCE

    # Numbers of the scene itself that may vary from run to run, and reasons why others cannot. The initial
    # coordinate of a joint varies under the name start.JOINT, a list of initial states as argument `states`
    number_fields: ClassVar = {"gravity": NumberField("m/s^2", shape=(3,))}
    constant: ClassVar = {
        "duration": "the same in all runs",
        "output_period": "the same in all runs",
        "redundancy_tolerance": "a choice of constraints, which is made once for all runs",
        "initial_state": "the state of all bodies, which coordinates (start.JOINT) or `states` determine",
    }

    @np.errstate(all="ignore")  # numbers that overflow are refused here or by a run
    def __post_init__(self) -> None:
        # Check the name, the mechanism and the times of the run
        self._check_texts()
        where = f"scene {quoted(self.name)}"
        if not isinstance(self.mechanism, Mechanism):
            raise MechanismError(where, f"mechanism is {quoted(self.mechanism)}", "a Mechanism")
        for name in ("duration", "output_period"):
            value = getattr(self, name)
            if not is_finite_number(value) or not 0.0 < value <= MAXIMUM_DURATION:
                needed = f"a positive number of seconds, at most {MAXIMUM_DURATION:g}"
                raise MechanismError(where, f"{name} is {quoted(value)}", needed)
            object.__setattr__(self, name, float(value))
        tolerance = self.redundancy_tolerance
        if not is_finite_number(tolerance) or not 0.0 <= tolerance < 1.0:
            raise MechanismError(
                where, f"redundancy_tolerance is {quoted(tolerance)}", "a number from 0 to below 1"
            )
        if self.duration > MAXIMUM_OUTPUTS * self.output_period:
            raise MechanismError(
                where,
                f"duration {self.duration:g} s at output_period {self.output_period:g} s asks for more "
                f"than {MAXIMUM_OUTPUTS} outputs",
                "a longer output_period",
            )

        # Check gravity, the outputs, the elements and the initial state
        set_finite_arrays(self, where, gravity=(3,))
        outputs = items_of(self.outputs)
        if outputs is None:
            raise MechanismError(where, f"outputs is {quoted(self.outputs)}", "a set of names")
        check_choices("output", outputs, OUTPUTS)
        object.__setattr__(self, "outputs", frozenset(outputs))
        for field, kinds in ELEMENT_KINDS.items():
            elements = elements_of(where, field, getattr(self, field), *kinds)
            check_elements(elements, self.mechanism)
            object.__setattr__(self, field, elements)
        self.check_functions(0.0, self.duration, "the end of the run")
        if self.initial_state is not None:
            self._check_state(self.initial_state)

    def __repr__(self) -> str:
        size = f"bodies: {len(self.mechanism.bodies)}, joints: {len(self.mechanism.joints)}"
        return f"<Scene {self.name!r}: {len(self.times)} outputs to {self.duration:g} s, {size}>"

    def _check_texts(self) -> None:
        """Raise `MechanismError` for a name that cannot name files, or a description that is not one line."""
        name, description = self.name, self.description
        if not isinstance(name, str) or not _SCENE_NAME.fullmatch(name) or name in (".", ".."):
            needed = "letters, digits, _, . and - only, at most 100, not . or .."
            raise MechanismError("scene", f"name is {quoted(name, 150)}", needed)
        if not isinstance(description, str) or not description.isprintable():
            raise MechanismError(
                f"scene {quoted(name)}",
                f"description is {quoted(description, 150)}",
                "one line of printable text",
            )

    def check_functions(self, begin: float, end: float, noun: str) -> None:
        """Raise `MechanismError` if a spline of the scene does not cover an interval of time.

        Args:
            begin, end: the interval, s.
            noun: description of the interval for the error message, such as "the end of the run".
        """
        for element in (*self.motions, *self.control, *self.forces):
            given = element.law if isinstance(element, Digital) else element
            for name in given.functions:
                for term in (term for f in functions_of(getattr(given, name)) for term in terms(f)):
                    if isinstance(term, Spline) and not term.covers(begin, end):
                        span = f"{name} is known from {term.times[0]:.9g} to {term.times[-1]:.9g} s"
                        needed = f"samples from {begin:g} to {end:g} s, {noun}"
                        raise MechanismError(element.element, span, needed)

    @np.errstate(all="ignore")  # a norm may overflow
    def check_numbers(self, state: object, where: str) -> None:
        """Raise `MechanismError` unless a value is a `State` of the scene's bodies with finite numbers.

        The state may violate joint constraints.

        Args:
            state: the value.
            where: name of the value, for the error message.
        """
        if not isinstance(state, State):
            raise MechanismError(where, f"is {quoted(state, 200)}", "a State")
        count = len(self.mechanism.bodies)
        for name, width in (
            ("position", 3),
            ("quaternion", 4),
            ("linear_velocity", 3),
            ("angular_velocity", 3),
        ):
            value = getattr(state, name)
            if (
                not isinstance(value, np.ndarray)
                or value.dtype.kind != "f"
                or value.shape != (count, width)
                or np.ma.is_masked(value)
                or not np.all(np.isfinite(value))
            ):
                raise MechanismError(
                    where,
                    f"{name} has another shape, or holds what is masked or not finite",
                    f"an array of finite floats, shape ({count}, {width})",
                )
        self.check_angles(state.angles, where)
        norms = np.linalg.norm(state.quaternion, axis=1)
        if not np.all(norms > UNIT_TOLERANCE):
            body = self.mechanism.body_names[int(np.argmin(norms))]
            raise MechanismError(where, f"quaternion of body {quoted(body)} is zero", "one of norm 1")

    def check_angles(self, angles: object, where: str) -> None:
        """Raise `MechanismError` unless a value is a mapping from hinge coordinates to finite angles, rad.

        Args:
            angles: the value, see `State.angles`.
            where: name of the value, for the error message.
        """
        if not isinstance(angles, Mapping):
            raise MechanismError(where, f"angles is {quoted(angles)}", "angles in rad by (joint, coordinate)")
        for key, angle in angles.items():
            if key not in self.mechanism.coordinate_labels or self.mechanism.is_slide(*key):
                hinges = (
                    key for key in self.mechanism.coordinate_labels if not self.mechanism.is_slide(*key)
                )
                shown = listed(hinges) or "none, as no joint has a hinge"
                raise MechanismError(where, f"angles has {quoted(key)}", f"one of {shown}")
            if not is_finite_number(angle) or abs(angle) > MAXIMUM_ANGLE:
                needed = f"a number of rad, at most {MAXIMUM_ANGLE:g}"
                raise MechanismError(where, f"angle of {key!r} is {quoted(angle)}", needed)

    def _check_state(self, state: State) -> None:
        """Raise `MechanismError` for a state with invalid numbers or quaternions, or a moved ground."""
        self.check_numbers(state, f"initial state of scene {quoted(self.name)}")
        norms = np.linalg.norm(state.quaternion, axis=1)
        worst = int(np.argmax(np.abs(norms - 1.0)))
        if abs(norms[worst] - 1.0) > UNIT_TOLERANCE:
            raise MechanismError(
                f"body {quoted(self.mechanism.body_names[worst])}",
                f"initial quaternion has norm {norms[worst]:.9g}",
                "a unit quaternion, w-x-y-z",
            )
        self._check_ground(state)

    def _check_ground(self, state: State) -> None:
        """Raise `MechanismError` unless the ground has its described pose and is at rest in a state."""
        ground = self.mechanism.bodies[0]
        shift = float(np.linalg.norm(state.position[0] - ground.center_of_mass))
        # Compare outer products, because q and -q are the same orientation
        turn = float(
            np.linalg.norm(
                np.outer(state.quaternion[0], state.quaternion[0])
                - np.outer(ground.quaternion, ground.quaternion)
            )
        )
        if shift > CLOSURE_TOLERANCE or turn > UNIT_TOLERANCE:
            problem = "is not at its own pose in the initial state"
        elif np.any(state.linear_velocity[0]) or np.any(state.angular_velocity[0]):
            problem = "moves in the initial state"
        else:
            return
        raise MechanismError(f"ground {quoted(ground.name)}", problem, "the ground's own pose, at rest")

    def without_forces(self) -> Scene:
        """Return the scene with its mechanism and prescribed motions only, for kinematic analyses."""
        return replace(self, control=(), forces=(), armatures=(), outputs=frozenset())

    @cached_property
    def with_unloaded_friction(self) -> Scene:
        """The scene without friction that grows with reactions, which is zero at rest; the same object each
        time."""
        forces = tuple(
            replace(force, load_coefficient=0.0)
            if isinstance(force, JointFriction) and force.is_loaded
            else force
            for force in self.forces
        )
        return self if forces == self.forces else replace(self, forces=forces)

    @cached_property
    def with_rigid_gears(self) -> Scene:
        """The scene with a rigid gear in place of each elastic gear: without play, deflection and friction.

        It is the same object each time, so that its compiled equations are used again.
        """
        gears = [force for force in self.forces if isinstance(force, ElasticGear)]
        if not gears:
            return self
        mechanism = self.mechanism
        taken = {*mechanism.joint_names, *(coupling.name for coupling in mechanism.couplings)}
        rigid = []
        for gear in gears:
            name = gear.name
            while name in taken:  # names of forces may be those of joints
                name += "_"
            taken.add(name)
            (driver, k), (follower, j) = gear.keys
            rigid.append(Gear(name, driver, follower, gear.ratio, k, j))
        couplings = (*mechanism.couplings, *rigid)
        return replace(
            self,
            mechanism=Mechanism(mechanism.bodies, mechanism.joints, couplings),
            forces=tuple(force for force in self.forces if not isinstance(force, ElasticGear)),
        )

    @property
    def sampled(self) -> tuple[Sampled | Digital, ...]:
        """Control laws in discrete time, whose force is held constant between sampling instants."""
        return tuple(law for law in self.control if isinstance(law, HeldLaw))

    @property
    def sensed(self) -> tuple[Key, ...]:
        """Joint coordinates on which control laws act, in the order of the laws, then other coordinates that
        laws read."""
        return sensed(self.control)

    @property
    def functions(self) -> dict[tuple[str, int, str], tuple[TimeFunction, ...]]:
        """Functions of time of all elements, by (field of the scene, index of the element, attribute)."""
        by_place = {}
        for field in ("motions", "control", "forces"):
            for k, element in enumerate(getattr(self, field)):
                for attribute in element.functions:
                    if functions := functions_of(getattr(element, attribute)):
                        by_place[field, k, attribute] = functions
        return by_place

    @property
    def knots(self) -> tuple[float, ...]:
        """Times, s, at which a derivative of a function of time jumps, ascending; integrators restart
        there."""
        return _knots(function for functions in self.functions.values() for function in functions)

    @property
    def jumps(self) -> tuple[float, ...]:
        """Knots, s, ascending, of all attributes that have at least one function whose value jumps."""
        jumping = (functions for functions in self.functions.values() if any(f.jumps for f in functions))
        return _knots(function for functions in jumping for function in functions)

    @cached_property
    def joint_forces(self) -> tuple[Law | JointSpring, ...]:
        """The control laws, then the joint springs. Each acts on one joint coordinate."""
        return (*self.control, *(force for force in self.forces if isinstance(force, JointSpring)))

    @cached_property
    def switched_forces(self) -> tuple[SwitchedElement, ...]:
        """Dry friction, stops and elastic gears, whose formulas change at certain states."""
        return tuple(force for force in self.forces if isinstance(force, SwitchedForce))

    @cached_property
    def loaded_coordinates(self) -> tuple[Key, ...]:
        """Joint coordinates on which control laws and other forces act, in their order, with repetitions."""
        return tuple(key for force in (*self.control, *self.forces) for key in force.keys)

    @property
    def body_forces(self) -> tuple[Force, ...]:
        """Forces that act on bodies: ball springs, point springs, wrenches and wind loads."""
        return tuple(force for force in self.forces if not force.keys)

    @property
    def loaded_balls(self) -> frozenset[str]:
        """Names of the joints with a spring, damper or armature on their ball."""
        return frozenset(each.joint for each in (*self.forces, *self.armatures) if isinstance(each, OnBall))

    @property
    def needs_accelerations(self) -> bool:
        """True if an output depends on accelerations, so that the equations of motion are solved at output
        times."""
        return not self.outputs.isdisjoint(("reactions", "actuation"))

    @property
    def tracks_work(self) -> bool:
        """True if runs integrate, as an additional state, the work of forces without potential energy."""
        return "energy" in self.outputs and len(self.control) + len(self.forces) + len(self.motions) > 0

    @cached_property
    def times(self) -> Array:
        """(n,) output times, s: the multiples of the output period from 0, and the end of the run."""
        # The factors allow for round-off in a duration that is meant to be a multiple of the period
        count = int(np.floor(self.duration / self.output_period * (1.0 + 1e-12)))
        times = self.output_period * np.arange(count + 1)
        if self.duration - times[-1] > 1e-9 * self.output_period:
            return np.append(times, self.duration)
        times[-1] = self.duration
        return times
