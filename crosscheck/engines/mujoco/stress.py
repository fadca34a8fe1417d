"""Settings of MuJoCo for stress tests: integrators and constraint solvers, by default at a step of 1 ms."""

from __future__ import annotations

from crosscheck.engines.stress import Options, StressSettings
from mjcf.constraint_solver import SOLVERS, SolverName


def setting(integrator: str = "RK4", timestep: float = 1e-3, solver: SolverName | None = None) -> Options:
    """Return a setting with an integrator of MuJoCo, a timestep, s, and a constraint solver.

    If the solver is None, the setting does not name one, and MuJoCo uses Newton's method.
    """
    named = {} if solver is None else {"solver": solver}
    return {"integrator": integrator, "timestep": timestep, **named}


STRESS = StressSettings(
    typical=(setting(),),
    topics={
        "starts": (setting(), setting("implicitfast")),
        "singular": (setting(), setting("implicitfast")),
        "stiff gains": tuple(setting(each) for each in ("RK4", "Euler", "implicit", "implicitfast")),
        # very different masses make the iteration for constraint forces ill-conditioned
        "masses": (
            setting(),
            *(setting(solver=solver) for solver in SOLVERS if solver != "Newton"),
            setting("implicitfast"),
        ),
        "numbers": (setting(), setting("implicitfast")),
        "fixed steps": tuple(setting(each) for each in ("Euler", "implicitfast", "RK4")),
    },
    long_runs={
        "pendulum": {
            1e4: tuple(setting(each, 1e-2) for each in ("RK4", "Euler", "implicitfast")),
            1e3: (setting("RK4", 1e-3),),
        },
        "four_bar": {1e3: (setting("implicitfast", 2e-3),), 200.0: (setting("RK4", 2e-3),)},
        "tracker": {3600.0: (setting("RK4", 1e-2), setting("implicitfast", 1e-2))},
    },
    stepped=tuple({"integrator": each} for each in ("RK4", "Euler", "implicit", "implicitfast")),
    step_option="timestep",
    at_step=lambda step: setting(timestep=step),
    position_error=1e-5,
    integrates_work=False,
)
