"""Settings of MuJoCo for stress tests: its integrators, by default at a step of 1 ms."""

from __future__ import annotations

from crosscheck.engines.stress import Options, StressSettings


def setting(integrator: str = "RK4", timestep: float = 1e-3) -> Options:
    """Return a setting with an integrator of MuJoCo and a timestep, s."""
    return {"integrator": integrator, "timestep": timestep}


STRESS = StressSettings(
    typical=(setting(),),
    topics={
        "starts": (setting(), setting("implicitfast")),
        "singular": (setting(), setting("implicitfast")),
        "stiff gains": tuple(setting(each) for each in ("RK4", "Euler", "implicit", "implicitfast")),
        "masses": (setting(), setting("implicitfast")),
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
