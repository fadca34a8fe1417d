"""MuJoCo as it is, with its soft constraints, at single states."""

from __future__ import annotations

import mujoco
import numpy as np

from mjcf.evaluate import evaluation
from mjcf.model import CompiledScene
from newton_euler.scalars import Array
from newton_euler.state import Evaluation


class SoftMuJoCo(CompiledScene):
    """What `mj_forward` says: accelerations and constraint forces of soft constraints."""

    name = "mujoco"

    def evaluate(self, q: Array, v: Array) -> Evaluation:
        """Accelerations, reactions and energies at a state."""
        self.place(q, v)
        self.data.qacc_warmstart[:] = 0.0  # so that the answer does not depend on the state before
        mujoco.mj_forward(self.model, self.data)
        return evaluation(self, np.array(self.data.qacc), np.array(self.data.efc_force))
