"""Full revolutions of coupled angles at the start of a run.

The poses of two bodies determine the angle between them only up to full revolutions, but couplings (gears,
screws, polynomial couplings, prescribed motions) hold at some numbers of revolutions only. A key (joint,
number) names a joint coordinate: a slide displacement or a hinge angle.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from newton_euler.equations.couplings import Coupling
from newton_euler.model.joint import Key
from newton_euler.model.state import whole_revolutions

MAX_START_REVOLUTIONS = 1000
"""Largest number of revolutions that is tried for the slowest of several coupled angles at the start."""

MAX_ANGLE_ERROR = 1e-6
"""Largest difference, rad, between an angle that follows from couplings and the same angle in the poses.

A wrong number of revolutions rarely comes so close."""


def revolutions(
    couplings: Sequence[Coupling],
    x: Mapping[Key, float],
    angles: Collection[Key],
    time: float,
    known: Mapping[Key, float],
) -> dict[Key, float]:
    """Find the full revolutions of angles at which all couplings hold.

    Poses determine angles between -pi and pi only. Known angles, prescribed motions and slides determine the
    revolutions of other angles through couplings. Angles that are coupled only to each other, or that
    determine others by polynomials, get the fewest revolutions at which all coupled coordinates match the
    poses. The order of the couplings does not matter.

    Args:
        couplings: all couplings of the scene.
        x: joint coordinates in the poses of the bodies, by key, m or rad.
        angles: keys of the coordinates in `x` that are angles.
        time: s, at which prescribed motions are evaluated.
        known: angles with their full revolutions, rad, by key, as in `State.angles`.

    Returns:
        Multiple of 2 pi to add to each angle, rad, by key.
    """
    # `wanted`: coordinates with their full revolutions, m or rad; first known angles and prescribed motions
    wanted = {key: x[key] + whole_revolutions(known[key] - x[key]) for key in angles if key in known}
    for coupling in couplings:
        if coupling.function:
            (key,) = coupling.factors
            wanted.setdefault(key, float(coupling.function.value(time)))
    # coordinates that follow from these by couplings; then slides, and coordinates that follow from slides
    linked = sorted((c for c in couplings if c.function is None), key=lambda c: (c.what, c.name))
    _add_followers(linked, wanted)
    coupled = {key for coupling in couplings for key in coupling.factors}
    wanted |= {key: x[key] for key in coupled if key not in angles and key not in wanted}
    _add_followers(linked, wanted)
    # groups of angles that are coupled only to each other: search for the fewest revolutions. In one group
    # all angles have constant ratios to one of them
    while coupled - wanted.keys():
        ratios = {_first_to_turn(linked, wanted, coupled - wanted.keys()): 1.0}
        _add_followers([c for c in linked if not c.powers], ratios)
        wanted |= _fewest_revolutions(ratios, linked, wanted, x)
        _add_followers(linked, wanted)
    return {key: float(whole_revolutions(wanted[key] - x[key])) for key in angles if key in wanted}


def _add_followers(couplings: Sequence[Coupling], wanted: dict[Key, Any]) -> None:
    """Add the coordinates that follow from known coordinates by couplings.

    Args:
        couplings: couplings without a function of time.
        wanted: known coordinates, numbers or arrays, by key; the new ones are added.
    """
    # pass through the couplings until a pass adds no coordinate; a coordinate whose polynomial has a higher
    # degree is not added, because the equation may have several solutions
    count_before = -1
    while count_before < len(wanted):
        count_before = len(wanted)
        for coupling in couplings:
            missing = [key for key in coupling.factors if key not in wanted]
            if len(missing) == 1 and missing[0] not in coupling.powers:
                known = sum(coupling.term(key, wanted[key]) for key in coupling.factors if key in wanted)
                wanted[missing[0]] = -known / coupling.factors[missing[0]]  # all terms together are 0


def _first_to_turn(couplings: Sequence[Coupling], wanted: Mapping[Key, float], among: Collection[Key]) -> Key:
    """Choose the angle whose revolutions are searched first: the one that determines most other angles.

    Only angles with a polynomial of degree 2 or higher are compared, because other coordinates do not
    determine them. Without such angles, the first key in alphabetical order is chosen.

    Args:
        couplings: couplings without a function of time.
        wanted: known coordinates by key.
        among: keys of the angles to choose from.
    """
    nonlinear = [key for coupling in couplings for key in coupling.powers if key in among]
    if not nonlinear:
        return min(among)
    determined_counts = {}
    for key in nonlinear:
        determined = {**wanted, key: 0.0}
        _add_followers(couplings, determined)
        determined_counts[key] = len(determined)
    return min(nonlinear, key=lambda key: (-determined_counts[key], key))


def _fewest_revolutions(
    ratios: Mapping[Key, float],
    couplings: Sequence[Coupling],
    wanted: Mapping[Key, float],
    x: Mapping[Key, float],
) -> dict[Key, float]:
    """Find the smallest angles with given ratios that match the poses up to full revolutions.

    Coordinates that follow from the angles by couplings must match the poses, too. If no angles up to
    `MAX_START_REVOLUTIONS` match, the slowest angle (the one of the smallest ratio except 0) is between -pi
    and pi. If a known coordinate has a ratio except 0, this coordinate determines all angles.

    Args:
        ratios: ratio of each angle to a common angle, by key; 0 for a coordinate that the common angle does
            not move. Known coordinates may be among the keys.
        couplings: couplings without a function of time.
        wanted: known coordinates by key.
        x: joint coordinates in the poses of the bodies, by key, m or rad.

    Returns:
        The angles with their revolutions, rad, by key.
    """
    # candidates of the slowest angle in ascending magnitude, and the other angles for each of them
    turning = [key for key, ratio in ratios.items() if ratio]
    slowest = min(turning, key=lambda key: (abs(ratios[key]), key))
    count = np.arange(MAX_START_REVOLUTIONS + 1)
    count = np.stack([count, -count], axis=1).ravel()
    candidates = x[slowest] + 2.0 * np.pi * count
    candidates = candidates[np.argsort(np.abs(candidates), kind="stable")]
    if known_turning := sorted(wanted.keys() & turning):
        candidates = np.array([wanted[known_turning[0]] * (ratios[slowest] / ratios[known_turning[0]])])
    angles = {
        key: candidates * (ratio / ratios[slowest]) for key, ratio in ratios.items() if key not in wanted
    }
    known: dict[Key, Any] = {**wanted, **angles}
    nonlinear = [coupling for coupling in couplings if coupling.powers]
    if nonlinear:
        _add_followers(couplings, known)
    # the first candidate at which all angles differ from the poses by full revolutions. An angle is rejected
    # if it has so many revolutions that round-off exceeds the limit
    differences = [known[key] - x[key] for key in known.keys() - wanted.keys()]
    turns = np.array(differences) / (2.0 * np.pi)
    limit = MAX_ANGLE_ERROR / (2.0 * np.pi)
    agree = np.all((np.abs(turns - np.round(turns)) < limit) & (np.spacing(np.abs(turns)) < limit), axis=0)
    # polynomial couplings between known coordinates must hold, too
    for coupling in nonlinear:
        if coupling.factors.keys() <= known.keys():
            agree = agree & (np.abs(coupling.value(known)) < MAX_ANGLE_ERROR)
    best = int(np.argmax(agree))
    return {key: float(values[best]) for key, values in angles.items()}
