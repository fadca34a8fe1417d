"""What to say of a march that could not go on: when, at which joint, under which force, and why."""

from __future__ import annotations

import numpy as np

from newton_euler.compiled import Code
from newton_euler.equations.applied_forces import strongest
from newton_euler.equations.dense import singular_values
from newton_euler.equations.system import blamed, dimensionless_jacobian
from newton_euler.errors import NewtonEulerError
from newton_euler.integrators import march as m
from newton_euler.integrators.stabilize import worst_joint
from newton_euler.model.trajectory import IntegrationError
from newton_euler.scalars import Array


def failure(
    code: Code, integrator: str, most: int, status: int, x: Array, counts: Array, error: Exception | None
) -> IntegrationError:
    """The error of a march; x is the last state that it reached, `error` what Python raised in it."""
    system, reached = code.float_system(x), float(counts[m.REACHED])
    q, v = x[: system.nq], x[system.nq : code.size]
    if error is not None and status in (m.SINGULAR, m.OPEN):
        if not isinstance(error, NewtonEulerError | np.linalg.LinAlgError):
            raise error
        reason = str(error)
    elif status == m.OPEN:
        joint, gap = worst_joint(system, system.state(q, v))
        reason = f"projection cannot close joint {joint!r}, which is open by {gap:.3g} (m or rad)"
    else:
        reason = _reason(code, integrator, most, status, x)
    force = strongest(system.scene, system.seen(q, v))
    return IntegrationError(reached, blamed(reason, system.fastest_joint(q, v), force))


def _reason(code: Code, integrator: str, most: int, status: int, x: Array) -> str:
    told = status in (m.STRAYING, m.UNDETERMINED, m.UNPROJECTED)
    near = told or code.function("derivative")(x)[-1] < m.NEAR
    advice = {True: "", False: "; for stiff equations use Radau"}[near or integrator != "DOP853"]
    here = f"a singular configuration, where joint {singular_joint(code, x)!r} loses rank" if near else ""
    larger = f"; round-off near {here}, is larger than rtol allows" if near else ""
    return {
        m.NOT_FINITE: "the solution is not finite",
        m.SINGULAR: "the equations of motion are singular",
        m.TOO_MANY_STEPS: f"more than {most} steps{advice}{larger}",
        m.STEP_TOO_SMALL: f"steps have become too small{advice}{larger}",
        m.STRAYING: f"accelerations of a step contradict each other near {here}; another step may pass",
        m.UNDETERMINED: f"the run starts at rest at {here}, and which way it leaves is not determined",
        m.UNPROJECTED: f"the run starts without projection at {here}, and may go over to another motion",
    }[status]


def singular_joint(code: Code, x: Array) -> str:
    """Name of the joint or gear that weighs most in the constraint rows that are nearest to dependent.

    Without constraints, of the one that moves fastest.
    """
    system, rows = code.float_system(x), code.rows.numbers
    if not rows:
        return system.fastest_joint(x[: system.nq], x[system.nq : code.size])
    jacobian = dimensionless_jacobian(system, x[: system.nq])
    combination = singular_values(jacobian[rows])[0][:, -1]
    weights: dict[str, float] = {}
    for row, share in zip(rows, combination, strict=True):
        owner = system.row_owners[row]
        weights[owner] = weights.get(owner, 0.0) + share**2
    return max(weights, key=lambda owner: weights[owner])
