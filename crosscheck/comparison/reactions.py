"""Joint reactions as far as the equations of motion determine them.

Where constraints are redundant, some reactions balance each other on every body and any amount of them
can be added: engines differ there, and none is wrong (J. Garcia de Jalon, M. D. Gutierrez-Lopez, Multibody
dynamics with redundant constraints and singular mass matrix, Multibody System Dynamics 30, 2013).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from newton_euler.euler_parameters import rotation
from newton_euler.scalars import Array, cross
from newton_euler.scene import Scene
from newton_euler.solve import RANK_TOLERANCE, orthonormal_null, orthonormal_range
from newton_euler.state import State


def undetermined(scene: Scene, state: State) -> Array:
    """(6 j, r) orthonormal reactions that together act on no body: r redundant constraints.

    For each joint force and torque over the mechanism's size, N both, on the second body at the joint
    point; world frame. Couplings are not looked at.
    """
    mechanism, frames = scene.mechanism, state.frames()
    rows, wrenches = [], []
    for k, equations in enumerate(mechanism.equations):
        i, j = equations.first, equations.second
        blocks = equations.jacobian(frames[i], frames[j])
        unit = equations.units(mechanism.size)[:, None]
        row = np.zeros((equations.count, len(frames), 6))
        row[:, i, :3], row[:, i, 3:] = blocks.r_first, blocks.theta_first / mechanism.size
        row[:, j, :3], row[:, j, 3:] = blocks.r_second, blocks.theta_second / mechanism.size
        row[:, 0] = 0.0  # the ground takes anything
        rows.append(row.reshape(equations.count, 6 * len(frames)) * mechanism.size / unit)
        body = mechanism.bodies[j]
        arm = rotation(state.quaternion[j]) @ body.pose.point_to_body(equations.joint.reaction_point)
        wrench = np.zeros((6 * len(mechanism.joints), equations.count))
        wrench[6 * k : 6 * k + 3] = blocks.r_second.T
        wrench[6 * k + 3 : 6 * k + 6] = (
            blocks.theta_second.T - np.array([cross(arm, force) for force in blocks.r_second]).T
        ) / mechanism.size
        wrenches.append(wrench * mechanism.size / unit.T)
    null = orthonormal_null(np.concatenate(rows).T)
    return orthonormal_range(np.concatenate(wrenches, axis=1) @ null)


def determined(force: Array, torque: Array, free: Sequence[Array], size: float) -> tuple[Array, Array]:
    """Differences of reactions without what nothing determines.

    Args:
        force, torque: (n, j, 3) N and N m.
        free: for each of the n states what `undetermined` gives.
        size: of the mechanism, m.
    """
    found = np.concatenate([force, torque / size], axis=2)
    for n, basis in enumerate(free):
        wrench = found[n].ravel()
        found[n] = (wrench - basis @ (basis.T @ wrench)).reshape(-1, 6)
    return found[..., :3], size * found[..., 3:]


def undetermined_joints(scene: Scene, state: State) -> tuple[int, list[str]]:
    """How many constraints are redundant at a state, and the joints whose reactions are not unique for it."""
    basis = undetermined(scene, state)
    parts = np.split(np.linalg.norm(basis, axis=1), len(scene.mechanism.joints))
    names = scene.mechanism.joint_names
    return basis.shape[1], [
        name for name, part in zip(names, parts, strict=True) if np.max(part) > RANK_TOLERANCE
    ]
