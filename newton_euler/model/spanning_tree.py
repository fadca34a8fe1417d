"""Spanning tree of a mechanism: which joints carry coordinates and which close loops.

The same tree serves the joint-coordinate formulation, the MJCF and the URDF, so that their
coordinates are the same numbers. Bodies of the tree use frames that are parallel to the world at
the initial pose: a hinge's axis then has the same components in both of its bodies, and joint
coordinates are zero there.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count

import numpy as np

from newton_euler.model.euler_parameters import from_rotation, matrix_l, rotation
from newton_euler.model.joint import Joint, JointEquations, Motion, Pose
from newton_euler.model.joint_kinds import Fixed, Free, Rod, Spherical
from newton_euler.model.mechanism import CLOSURE_TOLERANCE, Body, Mechanism
from newton_euler.model.state import State
from newton_euler.scalars import Array, mapped, sqrt, zeros


@dataclass(frozen=True, eq=False)
class TreeJoint:
    """A joint that the tree keeps.

    Attributes:
        joint: number of the joint, as of `SpanningTree.joint`.
        parent, child: body indices.
        forward: True if the child is the joint's second body.
        motions: from parent to child; hinge and slide axes are signed so that coordinates keep the
            joint's own sense. A ball turns the child against the parent.
        points: of the motions, (3,) each, as of `Joint.motion_points`.
        q, v: where its coordinates and velocities are. A ball has a quaternion w-x-y-z in q and
            in v the angular velocity against the parent, in the child's tree frame.
    """

    joint: int
    parent: int
    child: int
    forward: bool
    motions: tuple[Motion, ...]
    points: tuple[Array, ...]
    q: slice
    v: slice

    @property
    def places(self) -> Iterator[tuple[Motion, slice, slice]]:
        """The motions with their places in q and in v."""
        iq, iv = self.q.start, self.v.start
        for motion in self.motions:
            nq, nv = (4, 3) if motion.kind == "ball" else (1, 1)
            yield motion, slice(iq, iq + nq), slice(iv, iv + nv)
            iq, iv = iq + nq, iv + nv


def motion_names(joint: Joint, forward: bool = True) -> list[str]:
    """A name for each of a joint's motions: the joint's own, numbered from 1 if there are several.

    In the joint's own order, from its first body to its second; in the other one unless `forward`.
    """
    count = len(joint.motions)
    names = [joint.name] if count == 1 else [f"{joint.name}_{k + 1}" for k in range(count)]
    return names if forward else names[::-1]


def coordinate_name(joint: Joint, coordinate: int) -> str:
    """Name of the motion of one of a joint's coordinates, which count its hinges and slides from 0."""
    names = zip(motion_names(joint), joint.motions, strict=True)
    return [name for name, motion in names if motion.kind != "ball"][coordinate]


class SpanningTree:
    """The tree of `mechanism` that cuts the joints with the fewest equations: balls first.

    Of joints with as many it rather keeps those that are actuated or have `loaded` balls.

    Rods are always cut. A body that only they reach floats: the tree has a free joint for it, after
    the joints of the mechanism, at its center of mass.

    Attributes:
        joints: kept joints, parents before children.
        floating: the free joints that are not among the mechanism's.
        cuts: indices of the joints that close loops.
        nq, nv: numbers of coordinates and velocities.
    """

    def __init__(
        self, mechanism: Mechanism, never: Collection[str] = (), loaded: Collection[str] = ()
    ) -> None:
        """Grow from the ground; joints named in `never` are cut whatever their kind.

        `loaded` are names of joints whose balls something acts on, see `Scene.loaded_balls`.
        """
        self.mechanism = mechanism
        kept: list[TreeJoint] = []
        reached: dict[int, int] = {0: 0}  # body: depth
        candidates: list[tuple[int, bool, int, int, int]] = []
        nq = nv = 0

        def offer(body: int) -> None:
            for index in mechanism.joints_at[body]:
                equations = self._equations[index]
                if equations.joint.name not in never and not equations.joint.only_closes:
                    passive = not (equations.joint.actuated or equations.joint.name in loaded)
                    heapq.heappush(candidates, (-equations.count, passive, reached[body], index, body))

        self.floating: tuple[Free, ...] = ()
        offer(0)
        while len(reached) < len(mechanism.bodies):
            if not candidates:
                body = next(k for k in range(len(mechanism.bodies)) if k not in reached)
                heapq.heappush(candidates, (0, True, 0, self._float(body), 0))
            _, _, depth, index, parent = heapq.heappop(candidates)
            equations = self._equations[index]
            forward = equations.first == parent
            child = equations.second if forward else equations.first
            if child in reached:
                continue
            motions, points = equations.joint.motions, equations.joint.motion_points
            if not forward:
                motions = tuple(Motion(m.kind, -m.axis) for m in reversed(motions))
                points = points[::-1]
            q_size = sum(4 if m.kind == "ball" else 1 for m in motions)
            v_size = sum(3 if m.kind == "ball" else 1 for m in motions)
            on_q, on_v = slice(nq, nq + q_size), slice(nv, nv + v_size)
            kept.append(TreeJoint(index, parent, child, forward, motions, points, on_q, on_v))
            nq, nv = nq + q_size, nv + v_size
            reached[child] = depth + 1
            offer(child)
        self.joints = tuple(kept)
        self.nq, self.nv = nq, nv
        self._kept = {joint.joint: joint for joint in kept}
        self.cuts = tuple(k for k in range(len(mechanism.joints)) if k not in self._kept)

    @cached_property
    def poses(self) -> list[Pose]:
        """Reference poses of the frames of the tree."""
        return [Pose(body.center_of_mass, np.eye(3)) for body in self.mechanism.bodies]

    @cached_property
    def _equations(self) -> list[JointEquations]:
        """All joints' equations in the frames of the tree, those of `floating` at the end."""
        return list(self.mechanism.attach(self.poses))

    def _float(self, body: int) -> int:
        """Add a free joint between the ground and a body; returns its number."""
        ground, name = self.mechanism.body_names[0], self.mechanism.body_names[body]
        free = Free(f"{name}_floats", ground, name, np.zeros(3))
        for point in ("point", "point_on_second"):  # which may be generic scalars
            object.__setattr__(free, point, self.mechanism.bodies[body].center_of_mass)
        self.floating = (*self.floating, free)
        self._equations.append(free.attach(0, self.poses[0], body, self.poses[body]))
        return len(self._equations) - 1

    def joint(self, joint: int) -> Joint:
        """Joint number `joint`: of the mechanism, or of `floating` after those."""
        return self._equations[joint].joint

    def equations(self, joint: int) -> JointEquations:
        """Equations of joint number `joint` in the frames of the tree."""
        return self._equations[joint]

    @cached_property
    def initial_rotations(self) -> tuple[Array, ...]:
        """(3, 3) for each body: takes its own frame to its tree frame."""
        return tuple(rotation(body.quaternion) for body in self.mechanism.bodies)

    @cached_property
    def motions(self) -> tuple[tuple[Motion, slice, slice], ...]:
        """All motions of the tree with their places in q and in v."""
        return tuple(place for joint in self.joints for place in joint.places)

    @property
    def quaternions(self) -> list[slice]:
        """Places of the Euler parameters of balls in q."""
        return [on_q for motion, on_q, _ in self.motions if motion.kind == "ball"]

    @cached_property
    def is_length(self) -> Array:
        """(nv,) True for velocities in m/s."""
        found = np.zeros(self.nv, dtype=bool)
        for motion, _, on_v in self.motions:
            found[on_v] = motion.kind == "slide"
        return found

    @cached_property
    def velocity_units(self) -> Array:
        """(nv,) what makes velocities dimensionless: the mechanism's size for slides, 1 for angles."""
        return np.where(self.is_length, self.mechanism.size, 1.0)

    @cached_property
    def coordinate_units(self) -> Array:
        """(nq,) units of coordinates: the mechanism's size, m, for slides, 1 for angles and quaternions."""
        found = np.ones(self.nq)
        for motion, on_q, _ in self.motions:
            if motion.kind == "slide":
                found[on_q] = self.mechanism.size
        return found

    def place(self, joint: str, coordinate: int) -> tuple[int, int] | None:
        """Return the places in q and v of a joint's hinge or slide number `coordinate`; None if cut."""
        kept = self._kept.get(self.mechanism.joint_index(joint))
        if kept is None:
            return None
        single = [(on_q.start, on_v.start) for motion, on_q, on_v in kept.places if motion.kind != "ball"]
        return single[coordinate if kept.forward else -1 - coordinate]

    def ball_place(self, joint: str) -> slice | None:
        """Return the place in v of the angular velocity of a joint's ball; None if it is cut."""
        kept = self._kept.get(self.mechanism.joint_index(joint))
        if kept is None:
            return None
        (place,) = (on_v for motion, _, on_v in kept.places if motion.kind == "ball")
        return place

    def rate(self, q: Array, v: Array) -> Array:
        """qdot (nq,): v itself, and pdot = 1/2 L^T omega' for quaternions."""
        if self.nq == self.nv:
            return v
        balls = [0.5 * matrix_l(q[on_q]).T @ v[on_v] for on_q, on_v in self._balls]
        return np.concatenate([v[self._singles[1]], *balls])[self._in_order]

    def retract(self, q: Array, step: Array) -> Array:
        """q moved by a small step (nv,); quaternions come out with norm 1."""
        if self.nq == self.nv:
            return q[: self.nq] + step
        on_q, on_v = self._singles
        moved = [q[on_q] + step[on_v]]
        for at, turned in self._balls:
            p = q[at] + 0.5 * (matrix_l(q[at]).T @ step[turned])
            moved.append(p / sqrt(p @ p))
        return np.concatenate(moved)[self._in_order]

    @cached_property
    def _balls(self) -> list[tuple[slice, slice]]:
        """Places of the balls in q and in v."""
        return [(on_q, on_v) for motion, on_q, on_v in self.motions if motion.kind == "ball"]

    @cached_property
    def _singles(self) -> tuple[Array, Array]:
        """(n,) the places of all other motions in q, and in v."""
        places = [(on_q.start, on_v.start) for m, on_q, on_v in self.motions if m.kind != "ball"]
        on_q, on_v = np.reshape(np.array(places, dtype=int), (-1, 2)).T
        return on_q, on_v

    @cached_property
    def _in_order(self) -> Array:
        """(nq,) where what comes as the singles and then the balls has the coordinates q."""
        order = [*self._singles[0], *(k for on_q, _ in self._balls for k in range(self.nq)[on_q])]
        return np.argsort(np.array(order, dtype=int))

    def coordinates(self, state: State) -> tuple[Array, Array]:
        """Joint coordinates q (nq,) and velocities v (nv,) of the kept joints in a state."""
        frames = [
            frame._replace(rotation=frame.rotation @ initial.T)
            for frame, initial in zip(state.frames(), self.initial_rotations, strict=True)
        ]
        q, v = zeros(self.nq, state.position), zeros(self.nv, state.position)
        for kept in self.joints:
            equations = self._equations[kept.joint]
            i, j = frames[equations.first], frames[equations.second]
            values = []
            for coordinate in equations.coordinates:
                values.append((coordinate.phi(i, j), coordinate.jacobian(i, j).rate(i, j)))
            parent, child = frames[kept.parent], frames[kept.child]
            remaining = iter(values if kept.forward else values[::-1])
            parts = []
            for motion in kept.motions:
                if motion.kind == "ball":
                    turn = mapped(from_rotation, parent.rotation.T @ child.rotation)
                    omega = child.angular_velocity - parent.angular_velocity
                    parts.append((turn, child.rotation.T @ omega))
                else:
                    parts.append(next(remaining))
            q[kept.q] = np.concatenate([np.zeros(0), *(part[0] for part in parts)])
            v[kept.v] = np.concatenate([np.zeros(0), *(part[1] for part in parts)])
        return q, v


@dataclass(frozen=True, eq=False)
class WeldedMechanism:
    """A mechanism whose loops close at balls, rods and welds only, for engines that know no other closure.

    A loop that would have to be cut at any other joint is cut through a body instead: the body is halved,
    both halves of the same pose and shape of inertia, the joint stays in the tree with one half,
    and a weld holds the halves together. That is exact, adds no equation that the joint did not
    have, and leaves the joint's reaction what it was.

    Attributes:
        mechanism: the bodies, halves appended at the end; the joints, welds appended at the end.
        tree: its spanning tree; the cuts are spherical joints that nothing acts on, rods and welds.
        origin: for each body the index of the body it is a part of in the original.
    """

    mechanism: Mechanism
    tree: SpanningTree
    origin: tuple[int, ...]

    def state(self, state: State) -> State:
        """The state of the original with rows repeated for the halves."""
        rows = list(self.origin)
        return State(*(array[rows] for array in state.arrays))


def weld_loops(
    mechanism: Mechanism, keep_bodies: bool = False, loaded: Collection[str] = ()
) -> WeldedMechanism:
    """Rewrite the loops of a mechanism so that only balls, rods and welds close them.

    Args:
        mechanism: of any loops.
        keep_bodies: whether to cut loops at their own welds. To an engine a weld in the tree is the better
            one, it costs no equations; but readers of a file make one body of the two that it holds.
        loaded: names of joints whose balls something acts on, which engines have in the tree only.
    """
    bodies, joints = list(mechanism.bodies), list(mechanism.joints)
    origin = list(range(len(bodies)))
    never = _own_welds(mechanism) if keep_bodies else []
    for index in SpanningTree(mechanism, never, loaded).cuts:
        joint = mechanism.joints[index]
        closes = isinstance(joint, Rod) or (isinstance(joint, Spherical) and joint.name not in loaded)
        if closes or joint.name in never:
            continue
        side = "second" if joint.second != mechanism.body_names[0] else "first"
        whole = mechanism.body_index(getattr(joint, side))
        name, half = _names_of_cut(joint.name, bodies[whole].name, bodies, joints)
        joints[index] = replace(joint, first=half) if side == "first" else replace(joint, second=half)
        joints.append(Fixed(name, bodies[whole].name, half, bodies[whole].center_of_mass))
        never.append(name)
        bodies.append(replace(mechanism.bodies[whole], name=half, shapes=()))
        origin.append(whole)
    parts = Counter(origin)
    for number, whole in enumerate(origin):
        share = 1.0 / parts[whole]
        if share < 1.0:
            body = bodies[number]
            bodies[number] = replace(body, mass=share * body.mass, inertia=share * body.inertia)
    welded = Mechanism(bodies, joints, mechanism.couplings)
    return WeldedMechanism(welded, SpanningTree(welded, never, loaded), tuple(origin))


def _own_welds(mechanism: Mechanism) -> list[str]:
    """Names of welds that other joints can do without to reach all bodies."""
    floating = len(SpanningTree(mechanism).floating)
    found: list[str] = []
    for joint in mechanism.joints:
        if isinstance(joint, Fixed):
            without = SpanningTree(mechanism, [*found, joint.name])
            if len(without.floating) == floating:
                found.append(joint.name)
    return found


def _names_of_cut(joint: str, whole: str, bodies: list[Body], joints: list[Joint]) -> tuple[str, str]:
    """Names of a weld and a half that are not taken, for a joint that a loop is cut at."""
    taken = {body.name for body in bodies} | {other.name for other in joints}
    for number in count(1):
        cut = joint if number == 1 else f"{joint}_{number}"
        names = f"{cut}_weld", f"{whole}_at_{cut}"
        if taken.isdisjoint(names):
            break
    return names


def unweld_loops(mechanism: Mechanism) -> Mechanism:
    """Put halves of `weld_loops` together again, known by their names; joints are as they were."""
    bodies, joints = {body.name: body for body in mechanism.bodies}, list(mechanism.joints)
    for weld in mechanism.joints:
        cut = weld.name.removesuffix("_weld")
        half = f"{weld.first}_at_{cut}"
        if not isinstance(weld, Fixed) or cut == weld.name or weld.second != half:
            continue
        body, other = bodies[weld.first], bodies[half]
        ends = [end for joint in joints if joint is not weld for end in (joint.first, joint.second)]
        same = np.allclose(body.center_of_mass, other.center_of_mass, rtol=0.0, atol=CLOSURE_TOLERANCE)
        if ends.count(half) != 1 or not same:
            continue
        turn = rotation(body.quaternion).T @ rotation(other.quaternion)
        inertia = body.inertia + turn @ other.inertia @ turn.T
        bodies[weld.first] = replace(body, mass=body.mass + other.mass, inertia=0.5 * (inertia + inertia.T))
        del bodies[half]
        joints = [_with_end(joint, half, weld.first) for joint in joints if joint is not weld]
    return Mechanism(bodies.values(), joints, mechanism.couplings)


def _with_end(joint: Joint, old: str, new: str) -> Joint:
    """A joint with another body where it has one of that name."""
    if joint.first == old:
        return replace(joint, first=new)
    return replace(joint, second=new) if joint.second == old else joint
