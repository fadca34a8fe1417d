"""Settings of Drake for stress tests: newton_euler's integrators with Drake's equations."""

from __future__ import annotations

from crosscheck.engines.stress import Options, StressSettings

DEFAULT: Options = {}
"""DOP853 at the default tolerance."""

STRESS = StressSettings(
    topics={
        "starts": (DEFAULT, {"stabilization": "none"}),
        "stiff gains": (DEFAULT, {"integrator": "Radau", "rtol": 1e-6, "atol": 1e-9}),
        "fixed steps": (),
    },
    long_runs={
        "pendulum": {100.0: (DEFAULT,), 1000.0: ({"solver": "runge_kutta5", "accuracy": 1e-11},)},
        "four_bar": {10.0: (DEFAULT,)},
        "tracker": {60.0: (DEFAULT,)},
    },
    stepped=({"integrator": "RK4"}, {"integrator": "Euler"}, {"solver": "SAP"}),
    adaptive=({"integrator": "DOP853"}, {"integrator": "Radau"}),
    is_slow=True,
)
