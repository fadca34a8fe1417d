"""Motions of bodies that the constraints of a system allow, and the equations of motion projected onto them.

A system is the equations of motion of an engine in one formulation (choice of coordinates). Bases of allowed
body velocities, and inertia and force projected onto them, do not depend on that choice: they can be compared
between engines. Shapes: b bodies (body 0 is the ground), d degrees of freedom, nv velocities of a system.
"""

from __future__ import annotations

import numpy as np

from newton_euler.equations.dense import numerical_rank, orthonormal_range, singular_values
from newton_euler.equations.redundancy import rows_left_out, with_zero_rows
from newton_euler.equations.system import Evaluation, System, dimensionless_jacobian
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array


def body_units(scene: Scene) -> Array:
    """Return units (6 b,) of body velocities: mechanism sizes per second (linear) and rad/s (angular)."""
    size = scene.mechanism.size
    return np.tile([size, size, size, 1.0, 1.0, 1.0], len(scene.mechanism.bodies))


def admissible_basis(system: System, q: Array, units: Array) -> tuple[Array, float]:
    """Compute the body velocities that the constraints allow, and the condition number of the constraints.

    The projector onto the basis represents the constraint Jacobian independently of coordinates and of the
    choice of constraint equations.

    Args:
        system: equations of motion.
        q: coordinates of the system.
        units: (6 b,) units of body velocities, see `body_units`.

    Returns:
        An orthonormal basis (6 b, d) of the allowed body velocities divided by `units`, 1/s; and the
        condition number of the independent constraint equations, 1 without constraints.
    """
    # The dimensionless constraint Jacobian, without rows that are nearly redundant, and the dimensionless
    # transformation T of coordinate velocities to body velocities
    jacobian = with_zero_rows(dimensionless_jacobian(system, q), rows_left_out(system))
    transformation = system.velocity_transformation(q) * system.velocity_units / units[:, None]
    if not jacobian.size:
        return orthonormal_range(transformation), 1.0
    # The coordinate velocities that the constraints allow are the null space of the Jacobian
    _, values, directions = singular_values(jacobian, full=True)
    count = numerical_rank(values)
    basis = orthonormal_range(transformation @ directions[count:].T)
    return basis, float(values[0] / values[count - 1]) if count else 1.0


def free_motion(
    system: System, q: Array, v: Array, evaluation: Evaluation, vdot: Array, basis: Array, units: Array
) -> tuple[Array, Array]:
    """Compute effective inertia (d, d), kg m^2, and effective force (d,), N m, of the allowed motions.

    The allowed body velocities are V = U W y, with the columns W of `basis`, the units U and d independent
    velocities y. The equations of motion M vdot = f + J^T lambda become

        (Y^T M Y) dy/dt = Y^T (f - M v_p),   T Y = U W,   J Y = 0

    J is the constraint Jacobian, and T the system's velocity transformation from v to V. v_p is the part of
    dv/dt that satisfies the constraints and accelerates the bodies perpendicularly to W only. The effective
    inertia Y^T M Y and force Y^T (f - M v_p) do not depend on the choice of coordinates (J. Garcia de Jalon,
    E. Bayo, Kinematic and Dynamic Simulation of Multibody Systems, 1994, section 5.2).

    Args:
        system: equations of motion.
        q, v: coordinates and velocities of the system.
        evaluation: accelerations of bodies at this state.
        vdot: (nv,) accelerations of the coordinates.
        basis: (6 b, d) basis W of the allowed body velocities, divided by `units`.
        units: (6 b,) units U of body velocities, see `body_units`.
    """
    # T and M in dimensionless velocities, v / velocity_units
    transformation = system.velocity_transformation(q) * system.velocity_units / units[:, None]
    mass, force = system.mass_and_force(q, v)
    mass = mass * system.velocity_units
    accelerations = np.hstack([evaluation.linear_acceleration, evaluation.angular_acceleration]).ravel()
    y_rate = basis.T @ (accelerations / units)  # dy/dt
    # Y in dimensionless velocities (`velocities`), and Y in the space of the rows of M and f (`projection`)
    if len(mass) < system.nv:
        # Cartesian coordinates: the rows of M and f belong to body velocities, with angular ones in body
        # frames. Body accelerations are T qddot, because Gdot pdot = 0 for Euler parameters p
        motion = _least_squares(transformation, np.column_stack([basis, accelerations / units]))
        velocities, acceleration = motion[:, :-1], motion[:, -1]
        projection = _in_body_frames(evaluation.state, units[:, None] * basis)
    else:
        jacobian = dimensionless_jacobian(system, q)
        # J Y = 0 is needed as well: if a system cuts a body into two halves to open a loop, V = T v does not
        # have the velocities of both halves
        rows = np.concatenate([transformation, jacobian])
        right = np.concatenate([basis, np.zeros((len(jacobian), basis.shape[1]))])
        velocities = _least_squares(rows, right)
        acceleration = vdot / system.velocity_units
        projection = system.velocity_units[:, None] * velocities
    v_p = acceleration - velocities @ y_rate
    return projection.T @ mass @ velocities, projection.T @ (force - mass @ v_p)


def _least_squares(matrix: Array, right: Array) -> Array:
    """Solve a least squares problem with several right-hand sides; raises `LinAlgError` if not finite."""
    if not (np.isfinite(matrix).all() and np.isfinite(right).all()):
        raise np.linalg.LinAlgError("a matrix is not finite")  # LAPACK may never return for such a matrix
    return np.asarray(np.linalg.lstsq(matrix, right)[0])


def _in_body_frames(state: State, velocities: Array) -> Array:
    """Rotate angular velocities to body frames, in which Cartesian equations have torques; drop the ground.

    Args:
        state: state with the body frames.
        velocities: (6 b, d) velocities of all bodies, linear and angular, in the world frame.

    Returns:
        (6 (b - 1), d) velocities of the moving bodies.
    """
    in_body_frames = velocities.reshape(len(state.position), 6, -1).copy()
    for body, frame in zip(in_body_frames, state.frames(), strict=True):
        body[3:] = frame.rotation.T @ body[3:]
    return in_body_frames[1:].reshape(-1, velocities.shape[1])
