"""Random mechanisms at random consistent states, each reproducible from (seed, number).

A tree of 2 to 8 bodies grows from the ground by joints of random kinds. Then up to three joints close loops.
All joints are placed in one pose of the bodies, so that the loops are closed by construction. Then the
mechanism is moved to a random state that its loops allow. One mechanism in six is planar: its hinges, slides
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
from newton_euler.model.control import PD
from newton_euler.model.couplings import Gear
from newton_euler.model.digital_control import Law
from newton_euler.model.euler_parameters import from_rotation_vector, rotation
from newton_euler.model.forces import BallArmature, BallSpring, Force, JointSpring, PointSpring, Wrench
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
"""m/s^2, in a random direction."""

PLANAR_FRACTION = 1.0 / 6.0
"""Fraction of planar mechanisms."""

REDUNDANT_LOOP_FRACTION = 0.2
"""Fraction of loops in other mechanisms that may have redundant constraints."""

DISPLACEMENTS = (0.5, 0.2, 0.05, 0.0)
"""rad or mechanism sizes, displacements of joints from the initial pose, tried in this order."""

MAX_ATTEMPTS = 10
"""Largest number of attempts to add a joint or gear that leaves the mechanism a degree of freedom."""

WRENCH_FRAMES: tuple[Literal["world", "body"], ...] = ("world", "body")

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
"""Joint kinds. Another length or order of this list gives other mechanisms for the same numbers."""

PARALLEL_HINGES_FRACTION = 0.25
"""Fraction of revolute joints that become two parallel hinges."""

PLANAR_KINDS = ("revolute", "prismatic", "planar", "fixed")
"""Joint kinds of planar mechanisms."""

KINDS_ALONG_AXIS = ("prismatic", "translational", "cylindrical", "screw", "point_on_line")
"""Joint kinds whose second point may lie anywhere along the axis."""


class _Draft:
    """Mechanism under construction.

    Attributes:
        rng, of_offsets, of_links: random generators. Features that were added later have their own
            generators, so that the mechanisms of a number keep their other features.
        length, mass: m and kg, orders of magnitude of lengths and masses.
        normal: (3,) common normal of a planar mechanism, else None.
    """

    def __init__(
        self, rng: np.random.Generator, of_offsets: np.random.Generator, of_links: np.random.Generator
    ) -> None:
        self.rng, self.of_offsets, self.of_links = rng, of_offsets, of_links
        self.length, self.mass = 10.0 ** rng.uniform(-1.0, 1.0, 2)
        self.normal = _direction(rng) if rng.random() < PLANAR_FRACTION else None
        self.bodies = [Body.ground()]
        self.joints: list[Joint] = []
        self.gears: list[Gear] = []
        for number in range(1, rng.integers(2, 9) + 1):
            self._grow(f"body_{number}")
        for number in range(1, rng.integers(0, 4) + 1):
            self._close(f"loop_{number}")
        if rng.random() < 0.3:
            self._couple("gear")

    @property
    def mechanism(self) -> Mechanism:
        """The mechanism as far as it is built."""
        return Mechanism(self.bodies, self.joints, self.gears)

    def _vector(self, scale: float = 1.0) -> Array:
        """Return a random vector (3,), m."""
        return scale * self.length * self.rng.uniform(-1.0, 1.0, 3)

    def _grow(self, name: str) -> None:
        """Add a body and a joint that connects it to an earlier body. The first joint of a mechanism can
        move."""
        rng = self.rng
        parent = self.bodies[rng.integers(len(self.bodies))]
        center = parent.center_of_mass + _direction(rng) * self.length * rng.uniform(0.3, 1.0)
        self.bodies.append(_body(rng, name, self.mass, center, self.length))
        joint = self._joint(f"to_{name}", parent, self.bodies[-1])
        while not self.joints and not joint.motions:
            joint = self._joint(joint.name, parent, self.bodies[-1])
        self.joints.append(joint)

    def _joint(self, name: str, one: Body, other: Body) -> Joint:
        """Make a joint of a random kind between two bodies, in random order of the bodies."""
        rng = self.rng
        kinds = KINDS if self.normal is None else PLANAR_KINDS
        kind = JOINT_KINDS[kinds[rng.integers(len(kinds))]]
        first, second = (one, other) if rng.random() < 0.5 else (other, one)
        share = rng.uniform(0.2, 0.8)
        point = share * first.center_of_mass + (1.0 - share) * second.center_of_mass + self._vector(0.2)
        axis, shift = _direction(rng), self._vector(0.3)
        if self.normal is not None:
            axis = _across(axis, self.normal) if kind.kind == "prismatic" else self.normal
        options: dict[str, Any] = dict.fromkeys(kind.axis_names, axis)
        if kind.kind == "revolute" and self.of_links.random() < PARALLEL_HINGES_FRACTION:
            kind = JOINT_KINDS["parallel_hinges"]
            options["offset"] = 0.3 * self.length * _direction(self.of_links)
            options["opposed"] = bool(self.of_links.random() < 0.5)
        if kind.kind == "universal":
            options["axis_on_second"] = _across(_direction(rng), axis)
        if kind.kind == "screw":
            options["pitch"] = _sign(rng) * self.length * rng.uniform(0.05, 0.3)
        if kind.kind in KINDS_ALONG_AXIS:
            options["point_on_second"] = point + (axis @ shift) * axis
        elif kind.kind == "planar":
            options["point_on_second"] = point + shift - (axis @ shift) * axis
        elif kind.kind == "rod":
            options["point_on_second"] = second.center_of_mass + self._vector(0.2)
        elif kind.kind == "free":
            options["point_on_second"] = point + shift
        elif kind.kind == "compound":
            options = _compound(rng)
            beyond = shift[: len(options["slides"])] @ options["slides"]
            missing = max(len(options["hinges"]) - 1, 0)
            if missing and self.of_offsets.random() < 0.5:  # hinges whose axes do not meet
                reach = 0.3 * self.length
                options["offsets"] = self.of_offsets.uniform(-reach, reach, (missing, 3))
                beyond = beyond + options["offsets"].sum(axis=0)
            options["point_on_second"] = point + beyond
        return kind(name, first.name, second.name, point, **options)

    def _close(self, name: str) -> None:
        """Add a joint between two bodies that closes a loop.

        The joint leaves the mechanism a degree of freedom, and in most mechanisms adds no redundant
        constraint.
        """
        before = _rank(Mechanism(self.bodies, self.joints))[1]
        for _ in range(MAX_ATTEMPTS):
            one, other = self.rng.choice(len(self.bodies), 2, replace=False)
            joint = self._joint(name, self.bodies[one], self.bodies[other])
            if joint.kind == "free":
                continue  # a free joint closes no loop
            freedoms, redundant = _rank(Mechanism(self.bodies, [*self.joints, joint]))
            may_repeat = self.normal is not None or self.rng.random() < REDUNDANT_LOOP_FRACTION
            if freedoms > 0 and (may_repeat or redundant == before):
                self.joints.append(joint)
                return

    def _couple(self, name: str) -> None:
        """Add a gear between two joint coordinates that leaves the mechanism a degree of freedom."""
        keys, rng = _coordinates(self.joints), self.rng
        for _ in range(MAX_ATTEMPTS if len(keys) > 1 else 0):
            (driver, i), (follower, j) = (keys[k] for k in rng.choice(len(keys), 2, replace=False))
            units = [self._unit(joint, number) for joint, number in ((driver, i), (follower, j))]
            ratio = _sign(rng) * rng.uniform(0.3, 3.0) * units[1] / units[0]
            gear = Gear(name, driver.name, follower.name, ratio, i, j)
            freedoms, _ = _rank(Mechanism(self.bodies, self.joints, [gear]))
            if freedoms > 0:
                self.gears.append(gear)
                return

    def _unit(self, joint: Joint, number: int) -> float:
        return float(self.length) if joint.coordinate_kinds[number] == "slide" else 1.0

    def forces(self) -> tuple[list[Force], list[Law]]:
        """Make random springs, dampers, wrenches and PD controllers, of the order of the weight."""
        rng, weight = self.rng, self.mass * STANDARD_GRAVITY
        forces, control = list[Force](), list[Law]()
        for joint, coordinate in _coordinates(self.joints):
            chance, unit = rng.random(), self._unit(joint, coordinate)
            stiffness, damping = rng.uniform(0.1, 3.0, 2) * weight * self.length / unit**2
            rest = unit * rng.uniform(-1.0, 1.0)
            if chance < 0.1:
                forces.append(JointSpring(joint.name, stiffness, damping, rest, coordinate))
            elif chance < 0.15:
                control.append(PD(joint.name, stiffness, damping, rest, coordinate))
        driven = {law.joint for law in control}
        self.joints = [replace(joint, actuated=joint.name in driven) for joint in self.joints]
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
    return _unit(rng.normal(size=3))


def _compound(rng: np.random.Generator) -> dict[str, Any]:
    """Make the options of a compound joint: slides, and hinges or a ball, whose axes are well independent."""
    slides, hinges = rng.integers(0, 4, 2)
    ball = bool(hinges == 0 and rng.random() < 0.5)
    return {"slides": _askew(rng, slides), "hinges": _askew(rng, hinges), "ball": ball}


def _askew(rng: np.random.Generator, count: int) -> Array:
    """Return `count` orthonormal axes (count, 3), each rotated by some tenths of a radian."""
    axes = rotation(from_rotation_vector(rng.uniform(0.0, np.pi) * _direction(rng)))[:count]
    return np.array([_unit(axis + rng.uniform(-0.2, 0.2, 3)) for axis in axes]).reshape(-1, 3)


def _of_balls(
    rng: np.random.Generator, draft: _Draft
) -> tuple[tuple[BallSpring, ...], tuple[BallArmature, ...]]:
    """Make random springs, dampers and rotors of balls, of the order of the weight and of the inertias."""
    torque, inertia = draft.mass * STANDARD_GRAVITY * draft.length, 0.1 * draft.mass * draft.length**2
    springs, rotors = list[BallSpring](), list[BallArmature]()
    for joint in draft.joints:
        chances, (stiffness, damping, rotor) = rng.random(2), rng.uniform(0.1, 3.0, 3)
        rest = rng.uniform(-1.0, 1.0, 3)
        if any(motion.kind == "ball" for motion in joint.motions):
            if chances[0] < 0.2:
                springs.append(BallSpring(joint.name, stiffness * torque, damping * torque, rest))
            if chances[1] < 0.2:
                rotors.append(BallArmature(joint.name, rotor * inertia))
    return tuple(springs), tuple(rotors)


def _wind(rng: np.random.Generator, draft: _Draft) -> tuple[WindLoad, ...]:
    """Make a random wind load on a plate of one body, of the order of the weight, in some mechanisms."""
    body = draft.bodies[rng.integers(1, len(draft.bodies))]
    (first, second, _), sizes = _askew(rng, 3), draft.length * rng.uniform(0.2, 1.0, 2)
    sides = {"first_side": sizes[0] * first, "second_side": sizes[1] * _across(second, first)}
    speed = np.sqrt(draft.mass * STANDARD_GRAVITY / (STANDARD_AIR * np.prod(sizes))) * rng.uniform(0.3, 3.0)
    point = body.center_of_mass + 0.3 * draft.length * rng.normal(size=3)
    load = WindLoad("wind", body.name, point, **sides, direction=_direction(rng), speed=float(speed))
    return (load,) if rng.random() < 0.2 else ()


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))


def _across(vector: Array, axis: Array) -> Array:
    """Return the unit vector along the part of a vector that is perpendicular to a unit axis."""
    return _unit(cross(axis, cross(vector, axis)))


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _body(rng: np.random.Generator, name: str, mass: float, center: Array, length: float) -> Body:
    """Make a body with a random realizable inertia: masses spread by different amounts along three axes."""
    mass = mass * 10.0 ** rng.uniform(-1.0, 1.0)
    spread = (length * rng.uniform(0.03, 0.5, 3)) ** 2
    turn = rotation(from_rotation_vector(rng.uniform(0.0, np.pi) * _direction(rng)))
    inertia = turn @ np.diag(mass * (np.sum(spread) - spread)) @ turn.T
    return Body(name, mass, center, 0.5 * (inertia + inertia.T), _unit(rng.normal(size=4)))


def _coordinates(joints: Sequence[Joint]) -> list[tuple[Joint, int]]:
    """List all hinge and slide coordinates as joint and number."""
    return [(joint, k) for joint in joints for k in range(len(joint.coordinate_kinds))]


def _rank(mechanism: Mechanism) -> tuple[int, int]:
    """Return the numbers of degrees of freedom and of redundant constraints at the initial pose."""
    system = Relative(Scene("draft", mechanism, duration=1.0, output_period=1.0))
    return _rank_at(system, system.coordinates(initial_state(system.scene))[0])


def _rank_at(system: Relative, q: Array) -> tuple[int, int]:
    jacobian = dimensionless_jacobian(system, q)
    found = rank(jacobian)
    return system.nv - found, len(jacobian) - found


def _moved(rng: np.random.Generator, mechanism: Mechanism) -> State:
    """Find a state away from the initial pose, with velocities of 0.3 to 10 rad/s or mechanism sizes per
    second."""
    system = Relative(Scene("draft", mechanism, duration=1.0, output_period=1.0))
    start, _ = system.coordinates(initial_state(system.scene))
    wanted = _rank_at(system, start)
    for reach in DISPLACEMENTS:
        step = reach * system.velocity_units * rng.uniform(-1.0, 1.0, system.nv)
        try:
            q = project_position(system, system.retract(start, step))
        except AssemblyError:
            continue
        if (
            largest(system.phi(q)) < 4.0 * RESIDUAL_ROUND_OFF * mechanism.size
            and _rank_at(system, q) == wanted
        ):
            break
    speed = 10.0 ** rng.uniform(-0.5, 1.0)
    v = project_velocity(system, q, speed * system.velocity_units * rng.normal(size=system.nv))
    return system.state(q, project_velocity(system, q, v))  # a second projection removes round-off


def _motion(rng: np.random.Generator, scene: Scene) -> Scene:
    """Prescribe the motion of one joint coordinate, if a degree of freedom remains."""
    keys, state = _coordinates(scene.mechanism.joints), initial_state(scene)
    system, frames = Relative(scene), state.frames()
    before = _rank_at(system, system.coordinates(state)[0])
    for k in rng.permutation(len(keys)):
        joint, coordinate = keys[k]
        equations = scene.mechanism.joint_equations(joint.name)
        first, second = frames[equations.first], frames[equations.second]
        measured = equations.coordinates[coordinate]
        x = float(measured.phi(first, second)[0])
        rate = float(measured.jacobian(first, second).rate(first, second)[0])
        unit = scene.mechanism.size if measured.is_length else 1.0
        motion = PrescribedMotion(joint.name, Polynomial((x, rate, unit * rng.normal())), coordinate)
        driven = replace(scene, motions=(motion,))
        system = Relative(driven)
        if _rank_at(system, system.coordinates(state)[0]) == (before[0] - 1, before[1]) and before[0] > 1:
            return driven
    return scene


def random_scene(seed: int, number: int) -> Scene:
    """Generate a random mechanism whose initial state is a random consistent state.

    Args:
        seed, number: whole numbers; equal pairs give equal scenes.
    """
    rng = np.random.default_rng([seed, number])
    # separate generators for features that were added later, so that earlier features stay the same
    draft = _Draft(rng, np.random.default_rng([seed, number, 2]), np.random.default_rng([seed, number, 4]))
    forces, control = draft.forces()
    springs, rotors = _of_balls(np.random.default_rng([seed, number, 1]), draft)
    mechanism = draft.mechanism
    scene = Scene(
        f"random_{seed}_{number}",
        mechanism,
        duration=1.0,
        output_period=0.1,
        gravity=STANDARD_GRAVITY * _direction(rng),
        control=tuple(control),
        initial_state=_moved(rng, mechanism),
        forces=(*forces, *springs, *_wind(np.random.default_rng([seed, number, 3]), draft)),
        armatures=rotors,
        description=f"random mechanism {number} of seed {seed}",
    )
    return _motion(rng, scene) if rng.random() < 0.15 else scene
