"""Level "dynamics": actuator forces, energies, effective inertia and effective force of two engines.

A level is a group of checks; these checks compare two engines at the same states of a mechanism. Effective
inertia and force are the mass matrix and the force vector projected onto the velocities that the constraints
allow. They do not depend on an engine's choice of coordinates (`free_motion` in `allowed_motions.py`).
Velocities are divided by units, so that effective inertias are in kg m^2 and effective forces in N m.
`States.noise` is the relative error of the constraint equations, from round-off or nearly redundant
equations.
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
"""Function that finds the cause of a difference: a body, joint or gravity, with the wrong parameter if known.
The argument is True if a force or gravity can be the cause. The result is None without a cause."""


def dynamics_checks(pair: tuple[str, str], first: Samples, second: Samples) -> Iterator[Check]:
    """Compare actuator forces, energies, effective inertia and effective force of two engines.

    Tolerances are round-off times the condition number of the constraints. For the effective force, which
    contains accelerations, the tolerance is also multiplied by the condition number of the mass matrix. A
    failing check is attributed to the actuated joint, or to the element whose equations of motion are
    violated (a body, a joint or gravity).

    Args:
        pair: names of the two engines.
        first, second: equations of the two engines at the same states.
    """
    states = first.states

    @cache
    def cause(forces: bool) -> Cause | None:
        """Find the element that failing checks are attributed to, once for each value of `forces`."""
        return dynamic_cause(first, second, forces)

    if states.scene.control:
        units = _actuator_units(first)
        gap = np.abs(first.stack("actuator_force") - second.stack("actuator_force")) / units
        joint = states.scene.control[int(np.argmax(gap.max(axis=0)))].joint
        tolerance = round_off(max(first.condition, second.condition), states.noise)

        def actuator_cause(forces: bool) -> Cause:
            """Return the cause with its wrong parameter if it is at the actuated joint, else the joint."""
            violated = cause(forces)
            return violated if violated and violated.where == joint else Cause(joint)

        yield _check_largest(pair, states, "actuator force, rel", gap, 1.0, tolerance, actuator_cause)
    yield from motion_checks(pair, first, second, cause)


def motion_checks(
    pair: tuple[str, str], first: Samples, second: Samples, cause: CauseFinder
) -> Iterator[Check]:
    """Compare energies, effective inertia and effective force of two engines.

    Args:
        pair: names of the two engines.
        first, second: their equations at the same states.
        cause: called if a check fails, to find the body, joint or gravity that it is attributed to.
    """
    states = first.states
    condition = max(first.condition, second.condition)
    tolerance = round_off(condition, states.noise)
    for name in ("kinetic_energy", "potential_energy"):
        one, two = first.stack(name), second.stack(name)
        unit = max(states.energy, float(np.abs(one).max()))
        quantity = f"{name.replace('_', ' ')}, rel"
        yield _check_largest(pair, states, quantity, np.abs(one - two), unit, tolerance, cause)
    if not all(basis.shape[1] for basis in states.bases):  # bases of the allowed velocities (6 b, d)
        return  # nothing can move
    # Effective inertia and force at each state
    one_inertia, two_inertia = ([inertia for inertia, _ in each.free_motions] for each in (first, second))
    one_force, two_force = ([force for _, force in each.free_motions] for each in (first, second))
    gap, unit = _largest_differences(one_inertia, two_inertia, floor=0.0)
    yield _check_largest(pair, states, "effective inertia, rel", gap, unit, tolerance, cause)
    tolerance = round_off(condition * states.mass_condition, states.noise)
    gap, unit = _largest_differences(one_force, two_force, floor=states.energy)  # J = N m
    yield _check_largest(pair, states, "effective force, rel", gap, unit, tolerance, cause)


def _check_largest(
    pair: tuple[str, str],
    states: States,
    quantity: str,
    gap: Array,
    unit: float,
    tolerance: float,
    cause: CauseFinder,
) -> Check:
    """Make the check of the largest difference.

    Args:
        pair, quantity, tolerance: attributes of the check.
        states: n states, `states.all`.
        gap: (n, ...) differences at the states.
        unit: unit that differences are divided by.
        cause: finds the element that the check is attributed to if it fails; without an element, the check is
            attributed to the state of the largest difference.
    """
    worst = gap.reshape(len(states.all), -1).max(axis=1)
    value = float(worst.max()) / unit
    place = Cause(states.name(int(np.argmax(worst))))
    if not value <= tolerance:
        # kinetic energy and inertia do not depend on forces
        depends_on_forces = quantity not in ("kinetic energy, rel", "effective inertia, rel")
        place = cause(depends_on_forces) or place
    return Check("dynamics", quantity, pair, value, tolerance, place.where, detail=place.detail)


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
    """Return the units (a,) that differences of the forces of a actuators are divided by, N or N m.

    The unit is the largest force in the mechanism (times the mechanism's size for a torque), or the largest
    value of the actuator itself if that is larger.
    """
    scene, scales = samples.states.scene, samples.scales
    units = []
    for law in scene.control:
        slides = scene.mechanism.is_slide(*law.key)
        units.append(scales.force * (1.0 if slides else scales.size))
    return np.maximum(units, np.abs(samples.stack("actuator_force")).max(axis=0))
