"""Iteration by which MuJoCo computes the forces of its soft constraints, and its options."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple, get_args

SolverName = Literal["Newton", "CG", "PGS"]
"""MuJoCo's constraint solvers, as MJCF names them. CG is the method of conjugate gradients, PGS the projected
Gauss-Seidel method."""

SOLVERS: tuple[SolverName, ...] = get_args(SolverName)

ITERATIONS = 100
"""Default for the largest number of iterations; MuJoCo's default as well."""

MAX_ITERATIONS = 100_000
"""Largest number of iterations that may be asked for; MuJoCo cannot be interrupted while it iterates."""

TOLERANCE = 1e-15
"""Default for the relative improvement at which the iteration ends. At MuJoCo's own default, 1e-8, conjugate
gradients with a warm start end too early for accurate runs."""


class ConstraintSolver(NamedTuple):
    """Constraint solver of a run.

    Attributes:
        name: one of `SOLVERS`.
        iterations: largest number of iterations.
        tolerance: relative improvement at which the iteration ends.
    """

    name: SolverName = "Newton"
    iterations: int = ITERATIONS
    tolerance: float = TOLERANCE

    def apply(self, model: Any) -> None:
        """Set this solver in a compiled model."""
        import mujoco

        model.opt.solver = getattr(mujoco.mjtSolver, f"mjSOL_{self.name.upper()}")
        model.opt.iterations, model.opt.tolerance = self.iterations, self.tolerance
