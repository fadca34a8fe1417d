"""Find configurations that meet goals, or come nearest to goals out of reach.

Goals are values of joint coordinates and directions of an axis. `follow` moves from the start to all goals by
continuation: Newton's method with steps of least length begins at the nearest configuration that is solved
already. For goals that `follow` does not reach, `approach` minimizes the distance to the goal over all
configurations with closed loops. It uses Newton's method in the tangent space (J. Nocedal, S. J. Wright,
Numerical Optimization, 2nd ed., 2006, sections 3.4 and 15.4), from the nearest of many configurations.

`Configurations` are n vectors of joint coordinates of a `Chain`, a mechanism with chosen joint coordinates.
The tangent space at a configuration has the f dimensionless velocities that leave its loops closed, where f
is the number of degrees of freedom. Lengths are divided by the size of the mechanism: the largest distance of
joint points and centers of mass from their mean. An assembly branch is a set of configurations that the
mechanism can reach from each other without passing a singular configuration.
"""

from __future__ import annotations

import numpy as np

from newton_euler.analysis.kinematics.configurations import (
    MAX_JOINT_STEP,
    Chain,
    Configurations,
    Goal,
    products,
)
from newton_euler.analysis.kinematics.steps import (
    continues,
    crosses_singular_loops,
    crossing_signs,
    distances,
    stays_on_branch,
)
from newton_euler.equations.dense import RANK_TOLERANCE
from newton_euler.scalars import Array

MAX_STRIDE = 0.25
"""Largest distance between a goal and the solved configuration from which Newton's method starts: rad, or
lengths divided by the size of the mechanism."""

MIN_STRIDE_FRACTION = 2.0**-10
"""Shortest stride, as a fraction of the first one. Strides whose ends leave the branch are halved."""

SINGULAR_LOOPS = 1e-6
"""Smallest singular value of the dimensionless Jacobian of the loops in configurations from which strides
start. Where loops lose rank, steps of Newton's method have no direction."""

MAX_STRIDES = 1000
"""Largest number of strides (solved intermediate goals) from the start to a goal. Farther goals get longer
strides."""

GOAL_STEPS = 12
"""Largest number of Newton steps from a solved pose near the goal."""

RANDOM_STEPS = 60
"""Largest number of Newton steps from a random configuration."""

RESIDUAL_ROUND_OFF = 16.0 * np.finfo(float).eps
"""Dimensionless residual below which residuals are round-off."""

MAX_RESIDUAL = 1e-11
"""Largest dimensionless residual of a configuration that meets its goal. Newton's method continues below this
residual only while each step at least halves the residual."""

MAX_APPROACH_STEPS = 60
"""Number of steps to the pose nearest to a goal out of reach."""

DIFFERENCE_STEP = 1e-5
"""Dimensionless step h of central differences: the errors h^2 and (round-off / h) are about equal."""

MIN_CURVATURE = 1e-9
"""Smallest curvature (eigenvalue of the Hessian) by which a gradient is divided in a Newton step."""

MAX_HALVINGS = 8
"""Number of times that a step is halved until it reduces the distance to the goal."""

MAX_CHORD_STEPS = 15
"""Number of steps that close loops by the Jacobian of another configuration (chord method)."""

DISTANCE_ROUND_OFF = 1e-12
"""Relative change of a squared distance that is round-off."""

SAME_CONFIGURATION = 1e-4
"""Distance, rad or sizes of the mechanism, below which two configurations are the same. Configurations that
are nearly singular have half of all digits only."""

NEAR_SAMPLES = 16
"""Number of samples of a branch from which a configuration is approached."""

PATHS = 64
"""Number of random paths that sample an assembly branch."""

PATH_STEPS = 20
"""Number of steps along each random path."""


def newton(configs: Configurations, goal: Goal, steps: int = GOAL_STEPS) -> tuple[Configurations, Array]:
    """Move n configurations to goals by Newton steps of least length.

    A step has two parts: the shortest step that closes the loops in first order; and the shortest step in the
    tangent space of the loops that then meets the goals in first order.

    Args:
        configs: configurations to begin with.
        goal: one goal for each configuration.
        steps: largest number of steps.

    Returns:
        The configurations, and True (n,) for those that meet their goals with closed loops.
    """
    values, error = configs.values.copy(), np.full(len(configs), np.inf)
    # the configurations that still move, and their numbers
    active, here = np.arange(len(configs)), configs
    for _ in range(steps):
        # store the configurations; select those that need another step
        goal_errors, rows = here.goal_errors(goal[active])
        new_error = largest(here.phi, goal_errors)
        improves = (new_error >= MAX_RESIDUAL) | (new_error < 0.5 * error[active])
        needs_step = (new_error >= RESIDUAL_ROUND_OFF) & improves
        values[active], error[active] = here.values, new_error
        if not needs_step.any():
            break
        active, here = active[needs_step], here[needs_step]
        goal_errors, rows = goal_errors[needs_step], rows[needs_step]
        # one step of these: close the loops, then meet the goals along the tangent space
        closing_step = products(here.loop_inverse, -here.phi)
        reduced = rows @ np.swapaxes(here.tangent, 1, 2)
        remaining = -goal_errors - products(rows, closing_step)
        along = products(np.linalg.pinv(reduced, RANK_TOLERANCE), remaining)
        here = here.step_by(closing_step + products(np.swapaxes(here.tangent, 1, 2), along))
    return Configurations(configs.chain, values), error < MAX_RESIDUAL


def largest(*residuals: Array) -> Array:
    """Find the largest magnitudes (n,) of dimensionless residuals (n, k) each."""
    return np.max(np.abs(np.hstack(residuals)), axis=1, initial=0.0)


def _goal_step(configs: Configurations, goal: Goal) -> Array:
    """Compute the shortest dimensionless tangent steps (n, nv) that meet goals in first order."""
    goal_errors, rows = configs.goal_errors(goal)
    inverse = np.linalg.pinv(rows @ np.swapaxes(configs.tangent, 1, 2), RANK_TOLERANCE)
    return products(np.swapaxes(configs.tangent, 1, 2), products(inverse, -goal_errors))


def follow(start: Configurations, goal: Goal) -> tuple[Configurations, Array, Array]:
    """Move one configuration to each of n goals by continuation from the nearest solved goal.

    A goal far from all solved goals is approached in strides along a straight line.

    Returns:
        Configurations; a goal that is not reached has the nearest solved one. True (n,) for goals that are
        reached without a jump, and without a change of sign of the determinants of `crossing_signs`. True
        (n,) for goals that the path reaches through a configuration in which loops lose rank.
    """
    from scipy.spatial import cKDTree

    chain, count = start.chain, len(goal.coordinates)
    # solved configurations and the goals that they meet, at first the start alone
    solved, solved_goals = start.values, chain.goal_at(start)
    solved_beyond = np.zeros(1, dtype=bool)
    # for each goal: the configuration so far, a point in a Euclidean space in which angles are points on
    # circles, and the number of the solved goal from which it was last tried
    values = np.repeat(start.values, count, axis=0)
    points, tried, reached = chain.embed(goal), np.full(count, -1), np.zeros(count, dtype=bool)
    beyond = np.zeros(count, dtype=bool)
    # length of a stride for each goal
    start_distance = np.linalg.norm(points - chain.embed(solved_goals), axis=1)
    first_stride = np.maximum(MAX_STRIDE, start_distance / MAX_STRIDES)
    stride = first_stride.copy()
    while not reached.all():
        # goals whose nearest solved goal is new; those within one stride first
        waiting = np.flatnonzero(~reached)
        distance, nearest = cKDTree(chain.embed(solved_goals)).query(points[waiting])
        has_new_source = nearest != tried[waiting]
        is_near = has_new_source & (distance <= stride[waiting])
        selected = is_near if is_near.any() else has_new_source
        if not selected.any():
            break
        # a stride from the nearest solved goal towards each of these goals
        numbers, source, distance = waiting[selected], nearest[selected], distance[selected]
        fraction = np.minimum(1.0, stride[numbers] / np.maximum(distance, stride[numbers]))
        intermediate = chain.between(goal[numbers], solved_goals[source], fraction)
        before = Configurations(chain, solved[source])
        after, met = newton(before, intermediate)
        follows = continues(before, after, _goal_step(before, intermediate))
        follows &= np.all(crossing_signs(before, after) > 0.0, axis=1)
        crosses = crosses_singular_loops(before, after)
        # a stride that leaves the branch is tried again at half the length; the last one may pass a
        # configuration in which loops lose rank
        is_long = stride[numbers] > MIN_STRIDE_FRACTION * first_stride[numbers]
        # one that ends where loops lose rank is shortened, unless its goal is there
        is_singular = after.weakest_loop < SINGULAR_LOOPS
        again = met & is_long & (~follows | crosses | (is_singular & (fraction < 1.0)))
        met &= follows & ~again
        stride[numbers[again]] = 0.5 * np.minimum(stride[numbers], distance)[again]
        stride[numbers[met]] = np.minimum(2.0 * stride[numbers[met]], first_stride[numbers[met]])
        # the ends of strides are solved goals from now on, from which others start if loops keep their rank
        tried[numbers[~again]] = source[~again]
        values[numbers] = np.where(met[:, None], after.values, before.values)
        reached[numbers] = met & (fraction == 1.0)
        is_beyond = solved_beyond[source] | crosses
        beyond[numbers] = is_beyond
        starts = met & ~is_singular
        solved = np.concatenate([solved, after.values[starts]])
        solved_beyond = np.concatenate([solved_beyond, is_beyond[starts]])
        solved_goals = solved_goals.with_others(intermediate[starts])
    return Configurations(chain, values), reached, beyond & reached


def reachable(start: Configurations, configs: Configurations) -> Array:
    """Return True (n,) for configurations that the start reaches without passing a singular configuration.

    The goals of the chain must determine its pose. Each configuration is approached from the start along a
    straight line of goals, and then from samples of the start's branch that are near.

    Args:
        start: one configuration.
        configs: n configurations with closed loops.
    """
    from scipy.spatial import cKDTree

    chain = start.chain
    # a determinant of the other sign lies beyond a singular configuration for sure, if no rows of the loops
    # are redundant; goals of an axis are left to the search
    candidates = np.arange(len(configs))
    if len(chain.independent) == len(chain.closing) and not chain.has_axis_goal:
        candidates = np.flatnonzero(_signs(configs) * _signs(start) >= 0.0)
    same = np.zeros(len(configs), dtype=bool)
    if not candidates.size:
        return same
    goal = chain.goal_at(configs)
    found, reached, beyond = follow(start, goal[candidates])
    same[candidates] = reached & ~beyond & (distances(found, configs[candidates]) < SAME_CONFIGURATION)
    missed = candidates[~same[candidates]]
    if missed.size:
        # Newton's method to each from several samples at once
        samples = sample_branch(start)
        tree = cKDTree(chain.embed(chain.goal_at(samples)))
        count = min(NEAR_SAMPLES, len(samples))
        _, nearest = tree.query(chain.embed(goal[missed]), k=count)
        rows, before = np.repeat(missed, count), samples[np.ravel(nearest)]
        after, met = newton(before, goal[rows])
        met &= stays_on_branch(before, after, _goal_step(before, goal[rows]))
        met &= distances(after, configs[rows]) < SAME_CONFIGURATION
        same[missed] = met.reshape(-1, count).any(axis=1)
    return same


def _signs(configs: Configurations) -> Array:
    """Compute the signs (n,) of the determinant of loop equations and coordinates with goals."""
    chain = configs.chain
    rows = configs.jacobian[:, chain.independent], configs.coordinate_jacobian[:, : chain.goal_count]
    return np.asarray(np.sign(np.linalg.det(np.concatenate(rows, axis=1))))


def random_coordinates(chain: Chain, count: int, rng: np.random.Generator) -> Array:
    """Draw random coordinates (count, nq) of the spanning tree, whose loops are open.

    Angles and orientations are arbitrary, slides are at most two sizes of the mechanism from the start.
    """
    q = np.repeat(chain.start[None], count, axis=0)
    for motion, on_q, _ in chain.system.tree.motions:
        shape = count, on_q.stop - on_q.start
        if motion.kind == "ball":
            drawn = rng.standard_normal(shape)
            q[:, on_q] = drawn / np.linalg.norm(drawn, axis=1, keepdims=True)
        else:
            reach = np.pi if motion.kind == "hinge" else 2.0 * chain.scene.mechanism.size
            q[:, on_q] = rng.uniform(-reach, reach, shape)
    return q


def sample_branch(start: Configurations) -> Configurations:
    """Sample the branch of a closed configuration by random paths that cross no singular configuration."""
    rng, chain = np.random.default_rng(0), start.chain
    here = Configurations(chain, np.repeat(start.values, PATHS, axis=0))
    visited = [start.values]
    for _ in range(PATH_STEPS):
        # `step_by` shortens steps with a component above `MAX_JOINT_STEP`
        along = rng.standard_normal((PATHS, chain.freedoms))
        step = MAX_JOINT_STEP * products(np.swapaxes(here.tangent, 1, 2), along)
        after = moved_closed(here, step)
        on_branch = (largest(after.phi) < MAX_RESIDUAL) & stays_on_branch(here, after, step)
        here = Configurations(chain, np.where(on_branch[:, None], after.values, here.values))
        visited.append(after.values[on_branch])
    return Configurations(chain, np.concatenate(visited))


def approach(configs: Configurations, others: Configurations, goal: Goal) -> tuple[Configurations, Array]:
    """Minimize the distances of closed configurations to goals that are out of reach.

    Args:
        configs: (n) configurations to start from.
        others: configurations of the branch; the nearest to a goal replaces a start that is farther away.
        goal: (n) goals.

    Returns:
        The nearest configurations, and signs (n, 2): -1.0 where a singular configuration was passed, see
        `crossing_signs`, else 1.0.
    """
    from scipy.spatial import cKDTree

    # start at a nearer configuration of the branch if there is one
    chain = configs.chain
    _, nearest = cKDTree(chain.embed(chain.goal_at(others))).query(chain.embed(goal))
    other = others[nearest]
    nearer = half_square(other, goal) < half_square(configs, goal)
    values, signs = np.where(nearer[:, None], other.values, configs.values), np.ones((len(configs), 2))
    active = np.arange(len(configs))  # numbers of the configurations that still come nearer
    for _ in range(MAX_APPROACH_STEPS):
        # a Newton step of the distance in the tangent space
        if not active.size or not chain.freedoms:
            break
        here, active_goal = Configurations(chain, values[active]), goal[active]
        along = _newton_step(here, active_goal)
        # halve the step until the closed configuration is nearer to the goal
        has_moved = np.zeros(len(here), dtype=bool)
        for k in range(MAX_HALVINGS):
            trying = np.flatnonzero(~has_moved)
            if not trying.size:
                break
            before = here[trying]
            step = 0.5**k * products(np.swapaxes(before.tangent, 1, 2), along[trying])
            after = moved_closed(before, step)
            better = _is_better(after, before, active_goal[trying]) & continues(before, after, step)
            improved = active[trying[better]]
            signs[improved] = np.minimum(signs[improved], crossing_signs(before[better], after[better]))
            signs[improved[crosses_singular_loops(before[better], after[better])]] = -1.0
            values[improved] = after.values[better]
            has_moved[trying[better]] = True
        active = active[has_moved]
    return Configurations(chain, values), signs


def half_square(configs: Configurations, goal: Goal) -> Array:
    """Compute half the squared dimensionless distances (n,) to goals."""
    return 0.5 * np.sum(configs.goal_errors(goal)[0] ** 2, axis=1)


def gradient(configs: Configurations, goal: Goal) -> Array:
    """Compute the gradients (n, nv) of half the squared distances to goals, dimensionless."""
    goal_errors, rows = configs.goal_errors(goal)
    return products(np.swapaxes(rows, 1, 2), goal_errors)


def _newton_step(configs: Configurations, goal: Goal) -> Array:
    """Compute the Newton step (n, f) that minimizes half the squared distance in the tangent space.

    The Hessian of the Lagrange function (half the squared distance plus multipliers times loop residuals) is
    a central difference of gradients. The step divides by the absolute values of its eigenvalues, so that the
    step goes downhill in every direction.
    """
    distance_gradient = gradient(configs, goal)
    multipliers = -products(np.swapaxes(configs.loop_inverse, 1, 2), distance_gradient)
    tangent = configs.tangent
    columns = []
    for k in range(tangent.shape[1]):
        gradients = []  # of the Lagrange function, on both sides
        for sign in (1.0, -1.0):
            other = configs.step_by(sign * DIFFERENCE_STEP * tangent[:, k])
            constraint_part = products(np.swapaxes(other.loops, 1, 2), multipliers)
            gradients.append(gradient(other, goal) + constraint_part)
        columns.append(products(tangent, gradients[0] - gradients[1]) / (2.0 * DIFFERENCE_STEP))
    hessian = np.stack(columns, axis=2)
    curvature, directions = np.linalg.eigh(0.5 * (hessian + np.swapaxes(hessian, 1, 2)))
    slopes = products(np.swapaxes(directions, 1, 2), products(tangent, distance_gradient))
    return -products(directions, slopes / np.maximum(np.abs(curvature), MIN_CURVATURE))


def moved_closed(configs: Configurations, step: Array) -> Configurations:
    """Move configurations by dimensionless steps (n, nv) and close the loops by the chord method."""
    after = configs.step_by(step)
    for _ in range(MAX_CHORD_STEPS):
        if np.all(largest(after.phi) < RESIDUAL_ROUND_OFF):
            break
        after = after.step_by(products(configs.loop_inverse, -after.phi))
    return after


def _is_better(after: Configurations, before: Configurations, goal: Goal) -> Array:
    """Return True (n,) for closed configurations that are nearer to their goals than before.

    If both distances are equal up to round-off, the configuration with a less than half as large slope of the
    distance is better.
    """
    new, old = half_square(after, goal), half_square(before, goal)
    new_slope, old_slope = (largest(products(each.tangent, gradient(each, goal))) for each in (after, before))
    same = np.abs(new - old) <= DISTANCE_ROUND_OFF * old
    closed = largest(after.phi) < np.maximum(MAX_RESIDUAL, 0.5 * largest(before.phi))
    return closed & np.where(same, new_slope < 0.5 * old_slope, new < old)
