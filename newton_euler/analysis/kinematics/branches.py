"""Assembly branches: all poses of a mechanism for given coordinates, found from random configurations.

Given joint coordinates and directions of an axis are called goals. A `Chain` is a mechanism with the joint
coordinates that have goals or are to be measured. `Configurations` are n poses of a chain, evaluated by its
compiled `function`. A pose is a vector of coordinates of the spanning tree: the mechanism without the joints
that close loops.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from newton_euler.analysis.kinematics.configurations import Axis, Chain, Configurations, Goal
from newton_euler.analysis.kinematics.continuation import (
    RANDOM_STEPS,
    newton,
    random_coordinates,
    reachable,
)
from newton_euler.analysis.kinematics.poses import Poses, goals_of, needed_goals, poses_of
from newton_euler.arguments import checked
from newton_euler.errors import OptionError
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array

SAMPLES = 500
"""Number of random configurations that are solved at a time, at least twice."""

MAX_SAMPLES = 5_000
"""Largest number of random configurations."""

MIN_HITS = 5
"""Number of times that each branch must be found before the search ends. A branch that is as likely as the
others is then missed with a probability of exp(-5)."""

SAME_POSE = 1e-4
"""Distance of vectors of `_features` below which two poses are the same.

The value is large because poses at singular configurations (double roots) are accurate to half of all digits
only."""

MIN_DETERMINANT = 1e-5
"""Dimensionless determinant below which a branch is at a singular configuration."""


@dataclass(frozen=True, eq=False)
class Branches:
    """Assembly branches of a mechanism for the same goals, the nearest to the start first.

    Attributes:
        poses: poses of the branches, all of which meet the goals. `Poses.reached` is True for the pose on the
            branch of the start; `Poses.beyond` for the others: the start reaches them only through a singular
            configuration, or not at all.
        labels: number of the branch, and a sign for each of `blocks`, the sign of the determinant of its
            equations: `+` as at the start, `-` beyond a singular configuration, `0` at one. For planar loops
            the signs distinguish elbow up and elbow down.
        blocks: for each block of equations that are solved together, the names of the joints that they
            determine; without blocks whose determinants are equal in all branches.
        found: (n,) number of random configurations that converged to each branch.
        complete: True if each branch was found at least 5 times, so that further branches are
            unlikely.
        scattered: number of random configurations that converged to singular configurations found fewer than
            5 times: points of continuous families of poses, where goals do not determine the pose.

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

    Newton's method starts from random configurations until each branch was found 5 times. If the
    goals cannot be met, the result has no branch; `solve_poses` finds the nearest pose then.

    Args:
        scene: gives the mechanism, and the start that branches are compared with.
        coordinates: one value for each joint coordinate, m or rad from the initial pose, by name of the
            joint, or by (name, number) for joints of several coordinates.
        axis: axis of a body.
        towards: (3,) direction that the axis points in, world frame. The number of coordinates, plus 2 for
            the axis, must be the number of degrees of freedom.
        measure: other joint coordinates to return.
        start: pose of the branch that comes first; the scene's initial state if None.

    Raises:
        OptionError: for too few or too many goals, or for several values.
        UnknownNameError: for an unknown joint or body.
        MechanismError: for values that are not finite, and for a joint without such a coordinate.

    Examples:
        >>> found = assembly_branches(load("slider_crank"), {"pivot": 0.3}, measure=("guide",))
        >>> # the slider on either side of the crank, and the rod in two rotations about its own line
        >>> print(found.labels, found.poses.coordinates["guide"].round(3))
        ('0 +', '1 -', '2 -', '3 +') [ 0.014  0.014 -0.414 -0.414]
    """
    chain, names, goal = goals_of(scene, coordinates, axis, towards, measure, start)
    goal_rows = chain.goal_count + 2 * chain.has_axis_goal
    if goal_rows != chain.freedoms:
        raise OptionError("number of goals", goal_rows, f"{needed_goals(chain)}; an axis counts as two")
    if len(goal.coordinates) > 1:
        raise OptionError(
            "number of values", len(goal.coordinates), "one of each coordinate, and one direction"
        )
    # poses from random configurations; the same goal for each
    configs, hits = _search(chain, goal)
    begin, goals = chain.at(chain.start[None]), goal[np.zeros(len(hits), dtype=int)]
    # blocks of equations whose determinant differs between branches, and its sign relative to the start
    blocks = _blocks(chain, configs, goals) if len(configs) else []
    determinants = _determinants(configs, goals, blocks)
    varies = np.zeros(len(blocks), dtype=bool)
    if len(configs) > 1:
        varies = np.ptp(determinants, axis=0) > MIN_DETERMINANT
    blocks = [block for block, block_varies in zip(blocks, varies, strict=True) if block_varies]
    start_signs = np.sign(_determinants(begin, chain.goal_at(begin), blocks))
    signs = np.sign(determinants[:, varies]) * np.where(start_signs == 0.0, 1.0, start_signs)
    signs[np.abs(determinants[:, varies]) < MIN_DETERMINANT] = 0.0
    # leave out points of continuous families; sort by the distance to the start
    is_scattered = (hits < MIN_HITS) & np.any(signs == 0.0, axis=1)
    order = _order(configs, begin)
    order = order[~is_scattered[order]]
    sign_texts = ["".join("-0+"[int(sign) + 1] for sign in signs[row]) for row in order]
    labels = tuple(f"{k} {text}" for k, text in enumerate(sign_texts))
    configs = configs[order]
    # all poses meet their goals; the start reaches one of them on its own branch
    on_branch = reachable(begin, configs) if len(configs) else np.zeros(0, dtype=bool)
    return Branches(
        poses=poses_of(configs, goals[order], names, reached=on_branch, beyond=~on_branch),
        labels=labels,
        blocks=tuple(_joints(chain, columns) for _, columns in blocks),
        found=hits[order],
        complete=bool(np.all(hits[~is_scattered] >= MIN_HITS)),
        scattered=int(np.sum(hits[is_scattered])),
    )


def _search(chain: Chain, goal: Goal) -> tuple[Configurations, Array]:
    """Find the different configurations that meet a goal.

    Returns:
        The n configurations; how many random configurations converged to each, (n,).
    """
    rng = np.random.default_rng(0)
    # one row per branch: results of the chain's function, features, and number of hits
    branches, features = np.zeros((0, chain.function.outputs)), np.zeros((0, 0))
    hits = np.zeros(0, dtype=int)
    for tried in range(SAMPLES, MAX_SAMPLES + 1, SAMPLES):
        q = random_coordinates(chain, SAMPLES, rng)
        configs, met = newton(chain.at(q), goal[np.zeros(SAMPLES, dtype=int)], RANDOM_STEPS)
        for values, feature in zip(configs.values[met], _features(configs)[met], strict=True):
            distance = np.linalg.norm(features - feature, axis=1) if len(features) else np.full(1, np.inf)
            nearest = int(np.argmin(distance))
            if distance[nearest] < SAME_POSE:
                hits[nearest] += 1
            else:
                branches = np.vstack([branches, values])
                features = np.vstack([features.reshape(-1, len(feature)), feature])
                hits = np.append(hits, 1)
        if tried > SAMPLES and np.all(hits >= MIN_HITS):
            break
    return Configurations(chain, branches), hits


def _features(configs: Configurations) -> Array:
    """Compute vectors (n, 19 b) whose distances compare poses.

    For each of b bodies: the position (3) in sizes of the mechanism, and the products (16) of the
    quaternion's components. The products are the same for a quaternion and its negative.
    """
    positions = configs.position / configs.chain.scene.mechanism.size
    products = configs.quaternion[..., None] * configs.quaternion[..., None, :]
    bodies = positions.shape[1]
    return np.hstack([positions.reshape(-1, 3 * bodies), products.reshape(-1, 16 * bodies)])


def _order(configs: Configurations, begin: Configurations) -> Array:
    """Return the indices (n,) that sort configurations by their distance to the start.

    Mirror images at equal distance are sorted by their poses.
    """
    features = _features(configs)
    distance = np.linalg.norm(features - _features(begin), axis=1)
    return np.lexsort((*features.T[::-1].round(3), distance.round(3)))


def _matrix(configs: Configurations, goal: Goal) -> Array:
    """Return the square Jacobian (n, nv, nv) of independent loop equations and goals."""
    loop_rows, goal_rows = configs.jacobian[:, configs.chain.independent], configs.goal_errors(goal)[1]
    return np.concatenate([loop_rows, goal_rows], axis=1)


def _blocks(chain: Chain, configs: Configurations, goal: Goal) -> list[tuple[Array, Array]]:
    """Find rows and columns of the irreducible diagonal blocks of the Jacobian, without blocks of goals.

    Source: block triangular form of A. Pothen, C.-J. Fan, ACM Transactions on Mathematical Software 16(4),
    1990. The matrix has independent loop equations first, then goals. A goal that is a block by itself only
    sets a coordinate.
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components, maximum_bipartite_matching

    pattern = np.any(_matrix(configs, goal) != 0.0, axis=0)  # nonzero in some of the configurations
    columns = maximum_bipartite_matching(csr_array(pattern), perm_type="column")
    _, block_of_row = connected_components(csr_array(pattern[:, columns]), connection="strong")
    first_goal = len(chain.independent)
    row_sets = [np.flatnonzero(block_of_row == block) for block in np.unique(block_of_row)]
    kept = [rows for rows in row_sets if len(rows) > 1 or rows[0] < first_goal]
    return sorted(((rows, columns[rows]) for rows in kept), key=lambda block: int(np.min(block[1])))


def _determinants(configs: Configurations, goal: Goal, blocks: list[tuple[Array, Array]]) -> Array:
    """Compute the determinants (n, blocks) of the blocks of the Jacobian."""
    matrix = _matrix(configs, goal)
    determinants = [np.linalg.det(matrix[:, rows[:, None], columns]) for rows, columns in blocks]
    return np.stack(determinants, axis=1) if determinants else np.zeros((len(configs), 0))


def _joints(chain: Chain, columns: Array) -> tuple[str, ...]:
    """Return the names of the joints that velocities of the spanning tree, given by indices, belong to."""
    tree = chain.system.tree
    return tuple(
        tree.joint(each.joint).name
        for each in tree.joints
        if np.any((each.v.start <= columns) & (columns < each.v.stop))
    )
