"""Joint reactions as far as the equations of motion determine them.

Where constraints are redundant, some reactions balance each other on every body and any amount of them
can be added: engines differ there, and none is wrong (J. Garcia de Jalon, M. D. Gutierrez-Lopez, Multibody
dynamics with redundant constraints and singular mass matrix, Multibody System Dynamics 30, 2013).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from newton_euler.cartesian import Cartesian
from newton_euler.constraints import Jacobian
from newton_euler.couplings import couplings
from newton_euler.scalars import Array
from newton_euler.scene import Scene
from newton_euler.solve import RANK_TOLERANCE, orthonormal_null, orthonormal_range
from newton_euler.state import State


def undetermined(scene: Scene, state: State) -> Array:
    """(6 j, r) orthonormal reactions that together act on no body: r redundant constraints.

    For each joint force and torque over the mechanism's size, N both, on the second body at the joint
    point; world frame. What couplings and prescribed motions put on a joint's coordinates is among them.
    """
    mechanism, frames = scene.mechanism, state.frames()
    size, rows, wrenches = mechanism.size, [], []

    def add(parts: list[tuple[int, int, int, Jacobian]], unit: Array) -> None:
        """Equations of these joints, first and second bodies, of those units; the ground takes anything."""
        row = np.zeros((len(unit), len(frames), 6))
        wrench = np.zeros((len(mechanism.joints), 6, len(unit)))
        for k, i, j, blocks in parts:
            for body, r, theta in (
                (i, blocks.r_first, blocks.theta_first),
                (j, blocks.r_second, blocks.theta_second),
            ):
                row[:, body] += np.hstack([r, theta / size])
            pose = mechanism.bodies[j].pose
            arm = frames[j].rotation @ pose.point_to_body(mechanism.joints[k].reaction_point)
            torque = blocks.theta_second - np.cross(arm, blocks.r_second)
            wrench[k] += np.hstack([blocks.r_second, torque / size]).T
        row[:, 0] = 0.0
        rows.append(row.reshape(len(unit), 6 * len(frames)) * size / unit[:, None])
        wrenches.append(wrench.reshape(6 * len(mechanism.joints), len(unit)) * size / unit)

    for k, equations in enumerate(mechanism.equations):
        i, j = equations.first, equations.second
        add([(k, i, j, equations.jacobian(frames[i], frames[j]))], equations.units(size))
    measured = Cartesian(scene).measured
    for coupling in couplings(scene):
        parts = []
        for key, factor in coupling.factors.items():
            i, j = measured[key].first, measured[key].second
            blocks = measured[key].constraint.jacobian(frames[i], frames[j])
            share = Jacobian(*(factor * block for block in blocks))
            parts.append((mechanism.joint_index(key[0]), i, j, share))
        add(parts, np.array([size if coupling.is_length else 1.0]))
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
