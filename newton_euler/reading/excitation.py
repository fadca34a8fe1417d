"""Excitation: states at random, and small motions that make a run depend on as much of a scene as it can.

Models stand still or fall freely as their files have them, and engines that agree on such runs show little.
Everything here is a function of the scene alone, the same in every process.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

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
from newton_euler.reading.activity import Bounds
from newton_euler.runs.assemble import assemble, initial_state, measured_coordinate
from newton_euler.scalars import Array

SPIN, SPEED = 0.5, 0.1  # rad/s and sizes/s, at most, of joints at the start
SWING, SHIFT = 0.2, 0.05  # rad and sizes, about as far as a driven joint moves
LEAST_SHARE = 0.05  # of these that a joint keeps however little room its limits leave, so that loops move
ROOM_SHARE = 0.5  # of the room that limits leave, at most, that start velocities use; the rest is for swings
LOWEST, HIGHEST = 0.7, 1.9  # Hz, between which frequencies are spread
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)  # its multiples, less whole numbers, are spread evenly
SEED = 0  # of the directions of start velocities
RANDOM_AMPLITUDE = 0.2  # rad, and sizes, that `random_states` moves joints by before it closes the loops
STRAY = 3.0  # how many times as far as that a joint may end up from where it started
ATTEMPTS = 50
ROUND_OFF = 1e-9  # relative, of velocities
AT_REST = 1e-9  # rad/s and sizes/s, below which a mechanism that is given velocities cannot move


def moving(scene: Scene, bounds: Iterable[Bounds] = ()) -> tuple[Scene, str]:
    """Give a scene consistent start velocities of all its joints.

    Args:
        scene: at its start.
        bounds: limits of what the velocities change at once, such as the force of a servo with damping, and
            of joint coordinates. The velocities use at most `ROOM_SHARE` of the room that each limit leaves,
            for coordinates in the whole duration. A joint moves to the side where its limits leave more room.
            If a closed loop decides its direction, all joints that constraints connect with that loop move
            the way that allows the higher speed. Joints that share no constraint do not slow each other down.

    Returns:
        The scene, and how fast joints turn and slide, in words. A start where constraints lose rank stays at
        rest: most velocities that are free there begin no motion.

    Raises:
        AssemblyError: where velocities cannot be made to fit the constraints.
    """
    system = Relative(scene)
    q, _ = system.coordinates(initial_state(scene))
    jacobian = dimensionless_jacobian(system, q)
    if rank(jacobian) < constraint_rank(system):
        return scene, "no start velocities, as the start is a singular configuration"
    lengths = system.tree.is_length
    limits = np.where(lengths, SPEED * scene.mechanism.size, SPIN)
    bounds = list(bounds)
    rows = _rate_rows(system, q, bounds)
    for row in rows:
        acting = row != 0.0
        limits[acting] = np.minimum(limits[acting], 1.0 / (np.sum(acting) * np.abs(row[acting])))
    rng = np.random.default_rng(SEED)
    signs = rng.choice([-1.0, 1.0], system.nv)
    rooms, fastest = list(_rooms(system, bounds)), limits.copy()
    for room in rooms:
        k, (down, up) = room.place, (room.down, room.up)
        if k is not None:
            signs[k] = signs[k] if down == up else np.sign(up - down)
            limits[k] *= np.clip(ROOM_SHARE * max(down, up) / (scene.duration * limits[k]), LEAST_SHARE, 1.0)
    wanted = limits * signs * rng.uniform(0.5, 1.0, system.nv)
    free = orthonormal_null(jacobian, constraint_rank(system))
    v = system.velocity_units * (free @ (free.T @ (wanted / system.velocity_units)))
    turning = _turning(scene, system, q)
    turned = turning.reshape(-1, system.nv) * system.velocity_units
    parts = list(_parts([*jacobian, *turned, *(row / np.max(np.abs(row)) for row in rows if np.any(row))]))
    reaches = [_reach_of(v * part, limits, turning, rows) for part in parts]
    if max(reaches, default=0.0) * SPIN < AT_REST:
        return scene, "no start velocities, as constraints leave none"
    # parts that share no constraint keep the proportions that they were drawn with
    drawn = np.abs(wanted) / limits
    moving_parts = [pair for pair in zip(parts, reaches, strict=True) if pair[1] * SPIN >= AT_REST]
    most = max(np.max(drawn[part]) for part, _ in moving_parts)
    found = np.zeros(system.nv)
    for part, reached in moving_parts:
        of_part = np.where(part, v, 0.0) * np.max(drawn[part]) / (most * reached)
        found += _within_rooms(system, rooms, fastest, q, of_part)
    v = found
    state = assemble(scene, system.state(q, v))
    speeds = {
        "rad/s": float(np.max(np.linalg.norm(turning @ v, axis=1), initial=0.0)),
        "m/s": float(np.max(np.abs(v[lengths]), initial=0.0)),
    }
    said = " and ".join(f"{speed:.2g} {unit}" for unit, speed in speeds.items() if speed > AT_REST)
    return replace(scene, initial_state=state), f"start velocities up to {said}"


def _rate_rows(system: Relative, q: Array, bounds: Iterable[Bounds]) -> list[Array]:
    """Rows (nv,) of the start's velocities, each of which uses `ROOM_SHARE` of a limit's room where it is 1.

    A limit that the start has reached already leaves no room, and has no row.
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
            for k, x in measured[key].jacobian.items():
                row[k] += factor * x * bound.by_rate / (ROOM_SHARE * room)
        rows.append(row)
    return rows


class Room(NamedTuple):
    """Room that the limits of a joint coordinate leave at the start.

    Attributes:
        key: of the coordinate.
        place: number of its velocity; None if the joint is cut.
        down, up: distances to the limits, m or rad.
    """

    key: Key
    place: int | None
    down: float
    up: float


def _rooms(system: Relative, bounds: Iterable[Bounds]) -> Iterator[Room]:
    """Yield the room that limits of each joint coordinate leave.

    A coordinate that starts outside of its limits has no room on that side and may move inwards. A range of
    no width, which exporters write for limits that they do not know, is none.
    """
    start = initial_state(system.scene)
    for bound in bounds:
        if bound.by_rate or len(bound.terms) != 1 or isinstance(bound.constant, TimeFunction):
            continue
        ((key, factor),) = bound.terms
        slope = bound.by_value * factor
        if not slope or bound.low == bound.high:
            continue
        value = bound.constant + slope * measured_coordinate(system.scene, start, key)[0]
        sides = max(0.0, value - bound.low) / abs(slope), max(0.0, bound.high - value) / abs(slope)
        down, up = sides if slope > 0.0 else sides[::-1]
        place = system.tree.place(*key)
        yield Room(key, None if place is None else place[1], down, up)


def _within_rooms(system: Relative, rooms: Iterable[Room], fastest: Array, q: Array, v: Array) -> Array:
    """Turn round and slow down velocities of joints that move together, for the room that limits leave them.

    Args:
        system, rooms: of the scene at its start.
        fastest: (nv,) rates that are allowed where there are no limits, m/s or rad/s.
        q, v: coordinates and velocities of the tree.
    """
    scene, forth, back = system.scene, 0.0, 0.0
    frames = system.state(q, v).frames()
    for room in rooms:
        rate = float(scene.mechanism.measure(room.key, frames)[1])
        if room.place is not None:
            most = fastest[room.place]
        else:
            most = SPEED * scene.mechanism.size if scene.mechanism.is_slide(*room.key) else SPIN
        up, down = (
            np.clip(ROOM_SHARE * side / scene.duration, LEAST_SHARE * most, most)
            for side in (room.up, room.down)
        )
        forth = max(forth, abs(rate) / (up if rate > 0.0 else down))
        back = max(back, abs(rate) / (down if rate > 0.0 else up))
    if min(forth, back) > 1.0 + ROUND_OFF:
        v = v / min(forth, back)
    return -v if forth > max(1.0, back) * (1.0 + ROUND_OFF) else v


def _turning(scene: Scene, system: Relative, q: Array) -> Array:
    """(joints, 3, nv) angular velocity between the bodies of each joint for each velocity."""
    angular = system.velocity_transformation(q).reshape(-1, 6, system.nv)[:, 3:]
    equations = scene.mechanism.equations
    return angular[[each.second for each in equations]] - angular[[each.first for each in equations]]


def _reach_of(v: Array, limits: Array, turning: Array, rows: Iterable[Array]) -> float:
    """Compute the largest velocity, spin of a joint, or rate of a row (nv,), by what it may be at most."""
    spins = np.linalg.norm(turning @ v, axis=1)
    reached = np.max(np.abs(v) / limits, initial=0.0), np.max(spins, initial=0.0) / SPIN
    return float(max(*reached, *(abs(row @ v) for row in rows)))


def _parts(rows: Iterable[Array]) -> Iterator[Array]:
    """Yield the velocities (nv,) that dimensionless rows (nv,) connect with each other, as masks.

    Each row connects all velocities that it has entries for.
    """
    rows = np.array([*rows])
    labels = np.arange(rows.shape[1])
    for row in np.abs(rows) > ROUND_OFF:
        connected = labels[row]
        labels[np.isin(labels, connected)] = min(connected, default=0)
    for label in np.unique(labels):
        yield labels == label


class Swing(NamedTuple):
    """A sine of time.

    Attributes:
        amplitude: by which joints move as far as they would without limits.
        within: amplitude by which they move as far as their limits leave from where they start.
        angular_frequency: rad/s.
    """

    amplitude: float
    within: float
    angular_frequency: float


def swings(
    scene: Scene, forces: Sequence[Mapping[Key, float]], bounds: Iterable[Bounds] = ()
) -> Iterator[Swing]:
    """Sines that drive joints so that each moves by about `SWING` or `SHIFT`, with and without its limits.

    A force of amplitude F and frequency w moves a mass m that is at rest by up to F (w T + 1) / (m w^2) in a
    time T, a spring by F / k and a damper by F / (d w). Constraints hold, and everything else may move.

    Args:
        scene: at its start.
        forces: on joint coordinates that have control laws, N or N m, for each unit of what is to swing.
        bounds: limits of joint coordinates. A joint swings by at most the share of their room that start
            velocities leave, but by a `LEAST_SHARE` of what it would without them.
    """
    system = Relative(scene)
    rooms = {room.key: min(room.down, room.up) for room in _rooms(system, bounds)}
    q, v = system.coordinates(initial_state(scene))
    measured = system.measured(q, v)
    mass, _ = system.mass_and_force(q, v)
    free = orthonormal_null(dimensionless_jacobian(system, q), constraint_rank(system))
    free = system.velocity_units[:, None] * free
    inertia = free.T @ mass @ free
    for number, pushes in enumerate(forces):
        w = 2.0 * np.pi * (LOWEST + (HIGHEST - LOWEST) * ((0.5 + number * GOLDEN) % 1.0))
        push = np.zeros(system.nv)
        for key, force in pushes.items():
            for k, x in measured[key].jacobian.items():
                push[k] += x * force
        answer = free @ np.linalg.solve(inertia, free.T @ push) if free.size else np.zeros(system.nv)
        amplitude = within = np.inf
        for key, force in pushes.items():
            acceleration = abs(float(sum(x * answer[k] for k, x in measured[key].jacobian.items())))
            if not force or not acceleration:
                continue
            stiffness, damping, servo = _at(scene, key)
            impedance = abs(force) * w**2 / (acceleration * (1.0 + w * scene.duration))
            impedance = servo or impedance + stiffness + damping * w
            reach = _reach(scene, key)
            room = (1.0 - ROOM_SHARE) * rooms.get(key, np.inf)
            amplitude = min(amplitude, reach * impedance / abs(force))
            within = min(within, np.clip(room, LEAST_SHARE * reach, reach) * impedance / abs(force))
        if not np.isfinite(amplitude):
            amplitude = within = 0.0
        yield Swing(float(amplitude), float(within), float(w))


def _at(scene: Scene, key: Key) -> tuple[float, float, float]:
    """Stiffness and damping at a joint coordinate, SI, and the stiffness of the control law alone."""
    found = [law for law in scene.joint_forces if law.key == key]
    gains = [law for law in found if isinstance(law, PD | JointSpring)]
    servo = sum(law.stiffness for law in gains if isinstance(law, PD))
    return sum(law.stiffness for law in gains), sum(law.damping for law in gains), max(servo, 0.0)


def _reach(scene: Scene, key: Key) -> float:
    """Return the amplitude of a joint coordinate's motion, m or rad."""
    return SHIFT * scene.mechanism.size if scene.mechanism.is_slide(*key) else SWING


def random_states(scene: Scene, count: int, seed: int = 0) -> list[State]:
    """Consistent states at random around the initial one, with random velocities; same seed, same states.

    Joint velocities are of the order of 1 rad/s and of one size of the mechanism per second.

    Raises:
        AssemblyError: if the mechanism hardly ever closes from nearby.
    """
    code = CompiledEquations(scene, "relative")
    assert isinstance(code.system, Relative)
    system, project = code.system, Projection(code)
    tree, unit = system.tree, system.velocity_units
    single = [(on_q.start, on_v.start) for motion, on_q, on_v in tree.motions if motion.kind != "ball"]
    single_q, single_v = [place[0] for place in single], [place[1] for place in single]
    start, _ = system.coordinates(initial_state(scene))
    rng = np.random.default_rng(seed)
    states: list[State] = []
    x = code.packed(start, np.zeros(tree.nv))
    for _ in range(ATTEMPTS * count):
        if len(states) == count:
            break
        step = RANDOM_AMPLITUDE * unit * rng.uniform(-1.0, 1.0, tree.nv)
        v = unit * rng.standard_normal(tree.nv)
        x[: code.size] = np.concatenate([system.retract(start, step), v])
        if not project(x):
            continue
        q, v = x[: system.nq], x[system.nq : code.size]
        if np.abs((q - start)[single_q] / unit[single_v]).max(initial=0.0) > STRAY * RANDOM_AMPLITUDE:
            continue  # closed on another branch, perhaps folded flat
        states.append(system.state(q, v))
    if len(states) < count:
        joint, gap = worst_joint(system, system.state(x[: system.nq], x[system.nq : code.size]))
        raise AssemblyError(joint, gap, CLOSURE_TOLERANCE)
    return states
