"""Redundant constraints and the degrees of freedom they leave, decided once for each scene.

A constraint row is redundant if it follows from the others in every configuration. A row that depends on the
others in one configuration only, as in a dead center, is not redundant. Several configurations are examined.

Files are rarely exact. Axes tilted by 1e-12 to 1e-7 rad and points rounded to 1e-6 m leave rows with a very
small independent part, although the design is redundant. Taken literally these rows would lock the mechanism.
A row counts as redundant if its independent part is smaller than `Scene.redundancy_tolerance` and separated
from the others by a gap (`newton_euler.equations.independence`). The report names it with its singular value
(on such models see J. Garcia de Jalon and M. D. Gutierrez-Lopez, Multibody System Dynamics 30, 2013).

The decision is made in joint coordinates. Each row is in units of the body motions whose difference it is.
All other forms of the equations, dense and sparse, of every engine, use its degrees of freedom. All matrices
are sparse: scenes may have thousands of rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from newton_euler.equations.branches import joint_between_branches
from newton_euler.equations.dense import largest, largest_share, singular_values
from newton_euler.equations.formulation import Formulation
from newton_euler.equations.independence import (
    MIN_INEXACT,
    ROW_ROUND_OFF,
    Independent,
    independent,
    least_step,
    length,
    remainder,
)
from newton_euler.equations.kinematics import TreeKinematics
from newton_euler.equations.row_shares import MIN_REGULAR, ScaledRows, varying_rows
from newton_euler.equations.sparse import Rows, to_array
from newton_euler.equations.system import System, dimensionless_jacobian
from newton_euler.model.mechanism import CLOSURE_TOLERANCE
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array

MIN_CONFIGURATIONS = 4
"""Number of configurations that decide."""

MAX_CONFIGURATIONS = 16
"""Number of configurations if fewer than `MIN_REGULAR` of them are regular."""

SAMPLE_DISTANCE = 0.1
"""Distance between configurations, rad or sizes of the mechanism."""

RESIDUAL_FACTOR = 10.0
"""Largest residual of a nearly redundant constraint, divided by the scene's tolerance. Joints move by some
rad or sizes of the mechanism, which multiply the noise of the file's numbers."""

SUSPECT = 1e-2, 100.0
"""Largest singular value of a row that looks redundant by design although it is taken literally, and least
ratio to the next larger singular value."""

MAX_LISTED = 20
"""Number of redundant constraints listed for a scene that is too large for singular values."""

DENSE_LIMIT = 1_000_000
"""Number of elements of the largest Jacobian whose singular values are computed."""

MAX_NEIGHBOR_STEPS = 30
"""Number of Newton's steps to a configuration. From a singular configuration they converge slowly."""

MAX_SAMPLE_RESIDUAL = 1e-11
"""Largest dimensionless residual of the independent rows of a closed configuration."""


class NearlyRedundant(NamedTuple):
    """A constraint that is almost implied by the others."""

    joint: str
    """Name of the joint or coupling with the largest share in the constraint."""
    singular_value: float
    """Dimensionless, of the constraint Jacobian in joint coordinates."""
    taken: Literal["redundant", "literally"]

    def __str__(self) -> str:
        return f"joint {self.joint!r}: singular value {self.singular_value:.1e}, taken {self.taken}"


def residual(nearly: Iterable[NearlyRedundant]) -> float:
    """Find the largest singular value that is taken as redundant; 0 without any."""
    return max((weak.singular_value for weak in nearly if weak.taken == "redundant"), default=0.0)


class Configuration(NamedTuple):
    """Constraint rows at a closed configuration."""

    q: Array
    rows: Rows
    """Dimensionless, in units of `scales`."""
    scales: Array
    """(k,) natural magnitudes of the dimensionless rows."""
    chosen: Independent

    @property
    def rank(self) -> int:
        return len(self.chosen.factor.order)


@dataclass(frozen=True, eq=False)
class Mobility:
    """Degrees of freedom of a scene.

    Attributes:
        degrees_of_freedom: number of independent velocities in configurations that are not singular.
        independent: rows of the joint-coordinate form that imply all others.
        redundant: other rows that are not zero everywhere: with them multipliers are not unique.
        exchangeable: natural magnitudes of the rows among which a run chooses, see
            `newton_euler.equations.row_choice`; empty if rows are redundant except for noise.
        nearly: constraints that are almost redundant, and whether they are taken as redundant.
        residual: largest singular value that is taken as redundant; 0 if redundancy is exact.
        configurations: closed configurations that were examined.
        states: states of these configurations, at rest.
        between_branches: joint that loses rank at a singular start whose velocities no motion has; empty if a
            motion has them. See `newton_euler.equations.branches`.
    """

    degrees_of_freedom: int
    independent: list[int]
    redundant: list[int]
    exchangeable: dict[int, float]
    nearly: tuple[NearlyRedundant, ...]
    configurations: list[Configuration]
    states: list[State]
    between_branches: str = ""

    @property
    def residual(self) -> float:
        return residual(self.nearly)


_KNOWN: WeakKeyDictionary[Scene, Mobility] = WeakKeyDictionary()
_LEFT_OUT: WeakKeyDictionary[Scene, dict[str, list[int]]] = WeakKeyDictionary()


def mobility(scene: Scene) -> Mobility:
    """Decide which constraints of a scene are redundant, once for each scene."""
    if scene not in _KNOWN:
        with np.errstate(all="ignore"):  # a run reports overflows
            _KNOWN[scene] = _mobility(TreeKinematics(scene))
    return _KNOWN[scene]


def constraint_rank(system: System) -> int:
    """Compute the number of independent constraints of any form of a scene's equations."""
    return system.nv - mobility(system.scene).degrees_of_freedom


def rows_left_out(system: System) -> list[int]:
    """Select the rows of `phi` that are redundant except for noise, which all solvers leave out.

    A `Formulation` keeps the rows of the joint-coordinate form. Another engine keeps the rows that a QR
    factorization with pivoting selects at the configuration of the largest rank.
    """
    decided, count = mobility(system.scene), len(system.phi_units)
    if decided.residual == 0.0:
        return []
    known = _LEFT_OUT.setdefault(system.scene, {})
    if isinstance(system, Formulation):
        if system.omitted is not None:
            return system.omitted
        used = system.rows_of(decided.independent)
    elif system.name in known:
        return known[system.name]
    else:
        from scipy.linalg import qr

        best = max(range(len(decided.states)), key=lambda k: decided.configurations[k].rank)
        q, _ = system.coordinates(decided.states[best])
        used = qr(dimensionless_jacobian(system, q).T, mode="r", pivoting=True)[1][
            : constraint_rank(system)
        ].tolist()
    known[system.name] = sorted(set(range(count)) - set(used))
    return known[system.name]


def loosely_closed(tolerance: float) -> float:
    """Compute the largest residual, sizes or rad, of closed constraints that are nearly redundant."""
    return max(RESIDUAL_FACTOR * tolerance, CLOSURE_TOLERANCE)


def without(rows: Array, left_out: Sequence[int]) -> Array:
    """Copy an array (k, ...) with some of its rows zero."""
    changed = np.array(rows)
    changed[list(left_out)] = 0.0
    return changed


def inherit_mobility(scene: Scene, of: Scene) -> None:
    """Use the decision on another scene with the same geometry, if it has been made."""
    if of in _KNOWN:
        _KNOWN[scene] = replace(_KNOWN[of], between_branches="")  # its start may be another one


def _mobility(system: TreeKinematics) -> Mobility:
    seen, alive = _examine(system)
    best = max(seen, key=lambda at: at.rank)
    used, rest = best.chosen.rows, np.zeros(system.nv)
    redundant = sorted(alive - set(used))
    nearly = tuple(_nearly(system, [at for at in seen if at.rank == len(used)]))
    exact = redundant if residual(nearly) == 0.0 else []
    return Mobility(
        system.nv - len(used),
        used,
        redundant,
        varying_rows([ScaledRows(at.rows, at.scales) for at in seen], used, exact),
        nearly,
        seen,
        [system.state(at.q, rest) for at in seen],
        _between_branches(system),
    )


def _between_branches(system: TreeKinematics) -> str:
    """Find the joint of a start between branches, see `Mobility`; large mechanisms are not examined."""
    if system.scene.initial_state is None or len(system.phi_units) * system.nv > DENSE_LIMIT:
        return ""
    return joint_between_branches(system, *system.coordinates(system.scene.initial_state))


def _nearly(system: TreeKinematics, seen: Sequence[Configuration]) -> Iterator[NearlyRedundant]:
    """Find small singular values on both sides of the rank.

    Singular values taken literally come from the configuration where the smallest of them is largest, those
    of redundant rows from the configuration with the largest noise: in some poses noise has no effect.
    """
    own, _ = system.coordinates(State.initial(system.scene.mechanism))
    exact = [MIN_INEXACT if np.array_equal(at.q, own) else MAX_SAMPLE_RESIDUAL for at in seen]
    if all(at.chosen.weak for at in seen):
        spectra = [_spectrum(system, at) for at in seen]
        values, rank, owner = max(spectra, key=lambda each: each.values[each.rank - 1])
        smallest, apart = SUSPECT
        for k in range(1, rank):
            if values[k] < smallest and values[k] * apart < values[k - 1]:
                yield NearlyRedundant(owner(k), values[k], "literally")
    noisiest = max(range(len(seen)), key=lambda k: seen[k].chosen.noise / exact[k])
    if seen[noisiest].chosen.noise > exact[noisiest]:
        values, rank, owner = _spectrum(system, seen[noisiest])
        for k in range(rank, len(values)):
            if values[k] > exact[noisiest]:
                yield NearlyRedundant(owner(k), values[k], "redundant")


class Spectrum(NamedTuple):
    """Singular values of the Jacobian of a configuration, the largest first.

    A Jacobian too large for singular values has the independent parts of its rows instead.
    """

    values: list[float]
    rank: int
    """Number of singular values that are not taken as redundant."""
    owner: Callable[[int], str]
    """Function from the number of a singular value to the joint or coupling with the largest share."""


def _spectrum(system: TreeKinematics, at: Configuration) -> Spectrum:
    rows, chosen, owners = at.rows, at.chosen, system.row_owners
    if len(rows) * system.nv <= DENSE_LIMIT:
        u, s, _ = singular_values(to_array(rows, system.nv))
        return Spectrum(s.tolist(), at.rank, lambda k: largest_share(owners, u[:, k]))
    others = set(range(len(rows))) - set(chosen.factor.order)
    left = {k: remainder(rows, chosen.factor, rows[k]) for k in others}
    redundant = sorted(left, key=lambda k: -left[k])[:MAX_LISTED]
    named = [*chosen.weak, *redundant]
    values = [chosen.strong, *chosen.weak.values(), *(left[k] for k in redundant)]
    return Spectrum(values, 1 + len(chosen.weak), lambda k: owners[named[k - 1]])


def _examine(system: TreeKinematics) -> tuple[list[Configuration], set[int]]:
    """Examine closed configurations; also return the rows that are not zero in all of them."""
    tolerance = system.scene.redundancy_tolerance
    pose = State.initial(system.scene.mechanism)
    q, v = system.coordinates(pose if system.scene.initial_state is None else system.scene.initial_state)
    own, _ = system.coordinates(pose)
    directions = _directions(system, v)
    alive: set[int] = set()
    seen: list[Configuration] = []
    for number in range(MAX_CONFIGURATIONS):
        # keep the start, and configurations whose loops are closed
        phi, rows, scales = _scaled(system, q)
        found = independent(rows, tolerance)
        others = np.delete(phi, found.rows)
        if number == 0 or (
            largest(phi[found.rows]) < MAX_SAMPLE_RESIDUAL
            and largest(others) < max(MAX_SAMPLE_RESIDUAL, RESIDUAL_FACTOR * tolerance)
        ):
            alive.update(i for i, row in enumerate(rows) if length(row) > ROW_ROUND_OFF)
            seen.append(Configuration(q, rows, scales, found))
        # stop if the rank is the largest possible, or enough configurations are regular
        best = max(seen, key=lambda at: at.rank)
        if number > 0 and best.rank == len(alive):
            break
        regular = sum(at.rank == best.rank for at in seen)
        if number + 1 >= MIN_CONFIGURATIONS and regular >= MIN_REGULAR:
            break
        # next: the initial pose if the start is another one, then neighbors of the best configuration
        moved = number == 0 and not np.array_equal(own, q)
        q = own if moved else _neighbor(system, best.q, next(directions))
    return seen, alive


def _scaled(system: TreeKinematics, q: Array) -> tuple[Array, Rows, Array]:
    """Compute residuals and Jacobian rows, dimensionless and in units of their motions, and these units."""
    phi, jacobian = system.phi_and_jacobian(q)
    natural = system.row_scales(q)
    units, scales = system.velocity_units, system.phi_units * natural
    rows = [
        {k: x * units[k] / scale for k, x in row.items()} for row, scale in zip(jacobian, scales, strict=True)
    ]
    return phi / scales, rows, natural


def _directions(system: TreeKinematics, v: Array) -> Iterator[Array]:
    """Yield directions to other configurations: the start's velocity, then random directions.

    From a singular configuration a random step leaves all branches, and projection returns to a point too
    near to decide. A velocity belongs to a branch.
    """
    speed = np.max(np.abs(v / system.velocity_units), initial=0.0)
    if speed > 0.0:
        yield v / speed
    rng = np.random.default_rng(0)
    while True:
        yield system.velocity_units * rng.uniform(-1.0, 1.0, system.nv)


def _neighbor(system: TreeKinematics, q: Array, direction: Array) -> Array:
    """Find another closed configuration of the independent constraints, `SAMPLE_DISTANCE` away."""
    tolerance, unit = system.scene.redundancy_tolerance, system.velocity_units
    # a step along the direction, projected onto the tangent space
    step = SAMPLE_DISTANCE * direction
    _, rows, _ = _scaled(system, q)
    rate = np.array([sum(x * step[k] / unit[k] for k, x in row.items()) for row in rows])
    back = least_step(rows, independent(rows, tolerance).factor, rate, system.nv)
    q = system.retract(q, step - unit * back)
    # Newton's steps of least length
    for _ in range(MAX_NEIGHBOR_STEPS):
        phi, rows, _ = _scaled(system, q)
        factor = independent(rows, tolerance).factor
        if largest(phi[factor.order]) < 0.01 * MAX_SAMPLE_RESIDUAL:
            break
        q = system.retract(q, -unit * least_step(rows, factor, phi, system.nv))
    return q
