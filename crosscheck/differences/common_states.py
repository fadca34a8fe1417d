"""Two robots in the same random states: their common part, accelerations, and errors of constraints.

In: two robot files and their `Alignment`. Out: `CommonStates`. Both robots are put into the same random
states: at rest, moving, and moving with drives. The states fulfill the constraints of the first robot.
`crosscheck.differences.motion` compares the accelerations.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property

import numpy as np

from crosscheck.differences.alignment import Alignment, BodyPair
from crosscheck.differences.causes import LACKING
from crosscheck.differences.common_part import Cut, cuts, paired_joints
from crosscheck.differences.difference import Quantity
from crosscheck.differences.drive_pairs import control_of_second, drive_pairs
from crosscheck.differences.dynamics import Accelerations, Dynamics
from crosscheck.differences.frames import common_frames
from crosscheck.differences.joint_tree import SCALAR, size_of
from crosscheck.differences.links import mass_of_group
from crosscheck.differences.pose_transfer import carry_over, is_paired
from newton_euler.reading.robot import Placement, Robot, RobotFile
from newton_euler.scalars import Array

STANDARD_GRAVITY = np.array([0.0, 0.0, -9.81])
"""m/s^2, for two robots whose files say nothing of gravity; MuJoCo and Pinocchio use the same."""

ROUND_OFF = 1e-8
"""Relative change of accelerations that double precision may cause: 1e-16 times the condition of mass
matrices, up to 1e6, and of loops near singular poses, up to 1e2."""

STATES = 4
"""Number of random states of each phase."""

MAX_ANGLE = 1.2
"""Largest random distance of a coordinate from the pose of the file, rad or lengths of the robot."""

MAX_STEP_SUM = 0.6
"""Largest sum of the steps of a robot with loops from the pose of the file, rad or lengths of the robot."""

STEPS = 6
"""Number of steps of a robot with loops from the pose of the file."""

MAX_OPEN = 1e-5
"""Error of a closed loop in lengths of the robot: redundant constraints written with six digits conflict."""

MIN_FREEDOM = 1e-4
"""A motion moves joints with partner if these move by more than this part of it."""

DIGITS_FACTOR = 2.0
"""The largest change among a few variants underestimates the largest possible one by about this factor."""

MIN_SHIFT = 1e-4
"""m, distance of centers of mass that tells one placement of a frame from another."""


class Phase(StrEnum):
    """Kind of the states in which accelerations are compared."""

    REST = "at rest"
    MOVING = "moving"
    DRIVEN = "driven"


PHASES = [phase for phase in Phase for _ in range(STATES)]
"""Phase of each state."""


@dataclass(frozen=True)
class Gap:
    """Error of a constraint of the second robot in poses of the first one.

    Attributes:
        constraint: name of the loop or coupling in the second file.
        error: largest error, in the unit.
        uncertainty: of the error, by the digits of both files.
        unit: "m" or "rad".
    """

    constraint: str
    error: float
    uncertainty: float
    unit: str

    @property
    def is_open(self) -> bool:
        """True if the error is larger than round-off and the uncertainty."""
        return self.error > max(self.uncertainty, ROUND_OFF)


class CommonStates:
    """Two robots, cut to their common part, in the same random states.

    Attributes:
        files: the robot files.
        agreeing: pairs of bodies and joints, with the frames in which most numbers agree.
        alignment: pairs of bodies and joints, with frames in which the centers of mass agree better.
        pairs: pairs of bodies that move.
        spreads: center of mass of each of these pairs in the first robot's body frame, and radius of
            gyration, m.
        one, two: equations of both robots.
        cuts: what both robots lose.
        gravity: (3,) m/s^2, for a robot without gravity of its own.
        coordinates, velocities: (1, states, coordinates) of the first robot.
        controls: (1, states, drives) of the first robot's drives, and of drives that only the second has.
        is_closed: whether such states exist: loops of the first robot can be closed.
        notes: what was left out or held, one sentence each.
    """

    def __init__(self, first: RobotFile, second: RobotFile, alignment: Alignment) -> None:
        """Draw the states, with a fixed seed.

        Args:
            first, second: the robot files.
            alignment: their pairs of bodies and joints.
        """
        self.files = files = (first, second)
        frames = common_frames(first, second, alignment, None).frames
        # each body gets the frame in which most of its numbers agree: a changed number stays at its element
        agreeing = [
            replace(pair, placement=frames[number].placement) if number in frames else pair
            for number, pair in enumerate(alignment.bodies)
        ]
        self.agreeing = replace(alignment, bodies=tuple(agreeing))
        nearer = [
            _nearer(first.robot, second.robot, *each) for each in zip(agreeing, alignment.bodies, strict=True)
        ]
        self.alignment = alignment = replace(alignment, bodies=tuple(nearer))
        gravities = [file.robot.gravity for file in files if file.robot.gravity is not None]
        self.gravity = gravities[0] if gravities else STANDARD_GRAVITY
        has_no_drives = [
            Quantity.PRESENCE in LACKING.get(file.format, ()) and not file.robot.drives for file in files
        ]
        self.cuts = cuts(first.robot, second.robot, alignment, any(has_no_drives))
        self.notes = tuple(_notes(files, alignment, self.cuts))
        length = size_of(first.robot)
        one, two = (cut.of(file.robot, self.gravity) for cut, file in zip(self.cuts, files, strict=True))
        self.one, self.two = Dynamics([one], length), Dynamics([two], length)
        self.pairs = [
            pair
            for pair in alignment.bodies
            if self.one.moves[pair.first[0]].any() or self.two.moves[pair.second[0]].any()
        ]
        self.spreads = [_spread(one, pair.first, length) for pair in self.pairs]
        self._driven = np.array([phase is Phase.DRIVEN for phase in PHASES], float)
        random = np.random.default_rng(0)
        self.coordinates, self.is_closed = closed_states(self.one, random)
        rate = np.sqrt(max(float(np.linalg.norm(self.gravity)), 1.0) / length)
        moving = np.array([phase is not Phase.REST for phase in PHASES], float)
        # such velocities need accelerations that are about as large as gravity
        velocities = rate * self.one.scale * moving[:, None] * random.normal(size=self.coordinates.shape)
        self.velocities = self.one.admissible(self.coordinates, velocities)
        self.controls = self._controls(self.one, self.coordinates, self.velocities, random)
        self.coordinates_of_second, self.velocities_of_second = self._in_second(
            self.coordinates, self.velocities
        )
        of_second = self._controls(self.two, self.coordinates_of_second, self.velocities_of_second, random)
        pairs = drive_pairs(one, two, alignment.joints)
        for own, other in pairs:
            control = control_of_second(one, two, alignment, one.drives[own], two.drives[other])
            if not self.controls[..., own].any():  # a drive without force in the first robot alone
                self.controls[..., own] = control.sense * (of_second[..., other] - control.shift)
            of_second[..., other] = control.sense * self.controls[..., own] + control.shift
        self.controls_of_second = of_second
        paired = {other for _, other in pairs}
        alone = [index for index in range(len(two.drives)) if index not in paired]
        self.controls = np.concatenate([self.controls, of_second[..., alone]], axis=-1)

    def _controls(
        self, robot: Dynamics, coordinates: Array, velocities: Array, random: np.random.Generator
    ) -> Array:
        """Draw controls (1, states, drives) with forces about as large as those that act anyway."""
        inertia, force = robot.loads(coordinates, velocities)
        rate = max(float(np.linalg.norm(self.gravity)), 1.0) / robot.length
        wanted = np.abs(force) + inertia * rate * robot.scale
        gears = np.abs(robot.gears[0, 0])
        drive = (wanted @ gears.T) / np.maximum(np.sum(gears**2, axis=-1), np.finfo(float).tiny)
        drive *= random.choice([-1.0, 1.0], size=drive.shape) * random.uniform(0.5, 1.0, size=drive.shape)
        without = robot.drive_forces(coordinates, velocities, np.zeros((1, 1, len(gears))))
        is_controlled = (robot.gain != 0) & (gears != 0).any(axis=-1)
        return np.where(is_controlled, (drive - without) / np.where(is_controlled, robot.gain, 1.0), 0.0)

    def _in_second(self, coordinates: Array, velocities: Array) -> tuple[Array, Array]:
        """Return the state of the second robot; joints without partner close the loops as far as they can."""
        coordinates, velocities = carry_over(self.alignment, self.one, self.two, coordinates, velocities)
        alone = ~is_paired(self.two, paired_joints(self.alignment)[1])
        if alone.any():
            coordinates, _ = self.two.closed(coordinates, alone)
            velocities = self.two.admissible(coordinates, velocities, alone)
        return coordinates, velocities

    def poses(self) -> tuple[list[Placement], list[Placement]]:
        """Return where the frames of all bodies of both robots are, in the pose of the first file."""
        coordinates = self.one.zero[:1]
        at_rest = np.zeros(coordinates.shape)
        of_second, _ = self._in_second(coordinates, at_rest)
        moving = (
            self.one.kinematics(coordinates, at_rest),
            self.two.kinematics(of_second, np.zeros(of_second.shape)),
        )
        first, second = (
            [
                Placement(each.position[0, 0, k], each.rotation[0, 0, k])
                for k in range(each.position.shape[2] - 1)  # the last one is the ground
            ]
            for each in moving
        )
        return first, second

    @cached_property
    def variants(self) -> tuple[list[Robot], list[Robot]]:
        """The common part of each robot with other last digits."""
        first, second = (
            [cut.of(robot, self.gravity) for robot in file.variants]
            for cut, file in zip(self.cuts, self.files, strict=True)
        )
        return first, second

    def points(self) -> tuple[Array, Array]:
        """Return (bodies, 3) m, in the frames of each robot's bodies: the first one's centers of mass.

        Bodies that are in no pair have the origin of their frame.
        """
        first, second = (np.zeros((len(each.robot.bodies), 3)) for each in (self.one, self.two))
        for pair, (center, _) in zip(self.pairs, self.spreads, strict=True):
            back = pair.placement.inverse()
            first[pair.first[0]] = center
            second[pair.second[0]] = back.point(center)
        return first, second

    def states_of_first(self, drives: int) -> tuple[Array, Array, Array]:
        """Return coordinates, velocities and controls (1, states, n) of the first robot.

        Args:
            drives: number of drives, which may be followed by those that only the second robot has.
        """
        return self.coordinates, self.velocities, self.controls[..., :drives]

    def states_of_second(self) -> tuple[Array, Array, Array]:
        """Return coordinates, velocities and controls (1, states, n) of the second robot."""
        return self.coordinates_of_second, self.velocities_of_second, self.controls_of_second

    def of_first(self, robots: Sequence[Robot]) -> Array:
        """Return accelerations of pairs of bodies of robots that have the structure of the first.

        Args:
            robots: the robots; their drives may be followed by those that only the second robot has.

        Returns:
            (robots, states, pairs, 6) m/s^2, acceleration of the center of mass, and angular acceleration
            times the radius of gyration, in the frame of the first robot's body. The root of the sum of
            squares is about the root mean square of the acceleration over the mass of the body.
        """
        robot = Dynamics(robots, self.one.length)
        found = self._accelerations(robot, *self.states_of_first(len(robot.robot.drives)), self.points()[0])
        parts = [
            np.concatenate(
                [found.linear[:, :, pair.first[0]], radius * found.angular[:, :, pair.first[0]]], -1
            )
            for pair, (_, radius) in zip(self.pairs, self.spreads, strict=True)
        ]
        return np.stack(parts, axis=2)

    def of_second(self, robots: Sequence[Robot]) -> Array:
        """Return accelerations of pairs of bodies of robots that have the structure of the second.

        Returns:
            as for `of_first`, of the same points and in the same frames.
        """
        robot = Dynamics(robots, self.one.length)
        found = self._accelerations(robot, *self.states_of_second(), self.points()[1])
        parts = []
        for pair, (_, radius) in zip(self.pairs, self.spreads, strict=True):
            each = [found.linear[:, :, pair.second[0]], radius * found.angular[:, :, pair.second[0]]]
            parts.append(np.concatenate([part @ pair.placement.rotation.T for part in each], axis=-1))
        return np.stack(parts, axis=2)

    def _accelerations(
        self, robot: Dynamics, coordinates: Array, velocities: Array, controls: Array, points: Array
    ) -> Accelerations:
        """Return accelerations in the states nearest to the given ones that the constraints allow."""
        coordinates, _ = robot.closed(coordinates)
        return robot.accelerations(coordinates, velocities, controls, self._driven, points[None])

    def gaps(self, first_variants: Sequence[Robot], second_variants: Sequence[Robot]) -> tuple[Gap, ...]:
        """Return the errors of the second robot's constraints in the poses of the first robot.

        Args:
            first_variants, second_variants: the robots with other last digits.
        """
        if not self.two.rows:
            return ()
        errors = self._gap_errors(self.two, self.coordinates_of_second)
        uncertainties = np.zeros(errors.shape[-1])
        if second_variants:
            changed = self._gap_errors(Dynamics(second_variants, self.one.length), self.coordinates_of_second)
            uncertainties += DIGITS_FACTOR * np.abs(changed - errors).max(axis=(0, 1))
        if first_variants:
            closed, _ = Dynamics(first_variants, self.one.length).closed(self.coordinates)
            coordinates, _ = self._in_second(closed, np.zeros(closed.shape))
            changed = self._gap_errors(self.two, coordinates)
            uncertainties += DIGITS_FACTOR * np.abs(changed - errors).max(axis=(0, 1))
        largest = np.abs(errors).max(axis=(0, 1))
        found: dict[tuple[str, str], Gap] = {}
        for (name, unit), error, uncertainty in zip(self.two.rows, largest, uncertainties, strict=True):
            gap = Gap(name, float(error), float(uncertainty), unit)
            before = found.get((name, unit), gap)
            found[name, unit] = max(before, gap, key=lambda each: each.error - each.uncertainty)
        return tuple(found.values())

    def _gap_errors(self, robot: Dynamics, coordinates: Array) -> Array:
        """Return (robots, states, rows) errors of constraints, m or rad."""
        at_rest = np.zeros(coordinates.shape)
        found = robot.constraints(coordinates, at_rest, robot.kinematics(coordinates, at_rest)).residual
        return found * np.array([robot.length if unit == "m" else 1.0 for _, unit in robot.rows])

    def freedoms(self) -> tuple[int, int]:
        """Return the number of independent motions of joints with partner, in both robots.

        Each robot counts where its loops are closed. The points of an open loop move apart if a body turns
        that carries the whole loop, which would count as a constraint.
        """
        first, second = paired_joints(self.alignment)
        closed, error = self.two.closed(self.coordinates_of_second)
        is_closed = error[..., None] < MAX_OPEN
        of_second = np.where(is_closed, closed, self.coordinates_of_second)
        return self._freedom(self.one, self.coordinates, first), self._freedom(self.two, of_second, second)

    def _freedom(self, robot: Dynamics, coordinates: Array, joints: Sequence[tuple[int, int]]) -> int:
        """Return the rank of the admissible velocities of some joints, the usual one among the states."""
        paired = is_paired(robot, joints)
        if not paired.any():
            return 0
        if not robot.rows:
            return int(paired.sum())
        basis = (robot.basis(coordinates) / robot.scale[:, None])[..., paired, :]
        return int(np.median(np.linalg.matrix_rank(basis, tol=MIN_FREEDOM)))


def common_states(first: RobotFile, second: RobotFile, alignment: Alignment) -> CommonStates | None:
    """Put two robots into the same random states; None for robots without joints in common.

    Args:
        first, second: the robot files.
        alignment: their pairs of bodies and joints.
    """
    return CommonStates(first, second, alignment) if alignment.joints else None


def _nearer(first: Robot, second: Robot, pair: BodyPair, other: BodyPair) -> BodyPair:
    """Return the first of two ways to place a pair's frames, or the second if centers of mass agree better.

    Args:
        first, second: the robots.
        pair, other: the same bodies with other placements.
    """
    center = mass_of_group(first, pair.first, first.placements())[1]
    other_center = mass_of_group(second, pair.second, second.placements())[1]
    errors = [
        float(np.linalg.norm(each.point(other_center) - center)) for each in (pair.placement, other.placement)
    ]
    return pair if errors[0] <= errors[1] + MIN_SHIFT else other


def _spread(robot: Robot, group: Sequence[int], length: float) -> tuple[Array, float]:
    """Return the center of mass of a rigid group, and its radius of gyration, m.

    A group without mass counts as if it were at its origin, with a radius of a tenth of the robot.
    """
    mass, center, inertia = mass_of_group(robot, group, robot.placements())
    return (center, float(np.sqrt(np.trace(inertia) / 2 / mass))) if mass > 0 else (np.zeros(3), 0.1 * length)


def closed_states(robot: Dynamics, random: np.random.Generator) -> tuple[Array, bool]:
    """Draw coordinates (1, states, coordinates) that fulfill the constraints.

    A robot with loops is moved from the pose of the file in small steps, so that the loops are not assembled
    in another way, as a parallelogram that is crossed.

    Returns:
        the coordinates, and whether they fulfill the constraints.
    """
    if not robot.rows:
        return _within_limits(robot, random), True
    shape = (1, len(PHASES), robot.size)
    direction = robot.scale * random.normal(size=shape)
    reach = MAX_STEP_SUM * random.uniform(0.2, 1.0, size=(1, len(PHASES), 1))
    coordinates, error = robot.closed(np.zeros(shape) + robot.zero)
    for _ in range(STEPS):
        step = robot.admissible(coordinates, direction)
        largest = np.abs(step / robot.scale).max(axis=-1, keepdims=True)
        step *= reach / STEPS / np.maximum(largest, np.finfo(float).tiny)
        coordinates, error = robot.closed(robot.moved(coordinates, step))
    return coordinates, bool(error.max() < MAX_OPEN)


def _within_limits(robot: Dynamics, random: np.random.Generator) -> Array:
    """Draw coordinates (1, states, coordinates) around the pose of the file."""
    reach = MAX_ANGLE * robot.scale
    low, high = robot.zero[0, 0] - reach, robot.zero[0, 0] + reach
    for (body, number), at in robot.at.items():
        joint = robot.robot.bodies[body].joints[number]
        if joint.kind in SCALAR:
            limits = np.clip(joint.limits, low[at.start], high[at.start])
            if limits[1] > limits[0]:
                low[at.start], high[at.start] = limits
    return random.uniform(low, high, size=(1, len(PHASES), robot.size))


def _notes(files: Sequence[RobotFile], alignment: Alignment, taken: Sequence[Cut]) -> Iterator[str]:
    """Yield what both robots lose, one sentence each."""
    first, second = (file.robot for file in files)
    free = [cut.base >= 0 for cut in taken]
    if any(free):
        note = f"Both bases are held to compare: {alignment.base or 'only one file has a free base'}"
        # a URDF cannot say whether its root link floats
        floats = any(
            cut.base >= 0 and file.robot.bodies[cut.base].parent < 0
            for file, cut in zip(files, taken, strict=True)
        )
        for each, is_free, number in zip(files, free, ("first", "second"), strict=True):
            if floats and each.format == "URDF" and not is_free:
                note += f"; the option base=free lets the {number} float"
        yield f"{note}."
    for robot, cut, file in zip((first, second), taken, ("first", "second"), strict=True):
        names = [robot.bodies[index].name for index in cut.bodies if robot.bodies[index].mass > 0]
        if names:
            yield f"Only in the {file} file, and left out: {', '.join(names)}."
        joints = [joint.name for index in cut.held for joint in robot.bodies[index].joints]
        if joints:
            yield f"Only in the {file} file, and held: {', '.join(joints)}."
    if taken[0].without_drives and (first.drives or second.drives):
        yield "Drives do not act in the compared motions: one of the formats has none."
    if first.gravity is None and second.gravity is None:
        yield "Neither file has gravity: 9.81 m/s^2 along -z."
