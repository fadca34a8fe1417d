"""Settings of Pinocchio for stress tests: newton_euler's integrators with Pinocchio's equations."""

from __future__ import annotations

from crosscheck.engines.stress import Options, StressSettings

DEFAULT: Options = {}
"""DOP853 at the default tolerance."""

PROJECTION: Options = {"stabilization": "projection"}
"""Each step projected onto the constraints."""

STRESS = StressSettings(
    topics={
        "starts": (DEFAULT, PROJECTION, {"stabilization": "none"}),
        "singular": (DEFAULT, PROJECTION),
        "stiff gains": (DEFAULT, {"integrator": "Radau", "rtol": 1e-6, "atol": 1e-9}),
        "fixed steps": (),
    },
    long_runs={
        "pendulum": {100.0: (DEFAULT,)},
        "four_bar": {10.0: (DEFAULT, PROJECTION)},
        "tracker": {60.0: (DEFAULT,)},
    },
    stepped=({"integrator": "RK4"}, {"integrator": "Euler"}),
    adaptive=({"integrator": "DOP853"}, {"integrator": "Radau"}),
    is_slow=True,
)
