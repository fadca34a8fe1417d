"""Excitation of a scene: small start velocities, sines for actuators, and random consistent states.

Most models stand still or fall freely at their initial state, and a run without motion tests little. This
module adds motion to a scene; it does not simulate. Joint limits of the file, which scenes do not simulate,
are respected where possible: the "room" of a joint is its distance from a limit at the start. All random
numbers have fixed seeds, so that the results are the same in every process. "Sizes" below are lengths divided
by the size of the mechanism.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from newton_euler.compiled.constraint_groups import connected
from newton_euler.compiled.equations import CompiledEquations
from newton_euler.compiled.run import Projection
from newton_euler.equations.dense import orthonormal_null, rank
from newton_euler.equations.redundancy import constraint_rank
from newton_euler.equations.relative import Relative
from newton_euler.equations.system import dimensionless_jacobian
from newton_euler.errors import AssemblyError
from newton_euler.integrators.projection import worst_joint
from newton_euler.model.control import PD
from newton_euler.model.forces import JointSpring
from newton_euler.model.joint import Key
from newton_euler.model.mechanism import CLOSURE_TOLERANCE
from newton_euler.model.motions import TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.switched_forces import JointFriction
from newton_euler.reading.activity import Bounds
from newton_euler.reading.free_motions import free_motions
from newton_euler.runs.assemble import assemble, initial_state, measured_coordinate
from newton_euler.scalars import Array

MAX_START_SPIN = 0.5
"""Largest start velocity of a joint's rotation, rad/s."""

MAX_START_SPEED = 0.1
"""Largest start velocity of a joint's translation, sizes/s."""

SWING_ANGLE = 0.2
"""Approximate amplitude of a rotation that an actuator drives by a sine, rad."""

SWING_LENGTH = 0.05
"""Approximate amplitude of a translation that an actuator drives by a sine, sizes."""

MIN_KEPT_SHARE = 0.05
"""Smallest fraction to which joint limits reduce these speeds and amplitudes. Without it, a joint next to its
limit would stop the whole closed loop."""

START_ROOM_SHARE = 0.5
"""Largest fraction of the room that start velocities use; sines use the rest."""

MIN_FREQUENCY = 0.7
"""Lowest frequency of a sine, Hz."""

MAX_FREQUENCY = 1.9
"""Highest frequency of a sine, Hz."""

RANDOM_AMPLITUDE = 0.2
"""Amplitude of the joint displacements of random states before loops are closed, rad and sizes."""

MAX_STRAY_FACTOR = 3.0
"""Largest displacement of a joint after its loops are closed, as a multiple of `RANDOM_AMPLITUDE`; beyond it,
the loops have closed on another branch."""

MAX_TRIES_PER_STATE = 50
"""Number of random displacements per requested state before the search is given up."""

ROUND_OFF_SPEED = 1e-9
"""Velocity, as a fraction of the largest one, that is round-off."""

MIN_START_SPEED = 1e-9
"""Speed, rad/s and sizes/s, below which the constraints count as leaving no start velocities."""


def with_start_velocities(scene: Scene, bounds: Iterable[Bounds] = ()) -> tuple[Scene, str]:
    """Give a scene consistent start velocities of all its joints.

    The velocities use at most `START_ROOM_SHARE` of the distance to each limit. For a limit of a joint
    coordinate this holds at the end of the run, if the joint keeps its velocity. A joint moves towards the
    side with more room. In a closed loop not every joint can: all joints that constraints connect with the
    loop then move in the direction that allows the higher speed. Joints that share no constraint do not slow
    each other down.

    Args:
        scene: scene at rest, at its initial state.
        bounds: limits of joint coordinates, and of forces that depend on velocities, such as the force of a
            servo (position control) with damping.

    Returns:
        The scene with start velocities, and a text with the largest speeds. A scene that starts in a singular
        configuration stays at rest: most velocities that the constraints allow there begin no motion.

    Raises:
        AssemblyError: if no velocities satisfy the constraints.
    """
    system = Relative(scene)  # equations of motion in joint coordinates: q, and velocities v (nv,)
    q, _ = system.coordinates(initial_state(scene))
    jacobian = dimensionless_jacobian(system, q)
    if rank(jacobian) < constraint_rank(system):
        return scene, "no start velocities, as the start is a singular configuration"
    # 1. largest speed of each joint, from its kind and from limits of forces: each of the n joints on which a
    # force depends may use 1/n of the distance to the limit of the force
    lengths = system.tree.is_length
    max_speeds = np.where(lengths, MAX_START_SPEED * scene.mechanism.size, MAX_START_SPIN)
    bounds = list(bounds)
    force_rows = _force_rows(system, q, bounds)
    for row in force_rows:
        nonzero = row != 0.0
        max_speeds[nonzero] = np.minimum(max_speeds[nonzero], 1.0 / (np.sum(nonzero) * np.abs(row[nonzero])))
    # 2. direction and largest speed of each joint, from the limits of its coordinate
    rng = np.random.default_rng(0)
    signs = rng.choice([-1.0, 1.0], system.nv)
    rooms, fastest = list(_rooms(system, bounds)), max_speeds.copy()
    for room in rooms:
        k, down, up = room.velocity_index, room.down, room.up
        if k is not None:
            signs[k] = signs[k] if down == up else np.sign(up - down)
            max_speeds[k] *= np.clip(
                START_ROOM_SHARE * max(down, up) / (scene.duration * max_speeds[k]), MIN_KEPT_SHARE, 1.0
            )
    # 3. random speeds, projected on the motions that the constraints leave free
    wanted = max_speeds * signs * rng.uniform(0.5, 1.0, system.nv)
    free = orthonormal_null(jacobian, constraint_rank(system))
    v = system.velocity_units * (free @ (free.T @ (wanted / system.velocity_units)))
    # 4. groups of velocities that constraints and limits connect, and the ratio of each group to its limits
    spin_jacobian = _spin_jacobian(scene, system, q)
    spin_rows = spin_jacobian.reshape(-1, system.nv) * system.velocity_units
    scaled_rows = (row / np.max(np.abs(row)) for row in force_rows if np.any(row))
    groups = list(_connected_groups([*jacobian, *spin_rows, *scaled_rows]))
    limit_ratios = [_limit_ratio(v * group, max_speeds, spin_jacobian, force_rows) for group in groups]
    if max(limit_ratios, default=0.0) * MAX_START_SPIN < MIN_START_SPEED:
        return scene, "no start velocities, as constraints leave none"
    # 5. scale each group to its limits. The ratios of the speeds of different groups are those of the random
    # speeds; the largest one reaches its limit
    drawn = np.abs(wanted) / max_speeds
    moving_groups = [
        (group, ratio)
        for group, ratio in zip(groups, limit_ratios, strict=True)
        if ratio * MAX_START_SPIN >= MIN_START_SPEED
    ]
    largest_drawn = max(np.max(drawn[group]) for group, _ in moving_groups)
    scaled = np.zeros(system.nv)
    for group, ratio in moving_groups:
        of_group = np.where(group, v, 0.0) * np.max(drawn[group]) / (largest_drawn * ratio)
        scaled += _within_rooms(system, rooms, fastest, q, of_group)
    state = assemble(scene, system.state(q, scaled))
    speeds = {
        "rad/s": float(np.max(np.linalg.norm(spin_jacobian @ scaled, axis=1), initial=0.0)),
        "m/s": float(np.max(np.abs(scaled[lengths]), initial=0.0)),
    }
    text = " and ".join(f"{speed:.2g} {unit}" for unit, speed in speeds.items() if speed > MIN_START_SPEED)
    return replace(scene, initial_state=state), f"start velocities up to {text}"


def _force_rows(system: Relative, q: Array, bounds: Iterable[Bounds]) -> list[Array]:
    """Return a row (nv,) for each limited force that depends on velocities, such as that of a damper.

    A limited force is constant + by_value * x + by_rate * dx/dt (`Bounds`), with a weighted sum x of joint
    coordinates (`terms`). In scenes from model files, joint coordinates are zero at the start, and x with
    them. If row @ v is 1, velocities v use `START_ROOM_SHARE` of the distance to the limit of the force. A
    limit that the start has already reached has no row.

    Args:
        system: equations of motion of the scene.
        q: (nq,) initial coordinates.
        bounds: limits of joint coordinates and forces.
    """
    measured, rows = system.measured(q, np.zeros(system.nv)), list[Array]()
    for bound in bounds:
        if not bound.by_rate or not all(key in measured for key, _ in bound.terms):
            continue
        value = bound.constant.value(0.0) if isinstance(bound.constant, TimeFunction) else bound.constant
        room = min(value - bound.low, bound.high - value)
        if not 0.0 < room < np.inf:
            continue
        row = np.zeros(system.nv)
        for key, factor in bound.terms:
            # The sparse Jacobian of the coordinate's rate: derivative with respect to v[k], by k
            for k, derivative in measured[key].jacobian.items():
                row[k] += factor * derivative * bound.by_rate / (START_ROOM_SHARE * room)
        rows.append(row)
    return rows


class LimitRoom(NamedTuple):
    """Distances of a joint coordinate from its limits at the start.

    Attributes:
        key: name of the joint, and index of the coordinate in the joint.
        velocity_index: index of the coordinate's velocity in v; None for a joint that closes a loop.
        down: distance to the lower limit, m or rad.
        up: distance to the upper limit, m or rad.
    """

    key: Key
    velocity_index: int | None
    down: float
    up: float


def _rooms(system: Relative, bounds: Iterable[Bounds]) -> Iterator[LimitRoom]:
    """Yield the distances ("room") of joint coordinates from their limits at the start.

    A coordinate that starts outside a limit has no room on that side and may move inwards. A range of zero
    width does not limit: exporters write such ranges for unknown limits.
    """
    start = initial_state(system.scene)
    for bound in bounds:
        # Only limits of one joint coordinate have room: low <= constant + by_value * factor * x <= high
        if bound.by_rate or len(bound.terms) != 1 or isinstance(bound.constant, TimeFunction):
            continue
        ((key, factor),) = bound.terms
        slope = bound.by_value * factor
        if not slope or bound.low == bound.high:
            continue
        value = bound.constant + slope * measured_coordinate(system.scene, start, key)[0]
        sides = max(0.0, value - bound.low) / abs(slope), max(0.0, bound.high - value) / abs(slope)
        down, up = sides if slope > 0.0 else sides[::-1]
        place = system.tree.place(*key)  # indices in q and in v; None for a joint that closes a loop
        yield LimitRoom(key, None if place is None else place[1], down, up)


def _within_rooms(system: Relative, rooms: Iterable[LimitRoom], fastest: Array, q: Array, v: Array) -> Array:
    """Reverse or slow down the velocities of joints that move together, so that they stay within limits.

    Args:
        system: equations of motion of the scene.
        rooms: distances from limits at the start.
        fastest: (nv,) largest rates without limits of joint coordinates, m/s or rad/s.
        q: (nq,) coordinates of the spanning tree.
        v: (nv,) velocities of the spanning tree.
    """
    scene = system.scene
    # Largest ratio of a rate to its allowed rate, for velocities v and for the opposite velocities -v
    ratio, reverse_ratio = 0.0, 0.0
    frames = system.state(q, v).frames()
    for room in rooms:
        rate = float(scene.mechanism.measure(room.key, frames)[1])
        if room.velocity_index is not None:
            max_rate = fastest[room.velocity_index]
        else:
            max_rate = (
                MAX_START_SPEED * scene.mechanism.size
                if scene.mechanism.is_slide(*room.key)
                else MAX_START_SPIN
            )
        up, down = (
            np.clip(START_ROOM_SHARE * side / scene.duration, MIN_KEPT_SHARE * max_rate, max_rate)
            for side in (room.up, room.down)
        )
        ratio = max(ratio, abs(rate) / (up if rate > 0.0 else down))
        reverse_ratio = max(reverse_ratio, abs(rate) / (down if rate > 0.0 else up))
    # Choose the direction that allows the higher speed; slow down if it still passes a limit
    if min(ratio, reverse_ratio) > 1.0 + ROUND_OFF_SPEED:
        v = v / min(ratio, reverse_ratio)
    return -v if ratio > max(1.0, reverse_ratio) * (1.0 + ROUND_OFF_SPEED) else v


def _spin_jacobian(scene: Scene, system: Relative, q: Array) -> Array:
    """Return the Jacobian (joints, 3, nv) of the angular velocities between the two bodies of each joint."""
    angular = system.velocity_transformation(q).reshape(-1, 6, system.nv)[:, 3:]
    joints = scene.mechanism.equations  # of each joint, with the numbers of its two bodies
    return angular[[each.second for each in joints]] - angular[[each.first for each in joints]]


def _limit_ratio(v: Array, max_speeds: Array, spin_jacobian: Array, force_rows: Iterable[Array]) -> float:
    """Compute the largest ratio of any limited quantity to its limit at velocities v.

    Args:
        v: (nv,) velocities.
        max_speeds: (nv,) largest absolute value of each velocity.
        spin_jacobian: (joints, 3, nv) of the angular velocities of joints, limited by `MAX_START_SPIN`.
        force_rows: (nv,) each, see `_force_rows`; the limit of row @ v is 1.
    """
    spins = np.linalg.norm(spin_jacobian @ v, axis=1)
    ratios = np.max(np.abs(v) / max_speeds, initial=0.0), np.max(spins, initial=0.0) / MAX_START_SPIN
    return float(max(*ratios, *(abs(row @ v) for row in force_rows)))


def _connected_groups(rows: Iterable[Array]) -> Iterator[Array]:
    """Yield masks (nv,) of the groups of velocities that dimensionless rows (nv,) connect.

    Each row connects all velocities of its nonzero entries.
    """
    nonzero = np.abs(np.array([*rows])) > ROUND_OFF_SPEED
    # Rows of the identity make velocities that nothing connects groups, too
    groups = connected(np.vstack([nonzero, np.eye(nonzero.shape[1], dtype=bool)]))
    for group in np.unique(groups):
        yield groups == group


class Swing(NamedTuple):
    """Sine that drives an actuator.

    Attributes:
        amplitude: amplitude of the control input that disregards limits of joints.
        amplitude_within_limits: amplitude of the control input that keeps joints within their limits.
        angular_frequency: rad/s.
    """

    amplitude: float
    amplitude_within_limits: float
    angular_frequency: float


def swings(
    scene: Scene, forces: Sequence[Mapping[Key, float]], bounds: Iterable[Bounds] = ()
) -> Iterator[Swing]:
    """Yield sines that move each driven joint by about `SWING_ANGLE` or `SWING_LENGTH`.

    A force of amplitude F and angular frequency w moves a mass m by up to F (w T + 1) / (m w^2) in a time T.
    It moves a spring of stiffness k by F / k and a damper of damping d by F / (d w). The mass is that of the
    whole mechanism as the driven joint feels it: constraints hold, and all other joints may move. The force
    also overcomes the dry friction of the driven joint.

    Args:
        scene: scene at its initial state.
        forces: for each sine, the forces on joint coordinates that a control input of 1 causes, N or N m.
        bounds: limits of joint coordinates. A joint swings by at most the room that start velocities leave,
            and by at least `MIN_KEPT_SHARE` of its amplitude without limits.
    """
    system = Relative(scene)
    rooms = {room.key: min(room.down, room.up) for room in _rooms(system, bounds)}
    q, v = system.coordinates(initial_state(scene))
    measured = system.measured(q, v)
    free, inertia = free_motions(system, q, v)
    for number, unit_forces in enumerate(forces):
        # Spread the frequencies evenly, by the fractional parts of multiples of the golden ratio
        golden = 0.5 * (np.sqrt(5.0) - 1.0)
        w = 2.0 * np.pi * (MIN_FREQUENCY + (MAX_FREQUENCY - MIN_FREQUENCY) * ((0.5 + number * golden) % 1.0))
        # accelerations (nv,) of the free motions for a control input of 1
        generalized = np.zeros(system.nv)
        for key, force in unit_forces.items():
            for k, derivative in measured[key].jacobian.items():
                generalized[k] += derivative * force
        accelerations = (
            free @ np.linalg.solve(inertia, free.T @ generalized) if free.size else np.zeros(system.nv)
        )
        # smallest amplitude of the control input over the driven joint coordinates
        amplitude = within = np.inf
        for key, force in unit_forces.items():
            acceleration = abs(float(sum(x * accelerations[k] for k, x in measured[key].jacobian.items())))
            if not force or not acceleration:
                continue
            # Impedance: amplitude of the force per amplitude of the displacement. If a servo drives the
            # joint, its stiffness alone is the impedance. The mass is force / acceleration
            stiffness, damping, servo = _joint_impedance(scene, key)
            impedance = abs(force) * w**2 / (acceleration * (1.0 + w * scene.duration))
            impedance = servo or impedance + stiffness + damping * w
            friction = _dry_friction(scene, key)
            swing = _intended_amplitude(scene, key)
            room = (1.0 - START_ROOM_SHARE) * rooms.get(key, np.inf)
            swing_within = np.clip(room, MIN_KEPT_SHARE * swing, swing)
            amplitude = min(amplitude, (swing * impedance + friction) / abs(force))
            within = min(within, (swing_within * impedance + friction) / abs(force))
        if not np.isfinite(amplitude):
            amplitude = within = 0.0
        yield Swing(float(amplitude), amplitude_within_limits=float(within), angular_frequency=float(w))


def _joint_impedance(scene: Scene, key: Key) -> tuple[float, float, float]:
    """Return the sum of stiffnesses and the sum of dampings at a joint coordinate, SI, and the stiffness of
    the servos alone.

    Servos are proportional-derivative control laws (`PD`); the sums also include joint springs.
    """
    laws = [law for law in scene.joint_forces if law.key == key]
    gains = [law for law in laws if isinstance(law, PD | JointSpring)]
    servo = sum(law.stiffness for law in gains if isinstance(law, PD))
    return sum(law.stiffness for law in gains), sum(law.damping for law in gains), max(servo, 0.0)


def _dry_friction(scene: Scene, key: Key) -> float:
    """Return the dry friction of a joint coordinate, N or N m."""
    elements = (force for force in scene.switched_forces if isinstance(force, JointFriction))
    return sum(force.coulomb for force in elements if force.key == key)


def _intended_amplitude(scene: Scene, key: Key) -> float:
    """Return the amplitude that a sine shall give a joint coordinate, m or rad."""
    return SWING_LENGTH * scene.mechanism.size if scene.mechanism.is_slide(*key) else SWING_ANGLE


def random_states(scene: Scene, count: int, seed: int = 0) -> list[State]:
    """Draw random consistent states around the initial state; the same seed gives the same states.

    Joint velocities are about 1 rad/s and one size of the mechanism per second.

    Args:
        scene: scene at its initial state.
        count: number of states.
        seed: seed of the random numbers.

    Raises:
        AssemblyError: if too few of the random displacements can be closed.
    """
    code = CompiledEquations(scene, "relative")
    assert isinstance(code.system, Relative)
    system, project = code.system, Projection(code)
    tree, unit = system.tree, system.velocity_units
    # Indices in q and v of all coordinates but those of balls, whose quaternions have no single velocity
    single = [(on_q.start, on_v.start) for motion, on_q, on_v in tree.motions if motion.kind != "ball"]
    single_q, single_v = [index for index, _ in single], [index for _, index in single]
    start, _ = system.coordinates(initial_state(scene))
    rng = np.random.default_rng(seed)
    states: list[State] = []
    x = code.packed(start, np.zeros(tree.nv))  # input of native functions: q, v, then time and parameters
    # Draw displacements and velocities, and project them on the constraints; `project` returns False if the
    # loops do not close
    for _ in range(MAX_TRIES_PER_STATE * count):
        if len(states) == count:
            break
        step = RANDOM_AMPLITUDE * unit * rng.uniform(-1.0, 1.0, tree.nv)
        v = unit * rng.standard_normal(tree.nv)
        x[: code.size] = np.concatenate([system.retract(start, step), v])
        if not project(x):
            continue
        q, v = x[: system.nq], x[system.nq : code.size]
        if (
            np.abs((q - start)[single_q] / unit[single_v]).max(initial=0.0)
            > MAX_STRAY_FACTOR * RANDOM_AMPLITUDE
        ):
            continue  # the loops closed on another branch of the motion
        states.append(system.state(q, v))
    if len(states) < count:
        joint, gap = worst_joint(system, system.state(x[: system.nq], x[system.nq : code.size]))
        raise AssemblyError(joint, gap, CLOSURE_TOLERANCE)
    return states
