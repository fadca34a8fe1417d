"""Projection next to a singular configuration, by a dense form that tells weak constraints from strong ones.

Corrections are M^-1 J^T times multipliers, the direction in which wrong multipliers lead a run astray: what
they did is undone, whatever it was, as far as constraints are strong enough. With L the Cholesky factor of
the metric, the columns of L^-1 J^T become orthonormal ones, the longest that is left first (modified
Gram-Schmidt with column pivoting: G. H. Golub, C. F. Van Loan, Matrix Computations, fourth edition, Johns
Hopkins 2013, sections 5.2.8 and 5.4.2). What is left of weak constraints is short, and is left out.

Written for native code, see `newton_euler.codegen.native`; it runs as plain Python as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import prod, sqrt
from typing import Any

import numpy as np

from newton_euler.codegen.native import Callback, Record, Shared, Vector, native
from newton_euler.model.mechanism import CLOSURE_TOLERANCE
from newton_euler.scalars import Array

MAX_DENSE_ITERATIONS = 20
"""Newton's steps at most, of which each makes residuals half as large or is the last."""

RESIDUAL_ROUND_OFF = 16.0 * np.finfo(float).eps
"""Residuals below this share of the mechanism's size are what evaluating them loses."""

REUSE_JACOBIAN_BELOW = 1e-12
"""Dimensionless residual that a Newton step of 1e-6 leaves. The next one may do with the same Jacobian: it
leaves 1e-6 / `WEAK_CONSTRAINT_LENGTH` of the residual at most."""

WEAK_CONSTRAINT_LENGTH = 3e-5
"""Dimensionless length, as a share of the longest, below which a column of what constraints measure says too
little to correct a state by it: the correction of a velocity would have the round-off of its residual divided
by the square."""


@dataclass(frozen=True, eq=False)
class Closing(Record):
    """The constraints and the mass matrix of a scene, all dimensionless, and scratch to close it.

    Attributes:
        nq, nv: lengths of q and v.
        inputs: length of a state with time and parameters.
        constraints: k, their number; negative before `prepare` has been called.
        on_jacobian, on_mass: numbers of nonzeros.
        prepare: fills in this record.
        retract: q (nq,) moved by the step (nv,) that x (inputs,) has in place of velocities, SI.
        evaluate: Phi (k,), dPhi/dt (k,), nonzeros of Phi_q (k, nv) and of M (nv, nv) at x (inputs,).
        places: of these nonzeros in the whole matrices, row by row.
        units: (nv,) of v, SI.
        at, moved, found: (inputs,), (nq,) and what `evaluate` writes: where it is, and scratch.
        rows, lower: (k, nv) and (nv, nv) Phi_q and the factor of the metric.
        basis, shares: (r, nv) orthonormal vectors that span what strong constraints measure, r = min(k, nv),
            longest first, and (r, k) the share that constraints have in each.
        chosen, inverse: (r,) which constraint each vector was made of, and its inverse length, 0 for what is
            weak.
        lengths, rest, step: (k,), (k,) and (nv,) scratch.
    """

    nq: int
    nv: int
    inputs: int
    constraints: int
    on_jacobian: int
    on_mass: int
    prepare: Callback
    retract: Callback
    evaluate: Callback
    places: Shared
    units: Shared
    at: Vector
    moved: Vector
    found: Vector
    rows: Vector
    lower: Vector
    basis: Vector
    shares: Vector
    chosen: Vector
    inverse: Vector
    lengths: Vector
    rest: Vector
    step: Vector


def unprepared(prepare: Callback, nq: int, nv: int) -> Closing:
    """Return a record that native code has filled in when it is first needed; as it is, nothing closes."""
    nothing = [np.zeros(0)] * 14
    return Closing(nq, nv, 0, -1, 0, 0, prepare, None, None, *nothing)


def closing_of(
    nq: int,
    units: Array,
    inputs: int,
    places: tuple[list[int], list[int]],
    constraints: int,
    functions: tuple[Any, Any],
    lanes: int = 1,
) -> Closing:
    """Return a record with scratch for a state in each lane.

    Args:
        units: (nv,) of v.
        places: of nonzeros of Phi_q and M in the whole matrices.
        functions: retract and evaluate.
    """
    nv = len(units)
    rank = min(constraints, nv)

    def scratch(*shape: int) -> Array:
        return np.zeros(prod(shape) * lanes)

    return Closing(
        nq=nq,
        nv=nv,
        inputs=inputs,
        constraints=constraints,
        on_jacobian=len(places[0]),
        on_mass=len(places[1]),
        prepare=None,
        retract=functions[0],
        evaluate=functions[1],
        places=np.array([*places[0], *places[1]], dtype=float),
        units=np.array(units, dtype=float),
        at=scratch(inputs),
        moved=scratch(nq),
        found=scratch(2 * constraints + sum(map(len, places))),
        rows=scratch(constraints, nv),
        lower=scratch(nv, nv),
        basis=scratch(rank, nv),
        shares=scratch(rank, constraints),
        chosen=scratch(rank),
        inverse=scratch(rank),
        lengths=scratch(constraints),
        rest=scratch(constraints),
        step=scratch(nv),
    )


@native
def factor_metric(closing: Closing) -> int:
    """Put Phi_q into its rows and factor the metric of corrections; 1 if it is definite.

    It is the mass matrix, of largest diagonal element 1, and, as what the constraints measure costs nothing
    on them, J^T J: that makes Euler parameters definite.
    """
    nv = closing.nv
    k = closing.constraints
    places = closing.places
    rows = closing.rows
    lower = closing.lower
    nonzeros = closing.found[2 * k :]
    # scatter the nonzeros into the full matrices Phi_q and M
    for i in range(k * nv):
        rows[i] = 0.0
    for i in range(closing.on_jacobian):
        rows[int(places[i])] = nonzeros[i]
    for i in range(nv * nv):
        lower[i] = 0.0
    for i in range(closing.on_mass):
        lower[int(places[closing.on_jacobian + i])] = nonzeros[closing.on_jacobian + i]
    # metric: M, scaled to the largest diagonal element 1, plus J^T J
    largest = 0.0
    for i in range(nv):
        largest = max(largest, lower[nv * i + i])
    for i in range(nv):
        for j in range(i + 1):
            lower[nv * i + j] = lower[nv * i + j] / largest
    for row in range(k):
        for i in range(nv):
            for j in range(i + 1):
                lower[nv * i + j] += rows[nv * row + i] * rows[nv * row + j]
    # Cholesky factor L, column by column
    definite = 1
    for j in range(nv):
        for i in range(j, nv):
            rest = lower[nv * i + j]
            for m in range(j):
                rest -= lower[nv * i + m] * lower[nv * j + m]
            lower[nv * i + j] = rest
        scale = 0.0
        if lower[nv * j + j] > 0.0:
            scale = 1.0 / sqrt(lower[nv * j + j])
        else:
            definite = 0
        for i in range(j, nv):
            lower[nv * i + j] = scale * lower[nv * i + j]
    return definite


@native
def orthogonalize(closing: Closing) -> None:
    """Find the orthonormal vectors that span what strong constraints measure; changes their rows."""
    nv = closing.nv
    k = closing.constraints
    rows = closing.rows
    lower = closing.lower
    basis = closing.basis
    lengths = closing.lengths
    # solve L Y = J^T: rows become the columns of L^-1 J^T, with squared lengths
    for row in range(k):
        square = 0.0
        for i in range(nv):
            rest = rows[nv * row + i]
            for j in range(i):
                rest -= lower[nv * i + j] * rows[nv * row + j]
            rest = rest / lower[nv * i + i]
            rows[nv * row + i] = rest
            square += rest * rest
        lengths[row] = square
    # modified Gram-Schmidt with pivoting: take the longest column that is left
    longest = 0.0
    for r in range(k if k < nv else nv):
        place = 0
        most = 0.0
        for row in range(k):
            if lengths[row] > most:
                most = lengths[row]
                place = row
        longest = max(longest, most)
        scale = 1.0 / sqrt(most) if most > WEAK_CONSTRAINT_LENGTH * WEAK_CONSTRAINT_LENGTH * longest else 0.0
        # normalize the column; a weak one becomes zero, so that it corrects nothing
        closing.chosen[r] = float(place)
        closing.inverse[r] = scale
        for i in range(nv):
            basis[nv * r + i] = scale * rows[nv * place + i]
        # subtract its component from all columns
        for row in range(k):
            share = 0.0
            for i in range(nv):
                share += basis[nv * r + i] * rows[nv * row + i]
            closing.shares[k * r + row] = share
            square = 0.0
            for i in range(nv):
                rest = rows[nv * row + i] - share * basis[nv * r + i]
                rows[nv * row + i] = rest
                square += rest * rest
            lengths[row] = square


@native
def correct(closing: Closing, residuals: Vector) -> None:
    """Find the step, SI, that undoes residuals (k,) of strong constraints."""
    nv = closing.nv
    k = closing.constraints
    lower = closing.lower
    rest = closing.rest
    step = closing.step
    for row in range(k):
        rest[row] = residuals[row]
    for i in range(nv):
        step[i] = 0.0
    # forward substitution along the orthonormal vectors
    for r in range(k if k < nv else nv):
        length = rest[int(closing.chosen[r])] * closing.inverse[r]
        for row in range(k):
            rest[row] -= length * closing.shares[k * r + row]
        for i in range(nv):
            step[i] += length * closing.basis[nv * r + i]
    # back substitution: L^T step = what was found
    for m in range(nv):
        i = nv - 1 - m
        left = step[i]
        for j in range(i + 1, nv):
            left -= lower[nv * j + i] * step[j]
        step[i] = left / lower[nv * i + i]
    # from dimensionless numbers to SI
    for i in range(nv):
        step[i] = closing.units[i] * step[i]


@native
def squared(count: int, residuals: Vector) -> float:
    """Square a vector of residuals."""
    square = 0.0
    for i in range(count):
        square += residuals[i] * residuals[i]
    return square


@native
def close_by(closing: Closing, x: Vector, y: Vector) -> None:
    """Write into y (nq + nv + 1,) the state on the constraints near that of x (inputs,), and 1.0, or -1.0 if
    it was not found."""
    nq = closing.nq
    nv = closing.nv
    k = closing.constraints
    at = closing.at
    moved = closing.moved
    found = closing.found
    step = closing.step
    y[nq + nv] = -1.0
    if k < 0:
        return
    # start at the given state, with quaternions of norm 1
    for i in range(closing.inputs):
        at[i] = x[i]
    for i in range(nv):
        at[nq + i] = 0.0
        y[nq + i] = x[nq + i]
    closing.retract(at, y)
    for i in range(nq + nv):
        at[i] = y[i]
    closing.evaluate(at, found)
    left = squared(k, found)
    # positions: Newton's iteration, with a new Jacobian while the residual is large
    for number in range(MAX_DENSE_ITERATIONS):
        if number == 0 or left > REUSE_JACOBIAN_BELOW * REUSE_JACOBIAN_BELOW:
            if factor_metric(closing) == 0:
                return
            orthogonalize(closing)
        correct(closing, found)
        for i in range(nq):
            at[i] = y[i]
        for i in range(nv):
            at[nq + i] = -step[i]
        closing.retract(at, moved)
        for i in range(nq):
            at[i] = moved[i]
        for i in range(nv):
            at[nq + i] = x[nq + i]
        # accept the step if it reduces the residual by half at least, else stop
        before = left
        closing.evaluate(at, found)
        left = squared(k, found)
        if not left < 0.25 * before:
            left = before
            break
        for i in range(nq):
            y[i] = at[i]
        if left < RESIDUAL_ROUND_OFF * RESIDUAL_ROUND_OFF:
            break
    # fail if the loops stay open
    if not left <= CLOSURE_TOLERANCE * CLOSURE_TOLERANCE:
        return
    # velocities: two corrections, the second one for the digits
    for _time in range(2):
        for i in range(nq + nv):
            at[i] = y[i]
        closing.evaluate(at, found)
        correct(closing, found[k:])
        for i in range(nv):
            y[nq + i] -= step[i]
    y[nq + nv] = 1.0


@native
def close(closing: Closing, x: Vector, y: Vector) -> None:
    """Close a state as `close_by` does, after filling in the record if nothing has yet."""
    if closing.constraints < 0:
        closing.prepare(x, y)
    close_by(closing, x, y)
