"""Benchmarks of Drake: DOP853 with Drake's equations, and Drake's own solvers, from coarse to fine.

The time of a run is that of the integration. It does not include forward kinematics at the outputs, which
take some 10 us each: tree coordinates are converted to poses afterwards.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import cycle
from timeit import Timer

import numpy as np

from crosscheck.engines.benchmarks import (
    Benchmarks,
    Ladder,
    Model,
    Models,
    Options,
    RightHandSide,
    integrated,
    output_interval,
    projected,
    step_ladder,
)
from crosscheck.engines.drake.equations import DrakeSystem
from crosscheck.engines.drake.solvers import SolverName, integrate_with, limits_of_solver
from newton_euler.model.scene import Scene
from newton_euler.reading.excitation import random_states

ACCURACIES = (3, 5, 7, 9, 11, 12, 13)
"""Negative decimal logarithms of the accuracies of `runge_kutta5`."""

STEPS_PER_OUTPUT = (1, 2, 5, 10, 20, 50)
"""Numbers of SAP's steps from one output to the next."""


def _models(scene: Scene) -> Models:
    """Return functions that load a scene for Drake's equations, and for each solver that can run it."""
    own: dict[SolverName, Ladder] = {
        "SAP": step_ladder("SAP", "step", output_interval(scene), STEPS_PER_OUTPUT, solver="SAP"),
        "runge_kutta5": Ladder("runge_kutta5", _accuracy, ACCURACIES, {"solver": "runge_kutta5"}),
    }
    runs: dict[str, Callable[[], Model]] = {
        solver: partial(_own_model, scene, ladder)
        for solver, ladder in own.items()
        if not limits_of_solver(scene, solver)
    }
    return {"equations": partial(projected, partial(DrakeSystem, scene)), **runs}


def _accuracy(number: int) -> tuple[str, Options]:
    """Return name and options of an accuracy, by its negative decimal logarithm."""
    return f"accuracy 1e-{number}", {"accuracy": 10.0**-number}


def _own_model(scene: Scene, ladder: Ladder) -> Model:
    """Load a scene for a solver of Drake."""
    return Model([ladder], lambda options: integrated(integrate_with(scene, options)))


def _right_hand_side(scene: Scene) -> RightHandSide:
    """Make the accelerations of Drake's equations, called from Python.

    The equations keep the result of the last state, so that calls alternate between two states.
    """
    system = DrakeSystem(scene)
    states = cycle([system.coordinates(state) for state in random_states(scene, 2)])
    return RightHandSide(Timer(lambda: system.acceleration(*next(states))).timeit)


def _forward_dynamics(scene: Scene) -> RightHandSide:
    """Make Drake's articulated-body algorithm of the spanning tree, without loops, called from Python."""
    system = DrakeSystem(scene)
    placed, states = system.placed, [system.coordinates(state) for state in random_states(scene, 2)]
    rest = np.zeros(system.nv), np.zeros((len(placed.built.bodies), 6))
    placed.load(*rest)
    following = cycle([(q[: system.tree.nq], v) for q, v in states])
    port = placed.plant.get_generalized_acceleration_output_port()

    def evaluate() -> None:
        placed.place(*next(following))
        port.Eval(placed.context)

    return RightHandSide(Timer(evaluate).timeit)


BENCHMARKS = Benchmarks(
    models=_models,
    right_hand_sides={"equations": _right_hand_side, "tree without loops": _forward_dynamics},
)
