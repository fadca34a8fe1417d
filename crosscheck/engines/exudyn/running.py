"""Exudyn's system during a run: its initial state, and what its solver has reached."""

from __future__ import annotations

import exudyn as exu
import numpy as np

from crosscheck.engines.exudyn.coordinates import NODAL
from crosscheck.engines.exudyn.equations import ExudynSystem
from newton_euler.model.euler_parameters import matrix_l
from newton_euler.model.state import whole_revolutions
from newton_euler.scalars import Array


class RunningSystem(ExudynSystem):
    """Equations of a scene whose system of Exudyn a solver runs."""

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
