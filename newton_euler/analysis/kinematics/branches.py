"""Assembly branches: all poses of a mechanism for given coordinates, found from random configurations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from newton_euler.analysis.kinematics.configurations import Axis, Chain, Configurations, Goal
from newton_euler.analysis.kinematics.continuation import RANDOM_STEPS, newton, random_coordinates
from newton_euler.analysis.kinematics.poses import Poses, goals_of, poses_of
from newton_euler.arguments import checked
from newton_euler.errors import OptionError
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array

SAMPLES = 500
"""Number of random configurations that are solved at a time."""

MAX_SAMPLES = 5_000
"""Largest number of random configurations."""

MIN_HITS = 5
"""Number of times that each branch must be found before the search ends. A branch that is as likely as the
others is then missed with a probability of exp(-5)."""

SAME_POSE = 1e-4
"""Distance below which two poses are the same; positions in sizes of the mechanism, and quaternions. Poses at
singular configurations (double roots) have half of all digits."""

MIN_DETERMINANT = 1e-5
"""Dimensionless determinant below which a branch is at a singular configuration."""


@dataclass(frozen=True, eq=False)
class Branches:
    """Assembly branches of a mechanism for the same goals, the nearest to the start first.

    Attributes:
        poses: poses of the branches.
        labels: number of the branch, and a sign for each of `blocks`, the sign of the determinant of its
            equations: `+` as at the start, `-` beyond a singular configuration, `0` at one. For planar loops
            the signs distinguish elbow up and elbow down.
        blocks: names of the joints that are solved together, for each block of equations.
        found: (n,) number of random configurations that converged to each branch.
        complete: True if each branch was found often, so that further branches are unlikely.
        scattered: number of random configurations that converged to rarely found singular configurations:
            points of continuous families, where goals do not determine the pose.

    Examples:
        >>> found: Branches = assembly_branches(load("four_bar"), {"pivot_0": 0.3})
        >>> found.labels, found.blocks
        (('0 ++', '1 +-', '2 -0'), (('pivot_1', 'hinge_0'), ('pivot_2', 'hinge_1')))
    """

    poses: Poses
    labels: tuple[str, ...]
    blocks: tuple[tuple[str, ...], ...]
    found: Array
    complete: bool
    scattered: int

    def __repr__(self) -> str:
        return f"<Branches: {', '.join(map(repr, self.labels))}, complete: {self.complete}>"

    def __len__(self) -> int:
        return len(self.labels)


@checked
def assembly_branches(
    scene: Scene,
    coordinates: Mapping[str | Key, Any] | None = None,
    axis: Axis | None = None,
    towards: Any = None,
    measure: tuple[str | Key, ...] = (),
    start: State | None = None,
) -> Branches:
    """Find all assembly branches of a mechanism for given joint coordinates, or for the direction of an axis.

    From random configurations, by Newton's method, until each branch was found often. There is none where the
    goals cannot be met; `solve_poses` finds the nearest pose then.

    Args:
        scene: gives the mechanism, and the start that branches are compared with.
        coordinates: one value for each joint coordinate, as of `solve_poses`.
        axis: of a body.
        towards: (3,) where the axis is to point. Coordinates, and two for the axis, are to be as many as the
            mechanism has degrees of freedom.
        measure: other joint coordinates that are asked for.
        start: pose of the branch that comes first; the scene's own if None.

    Raises:
        OptionError: for goals that leave freedom or are too many, or for several values.
        UnknownNameError: for an unknown joint or body.
        MechanismError: for values that are no finite numbers, and for a joint without such a coordinate.

    Examples:
        >>> found = assembly_branches(load("slider_crank"), {"pivot": 0.3}, measure=("guide",))
        >>> print(found.labels, found.poses.coordinates["guide"].round(3))
        ('0 +', '1 -', '2 -', '3 +') [ 0.014  0.014 -0.414 -0.414]
    """
    chain, names, goal = goals_of(scene, coordinates, axis, towards, measure, start)
    rows = chain.goal_count + 2 * chain.has_axis_goal
    if rows != chain.freedoms:
        needed = f"as many as degrees of freedom, {chain.freedoms}; an axis counts as two"
        raise OptionError("number of goals", rows, needed)
    if len(goal.coordinates) > 1:
        raise OptionError(
            "number of values", len(goal.coordinates), "one of each coordinate, and one direction"
        )
    # poses from random configurations
    at, found = _search(chain, goal)
    begin, goals = chain.at(chain.start[None]), goal[np.zeros(len(found), dtype=int)]
    # blocks of equations whose determinant differs between branches, and its sign relative to the start
    blocks = _blocks(chain, at, goals) if len(at) else []
    determinants = _determinants(at, goals, blocks)
    varied = (
        np.ptp(determinants, axis=0) > MIN_DETERMINANT if len(at) > 1 else np.zeros(len(blocks), dtype=bool)
    )
    blocks = [block for block, kept in zip(blocks, varied, strict=True) if kept]
    reference = np.sign(_determinants(begin, chain.goal_at(begin), blocks))
    signs = np.sign(determinants[:, varied]) * np.where(reference == 0.0, 1.0, reference)
    signs[np.abs(determinants[:, varied]) < MIN_DETERMINANT] = 0.0
    # leave out points of continuous families; sort by the distance to the start
    alone = (found < MIN_HITS) & np.any(signs == 0.0, axis=1)
    order = _order(at, begin)
    order = order[~alone[order]]
    labels = [f"{k} " + "".join("-0+"[int(sign) + 1] for sign in signs[row]) for k, row in enumerate(order)]
    at = at[order]
    every = np.ones(len(at), dtype=bool)
    return Branches(
        poses_of(at, goals[order], names, every, ~every),
        tuple(labels),
        tuple(_joints(chain, columns) for _, columns in blocks),
        found[order],
        bool(np.all(found[~alone] >= MIN_HITS)),
        int(np.sum(found[alone])),
    )


def _search(chain: Chain, goal: Goal) -> tuple[Configurations, Array]:
    """Find the configurations that meet a goal, and how many random configurations converged to each."""
    rng = np.random.default_rng(0)
    branches, features, found = (
        np.zeros((0, chain.function.outputs)),
        np.zeros((0, 0)),
        np.zeros(0, dtype=int),
    )
    for tried in range(SAMPLES, MAX_SAMPLES + 1, SAMPLES):
        q = random_coordinates(chain, SAMPLES, rng)
        at, met = newton(chain.at(q), goal[np.zeros(SAMPLES, dtype=int)], RANDOM_STEPS)
        for values, feature in zip(at.values[met], _features(at)[met], strict=True):
            distance = np.linalg.norm(features - feature, axis=1) if len(features) else np.full(1, np.inf)
            nearest = int(np.argmin(distance))
            if distance[nearest] < SAME_POSE:
                found[nearest] += 1
            else:
                branches = np.vstack([branches, values])
                features = np.vstack([features.reshape(-1, len(feature)), feature])
                found = np.append(found, 1)
        if tried > SAMPLES and np.all(found >= MIN_HITS):
            break
    return Configurations(chain, branches), found


def _features(at: Configurations) -> Array:
    """Compute vectors (n, 19 b) whose distances compare poses.

    For each body: the position in sizes of the mechanism, and the products of the quaternion's components.
    The products are the same for a quaternion and its negative.
    """
    positions = at.position / at.chain.scene.mechanism.size
    turns = at.quaternion[..., None] * at.quaternion[..., None, :]
    bodies = positions.shape[1]
    return np.hstack([positions.reshape(-1, 3 * bodies), turns.reshape(-1, 16 * bodies)])


def _order(at: Configurations, begin: Configurations) -> Array:
    """Sort configurations by their distance to the start; mirror images at equal distance by their poses."""
    features = _features(at)
    distance = np.linalg.norm(features - _features(begin), axis=1)
    return np.lexsort((*features.T[::-1].round(3), distance.round(3)))


def _matrix(at: Configurations, goal: Goal) -> Array:
    """Return the square Jacobian (n, nv, nv) of independent loop equations and goals."""
    return np.concatenate([at.jacobian[:, at.chain.independent], at.goal_errors(goal)[1]], axis=1)


def _blocks(chain: Chain, at: Configurations, goal: Goal) -> list[tuple[Array, Array]]:
    """Find rows and columns of the irreducible diagonal blocks of the Jacobian, without blocks of goals.

    Block triangular form of A. Pothen, C.-J. Fan, ACM Transactions on Mathematical Software 16(4), 1990.
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components, maximum_bipartite_matching

    pattern = np.any(_matrix(at, goal) != 0.0, axis=0)
    columns = maximum_bipartite_matching(csr_array(pattern), perm_type="column")
    _, owner = connected_components(csr_array(pattern[:, columns]), connection="strong")
    first_goal = len(chain.independent)
    found = [np.flatnonzero(owner == block) for block in np.unique(owner)]
    chosen = [rows for rows in found if len(rows) > 1 or rows[0] < first_goal]
    return sorted(((rows, columns[rows]) for rows in chosen), key=lambda block: int(np.min(block[1])))


def _determinants(at: Configurations, goal: Goal, blocks: list[tuple[Array, Array]]) -> Array:
    """Compute the determinants (n, blocks) of the blocks of the Jacobian."""
    matrix = _matrix(at, goal)
    found = [np.linalg.det(matrix[:, rows[:, None], columns]) for rows, columns in blocks]
    return np.stack(found, axis=1) if found else np.zeros((len(at), 0))


def _joints(chain: Chain, columns: Array) -> tuple[str, ...]:
    """Return the names of the joints that velocities, given by columns, belong to."""
    tree = chain.system.tree
    return tuple(
        tree.joint(kept.joint).name
        for kept in tree.joints
        if np.any((kept.v.start <= columns) & (columns < kept.v.stop))
    )
