"""Principal moments and axes of inertia of two bodies, and mistakes that make one inertia out of another."""

from __future__ import annotations

from itertools import combinations, permutations, product

import numpy as np

from crosscheck.differences.stack import Judge, MassProperties, about_other_point, absolute
from newton_euler.scalars import Array

CLEAR_GAP = 0.02
"""Smallest gap of two principal moments, relative to the largest one, at which their axes are compared."""


def moments(inertia: Array) -> Array:
    """Return the principal moments (V, 3) of inertias (V, 3, 3), smallest first."""
    values: Array = np.linalg.eigvalsh(inertia)
    return values


def axes_angle(first: Array, second: Array, judge: Judge) -> tuple[float, float]:
    """Return the angle, rad, between the principal axes of two inertias, and its uncertainty.

    Axes of nearly equal moments are left out: any small change turns them.

    Args:
        first, second: (V, 3, 3) inertias of both robots.
        judge: compares numbers.
    """
    values, axes = np.linalg.eigh(first[0])
    clear = _clear_axes(values) & _clear_axes(np.linalg.eigvalsh(second[0]))
    if not clear.any():
        return 0.0, 0.0
    reference = axes[:, clear]

    def angles(inertia: Array) -> Array:
        """Return the largest angle (V,) of clear axes from those of the first robot."""
        own = np.linalg.eigh(inertia)[1][..., clear]
        cosines = np.abs((own * reference).sum(axis=-2))
        sines = np.linalg.norm(np.cross(own, reference, axis=-2), axis=-2)
        largest: Array = np.arctan2(sines, cosines).max(axis=-1)
        return largest

    return judge.compare(angles(first), angles(second), absolute)


def _clear_axes(values: Array) -> Array:
    """Return which of three sorted moments differ clearly from the two others."""
    gaps = np.diff(values) > CLEAR_GAP * values[-1]
    return np.array([gaps[0], gaps[0] and gaps[1], gaps[1]])


def inertia_cause(first: MassProperties, second: MassProperties, tolerance: float) -> str:
    """Return the mistake that makes the second inertia out of the first one, or the first out of the second.

    Args:
        first, second: mass properties of both robots in a common frame.
        tolerance: relative difference of matrices that counts as none.
    """
    for source, result, where in ((first, second, "second"), (second, first, "first")):
        target = result.inertia[0]
        for words, candidate in _mistakes(source):
            if np.linalg.norm(candidate - target) <= tolerance * np.linalg.norm(target):
                return f"in the {where} file, {words}"
    return ""


def _mistakes(properties: MassProperties) -> list[tuple[str, Array]]:
    """Return inertias (3, 3) that known mistakes make out of a right one, with words for each."""
    inertia = properties.inertia[0]
    values, axes = np.linalg.eigh(inertia)
    diagonal = np.diag(np.diag(inertia))
    shift = about_other_point(properties.mass[:1], properties.center[:1])[0]
    orders = [np.eye(3)[list(order)] for order in permutations(range(3))]
    found = [
        ("the products of inertia have the other sign", 2.0 * diagonal - inertia),
        ("the products of inertia are missing", diagonal),
        ("the inertia is about the origin of the link instead of the center of mass", inertia + shift),
    ]
    for one, other in combinations(range(3), 2):
        exchanged = inertia.copy()
        exchanged[[one, other], [one, other]] = exchanged[[other, one], [other, one]]
        letters = "xyz"[one], "xyz"[other]
        found.append((f"i{letters[0] * 2} and i{letters[1] * 2} are exchanged", exchanged))
        swapped = np.eye(3)
        swapped[[one, other]] = swapped[[other, one]]
        found.append((f"the axes {letters[0]} and {letters[1]} are exchanged", swapped @ inertia @ swapped.T))
    found += [("the rotation of the inertia is lost", order @ np.diag(values) @ order.T) for order in orders]
    for axis, letter in enumerate("xyz"):
        mirror = np.diag(np.where(np.arange(3) == axis, -1.0, 1.0))
        found.append((f"the inertia is mirrored along {letter}", mirror @ inertia @ mirror))
    # A rotation applied the other way: R^T J R with the axes R of R J R^T, in any order and with any signs
    for order, signs in product(orders, product((1.0, -1.0), repeat=3)):
        rotation = axes @ order.T @ np.diag(signs)
        found.append(
            (
                "the inertia is rotated the other way",
                rotation.T @ (order @ np.diag(values) @ order.T) @ rotation,
            )
        )
    return found
