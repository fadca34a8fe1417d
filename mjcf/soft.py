"""MuJoCo as it is, with its soft constraints, at single states."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import mujoco
import numpy as np

from mjcf.evaluate import evaluation
from mjcf.model import CompiledScene
from newton_euler.equations.system import Evaluation
from newton_euler.model.control import PD, Feedforwards
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array


class SoftMuJoCo(CompiledScene):
    """Equations by `mj_forward`: accelerations and constraint forces of soft constraints.

    Attributes:
        moved: (m,) places in MuJoCo's velocities of the joint coordinates that follow prescribed motions.
        driven: the laws that depend on time.
    """

    name = "mujoco"

    def __init__(self, scene: Scene) -> None:
        """Compile; raises `ModelError` with MuJoCo's reason if it refuses."""
        super().__init__(scene)
        first = self.model.neq - len(self.couplings.couplings)
        self._motions = np.arange(first, first + len(scene.motions))  # the first of the couplings
        self.moved = self.model.jnt_dofadr[self.model.eq_obj1id[self._motions]]
        self.driven = Feedforwards(scene.control)
        laws = [scene.control[k] for k in self.driven.places]
        self._of_targets = np.array([law.stiffness * law.target for law in laws if isinstance(law, PD)])
        # of the evaluations in a step; shared by copies of this object, one of which MuJoCo calls
        self._asked: list[tuple[Array, Array]] = []
        self._stages: list[Array] = []

    def evaluate(self, q: Array, v: Array) -> Evaluation:
        """Accelerations, reactions and energies at a state."""
        self.place(q, v)
        self.data.qacc_warmstart[:] = 0.0  # so that the answer does not depend on the state before
        with self.following():
            mujoco.mj_forward(self.model, self.data)
        return evaluation(self, np.array(self.data.qacc), np.array(self.data.efc_force))

    @contextmanager
    def following(self) -> Iterator[None]:
        """Within it MuJoCo's actuators and joints follow the scene's functions of time.

        Each of MuJoCo's evaluations, those of the stages of RK4 too, gets the controls at its own time. What
        is held for a step instead would be of second order at best, and its power would jump.

        MuJoCo's equalities do not depend on time. But all that a constraint row knows of its residual r
        is the acceleration that it asks for (its documentation, Computation, section Reference),

            a_ref = -b dr/dt - k d r,

        which is changed here, before each of MuJoCo's solves, to that of r = x - f(t),

            a_ref = f'' - b (dx/dt - f') - k d (x - f).
        """
        if not len(self.moved) and not len(self.driven.places):
            yield
            return
        before = mujoco.get_mjcb_control()
        mujoco.set_mjcb_control(self._act)
        try:
            yield
        finally:
            mujoco.set_mjcb_control(before)

    def _act(self, model: Any, data: Any) -> None:
        """Callback of MuJoCo in each evaluation."""
        if len(self.driven.places):  # of the others those that are sampled have changed since
            data.ctrl[self.driven.places] = self.driven.at(data.time) + self._of_targets
        if len(self.moved):
            self._follow(data)

    def _follow(self, data: Any) -> None:
        """Change a_ref of the rows of prescribed motions at MuJoCo's time."""
        rows, functions = self._rows_of_motions(data), slice(len(self.moved))
        if self._asked:  # accelerations are still those of the stage before
            asked, stiffness = self._asked.pop()
            self._stages.append(stiffness * (asked - data.qacc[self.moved]))
        ahead = self.couplings.value(data.time)[functions] - self.couplings.value(0.0)[functions]
        k, b, impedance = data.efc_KBIP[rows, :3].T
        data.efc_aref[rows] += (
            self.couplings.acceleration(data.time)[functions]
            + b * self.couplings.rate(data.time)[functions]
            + k * impedance * ahead
        )
        self._asked.append((np.array(data.efc_aref[rows]), np.array(data.efc_D[rows])))

    def forget_stages(self) -> None:
        """Have the next evaluation be the first whose multipliers are kept."""
        self._asked.clear()
        self._stages.clear()

    def multipliers(self) -> Array:
        """(stages, m) N or N m, of prescribed motions at the evaluations since `forget_stages`.

        A soft constraint's force is D (a_ref - a) with the acceleration a that comes about.
        """
        return np.array([*self._stages, self.data.efc_force[self._rows_of_motions(self.data)]])

    def _rows_of_motions(self, data: Any) -> Array:
        """(m,) the rows of prescribed motions, which are never dropped: each moves a joint."""
        return np.flatnonzero(np.isin(data.efc_id, self._motions))

    def power(self) -> float:
        """Power, W, of actuators and dampers at the state that `data` holds."""
        data = self.data
        mujoco.mj_forward(self.model, data)
        return float(data.actuator_force @ data.actuator_velocity + data.qfrc_damper @ data.qvel)
