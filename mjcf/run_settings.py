"""Settings of a run in MuJoCo, and the controls of the run.

`mjcf.file_run` simulates a file with its own settings, and with others to measure the error of each setting.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from mjcf.constraint_solver import SOLVERS, ConstraintSolver, SolverName
from newton_euler.model.smooth_functions import Sine
from newton_euler.scalars import Array

INTEGRATORS = ("Euler", "implicit", "implicitfast", "RK4")
"""MuJoCo's integrators by their name in MJCF."""


@dataclass(frozen=True)
class MujocoSettings:
    """Settings of a run in MuJoCo, with the names of MJCF.

    Attributes:
        timestep: s.
        integrator: one of `INTEGRATORS`.
        solver: one of `mjcf.constraint_solver.SOLVERS`.
        iterations: largest number of iterations of the constraint solver.
        tolerance: relative improvement at which the constraint solver stops.
        solref: softness of all equalities; None keeps the softness that each equality has in the file.
        solimp: first three numbers of the impedance of all equalities; None keeps the numbers in the file.
        sleep: whether MuJoCo lets mechanisms that move slowly sleep, that is, holds them at rest.
    """

    timestep: float
    integrator: str
    solver: SolverName
    iterations: int
    tolerance: float
    solref: tuple[float, float] | None = None
    solimp: tuple[float, float, float] | None = None
    sleep: bool = False

    @classmethod
    def of(cls, model: Any) -> MujocoSettings:
        """Read the settings of a compiled model; the softness of equalities stays as in the model (None)."""
        # MuJoCo's constants are in capital letters, the names of MJCF are not
        integrator = mujoco.mjtIntegrator(model.opt.integrator).name.removeprefix("mjINT_")
        solver_of_constant = {f"mjSOL_{name.upper()}": name for name in SOLVERS}
        return cls(
            timestep=float(model.opt.timestep),
            integrator=integrator if integrator == "RK4" else integrator.lower().replace("euler", "Euler"),
            solver=solver_of_constant[mujoco.mjtSolver(model.opt.solver).name],
            iterations=int(model.opt.iterations),
            tolerance=float(model.opt.tolerance),
            sleep=bool(model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP),
        )

    def apply(self, model: Any) -> None:
        """Set these settings in a compiled model."""
        model.opt.timestep = self.timestep
        model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{self.integrator.upper()}")
        ConstraintSolver(self.solver, self.iterations, self.tolerance).apply(model)
        model.opt.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
        if self.sleep:
            model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)
        if self.solref is not None:
            model.eq_solref[:] = self.solref
        if self.solimp is not None:
            model.eq_solimp[:, :3] = self.solimp


class Inputs:
    """Controls of a run: constants, and sines about them.

    Attributes:
        control: (nu,) controls at the start.
        activation: (na,) activations at the start.
    """

    def __init__(self, model: Any, control: Array, activation: Array, sines: Mapping[int, Sine]) -> None:
        """Take the inputs of an imported scene.

        For an activation a(t) = a_0 + A sin(w t), an actuator with dynamics "integrator" needs the control
        da/dt. An actuator with dynamics "filter" needs a + tau da/dt (MuJoCo's documentation, Modeling,
        Actuator, attribute dyntype).

        Args:
            model: compiled model.
            control: (nu,) controls at the start.
            activation: (na,) activations at the start.
            sines: sine of the control, or of the activation of an actuator with dynamics, by number of the
                actuator.
        """
        self.control, self.activation = control, activation
        self._control_indices = np.array([model.actuator_ctrladr[k] for k in sines], dtype=int)
        self._frequency = np.array([sine.angular_frequency for sine in sines.values()])
        # amplitudes of sin(w t) and cos(w t) in the control of each actuator
        by_sine, by_cosine = [], []
        for actuator, sine in sines.items():
            rate = sine.amplitude * sine.angular_frequency
            match mujoco.mjtDyn(model.actuator_dyntype[actuator]):
                case mujoco.mjtDyn.mjDYN_NONE:
                    of_sine, of_cosine = sine.amplitude, 0.0
                case mujoco.mjtDyn.mjDYN_INTEGRATOR:
                    of_sine, of_cosine = 0.0, rate
                case mujoco.mjtDyn.mjDYN_FILTER | mujoco.mjtDyn.mjDYN_FILTEREXACT:
                    tau = float(model.actuator_dynprm[actuator, 0])
                    of_sine, of_cosine = sine.amplitude, rate * tau
                case kind:
                    raise NotImplementedError(f"sine of an actuator with dynamics {kind.name}")
            by_sine.append(of_sine)
            by_cosine.append(of_cosine)
        self._by_sine, self._by_cosine = np.array(by_sine), np.array(by_cosine)

    @property
    def are_constant(self) -> bool:
        """True if no control follows a sine."""
        return not len(self._control_indices)

    def at(self, times: float | Array) -> Array:
        """Return the controls (nu,) at a time, s, or (n, nu) at n times."""
        phase = np.multiply.outer(times, self._frequency)
        controls = np.broadcast_to(self.control, (*phase.shape[:-1], len(self.control))).copy()
        sines = self._by_sine * np.sin(phase) + self._by_cosine * np.cos(phase)
        controls[..., self._control_indices] += sines
        return controls

    @property
    def terms(self) -> dict[str, list[float]]:
        """Numbers (nu,) of the controls constant + sine sin(w t) + cosine cos(w t), by name.

        "angular_frequency" is w, rad/s; it is 0 for a constant control.
        """
        frequency, sine, cosine = np.zeros((3, len(self.control)))
        frequency[self._control_indices] = self._frequency
        sine[self._control_indices], cosine[self._control_indices] = self._by_sine, self._by_cosine
        terms = {"constant": self.control, "sine": sine, "cosine": cosine, "angular_frequency": frequency}
        return {name: values.tolist() for name, values in terms.items()}
