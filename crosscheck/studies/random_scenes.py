"""Random mechanisms at random consistent states, reproducible from a seed and a number.

`random_scene(seed, number)` builds a mechanism in three steps. A tree of 2 to 8 bodies grows from the ground
by joints of random kinds. Up to three further joints close loops. All joints are defined in one pose of the
bodies, the initial pose, so that the loops are closed there. Then the mechanism moves to a random consistent
state: positions and velocities that satisfy all constraints. One mechanism in six is planar: hinges, slides
and planes share one normal, and each loop has three redundant constraints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from newton_euler.equations.dense import largest, rank
from newton_euler.equations.relative import Relative
from newton_euler.equations.system import dimensionless_jacobian
from newton_euler.errors import AssemblyError
from newton_euler.integrators.dense_projection import RESIDUAL_ROUND_OFF
from newton_euler.integrators.projection import project_position, project_velocity
from newton_euler.model.armatures import BallArmature
from newton_euler.model.control import PD
from newton_euler.model.couplings import Gear
from newton_euler.model.digital_control import Law
from newton_euler.model.euler_parameters import from_rotation_vector, rotation
from newton_euler.model.forces import BallSpring, Force, JointSpring, PointSpring, Wrench
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import JOINT_KINDS
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.motions import PrescribedMotion
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Polynomial
from newton_euler.model.state import State
from newton_euler.model.wind import STANDARD_AIR, WindLoad
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array, cross

STANDARD_GRAVITY = 9.81
"""Magnitude of gravity, m/s^2; its direction is random."""

PLANAR_FRACTION = 1.0 / 6.0
"""Fraction of planar mechanisms."""

REDUNDANT_LOOP_FRACTION = 0.2
"""Fraction of loops in mechanisms that are not planar that may have redundant constraints."""

DISPLACEMENTS = (0.5, 0.2, 0.05, 0.0)
"""Largest displacements of joints from the initial pose, rad or mechanism sizes, tried in this order until
the loops of the mechanism can be closed."""

MAX_ATTEMPTS = 10
"""Largest number of attempts to add a joint or gear that leaves the mechanism a degree of freedom."""

WRENCH_FRAMES: tuple[Literal["world", "body"], ...] = ("world", "body")
"""Frames in which the force and torque of a wrench can be given."""

KINDS = (
    "fixed",
    "revolute",
    "prismatic",
    "translational",
    "cylindrical",
    "screw",
    "planar",
    "universal",
    "spherical",
    "point_on_line",
    "compound",
    "rod",
    "free",
)
"""Joint kinds, which are chosen with equal probability.

Another length or order of this list gives other mechanisms for the same seed and number.
"""

PARALLEL_HINGES_FRACTION = 0.25
"""Fraction of revolute joints that are replaced by two parallel hinges with a link between them."""

PLANAR_KINDS = ("revolute", "prismatic", "planar", "fixed")
"""Joint kinds of planar mechanisms."""

KINDS_ALONG_AXIS = ("prismatic", "translational", "cylindrical", "screw", "point_on_line")
"""Joint kinds whose point on the second body may lie anywhere along the axis through that on the first."""


class _Draft:
    """Random mechanism under construction; the constructor adds all bodies, joints and gears.

    Attributes:
        rng: random generator of all features, except those with a separate generator.
        offset_rng: random generator of the offsets between hinges of compound joints.
        link_rng: random generator of the links between parallel hinges. Features that were added to this
            module later have separate generators, so that older features stay the same for a seed and number.
        length: order of magnitude of lengths, m.
        mass: order of magnitude of masses, kg.
        normal: common normal (3,) of a planar mechanism, else None.
        bodies: bodies so far, ground first.
        joints: joints so far.
        gears: gears so far.
    """

    def __init__(
        self, rng: np.random.Generator, offset_rng: np.random.Generator, link_rng: np.random.Generator
    ) -> None:
        self.rng, self.offset_rng, self.link_rng = rng, offset_rng, link_rng
        self.length, self.mass = 10.0 ** rng.uniform(-1.0, 1.0, 2)
        self.normal = _direction(rng) if rng.random() < PLANAR_FRACTION else None
        self.bodies = [Body.ground()]
        self.joints: list[Joint] = []
        self.gears: list[Gear] = []
        for number in range(1, rng.integers(2, 9) + 1):
            self._add_body(f"body_{number}")
        for number in range(1, rng.integers(0, 4) + 1):
            self._close_loop(f"loop_{number}")
        if rng.random() < 0.3:
            self._add_gear("gear")

    @property
    def mechanism(self) -> Mechanism:
        """Mechanism of the bodies, joints and gears so far."""
        return Mechanism(self.bodies, self.joints, self.gears)

    def _vector(self, scale: float = 1.0) -> Array:
        """Return a random vector (3,), m, with components up to `scale` times `length`."""
        return scale * self.length * self.rng.uniform(-1.0, 1.0, 3)

    def _add_body(self, name: str) -> None:
        """Add a body, and a joint that connects the body to an earlier one.

        The first joint of the mechanism is not a fixed joint, so that the mechanism can move.
        """
        rng = self.rng
        parent = self.bodies[rng.integers(len(self.bodies))]
        center = parent.center_of_mass + _direction(rng) * self.length * rng.uniform(0.3, 1.0)
        self.bodies.append(_body(rng, name, self.mass, center, self.length))
        joint = self._joint(f"to_{name}", parent, self.bodies[-1])
        while not self.joints and not joint.motions:  # a fixed joint has no motions
            joint = self._joint(joint.name, parent, self.bodies[-1])
        self.joints.append(joint)

    def _joint(self, name: str, one: Body, other: Body) -> Joint:
        """Make a joint of a random kind between two bodies, in random order of the bodies.

        All points and axes are in the world frame at the initial pose.
        """
        # Kind, point on the first body, and axis
        rng = self.rng
        kinds = KINDS if self.normal is None else PLANAR_KINDS
        kind = JOINT_KINDS[kinds[rng.integers(len(kinds))]]
        first, second = (one, other) if rng.random() < 0.5 else (other, one)
        weight = rng.uniform(0.2, 0.8)
        point = weight * first.center_of_mass + (1.0 - weight) * second.center_of_mass + self._vector(0.2)
        axis, shift = _direction(rng), self._vector(0.3)
        if self.normal is not None:
            axis = _perpendicular_part(axis, self.normal) if kind.kind == "prismatic" else self.normal
        # Further axes and dimensions of the kind
        options: dict[str, Any] = dict.fromkeys(kind.axis_names, axis)
        if kind.kind == "revolute" and self.link_rng.random() < PARALLEL_HINGES_FRACTION:
            kind = JOINT_KINDS["parallel_hinges"]
            options["offset"] = 0.3 * self.length * _direction(self.link_rng)
            # True if the angle of the second hinge counts about the reversed axis
            options["opposed"] = bool(self.link_rng.random() < 0.5)
        if kind.kind == "universal":
            options["axis_on_second"] = _perpendicular_part(_direction(rng), axis)
        if kind.kind == "screw":
            options["pitch"] = _sign(rng) * self.length * rng.uniform(0.05, 0.3)
        # Point on the second body, where it may differ from the point on the first body
        if kind.kind in KINDS_ALONG_AXIS:
            options["point_on_second"] = point + (axis @ shift) * axis
        elif kind.kind == "planar":
            options["point_on_second"] = point + shift - (axis @ shift) * axis
        elif kind.kind == "rod":
            options["point_on_second"] = second.center_of_mass + self._vector(0.2)
        elif kind.kind == "free":
            options["point_on_second"] = point + shift
        elif kind.kind == "compound":
            options = _compound_options(rng)
            displacement = shift[: len(options["slides"])] @ options["slides"]
            offsets = max(len(options["hinges"]) - 1, 0)
            if offsets and self.offset_rng.random() < 0.5:  # hinges whose axes do not meet
                reach = 0.3 * self.length
                options["offsets"] = self.offset_rng.uniform(-reach, reach, (offsets, 3))
                displacement = displacement + options["offsets"].sum(axis=0)
            options["point_on_second"] = point + displacement
        return kind(name, first.name, second.name, point, **options)

    def _close_loop(self, name: str) -> None:
        """Add a joint between two bodies that closes a loop.

        The joint leaves the mechanism a degree of freedom, and in most mechanisms adds no redundant
        constraint. After `MAX_ATTEMPTS` unsuccessful attempts the loop stays open.
        """
        _, redundant_before = _mobility(Mechanism(self.bodies, self.joints))
        for _ in range(MAX_ATTEMPTS):
            one, other = self.rng.choice(len(self.bodies), 2, replace=False)
            joint = self._joint(name, self.bodies[one], self.bodies[other])
            if joint.kind == "free":
                continue  # a free joint constrains nothing, and so closes no loop
            freedoms, redundant = _mobility(Mechanism(self.bodies, [*self.joints, joint]))
            may_be_redundant = self.normal is not None or self.rng.random() < REDUNDANT_LOOP_FRACTION
            if freedoms > 0 and (may_be_redundant or redundant == redundant_before):
                self.joints.append(joint)
                return

    def _add_gear(self, name: str) -> None:
        """Add a gear between two joint coordinates that leaves the mechanism a degree of freedom.

        After `MAX_ATTEMPTS` unsuccessful attempts there is no gear.
        """
        coordinates, rng = _coordinates(self.joints), self.rng
        for _ in range(MAX_ATTEMPTS if len(coordinates) > 1 else 0):
            (driver, i), (follower, j) = (
                coordinates[k] for k in rng.choice(len(coordinates), 2, replace=False)
            )
            units = [self._unit(joint, number) for joint, number in ((driver, i), (follower, j))]
            ratio = _sign(rng) * rng.uniform(0.3, 3.0) * units[1] / units[0]
            gear = Gear(name, driver.name, follower.name, ratio, driver_coordinate=i, follower_coordinate=j)
            freedoms, _ = _mobility(Mechanism(self.bodies, self.joints, [gear]))
            if freedoms > 0:
                self.gears.append(gear)
                return

    def _unit(self, joint: Joint, number: int) -> float:
        """Return the unit of a joint coordinate: `length` for a slide, m; 1 for a hinge, rad."""
        return float(self.length) if joint.coordinate_kinds[number] == "slide" else 1.0

    def forces(self) -> tuple[list[Force], list[Law]]:
        """Make random springs, dampers, wrenches and PD controllers, of the order of the weight.

        Joints with a controller become actuated.
        """
        rng, weight = self.rng, self.mass * STANDARD_GRAVITY
        forces, control = list[Force](), list[Law]()
        # a spring with a damper, or a controller, on one joint coordinate in ten or twenty
        for joint, coordinate in _coordinates(self.joints):
            chance, unit = rng.random(), self._unit(joint, coordinate)
            stiffness, damping = rng.uniform(0.1, 3.0, 2) * weight * self.length / unit**2
            rest = unit * rng.uniform(-1.0, 1.0)
            if chance < 0.1:
                forces.append(JointSpring(joint.name, stiffness, damping, rest, coordinate))
            elif chance < 0.15:
                control.append(PD(joint.name, stiffness, damping, target=rest, coordinate=coordinate))
        driven = {law.joint for law in control}
        self.joints = [replace(joint, actuated=joint.name in driven) for joint in self.joints]
        # a spring between two bodies, and wrenches on bodies, in some mechanisms
        if rng.random() < 0.3:
            forces.append(self._spring())
        for frame in WRENCH_FRAMES:
            if rng.random() < 0.2:
                body = self.bodies[rng.integers(1, len(self.bodies))]
                force, torque = weight * rng.normal(size=3), weight * self._vector()
                point = body.center_of_mass + self._vector(0.3)
                forces.append(Wrench(f"wrench_{frame}", body.name, point, force, torque, frame))
        return forces, control

    def _spring(self) -> PointSpring:
        """Make a random spring with a damper between points of two bodies."""
        rng, stiffness = self.rng, self.mass * STANDARD_GRAVITY / self.length
        one, other = (self.bodies[k] for k in rng.choice(len(self.bodies), 2, replace=False))
        return PointSpring(
            "spring",
            one.name,
            other.name,
            one.center_of_mass + self._vector(0.3),
            other.center_of_mass + self._vector(0.3),
            stiffness=stiffness * rng.uniform(0.1, 3.0),
            rest_length=self.length * rng.uniform(0.1, 3.0),
            damping=stiffness * rng.uniform(0.1, 3.0),
        )


def _direction(rng: np.random.Generator) -> Array:
    """Return a random unit vector, uniformly distributed."""
    return _normalized(rng.normal(size=3))


def _compound_options(rng: np.random.Generator) -> dict[str, Any]:
    """Make the options of a compound joint, which has up to three slides, followed by hinges or a ball."""
    slides, hinges = rng.integers(0, 4, 2)
    ball = bool(hinges == 0 and rng.random() < 0.5)
    return {"slides": _independent_axes(rng, slides), "hinges": _independent_axes(rng, hinges), "ball": ball}


def _independent_axes(rng: np.random.Generator, count: int) -> Array:
    """Return `count` unit vectors (count, 3): orthogonal axes, each rotated by some tenths of a radian."""
    axes = rotation(from_rotation_vector(rng.uniform(0.0, np.pi) * _direction(rng)))[:count]
    return np.array([_normalized(axis + rng.uniform(-0.2, 0.2, 3)) for axis in axes]).reshape(-1, 3)


def _ball_elements(
    rng: np.random.Generator, draft: _Draft
) -> tuple[tuple[BallSpring, ...], tuple[BallArmature, ...]]:
    """Make random springs with dampers, and armatures (rotor inertias), of some balls in joints.

    A ball is a motion of a joint with three rotational degrees of freedom. Springs and armatures are of the
    order of the weight and of the inertias of the mechanism.
    """
    torque, inertia = draft.mass * STANDARD_GRAVITY * draft.length, 0.1 * draft.mass * draft.length**2
    springs, armatures = list[BallSpring](), list[BallArmature]()
    for joint in draft.joints:
        chances, (stiffness, damping, armature) = rng.random(2), rng.uniform(0.1, 3.0, 3)
        rest = rng.uniform(-1.0, 1.0, 3)
        if any(motion.kind == "ball" for motion in joint.motions):
            if chances[0] < 0.2:
                springs.append(BallSpring(joint.name, stiffness * torque, damping * torque, rest))
            if chances[1] < 0.2:
                armatures.append(BallArmature(joint.name, armature * inertia))
    return tuple(springs), tuple(armatures)


def _wind(rng: np.random.Generator, draft: _Draft) -> tuple[WindLoad, ...]:
    """Make a random wind load on a plate of one body, of the order of the weight, in some mechanisms."""
    body = draft.bodies[rng.integers(1, len(draft.bodies))]
    (first, second, _), sizes = _independent_axes(rng, 3), draft.length * rng.uniform(0.2, 1.0, 2)
    second = _perpendicular_part(second, first)
    sides = {"first_side": sizes[0] * first, "second_side": sizes[1] * second}
    # the speed in standard air at which the wind force on the plate is of the order of the weight
    speed = np.sqrt(draft.mass * STANDARD_GRAVITY / (STANDARD_AIR * np.prod(sizes))) * rng.uniform(0.3, 3.0)
    point = body.center_of_mass + 0.3 * draft.length * rng.normal(size=3)
    load = WindLoad("wind", body.name, point, **sides, direction=_direction(rng), speed=float(speed))
    return (load,) if rng.random() < 0.2 else ()


def _normalized(vector: Array) -> Array:
    """Return a vector divided by its length."""
    return np.asarray(vector / np.linalg.norm(vector))


def _perpendicular_part(vector: Array, axis: Array) -> Array:
    """Return the unit vector along the part of a vector (3,) that is perpendicular to a unit axis (3,)."""
    return _normalized(cross(axis, cross(vector, axis)))


def _sign(rng: np.random.Generator) -> float:
    """Return a random sign, -1 or 1."""
    return float(rng.choice([-1.0, 1.0]))


def _body(rng: np.random.Generator, name: str, mass: float, center: Array, length: float) -> Body:
    """Make a body at a center of mass (3,), m, with a random mass, orientation and inertia.

    The inertia is physical: that of masses with random mean square distances from the center along three
    axes. `mass`, kg, and `length`, m, are orders of magnitude.
    """
    mass = mass * 10.0 ** rng.uniform(-1.0, 1.0)
    mean_squares = (length * rng.uniform(0.03, 0.5, 3)) ** 2
    turn = rotation(from_rotation_vector(rng.uniform(0.0, np.pi) * _direction(rng)))
    # principal moments of inertia, such as m (<y^2> + <z^2>)
    inertia = turn @ np.diag(mass * (np.sum(mean_squares) - mean_squares)) @ turn.T
    return Body(name, mass, center, 0.5 * (inertia + inertia.T), _normalized(rng.normal(size=4)))


def _coordinates(joints: Sequence[Joint]) -> list[tuple[Joint, int]]:
    """List all hinge and slide coordinates, each as a joint and the index of the coordinate in the joint."""
    return [(joint, k) for joint in joints for k in range(len(joint.coordinate_kinds))]


def _mobility(mechanism: Mechanism) -> tuple[int, int]:
    """Return the numbers of degrees of freedom and of redundant constraints at the initial pose."""
    # `Relative`: equations of motion in the joint coordinates q of a spanning tree
    system = Relative(Scene("draft", mechanism, duration=1.0, output_period=1.0))
    return _mobility_at(system, system.coordinates(initial_state(system.scene))[0])


def _mobility_at(system: Relative, q: Array) -> tuple[int, int]:
    """Return the numbers of degrees of freedom and of redundant constraints at coordinates q (nq,)."""
    jacobian = dimensionless_jacobian(system, q)  # of all constraints, (constraints, nv)
    independent = rank(jacobian)
    return system.nv - independent, len(jacobian) - independent


def _random_state(rng: np.random.Generator, mechanism: Mechanism) -> State:
    """Find a random state that satisfies all constraints, away from the initial pose if possible.

    The state has the same numbers of freedoms and redundant constraints as the initial pose. Velocities are
    of the order of 0.3 to 10 rad/s or mechanism sizes per second.
    """
    system = Relative(Scene("draft", mechanism, duration=1.0, output_period=1.0))
    start, _ = system.coordinates(initial_state(system.scene))
    wanted = _mobility_at(system, start)
    # Displace the joints and close the loops; the last displacement, 0, always succeeds
    for reach in DISPLACEMENTS:
        step = reach * system.velocity_units * rng.uniform(-1.0, 1.0, system.nv)
        try:
            q = project_position(system, system.retract(start, step))
        except AssemblyError:
            continue
        # accept only loops closed to round-off: 4 is a margin on the residual at which the projection stops
        if (
            largest(system.phi(q)) < 4.0 * RESIDUAL_ROUND_OFF * mechanism.size
            and _mobility_at(system, q) == wanted
        ):
            break
    # Random velocities, projected onto those that the constraints allow
    speed = 10.0 ** rng.uniform(-0.5, 1.0)
    v = project_velocity(system, q, speed * system.velocity_units * rng.normal(size=system.nv))
    return system.state(q, project_velocity(system, q, v))  # a second projection removes round-off


def _with_prescribed_motion(rng: np.random.Generator, scene: Scene) -> Scene:
    """Return the scene with a prescribed motion of one joint coordinate, if a degree of freedom remains.

    The motion continues the initial position and rate of the coordinate with a random acceleration.
    """
    coordinates, state = _coordinates(scene.mechanism.joints), initial_state(scene)
    system, frames = Relative(scene), state.frames()
    freedoms, redundant = _mobility_at(system, system.coordinates(state)[0])
    for k in rng.permutation(len(coordinates)):
        # Value and rate of the coordinate, from the frames of the two bodies that the joint connects
        joint, coordinate = coordinates[k]
        equations = scene.mechanism.joint_equations(joint.name)
        first, second = frames[equations.first], frames[equations.second]
        measured = equations.coordinates[coordinate]
        value = float(measured.phi(first, second)[0])
        rate = float(measured.jacobian(first, second).rate(first, second)[0])
        # Prescribe the coordinate as a polynomial of time, and accept that if one freedom is lost
        unit = scene.mechanism.size if measured.is_length else 1.0
        motion = PrescribedMotion(joint.name, Polynomial((value, rate, unit * rng.normal())), coordinate)
        driven = replace(scene, motions=(motion,))
        system = Relative(driven)
        mobility = _mobility_at(system, system.coordinates(state)[0])
        if mobility == (freedoms - 1, redundant) and freedoms > 1:
            return driven
    return scene


def random_scene(seed: int, number: int) -> Scene:
    """Generate a random mechanism whose initial state is a random consistent state.

    Args:
        seed: whole number that selects a series of scenes.
        number: whole number of the scene in the series. Equal pairs of seed and number give equal scenes.
    """
    rng = np.random.default_rng([seed, number])
    # Features that were added later have generators with a third number, so that earlier features stay the
    # same
    draft = _Draft(rng, np.random.default_rng([seed, number, 2]), np.random.default_rng([seed, number, 4]))
    forces, control = draft.forces()
    springs, armatures = _ball_elements(np.random.default_rng([seed, number, 1]), draft)
    mechanism = draft.mechanism
    scene = Scene(
        f"random_{seed}_{number}",
        mechanism,
        duration=1.0,
        output_period=0.1,
        gravity=STANDARD_GRAVITY * _direction(rng),
        control=tuple(control),
        initial_state=_random_state(rng, mechanism),
        forces=(*forces, *springs, *_wind(np.random.default_rng([seed, number, 3]), draft)),
        armatures=armatures,
        description=f"random mechanism {number} of seed {seed}",
    )
    return _with_prescribed_motion(rng, scene) if rng.random() < 0.15 else scene
