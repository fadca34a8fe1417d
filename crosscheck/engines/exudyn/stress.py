"""Settings of Exudyn for stress tests: its implicit integrators, by default at a step of 1 ms."""

from __future__ import annotations

from crosscheck.engines.stress import Options, StressSettings


def setting(integrator: str = "generalized_alpha", step: float = 1e-3) -> Options:
    """Return a setting with an integrator of Exudyn and a step, s."""
    return {"integrator": integrator, "step": step}


BOTH = (setting(), setting("trapezoidal"))
"""Both integrators."""

STRESS = StressSettings(
    typical=(setting(),),
    topics={"starts": BOTH, "singular": BOTH, "stiff gains": BOTH, "fixed steps": BOTH},
    long_runs={
        "pendulum": {1e3: (setting(step=1e-2), setting("trapezoidal", 1e-2))},
        "four_bar": {200.0: (setting(step=2e-3),)},
        "tracker": {60.0: (setting(step=1e-2),)},
    },
    stepped=({"integrator": "generalized_alpha"}, {"integrator": "trapezoidal"}),
    at_step=lambda step: setting(step=step),
    position_error=1e-5,
)
