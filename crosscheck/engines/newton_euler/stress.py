"""Settings of newton_euler for stress tests: both formulations, all stabilizations and integrators."""

from __future__ import annotations

from itertools import product
from typing import Any

from crosscheck.engines.stress import Options, StressSettings
from newton_euler.compiled.formulations import FORMULATIONS
from newton_euler.integrators.options import STABILIZATIONS, FormulationName, StabilizationName


def setting(
    formulation: FormulationName = "relative", stabilization: StabilizationName = "projection", **options: Any
) -> Options:
    """Return a setting.

    Args:
        formulation: coordinates, "relative" (of joints) or "cartesian" (of bodies).
        stabilization: how constraint violations are kept small.
        **options: other options, such as `integrator`, `rtol`, `atol` and `step`.
    """
    return {"formulation": formulation, "stabilization": stabilization, **options}


def both_formulations(**options: Any) -> tuple[Options, ...]:
    """Return settings in both formulations with projection and the given options."""
    return tuple(setting(formulation, **options) for formulation in FORMULATIONS)


STABILIZED = tuple(setting(*each) for each in product(FORMULATIONS, STABILIZATIONS))
"""Both formulations with each method of stabilization, at the default tolerance."""

STRESS = StressSettings(
    typical=both_formulations(),
    topics={
        "long tops": (*STABILIZED, setting(integrator="Radau", rtol=1e-8, atol=1e-10)),
        "starts": STABILIZED,
        "singular": (
            *STABILIZED,
            setting(integrator="Radau", rtol=1e-8, atol=1e-10),
            setting(integrator="RK4", step=1e-3),
        ),
        "stiff gains": (
            *both_formulations(),
            setting("relative", "baumgarte"),
            setting(integrator="Radau", rtol=1e-6, atol=1e-9),
            setting(integrator="RK4", step=1e-3),
            setting(integrator="Euler", step=1e-3),
        ),
        "masses": (
            *both_formulations(),
            setting("relative", "baumgarte"),
            setting("cartesian", "baumgarte"),
        ),
        "numbers": (
            *both_formulations(),
            setting("cartesian", "baumgarte"),
            setting(integrator="Radau"),
            setting(integrator="RK4", step=1e-2),
            setting(integrator="Euler", step=1e-2),
        ),
        # "Euler" is the semi-implicit method
        "fixed steps": (
            *(
                setting(formulation, integrator="Euler", step=step)
                for formulation in FORMULATIONS
                for step in (1e-3, 1e-4)
            ),
            *both_formulations(integrator="RK4", step=1e-3),
        ),
        "noise": STABILIZED,
    },
    long_runs={
        "pendulum": {
            1e4: (
                *STABILIZED,
                setting(integrator="Radau", rtol=1e-6, atol=1e-8),
                setting(integrator="RK4", step=1e-2),
                setting(integrator="Euler", step=1e-3),
            )
        },
        "four_bar": {
            1e3: (setting("relative"),),
            200.0: (setting("cartesian"),),
            10.0: tuple(
                setting(formulation, stabilization)
                for stabilization in ("baumgarte", "none")
                for formulation in FORMULATIONS
            ),
        },
        "tracker": {
            3600.0: (
                *STABILIZED,
                setting(integrator="Radau", rtol=1e-8, atol=1e-10),
                setting(integrator="RK4", step=1e-2),
            )
        },
    },
    stepped=tuple(
        each for integrator in ("RK4", "Euler") for each in both_formulations(integrator=integrator)
    ),
    # last the one that compiles for half a minute: Radau in Cartesian coordinates
    adaptive=tuple(
        each for integrator in ("DOP853", "Radau") for each in both_formulations(integrator=integrator)
    ),
)
