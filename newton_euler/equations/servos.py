"""Actuators of a scene and the joint coordinates that they move, chosen and checked once for all states.

The forces themselves are `newton_euler.equations.formulation.Formulation.servo_forces`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from newton_euler.equations.dense import RANK_TOLERANCE, orthonormal_null, singular_values
from newton_euler.equations.formulation import Formulation, Servos
from newton_euler.equations.model_control import scaled
from newton_euler.equations.parameters import measuring
from newton_euler.equations.redundancy import mobility
from newton_euler.equations.relative import Relative
from newton_euler.equations.row_choice import rows_in_use
from newton_euler.equations.sparse import to_array
from newton_euler.equations.system import dimensionless_jacobian
from newton_euler.errors import MechanismError
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array

CHOSEN = 1e-3  # dimensionless rate, independent of those chosen so far, below which one adds too little
ALIKE = 6  # digits to which such velocities are compared, so that no processor chooses by its last ones


def servos_of(
    scene: Scene,
    coordinates: Sequence[Key],
    actuators: Sequence[Key],
    form: Callable[[Scene], Formulation] = Relative,
) -> Servos:
    """Check that actuators of a scene can give coordinates any accelerations.

    Args:
        scene: the mechanism; its control laws are left out.
        coordinates, actuators: of `Servos`.
        form: of the equations whose rows of constraints are wanted.

    Raises:
        MechanismError: naming a coordinate that is there twice, follows a prescribed motion, is moved by
            others, or that no actuator moves, and for coordinates that leave other motions to actuators.
    """
    name = scene.mechanism.coordinate_name
    for what, keys in (("coordinate", coordinates), ("actuator", actuators)):
        for key in keys:
            if key in {motion.key for motion in scene.motions}:
                raise MechanismError(f"{what} {name(key)!r}", "follows a prescribed motion", "another one")
            if list(keys).count(key) > 1:
                raise MechanismError(f"{what} {name(key)!r}", "is named twice", f"each {what} once")
    system = Relative(measuring(scene, [*coordinates, *actuators]))
    servos = Servos(tuple(coordinates), tuple(actuators), rows_in_use(system))
    decided, count = mobility(scene), len(coordinates)
    if servos.actuators != servos.coordinates and decided.degrees_of_freedom != count:
        problem = f"has {decided.degrees_of_freedom} degrees of freedom, and {count} coordinates are chosen"
        needed = "as many where actuators are on other coordinates than these"
        raise MechanismError(f"scene {scene.name!r}", problem, needed)
    faults = [fault(system, system.coordinates(state)[0], servos) for state in decided.states]
    if all(faults):
        key, problem = faults[0] or (("", 0), "")
        raise MechanismError(f"coordinate {name(key)!r}", problem, "another choice")
    return scaled(servos, form(system.scene))


def fault(
    system: Relative, q: Array, servos: Servos, tolerance: float = RANK_TOLERANCE
) -> tuple[Key, str] | None:
    """Find a coordinate that cannot get any acceleration in a configuration, and the reason; None if all can.

    Args:
        system: of the scene that `measuring` returns for the coordinates and actuators.
        q: (nq,).
        servos: the choice.
        tolerance: dimensionless, of singular values that count as zero.
    """
    if not servos.coordinates:
        return None
    closed = dimensionless_jacobian(system, q)[servos.rows.in_use]
    rows = np.concatenate([closed, coordinate_rows(system, q, servos.coordinates)])
    left, values, right = singular_values(rows, full=True)
    rank = int(np.sum(values > tolerance))
    if rank < len(rows):
        share = np.abs(left[len(closed) :, rank:]).max(axis=1)
        return servos.coordinates[int(np.argmax(share))], "depends on loops and the other coordinates"
    tangent = right[:rank].T @ (left[len(closed) :].T / values[:, None])
    acting = coordinate_rows(system, q, servos.actuators) @ tangent
    _, ratios, combinations = singular_values(acting, full=True)
    if servos.actuators == servos.coordinates or np.sum(ratios > tolerance) == len(servos.coordinates):
        return None
    return servos.coordinates[int(np.argmax(np.abs(combinations[-1])))], "is moved by no actuator"


def coordinate_rows(system: Relative, q: Array, keys: Sequence[Key]) -> Array:
    """Compute dimensionless rates (k, nv) of measured joint coordinates for each dimensionless velocity."""
    measured = system.measured(q, np.zeros(system.nv))
    rows = to_array([measured[key].jacobian for key in keys], system.nv)
    return rows * system.velocity_units / np.array([system.unit(key) for key in keys])[:, None]


def tangents(system: Relative, q: Array) -> Array:
    """Compute orthonormal dimensionless velocities (nv, d) that keep loops closed."""
    closed = dimensionless_jacobian(system, q)[mobility(system.scene).independent]
    return orthonormal_null(closed, len(closed))


def independent_rows(rows: Array, chosen: Sequence[int], candidates: Iterable[int], count: int) -> list[int]:
    """Choose rows of a dimensionless matrix one by one, always the one that adds the most to those before.

    Args:
        rows: (k, n).
        chosen: those that are chosen already, `count` at most.
        candidates: others to choose from, until there are `count` or none adds more than `CHOSEN`.
    """
    found, rest, left = list(chosen), list(candidates), rows.copy()
    for row in found:
        _remove(left, row)
    while rest and len(found) < count:
        lengths = np.linalg.norm(left[rest], axis=1).round(ALIKE)
        best = int(np.argmax(lengths))
        if lengths[best] < CHOSEN:
            break
        found.append(rest.pop(best))
        _remove(left, found[-1])
    return found


def _remove(rows: Array, row: int) -> None:
    """Take the part along one of the rows off all of them."""
    length = np.linalg.norm(rows[row])
    if length > 0.0:
        along = rows[row] / length
        rows -= np.outer(rows @ along, along)
