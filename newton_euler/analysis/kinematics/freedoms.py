"""Independent coordinates of a mechanism: joint coordinates, and rotations of balls."""

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


class Freedom(NamedTuple):
    """An independent coordinate."""

    name: str | Key
    key: Key | None
    """The joint coordinate: name of the joint, number of the coordinate; None for a rotation of a ball."""
    place: int
    """Index in v of a velocity of the tree without a joint coordinate; -1 for a joint coordinate."""
    ball: int
    """Index in v of the first component of the ball's angular velocity; -1 for other freedoms."""
    unit: float
    """The size of the mechanism for slides, m, else 1."""


def _other_freedoms(system: Relative) -> list[Freedom]:
    """List velocities of the spanning tree without a joint coordinate: of balls, and of bodies on rods only.

    The spanning tree is the mechanism without the joints that close loops.
    """
    found = []
    for kept in system.tree.joints:
        name = system.tree.joint(kept.joint).name
        for number, (motion, _, on_v) in enumerate(kept.places):
            if motion.kind == "ball":
                each = [
                    (f"{name}.ball.{axis}", on_v.start + k, on_v.start) for k, axis in enumerate(AXIS_NAMES)
                ]
            elif kept.joint >= len(system.mechanism.joints):
                each = [(f"{name}.{number}", on_v.start, -1)]
            else:
                continue
            found += [Freedom(n, None, place, ball, system.velocity_units[place]) for n, place, ball in each]
    return found


def chosen_freedoms(scene: Scene, state: State, names: Sequence[str | Key] | None) -> tuple[Freedom, ...]:
    """Return the coordinates with these names, or choose independent ones at a state if None."""
    mechanism, count = scene.mechanism, mobility(scene).degrees_of_freedom
    if count == 0:
        raise MechanismError(f"scene {scene.name!r}", "has no degree of freedom", "a mechanism that can move")
    others = {freedom.name: freedom for freedom in _other_freedoms(Relative(scene))}
    if names is None:
        keys = list(mechanism.coordinate_labels)
    else:
        keys = [mechanism.coordinate(name) for name in names if name not in others]
    system = Relative(measuring(scene, keys))
    of_joints = {key: Freedom(mechanism.coordinate_name(key), key, -1, -1, system.unit(key)) for key in keys}
    if names is not None:
        found = [others.get(name) or of_joints[mechanism.coordinate(name)] for name in names]
        if not len(found) == len(set(found)) == count:
            problem = f"coordinates are {listed(map(repr, names)) or 'none'}"
            needed = f"{count} different ones for {count} degrees of freedom"
            raise MechanismError(f"scene {scene.name!r}", problem, needed)
        return tuple(found)
    q, _ = system.coordinates(state)
    candidates = [*of_joints.values(), *others.values()]
    rows = rates_of(system, q, candidates) @ tangents(system, q)
    driven = [k for k, each in enumerate(candidates) if each.key in {law.key for law in scene.control}]
    chosen: list[int] = []
    for group in (driven, range(len(of_joints)), range(len(candidates))):
        rest = [k for k in group if k not in chosen]
        chosen = independent_rows(rows, chosen, rest, count)
    if len(chosen) < count:
        problem = f"{len(chosen)} joint coordinates are independent, of {count} degrees of freedom"
        raise MechanismError(f"scene {scene.name!r}", problem, "a state that is not singular")
    return tuple(candidates[k] for k in sorted(chosen))


def rates_of(system: Relative, q: Array, freedoms: Sequence[Freedom]) -> Array:
    """Compute the dimensionless Jacobian (d, nv) of coordinates with respect to velocities of the tree.

    Args:
        system: equations of motion in joint coordinates.
        q: (nq,) coordinates of the tree.
        freedoms: the d independent coordinates.
    """
    measured, units = system.measured(q, np.zeros(system.nv)), np.array([each.unit for each in freedoms])
    rows = [measured[each.key].jacobian if each.key else {each.place: 1.0} for each in freedoms]
    return to_array(rows, system.nv) * system.velocity_units / units[:, None]
