"""Independent coordinates of a mechanism: joint coordinates, and rotations of ball joints.

The spanning tree is the mechanism without the joints that close loops; v (nv,) are its velocities. A body
that only rods (constant distances) connect with others is joined to the ground of the tree by a free joint
with the name `BODY_floats`: three slides along the world axes, then a ball. The coordinates of this joint may
be independent coordinates, too. A key (joint, number) names a joint coordinate.

The tree frame of a body is fixed in the body, and parallel to the world at the initial pose. v has the
angular velocity of a ball joint relative to the parent body, in the tree frame of the child body.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from newton_euler.equations.parameters import measuring
from newton_euler.equations.redundancy import mobility
from newton_euler.equations.relative import Relative
from newton_euler.equations.servos import independent_rows, tangents
from newton_euler.equations.sparse import to_array
from newton_euler.errors import MechanismError, listed
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array

AXIS_NAMES = ("x", "y", "z")
"""Names of the three axes of a tree frame or of the world frame."""


class Freedom(NamedTuple):
    """An independent coordinate.

    Attributes:
        name: name of the joint or key of the joint coordinate; `JOINT.ball.x`, `JOINT.ball.y` or
            `JOINT.ball.z` for a rotation of a ball joint about an axis of its child's tree frame. The free
            joint of a body that only rods connect with others has the names `BODY_floats.0`, `BODY_floats.1`
            and `BODY_floats.2`. These are translations along the world axes x, y and z. Rotations are
            `BODY_floats.ball.x`, `.y` and `.z`.
        key: key of the joint coordinate; None for the other coordinates.
        v_index: index in v of the rate of a coordinate without a key; -1 for a joint coordinate.
        ball_start: index in v of the first component of a ball joint's angular velocity; -1 for other
            coordinates.
        unit: divisor that makes the coordinate dimensionless: the size of the mechanism, m (largest distance
            of joint points and centers of mass from their mean) for slides, else 1.
    """

    name: str | Key
    key: Key | None
    v_index: int
    ball_start: int
    unit: float


def _other_freedoms(system: Relative) -> list[Freedom]:
    """List the velocities of the spanning tree that are not rates of joint coordinates.

    These are angular velocities of ball joints, and velocities of bodies that only rods connect with others.
    """
    freedoms: list[Freedom] = []

    def add(name: str, v_index: int, ball_start: int) -> None:
        """Add a velocity, see `Freedom`."""
        unit = system.velocity_units[v_index]
        freedoms.append(Freedom(name, key=None, v_index=v_index, ball_start=ball_start, unit=unit))

    for tree_joint in system.tree.joints:
        name = system.tree.joint(tree_joint.joint).name
        is_added = tree_joint.joint >= len(system.mechanism.joints)  # a free joint of the tree alone
        # hinges, slides and balls of the joint, each with its slice in v
        for number, (motion, _, on_v) in enumerate(tree_joint.places):
            if motion.kind == "ball":
                for k, axis in enumerate(AXIS_NAMES):
                    add(f"{name}.ball.{axis}", v_index=on_v.start + k, ball_start=on_v.start)
            elif is_added:
                add(f"{name}.{number}", v_index=on_v.start, ball_start=-1)
    return freedoms


def chosen_freedoms(scene: Scene, state: State, names: Sequence[str | Key] | None) -> tuple[Freedom, ...]:
    """Return independent coordinates, as many as degrees of freedom.

    Args:
        scene: gives the mechanism and the control laws.
        state: state at which coordinates are chosen. It is not used if `names` are given; callers check
            that these coordinates are independent.
        names: names of the coordinates. If None, coordinates with control laws are chosen first, then other
            joint coordinates, then the rest, in each group those that move most.

    Raises:
        UnknownNameError: for an unknown joint.
        MechanismError: for too many or too few names, for a mechanism that cannot move, and for a singular
            state, at which too few coordinates are independent.
    """
    mechanism, count = scene.mechanism, mobility(scene).degrees_of_freedom
    if count == 0:
        raise MechanismError(f"scene {scene.name!r}", "has no degree of freedom", "a mechanism that can move")
    others = {freedom.name: freedom for freedom in _other_freedoms(Relative(scene))}
    if names is None:
        keys = list(mechanism.coordinate_labels)  # all joint coordinates
    else:
        keys = [mechanism.coordinate(name) for name in names if name not in others]
    # `measuring` makes the equations measure these coordinates: each gets a control law of zero force. The
    # spanning tree, and so v, is that of the scene
    system = Relative(measuring(scene, keys))
    of_joints = {
        key: Freedom(mechanism.coordinate_name(key), key, v_index=-1, ball_start=-1, unit=system.unit(key))
        for key in keys
    }
    # the coordinates that the user names
    if names is not None:
        named = [others.get(name) or of_joints[mechanism.coordinate(name)] for name in names]
        if not len(named) == len(set(named)) == count:
            problem = f"coordinates are {listed(map(repr, names)) or 'none'}"
            needed = f"{count} different ones for {count} degrees of freedom"
            raise MechanismError(f"scene {scene.name!r}", problem, needed)
        return tuple(named)
    # select independent rows of the candidates' Jacobian in the tangent space of the closed loops
    q, _ = system.coordinates(state)
    candidates = [*of_joints.values(), *others.values()]
    rows = coordinate_jacobian(system, q, candidates) @ tangents(system, q)
    controlled = [k for k, each in enumerate(candidates) if each.key in {law.key for law in scene.control}]
    chosen: list[int] = []
    for group in (controlled, range(len(of_joints)), range(len(candidates))):
        rest = [k for k in group if k not in chosen]
        chosen = independent_rows(rows, chosen, rest, count)
    if len(chosen) < count:
        problem = f"{len(chosen)} coordinates are independent, of {count} degrees of freedom"
        raise MechanismError(f"scene {scene.name!r}", problem, "a state that is not singular")
    return tuple(candidates[k] for k in sorted(chosen))


def coordinate_jacobian(system: Relative, q: Array, freedoms: Sequence[Freedom]) -> Array:
    """Compute the dimensionless Jacobian (d, nv) of coordinates with respect to velocities of the tree.

    Args:
        system: equations of motion in joint coordinates, which measure the joint coordinates among `freedoms`
            (`newton_euler.equations.parameters.measuring`).
        q: (nq,) coordinates of the tree.
        freedoms: the d independent coordinates.
    """
    measured, units = system.measured(q, np.zeros(system.nv)), np.array([each.unit for each in freedoms])
    rows = [measured[each.key].jacobian if each.key else {each.v_index: 1.0} for each in freedoms]
    return to_array(rows, system.nv) * system.velocity_units / units[:, None]
