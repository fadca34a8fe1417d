"""Benchmarks of Pinocchio: scipy's LSODA, and DOP853 with projection, with tolerances from coarse to fine.

The time of a run of LSODA is that of the integration, of forward kinematics at every output, and of copies of
the translations and rotation matrices of all joints there.
"""

from __future__ import annotations

import time
from functools import partial
from timeit import Timer

from crosscheck.engines.benchmarks import (
    ATOL_PER_RTOL,
    FINEST_DECADE,
    Benchmarks,
    Model,
    Models,
    Options,
    RightHandSide,
    Run,
    projected,
    tolerance_ladder,
)
from newton_euler.model.scene import Scene
from urdf.benchmark_kernels import Kinematics, articulated_bodies, equations_of, lsoda
from urdf.dynamics import PinocchioSystem

BAUMGARTE_ALPHAS = (0.0, 3.0, 10.0)
"""Parameters alpha, 1/s, of Baumgarte's stabilization, which feeds back constraint violations with the gains
alpha^2 and their rates with 2 alpha.

With the scene `tracker`, 30 is not better than 10, and 100 makes the equations stiff.
"""


def _models(scene: Scene) -> Models:
    """Return functions that load a scene into Pinocchio with each of `BAUMGARTE_ALPHAS`, and with projection.

    Accelerations come from Pinocchio's `constraintDynamics`. Those of `lcaba`, Pinocchio's articulated-body
    algorithm with constraints, have noise of 1e-9, at which integrators with error control stall.
    """
    compiled = {
        f"constraintDynamics, alpha {alpha:g}": partial(_load, scene, alpha) for alpha in BAUMGARTE_ALPHAS
    }
    return {"projection": partial(projected, partial(PinocchioSystem, scene)), **compiled}


def _load(scene: Scene, alpha: float) -> Model:
    """Load a scene into Pinocchio with a Baumgarte parameter alpha, 1/s; the integrator is LSODA."""
    equations = equations_of(scene, alpha, lcaba=None)  # by `constraintDynamics`
    kinematics = Kinematics(equations)

    def run(options: Options) -> Run:
        start = time.perf_counter()
        states, evaluations = lsoda(equations, **options)  # states at the output times
        placements = kinematics(states)
        seconds = time.perf_counter() - start
        return Run(seconds, evaluations, partial(kinematics.poses, placements))

    method = f"constraintDynamics, alpha {alpha:g}, LSODA"
    ladders = [
        tolerance_ladder(method, coarsest=1.0, finest=FINEST_DECADE, atol_per_rtol=ratio)
        for ratio in ATOL_PER_RTOL
    ]
    return Model(ladders, run)


def _constrained(scene: Scene, lcaba: tuple[float, int] | None) -> RightHandSide:
    """Make Pinocchio's right-hand side for mechanisms with loops, called from Python.

    Args:
        scene: the scene.
        lcaba: regularization mu and number of proximal iterations of `lcaba`, Pinocchio's articulated-body
            algorithm with constraints; None for `constraintDynamics`, which factorizes the constraints.
    """
    # alpha: gain of Baumgarte stabilization
    return RightHandSide(Timer(equations_of(scene, alpha=0.0, lcaba=lcaba).acceleration).timeit)


def _aba(scene: Scene) -> RightHandSide:
    """Make Pinocchio's articulated-body algorithm for mechanisms without loops, called from Python."""
    return RightHandSide(Timer(articulated_bodies(scene)).timeit)


BENCHMARKS = Benchmarks(
    models=_models,
    right_hand_sides={
        "aba": _aba,
        "constraintDynamics": partial(_constrained, lcaba=None),
        "lcaba, mu 1e-6": partial(_constrained, lcaba=(1e-6, 1)),
    },
)
