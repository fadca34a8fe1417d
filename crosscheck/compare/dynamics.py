"""Level "dynamics": actuator forces, energies, effective inertia and effective force of two engines.

Effective inertia and force are the mass matrix and the force vector projected onto the velocities that the
constraints allow. They do not depend on an engine's choice of coordinates (`free_motion` in `samples.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache

import numpy as np

from crosscheck.compare.attribution import Cause, dynamic_cause
from crosscheck.compare.check import Check, round_off
from crosscheck.compare.samples import Samples, States
from newton_euler.scalars import Array

CauseFinder = Callable[[bool], Cause | None]
"""Function that finds the cause of a difference. The argument is True if a force can be the cause."""


def dynamics_rows(pair: tuple[str, str], first: Samples, second: Samples) -> Iterator[Check]:
    """Compare actuator forces, energies, effective inertia and effective force of two engines.

    Tolerances are round-off times the condition number of the constraints. For the effective force, which
    contains accelerations, the tolerance is also multiplied by the condition number of the mass matrix. A
    failing check is attributed to the actuated joint, or to the body or term whose equations of motion are
    violated.

    Args:
        pair: names of the two engines.
        first, second: their equations at the same states.
    """
    states = first.states

    @cache
    def cause(forces: bool) -> Cause | None:
        return dynamic_cause(first, second, forces)

    if states.scene.control:
        units = _actuator_units(first)
        gap = np.abs(first.stack("actuator_force") - second.stack("actuator_force")) / units
        joint = states.scene.control[int(np.argmax(gap.max(axis=0)))].joint
        tolerance = round_off(max(first.condition, second.condition), states.noise)

        def actuator_cause(forces: bool) -> Cause:
            """Return the cause if it is at the actuated joint, for its detail, else the joint alone."""
            found = cause(forces)
            return found if found and found.where == joint else Cause(joint)

        yield _row(pair, states, "actuator force, rel", gap, 1.0, tolerance, actuator_cause)
    yield from motion_rows(pair, first, second, cause)


def motion_rows(
    pair: tuple[str, str], first: Samples, second: Samples, cause: CauseFinder
) -> Iterator[Check]:
    """Compare energies, effective inertia and effective force of two engines, or of two models.

    Args:
        pair: names of the two.
        first, second: their equations at the same states.
        cause: called if a check fails, to find the body, joint or term that it is attributed to.
    """
    states = first.states
    condition = max(first.condition, second.condition)
    tolerance = round_off(condition, states.noise)
    for name in ("kinetic_energy", "potential_energy"):
        one, two = first.stack(name), second.stack(name)
        unit = max(states.energy, float(np.abs(one).max()))
        quantity = f"{name.replace('_', ' ')}, rel"
        yield _row(pair, states, quantity, np.abs(one - two), unit, tolerance, cause)
    if not all(basis.shape[1] for basis in states.bases):
        return  # nothing can move
    one_inertia, two_inertia = ([inertia for inertia, _ in each.free_motions] for each in (first, second))
    one_force, two_force = ([force for _, force in each.free_motions] for each in (first, second))
    gap, unit = _largest_differences(one_inertia, two_inertia, 0.0)
    yield _row(pair, states, "effective inertia, rel", gap, unit, tolerance, cause)
    tolerance = round_off(condition * states.mass_condition, states.noise)
    gap, unit = _largest_differences(one_force, two_force, states.energy)
    yield _row(pair, states, "effective force, rel", gap, unit, tolerance, cause)


def _row(
    pair: tuple[str, str],
    states: States,
    quantity: str,
    gap: Array,
    unit: float,
    tolerance: float,
    cause: CauseFinder,
) -> Check:
    """Make the check of the largest of the differences `gap`, whose first axis is the states.

    The value is `gap` divided by `unit`. If the check fails, it is attributed to the `cause`.
    """
    worst = gap.reshape(len(states.all), -1).max(axis=1)
    value = float(worst.max()) / unit
    found = Cause(states.name(int(np.argmax(worst))))
    if not value <= tolerance:
        by_force = quantity not in ("kinetic energy, rel", "effective inertia, rel")
        found = cause(by_force) or found
    return Check("dynamics", quantity, pair, value, tolerance, found.where, detail=found.detail)


def _largest_differences(one: list[Array], two: list[Array], floor: float) -> tuple[Array, float]:
    """Compute the largest difference at each of n states, and the unit that differences are divided by.

    Args:
        one, two: arrays of two engines, one per state. Their shapes vary with the degrees of freedom.
        floor: smallest unit.

    Returns:
        Differences (n,), and the unit: the largest absolute value in `one`, or `floor` if that is larger.
    """
    gap = [float(np.max(np.abs(x - y))) for x, y in zip(one, two, strict=True)]
    return np.array(gap), max(floor, *(float(np.max(np.abs(x))) for x in one))


def _actuator_units(samples: Samples) -> Array:
    """Return the units (a,) that differences of actuator forces are divided by, N or N m.

    The unit is the largest force in the mechanism (times the mechanism's size for a torque), or the largest
    value of the actuator itself if that is larger.
    """
    scene, scales = samples.states.scene, samples.scales
    units = []
    for law in scene.control:
        slides = scene.mechanism.is_slide(*law.key)
        units.append(scales.force * (1.0 if slides else scales.size))
    return np.maximum(units, np.abs(samples.stack("actuator_force")).max(axis=0))
