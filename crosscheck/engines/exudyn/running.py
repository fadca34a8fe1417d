"""Exudyn's system during a run: its initial state, and what its solver has reached."""

from __future__ import annotations

from collections.abc import Sequence

import exudyn as exu
import numpy as np

from crosscheck.engines.exudyn.coordinates import NODAL
from crosscheck.engines.exudyn.equations import ExudynSystem
from newton_euler.equations.redundancy import constraint_rank, dependent_rows, regular_state
from newton_euler.equations.system import dimensionless_jacobian
from newton_euler.model.euler_parameters import matrix_l
from newton_euler.model.scene import Scene
from newton_euler.model.state import whole_revolutions
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array

WEAK_ROWS = 0.2
"""Fraction of the largest independence of constraint rows below which other rows are considered."""

STRONG_ROWS = 0.4
"""Smallest fraction of the largest independence with which other constraint rows replace those in use.

Near a singular state no rows reach it. The run then keeps its rows, as a new start there is inaccurate."""


class IndependentRows:
    """Choice of constraint rows that are independent, and that imply the redundant ones.

    The independence of rows is the smallest singular value of their dimensionless Jacobian. Rows with much of
    it at the start may lose it on the way, as in a Bennett linkage that turns.

    Attributes:
        left_out: numbers of the redundant rows, see `crosscheck.engines.exudyn.model.build`.
    """

    def __init__(self, scene: Scene) -> None:
        """Choose the rows for the initial state of a scene."""
        whole = ExudynSystem(scene)
        self.left_out, self._largest = list[int](), 0.0
        if len(whole.row_numbers) > constraint_rank(whole):
            self._every = ExudynSystem(scene, divided=True)
            regular, _ = self._every.coordinates(regular_state(scene))
            self.left_out = dependent_rows(self._every, regular)
            self._largest = self._independence(regular, self.left_out)
            self.exchange(self._every.coordinates(initial_state(scene))[0])

    def exchange(self, q: Array) -> bool:
        """Choose other rows at coordinates q (nq,) if the present ones have lost their independence there.

        Returns:
            Whether other rows were chosen.
        """
        if not self.left_out:
            return False
        now = self._independence(q, self.left_out)
        self._largest = max(self._largest, now)
        if now >= WEAK_ROWS * self._largest:
            return False
        others = dependent_rows(self._every, q)
        independence = self._independence(q, others)
        if independence < STRONG_ROWS * self._largest:
            return False
        self.left_out, self._largest = others, independence
        return True

    def _independence(self, q: Array, left_out: Sequence[int]) -> float:
        """Return the independence of the other rows at coordinates q (nq,)."""
        rows = np.delete(dimensionless_jacobian(self._every, q), left_out, axis=0)
        return float(np.linalg.svd(rows, compute_uv=False)[-1])


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
