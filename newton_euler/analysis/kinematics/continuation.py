"""Configurations moved to goals: Newton's method by continuation, and descent to the nearest where it fails.

Newton's method takes steps of least length, from the nearest configuration that is solved already. Goals that
it does not reach are approached: their distance is minimized over all closed configurations by Newton's
method in the tangent space (J. Nocedal, S. J. Wright, Numerical Optimization, 2nd ed., 2006, sections 3.4
and 15.4), from the nearest of many configurations.
"""

from __future__ import annotations

import numpy as np

from newton_euler.analysis.kinematics.configurations import (
    LONGEST_STEP,
    Chain,
    Configurations,
    Goal,
    products,
)
from newton_euler.equations.dense import RANK_TOLERANCE
from newton_euler.scalars import Array

NEAR = 0.25  # rad, or sizes, between a goal and the solved pose that Newton's method begins at
MOST_STRIDES = 1000  # between the start and a goal; longer ones are too long for Newton's method in the end
NEWTON_STEPS, RANDOM_STEPS = 12, 60  # from a solved configuration next to the goal, and from a random one
ROUND_OFF = 16.0 * np.finfo(float).eps  # dimensionless residuals below this are what evaluating them loses
CLOSED = 1e-11  # dimensionless residuals of a pose that is reached; others still halve
APPROACH_STEPS = 60
DIFFERENCE = 1e-5  # dimensionless step of central differences, off by its square and round-off over it
FLAT = 1e-9  # curvature below which a direction counts as straight
HALVINGS = 8
CHORDS = 15  # steps that close loops by the inverse of another configuration's Jacobian
NOISE = 1e-12  # share of a squared distance that is round-off
WALKERS, WALK = 64, 20  # random paths that look for configurations near to goals, and their steps


def newton(at: Configurations, goal: Goal, steps: int = NEWTON_STEPS) -> tuple[Configurations, Array]:
    """Move configurations to goals by steps of least length; also returns True (n,) for those that arrive."""
    values, error = at.values.copy(), np.full(len(at), np.inf)
    active, here = np.arange(len(at)), at
    for _ in range(steps):
        misses, rows = here.misses(goal[active])
        left = largest(here.phi, misses)
        on = (left >= ROUND_OFF) & ((left >= CLOSED) | (left < 0.5 * error[active]))
        values[active], error[active] = here.values, left
        if not on.any():
            break
        active, here, misses, rows = active[on], here[on], misses[on], rows[on]
        back = products(here.back, -here.phi)
        reduced = rows @ np.swapaxes(here.tangent, 1, 2)
        along = products(np.linalg.pinv(reduced, RANK_TOLERANCE), -misses - products(rows, back))
        here = here.moved(back + products(np.swapaxes(here.tangent, 1, 2), along))
    return Configurations(at.chain, values), error < CLOSED


def largest(*residuals: Array) -> Array:
    """Find the largest magnitudes (n,) of dimensionless residuals (n, k) each."""
    return np.max(np.abs(np.hstack(residuals)), axis=1, initial=0.0)


def sides(before: Configurations, after: Configurations) -> Array:
    """Return -1.0 (n, 2) where a singular configuration was passed between two configurations, else 1.0.

    There the determinant of the Jacobian of the goals (first column), or that of all chosen coordinates
    (second column), by motions in the tangent space changes its sign. There is no such sign where they are
    not as many as degrees of freedom.
    """
    chain = before.chain
    turned = np.linalg.det(after.tangent @ np.swapaxes(before.tangent, 1, 2))
    found = np.ones((len(before), 2))
    first, last = (at.misses(chain.goal_at(at))[1] for at in (before, after))
    pairs = [(first, last)]
    if chain.pointing or chain.goals < len(chain.keys):
        pairs.append((before.driving, after.driving))
    for column, (one, other) in enumerate(pairs):
        if one.shape[1] == chain.freedoms:
            start = np.linalg.det(one @ np.swapaxes(before.tangent, 1, 2))
            end = np.linalg.det(other @ np.swapaxes(after.tangent, 1, 2))
            passed = (start * turned * end < 0.0) & (np.abs(start) > RANK_TOLERANCE)
            found[passed, column] = -1.0
    return found


def follow(start: Configurations, goal: Goal) -> tuple[Configurations, Array]:
    """Move one configuration to each of n goals, each from the nearest one that is solved by then.

    Goals far from all of these are approached along straight lines.

    Returns:
        Configurations, those of the nearest solved goals where the own one is not reached; True (n,) where
        it is, without a singular configuration on the way.
    """
    from scipy.spatial import cKDTree

    chain, count = start.chain, len(goal.coordinates)
    solved, at = start.values, chain.goal_at(start)
    found = np.repeat(start.values, count, axis=0)
    points, tried, reached = chain.embed(goal), np.full(count, -1), np.zeros(count, dtype=bool)
    stride = np.maximum(NEAR, np.linalg.norm(points - chain.embed(at), axis=1) / MOST_STRIDES)
    while not reached.all():
        waiting = np.flatnonzero(~reached)
        distance, nearest = cKDTree(chain.embed(at)).query(points[waiting])
        take = fresh = nearest != tried[waiting]
        near = fresh & (distance <= stride[waiting])
        if near.any():
            take = near
        if not take.any():
            break
        own, source, distance = waiting[take], nearest[take], distance[take]
        share = np.minimum(1.0, stride[own] / np.maximum(distance, stride[own]))
        towards = chain.between(goal[own], at[source], share)
        before = Configurations(chain, solved[source])
        after, met = newton(before, towards)
        met &= np.all(sides(before, after) > 0.0, axis=1)
        tried[own] = source
        found[own] = np.where(met[:, None], after.values, before.values)
        reached[own] = met & (share == 1.0)
        solved = np.concatenate([solved, after.values[met]])
        at = at.with_others(towards[met])
    return Configurations(chain, found), reached


def random_coordinates(chain: Chain, count: int, rng: np.random.Generator) -> Array:
    """Draw coordinates (n, nq), loops open: any angles and orientations, slides within two sizes."""
    q = np.repeat(chain.start[None], count, axis=0)
    for motion, place, _ in chain.system.tree.motions:
        shape = count, place.stop - place.start
        if motion.kind == "ball":
            drawn = rng.standard_normal(shape)
            q[:, place] = drawn / np.linalg.norm(drawn, axis=1, keepdims=True)
        else:
            reach = np.pi if motion.kind == "hinge" else 2.0 * chain.scene.mechanism.size
            q[:, place] = rng.uniform(-reach, reach, shape)
    return q


def wander(start: Configurations) -> Configurations:
    """Find closed configurations all over the branch of one, by random paths that pass no singular one."""
    rng, chain = np.random.default_rng(0), start.chain
    here = Configurations(chain, np.repeat(start.values, WALKERS, axis=0))
    visited = [start.values]
    for _ in range(WALK):
        along = rng.standard_normal((WALKERS, chain.freedoms))
        after = moved_closed(here, LONGEST_STEP * products(np.swapaxes(here.tangent, 1, 2), along))
        good = (largest(after.phi) < CLOSED) & np.all(sides(here, after) > 0.0, axis=1)
        here = Configurations(chain, np.where(good[:, None], after.values, here.values))
        visited.append(after.values[good])
    return Configurations(chain, np.concatenate(visited))


def approach(at: Configurations, others: Configurations, goal: Goal) -> tuple[Configurations, Array]:
    """Move closed configurations, or others that are nearer, to where their distances to goals are smallest.

    Also returns -1.0 (n, 2) where an odd number of singular configurations was passed, as of `sides`, else
    1.0.
    """
    from scipy.spatial import cKDTree

    chain = at.chain
    _, nearest = cKDTree(chain.embed(chain.goal_at(others))).query(chain.embed(goal))
    other = others[nearest]
    nearer = half_square(other, goal) < half_square(at, goal)
    values, passed = np.where(nearer[:, None], other.values, at.values), np.ones((len(at), 2))
    active = np.arange(len(at))
    for _ in range(APPROACH_STEPS):
        if not active.size or not chain.freedoms:
            break
        here, own = Configurations(chain, values[active]), goal[active]
        along = _descent(here, own)
        better = np.zeros(len(here), dtype=bool)
        for k in range(HALVINGS):
            rest = np.flatnonzero(~better)
            if not rest.size:
                break
            before = here[rest]
            after = moved_closed(before, 0.5**k * products(np.swapaxes(before.tangent, 1, 2), along[rest]))
            good = _is_better(after, before, own[rest])
            moved = active[rest[good]]
            passed[moved] *= sides(before[good], after[good])
            values[moved] = after.values[good]
            better[rest[good]] = True
        active = active[better]
    return Configurations(chain, values), passed


def half_square(at: Configurations, goal: Goal) -> Array:
    """Compute half the squared dimensionless distances (n,) to goals."""
    return 0.5 * np.sum(at.misses(goal)[0] ** 2, axis=1)


def gradient(at: Configurations, goal: Goal) -> Array:
    """Compute the gradients (n, nv) of half the squared distances to goals."""
    misses, rows = at.misses(goal)
    return products(np.swapaxes(rows, 1, 2), misses)


def _descent(at: Configurations, goal: Goal) -> Array:
    """Compute Newton's step (n, f) in the tangent space, uphill in every direction of curvature."""
    uphill = gradient(at, goal)
    multipliers = -products(np.swapaxes(at.back, 1, 2), uphill)
    tangent = at.tangent
    columns = []
    for k in range(tangent.shape[1]):
        ends = []
        for sign in (1.0, -1.0):
            other = at.moved(sign * DIFFERENCE * tangent[:, k])
            ends.append(gradient(other, goal) + products(np.swapaxes(other.loops, 1, 2), multipliers))
        columns.append(products(tangent, ends[0] - ends[1]) / (2.0 * DIFFERENCE))
    hessian = np.stack(columns, axis=2)
    curvature, modes = np.linalg.eigh(0.5 * (hessian + np.swapaxes(hessian, 1, 2)))
    steepest = products(np.swapaxes(modes, 1, 2), products(tangent, uphill))
    return -products(modes, steepest / np.maximum(np.abs(curvature), FLAT))


def moved_closed(at: Configurations, step: Array) -> Configurations:
    """Move configurations by dimensionless steps (n, nv) and close the loops again."""
    after = at.moved(step)
    for _ in range(CHORDS):
        if np.all(largest(after.phi) < ROUND_OFF):
            break
        after = after.moved(products(at.back, -after.phi))
    return after


def _is_better(after: Configurations, before: Configurations, goal: Goal) -> Array:
    """Compare closed configurations by their distance to goals, and where that is as large by its slope."""
    new, old = half_square(after, goal), half_square(before, goal)
    slope, steeper = (largest(products(at.tangent, gradient(at, goal))) for at in (after, before))
    same = np.abs(new - old) <= NOISE * old
    closed = largest(after.phi) < np.maximum(CLOSED, 0.5 * largest(before.phi))
    return closed & np.where(same, slope < 0.5 * steeper, new < old)
