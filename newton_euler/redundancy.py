"""Which constraint rows say all that all of them say, found before a scene is compiled.

Redundant rows are so in every configuration; a row that is dependent in one configuration only is none.
So several configurations are looked at, the initial one and, if that is not enough, others near it.
Everything is sparse: scenes may have thousands of rows.
"""

from __future__ import annotations

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

if TYPE_CHECKING:
    from newton_euler.compiled import Formulation

CONFIGURATIONS = 4
"""How many configurations decide."""

REACH = 0.1
"""How far they lie apart: radians, and sizes of the mechanism."""

DOUBTFUL = 1e-7
"""Share of its Gram matrix' diagonal below which a pivot may be round-off, in rows of thousands."""

DEPENDENT = 1e-9
"""Length of what a dimensionless row adds to the others, below which it adds nothing."""

NEWTON_STEPS = 4
"""Enough for round-off from a tangential step of that length."""


def rows_in_use(system: Formulation) -> tuple[RowsInUse, bool]:
    """The rows of `system.phi_and_jacobian` that are independent and imply all others.

    Also whether any other row is not zero everywhere: then multipliers are not unique.
    """
    q, _ = system.coordinates(system.scene.initial_state)
    rng = np.random.default_rng(0)
    best: list[int] = []
    alive: set[int] = set()  # rows that are not zero everywhere
    seen = []
    for number in range(CONFIGURATIONS):
        seen.append(q)
        _, jacobian = system.phi_and_jacobian(q)
        alive.update(i for i, row in enumerate(jacobian) if row)
        best = max(best, _independent(_dimensionless(system, jacobian)), key=len)
        if number > 0 and len(best) == len(alive):
            break  # all that can be
        q = _neighbour(system, q, rng)
    rest = np.zeros(system.nv)
    solutions = [system.sparse_solution(q, rest, RowsInUse(best)) for q in seen]
    scales, mass_scales = (
        [float(max(column)) for column in zip(*diagonals, strict=True)]
        for diagonals in (
            [solution.diagonal for solution in solutions],
            [solution.mass_diagonal for solution in solutions],
        )
    )
    return RowsInUse(best, scales, mass_scales), len(best) < len(alive)


def _dimensionless(system: Formulation, jacobian: Rows) -> Rows:
    units = system.velocity_units
    return [
        {k: x * units[k] / unit for k, x in row.items()}
        for row, unit in zip(jacobian, system.phi_units, strict=True)
    ]


def _independent(rows: Rows) -> list[int]:
    """Numbers of rows that imply all others.

    Pivots of the Gram matrix are squares of what a row adds to those before it, so that they tell
    little adds from none only roughly. What they leave in doubt, the row's remainder decides.
    """
    products = gram(rows, rows)
    factor = factorise(products, pattern_order(products), drop=DOUBTFUL)
    kept = set(factor.order)
    doubtful = [i for i, row in enumerate(rows) if row and i not in kept]
    # a random combination of rows adds nothing only if none of them does: one look for all of them
    weights = np.random.default_rng(1).uniform(1.0, 2.0, len(doubtful))
    together: dict[int, float] = {}
    for i, weight in zip(doubtful, weights, strict=True):
        for k, x in rows[i].items():
            add(together, k, weight * x)
    if _remainder(rows, factor, together) > DEPENDENT:
        kept.update(i for i in doubtful if _remainder(rows, factor, rows[i]) > DEPENDENT)
    return sorted(kept)


def _remainder(rows: Rows, factor: Factor, row: dict[int, float]) -> float:
    """Length of what a row adds to the rows of a factor; solved twice, for the digits lost by squaring."""
    left = dict(row)
    for _ in range(2):
        right = {j: dot(rows[j], left) for j in factor.order}
        for j, share in factor.solve({j: x for j, x in right.items() if x != 0.0}).items():
            for k, x in rows[j].items() if share != 0.0 else ():
                left[k] = left.get(k, 0.0) - share * x
    return float(np.sqrt(sum(x * x for x in left.values())))


def _neighbour(system: Formulation, q: Array, rng: np.random.Generator) -> Array:
    """Another configuration that meets the constraints, some way off in a random direction."""
    phi, jacobian = system.phi_and_jacobian(q)
    step = REACH * system.velocity_units * rng.uniform(-1.0, 1.0, system.nv)
    rate = np.array([sum(x * step[k] for k, x in row.items()) for row in jacobian])
    q = system.retract(q, step - _least(system, jacobian, rate))
    for _ in range(NEWTON_STEPS):
        phi, jacobian = system.phi_and_jacobian(q)
        q = system.retract(q, -_least(system, jacobian, phi))
    return q


def _least(system: Formulation, jacobian: Rows, right: Array) -> Array:
    """The shortest dimensionless step (nv,) with J step = right, dependent rows left out."""
    rows = _dimensionless(system, jacobian)
    products = gram(rows, rows)
    factor = factorise(products, pattern_order(products), drop=DOUBTFUL)
    weights = factor.solve(sparse_vector(right / system.phi_units))
    step = np.zeros(system.nv)
    for i in factor.order:
        for k, x in rows[i].items():
            step[k] += x * weights.get(i, 0.0) * system.velocity_units[k]
    return step
