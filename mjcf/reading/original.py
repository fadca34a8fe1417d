"""What MuJoCo says of the file itself, to check a scene that was made of it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import mujoco
import numpy as np

from mjcf.motion import body_acceleration
from mjcf.reading.bodies import Bodies
from mjcf.reading.start import Start
from newton_euler.relative import Relative
from newton_euler.scalars import Array
from newton_euler.scene import Scene
from newton_euler.solve import solve_constrained
from newton_euler.state import State

AT_REST = 1e-3
"""m/s^2, of a mechanism in which nothing moves."""


@contextmanager
def without_left(start: Start) -> Iterator[None]:
    """Within it MuJoCo's model lacks what was left out of the scene."""
    model, data = start.model, start.data
    dofs = {int(joint): model.dof_jntid == joint for kind, joint in start.left if kind == "joint"}
    changed = [(array, array.copy()) for array in (
        data.eq_active, model.tendon_stiffness, model.tendon_stiffnesspoly, model.tendon_armature,
        model.actuator_gainprm, model.actuator_biasprm, model.actuator_armature,
        model.jnt_stiffness, model.jnt_stiffnesspoly, model.dof_armature,
    )]  # fmt: skip
    of_kind = {"equality": slice(0, 1), "tendon": slice(1, 4), "actuator": slice(4, 7), "joint": slice(7, 9)}
    for kind, index in start.left:
        for array, _ in changed[of_kind[kind]]:
            array[index] = 0
    for mask in dofs.values():
        model.dof_armature[mask] = 0.0
    try:
        yield
    finally:
        for array, before in changed:
            array[:] = before


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
    mujoco.mj_fwdActuation(model, data)
    mass = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    force = data.qfrc_passive + data.qfrc_actuator - data.qfrc_bias
    ones = np.ones(model.nv)
    gamma = np.zeros(len(rows))
    data.qacc[:] = solve_constrained(mass, force, rows, gamma, np.ones(len(rows)), ones)[0]
    mujoco.mj_rnePostConstraint(model, data)
    found = [np.concatenate(body_acceleration(model, data, k)) for k in range(model.nbody)]
    data.qvel[:] = velocity
    mujoco.mj_fwdVelocity(model, data)
    return np.array(found)


def acceleration_gap(start: Start, bodies: Bodies, scene: Scene) -> float:
    """Largest difference of a body's acceleration at rest at the start, relative to the largest there is.

    Angular ones count at the mechanism's size. Of a body that several are fixed together in, the first
    one's are compared.
    """
    wanted = rigid_accelerations(start)
    system = Relative(scene)
    evaluation = system.evaluate(*system.coordinates(State.initial(scene.mechanism)))
    size, gap, scale = scene.mechanism.size, 0.0, max(float(np.linalg.norm(scene.gravity)), AT_REST)
    for k, body in enumerate(scene.mechanism.bodies[1:], start=1):
        root = bodies.root(body.name)
        angular = evaluation.angular_acceleration[k]
        arm = start.data.xipos[root] - body.center_of_mass
        linear = evaluation.linear_acceleration[k] + np.cross(angular, arm)
        found = np.concatenate([linear, size * angular]).reshape(2, 3)
        mujocos = np.concatenate([wanted[root, :3], size * wanted[root, 3:]]).reshape(2, 3)
        gap = max(gap, *(float(x) for x in np.linalg.norm(found - mujocos, axis=1)))
        scale = max(scale, *(float(x) for x in np.linalg.norm(mujocos, axis=1)))
    return gap / scale
