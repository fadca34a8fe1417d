"""Exudyn's system during a run: its initial state, and what its solver has reached."""

from __future__ import annotations

from collections.abc import Collection

import exudyn as exu
import numpy as np

from crosscheck.engines.exudyn.coordinates import NODAL
from crosscheck.engines.exudyn.equations import ExudynSystem
from newton_euler.equations.redundancy import constraint_rank, dependent_rows
from newton_euler.model.euler_parameters import matrix_l
from newton_euler.model.scene import Scene
from newton_euler.model.state import State, whole_revolutions
from newton_euler.scalars import Array


def without_redundancy(scene: Scene, state: State | None = None) -> RunningSystem:
    """Return the equations of a scene without redundant constraints, which Exudyn's solvers cannot have.

    Args:
        scene: the scene.
        state: state at which the constraints in use are chosen; None for one of the configurations that the
            mobility analysis has examined.
    """
    equations = RunningSystem(scene)
    if len(equations.row_numbers) == constraint_rank(equations):
        return equations
    return RunningSystem(scene, dependent_rows(ExudynSystem(scene, divided=True), state))


class RunningSystem(ExudynSystem):
    """Equations of a scene whose system of Exudyn a solver runs.

    Attributes:
        is_reduced: True if redundant constraint rows are left out.
    """

    def __init__(self, scene: Scene, left_out: Collection[int] = ()) -> None:
        """Build the model without some constraint rows, see `crosscheck.engines.exudyn.model.build`."""
        super().__init__(scene, left_out)
        self.is_reduced = bool(left_out)

    def independence(self) -> float:
        """Return the smallest singular value of the dimensionless constraint rows at the present state."""
        nodal = self.reference + self.model.mbs.systemData.GetODE2Coordinates()
        jacobian = self._constraint_matrix() @ self.nodal_rates(nodal)
        dimensionless = jacobian * self.velocity_units / self.phi_units[:, None]
        return float(np.linalg.svd(dimensionless, compute_uv=False)[-1])

    def owner(self, row: int) -> str:
        """Return the name of the joint whose equation is a row of Exudyn's system matrix; "" for none."""
        for each in self.model.rows:
            if each.joint is not None and self.solver.GetODE2size() + each.equation == row:
                return self.mechanism.joint_names[each.joint]
        return ""

    def start(self, q: Array, v: Array, acceleration: Array, multipliers: Array) -> None:
        """Make a state the initial one of Exudyn's solvers, and the present one.

        Args:
            q, v: (nq,) and (nv,), the state.
            acceleration: (nv,) dv/dt.
            multipliers: (k,) multipliers of the constraints.
        """
        self.place(q, v)
        data, initial = self.model.mbs.systemData, exu.ConfigurationType.Initial
        of_equations = np.zeros(self.solver.GetAEsize())
        of_equations[self.row_numbers] = -multipliers  # Exudyn has M a + C_q^T multipliers = f
        data.SetODE2Coordinates(data.GetODE2Coordinates(), initial)
        data.SetODE2Coordinates_t(data.GetODE2Coordinates_t(), initial)
        data.SetODE2Coordinates_tt(self.nodal_accelerations(q, v, acceleration), initial)
        data.SetAECoordinates(of_equations, initial)
        data.SetDataCoordinates(data.GetDataCoordinates(), initial)

    def nodal_accelerations(self, q: Array, v: Array, acceleration: Array) -> Array:
        """Return the second derivatives of Exudyn's coordinates for accelerations dv/dt (nv,)."""
        found = self.nodal_rates(q) @ acceleration
        for k, place in enumerate(self.quaternions):
            spin = v[6 * k + 3 : 6 * k + 6]
            found[place] -= 0.25 * (spin @ spin) * q[place]
        return found

    def follow_angles(self) -> None:
        """Count the revolutions of the hinge angles up to the present state of Exudyn's system."""
        if self.angles:
            frames = self.present_state().frames()
            for key in self.angles:
                x = float(self.mechanism.measure(key, frames)[0])
                self.model.angles[key] = x + float(whole_revolutions(self.model.angles[key] - x))

    def read_state(self, like: Array) -> tuple[Array, Array, Array]:
        """Return q (nq,), v (nv,) and dv/dt (nv,) of the present state of Exudyn's system.

        Args:
            like: (nq,) coordinates with the present work.
        """
        data, q = self.model.mbs.systemData, like.copy()
        nodal = self.reference + data.GetODE2Coordinates()
        rates, second = np.array(data.GetODE2Coordinates_t()), np.array(data.GetODE2Coordinates_tt())
        v, acceleration = np.zeros((2, self.nv))
        for k, place in enumerate(self.quaternions):
            nodal[place] /= np.linalg.norm(nodal[place])
            position, matrix = slice(NODAL * k, NODAL * k + 3), 2.0 * matrix_l(nodal[place])
            for found, given in ((v, rates), (acceleration, second)):
                found[6 * k : 6 * k + 3], found[6 * k + 3 : 6 * k + 6] = (
                    given[position],
                    matrix @ given[place],
                )
        v[6 * self.count :] = rates[NODAL * self.count :]
        acceleration[6 * self.count :] = second[NODAL * self.count :]
        q[: self.nodal_size] = nodal
        q[self.angle_places] = [self.model.angles[key] for key in self.angles]
        return q, v, acceleration

    def read_multipliers(self) -> Array:
        """Return the multipliers (k,) of M dv/dt = f + J^T multipliers that Exudyn's solver has found."""
        return -np.array(self.model.mbs.systemData.GetAECoordinates())[self.row_numbers]
