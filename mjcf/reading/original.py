"""What MuJoCo says of the file itself, to check a scene that was made of it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import mujoco
import numpy as np

from mjcf.evaluate import mass_and_force
from mjcf.motion import body_acceleration
from mjcf.reading.bodies import Bodies
from mjcf.reading.source import SourceError
from mjcf.reading.start import Start
from newton_euler.redundancy import apparent_rank
from newton_euler.relative import Relative
from newton_euler.scalars import Array
from newton_euler.scene import REDUNDANCY_TOLERANCE, Scene
from newton_euler.solve import solve_constrained
from newton_euler.state import State

AT_REST = 1e-3
"""m/s^2, of a mechanism in which nothing moves."""

SAME = 1e-9
"""Relative, of accelerations: two sets of equations on numbers that went through a compiler."""


class Gap(NamedTuple):
    """A difference of accelerations, relative to the largest, and the body that has it."""

    relative: float
    body: str


@contextmanager
def without_left(start: Start) -> Iterator[None]:
    """Within it MuJoCo's model is without what the scene leaves out or approximates."""
    changed = [(array, rows, np.copy(array[rows])) for array, rows, _ in start.differences]
    for array, rows, values in start.differences:
        array[rows] = values
    try:
        yield
    finally:
        for array, rows, before in reversed(changed):
            array[rows] = before


def rigid_accelerations(start: Start) -> Array:
    """(nbody, 6) of MuJoCo's bodies at rest at the start, its equalities rigid.

    Of the centre of mass, m/s^2, and angular, rad/s^2, world frame: from MuJoCo's mass matrix, forces and
    constraint Jacobian.
    """
    model, data = start.model, start.data
    velocity = data.qvel.copy()
    data.qvel[:] = 0.0
    start.gaps()
    rows = start.jacobian()
    mujoco.mj_fwdVelocity(model, data)
    mass, force = mass_and_force(model, data)
    ones = np.ones(model.nv)
    gamma = np.zeros(len(rows))
    rank = apparent_rank(np.linalg.svd(rows, compute_uv=False), REDUNDANCY_TOLERANCE) if rows.size else 0
    data.qacc[:] = solve_constrained(mass, force, rows, gamma, np.ones(len(rows)), ones, rank)[0]
    mujoco.mj_rnePostConstraint(model, data)
    found = [np.concatenate(body_acceleration(model, data, k)) for k in range(model.nbody)]
    data.qvel[:] = velocity
    mujoco.mj_fwdVelocity(model, data)
    return np.array(found)


def gap_line(start: Start, bodies: Bodies, scene: Scene) -> str:
    """A line for the report: how far the scene is from MuJoCo's model of the file.

    Raises:
        SourceError: if that is more than round-off, and what is left out or approximated does not explain it.
    """
    gap = acceleration_gap(start, bodies, scene)
    what = "accelerations at rest there are off MuJoCo's of the file itself, rigid, by"
    line = f"{what} {gap.relative:.1e} relative"
    if start.differences and not gap.relative <= SAME:
        with without_left(start):
            gap = acceleration_gap(start, bodies, scene)
        line += f", and by {gap.relative:.1e} of the file without what is left out or approximated"
    if not gap.relative <= SAME:
        why = f"the most at body {gap.body!r}: more than {SAME:g}, the scene is not what the file says"
        raise SourceError(start.path, f"{line}, {why}")
    return line


def acceleration_gap(start: Start, bodies: Bodies, scene: Scene) -> Gap:
    """Largest difference of a body's acceleration at rest at the start, relative to the largest there is.

    Angular ones count at the mechanism's size. Of a body that several are fixed together in, the first
    one's are compared.
    """
    wanted = rigid_accelerations(start)
    system = Relative(scene)
    evaluation = system.evaluate(*system.coordinates(State.initial(scene.mechanism)))
    size, gap, worst = scene.mechanism.size, 0.0, scene.mechanism.bodies[1].name
    scale = max(float(np.linalg.norm(scene.gravity)), AT_REST)
    for k, body in enumerate(scene.mechanism.bodies[1:], start=1):
        root = bodies.root(body.name)
        angular = evaluation.angular_acceleration[k]
        arm = start.data.xipos[root] - body.center_of_mass
        linear = evaluation.linear_acceleration[k] + np.cross(angular, arm)
        found = np.concatenate([linear, size * angular]).reshape(2, 3)
        mujocos = np.concatenate([wanted[root, :3], size * wanted[root, 3:]]).reshape(2, 3)
        apart = float(np.nan_to_num(np.max(np.linalg.norm(found - mujocos, axis=1)), nan=np.inf))
        if apart > gap:
            gap, worst = apart, body.name
        scale = max(scale, *(float(x) for x in np.linalg.norm(mujocos, axis=1)))
    return Gap(gap / scale, worst)
