"""Projection of a state onto the constraints near a singular configuration, where constraints become
dependent.

The projection moves the state along M^-1 J^T, with the mass matrix M and the constraint Jacobian J. Errors of
constraint forces move a state along the same directions, so the projection undoes them. With the Cholesky
factor L of the metric M + J^T J, the columns of L^-1 J^T are orthonormalized by the modified Gram-Schmidt
method with column pivoting (G. H. Golub, C. F. Van Loan, Matrix Computations, fourth edition, Johns Hopkins
2013, sections 5.2.8 and 5.4.2). A constraint whose remaining column is short depends almost completely on the
others. Such a constraint is called *weak* and corrects nothing.

`close` projects one state. `newton_euler.integrators.projection` calls it if its faster sparse form fails. A
*state with time and parameters* is one vector (inputs,): coordinates q and velocities v, the time, flags of
constraint rows (1 if a redundant row is left out, else 0), and parameters of the scene.

Functions marked `native` are compiled to machine code by `newton_euler.codegen`; they also run as plain
Python.
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
"""Largest number of Newton steps. A step that does not at least halve the residual is undone and is the last
one."""

RESIDUAL_ROUND_OFF = 16.0 * np.finfo(float).eps
"""Constraint residual, as a fraction of the mechanism's size, below which it is only round-off."""

REUSE_JACOBIAN_BELOW = 1e-12
"""Dimensionless residual below which the next Newton step uses the same Jacobian again.

A Newton step of size 1e-6 leaves such a residual. A further step with the old Jacobian reduces it at
least by the factor 1e-6 / `WEAK_CONSTRAINT_LENGTH`."""

WEAK_CONSTRAINT_LENGTH = 3e-5
"""Length of a remaining column of L^-1 J^T, as a fraction of the longest one, below which its constraint is
weak and corrects nothing. A correction would divide the round-off of the residual by the square of this
length."""


@dataclass(frozen=True, eq=False)
class Closing(Record):
    """Dimensionless constraints and mass matrix of a scene, and working memory for the projection.

    Phi are the constraint residuals, Phi_q is their Jacobian (called J above), M is the mass matrix. Compiled
    code can make several runs at once, one in each lane of the processor's vector registers. All lanes use
    the same `Shared` vectors; a `Vector` has separate elements for each lane.

    Attributes:
        nq, nv: lengths of the coordinates q and of the velocities v.
        inputs: length of a state with time and parameters.
        constraints: number k of constraints; negative before `prepare` has filled in this record.
        jacobian_nonzeros, mass_nonzeros: numbers of nonzeros of Phi_q and of M.
        prepare: compiles the functions and fills in this record when a run first needs them. It ignores its
            arguments, which every callback has.
        retract: writes q (nq,) moved by a step (nv,), SI. Its argument is a state with time and parameters
            that has the step in place of the velocities.
        evaluate: writes Phi (k,), dPhi/dt (k,), the nonzeros of Phi_q (k, nv) and of M (nv, nv) at a state.
        places: indices of the nonzeros of Phi_q in the full matrix, row by row, then of those of M.
        units: (nv,) natural magnitudes of v, SI: divisors that make v dimensionless but for time.
        at: (inputs,) present state of the iteration.
        moved: (nq,) scratch for `retract`.
        results: results of `evaluate`.
        rows: (k, nv) Phi_q, later the columns of L^-1 Phi_q^T.
        lower: (nv, nv) metric, later its Cholesky factor L.
        basis: (r, nv) orthonormal vectors, r = min(k, nv), in the order in which they were chosen.
        shares: (r, k) component along each orthonormal vector of each constraint's column of L^-1 Phi_q^T.
        chosen: (r,) number of the constraint from whose column each vector was made.
        inverse: (r,) inverse length of this remaining column; 0 for a weak constraint.
        lengths: (k,) squared lengths of the remaining columns, after subtraction of their components along
            the chosen vectors.
        rest: (k,) residuals that the vectors so far have not corrected.
        step: (nv,) correction of the state, SI.
    """

    nq: int
    nv: int
    inputs: int
    constraints: int
    jacobian_nonzeros: int
    mass_nonzeros: int
    prepare: Callback
    retract: Callback
    evaluate: Callback
    places: Shared
    units: Shared
    at: Vector
    moved: Vector
    results: Vector
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
    """Return an empty record, which `prepare` fills in when a run first needs it.

    Until then, `close_by` reports that it finds no state on the constraints.
    """
    empty_vectors = [np.zeros(0)] * 14  # `places` to `step`
    return Closing(
        nq,
        nv,
        0,  # inputs
        -1,  # constraints: the record is not prepared
        0,  # nonzeros of Phi_q and of M
        0,
        prepare,
        None,  # retract and evaluate
        None,
        *empty_vectors,
    )


def closing_of(
    nq: int,
    units: Array,
    inputs: int,
    places: tuple[list[int], list[int]],
    constraints: int,
    functions: tuple[Any, Any],
    lanes: int = 1,
) -> Closing:
    """Return a record with working memory for one state in each lane (see `Closing`).

    Args:
        nq: length of q.
        units: (nv,) natural magnitudes of v, SI.
        inputs: length of a state with time and parameters.
        places: indices of the nonzeros of Phi_q and of M in the full matrices, row by row.
        constraints: number of constraints.
        functions: `Closing.retract` and `Closing.evaluate`.
        lanes: number of lanes; 1 for one run at a time.
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
        jacobian_nonzeros=len(places[0]),
        mass_nonzeros=len(places[1]),
        prepare=None,
        retract=functions[0],
        evaluate=functions[1],
        places=np.array([*places[0], *places[1]], dtype=float),
        units=np.array(units, dtype=float),
        at=scratch(inputs),
        moved=scratch(nq),
        results=scratch(2 * constraints + sum(map(len, places))),
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
    """Fill in the full Jacobian and factor the metric M + J^T J; return 1 if the metric is definite, else 0.

    M is scaled so that its largest diagonal element is 1. The term J^T J does not change the projection and
    makes the metric definite for Euler parameters, whose mass matrix is singular.
    """
    nv = closing.nv
    k = closing.constraints
    places = closing.places
    rows = closing.rows
    lower = closing.lower
    nonzeros = closing.results[2 * k :]
    # scatter the nonzeros into the full matrices Phi_q and M
    for i in range(k * nv):
        rows[i] = 0.0
    for i in range(closing.jacobian_nonzeros):
        rows[int(places[i])] = nonzeros[i]
    for i in range(nv * nv):
        lower[i] = 0.0
    for i in range(closing.mass_nonzeros):
        lower[int(places[closing.jacobian_nonzeros + i])] = nonzeros[closing.jacobian_nonzeros + i]
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
    """Orthonormalize the columns of L^-1 J^T, longest first; write `basis`, `shares`, `chosen` and `inverse`.

    `rows` are overwritten.
    """
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
        chosen_row = 0
        squared_length = 0.0
        for row in range(k):
            if lengths[row] > squared_length:
                squared_length = lengths[row]
                chosen_row = row
        longest = max(longest, squared_length)
        scale = (
            1.0 / sqrt(squared_length)
            if squared_length > WEAK_CONSTRAINT_LENGTH * WEAK_CONSTRAINT_LENGTH * longest
            else 0.0
        )
        # normalize the column; a weak one becomes zero, so that it corrects nothing
        closing.chosen[r] = float(chosen_row)
        closing.inverse[r] = scale
        for i in range(nv):
            basis[nv * r + i] = scale * rows[nv * chosen_row + i]
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
    """Compute `closing.step`; subtracting it from v or q removes the residuals of all but weak constraints.

    Args:
        residuals: (k,) dimensionless residuals of positions or of velocities.
    """
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
        component = rest[int(closing.chosen[r])] * closing.inverse[r]
        for row in range(k):
            rest[row] -= component * closing.shares[k * r + row]
        for i in range(nv):
            step[i] += component * closing.basis[nv * r + i]
    # back substitution: solve L^T step = y, where y is the sum of the loop above
    for m in range(nv):
        i = nv - 1 - m
        remainder = step[i]
        for j in range(i + 1, nv):
            remainder -= lower[nv * j + i] * step[j]
        step[i] = remainder / lower[nv * i + i]
    # from dimensionless numbers to SI
    for i in range(nv):
        step[i] = closing.units[i] * step[i]


@native
def squared(count: int, residuals: Vector) -> float:
    """Return the sum of squares of the first `count` residuals."""
    square = 0.0
    for i in range(count):
        square += residuals[i] * residuals[i]
    return square


@native
def close_by(closing: Closing, x: Vector, y: Vector) -> None:
    """Project a state onto the constraints by a prepared record; an unprepared one causes failure.

    Args:
        x: state with time and parameters (inputs,).
        y: (nq + nv + 1,) written: the projected state, then 1.0 for success or -1.0 for failure.
    """
    nq = closing.nq
    nv = closing.nv
    k = closing.constraints
    at = closing.at
    moved = closing.moved
    results = closing.results
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
    closing.evaluate(at, results)
    squared_residual = squared(k, results)
    # positions: Newton's iteration, with a new Jacobian while the residual is large
    for number in range(MAX_DENSE_ITERATIONS):
        if number == 0 or squared_residual > REUSE_JACOBIAN_BELOW * REUSE_JACOBIAN_BELOW:
            if factor_metric(closing) == 0:
                return
            orthogonalize(closing)
        correct(closing, results)
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
        previous = squared_residual
        closing.evaluate(at, results)
        squared_residual = squared(k, results)
        if not squared_residual < 0.25 * previous:
            squared_residual = previous
            break
        for i in range(nq):
            y[i] = at[i]
        if squared_residual < RESIDUAL_ROUND_OFF * RESIDUAL_ROUND_OFF:
            break
    # fail if the loops stay open
    if not squared_residual <= CLOSURE_TOLERANCE * CLOSURE_TOLERANCE:
        return
    # velocities: two corrections, the second one removes the round-off of the first
    for _time in range(2):
        for i in range(nq + nv):
            at[i] = y[i]
        closing.evaluate(at, results)
        correct(closing, results[k:])
        for i in range(nv):
            y[nq + i] -= step[i]
    y[nq + nv] = 1.0


@native
def close(closing: Closing, x: Vector, y: Vector) -> None:
    """Project a state onto the constraints as `close_by` does; fill in the record first if it is empty."""
    if closing.constraints < 0:
        closing.prepare(x, y)
    close_by(closing, x, y)
