"""Comparison of two robots' motions: accelerations at common random states, whatever the constraints are.

In: the `CommonStates` of two robots. Out: a `Motion`. The states fulfill the constraints of the first robot;
what the constraints of the second robot are off there tells whether both allow the same poses. The digits of
the files bound what can be told: the variants of both files show how much the last digits change the
accelerations.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from crosscheck.differences.common_states import (
    DIGITS_FACTOR,
    ROUND_OFF,
    STATES,
    CommonStates,
    Gap,
    Phase,
)
from newton_euler.scalars import Array

SLOW_BODY = 1e-3
"""Acceleration of a body, relative to the fastest one, below which differences count less."""

NO_ACCELERATION = 1e-6
"""m/s^2, acceleration of a balanced robot, such as a wheel, by round-off."""


class Likeness(StrEnum):
    """Result of a comparison of motions."""

    EQUAL = "equal to round-off"
    """The robots move alike."""
    ROUNDING = "equal within the digits of the files"
    """The digits of the files explain all differences."""
    DIFFERENT = "different"
    """The robots move differently."""
    UNDECIDED = "not compared"
    """The robots have no joints in common, or the loops of the first one cannot be closed."""


@dataclass(frozen=True)
class BodyChange:
    """Difference of the accelerations of a pair of bodies, relative to their size.

    Attributes:
        body: name in the first file.
        change: of the linear or angular acceleration, whichever is more, in the phase of the largest change.
        uncertainty: of the change, by the digits of both files.
        phase: with the largest change.
    """

    body: str
    change: float
    uncertainty: float
    phase: Phase


@dataclass(frozen=True)
class Motion:
    """Result of a comparison of two robots at twelve random states near the pose of the first file.

    Attributes:
        likeness: the result.
        change: largest relative difference of accelerations of a body: root mean square over the four states
            of a phase, divided by that of the acceleration. Other states can differ more.
        uncertainty: part of `change` that the digits of both files can cause.
        body: name, in the first file, of the body with the largest change in excess of its uncertainty.
        phase: in which that body changes most.
        bodies: changes of all pairs of bodies.
        gaps: constraints of the second robot that the poses of the first robot do not fulfill.
        freedoms: number of independent motions of the first and the second robot.
        notes: what was left out or held to compare, one sentence each.
    """

    likeness: Likeness
    change: float = 0.0
    uncertainty: float = 0.0
    body: str = ""
    phase: Phase = Phase.REST
    bodies: tuple[BodyChange, ...] = ()
    gaps: tuple[Gap, ...] = ()
    freedoms: tuple[int, int] = (0, 0)
    notes: tuple[str, ...] = ()


def compare_motions(states: CommonStates | None) -> Motion:
    """Compare the accelerations of two robots at common random states.

    Args:
        states: result of `common_states`.
    """
    if states is None:
        return Motion(Likeness.UNDECIDED, notes=("The robots have no joints in common.",))
    if not states.is_closed:
        return Motion(Likeness.UNDECIDED, notes=(*states.notes, "The first robot's loops cannot be closed."))
    one = states.of_first([states.one.robot, *states.variants[0]])
    two = states.of_second([states.two.robot, *states.variants[1]])
    changes = relative_changes(one[:1], two[:1])[0]
    uncertainties = np.zeros(changes.shape)
    for each in (one, two):
        if len(each) > 1:
            uncertainties += DIGITS_FACTOR * relative_changes(each[:1], each[1:]).max(axis=0)
    bodies = []
    for k, pair in enumerate(states.pairs):
        worst = _worst(changes[:, k], uncertainties[:, k])
        name = states.files[0].robot.bodies[pair.first[0]].name
        bodies.append(
            BodyChange(name, float(changes[worst, k]), float(uncertainties[worst, k]), list(Phase)[worst])
        )
    gaps = states.gaps(*states.variants)
    freedoms = states.freedoms()
    body = bodies[
        _worst(np.array([each.change for each in bodies]), np.array([each.uncertainty for each in bodies]))
    ]
    sizes = [(each.change, each.uncertainty) for each in bodies]
    sizes += [(gap.error, gap.uncertainty) for gap in gaps]
    if freedoms[0] != freedoms[1] or any(size > max(digits, ROUND_OFF) for size, digits in sizes):
        likeness = Likeness.DIFFERENT
    elif any(size > ROUND_OFF for size, _ in sizes):
        likeness = Likeness.ROUNDING
    else:
        likeness = Likeness.EQUAL
    return Motion(
        likeness,
        body.change,
        body.uncertainty,
        body.body,
        body.phase,
        tuple(bodies),
        gaps,
        freedoms,
        states.notes,
    )


def _worst(changes: Array, uncertainties: Array) -> int:
    """Return the index of the largest change among those beyond round-off and uncertainty, or else of all."""
    beyond = changes > np.maximum(uncertainties, ROUND_OFF)
    return int(np.argmax(np.where(beyond, changes, 0.0) if beyond.any() else changes))


def relative_changes(one: Array, others: Array) -> Array:
    """Return the differences of accelerations relative to their size.

    Args:
        one: (1, states, pairs, 6) accelerations of a robot, from `CommonStates`.
        others: (robots, states, pairs, 6) of others.

    Returns:
        (robots, phases, pairs) root mean square of the difference over the states of a phase, by the larger
        root mean square of both. Bodies that barely accelerate count as if they accelerated by a thousandth
        of the robot's fastest body, and at least by `NO_ACCELERATION`.
    """

    def by_phase(values: Array) -> Array:
        """Return (robots, phases, pairs) root mean squares."""
        split = values.reshape(len(values), len(Phase), STATES, *values.shape[2:])
        return np.sqrt(np.mean(np.sum(split**2, axis=-1), axis=2))

    size = np.maximum(by_phase(one), by_phase(others))
    fastest = by_phase(one).max(axis=-1, keepdims=True)
    floor = np.maximum(SLOW_BODY * fastest, SLOW_BODY**2 * fastest.max(axis=1, keepdims=True))
    return np.asarray(by_phase(others - one) / np.maximum(np.maximum(size, floor), NO_ACCELERATION))
