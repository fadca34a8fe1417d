"""Checks for inverse dynamics: can the actuators of a scene give chosen joint coordinates any accelerations?

`servos_of` returns a `Servos` record with the coordinates, the actuators and the constraint rows in use.
`newton_euler.equations.formulation.Formulation.servo_forces` then computes the actuator forces at a state.
Coordinates and actuators are listed by key: (name of the joint, number of its coordinate). An actuator acts
on one joint coordinate.
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

MIN_INDEPENDENT_DISTANCE = 1e-3
"""Smallest dimensionless distance of a row from the span of the rows chosen before it, for the row to be
chosen."""

COMPARED_DECIMALS = 6
"""Decimals to which distances of rows are rounded before they are compared, so that a processor's round-off
does not change the choice."""


def servos_of(
    scene: Scene,
    coordinates: Sequence[Key],
    actuators: Sequence[Key],
    form: Callable[[Scene], Formulation] = Relative,
) -> Servos:
    """Check that actuators of a scene can give joint coordinates any accelerations.

    Args:
        scene: the mechanism; its control laws are ignored.
        coordinates: keys of the joint coordinates with desired accelerations, independent of each other.
        actuators: keys of the joint coordinates on which actuators act: the same ones, or at least as many
            others.
        form: class of the equations whose constraint rows are returned.

    Raises:
        MechanismError: naming a coordinate that is given twice, follows a prescribed motion, depends on other
            coordinates, or is moved by no actuator; and for fewer coordinates than degrees of freedom.
    """
    name = scene.mechanism.coordinate_name
    for what, keys in (("coordinate", coordinates), ("actuator", actuators)):
        for key in keys:
            if key in {motion.key for motion in scene.motions}:
                raise MechanismError(f"{what} {name(key)!r}", "follows a prescribed motion", "another one")
            if list(keys).count(key) > 1:
                raise MechanismError(f"{what} {name(key)!r}", "is named twice", f"each {what} once")
    # equations of a copy of the scene whose only controllers are of zero force, on these coordinates
    system = Relative(measuring(scene, [*coordinates, *actuators]))
    servos = Servos(tuple(coordinates), tuple(actuators), rows_in_use(system))
    analysis, count = mobility(scene), len(coordinates)
    # for actuators on other coordinates, the chosen coordinates must determine the whole motion
    if servos.actuators != servos.coordinates and analysis.degrees_of_freedom != count:
        problem = f"has {analysis.degrees_of_freedom} degrees of freedom, and {count} coordinates are chosen"
        needed = "as many where actuators are on other coordinates than these"
        raise MechanismError(f"scene {scene.name!r}", problem, needed)
    # valid in at least one of the configurations that the mobility analysis has examined
    faults = [find_fault(system, system.coordinates(state)[0], servos) for state in analysis.states]
    if all(faults):
        key, problem = faults[0] or (("", 0), "")
        raise MechanismError(f"coordinate {name(key)!r}", problem, "another choice")
    # with the rows that `form` uses, and reference magnitudes of the pivots in their elimination
    return scaled(servos, form(system.scene))


def find_fault(
    system: Relative, q: Array, servos: Servos, tolerance: float = RANK_TOLERANCE
) -> tuple[Key, str] | None:
    """Find a coordinate to which the actuators cannot give any acceleration in a configuration.

    Args:
        system: equations of the scene that `newton_euler.equations.parameters.measuring` returns for the
            coordinates and actuators.
        q: (nq,) configuration.
        servos: the coordinates and actuators.
        tolerance: dimensionless limit below which a singular value counts as zero.

    Returns:
        Key of the coordinate and the reason; None if the actuators can give all coordinates any acceleration.
    """
    # coordinates must be independent of the constraints and of each other
    if not servos.coordinates:
        return None
    constraints = dimensionless_jacobian(system, q)[servos.rows.in_use]
    rows = np.concatenate([constraints, coordinate_rows(system, q, servos.coordinates)])
    left, values, right = singular_values(rows, full=True)
    rank = int(np.sum(values > tolerance))
    if rank < len(rows):
        share = np.abs(left[len(constraints) :, rank:]).max(axis=1)
        return servos.coordinates[int(np.argmax(share))], "depends on loops and the other coordinates"
    # velocities for a unit rate of each coordinate; the rates of the actuators' coordinates at these
    # velocities must have full rank
    velocities = right[:rank].T @ (left[len(constraints) :].T / values[:, None])
    actuator_rates = coordinate_rows(system, q, servos.actuators) @ velocities
    _, gains, combinations = singular_values(actuator_rates, full=True)
    if servos.actuators == servos.coordinates or np.sum(gains > tolerance) == len(servos.coordinates):
        return None
    return servos.coordinates[int(np.argmax(np.abs(combinations[-1])))], "is moved by no actuator"


def coordinate_rows(system: Relative, q: Array, keys: Sequence[Key]) -> Array:
    """Compute the dimensionless Jacobian (k, nv) of joint coordinates with respect to the velocities at q."""
    measured = system.measured(q, np.zeros(system.nv))
    rows = to_array([measured[key].jacobian for key in keys], system.nv)
    return rows * system.velocity_units / np.array([system.unit(key) for key in keys])[:, None]


def tangents(system: Relative, q: Array) -> Array:
    """Compute orthonormal dimensionless velocities (nv, d) at q that keep all loops closed.

    The number d is that of degrees of freedom.
    """
    constraints = dimensionless_jacobian(system, q)[mobility(system.scene).independent]
    return orthonormal_null(constraints, len(constraints))


def independent_rows(rows: Array, chosen: Sequence[int], candidates: Iterable[int], count: int) -> list[int]:
    """Choose independent rows of a dimensionless matrix, one after the other.

    The next row is always the candidate that is farthest from the span of the chosen rows.

    Args:
        rows: (k, n) matrix.
        chosen: numbers of rows that are chosen already, at most `count`.
        candidates: numbers of the rows to choose from.
        count: total number of rows to choose; fewer are chosen if the distance of all candidates from the
            span is below `MIN_INDEPENDENT_DISTANCE`.

    Returns:
        Numbers of the chosen rows, the given ones first.
    """
    found, waiting, components = list(chosen), list(candidates), rows.copy()
    # `components`: components of all rows orthogonal to the chosen rows
    for row in found:
        _remove(components, row)
    while waiting and len(found) < count:
        lengths = np.linalg.norm(components[waiting], axis=1).round(COMPARED_DECIMALS)
        best = int(np.argmax(lengths))
        if lengths[best] < MIN_INDEPENDENT_DISTANCE:
            break
        found.append(waiting.pop(best))
        _remove(components, found[-1])
    return found


def _remove(rows: Array, row: int) -> None:
    """Subtract from all rows (k, n), in place, their projection onto the row with the number `row`."""
    length = np.linalg.norm(rows[row])
    if length > 0.0:
        along = rows[row] / length
        rows -= np.outer(rows @ along, along)
