"""Mobility analysis of a scene: redundant constraints and the number of degrees of freedom.

A constraint row is one scalar constraint equation, and its row of the constraint Jacobian. A row is redundant
if it follows from the other rows in every configuration. A row that depends on the others in one
configuration only, such as a dead center, is not redundant: this configuration is singular. Therefore several
configurations are examined.

Model files are rarely exact. Axes tilted by 1e-12 to 1e-7 rad and points rounded to 1e-6 m leave rows that
are almost dependent, although the design is redundant. If these rows counted as independent, they would lock
the mechanism. The independent part of a row is its distance from the span of the other rows. A row counts as
redundant if this part is smaller than `Scene.redundancy_tolerance` and separated from the others by a gap
(`newton_euler.equations.independence`). Reports name such a row with its singular value (on such models see
J. Garcia de Jalon and M. D. Gutierrez-Lopez, Multibody System Dynamics 30, 2013).

The analysis uses joint coordinates of a spanning tree. It divides each row by its natural magnitude, which is
the size of the body motions that the row compares
(`newton_euler.equations.kinematics.TreeKinematics.row_scales`). All other forms of the equations, in every
engine, use the resulting degrees of freedom.
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
"""Number of configurations that are examined if at least `MIN_REGULAR` of them are regular (not singular)."""

MAX_CONFIGURATIONS = 16
"""Largest number of configurations that are examined."""

SAMPLE_DISTANCE = 0.1
"""Distance between examined configurations, rad, or a length divided by the mechanism's size."""

RESIDUAL_FACTOR = 10.0
"""Largest dimensionless residual of an almost redundant constraint in a closed configuration, divided by
`Scene.redundancy_tolerance`.

Joints move by several rad or mechanism sizes, which multiply the rounding errors of the file's numbers."""

MAX_SUSPECT_VALUE = 1e-2
"""Singular value below which an independent constraint may have been redundant by design."""

MIN_SUSPECT_GAP = 100.0
"""Smallest ratio of the next larger singular value to that of a constraint that may be redundant by
design."""

MAX_LISTED = 20
"""Number of redundant constraints listed for a scene that is too large for singular values."""

DENSE_LIMIT = 1_000_000
"""Number of elements of the largest Jacobian whose singular values are computed."""

MAX_NEIGHBOR_STEPS = 30
"""Largest number of Newton steps to a closed configuration; they converge slowly near a singular one."""

MAX_SAMPLE_RESIDUAL = 1e-11
"""Largest dimensionless residual of the independent rows of a closed configuration."""


class NearlyRedundant(NamedTuple):
    """A constraint that almost follows from the others.

    Attributes:
        joint: name of the joint or coupling with the largest share in the constraint.
        singular_value: dimensionless singular value of the constraint Jacobian in joint coordinates; about
            the distance of the constraint from the span of the others.
        taken: "redundant" if solvers ignore the constraint, "literally" if it counts as independent.
    """

    joint: str
    singular_value: float
    taken: Literal["redundant", "literally"]

    def __str__(self) -> str:
        return f"joint {self.joint!r}: singular value {self.singular_value:.1e}, taken {self.taken}"


def residual(nearly: Iterable[NearlyRedundant]) -> float:
    """Return the largest singular value of constraints that are ignored as redundant; 0 without any."""
    return max((each.singular_value for each in nearly if each.taken == "redundant"), default=0.0)


class Configuration(NamedTuple):
    """Constraint rows at a closed configuration.

    Attributes:
        q: (nq,) joint coordinates.
        rows: sparse dimensionless rows, each divided by its natural magnitude.
        scales: (k,) natural magnitude of each dimensionless row before the division.
        chosen: selection of independent rows, `chosen.rows`. `weak` are the selected rows that may be
            redundant by design. `strong` is the smallest independent part of the other selected rows, and
            `noise` is the largest one of the rows that are not selected.
    """

    q: Array
    rows: Rows
    scales: Array
    chosen: Independent

    @property
    def rank(self) -> int:
        """Number of independent rows."""
        return len(self.chosen.rows)


@dataclass(frozen=True, eq=False)
class Mobility:
    """Result of the mobility analysis of a scene. Rows are those of the joint-coordinate form.

    Attributes:
        degrees_of_freedom: number of independent velocities in configurations that are not singular.
        independent: numbers of independent rows; all other rows follow from them.
        redundant: numbers of the other rows, without rows that are zero in all configurations. If there are
            any, Lagrange multipliers and reactions are not unique.
        exchangeable: natural magnitudes, by row number, of rows that a run may exchange for each other when
            the independent rows become dependent, see `newton_euler.equations.row_choice`. Empty if
            redundancy is not exact.
        nearly: constraints that are almost redundant.
        configurations: closed configurations that were examined.
        states: states of these configurations, at rest.
        between_branches: name of a joint with a dependent constraint, if the start is singular and its
            velocities are tangent to no motion (branch) of the mechanism, see
            `newton_euler.equations.branches`; else empty.
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
        """Largest singular value of constraints that are ignored as redundant; 0 if redundancy is exact."""
        return residual(self.nearly)


_MOBILITIES: WeakKeyDictionary[Scene, Mobility] = WeakKeyDictionary()
"""Results of the mobility analysis by scene."""

_ROWS_LEFT_OUT: WeakKeyDictionary[System, list[int]] = WeakKeyDictionary()
"""Results of `rows_left_out` by equations of motion."""


def mobility(scene: Scene) -> Mobility:
    """Analyze which constraints of a scene are redundant; the result is kept for the scene."""
    if scene not in _MOBILITIES:
        with np.errstate(all="ignore"):  # a run reports overflows
            _MOBILITIES[scene] = _mobility(TreeKinematics(scene))
    return _MOBILITIES[scene]


def constraint_rank(system: System) -> int:
    """Compute the number of independent constraint rows in the equations of motion `system`."""
    return system.nv - mobility(system.scene).degrees_of_freedom


def rows_left_out(system: System) -> list[int]:
    """Select the constraint rows that solvers leave out because they are almost redundant.

    If redundancy is exact, no row is left out: rank decisions up to round-off are then reliable, and solvers
    make them. This package's own forms keep the independent rows of the joint-coordinate form. For another
    engine, a QR factorization with pivoting selects the rows to keep, at the configuration of the largest
    rank.

    Returns:
        Row numbers in `phi` of the system.
    """
    found, count = mobility(system.scene), len(system.phi_units)
    if found.residual == 0.0:
        return []
    if (
        isinstance(system, Formulation) and system.omitted is not None
    ):  # same rows as in the compiled equations
        return system.omitted
    if system not in _ROWS_LEFT_OUT:
        if isinstance(system, Formulation):
            used = system.rows_of(found.independent)
            _ROWS_LEFT_OUT[system] = sorted(set(range(count)) - set(used))
        else:
            q, _ = system.coordinates(regular_state(system.scene))
            _ROWS_LEFT_OUT[system] = dependent_rows(system, q)
    return _ROWS_LEFT_OUT[system]


def regular_state(scene: Scene) -> State:
    """Return the state, at rest, of the largest rank among the configurations that `mobility` examines."""
    found = mobility(scene)
    return found.states[max(range(len(found.states)), key=lambda k: found.configurations[k].rank)]


def dependent_rows(system: System, q: Array) -> list[int]:
    """Select constraint rows that follow from the others, exactly or almost, and leave the others full rank.

    A QR factorization with pivoting selects the rows to keep at coordinates q (nq,).

    Returns:
        Row numbers in `phi` of the system, ascending.
    """
    from scipy.linalg import qr

    _, pivots = qr(dimensionless_jacobian(system, q).T, mode="r", pivoting=True)
    return sorted(pivots[constraint_rank(system) :].tolist())


def loose_tolerance(tolerance: float) -> float:
    """Return the largest residual that an almost redundant constraint may have if its loop counts as closed.

    Args:
        tolerance: dimensionless size below which constraints count as redundant.

    Returns:
        Dimensionless residual: rad, or a length divided by the mechanism's size.
    """
    return max(RESIDUAL_FACTOR * tolerance, CLOSURE_TOLERANCE)


def with_zero_rows(rows: Array, left_out: Sequence[int]) -> Array:
    """Return a copy of an array (k, ...) in which the rows with the given numbers are zero."""
    changed = np.array(rows)
    changed[list(left_out)] = 0.0
    return changed


def inherit_mobility(scene: Scene, of: Scene) -> None:
    """Use for a scene the result of a scene `of` with the same geometry, if `of` has been analyzed."""
    if of in _MOBILITIES:
        _MOBILITIES[scene] = replace(_MOBILITIES[of], between_branches="")  # initial states may differ


def _mobility(system: TreeKinematics) -> Mobility:
    """Analyze the constraints of a system in joint coordinates.

    The independent rows are those of the examined configuration with the largest rank.
    """
    examined, nonzero_rows = _examine(system)
    best = max(examined, key=lambda at: at.rank)
    used, at_rest = best.chosen.rows, np.zeros(system.nv)
    redundant = sorted(nonzero_rows - set(used))
    nearly = tuple(_nearly(system, [at for at in examined if at.rank == len(used)]))
    exactly_redundant = redundant if residual(nearly) == 0.0 else []
    scaled = [ScaledRows(at.rows, at.scales) for at in examined]
    return Mobility(
        degrees_of_freedom=system.nv - len(used),
        independent=used,
        redundant=redundant,
        exchangeable=varying_rows(scaled, used, exactly_redundant),
        nearly=nearly,
        configurations=examined,
        states=[system.state(at.q, at_rest) for at in examined],
        between_branches=_between_branches(system),
    )


def _between_branches(system: TreeKinematics) -> str:
    """Find the joint of a start between branches of motion, see `Mobility`.

    Empty without such a joint, without an initial state, and for mechanisms above `DENSE_LIMIT`.
    """
    if system.scene.initial_state is None or len(system.phi_units) * system.nv > DENSE_LIMIT:
        return ""
    return joint_between_branches(system, *system.coordinates(system.scene.initial_state))


def _nearly(system: TreeKinematics, seen: Sequence[Configuration]) -> Iterator[NearlyRedundant]:
    """Yield almost redundant constraints: the small singular values on both sides of the rank.

    Args:
        system: equations in joint coordinates.
        seen: examined configurations that are not singular.
    """
    # limits up to which the independent part of a redundant row is round-off; configurations other than the
    # initial pose are less exact, because they are results of Newton's method
    initial_q, _ = system.coordinates(State.initial(system.scene.mechanism))
    limits = [MIN_INEXACT if np.array_equal(at.q, initial_q) else MAX_SAMPLE_RESIDUAL for at in seen]
    # independent constraints that may have been redundant by design: a small singular value after a gap, at
    # the configuration where the smallest singular value is largest. A configuration without weak rows shows
    # that all independent constraints are certainly independent
    if all(at.chosen.weak for at in seen):
        spectra = [_spectrum(system, at) for at in seen]
        values, rank, owner = max(spectra, key=lambda each: each.values[each.rank - 1])
        for k in range(1, rank):
            if values[k] < MAX_SUSPECT_VALUE and values[k] * MIN_SUSPECT_GAP < values[k - 1]:
                yield NearlyRedundant(owner(k), values[k], "literally")
    # redundant constraints that are not exactly dependent, at the configuration with the largest independent
    # part (noise) of a dependent row: in some poses the noise of the file's numbers has no effect
    noisiest = max(range(len(seen)), key=lambda k: seen[k].chosen.noise / limits[k])
    if seen[noisiest].chosen.noise > limits[noisiest]:
        values, rank, owner = _spectrum(system, seen[noisiest])
        for k in range(rank, len(values)):
            if values[k] > limits[noisiest]:
                yield NearlyRedundant(owner(k), values[k], "redundant")


class Spectrum(NamedTuple):
    """Singular values of the dimensionless constraint Jacobian at a configuration.

    Attributes:
        values: singular values in descending order. For a Jacobian above `DENSE_LIMIT`, the independent parts
            of its rows instead: first the smallest one of all certainly independent rows, then those of weak
            rows, then the largest ones of dependent rows.
        rank: number of values that belong to independent constraints; the values from `values[rank]` on
            belong to redundant ones.
        owner: function from the index of a value to the joint or coupling with the largest share in the
            constraint.
    """

    values: list[float]
    rank: int
    owner: Callable[[int], str]


def _spectrum(system: TreeKinematics, at: Configuration) -> Spectrum:
    """Compute the singular values at a configuration, or independent parts of rows if there are many."""
    # all singular values of a small Jacobian
    rows, chosen, owners = at.rows, at.chosen, system.row_owners
    if len(rows) * system.nv <= DENSE_LIMIT:
        u, s, _ = singular_values(to_array(rows, system.nv))
        return Spectrum(s.tolist(), at.rank, lambda k: largest_share(owners, u[:, k]))
    # independent parts of the rows of a large Jacobian
    dependent = set(range(len(rows))) - set(chosen.rows)
    parts = {k: remainder(rows, chosen.factor, rows[k]) for k in dependent}
    redundant = sorted(parts, key=lambda k: -parts[k])[:MAX_LISTED]
    row_of_value = [*chosen.weak, *redundant]  # the first value belongs to no single row
    values = [chosen.strong, *chosen.weak.values(), *(parts[k] for k in redundant)]
    return Spectrum(values, 1 + len(chosen.weak), lambda k: owners[row_of_value[k - 1]])


def _examine(system: TreeKinematics) -> tuple[list[Configuration], set[int]]:
    """Examine the initial configuration and other closed configurations.

    Returns:
        The configurations; the numbers of the rows that are nonzero in at least one of them.
    """
    tolerance = system.scene.redundancy_tolerance
    # the initial state of the scene, and the initial pose of the mechanism
    pose = State.initial(system.scene.mechanism)
    q, v = system.coordinates(pose if system.scene.initial_state is None else system.scene.initial_state)
    initial_q, _ = system.coordinates(pose)
    directions = _directions(system, v)
    nonzero_rows: set[int] = set()
    seen: list[Configuration] = []
    for number in range(MAX_CONFIGURATIONS):
        # keep the start, and configurations whose loops are closed
        phi, rows, scales = _scaled(system, q)
        found = independent(rows, tolerance)
        dependent_phi = np.delete(phi, found.rows)
        if number == 0 or (
            largest(phi[found.rows]) < MAX_SAMPLE_RESIDUAL
            and largest(dependent_phi) < max(MAX_SAMPLE_RESIDUAL, RESIDUAL_FACTOR * tolerance)
        ):
            nonzero_rows.update(i for i, row in enumerate(rows) if length(row) > ROW_ROUND_OFF)
            seen.append(Configuration(q, rows, scales, found))
        # stop if the rank is the largest possible, or enough configurations are regular
        best = max(seen, key=lambda at: at.rank)
        if number > 0 and best.rank == len(nonzero_rows):
            break
        regular = sum(at.rank == best.rank for at in seen)
        if number + 1 >= MIN_CONFIGURATIONS and regular >= MIN_REGULAR:
            break
        # next: the initial pose if the start is another one, then neighbors of the best configuration
        starts_elsewhere = number == 0 and not np.array_equal(initial_q, q)
        q = initial_q if starts_elsewhere else _neighbor(system, best.q, next(directions))
    return seen, nonzero_rows


def _scaled(system: TreeKinematics, q: Array) -> tuple[Array, Rows, Array]:
    """Compute scaled constraint residuals and Jacobian rows at q (nq,).

    `phi_units` and `velocity_units` are the mechanism's size, m, for lengths, and 1 for angles.

    Returns:
        Residuals (k,) and sparse rows, dimensionless and divided by their natural magnitudes; the magnitudes
        (k,), see `newton_euler.equations.kinematics.TreeKinematics.row_scales`.
    """
    phi, jacobian = system.phi_and_jacobian(q)
    natural = system.row_scales(q)
    units, scales = system.velocity_units, system.phi_units * natural
    rows = [
        {k: x * units[k] / scale for k, x in row.items()} for row, scale in zip(jacobian, scales, strict=True)
    ]
    return phi / scales, rows, natural


def _directions(system: TreeKinematics, v: Array) -> Iterator[Array]:
    """Yield directions (nv,) of about unit size to other configurations: the initial velocity, then random.

    A direction is in the units of v times s. At a singular configuration a random step leaves all branches
    of motion, and Newton's method returns to a point too close to the singular one. The initial velocity is
    tangent to a branch.
    """
    speed = np.max(np.abs(v / system.velocity_units), initial=0.0)
    if speed > 0.0:
        yield v / speed
    rng = np.random.default_rng(0)
    while True:
        yield system.velocity_units * rng.uniform(-1.0, 1.0, system.nv)


def _neighbor(system: TreeKinematics, q: Array, direction: Array) -> Array:
    """Find another configuration q (nq,) that closes the independent constraints.

    Args:
        system: equations in joint coordinates.
        q: (nq,) closed configuration to start from.
        direction: (nv,) direction of about unit size; the step has the size `SAMPLE_DISTANCE`.
    """
    tolerance, unit = system.scene.redundancy_tolerance, system.velocity_units
    # a step along the direction, projected onto the tangent space: its change of the residuals is undone
    step = SAMPLE_DISTANCE * direction
    _, rows, _ = _scaled(system, q)
    phi_change = np.array([sum(x * step[k] / unit[k] for k, x in row.items()) for row in rows])
    correction = least_step(rows, independent(rows, tolerance).factor, phi_change, system.nv)
    q = system.retract(q, step - unit * correction)
    # minimum-norm Newton steps back to the closed configurations
    for _ in range(MAX_NEIGHBOR_STEPS):
        phi, rows, _ = _scaled(system, q)
        chosen = independent(rows, tolerance)
        if largest(phi[chosen.rows]) < 0.01 * MAX_SAMPLE_RESIDUAL:
            break
        q = system.retract(q, -unit * least_step(rows, chosen.factor, phi, system.nv))
    return q
