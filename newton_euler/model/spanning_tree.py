"""Spanning tree of a mechanism: which joints carry coordinates, and which joints are cut, that is, close
loops by constraint equations.

The joint-coordinate formulation of newton_euler, exported MJCF files and exported URDF files use the same
tree, so that their coordinates have the same values. Bodies of the tree have frames that are parallel to the
world at the initial pose ("tree frames"). A hinge axis then has the same components in both of its bodies,
and joint coordinates are zero at the initial pose. q (nq,) denotes the coordinates of all joints of the tree,
and v (nv,) their velocities. Balls have quaternions in q and angular velocities in v.

MuJoCo and Pinocchio close loops only with ball joints, rods and welds. `weld_loops` rewrites a mechanism for
them: instead of any other joint it cuts a body into two halves, which a weld holds together. `unweld_loops`
reverses this.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count
from typing import NamedTuple

import numpy as np

from newton_euler.model.euler_parameters import from_rotation, matrix_l, rotation
from newton_euler.model.joint import Joint, JointEquations, Motion, Pose
from newton_euler.model.joint_kinds import Fixed, Free, Rod, Spherical
from newton_euler.model.mechanism import CLOSURE_TOLERANCE, Body, Mechanism
from newton_euler.model.state import State
from newton_euler.scalars import Array, mapped, sqrt, zeros


class PlacedMotion(NamedTuple):
    """An elementary motion (hinge, slide or ball) of a tree joint, with its places in q and v."""

    motion: Motion
    on_q: slice
    """Slice in q of the coordinate of a hinge or slide, or of the quaternion of a ball."""
    on_v: slice
    """Slice in v of the rate of a hinge or slide, or of the angular velocity of a ball."""


@dataclass(frozen=True, eq=False)
class TreeJoint:
    """A joint of the tree, which carries coordinates, between a parent and a child body.

    Attributes:
        joint: index of the joint, see `SpanningTree.joint`.
        parent, child: indices of the two bodies.
        forward: True if the child is the second body of the joint.
        motions: elementary motions from the parent to the child. The signs of hinge and slide axes are such
            that the coordinates are those of the joint also if the child is its first body.
        points: (3,) m, point of each motion, see `Joint.motion_points`.
        q, v: slices of the joint's coordinates in q and of its velocities in v. A ball has a quaternion (w,
            x, y, z) in q, and in v the angular velocity of the child relative to the parent, in the child's
            tree frame.
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
    def places(self) -> Iterator[PlacedMotion]:
        """Elementary motions from the parent to the child, with their slices in q and in v."""
        iq, iv = self.q.start, self.v.start
        for motion in self.motions:
            nq, nv = (4, 3) if motion.kind == "ball" else (1, 1)
            yield PlacedMotion(motion, slice(iq, iq + nq), slice(iv, iv + nv))
            iq, iv = iq + nq, iv + nv


def motion_names(joint: Joint, forward: bool = True) -> list[str]:
    """Name the elementary motions of a joint, for exported model files.

    A single motion has the name of the joint; several have the suffixes _1, _2, ....

    Args:
        joint: the joint.
        forward: True for the order from the joint's first body to its second body, False for the reverse
            order.
    """
    count = len(joint.motions)
    names = [joint.name] if count == 1 else [f"{joint.name}_{k + 1}" for k in range(count)]
    return names if forward else names[::-1]


def coordinate_name(joint: Joint, coordinate: int) -> str:
    """Return the name of the elementary motion that a joint coordinate measures, see `motion_names`.

    Args:
        joint: the joint.
        coordinate: index of the coordinate among the joint's hinges and slides, from 0.
    """
    names = zip(motion_names(joint), joint.motions, strict=True)
    return [name for name, motion in names if motion.kind != "ball"][coordinate]


class SpanningTree:
    """A spanning tree of a mechanism, in which the joints with the most constraint equations are kept.

    The cut joints, which close loops, therefore have few equations, such as balls. Among joints with equally
    many equations, joints that are actuated or have loaded balls are kept, because only kept joints have
    coordinates. Rods have no coordinates and are always cut. A body that only rods hold gets an additional
    free joint at its center of mass; additional joints have indices after those of the mechanism.

    Attributes:
        mechanism: the mechanism.
        joints: kept joints, parents before children.
        floating: the additional free joints.
        cuts: indices of the cut joints, which close loops.
        nq, nv: numbers of coordinates and of velocities; nq is larger by one for each ball.
    """

    def __init__(
        self, mechanism: Mechanism, always_cut: Collection[str] = (), loaded: Collection[str] = ()
    ) -> None:
        """Grow the tree from the ground, always by the best joint at a reached body (Prim's algorithm).

        Args:
            mechanism: the mechanism.
            always_cut: names of joints that are always cut.
            loaded: names of joints with a spring, damper or armature on their ball, see `Scene.loaded_balls`.
        """
        self.mechanism = mechanism
        kept: list[TreeJoint] = []
        reached: dict[int, int] = {0: 0}  # depth in the tree by body index
        # Heap with the best (smallest) candidate first: (-number of equations, is passive, depth of the
        # reached body, index of the joint, index of the reached body)
        candidates: list[tuple[int, bool, int, int, int]] = []
        nq = nv = 0

        def add_candidates(body: int) -> None:
            """Add the joints at a reached body to the candidates."""
            for index in mechanism.joints_at[body]:
                equations = self._equations[index]
                if equations.joint.name not in always_cut and not equations.joint.only_closes:
                    passive = not (equations.joint.actuated or equations.joint.name in loaded)
                    heapq.heappush(candidates, (-equations.count, passive, reached[body], index, body))

        self.floating: tuple[Free, ...] = ()
        add_candidates(0)
        while len(reached) < len(mechanism.bodies):
            # Without candidates, the next body is held by rods only and gets a free joint
            if not candidates:
                body = next(k for k in range(len(mechanism.bodies)) if k not in reached)
                heapq.heappush(candidates, (0, True, 0, self._add_floating_joint(body), 0))

            # Take the best candidate, unless its other body has been reached by another joint
            _, _, depth, index, parent = heapq.heappop(candidates)
            equations = self._equations[index]
            forward = equations.first == parent
            child = equations.second if forward else equations.first
            if child in reached:
                continue

            # Keep the joint, with its motions in the direction from parent to child
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
            add_candidates(child)

        self.joints = tuple(kept)
        self.nq, self.nv = nq, nv
        self._kept = {joint.joint: joint for joint in kept}
        self.cuts = tuple(k for k in range(len(mechanism.joints)) if k not in self._kept)

    @cached_property
    def poses(self) -> list[Pose]:
        """Poses of the tree frames of all bodies at the initial pose: at the centers of mass, parallel to the
        world."""
        return [Pose(body.center_of_mass, np.eye(3)) for body in self.mechanism.bodies]

    @cached_property
    def _equations(self) -> list[JointEquations]:
        """Equations of all joints in the tree frames; those of `floating` at the end."""
        return list(self.mechanism.attach(self.poses))

    def _add_floating_joint(self, body: int) -> int:
        """Add a free joint between the ground and the body with an index; return the index of the joint."""
        ground, name = self.mechanism.body_names[0], self.mechanism.body_names[body]
        free = Free(f"{name}_floats", ground, name, np.zeros(3))
        # Set the points after construction: when the equations are traced to generate code, the points are
        # symbols, which the constructor refuses
        for point in ("point", "point_on_second"):
            object.__setattr__(free, point, self.mechanism.bodies[body].center_of_mass)
        self.floating = (*self.floating, free)
        self._equations.append(free.attach(0, self.poses[0], body, self.poses[body]))
        return len(self._equations) - 1

    def joint(self, joint: int) -> Joint:
        """Return the joint with an index: joints of the mechanism first, then those of `floating`."""
        return self._equations[joint].joint

    def equations(self, joint: int) -> JointEquations:
        """Return the equations of the joint with an index, in the tree frames, see `joint`."""
        return self._equations[joint]

    @cached_property
    def initial_rotations(self) -> tuple[Array, ...]:
        """Rotation matrix (3, 3) of each body from its body frame to its tree frame."""
        return tuple(rotation(body.quaternion) for body in self.mechanism.bodies)

    @cached_property
    def motions(self) -> tuple[PlacedMotion, ...]:
        """All elementary motions of the tree with their slices in q and in v."""
        return tuple(place for joint in self.joints for place in joint.places)

    @property
    def motion_names(self) -> list[str]:
        """Names of all elementary motions in exported model files, in the order of `motions`."""
        return [
            name for joint in self.joints for name in motion_names(self.joint(joint.joint), joint.forward)
        ]

    @property
    def quaternions(self) -> list[slice]:
        """Slices of the quaternions of balls in q."""
        return [on_q for motion, on_q, _ in self.motions if motion.kind == "ball"]

    @cached_property
    def is_length(self) -> Array:
        """(nv,) True for velocities in m/s, False for velocities in rad/s."""
        lengths = np.zeros(self.nv, dtype=bool)
        for motion, _, on_v in self.motions:
            lengths[on_v] = motion.kind == "slide"
        return lengths

    @cached_property
    def velocity_units(self) -> Array:
        """(nv,) scales of velocities: the mechanism's characteristic length, m, for slides; 1 for angles."""
        return np.where(self.is_length, self.mechanism.size, 1.0)

    @cached_property
    def coordinate_units(self) -> Array:
        """(nq,) scales of coordinates: the mechanism's characteristic length, m, for slides; 1 for angles and
        quaternions."""
        units = np.ones(self.nq)
        for motion, on_q, _ in self.motions:
            if motion.kind == "slide":
                units[on_q] = self.mechanism.size
        return units

    def place(self, joint: str, coordinate: int) -> tuple[int, int] | None:
        """Return the indices of a joint coordinate in q and in v; None if the joint is cut.

        Args:
            joint: name of the joint.
            coordinate: index of the coordinate among the joint's hinges and slides, from 0.
        """
        kept = self._kept.get(self.mechanism.joint_index(joint))
        if kept is None:
            return None
        places = [(on_q.start, on_v.start) for motion, on_q, on_v in kept.places if motion.kind != "ball"]
        # If the child is the joint's first body, the motions are in reverse order
        return places[coordinate if kept.forward else -1 - coordinate]

    def ball_place(self, joint: str) -> slice | None:
        """Return the slice in v of the angular velocity of a joint's ball, by joint name; None if the joint
        is cut."""
        kept = self._kept.get(self.mechanism.joint_index(joint))
        if kept is None:
            return None
        (place,) = (on_v for motion, _, on_v in kept.places if motion.kind == "ball")
        return place

    def rate(self, q: Array, v: Array) -> Array:
        """Compute dq/dt (nq,) from q (nq,) and v (nv,).

        The rate is v for hinges and slides, and dp/dt = 1/2 L^T omega' for quaternions p of balls with the
        angular velocity omega' (`euler_parameters.matrix_l`).
        """
        if self.nq == self.nv:
            return v
        quaternion_rates = [0.5 * matrix_l(q[on_q]).T @ v[on_v] for on_q, on_v in self._ball_slices]
        return np.concatenate([v[self._axis_indices[1]], *quaternion_rates])[self._axes_first_to_q]

    def retract(self, q: Array, step: Array) -> Array:
        """Compute the coordinates (nq,) after a small step (nv,) from q, with unit quaternions.

        Args:
            q: (nq,) or longer; numbers after the first nq, which other parts of a state may add, are ignored.
            step: (nv,) hinge angles, rad, displacements of slides, m, and rotation vectors of balls, rad.
        """
        if self.nq == self.nv:
            return q[: self.nq] + step
        axes_q, axes_v = self._axis_indices
        moved = [q[axes_q] + step[axes_v]]
        for on_q, on_v in self._ball_slices:
            p = q[on_q] + 0.5 * (matrix_l(q[on_q]).T @ step[on_v])
            moved.append(p / sqrt(p @ p))
        return np.concatenate(moved)[self._axes_first_to_q]

    @cached_property
    def _ball_slices(self) -> list[tuple[slice, slice]]:
        """Slices of each ball in q and in v."""
        return [(on_q, on_v) for motion, on_q, on_v in self.motions if motion.kind == "ball"]

    @cached_property
    def _axis_indices(self) -> tuple[Array, Array]:
        """Indices (n,) of all hinges and slides in q, and (n,) in v."""
        places = [(on_q.start, on_v.start) for m, on_q, on_v in self.motions if m.kind != "ball"]
        on_q, on_v = np.reshape(np.array(places, dtype=int), (-1, 2)).T
        return on_q, on_v

    @cached_property
    def _axes_first_to_q(self) -> Array:
        """(nq,) indices that reorder a vector with all hinges and slides first, then all balls, to the order
        of q."""
        order = [*self._axis_indices[0], *(k for on_q, _ in self._ball_slices for k in range(self.nq)[on_q])]
        return np.argsort(np.array(order, dtype=int))

    def coordinates(self, state: State) -> tuple[Array, Array]:
        """Compute the coordinates q (nq,) and velocities v (nv,) of the kept joints in a state.

        The numbers of the state are floats, or generic scalars such as the states of many times at once.
        """
        # Tree frames, which differ from body frames by the rotations at the initial pose
        frames = [
            frame._replace(rotation=frame.rotation @ initial.T)
            for frame, initial in zip(state.frames(), self.initial_rotations, strict=True)
        ]
        q, v = zeros(self.nq, state.position), zeros(self.nv, state.position)
        for kept in self.joints:
            # Measure the hinges and slides of the joint: `phi` of a coordinate is its value
            equations = self._equations[kept.joint]
            i, j = frames[equations.first], frames[equations.second]
            values = []
            for coordinate in equations.coordinates:
                values.append((coordinate.phi(i, j), coordinate.jacobian(i, j).rate(i, j)))

            # Order the pairs (coordinate, rate) from parent to child, and insert the quaternion and the
            # angular velocity of balls
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
    """A mechanism whose loops are closed by ball joints, rods and welds only, for MuJoCo and Pinocchio.

    If a loop would have to be cut at any other joint, a body is cut instead. The body is replaced by two
    halves, each with the pose and half the mass and inertia of the body. The joint stays in the tree, at one
    half, and a weld holds the halves together. The dynamics and the reaction of the joint do not change. The
    weld has the six equations that balance the degrees of freedom that the joint adds to the tree.

    Attributes:
        mechanism: the bodies, with the additional halves at the end; the joints, with the welds at the end;
            the couplings of joint coordinates, such as gears, unchanged.
        tree: spanning tree of that mechanism; its cuts are ball joints without loads, rods and welds.
        origin: for each body, the index of the original mechanism's body from which it was made.
    """

    mechanism: Mechanism
    tree: SpanningTree
    origin: tuple[int, ...]

    def state(self, state: State) -> State:
        """Convert a state of the original mechanism to this mechanism: halves have the state of their
        body."""
        rows = list(self.origin)
        return State(*(array[rows] for array in state.arrays))

    @property
    def closing_joints(self) -> dict[str, Joint]:
        """Joints of this mechanism that close loops, by the joint of the original mechanism at the loop.

        This is the same joint, or the weld of the half that the joint holds.
        """
        joints, closing = self.mechanism.joints, dict[str, Joint]()
        for cut in self.tree.cuts:
            second, owner = self.mechanism.body_index(joints[cut].second), cut
            if self.origin[second] != second:  # a half, at which there is one joint beside its weld
                (owner,) = (k for k in self.mechanism.joints_at[second] if k != cut)
            closing[joints[owner].name] = joints[cut]
        return closing


def weld_loops(
    mechanism: Mechanism, keep_bodies: bool = False, loaded: Collection[str] = ()
) -> WeldedMechanism:
    """Rewrite a mechanism so that only ball joints, rods and welds close its loops, see `WeldedMechanism`.

    Args:
        mechanism: a mechanism with any loops.
        keep_bodies: True to cut loops at `Fixed` joints of the mechanism where possible. In the tree a fixed
            joint costs no equations, but readers of an exported file merge the two bodies that it holds into
            one.
        loaded: names of joints with a spring, damper or armature on their ball; engines support these only
            for joints of the tree.
    """
    bodies, joints = list(mechanism.bodies), list(mechanism.joints)
    origin = list(range(len(bodies)))
    always_cut = _cuttable_welds(mechanism) if keep_bodies else []

    # Split a body at each cut joint that an engine cannot close: the second body of the joint, or the first
    # if the second is the ground
    for index in SpanningTree(mechanism, always_cut, loaded).cuts:
        joint = mechanism.joints[index]
        closes = isinstance(joint, Rod) or (isinstance(joint, Spherical) and joint.name not in loaded)
        if closes or joint.name in always_cut:
            continue
        side = "second" if joint.second != mechanism.body_names[0] else "first"
        whole = mechanism.body_index(getattr(joint, side))
        weld, half = _names_of_cut(joint.name, bodies[whole].name, bodies, joints)
        joints[index] = replace(joint, first=half) if side == "first" else replace(joint, second=half)
        joints.append(Fixed(weld, bodies[whole].name, half, bodies[whole].center_of_mass))
        always_cut.append(weld)
        bodies.append(replace(mechanism.bodies[whole], name=half, shapes=()))
        origin.append(whole)

    # Divide mass and inertia equally among the parts of a body, which may be split at several joints
    part_count = Counter(origin)
    for index, whole in enumerate(origin):
        share = 1.0 / part_count[whole]
        if share < 1.0:
            body = bodies[index]
            bodies[index] = replace(body, mass=share * body.mass, inertia=share * body.inertia)
    welded = Mechanism(bodies, joints, mechanism.couplings)
    return WeldedMechanism(welded, SpanningTree(welded, always_cut, loaded), tuple(origin))


def _cuttable_welds(mechanism: Mechanism) -> list[str]:
    """Return the names of the fixed joints that can all be cut at once without the tree needing more free
    joints to reach all bodies."""
    floating = len(SpanningTree(mechanism).floating)
    cuttable: list[str] = []
    for joint in mechanism.joints:
        if isinstance(joint, Fixed):
            tree = SpanningTree(mechanism, always_cut=[*cuttable, joint.name])
            if len(tree.floating) == floating:
                cuttable.append(joint.name)
    return cuttable


def _names_of_cut(joint: str, whole: str, bodies: list[Body], joints: list[Joint]) -> tuple[str, str]:
    """Return unused names for the weld and the new half of a body that is split at a joint.

    Args:
        joint: name of the joint.
        whole: name of the body.
        bodies, joints: all bodies and joints, whose names are taken.
    """
    taken = {body.name for body in bodies} | {other.name for other in joints}
    for number in count(1):
        cut = joint if number == 1 else f"{joint}_{number}"
        names = f"{cut}_weld", f"{whole}_at_{cut}"
        if taken.isdisjoint(names):
            break
    return names


def unweld_loops(mechanism: Mechanism) -> Mechanism:
    """Merge the body halves that `weld_loops` has made with their bodies; their names identify them.

    A mechanism without such halves is returned with the same bodies and joints.
    """
    bodies, joints = {body.name: body for body in mechanism.bodies}, list(mechanism.joints)
    for weld in mechanism.joints:
        # The names of the weld and the half must match those of `_names_of_cut`
        cut = weld.name.removesuffix("_weld")
        half = f"{weld.first}_at_{cut}"
        if not isinstance(weld, Fixed) or cut == weld.name or weld.second != half:
            continue

        # The half must have exactly one joint besides the weld, and the same center of mass
        body, other = bodies[weld.first], bodies[half]
        ends = [end for joint in joints if joint is not weld for end in (joint.first, joint.second)]
        same = np.allclose(body.center_of_mass, other.center_of_mass, rtol=0.0, atol=CLOSURE_TOLERANCE)
        if ends.count(half) != 1 or not same:
            continue

        # Add mass and inertia of the half (turn: from the frame of the half to that of the body), and move
        # its joint to the body
        turn = rotation(body.quaternion).T @ rotation(other.quaternion)
        inertia = body.inertia + turn @ other.inertia @ turn.T
        bodies[weld.first] = replace(body, mass=body.mass + other.mass, inertia=0.5 * (inertia + inertia.T))
        del bodies[half]
        joints = [_with_end(joint, half, weld.first) for joint in joints if joint is not weld]
    return Mechanism(bodies.values(), joints, mechanism.couplings)


def _with_end(joint: Joint, old: str, new: str) -> Joint:
    """Return a joint with the body `old` replaced by the body `new` if it is one of its two bodies."""
    if joint.first == old:
        return replace(joint, first=new)
    return replace(joint, second=new) if joint.second == old else joint
