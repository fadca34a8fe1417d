"""Which constraint rows say all that all of them say, found before a scene is compiled.

Redundant rows are so in every configuration; a row that is dependent in one configuration only is none.
So several configurations are looked at, the initial one and, if that is not enough, others.
Everything is sparse: scenes may have thousands of rows.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from newton_euler.scalars import Array
from newton_euler.sparse import (
    Factor,
    Rows,
    RowsInUse,
    add,
    dot,
    factorise,
    gram,
    pattern_order,
    sparse_vector,
)
from newton_euler.state import State

if TYPE_CHECKING:
    from newton_euler.compiled import Formulation

CONFIGURATIONS = 4
"""How many configurations decide."""

REACH = 0.1
"""How far they lie apart: radians, and sizes of the mechanism."""

EMPTY = 1e-12
"""Length of a dimensionless row below which it is round-off."""

CERTAIN = 1e-4
"""Share of its diagonal element in the Gram matrix above which a pivot is no round-off; a pivot is the
square of what its row adds to those before it, so that smaller ones leave doubt."""

DEPENDENT = 1e-7
"""Share of a row that it must add to the others at least; round-off is below that if all rows in use
are certain, and a row that adds less is near singular anyway."""

NEWTON_STEPS = 30
"""From a singular configuration Newton's steps converge slowly."""

CLOSED = 1e-11
"""Residual, dimensionless, of a configuration that is near enough to the constraints to be looked at."""


def rows_in_use(system: Formulation) -> tuple[RowsInUse, list[int]]:
    """The rows of `system.phi_and_jacobian` that are independent and imply all others.

    Also which of the others are not zero everywhere: then multipliers are not unique.
    """
    q, v = system.coordinates(system.scene.initial_state)
    own, _ = system.coordinates(State.initial(system.scene.mechanism))
    directions = _directions(system, v)
    best: list[int] = []
    alive: set[int] = set()  # rows that are not zero everywhere
    seen: list[tuple[Array, Rows, list[int]]] = []
    for number in range(CONFIGURATIONS):
        phi, jacobian = system.phi_and_jacobian(q)
        if number == 0 or np.max(np.abs(phi / system.phi_units), initial=0.0) < CLOSED:
            rows = _dimensionless(system, jacobian)
            alive.update(i for i, row in enumerate(rows) if _length(row) > EMPTY)
            found = sorted(_independent(rows).order)
            seen.append((q, rows, found))
            best = max(best, found, key=len)
        if number > 0 and len(best) == len(alive):
            break  # all that can be
        if number == 0 and not np.array_equal(own, q):
            q = own
        else:
            regular, _, _ = max(seen, key=lambda each: len(each[2]))
            q = _neighbour(system, regular, next(directions))
    rest = np.zeros(system.nv)
    solutions = [
        system.sparse_solution(q, rest, RowsInUse(best))
        for q, rows, found in seen
        # where the rows in use depend on each other, as on the flat four-bar, pivots are zero or round-off
        if found == best or len(_independent([rows[i] for i in best]).order) == len(best)
    ]
    scales, mass_scales = (
        [float(max(column)) for column in zip(*pivots, strict=True)]
        for pivots in (
            [solution.pivots for solution in solutions],
            [solution.mass_pivots for solution in solutions],
        )
    )
    return RowsInUse(best, scales, mass_scales), sorted(alive - set(best))


def _dimensionless(system: Formulation, jacobian: Rows) -> Rows:
    units = system.velocity_units
    return [
        {k: x * units[k] / unit for k, x in row.items()}
        for row, unit in zip(jacobian, system.phi_units, strict=True)
    ]


def _length(row: dict[int, float]) -> float:
    return float(np.sqrt(sum(x * x for x in row.values())))


def _independent(rows: Rows) -> Factor:
    """Factor of the Gram matrix of rows that imply all others; `Factor.order` are these rows."""
    rows = [row if _length(row) > EMPTY else {} for row in rows]
    products = gram(rows, rows)
    order = [i for i in pattern_order(products) if rows[i]]
    factor = factorise(products, order, drop=CERTAIN)
    doubtful = [i for i in order if i not in set(factor.order)]
    # a random combination of rows adds nothing only if none of them does: one look for all of them
    weights = np.random.default_rng(1).uniform(1.0, 2.0, len(doubtful))
    together: dict[int, float] = {}
    for i, weight in zip(doubtful, weights, strict=True):
        for k, x in rows[i].items():
            add(together, k, weight * x)
    while doubtful and _remainder(rows, factor, together) > DEPENDENT:
        shares = [_remainder(rows, factor, rows[i]) for i in doubtful]
        if max(shares) <= DEPENDENT:
            break
        found = doubtful.pop(int(np.argmax(shares)))
        factor = factorise(products, [*factor.order, found])
    return factor


def _remainder(rows: Rows, factor: Factor, row: dict[int, float]) -> float:
    """Share of a row that is new to those of a factor; solved twice, for the digits lost by squaring."""
    left = dict(row)
    for _ in range(2):
        right = {j: dot(rows[j], left) for j in factor.order}
        for j, share in factor.solve({j: x for j, x in right.items() if x != 0.0}).items():
            for k, x in rows[j].items() if share != 0.0 else ():
                left[k] = left.get(k, 0.0) - share * x
    return _length(left) / _length(row)


def _directions(system: Formulation, v: Array) -> Iterator[Array]:
    """Where to look for other configurations: where velocities go, then anywhere.

    From a singular configuration random steps lead off all of its branches, and what they come back to is too
    near to it to tell; a velocity is that of a branch.
    """
    speed = np.max(np.abs(v / system.velocity_units), initial=0.0)
    if speed > 0.0:
        yield v / speed
    rng = np.random.default_rng(0)
    while True:
        yield system.velocity_units * rng.uniform(-1.0, 1.0, system.nv)


def _neighbour(system: Formulation, q: Array, direction: Array) -> Array:
    """Another configuration that meets the constraints, some way off in a direction."""
    phi, jacobian = system.phi_and_jacobian(q)
    step = REACH * direction
    rate = np.array([sum(x * step[k] for k, x in row.items()) for row in jacobian])
    q = system.retract(q, step - _least(system, jacobian, rate))
    for _ in range(NEWTON_STEPS):
        phi, jacobian = system.phi_and_jacobian(q)
        if np.max(np.abs(phi / system.phi_units), initial=0.0) < 0.01 * CLOSED:
            break
        q = system.retract(q, -_least(system, jacobian, phi))
    return q


def _least(system: Formulation, jacobian: Rows, right: Array) -> Array:
    """The shortest dimensionless step (nv,) with J step = right, dependent rows left out."""
    rows = _dimensionless(system, jacobian)
    factor = _independent(rows)
    scaled = sparse_vector(right / system.phi_units)
    weights = factor.solve({i: x for i, x in scaled.items() if i in set(factor.order)})
    step = np.zeros(system.nv)
    for i in factor.order:
        for k, x in rows[i].items():
            step[k] += x * weights.get(i, 0.0) * system.velocity_units[k]
    return step
