"""Redundant constraints and the degrees of freedom they leave, decided once for each scene.

A constraint row is redundant if it follows from the others in every configuration; a row that depends on
the others in one configuration only, as in a dead center, is none. So several configurations are examined.

Files are rarely exact: axes tilted by 1e-12 to 1e-7 rad and points rounded to 1e-6 m leave rows that add
very little to the others, although the design is plainly redundant. Taken literally they would lock the
mechanism. Rows whose independent part is smaller than `Scene.redundancy_tolerance` count as redundant
where a gap sets them apart, and are named with their singular value (on such models see J. Garcia de Jalon
and M. D. Gutierrez-Lopez, Multibody System Dynamics 30, 2013). The decision is made in joint coordinates,
with each row in units of the motions that it is a difference of; all other forms of the equations, dense
and sparse, of every engine, take the degrees of freedom from it.

Everything is sparse: scenes may have thousands of rows.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol, runtime_checkable
from weakref import WeakKeyDictionary

import numpy as np

from newton_euler.mechanism import CLOSURE_TOLERANCE
from newton_euler.relative_terms import RelativeTerms
from newton_euler.scalars import Array
from newton_euler.scene import Scene
from newton_euler.solve import singular_values
from newton_euler.sparse import (
    Factor,
    Rows,
    RowsInUse,
    Solution,
    add,
    dense,
    dot,
    factorise,
    gram,
    pattern_order,
    sparse_vector,
)
from newton_euler.state import State

CONFIGURATIONS = 4
"""Number of configurations that decide."""

REACH = 0.1
"""Distance between them: radians, and sizes of the mechanism."""

ROUND_OFF = 1e-10
"""Independent part of a row below which it is round-off, whatever the scene's tolerance."""

NAMED = 1e-13
"""Singular value of a closed initial pose above which a redundant row is not exactly redundant."""

CERTAIN = 1e-4
"""Pivot of the Gram matrix above which its row is independent: a pivot is the square of what the row adds to
those before it, so that smaller ones leave doubt."""

GAP = 10.0
"""Least ratio of the weakest independent row to the strongest redundant one."""

LOOSE = 10.0
"""Residual of a nearly redundant constraint in units of the scene's tolerance: noise of that size times the
largest angles, and sizes of the mechanism, that joints move by."""

SUSPECT = 1e-2, 100.0
"""Singular value below which, and distance to the next larger one from which, a row that is taken literally
looks like one of a design that was meant to be redundant."""

MOST_NAMED = 20
"""Constraints of a scene that is too large for its singular values."""

DENSE_LIMIT = 1_000_000
"""Largest number of elements of a Jacobian whose singular values are computed to name them."""

NEWTON_STEPS = 30
"""From a singular configuration Newton's steps converge slowly."""

CLOSED = 1e-11
"""Residual, dimensionless, of the independent rows of a configuration that is closed."""


class Equations(Protocol):
    """Any form of the equations of a scene, with constraints that hold all of the scene's."""

    scene: Scene
    nv: int


class Dense(Equations, Protocol):
    """A form with a dense Jacobian; see `newton_euler.system.System`."""

    name: str
    phi_units: Array
    velocity_units: Array

    def coordinates(self, state: State) -> tuple[Array, Array]: ...

    def phi_jacobian(self, q: Array) -> Array: ...


@runtime_checkable
class Eliminated(Dense, Protocol):
    """A form that sparse elimination solves."""

    omitted: list[int] | None
    """Rows to leave out instead of those that are chosen here."""

    def sparse_solution(self, q: Array, v: Array, rows: RowsInUse) -> Solution: ...

    def rows_of(self, relative: Collection[int]) -> list[int]:
        """Rows of `phi` that hold these of the joint-coordinate form, and all that its tree holds."""


class NearlyRedundant(NamedTuple):
    """A constraint that is almost implied by the others."""

    joint: str
    """Name of the joint or gear with the largest share in it."""
    singular_value: float
    """Dimensionless, of the constraint Jacobian in joint coordinates."""
    taken: Literal["redundant", "literally"]

    def __str__(self) -> str:
        return f"joint {self.joint!r}: singular value {self.singular_value:.1e}, taken {self.taken}"


class Configuration(NamedTuple):
    """Constraint rows at a closed configuration."""

    q: Array
    rows: Rows
    """Dimensionless."""
    independent: list[int]
    weak: bool
    """Whether an independent row adds little to the others."""
    noise: float
    """What the others together add to the independent rows, dimensionless."""


@dataclass(frozen=True, eq=False)
class Mobility:
    """Degrees of freedom of a scene.

    Attributes:
        degrees_of_freedom: number of independent velocities where no configuration is singular.
        independent: rows of the joint-coordinate form that imply all others.
        redundant: other rows that are not zero everywhere: with them multipliers are not unique.
        nearly: constraints that are almost redundant, and how they are taken.
        residual: largest singular value that is taken as redundant; 0 if all are exactly so.
        configurations: those that were examined and are closed.
        states: the same, at rest.
    """

    degrees_of_freedom: int
    independent: list[int]
    redundant: list[int]
    nearly: tuple[NearlyRedundant, ...]
    configurations: list[Configuration]
    states: list[State]

    @property
    def residual(self) -> float:
        return max((weak.singular_value for weak in self.nearly if weak.taken == "redundant"), default=0.0)


_KNOWN: WeakKeyDictionary[Scene, Mobility] = WeakKeyDictionary()
_LEFT_OUT: WeakKeyDictionary[Scene, dict[str, list[int]]] = WeakKeyDictionary()


def mobility(scene: Scene) -> Mobility:
    """Decide which constraints of a scene are redundant; asked again for the same scene, the same."""
    if scene not in _KNOWN:
        with np.errstate(all="ignore"):  # what overflows is reported by a run
            _KNOWN[scene] = _mobility(RelativeTerms(scene))
    return _KNOWN[scene]


def constraint_rank(system: Equations) -> int:
    """Number of independent constraints of any form of a scene's equations."""
    return system.nv - mobility(system.scene).degrees_of_freedom


def rows_left_out(system: Dense) -> list[int]:
    """Rows of `phi` that noise keeps from being redundant, left out the same everywhere.

    Of a form that knows the rows of the joint-coordinate form, all but those; of another one those that a
    factorization with pivoting leaves at a configuration where no others are redundant.
    """
    decided, count = mobility(system.scene), len(system.phi_units)
    if decided.residual == 0.0:
        return []
    known = _LEFT_OUT.setdefault(system.scene, {})
    if isinstance(system, Eliminated):
        if system.omitted is not None:
            return system.omitted
        used = system.rows_of(decided.independent)
    elif system.name in known:
        return known[system.name]
    else:
        from scipy.linalg import qr

        best = max(range(len(decided.states)), key=lambda k: len(decided.configurations[k].independent))
        q, _ = system.coordinates(decided.states[best])
        jacobian = system.phi_jacobian(q) * system.velocity_units / system.phi_units[:, None]
        used = qr(jacobian.T, mode="r", pivoting=True)[1][: constraint_rank(system)].tolist()
    known[system.name] = sorted(set(range(count)) - set(used))
    return known[system.name]


def loosely_closed(scene: Scene) -> float:
    """Residual, sizes or rad, up to which constraints that are redundant but for noise may be open."""
    return max(LOOSE * scene.redundancy_tolerance, CLOSURE_TOLERANCE)


def without(rows: Array, left_out: Sequence[int]) -> Array:
    """A copy of an array (k, ...) with some of its rows zero."""
    changed = np.array(rows)
    changed[list(left_out)] = 0.0
    return changed


def inherit_mobility(scene: Scene, of: Scene) -> None:
    """Give a scene with the same geometry as another one what has been decided of that, if it has been."""
    if of in _KNOWN:
        _KNOWN[scene] = _KNOWN[of]


def rows_in_use(system: Eliminated, independent: Sequence[int] | None = None) -> RowsInUse:
    """Select rows of a form of the equations that are independent and imply all others.

    They hold `independent` rows of the joint-coordinate form, those of its mobility if None.
    """
    decided = mobility(system.scene)
    independent = decided.independent if independent is None else list(independent)
    numbers = system.rows_of(independent)
    pivots = []
    for at, state in zip(decided.configurations, decided.states, strict=True):
        # elsewhere, as where the four-bar is flat, pivots are zero or round-off
        if len(_independent([at.rows[i] for i in independent], 0.0)[0].order) == len(independent):
            q, _ = system.coordinates(state)
            solution = system.sparse_solution(q, np.zeros(system.nv), RowsInUse(numbers))
            pivots.append((solution.pivots, solution.mass_pivots))
    scales, mass_scales = (
        [float(max(column)) for column in zip(*each, strict=True)] for each in zip(*pivots, strict=True)
    )
    return RowsInUse(numbers, scales, mass_scales)


def _mobility(system: RelativeTerms) -> Mobility:
    seen, alive = _examine(system)
    best = max(seen, key=lambda at: len(at.independent))
    independent, rest = best.independent, np.zeros(system.nv)
    return Mobility(
        system.nv - len(independent),
        independent,
        sorted(alive - set(independent)),
        tuple(_nearly(system, [at for at in seen if len(at.independent) == len(independent)])),
        seen,
        [system.state(at.q, rest) for at in seen],
    )


def _nearly(system: RelativeTerms, seen: Sequence[Configuration]) -> Iterator[NearlyRedundant]:
    """Small singular values on both sides of the rank, where no configuration has larger ones.

    Of a scene too large for these, what rows add that are taken as redundant.
    """
    if not all(at.weak or at.noise > NAMED for at in seen):
        return
    if len(seen[0].rows) * system.nv > DENSE_LIMIT:
        rows, used = seen[0].rows, set(seen[0].independent)
        factor = factorise(gram(rows, rows), seen[0].independent)
        left = {k: _remainder(rows, factor, row) for k, row in enumerate(rows) if k not in used}
        for row in sorted(left, key=lambda row: -left[row])[:MOST_NAMED]:
            if left[row] > NAMED:
                yield NearlyRedundant(system.row_owners[row], left[row], "redundant")
        return
    found = [singular_values(dense(at.rows, system.nv))[:2] for at in seen]
    rank, (smallest, apart) = len(seen[0].independent), SUSPECT
    own, _ = system.coordinates(State.initial(system.scene.mechanism))
    exact = NAMED if np.array_equal(seen[0].q, own) else CLOSED

    def named(u: Array, value: float, taken: Literal["redundant", "literally"]) -> NearlyRedundant:
        weights: dict[str, float] = {}
        for owner, share in zip(system.row_owners, u**2, strict=True):
            weights[owner] = weights.get(owner, 0.0) + share
        return NearlyRedundant(max(weights, key=lambda owner: weights[owner]), float(value), taken)

    u, s = max(found, key=lambda each: float(each[1][rank - 1]))
    for k in range(1, rank):
        if s[k] < smallest and s[k] * apart < s[k - 1]:
            yield named(u[:, k], s[k], "literally")
    u, s = found[0]
    for k in range(rank, len(s)):
        if s[k] > exact:
            yield named(u[:, k], s[k], "redundant")


def _examine(system: RelativeTerms) -> tuple[list[Configuration], set[int]]:
    """Examine closed configurations; also which rows are not zero in all of them."""
    tolerance = system.scene.redundancy_tolerance
    pose = State.initial(system.scene.mechanism)
    q, v = system.coordinates(pose if system.scene.initial_state is None else system.scene.initial_state)
    own, _ = system.coordinates(pose)
    directions = _directions(system, v)
    alive: set[int] = set()
    seen: list[Configuration] = []
    for number in range(CONFIGURATIONS):
        phi, rows = _scaled(system, q)
        factor, weak, noise = _independent(rows, tolerance)
        found = sorted(factor.order)
        others = np.delete(phi, found)
        if number == 0 or (
            _largest(phi[found]) < CLOSED and _largest(others) < max(CLOSED, LOOSE * tolerance)
        ):
            alive.update(i for i, row in enumerate(rows) if _length(row) > ROUND_OFF)
            seen.append(Configuration(q, rows, found, weak, noise))
        best = max(seen, key=lambda at: len(at.independent))
        if number > 0 and len(best.independent) == len(alive):
            break  # all that can be
        if number == 0 and not np.array_equal(own, q):
            q = own
        else:
            q = _neighbour(system, best.q, next(directions))
    return seen, alive


def apparent_rank(values: Array, tolerance: float) -> int:
    """Rank that the singular values (n,) of a matrix suggest, by the rule for the rows of a scene."""
    largest = float(np.max(values, initial=0.0))
    exact = int(np.sum(values > ROUND_OFF * max(1.0, largest)))
    for rank in range(1, exact):
        if values[rank] <= tolerance * largest and GAP * values[rank] <= values[rank - 1]:
            return rank
    return exact


def _scaled(system: RelativeTerms, q: Array) -> tuple[Array, Rows]:
    """Dimensionless residuals and Jacobian rows, each in units of its own motions."""
    phi, jacobian = system.phi_and_jacobian(q)
    units, scales = system.velocity_units, system.phi_units * system.row_scales(q)
    rows = [
        {k: x * units[k] / scale for k, x in row.items()} for row, scale in zip(jacobian, scales, strict=True)
    ]
    return phi / scales, rows


def _largest(residuals: Array) -> float:
    return float(np.max(np.abs(residuals), initial=0.0))


def _length(row: dict[int, float]) -> float:
    return float(np.sqrt(sum(x * x for x in row.values())))


def _independent(rows: Rows, tolerance: float) -> tuple[Factor, bool, float]:
    """Factor the Gram matrix of independent rows; `Factor.order` are these rows.

    Also `Configuration.weak` and `Configuration.noise`. Rows are added by what is new in them, the most
    first, until less than `tolerance` is new and a gap separates it; where there is none, until the rest is
    round-off.
    """
    lengths = [_length(row) for row in rows]
    noise = max((length for length in lengths if length <= ROUND_OFF), default=0.0)
    rows = [row if length > ROUND_OFF else {} for row, length in zip(rows, lengths, strict=True)]
    products = gram(rows, rows)
    order = [i for i in pattern_order(products) if rows[i]]
    certain = max(CERTAIN, (GAP * tolerance) ** 2)
    factor = factorise(products, order, scales=[1.0] * len(rows), drop=certain)
    used = set(factor.order)
    doubtful = [i for i in order if i not in used]
    least = float(np.sqrt(min((factor.pivots[i] for i in factor.order), default=1.0)))
    while doubtful and (new := _together(rows, factor, doubtful)) > NAMED:
        if new <= ROUND_OFF or GAP * new <= min(tolerance, least / GAP):
            noise = max(noise, new)
            break
        shares = {i: _remainder(rows, factor, rows[i]) for i in doubtful}
        found = max(shares, key=lambda i: shares[i])
        share = shares[found]
        if share <= ROUND_OFF or (share <= tolerance and GAP * share <= least):
            noise = max(noise, share)
            break
        least = min(least, share)
        doubtful.remove(found)
        factor = factorise(products, [*factor.order, found])
    return factor, least < np.sqrt(CERTAIN), noise


def _together(rows: Rows, factor: Factor, doubtful: list[int]) -> float:
    """Length of what is new in a random combination of rows: round-off only if nothing is new in any."""
    weights = np.random.default_rng(1).uniform(1.0, 2.0, len(doubtful))
    together: dict[int, float] = {}
    for i, weight in zip(doubtful, weights, strict=True):
        for k, x in rows[i].items():
            add(together, k, weight * x)
    return _remainder(rows, factor, together)


def _remainder(rows: Rows, factor: Factor, row: dict[int, float]) -> float:
    """Length of the part of a row that is new to those of a factor; solved twice, for digits that squaring
    loses."""
    left = dict(row)
    for _ in range(2):
        right = {j: dot(rows[j], left) for j in factor.order}
        for j, share in factor.solve({j: x for j, x in right.items() if x != 0.0}).items():
            for k, x in rows[j].items() if share != 0.0 else ():
                left[k] = left.get(k, 0.0) - share * x
    return _length(left)


def _directions(system: RelativeTerms, v: Array) -> Iterator[Array]:
    """Yield directions to other configurations: the velocity's, then random ones.

    From a singular configuration random steps lead off all of its branches, and what they come back to is too
    near to it to tell; a velocity is that of a branch.
    """
    speed = np.max(np.abs(v / system.velocity_units), initial=0.0)
    if speed > 0.0:
        yield v / speed
    rng = np.random.default_rng(0)
    while True:
        yield system.velocity_units * rng.uniform(-1.0, 1.0, system.nv)


def _neighbour(system: RelativeTerms, q: Array, direction: Array) -> Array:
    """Find another configuration that meets the independent constraints, some way off in a direction."""
    tolerance, unit = system.scene.redundancy_tolerance, system.velocity_units
    step = REACH * direction
    _, rows = _scaled(system, q)
    rate = np.array([sum(x * step[k] / unit[k] for k, x in row.items()) for row in rows])
    q = system.retract(q, step - _least(rows, _independent(rows, tolerance)[0], rate, unit))
    for _ in range(NEWTON_STEPS):
        phi, rows = _scaled(system, q)
        factor = _independent(rows, tolerance)[0]
        if _largest(phi[factor.order]) < 0.01 * CLOSED:
            break
        q = system.retract(q, -_least(rows, factor, phi, unit))
    return q


def _least(rows: Rows, factor: Factor, right: Array, unit: Array) -> Array:
    """The shortest step (nv,), in dimensionless terms, with rows @ (step / unit) = right."""
    used = set(factor.order)
    weights = factor.solve({i: x for i, x in sparse_vector(right).items() if i in used})
    step = np.zeros(len(unit))
    for i in factor.order:
        for k, x in rows[i].items():
            step[k] += x * weights.get(i, 0.0) * unit[k]
    return step
