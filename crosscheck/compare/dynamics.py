"""Level "dynamics": actuator forces, energies, inertia and force that independent velocities see."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache

import numpy as np

from crosscheck.compare.attribution import Cause, dynamic_cause
from crosscheck.compare.check import Check, round_off
from crosscheck.compare.samples import Samples, States
from newton_euler.scalars import Array

Blamed = Callable[[bool], Cause | None]
"""Function that finds the cause of a difference; its argument tells whether forces can be the cause."""


def dynamics_rows(pair: tuple[str, str], first: Samples, second: Samples) -> Iterator[Check]:
    """Actuator forces, energies, and the free motion's inertia and force; its basis is the states'.

    Tolerances are round-off magnified by the condition of the constraints, which independent velocities
    come from; the effective force holds accelerations across them, whose round-off the mass matrix magnifies.
    What fails is blamed on the joint that is actuated, or on the body or term whose equations of
    motion are violated.
    """
    states = first.states

    @cache
    def cause(forces: bool) -> Cause | None:
        return dynamic_cause(first, second, forces)

    if states.scene.control:
        units = _actuator_units(first)
        gap = np.abs(first.stack("actuator_force") - second.stack("actuator_force")) / units
        joint = states.scene.control[int(np.argmax(gap.max(axis=0)))].joint
        share = round_off(max(first.condition, second.condition), states.noise)

        def of_actuator(forces: bool) -> Cause:
            found = cause(forces)
            return found if found and found.where == joint else Cause(joint)

        yield _row(pair, states, "actuator force, rel", gap, 1.0, share, of_actuator)
    yield from motion_rows(pair, first, second, cause)


def motion_rows(pair: tuple[str, str], first: Samples, second: Samples, cause: Blamed) -> Iterator[Check]:
    """Energies, and the free motion's inertia and force, of two systems with the same bodies."""
    states = first.states
    condition = max(first.condition, second.condition)
    share = round_off(condition, states.noise)
    for name in ("kinetic_energy", "potential_energy"):
        one, two = first.stack(name), second.stack(name)
        unit = max(states.energy, float(np.abs(one).max()))
        yield _row(pair, states, f"{name.replace('_', ' ')}, rel", np.abs(one - two), unit, share, cause)
    if not all(basis.shape[1] for basis in states.bases):
        return  # nothing can move
    inertia, other = ([mass for mass, _ in samples.free_motions] for samples in (first, second))
    force, push = ([force for _, force in samples.free_motions] for samples in (first, second))
    yield _row(pair, states, "effective inertia, rel", *_apart(inertia, other, 0.0), share, cause)
    looser = round_off(condition * states.mass_condition, states.noise)
    yield _row(pair, states, "effective force, rel", *_apart(force, push, states.energy), looser, cause)


def _row(
    pair: tuple[str, str],
    states: States,
    quantity: str,
    gap: Array,
    unit: float,
    tolerance: float,
    cause: Blamed,
) -> Check:
    """`gap` has a first axis of states; the cause is asked for where it fails."""
    worst = gap.reshape(len(states.all), -1).max(axis=1)
    value = float(worst.max()) / unit
    found = Cause(states.name(int(np.argmax(worst))))
    if not value <= tolerance:
        by_force = quantity not in ("kinetic energy, rel", "effective inertia, rel")
        found = cause(by_force) or found
    return Check("dynamics", quantity, pair, value, tolerance, found.where, detail=found.detail)


def _apart(one: list[Array], two: list[Array], floor: float) -> tuple[Array, float]:
    """The largest difference at each state (n,), and the largest of the first, `floor` at least.

    States with more freedoms than others have larger arrays.
    """
    gap = [float(np.max(np.abs(x - y))) for x, y in zip(one, two, strict=True)]
    return np.array(gap), max(floor, *(float(np.max(np.abs(x))) for x in one))


def _actuator_units(samples: Samples) -> Array:
    """(a,) what actuator forces are relative to: the largest force, at the mechanism's size for torques."""
    scene, scales = samples.states.scene, samples.scales
    units = []
    for law in scene.control:
        slides = scene.mechanism.is_slide(*law.key)
        units.append(scales.force * (1.0 if slides else scales.size))
    return np.maximum(units, np.abs(samples.stack("actuator_force")).max(axis=0))
